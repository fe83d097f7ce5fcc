//! What the last run of a graph looked up, in one file: the next one reads it at once, where records would cost a
//! search each.
//!
//! It only saves time. A file that is missing, damaged, or of another run is as good as none, and every collection
//! and repair removes them all, so that nothing is found in one that is gone from the records.

use std::fs;
use std::path::{Path, PathBuf};

use crate::digest::Digest;
use crate::failpoint::INDEX;
use crate::history::Book;
use crate::store::{FORMAT, Store};
use crate::temp::TempFile;

/// The folder of these files.
pub(crate) const FOLDER: &str = "last";

impl Store {
    /// Keeps what the last run of a graph looked up, in place of what was kept before. Losing it is allowed.
    pub fn last_run_put(&self, book: &str, bytes: &[u8]) {
        let Some((folder, path)) = self.folder().zip(self.last_run_path(book)) else { return };
        if self.is_read_only() {
            return;
        }
        let _ = TempFile::create(&folder.join("temp"), &INDEX).and_then(|mut file| {
            file.write(bytes)?;
            file.write(Digest::of(bytes).as_bytes())?;
            file.persist(&path)
        });
    }

    /// What was last kept by [`last_run_put`](Self::last_run_put), whole and verified.
    pub fn last_run_get(&self, book: &str) -> Option<Vec<u8>> {
        read(&self.last_run_path(book)?)
    }

    /// Forgets all of them.
    pub(crate) fn forget_last_runs(&self) {
        if let Some(folder) = self.folder().filter(|_| !self.is_read_only()) {
            let _ = fs::remove_dir_all(folder.join(FOLDER));
        }
    }

    fn last_run_path(&self, book: &str) -> Option<PathBuf> {
        Some(path(self.folder()?, book))
    }
}

/// [`Store::last_run_get`] of the cache in `folder`, which is not opened for that.
pub fn last_run(folder: &Path, book: &str) -> Option<Vec<u8>> {
    read(&path(&folder.join(FORMAT), book))
}

fn path(root: &Path, book: &str) -> PathBuf {
    root.join(FOLDER).join(Book::key(book).to_string())
}

fn read(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = fs::read(path).ok()?;
    let digest = *bytes.last_chunk::<32>()?;
    bytes.truncate(bytes.len() - digest.len());
    (Digest::of(&bytes).as_bytes() == &digest).then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Options;

    #[test]
    fn the_last_one_counts_and_a_damaged_one_is_none() {
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
