//! The history of one graph: the changes of its text, made by the page or by other programs, so that they can be
//! undone, and the results of earlier texts.
//!
//! The history is a file of JSON lines, to which lines are appended. The first line is a text; the next lines are
//! changes of this text. If a line is incomplete, for instance after a power failure, that line and all lines after
//! it are ignored, and the file is written again. If the file cannot be written, the history is kept in memory and
//! this is reported.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use cache::Digest;
use serde::{Deserialize, Serialize};

/// Maximum number of changes that can be undone.
const MOST_CHANGES: usize = 1000;
/// Maximum total length of the texts of these changes, in bytes. The newest change is kept in any case.
const MOST_BYTES: usize = 16 << 20;
/// Maximum number of earlier results.
const MOST_SHOTS: usize = 50;
/// If the length of the file reaches this number of bytes, the file is written again without changes and results
/// that are no longer needed.
const COMPACT: u64 = 32 << 20;

/// A change of the text.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Change {
    /// Byte offset at which the texts begin to differ.
    pub start: usize,
    /// The old text.
    pub removed: String,
    /// The new text.
    pub added: String,
    /// Description for the user, such as `pose.yaw_deg = 30.0`.
    pub label: String,
    /// Time in seconds since 1970.
    pub seconds: u64,
}

impl Change {
    /// The change between two texts.
    pub fn between(old: &str, new: &str, label: String) -> Self {
        let common = |mut pairs: Box<dyn Iterator<Item = (u8, u8)> + '_>| {
            let mut count = 0;
            while pairs.next().is_some_and(|(a, b)| a == b) {
                count += 1;
            }
            count
        };
        let start = old.floor_char_boundary(common(Box::new(old.bytes().zip(new.bytes()))));
        let start = if new.is_char_boundary(start) { start } else { new.floor_char_boundary(start) };
        let rest = (&old[start..], &new[start..]);
        let mut end = common(Box::new(rest.0.bytes().rev().zip(rest.1.bytes().rev())));
        while !rest.0.is_char_boundary(rest.0.len() - end) {
            end -= 1;
        }
        Self {
            start,
            removed: rest.0[..rest.0.len() - end].to_owned(),
            added: rest.1[..rest.1.len() - end].to_owned(),
            label,
            seconds: now(),
        }
    }

    fn bytes(&self) -> usize {
        self.removed.len() + self.added.len()
    }

    /// Applies the change to `text`; `None` if `text` is not the text before the change.
    pub fn redo(&self, text: &str) -> Option<String> {
        replaced(text, self.start, &self.removed, &self.added)
    }

    /// Removes the change from `text`; `None` if `text` is not the text after the change.
    pub fn undo(&self, text: &str) -> Option<String> {
        replaced(text, self.start, &self.added, &self.removed)
    }
}

fn replaced(text: &str, start: usize, old: &str, new: &str) -> Option<String> {
    let (before, rest) = text.split_at_checked(start)?;
    let after = rest.strip_prefix(old)?;
    Some([before, new, after].concat())
}

/// The results of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shot {
    /// Digest of the text that was run.
    pub text: String,
    /// Description of the change that led to this text.
    pub label: String,
    /// Time in seconds since 1970.
    pub seconds: u64,
    /// Type and digest of each value that can be shown, by the name of its output, such as `final.image`.
    pub values: BTreeMap<String, (String, String)>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Line {
    /// The first line: the text before all changes.
    Text(String),
    Change(Change),
    Undo,
    Redo,
    Shot(Shot),
}

/// The history of one graph.
pub struct History {
    file: Option<PathBuf>,
    /// The reason why the history is only in memory.
    problem: Option<String>,
    text: String,
    changes: Vec<Change>,
    /// Number of changes that are in effect; the changes after them were undone.
    done: usize,
    shots: Vec<Shot>,
}

impl History {
    /// Opens the history in `file`. If the last text in the history is not `text`, another program has changed the
    /// graph, and this change is added to the history.
    pub fn open(file: Option<PathBuf>, text: &str) -> Self {
        let stored = file.as_deref().and_then(|file| fs::read(file).ok());
        let (text, file, whole) = (text.to_owned(), file, true);
        let mut history =
            Self { file, problem: None, text: text.clone(), changes: Vec::new(), done: 0, shots: Vec::new() };
        let stored = stored.unwrap_or_default();
        if history.replay(&stored) != whole || stored.len() as u64 > COMPACT || stored.is_empty() {
            if stored.is_empty() {
                history.text.clone_from(&text);
            }
            history.write_all();
        }
        history.saved(&text, "change by another program");
        history
    }

