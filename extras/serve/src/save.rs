//! Atomic replacement of the text of a graph file.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// The end of the name of a temporary file; the cache removes old files of this form.
const SUFFIX: &str = ".lightharmony-temp";

/// A reason why a file was not replaced. The file is unchanged.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The file no longer has the expected text.
    #[error("another program saved the file in the meantime")]
    Changed,
    /// The file was deleted.
    #[error("the file was deleted or moved")]
    Gone,
    /// The disk is full, or the user's quota is used up.
    #[error("the disk is full")]
    Full,
    /// Any other error of the system.
    #[error("{0}")]
    System(io::Error),
}

impl From<io::Error> for SaveError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::NotFound => Self::Gone,
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
                Self::Full
            }
            _ => Self::System(error),
        }
    }
}

/// Replaces the text `expected` of a file with `text`, by renaming a temporary file in the same folder. If the path
/// is a symbolic link, the target of the link is replaced. The file keeps its permissions.
///
/// # Errors
/// [`SaveError`]. The file then has its old content.
pub fn replace(path: &Path, expected: &str, text: &str) -> Result<(), SaveError> {
    let path = path.canonicalize()?;
    let temp = TempFile::create(&path)?;
    temp.fill(&path, text)?;
    // Between this comparison and the renaming, a save by another program would be lost; both take microseconds.
    if fs::read(&path)? != expected.as_bytes() {
        return Err(SaveError::Changed);
    }
    fs::rename(&temp.0, &path)?;
    std::mem::forget(temp);
    Ok(())
}

/// A file that is removed when this value is dropped.
struct TempFile(PathBuf);

impl TempFile {
    fn create(target: &Path) -> io::Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let folder = target.parent().unwrap_or(Path::new("/"));
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".{}-serve-{count}{SUFFIX}", std::process::id()));
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(_) => return Ok(Self(path)),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Gives the file the permissions of `target`, and then writes `text` to it.
    fn fill(&self, target: &Path, text: &str) -> io::Result<()> {
        fs::set_permissions(&self.0, fs::metadata(target)?.permissions())?;
        let mut file = OpenOptions::new().write(true).open(&self.0)?;
        file.write_all(text.as_bytes())?;
        file.sync_data()
    }
}

impl Drop for TempFile {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_replaced_only_if_it_is_the_expected_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("graph.ron");
        fs::write(&path, "old").unwrap();
        replace(&path, "old", "new").unwrap();
        assert!(matches!(replace(&path, "old", "newer"), Err(SaveError::Changed)));
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        fs::remove_file(&path).unwrap();
        assert!(matches!(replace(&path, "new", "x"), Err(SaveError::Gone)));
    }

    #[cfg(unix)]
    #[test]
    fn links_and_permissions_stay() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("graph.ron"), folder.path().join("link.ron"));
        fs::write(&path, "old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        replace(&link, "old", "new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }
}
