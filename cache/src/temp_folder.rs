//! [`TempFolder`]: a folder under a passing name, which goes when its owner does.

use std::fs::{self, DirBuilder, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::{At, Result};
use crate::temp::remove_stale;

/// How every passing folder ends.
const SUFFIX: &str = ".lightharmony-folder";

/// A folder that is removed in the end, with all that is in it.
///
/// It is locked as long as it is used, so that the next one made beside it knows and removes those that killed
/// processes left.
pub struct TempFolder {
    path: PathBuf,
    /// The folder itself; `None` where the system opens none.
    _held: Option<File>,
}

impl TempFolder {
    /// A folder in `parent`, which may be renamed to what it is for.
    ///
    /// # Errors
    /// What the system says.
    pub fn create_in(parent: &Path) -> Result<Self> {
        Self::create(parent, &DirBuilder::new())
    }

    /// A folder among those of the system that are for passing files, into which others on the machine cannot look,
    /// where that is possible.
    ///
    /// # Errors
    /// What the system says.
    pub fn private() -> Result<Self> {
        let mut builder = DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
        Self::create(&std::env::temp_dir(), &builder)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn create(parent: &Path, builder: &DirBuilder) -> Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        sweep(parent);
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = parent.join(format!(".{}-{count}{SUFFIX}", std::process::id()));
            match builder.create(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                result => {
                    result.at("create", &path)?;
                    // Where there are no locks on folders nobody sweeps either.
                    let held = File::open(&path).ok().filter(|folder| folder.try_lock().is_ok());
                    return Ok(Self { path, _held: held });
                }
            }
        }
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        // Renamed, it is no longer there.
        let _ = fs::remove_dir_all(&self.path);
    }
}

/// Removes what killed processes left in a folder.
fn sweep(parent: &Path) {
    let nobodys = |path: &Path| File::open(path).is_ok_and(|folder| folder.try_lock().is_ok());
    remove_stale(parent, SUFFIX, |path, found| {
        found.is_dir() && nobodys(path) && fs::remove_dir_all(path).is_ok()
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::temp::age_all;

    #[test]
    fn the_next_one_removes_what_the_dead_left() {
        let parent = tempfile::tempdir().unwrap();
        let living = TempFolder::create_in(parent.path()).unwrap();
        let dead = parent.path().join(format!(".1-1{SUFFIX}"));
        fs::create_dir_all(dead.join("deep")).unwrap();
        fs::write(dead.join("deep/half"), b"half").unwrap();
        drop(TempFolder::create_in(parent.path()).unwrap());
        assert!(dead.exists(), "too young to be sure");
        age_all(parent.path());
        drop(TempFolder::create_in(parent.path()).unwrap());
        assert!(!dead.exists() && living.path().exists());
        let target = parent.path().join("target");
        fs::rename(living.path(), &target).unwrap();
        drop(living);
        assert!(target.exists(), "renamed, it stays");
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
    }
}
