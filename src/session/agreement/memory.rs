//! Remembers the findings of comparisons from one run to the next, in the cache.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::path::Path;

use cache::FileStamp;
use engine::{Digest, DigestWriter, Event, Graph, Source, SourceRoot, State, Store, Wire};
use serde::{Deserialize, Serialize};

use super::pair::{DigestOf, Finding, spread};

/// Format of the stored findings. Its number is raised when the layout or a comparison changes.
const FORMAT: &str = "lightharmony agreement 5";
/// Maximum number of comparisons whose findings are kept for each graph. The oldest are dropped.
const MOST_KEPT: usize = 4096;
/// Maximum number of comparisons of one kind that later runs complete. With more, the findings of a run could drop
/// out of the memory before all are known.
const MOST_COMPLETED: usize = MOST_KEPT / 4;
/// The ids of findings, since stored ids are text.
const IDS: [&str; 5] =
    ["mesh-elsewhere", "mesh-debris", "mesh-incomplete", "splats-before-object", "agreement-unchecked"];

/// The nodes whose results a run computed or found in the cache, with their keys.
#[derive(Debug, Default)]
pub struct Done {
    keys: BTreeMap<String, Digest>,
    /// True if the code of a node ran or failed.
    pub changed: bool,
}

impl Done {
    /// Notes the end of a node.
    pub fn add(&mut self, event: &Event) {
        let Event::Node { id, state, key, .. } = event else { return };
        self.changed |= *state != State::Cached;
        if let (State::Ran | State::Cached, Some(key)) = (state, key) {
            self.keys.insert(id.clone(), *key);
        }
    }

    /// Key of a node. `None` if this run has no result of the node.
    pub fn key(&self, graph: &Graph, node: usize) -> Option<&Digest> {
        self.keys.get(graph.nodes[node].id.as_str())
    }

    /// Digest of all nodes and keys, for a text of a graph.
    fn whole(&self, text: &str) -> Digest {
        let mut key = Key::new("whole");
        key.text(text);
        for (id, digest) in &self.keys {
            key.text(id);
            key.bytes(digest.as_bytes());
        }
        key.digest()
    }
}

/// Digest of everything that the result of a comparison depends on.
pub struct Key(DigestWriter);

impl Key {
    /// A key for one kind of comparison.
    pub fn new(what: &str) -> Self {
        let mut key = Self(DigestWriter::new());
        key.text(what);
        key
    }

    /// Adds bytes with their number.
    pub fn bytes(&mut self, bytes: &[u8]) {
        // Writing to a digest cannot fail.
        let _ = self.0.write_all(&(bytes.len() as u64).to_le_bytes());
        let _ = self.0.write_all(bytes);
    }

    /// Adds a text.
    pub fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    /// Adds a node: its name and its key, which depends on its parameters and inputs. `None` if the run has no
    /// result of the node.
    pub fn node(&mut self, graph: &Graph, node: usize, done: &Done) -> Option<()> {
        let key = done.key(graph, node)?;
        self.text(&graph.nodes[node].id);
        self.bytes(key.as_bytes());
        Some(())
    }

    /// Adds the value of an output. `None` if the run has no such value.
    pub fn value(&mut self, wire: Wire, digest: DigestOf<'_>) -> Option<()> {
        self.bytes(digest(wire)?.as_bytes());
        Some(())
    }

    /// The digest.
    pub fn digest(self) -> Digest {
        self.0.finish()
    }
}

/// The stored findings of a graph.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Stored {
    format: String,
    /// Stamp of the program. Another build may compare in another way.
    program: Vec<u8>,
    /// The findings of each comparison by its key in hexadecimal digits, newest first.
    known: Vec<(String, Vec<(String, String)>)>,
}

/// The remembered findings of one graph.
#[derive(Debug)]
pub struct Memory {
    name: String,
    stored: Stored,
    /// True if the stored bytes are out of date.
    is_new: bool,
    /// True if the findings of a comparison are not known, since a value is not in the cache, or since the run made
    /// the maximum number of comparisons.
    is_incomplete: bool,
}

