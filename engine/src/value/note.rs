//! Notes of a node. They are part of its result: stored with it and reported again on every cache hit.

use serde::{Deserialize, Serialize};

/// Severity of a note.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// A number of affected items, such as broken rows that were dropped.
    Count,
    /// A choice that the node made because neither the graph nor a file determines it, such as the unit of length
    /// of a file that does not state its unit.
    Decision,
    /// The result is valid, but the user should check the point that the note describes.
    Warning,
    /// The result is worse than what the graph asks for. All results made from it are degraded too, and the exit
    /// code reports this.
    Degraded,
}

/// A note of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// Severity of the note.
    pub level: Level,
    /// Stable name in kebab-case, such as `zero-quaternion`, for tests and filters.
    pub id: String,
    /// Text in one line.
    pub text: String,
}

/// The notes of one run of a node, in order.
///
/// ```
/// use engine::{Level, Notes};
///
/// let mut notes = Notes::none();
/// notes.count("dark-pixels", 3, "of the pixels are black and have no direction");
/// notes.count("bright-pixels", 0, "of the pixels are clipped"); // Adds nothing.
/// notes.decision("unit", "the file states no unit, so metres are used");
/// assert!(!notes.is_degraded());
/// notes.degraded("few-views", "only 2 of the 8 views could be read");
///
/// let listed: Vec<(Level, &str)> = notes.iter().map(|note| (note.level, note.id.as_str())).collect();
/// assert_eq!(listed, [(Level::Count, "dark-pixels"), (Level::Decision, "unit"), (Level::Degraded, "few-views")]);
/// assert!(notes.is_degraded());
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notes(Vec<Note>);

impl FromIterator<Note> for Notes {
    fn from_iter<T: IntoIterator<Item = Note>>(notes: T) -> Self {
        Self(notes.into_iter().collect())
    }
}

impl Notes {
    /// No notes.
    pub fn none() -> Self {
        Self::default()
    }

    pub(crate) fn push(&mut self, level: Level, id: &str, text: String) {
        self.0.push(Note { level, id: id.to_owned(), text });
    }

    /// Adds a warning.
    pub fn warning(&mut self, id: &str, text: impl Into<String>) {
        self.push(Level::Warning, id, text.into());
    }

    /// Marks the result, and everything made from it, as degraded.
    pub fn degraded(&mut self, id: &str, text: impl Into<String>) {
        self.push(Level::Degraded, id, text.into());
    }

    /// Adds a choice that the node made.
    pub fn decision(&mut self, id: &str, text: impl Into<String>) {
        self.push(Level::Decision, id, text.into());
    }

    /// Adds a note with the text `n` followed by `of`, such as `3 of the rows had to be dropped`.
    /// Adds nothing if `n` is 0.
    pub fn count(&mut self, id: &str, n: u64, of: impl std::fmt::Display) {
        if n > 0 {
            self.push(Level::Count, id, format!("{n} {of}"));
        }
    }

    /// The notes in order.
    pub fn iter(&self) -> impl Iterator<Item = &Note> {
        self.0.iter()
    }

    /// True if a note marks the result as degraded.
    pub fn is_degraded(&self) -> bool {
        self.0.iter().any(|note| note.level == Level::Degraded)
    }
}
