//! [`publish_file`]: writes a user's file completely or not at all.

use std::fs;
use std::io::Write;
use std::path::Path;

use crate::error::{At, Error, Result};
use crate::failpoint::{PUBLISH, PUBLISH_SYNCED, reach};
use crate::temp::{TempFile, remove_stale_files, sync_folder};

/// Writes `bytes` to `path` through a temporary file in the same folder, so that at any moment the file has either
/// its old content or all of the new content. The folder is created if necessary. Once this function returns, the
/// new content survives a loss of power. A symbolic link at `path` is replaced, not followed.
///
/// # Errors
/// [`Error::NotAFile`] if the path is a folder, a device or a pipe; [`Error::Full`] or [`Error::Io`] for other
/// errors. After an error, no temporary file remains.
pub fn publish_file(path: &Path, bytes: &[u8]) -> Result<()> {
    publish_through(path, |to| to.write_all(bytes).at("write", path))
}

/// Like [`publish_file`], for content that is produced in pieces. `write` receives a writer for the temporary file.
/// If `write` fails, the file at `path` is unchanged.
///
/// # Errors
/// The errors of `write` and of [`publish_file`].
pub fn publish_through<E: From<Error>>(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    if fs::symlink_metadata(path).is_ok_and(|found| !found.is_file() && !found.is_symlink()) {
        return Err(Error::NotAFile { path: path.to_path_buf() }.into());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut temp = TempFile::create(folder, &PUBLISH)?;
    write(&mut temp)?;
    // Without this a loss of power after the rename may leave an empty file.
    temp.sync()?;
    temp.persist(path)?;
    // Without this, a loss of power may leave the old file or no file.
    sync_folder(folder);
    reach(PUBLISH_SYNCED).at("sync", path)?;
    remove_stale_files(folder);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_whole_files_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/picture.png");
        publish_file(&path, b"first").unwrap();
        publish_file(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);

        let error = publish_file(path.parent().unwrap(), b"over a folder").unwrap_err();
        assert!(matches!(error, Error::NotAFile { .. }), "{error}");
        let error = publish_file(&path.join("below"), b"below a file").unwrap_err();
        assert!(error.to_string().contains("picture.png"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn a_published_file_has_the_usual_permissions() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, usual) = (folder.path().join("ours"), folder.path().join("usual"));
        publish_file(&ours, b"x").unwrap();
        fs::write(&usual, b"x").unwrap();
        let mode = |path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&usual));
    }
}
