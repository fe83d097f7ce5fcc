//! [`TempFolder`]: a folder under a temporary name, removed when it is dropped.

use std::fs::{self, DirBuilder, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::{At, Result};
use crate::temp::remove_stale;

/// The suffix of the name of every temporary folder.
const SUFFIX: &str = ".lightharmony-folder";

/// A folder that is removed, with everything in it, when this value is dropped.
///
/// The folder is locked while it is in use. Creating a temporary folder removes all unlocked temporary folders in
/// the same parent, since killed processes left them.
pub struct TempFolder {
    path: PathBuf,
    /// The open and locked folder; `None` on systems that cannot open folders.
    _held: Option<File>,
}

impl TempFolder {
    /// Creates a folder in `parent`. If the caller renames the folder, it is not removed.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn create_in(parent: &Path) -> Result<Self> {
        Self::create(parent, &DirBuilder::new())
    }

    /// Creates a folder in the system's temporary folder. On systems with permissions, only its owner can read it.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn private() -> Result<Self> {
        let mut builder = DirBuilder::new();
        // Windows has no permission bits; its temporary folder belongs to the user.
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
        Self::create(&std::env::temp_dir(), &builder)
    }

    /// The path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn create(parent: &Path, builder: &DirBuilder) -> Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        remove_stale_folders(parent);
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = parent.join(format!(".{}-{count}{SUFFIX}", std::process::id()));
            match builder.create(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                result => {
                    result.at("create", &path)?;
                    // Where folders cannot be locked, no process removes stale ones either.
                    let held = File::open(&path).ok().filter(|folder| folder.try_lock().is_ok());
                    return Ok(Self { path, _held: held });
                }
            }
        }
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        // If it was renamed, there is nothing to remove.
        let _ = fs::remove_dir_all(&self.path);
    }
}

/// Removes the temporary folders in `parent` that killed processes left.
fn remove_stale_folders(parent: &Path) {
    let unlocked = |path: &Path| File::open(path).is_ok_and(|folder| folder.try_lock().is_ok());
    remove_stale(parent, SUFFIX, |path, found| {
        found.is_dir() && unlocked(path) && fs::remove_dir_all(path).is_ok()
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::temp::age_all;

    #[test]
    fn the_next_one_removes_stale_folders() {
        let parent = tempfile::tempdir().unwrap();
        let live = TempFolder::create_in(parent.path()).unwrap();
        let stale = parent.path().join(format!(".1-1{SUFFIX}"));
        fs::create_dir_all(stale.join("deep")).unwrap();
        fs::write(stale.join("deep/half"), b"half").unwrap();
        drop(TempFolder::create_in(parent.path()).unwrap());
        assert!(stale.exists(), "too young to be stale");
        age_all(parent.path());
        drop(TempFolder::create_in(parent.path()).unwrap());
        assert!(!stale.exists() && live.path().exists());
        let target = parent.path().join("target");
        fs::rename(live.path(), &target).unwrap();
        drop(live);
        assert!(target.exists(), "renamed, it stays");
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
    }
}