    /// Applies stored lines. Returns false if one of them is incomplete.
    fn replay(&mut self, stored: &[u8]) -> bool {
        let mut lines = stored.split_inclusive(|byte| *byte == b'\n');
        let line =
            |bytes: &[u8]| bytes.strip_suffix(b"\n").and_then(|line| serde_json::from_slice(line).ok());
        match lines.next().and_then(line) {
            Some(Line::Text(text)) => self.text = text,
            _ => return false,
        }
        for bytes in lines {
            let good = match line(bytes) {
                Some(Line::Change(change)) => self.push(change),
                Some(Line::Undo) => self.step(false).is_some(),
                Some(Line::Redo) => self.step(true).is_some(),
                Some(Line::Shot(shot)) => {
                    self.add(shot);
                    true
                }
                Some(Line::Text(_)) | None => false,
            };
            if !good {
                return false;
            }
        }
        true
    }

    /// The current text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The reason why the history is only in memory; `None` if it is in a file.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    /// The change that `undo` would undo.
    pub fn last(&self) -> Option<&Change> {
        self.done.checked_sub(1).map(|last| &self.changes[last])
    }

    /// The change that `redo` would repeat.
    pub fn next(&self) -> Option<&Change> {
        self.changes.get(self.done)
    }

    /// The number of changes that can be undone, and the number of changes that can be redone.
    pub fn depth(&self) -> (usize, usize) {
        (self.done, self.changes.len() - self.done)
    }

    /// The results of earlier runs, the oldest first.
    pub fn shots(&self) -> &[Shot] {
        &self.shots
    }

    /// Records that the graph has the text `text`, if this is not the current text.
    pub fn saved(&mut self, text: &str, label: &str) {
        if self.text != text {
            let change = Change::between(&self.text, text, label.to_owned());
            if self.push(change.clone()) {
                self.append(&Line::Change(change));
            }
        }
    }

    /// The text after undoing the last change; `None` if there is nothing to undo.
    pub fn undone(&self) -> Option<String> {
        self.last()?.undo(&self.text)
    }

    /// The text after redoing the next change; `None` if there is nothing to redo.
    pub fn redone(&self) -> Option<String> {
        self.next()?.redo(&self.text)
    }

    /// Records that the last change was undone.
    pub fn undo(&mut self) {
        if self.step(false).is_some() {
            self.append(&Line::Undo);
        }
    }

    /// Records that the next change was redone.
    pub fn redo(&mut self) {
        if self.step(true).is_some() {
            self.append(&Line::Redo);
        }
    }

    /// Records the results of a run, unless they equal the last recorded ones.
    pub fn shot(&mut self, shot: Shot) -> bool {
        let new = self.shots.last().is_none_or(|last| last.values != shot.values) && !shot.values.is_empty();
        if new {
            self.append(&Line::Shot(shot.clone()));
            self.add(shot);
        }
        new
    }

    fn add(&mut self, shot: Shot) {
        self.shots.push(shot);
        let surplus = self.shots.len().saturating_sub(MOST_SHOTS);
        self.shots.drain(..surplus);
    }

    fn step(&mut self, forwards: bool) -> Option<()> {
        (self.text, self.done) =
            if forwards { (self.redone()?, self.done + 1) } else { (self.undone()?, self.done - 1) };
        Some(())
    }

    fn push(&mut self, change: Change) -> bool {
        let Some(text) = change.redo(&self.text) else { return false };
        self.changes.truncate(self.done);
        self.changes.push(change);
        self.text = text;
        let mut bytes: usize = self.changes.iter().map(Change::bytes).sum();
        while self.changes.len() > 1 && (self.changes.len() > MOST_CHANGES || bytes > MOST_BYTES) {
            bytes -= self.changes.remove(0).bytes();
        }
        self.done = self.changes.len();
        true
    }

    fn append(&mut self, line: &Line) {
        let Some(path) = self.file.clone().filter(|_| self.problem.is_none()) else { return };
        let written = json(line).and_then(|line| {
            let mut file = private(OpenOptions::new().append(true)).open(&path)?;
            file.write_all(&line)?;
            Ok(file.metadata()?.len())
        });
        match written {
            Ok(length) if length > COMPACT => self.write_all(),
            Ok(_) => {}
            // The file may have been deleted together with the cache.
            Err(error) if error.kind() == io::ErrorKind::NotFound => self.write_all(),
            Err(error) => self.report(&path, &error),
        }
    }

    /// Writes the whole file.
    fn write_all(&mut self) {
        let Some(path) = self.file.clone() else { return };
        let mut base = self.text.clone();
        for change in self.changes[..self.done].iter().rev() {
            // Each change was applied to this text.
            base = change.undo(&base).unwrap_or(base);
        }
        let undone = self.changes.len() - self.done;
        let changes = self.changes.iter().cloned().map(Line::Change);
        let undos = std::iter::repeat_with(|| Line::Undo).take(undone);
        let shots = self.shots.iter().cloned().map(Line::Shot);
        let lines = std::iter::once(Line::Text(base)).chain(changes).chain(undos).chain(shots);
        let written = lines
            .map(|line| json(&line))
            .collect::<io::Result<Vec<_>>>()
            .and_then(|lines| write_private(&path, &lines.concat()));
        match written {
            Ok(()) => self.problem = None,
            Err(error) => self.report(&path, &error),
        }
    }

