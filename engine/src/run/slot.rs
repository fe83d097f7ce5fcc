//! The state of a node during a run.

use cache::Digest;

use crate::record::action::Action;
use crate::record::record::Record;
use crate::run::event::State;
use crate::run::time_estimate::TimeEstimate;
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;

/// The stages of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Life {
    /// No target needs the node.
    Unwanted,
    /// The digests of some inputs are not known yet.
    Waiting,
    /// The source files of the node are being digested.
    Reading,
    /// The result is not in the store, and is being looked up in the results that machines share.
    Asking,
    /// The result is not known, and a worker will compute the node.
    Listed,
    /// A worker will compute the node; the inputs that the server does not have are being loaded.
    Collecting,
    /// A worker computes the node.
    Away,
    /// The result is not in the store; the node waits until its input values may be loaded.
    Ready,
    /// The input values are being loaded.
    Gathering,
    /// The node waits for a thread and for memory.
    Queued,
    /// The result of the node or of one of its parts is being computed elsewhere. The node is tried again later.
    Parked,
    /// The code runs.
    Running,
    /// Another node with the same key is being computed.
    Following,
    /// The node is a sink, and its files are being written.
    Placing,
    /// The digests of the outputs are known, and the event was sent.
    Done,
    /// The code, a source file or an output file failed.
    Failed,
    /// The node did not run, since a node that it depends on failed or the run was cancelled.
    Skipped,
}

/// A consumer that waits for a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Waiter {
    /// The code of the node with this index, which reads the value.
    Code(usize),
    /// The task that writes the files of the sink with this index.
    Files(usize),
}

/// The state of a node.
pub(crate) struct Slot {
    pub life: Life,
    /// Number of nodes that this node reads and whose output digests are not known yet.
    pub unresolved: usize,
    /// Number of input values that are needed but not in memory.
    pub missing: usize,
    /// Number of consumers that may need the values: unfinished downstream nodes, reruns of downstream nodes, and
    /// the node's own files.
    pub readers: usize,
    pub action: Action,
    pub key: Option<Digest>,
    pub record: Option<Record>,
    /// The values of the outputs. Empty if no value was kept.
    values: Vec<Value>,
    pub waiters: Vec<(usize, Waiter)>,
    /// The stage to which the node returns after a rerun for its values. `None` if no rerun is pending.
    pub remaking: Option<Life>,
    /// True if the values of the node are lost because the rerun failed.
    pub lost: bool,
    /// True if the values of the node are being stored.
    pub storing: bool,
    /// Number of messages that threads still have to send for the node.
    pub owed: usize,
    pub degraded: bool,
    /// True if the node, or an upstream node, is reduced for a preview.
    pub rough: bool,
    /// Work and expected time of the node's code. Set when the key of the node is known.
    pub time: TimeEstimate,
    /// Memory reserved for the node's code, in bytes.
    pub reserved: u64,
    /// Estimate of the memory that the node's code needs, in bytes; `None` before the first estimate.
    pub cost: Option<u64>,
    /// Number of attempts to have the node computed by a worker that failed because an input was missing.
    pub attempts: u32,
    /// True if the result of a worker is compared with the result of this machine.
    pub checked: bool,
    /// The result of a worker that is compared with the result of this machine, and the name of the worker.
    pub check: Option<Box<(Record, String)>>,
    /// State in which the node ended; reported once its files are up to date.
    pub end: Option<State>,
    /// Time and counts of the work for the result. Before the result is available, they cover only the work that
    /// was done before the node was parked.
    pub effort: Effort,
}

#[derive(Default, Clone)]
struct Value {
    artifact: Option<AnyArtifact>,
    bytes: u64,
    loading: bool,
}

impl Slot {
    pub fn new(life: Life, unresolved: usize) -> Self {
        Self {
            life,
            unresolved,
            missing: 0,
            readers: 0,
            action: Action::default(),
            key: None,
            record: None,
            values: Vec::new(),
            waiters: Vec::new(),
            remaking: None,
            lost: false,
            storing: false,
            owed: 0,
            degraded: false,
            rough: false,
            time: TimeEstimate::default(),
            reserved: 0,
            cost: None,
            attempts: 0,
            checked: false,
            check: None,
            end: None,
            effort: Effort::default(),
        }
    }

    /// True if the node computes or looks up the result for its key. Other nodes with the same key wait for it.
    pub fn leads(&self) -> bool {
        use Life::{Asking, Away, Collecting, Gathering, Listed, Parked, Queued, Ready, Running};
        let is_here = matches!(self.life, Asking | Ready | Gathering | Queued | Parked | Running);
        self.remaking.is_none() && (is_here || matches!(self.life, Listed | Collecting | Away))
    }

    pub fn value(&self, port: usize) -> Option<&AnyArtifact> {
        self.values.get(port)?.artifact.as_ref()
    }

    /// The value of an output and its size in bytes, if the value is in memory.
    pub fn sized_value(&self, port: usize) -> Option<(&AnyArtifact, u64)> {
        let value = self.values.get(port)?;
        Some((value.artifact.as_ref()?, value.bytes))
    }

    fn entry(&mut self, port: usize) -> &mut Value {
        if self.values.len() <= port {
            self.values.resize(port + 1, Value::default());
        }
        &mut self.values[port]
    }

    /// Keeps a value of the given size. Returns false if it is present already.
    pub fn keep(&mut self, port: usize, artifact: AnyArtifact, bytes: u64) -> bool {
        let entry = self.entry(port);
        entry.loading = false;
        if entry.artifact.is_some() {
            return false;
        }
        (entry.artifact, entry.bytes) = (Some(artifact), bytes);
        true
    }

    /// Marks a value as being loaded. Returns false if it was marked already.
    pub fn begin_loading(&mut self, port: usize) -> bool {
        !std::mem::replace(&mut self.entry(port).loading, true)
    }

    /// Marks the loading of a value as failed.
    pub fn end_loading(&mut self, port: usize) {
        self.entry(port).loading = false;
    }

    /// Drops all data that is needed only during a run.
    pub fn rest(&mut self) {
        self.drop_values();
        self.waiters.clear();
        self.readers = 0;
    }

    /// True if the values are not needed any more.
    pub fn is_unread(&self) -> bool {
        self.readers == 0 && !self.storing && self.waiters.is_empty() && self.remaking.is_none()
    }

    /// Total size in bytes of the node's values that are in memory.
    pub fn bytes(&self) -> u64 {
        self.values.iter().map(|value| value.bytes).sum()
    }

    /// Drops the values and returns their size in bytes.
    pub fn drop_values(&mut self) -> u64 {
        std::mem::take(&mut self.values).iter().map(|value| value.bytes).sum()
    }
}
