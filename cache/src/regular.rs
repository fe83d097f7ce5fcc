//! Functions that open regular files only. A pipe could block forever, a device may have no end, and no file may be
//! created at the target of a dangling link.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::path::Path;

/// Opens an existing regular file; links are followed.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] for a folder, a pipe or a device; otherwise, the error of the operating system.
pub(crate) fn open(path: &Path, options: &OpenOptions) -> io::Result<File> {
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
    }
    options.open(path)
}

/// Opens a regular file for writing, and creates it if nothing exists at `path`, not even a link.
///
/// # Errors
/// The errors of [`open`]; [`io::ErrorKind::NotFound`] for a link whose target does not exist.
pub(crate) fn open_or_create(path: &Path) -> io::Result<File> {
    let existing = || open(path, OpenOptions::new().write(true));
    match existing() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            match OpenOptions::new().write(true).create_new(true).open(path) {
                // Created by another process in the meantime, or a dangling link.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => existing(),
                result => result,
            }
        }
        result => result,
    }
}

/// The content of a regular file.
///
/// # Errors
/// The errors of [`open`] and of reading.
pub(crate) fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = open(path, OpenOptions::new().read(true))?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(file.metadata()?.len()).unwrap_or(usize::MAX))?;
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The metadata of the regular file at `path`, following links; `None` if there is no regular file.
///
/// # Errors
/// Errors of the operating system, such as missing permission.
pub(crate) fn metadata(path: &Path) -> io::Result<Option<Metadata>> {
    match fs::metadata(path) {
        Ok(metadata) => Ok(Some(metadata).filter(Metadata::is_file)),
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            Ok(None)
        }
        Err(error) => {
            if is_broken_link(path, &error) {
                Ok(None)
            } else {
                Err(error)
            }
        }
    }
}

/// True if the link at `path` is broken: its target does not exist, or is the link itself. `error` is the error of
/// following the link.
pub(crate) fn is_broken_link(path: &Path, error: &io::Error) -> bool {
    error.kind() != io::ErrorKind::PermissionDenied
        && fs::symlink_metadata(path).is_ok_and(|found| found.is_symlink())
}
