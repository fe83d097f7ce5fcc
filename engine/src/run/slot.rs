//! What the scheduler knows of one node while a graph runs.

use cache::Digest;

use crate::record::action::Action;
use crate::record::record::Record;
use crate::run::event::State;
use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;

/// Where a node is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Life {
    /// No target stands below it.
    Unwanted,
    /// An input is not yet known by digest.
    Waiting,
    /// The files it reads are being digested.
    Reading,
    /// Not in the store; waits for its turn to bring its input values to memory.
    Ready,
    /// Its input values are on their way to memory.
    Gathering,
    /// Input values are there; waits for a thread and for memory.
    Queued,
    /// Another node or process computes its key or a part of it; asks again in a while.
    Parked,
    /// Its code runs.
    Running,
    /// Another node of the same key is being computed.
    Following,
    /// A sink whose result is known and whose files are being put in place.
    Placing,
    /// Its outputs are known by digest, and it was told so.
    Done,
    /// Its code, its sources or a file of it failed.
    Failed,
    /// Not tried, since something it needs failed or the run was stopped.
    Skipped,
}

/// Who waits for a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Waiter {
    /// The code of a node that reads it.
    Code(usize),
    /// The files of a sink, which is the node itself.
    Files(usize),
}

/// One node of a running graph.
pub(crate) struct Slot {
    pub life: Life,
    /// Nodes above that are not known by digest.
    pub unresolved: usize,
    /// Input values that are not in memory.
    pub missing: usize,
    /// Who may still want the values: nodes below that are not done, remakes of them, and its own files.
    pub readers: usize,
    pub action: Action,
    pub key: Option<Digest>,
    pub record: Option<Record>,
    /// One entry an output, or none at all while there is no value.
    values: Vec<Value>,
    pub waiters: Vec<(usize, Waiter)>,
    /// Its outputs are known, but its code runs once more for their values. Its life is then what it
    /// would be without this once that is over.
    pub remaking: Option<Life>,
    /// Its values cannot be had: making them once more failed.
    pub lost: bool,
    /// Its values are being written to the store.
    pub storing: bool,
    /// Messages that threads owe for it.
    pub owed: usize,
    pub degraded: bool,
    /// It does less than the graph file says, or is made from what does.
    pub rough: bool,
    /// How much its code has to do, in units of its kind.
    pub work: f64,
    /// Whether that takes little time, by forecast.
    pub short: bool,
    /// Memory that its code was admitted with.
    pub reserved: u64,
    /// What its code will take, once asked for.
    pub cost: Option<u64>,
    /// How it came to its result; told once its files are in place.
    pub end: Option<State>,
    /// With what work: until there is a result, that of before it had to wait.
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
            work: 0.0,
            short: false,
            reserved: 0,
            cost: None,
            end: None,
            effort: Effort::default(),
        }
    }

    /// Whether others of its key wait for this one to be computed.
    pub fn leads(&self) -> bool {
        use Life::{Gathering, Parked, Queued, Ready, Running};
        self.remaking.is_none() && matches!(self.life, Ready | Gathering | Queued | Parked | Running)
    }

    pub fn value(&self, port: usize) -> Option<&AnyArtifact> {
        self.values.get(port)?.artifact.as_ref()
    }

    /// A value and how many bytes it holds.
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

    /// Keeps a value of so many bytes. False when there was one already.
    pub fn keep(&mut self, port: usize, artifact: AnyArtifact, bytes: u64) -> bool {
        let entry = self.entry(port);
        entry.loading = false;
        if entry.artifact.is_some() {
            return false;
        }
        (entry.artifact, entry.bytes) = (Some(artifact), bytes);
        true
    }

    /// Marks a value as on its way from the store. False when it is already.
    pub fn begin_loading(&mut self, port: usize) -> bool {
        !std::mem::replace(&mut self.entry(port).loading, true)
    }

    /// The value did not come from the store.
    pub fn end_loading(&mut self, port: usize) {
        self.entry(port).loading = false;
    }

    /// Lets go of what only a run has use for.
    pub fn rest(&mut self) {
        self.drop_values();
        self.waiters.clear();
        self.readers = 0;
    }

    /// Whether nobody will ask for the values any more.
    pub fn is_unread(&self) -> bool {
        self.readers == 0 && !self.storing && self.waiters.is_empty() && self.remaking.is_none()
    }

    /// Bytes of its values in memory.
    pub fn bytes(&self) -> u64 {
        self.values.iter().map(|value| value.bytes).sum()
    }

    /// Gives the values up and says how many bytes they held.
    pub fn drop_values(&mut self) -> u64 {
        std::mem::take(&mut self.values).iter().map(|value| value.bytes).sum()
    }
}
