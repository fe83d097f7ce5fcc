//! Output files: which sink writes which file, and which files no sink may write.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::graph::reads::ReadFiles;

/// The output files of a run.
#[derive(Default)]
pub(crate) struct Claims {
    /// For each file, the index of the sink that writes it.
    writers: BTreeMap<PathBuf, usize>,
    /// Files that no sink may overwrite.
    read: OnceCell<ReadFiles>,
}

impl Claims {
    /// Claims a path for a sink. If another sink has claimed it already, returns both sinks in the order of the
    /// graph file, so that the error does not depend on the order in which the sinks run.
    pub fn claim(&mut self, path: &Path, index: usize) -> Option<[usize; 2]> {
        let other = self.writers.insert(path.to_owned(), index).filter(|&other| other != index)?;
        let (first, second) = (other.min(index), other.max(index));
        self.writers.insert(path.to_owned(), first);
        Some([first, second])
    }

    /// Files that no sink may overwrite. `files`, which inspects every file, is called only the first time.
    pub fn read(&self, files: impl FnOnce() -> ReadFiles) -> &ReadFiles {
        self.read.get_or_init(files)
    }
}
