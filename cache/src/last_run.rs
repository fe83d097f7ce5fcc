//! Stored results of all lookups of a graph's last run, in one file per graph. The next run of the graph reads this
//! file instead of searching for each record.
//!
//! The file only saves time. If it is missing or damaged, or belongs to another run, it is ignored. Every
//! collection and every repair removes all of these files, so that they never name a record that was removed.

use std::fs;
use std::path::{Path, PathBuf};

use crate::digest::Digest;
use crate::failpoint::INDEX;
use crate::history::Table;
use crate::obstacle::clear_folder;
use crate::regular;
use crate::settings::FORMAT;
use crate::store::Store;
use crate::temp::TempFile;

/// Name of the folder that contains these files. It lies in the folder [`FORMAT`].
pub(crate) const FOLDER: &str = "last";

impl Store {
    /// Stores `bytes` as the lookups of the last run of `graph`, replacing the previous ones. Errors are ignored.
    pub fn last_run_put(&self, graph: &str, bytes: &[u8]) {
        let Some((folder, path)) = self.folder().zip(self.last_run_path(graph)) else { return };
        if self.is_read_only() {
            return;
        }
        clear_folder(folder, &path);
        let _ = TempFile::create(&folder.join("temp"), &INDEX).and_then(|mut file| {
            file.write(bytes)?;
            file.write(Digest::of(bytes).as_bytes())?;
            file.persist(&path)
        });
    }

    /// The bytes last stored for `graph` by [`last_run_put`](Self::last_run_put), verified by their digest.
    pub fn last_run_get(&self, graph: &str) -> Option<Vec<u8>> {
        read(&self.last_run_path(graph)?)
    }

    /// Removes the stored lookups of all graphs.
    pub(crate) fn forget_last_runs(&self) {
        if let Some(folder) = self.folder().filter(|_| !self.is_read_only()) {
            let _ = fs::remove_dir_all(folder.join(FOLDER));
        }
    }

    fn last_run_path(&self, graph: &str) -> Option<PathBuf> {
        Some(path(self.folder()?, graph))
    }
}

/// Like [`Store::last_run_get`], but for the cache in `folder`, which is not opened.
pub fn last_run(folder: &Path, graph: &str) -> Option<Vec<u8>> {
    read(&path(&folder.join(FORMAT), graph))
}

fn path(root: &Path, graph: &str) -> PathBuf {
    root.join(FOLDER).join(Table::key(graph).to_string())
}

fn read(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = regular::read(path).ok()?;
    let digest = *bytes.last_chunk::<32>()?;
    bytes.truncate(bytes.len() - digest.len());
    (Digest::of(&bytes).as_bytes() == &digest).then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Options;

    #[test]
    fn the_last_one_is_returned_and_a_damaged_one_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), Options::default()).unwrap();
        assert_eq!(store.last_run_get("graph"), None);
        store.last_run_put("graph", b"one");
        store.last_run_put("graph", b"");
        store.last_run_put("other", b"two");
        assert_eq!(store.last_run_get("graph").as_deref(), Some(&b""[..]));
        assert_eq!(last_run(folder.path(), "other").as_deref(), Some(&b"two"[..]));
        assert_eq!(store.last_run_get("other").as_deref(), Some(&b"two"[..]));
        let path = store.last_run_path("other").unwrap();
        let good = fs::read(&path).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1;
            fs::write(&path, &bad).unwrap();
            assert_eq!(store.last_run_get("other"), None, "byte {at}");
            fs::write(&path, &good[..at]).unwrap();
            assert_eq!(store.last_run_get("other"), None, "cut at {at}");
        }
        fs::write(&path, &good).unwrap();
        store.forget_last_runs();
        assert_eq!(store.last_run_get("other"), None);
    }
}