impl Memory {
    /// Reads the memory of `source` from a store.
    pub fn of_store(store: &Store, source: &Source, root: &SourceRoot) -> Self {
        let name = name(source, root);
        let bytes = store.last_run_get(&name);
        Self::new(name, bytes)
    }

    /// Reads what is remembered in the cache in `folder`, which is not opened.
    pub fn of_folder(folder: &Path, source: &Source, root: &SourceRoot) -> Self {
        let name = name(source, root);
        let bytes = cache::last_run(folder, &name);
        Self::new(name, bytes)
    }

    fn new(name: String, bytes: Option<Vec<u8>>) -> Self {
        let program = std::env::current_exe().ok().and_then(|path| FileStamp::of(&path).ok());
        let program = program.map(|stamp| stamp.to_bytes().to_vec()).unwrap_or_default();
        let stored: Option<Stored> = bytes.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let stored = stored.filter(|stored| stored.format == FORMAT && stored.program == program);
        let stored =
            stored.unwrap_or_else(|| Stored { format: FORMAT.to_owned(), program, known: Vec::new() });
        Self { name, stored, is_new: false, is_incomplete: false }
    }

    /// The remembered findings of a comparison. If nothing is remembered, compares, and remembers the result unless
    /// it is `None`.
    pub fn remembered(
        &mut self,
        key: Digest,
        compare: impl FnOnce() -> Option<Vec<Finding>>,
    ) -> Vec<Finding> {
        if let Some(known) = self.get(&key) {
            return known;
        }
        match compare() {
            Some(found) => {
                self.put(key, &found);
                found
            }
            None => {
                self.is_incomplete = true;
                Vec::new()
            }
        }
    }

    /// The findings of the comparisons with these keys: those that are remembered, and those of at most `most`
    /// other comparisons, spread evenly over the list. `compare` makes the comparison with the given index. An
    /// element is `None` if its comparison was not made because of `most`.
    pub fn each(
        &mut self,
        keys: &[Digest],
        most: usize,
        mut compare: impl FnMut(usize) -> Option<Vec<Finding>>,
    ) -> Vec<Option<Vec<Finding>>> {
        let unknown: Vec<usize> = (0..keys.len()).filter(|&index| self.get(&keys[index]).is_none()).collect();
        let made: BTreeSet<usize> = spread(unknown.len(), most).into_iter().map(|at| unknown[at]).collect();
        // The next run makes further comparisons, even if nothing changes.
        self.is_incomplete |= made.len() < unknown.len() && keys.len() <= MOST_COMPLETED;
        let mut found: Vec<Option<Vec<Finding>>> = keys.iter().map(|key| self.get(key)).collect();
        for index in made {
            found[index] = Some(self.remembered(keys[index], || compare(index)));
        }
        found
    }

    /// Notes that the findings of a comparison are not known, since a value is not in the cache.
    pub fn set_incomplete(&mut self) {
        self.is_incomplete = true;
    }

    /// The findings of a run that changed nothing. `None` if they are not known.
    pub fn of_unchanged(&self, source: &Source, done: &Done) -> Option<Vec<Finding>> {
        self.get(&done.whole(&source.text))
    }

    /// Stores what is new. If this run changed nothing, also stores `found`, its findings, for
    /// [`of_unchanged`](Self::of_unchanged).
    pub fn keep(mut self, store: &Store, source: &Source, done: &Done, found: &[Finding]) {
        if !done.changed && !self.is_incomplete {
            let whole = done.whole(&source.text);
            if self.get(&whole).is_none() {
                self.put(whole, found);
            }
        }
        if self.is_new
            && let Ok(bytes) = serde_json::to_vec(&self.stored)
        {
            store.last_run_put(&self.name, &bytes);
        }
    }

    fn get(&self, key: &Digest) -> Option<Vec<Finding>> {
        let key = key.to_string();
        let (_, found) = self.stored.known.iter().find(|(known, _)| *known == key)?;
        let finding =
            |(id, text): &(String, String)| Some((IDS.into_iter().find(|known| known == id)?, text.clone()));
        found.iter().map(finding).collect()
    }