    fn report(&mut self, path: &Path, error: &io::Error) {
        self.problem =
            Some(format!("the history of edits cannot be written to `{}`: {error}", path.display()));
    }
}

fn json(line: &Line) -> io::Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec(line)?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// Options for a file that only its owner may read.
fn private(options: &mut OpenOptions) -> &mut OpenOptions {
    // Windows has no permission bits; a new file inherits the access list of its folder.
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.mode(0o600);
    }
    options
}

/// Writes a file that only its owner may read. If this fails, an existing file is unchanged.
pub fn write_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let temp = path.with_extension("new");
    let _ = fs::remove_file(&temp);
    private(OpenOptions::new().write(true).create_new(true)).open(&temp)?.write_all(bytes)?;
    fs::rename(&temp, path)
}

/// The time in seconds since 1970.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

/// File name for the data of one graph in a folder that all graphs share. It depends on the path of the graph.
pub fn name_of(graph: &Path) -> String {
    Digest::of(graph.as_os_str().as_encoded_bytes()).to_string()[..32].to_owned()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn shot(text: &str) -> Shot {
        let values = BTreeMap::from([("a.image".to_owned(), ("image".to_owned(), text.to_owned()))]);
        Shot { text: text.to_owned(), label: String::new(), seconds: 1, values }
    }

    #[test]
    fn a_history_survives_restarts_and_notices_other_programs() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pages/a.jsonl");
        let open = |text: &str| History::open(Some(file.clone()), text);
        let mut history = open("a1");
        assert_eq!((history.depth(), history.undone()), ((0, 0), None));
        history.saved("a2", "two");
        history.saved("a3", "three");
        history.undo();
        assert!(history.shot(shot("x")) && !history.shot(shot("x")));
        let history = open("a2");
        assert_eq!((history.depth(), history.redone().as_deref()), ((1, 1), Some("a3")));
        assert_eq!(history.shots(), [shot("x")]);
        let mut history = open("ä2");
        assert_eq!(history.last().map(|change| change.label.as_str()), Some("change by another program"));
        assert_eq!(history.depth(), (2, 0), "what was undone is gone");
        for text in ["a2", "a1"] {
            assert_eq!(history.undone().as_deref(), Some(text));
            history.undo();
        }
        assert_eq!(history.undone(), None);
        assert_eq!(history.problem(), None);
    }

    #[test]
    fn a_line_cut_off_ends_the_history_and_nothing_else_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.jsonl");
        let mut history = History::open(Some(file.clone()), "a1");
        history.saved("a2", "two");
        history.saved("a3", "three");
        let whole = fs::read(&file).unwrap();
        for cut in 0..whole.len() {
            fs::write(&file, &whole[..cut]).unwrap();
            let mut history = History::open(Some(file.clone()), "a3");
            assert_eq!(history.text(), "a3");
            while history.undone().is_some() {
                history.undo();
            }
            let again = History::open(Some(file.clone()), history.text());
            assert_eq!(again.depth(), (0, history.depth().1), "the file was repaired at {cut}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn the_file_is_private_and_a_full_disk_is_reported() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.jsonl");
        let mut history = History::open(Some(file.clone()), "a1");
        history.saved("a2", "two");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let mut history = History::open(Some("/dev/full/a.jsonl".into()), "a1");
        history.saved("a2", "two");
        assert!(history.problem().is_some_and(|why| why.contains("/dev/full/a.jsonl")));
        assert_eq!(history.undone().as_deref(), Some("a1"), "it is still in memory");
    }

    #[test]
    fn old_changes_make_room() {
        let mut history = History::open(None, "0");
        (1..=MOST_CHANGES + 5).for_each(|n| history.saved(&n.to_string(), ""));
        assert_eq!(history.depth(), (MOST_CHANGES, 0));
        let long = "x".repeat(MOST_BYTES);
        history.saved(&long, "");
        assert_eq!(history.depth(), (1, 0));
        assert_eq!(history.undone(), Some((MOST_CHANGES + 5).to_string()));
    }

    proptest! {
        #[test]
        fn a_change_leads_from_one_text_to_the_other_and_back(old in "[aäß€😀\r\n]{0,12}", new in "[aäß€😀\r\n]{0,12}") {
            let change = Change::between(&old, &new, String::new());
            prop_assert_eq!(change.redo(&old), Some(new.clone()));
            prop_assert_eq!(change.undo(&new), Some(old));
        }
    }
}
