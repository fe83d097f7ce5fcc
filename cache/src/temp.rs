//! [`TempFile`]: a file that is written under a temporary name and then renamed, so that no reader sees an
//! incomplete file. The crate `tempfile` is not used: it does not lock its files, so other processes could not
//! recognise an abandoned file.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use crate::error::{At, Result};
use crate::failpoint::{FilePoints, reach};

/// The suffix of every temporary name.
const SUFFIX: &str = ".lightharmony-temp";

/// Age at which an unlocked temporary file counts as left by a killed process. A running process locks each file
/// immediately after creating it.
const STALE: Duration = Duration::from_secs(10);

/// A file under a temporary name. It is removed if it is dropped before [`persist`](Self::persist) is called.
///
/// The file is locked while it is open, so that [`remove_stale_files`] never removes the file of a running process,
/// even if clocks are wrong.
pub(crate) struct TempFile {
    path: PathBuf,
    file: File,
    points: &'static FilePoints,
    persisted: bool,
}

impl TempFile {
    /// Creates a file in `folder`, and the folder itself if necessary.
    pub fn create(folder: &Path, points: &'static FilePoints) -> Result<TempFile> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        reach(points.before_create).at("create a file in", folder)?;
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".{}-{count}{SUFFIX}", std::process::id()));
            let options = || OpenOptions::new().write(true).create_new(true).open(&path);
            let file = match options() {
                // If the folder cannot be created, the error names it and not the temporary file.
                Err(error)
                    if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) =>
                {
                    fs::create_dir_all(folder).at("create", folder)?;
                    options()
                }
                // Left by a killed process with the same id, or in use by a process on another machine.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                result => result,
            };
            let file = file.at("create", &path)?;
            // Where locks do not work, no process removes stale files either.
            let _ = file.try_lock();
            let temp = TempFile { path, file, points, persisted: false };
            reach(points.after_create).at("create", &temp.path)?;
            return Ok(temp);
        }
    }

    /// Appends `bytes`.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.write_all(bytes).at("write", &self.path)
    }

    /// Syncs the written bytes to the disk.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().and_then(|()| reach(self.points.after_sync)).at("sync", &self.path)
    }

    /// Renames the file to its final name, replacing an existing file.
    pub fn persist(mut self, target: &Path) -> Result<()> {
        reach(self.points.before_rename).at("rename to", target)?;
        let rename = || fs::rename(&self.path, target);
        let renamed = match (rename(), target.parent()) {
            (Err(error), Some(folder)) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(folder).at("create", folder)?;
                rename()
            }
            (result, _) => result,
        };
        renamed.at("rename to", target)?;
        self.persisted = true;
        reach(self.points.after_rename).at("rename to", target)
    }
}

impl Write for TempFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (&self.file).write(bytes)
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        let (first, second) = bytes.split_at(if cfg!(feature = "failpoints") { bytes.len() / 2 } else { 0 });
        let mut file = &self.file;
        file.write_all(first)?;
        reach(self.points.middle)?;
        file.write_all(second)?;
        reach(self.points.after_write)
    }

    fn flush(&mut self) -> io::Result<()> {
        (&self.file).flush()
    }
}

impl Drop for TempFile {
    fn drop(&mut self) {
        if !self.persisted {
            // If this fails, the file is removed later as a stale one.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Syncs a folder to the disk, so that the names of its files survive a loss of power. Not every system supports
/// this. Where it is not supported, a lost file is detected when it is read.
pub(crate) fn sync_folder(folder: &Path) {
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

/// Removes the temporary files that killed writers left in `folder`, and returns the number of files removed.
/// Subfolders are not searched, and files of live processes are never removed.
pub(crate) fn remove_stale_files(folder: &Path) -> usize {
    let unlocked =
        |path: &Path| OpenOptions::new().write(true).open(path).is_ok_and(|file| file.try_lock().is_ok());
    remove_stale(folder, SUFFIX, |path, found| {
        found.is_file() && unlocked(path) && fs::remove_file(path).is_ok()
    })
}

/// Calls `remove` for every object in `folder` whose name ends with `suffix` and that is old enough to be stale.
/// Returns the number of calls that returned true.
pub(crate) fn remove_stale(
    folder: &Path,
    suffix: &str,
    remove: impl Fn(&Path, &fs::Metadata) -> bool,
) -> usize {
    let old = |found: &fs::Metadata| {
        let past = found.modified().ok().and_then(|then| SystemTime::now().duration_since(then).ok());
        past.is_some_and(|past| past >= STALE)
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let named = entries.filter(|entry| entry.file_name().to_string_lossy().ends_with(suffix));
    let found = named.filter_map(|entry| Some((entry.path(), fs::symlink_metadata(entry.path()).ok()?)));
    found.filter(|(path, found)| old(found) && remove(path, found)).count()
}

/// Sets the modification time of everything in a folder to one minute before now.
#[cfg(test)]
pub(crate) fn age_all(folder: &Path) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let then = SystemTime::now() - Duration::from_secs(60);
        File::open(entry.path()).unwrap().set_modified(then).unwrap();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failpoint::BLOB;

    #[test]
    fn stale_files_are_removed_and_live_ones_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let live = TempFile::create(folder.path(), &BLOB).unwrap();
        let stale = folder.path().join(format!(".1-1{SUFFIX}"));
        fs::write(&stale, b"half").unwrap();
        fs::write(folder.path().join("picture.png"), b"kept").unwrap();
        assert_eq!(remove_stale_files(folder.path()), 0, "too young to be stale");
        age_all(folder.path());
        assert_eq!(remove_stale_files(folder.path()), 1);
        assert!(!stale.exists() && live.path.exists());
        live.persist(&folder.path().join("done")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_file_dropped_unfinished_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let mut temp = TempFile::create(&folder.path().join("deep/er"), &BLOB).unwrap();
        temp.write(b"half").unwrap();
        drop(temp);
        assert_eq!(fs::read_dir(folder.path().join("deep/er")).unwrap().count(), 0);
    }
}