    fn put(&mut self, key: Digest, found: &[Finding]) {
        let found = found.iter().map(|(id, text)| ((*id).to_owned(), text.clone())).collect();
        self.stored.known.insert(0, (key.to_string(), found));
        self.stored.known.truncate(MOST_KEPT);
        self.is_new = true;
    }
}

/// Name of the stored findings of a graph: its folder and its file.
fn name(source: &Source, root: &SourceRoot) -> String {
    let file = source.name.rsplit('/').next().unwrap_or_default();
    format!("agreement\n{}\n{file}\n", root.folder().display())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(id: &str, state: State, key: &[u8]) -> Event {
        Event::Node {
            id: id.to_owned(),
            kind: "plane",
            state,
            key: Some(Digest::of(key)),
            seconds: 0.0,
            cpu_seconds: 0.0,
            counts: BTreeMap::new(),
            notes: Vec::new(),
            degraded: false,
            error: None,
        }
    }

    /// Findings are remembered for the same keys and the same text, and only a complete run that changed nothing is
    /// remembered as a whole. This test fails if `whole` ignores the keys.
    #[test]
    fn findings_are_those_of_equal_inputs() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let store = Store::open(folder.path(), cache::Options::default()).unwrap_or_else(|e| panic!("{e}"));
        let (source, root) = (Source::new("graph.ron", "one"), SourceRoot::new(folder.path()));
        let of = |state, key: &[u8]| {
            let mut done = Done::default();
            done.add(&node("mesh", state, key));
            done
        };
        let found = vec![("mesh-elsewhere", "text".to_owned())];
        let key = Digest::of(b"pair");
        for (state, incomplete) in [(State::Ran, false), (State::Cached, true), (State::Cached, false)] {
            let mut memory = Memory::of_store(&store, &source, &root);
            let done = of(state, b"a");
            assert_eq!(memory.of_unchanged(&source, &done), None);
            assert_eq!(memory.remembered(key, || Some(found.clone())), found);
            if incomplete {
                assert_eq!(memory.remembered(Digest::of(b"other"), || None), []);
            }
            memory.keep(&store, &source, &done, &found);
        }
        let mut memory = Memory::of_folder(folder.path(), &source, &root);
        assert_eq!(memory.remembered(key, || panic!("known")), found);
        assert_eq!(memory.of_unchanged(&source, &of(State::Cached, b"a")), Some(found));
        assert_eq!(memory.of_unchanged(&source, &of(State::Cached, b"b")), None);
        assert_eq!(memory.of_unchanged(&Source::new("graph.ron", "two"), &of(State::Cached, b"a")), None);
    }

    /// A run makes a limited number of new comparisons, and the next runs make the others. This test fails if
    /// remembered comparisons count.
    #[test]
    fn new_comparisons_are_limited() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let store = Store::open(folder.path(), cache::Options::default()).unwrap_or_else(|e| panic!("{e}"));
        let (source, root) = (Source::new("graph.ron", "one"), SourceRoot::new(folder.path()));
        let keys: Vec<Digest> = (0..6_u8).map(|i| Digest::of(&[i])).collect();
        for wanted in [[0, 3, 5].as_slice(), &[1, 2, 4], &[]] {
            let mut memory = Memory::of_store(&store, &source, &root);
            let mut compared = Vec::new();
            let found = memory.each(&keys, 3, |index| {
                compared.push(index);
                Some(vec![("mesh-debris", index.to_string())])
            });
            assert_eq!(compared, wanted);
            let known = found.iter().flatten().count();
            assert_eq!(
                (known, memory.is_incomplete),
                if wanted == [0, 3, 5] { (3, true) } else { (6, false) }
            );
            for (index, found) in found.iter().enumerate() {
                assert!(found.as_ref().is_none_or(|found| found[0].1 == index.to_string()));
            }
            memory.keep(&store, &source, &Done::default(), &[]);
        }
    }

    /// A node that failed has no result.
    #[test]
    fn failed_nodes_are_not_done() {
        let mut done = Done::default();
        done.add(&node("mesh", State::Failed, b"a"));
        assert!(done.changed && done.keys.is_empty());
    }
}
