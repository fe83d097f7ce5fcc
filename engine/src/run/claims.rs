//! The files that sinks write, and those that no sink may write over.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::graph::reads::ReadFiles;

/// The files that sinks write, and those that they must not.
#[derive(Default)]
pub(crate) struct Claims {
    /// Which sink writes a file.
    writers: BTreeMap<PathBuf, usize>,
    /// What no sink may write over.
    read: OnceCell<ReadFiles>,
}

impl Claims {
    /// Claims a path for a sink. Gives both sinks where another has it already, by their order in the file: whichever
    /// comes first while they run, the later one in the file is in the wrong.
    pub fn claim(&mut self, path: &Path, index: usize) -> Option<[usize; 2]> {
        let other = self.writers.insert(path.to_owned(), index).filter(|&other| other != index)?;
        let (first, second) = (other.min(index), other.max(index));
        self.writers.insert(path.to_owned(), first);
        Some([first, second])
    }

    /// What no sink may write over; looked for once, since it takes a look at every file.
    pub fn read(&self, files: impl FnOnce() -> ReadFiles) -> &ReadFiles {
        self.read.get_or_init(files)
    }
}
