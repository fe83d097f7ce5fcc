//! Locks: records of the inputs, kinds and results of a graph, to check that another run gives the same results.

use std::collections::BTreeMap;

use cache::Digest;
use serde::{Deserialize, Serialize};

use crate::graph::graph::Graph;
use crate::plan::plan::{Fate, Outlook};
use crate::run::engine::Engine;
use crate::text::source::Source;
use crate::value::error::NodeError;
use crate::value::root::is_program;

/// Version of the format of locks; raised when their fields change.
const FORMAT: u32 = 1;

/// The inputs, kinds and results of a graph. The text is RON in a fixed order, so that equal graphs give equal
/// texts.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lock {
    /// Format of the lock.
    pub format: u32,
    /// Version and numeric profile of each kind in the graph.
    pub kinds: BTreeMap<String, (u32, String)>,
    /// Digest of each source file. The key is the name of the file in the graph.
    pub inputs: BTreeMap<String, String>,
    /// Digests of outputs, for each node that has a result. The keys are the name of the node and the name of the
    /// output.
    pub results: BTreeMap<String, BTreeMap<String, String>>,
}

/// Errors when parsing a lock.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// The text does not parse.
    #[error("`{name}` is not a valid lock: {why}")]
    Form {
        /// Name of the file.
        name: String,
        /// Reason for the error.
        why: String,
    },
    /// The format of the lock is not the format that this version of lightharmony reads.
    #[error("`{name}` is a lock of format {format}, but this version of lightharmony reads format {FORMAT}")]
    Format {
        /// Name of the file.
        name: String,
        /// Version of the format of the lock.
        format: u32,
    },
}

/// Differences between a lock and the current state, one line each.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LockDifferences {
    /// Differences in kinds and inputs. If there are any, a new run may give results that differ from the results
    /// in the lock.
    pub before: Vec<String>,
    /// Differences between the results in the lock and the current results.
    pub results: Vec<String>,
}

impl Engine {
    /// The lock of everything that the targets of a graph need. Nodes without results are left out.
    ///
    /// # Errors
    /// If a source file cannot be read.
    pub fn lock(&self, graph: &Graph, only: &[usize]) -> Result<Lock, NodeError> {
        let targets = if only.is_empty() { graph.targets() } else { only.to_vec() };
        let wanted = graph.above(&targets);
        let mut outlook = Outlook::new(self, graph);
        let mut lock = Lock { format: FORMAT, ..Lock::default() };
        for &index in graph.order().iter().filter(|&&index| wanted[index]) {
            let node = &graph.nodes[index];
            let kind = (node.kind.version, node.kind.profile.to_owned());
            lock.kinds.insert(node.kind.name.to_owned(), kind);
            let fate = outlook.fate(index);
            // Source files are locked even if nodes above have no result.
            let sources = match fate {
                Fate::Follows(_) | Fate::Fails(_) => {
                    crate::record::action::read_sources(graph, index, self.store())?
                }
                _ => outlook.actions[index].sources.clone(),
            };
            for source in sources {
                lock.inputs.insert(source.file.name, source.digest.to_string());
            }
            if let (Fate::Known | Fate::Lost, Some(record)) = (fate, &outlook.records[index]) {
                let outputs = node.kind.outputs.iter().zip(&record.outputs);
                let digests = outputs.map(|(port, output)| (port.name.to_owned(), output.digest.to_string()));
                lock.results.insert(node.id.clone(), digests.collect());
            }
        }
        Ok(lock)
    }
}

impl Lock {
    /// Digests of the programs that nodes run, by the names of their source files.
    pub(crate) fn programs(&self) -> BTreeMap<String, Digest> {
        let programs = self.inputs.iter().filter(|(name, _)| is_program(name));
        programs.filter_map(|(name, hex)| Some((name.clone(), Digest::from_hex(hex)?))).collect()
    }

    /// The text of the lock.
    pub fn text(&self) -> String {
        let pretty = ron::ser::PrettyConfig::new().struct_names(true).new_line("\n").compact_arrays(true);
        // Strings, numbers and maps can always be serialised.
        ron::ser::to_string_pretty(self, pretty).unwrap_or_default() + "\n"
    }

    /// Parses a lock.
    ///
    /// # Errors
    /// If the text is not a lock (the message contains the position of the mistake), or if the lock has a format
    /// that this version does not read.
    pub fn parse(source: &Source) -> Result<Self, LockError> {
        let name = source.name.clone();
        let lock: Self = ron::from_str(&source.text)
            .map_err(|error| LockError::Form { name: name.clone(), why: error.to_string() })?;
        if lock.format == FORMAT { Ok(lock) } else { Err(LockError::Format { name, format: lock.format }) }
    }

    /// Lists the differences between this lock and `now`, a lock of the current state. Only results that both locks
    /// contain are compared.
    pub fn differences(&self, now: &Lock) -> LockDifferences {
        let short = |digest: &str| digest.chars().take(12).collect::<String>();
        let mut found = LockDifferences::default();
        for (kind, (version, profile)) in &now.kinds {
            match self.kinds.get(kind) {
                None => found.before.push(format!("the lock does not list the kind `{kind}`")),
                Some(known) if *known != (*version, profile.clone()) => found.before.push(format!(
                    "`{kind}` has version {version} ({profile}), but the lock has version {} ({})",
                    known.0, known.1
                )),
                _ => {}
            }
        }
        for (name, digest) in &now.inputs {
            match self.inputs.get(name) {
                None => found.before.push(format!("the lock does not list the input `{name}`")),
                Some(known) if known != digest => found.before.push(format!(
                    "`{name}` has the digest {}, but the lock has the digest {}",
                    short(digest),
                    short(known)
                )),
                _ => {}
            }
        }
        for (node, outputs) in &now.results {
            let Some(known) = self.results.get(node) else { continue };
            for (port, digest) in outputs {
                if let Some(known) = known.get(port).filter(|known| *known != digest) {
                    let (now, then) = (short(digest), short(known));
                    found.results.push(format!(
                        "the result of `{node}.{port}` has the digest {now}, but the lock has the digest {then}"
                    ));
                }
            }
        }
        found
    }
}
