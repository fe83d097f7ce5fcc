//! Files that are written under a passing name and then renamed, so that no reader sees half of one.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use crate::error::{At, Result};
use crate::failpoint::{FilePoints, reach};

/// How every passing name ends.
const SUFFIX: &str = ".lightharmony-temp";

/// What nobody holds and was not written to for so long was left by a process that was killed: a live one locks what it
/// makes at once.
const STALE: Duration = Duration::from_secs(10);

/// A file under a passing name. Dropped before [`persist`](Self::persist), it is removed.
///
/// The file is locked while it is open, so that a sweep never takes it from a live writer, whatever the
/// clocks say.
pub(crate) struct TempFile {
    path: PathBuf,
    file: File,
    points: &'static FilePoints,
    persisted: bool,
}

impl TempFile {
    /// Creates a file in `folder`, and the folder if need be.
    pub fn create(folder: &Path, points: &'static FilePoints) -> Result<TempFile> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        reach(points.before_create).at("create a file in", folder)?;
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".{}-{count}{SUFFIX}", std::process::id()));
            let options = || OpenOptions::new().write(true).create_new(true).open(&path);
            let file = match options() {
                // The folder is named where it cannot be made, and not the passing file.
                Err(error)
                    if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) =>
                {
                    fs::create_dir_all(folder).at("create", folder)?;
                    options()
                }
                // Left by a killed process of the same number, or in use by one on another machine.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                result => result,
            };
            let file = file.at("create", &path)?;
            // Where locks do not work, nobody sweeps either.
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

    /// Makes what was written survive a loss of power.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().and_then(|()| reach(self.points.after_sync)).at("sync", &self.path)
    }

    /// Gives the file its final name, replacing what is there.
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
            // Best effort: what stays is swept later.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Makes the names in a folder survive a loss of power. Not every system can, and then nothing is lost that
/// a verified read would not notice.
pub(crate) fn sync_folder(folder: &Path) {
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

/// Removes passing files in `folder` (not below it) that killed writers left, and returns how many went. A file that a
/// live process holds is never touched.
pub fn sweep_temp(folder: &Path) -> usize {
    let nobodys =
        |path: &Path| OpenOptions::new().write(true).open(path).is_ok_and(|file| file.try_lock().is_ok());
    remove_stale(folder, SUFFIX, |path, found| {
        found.is_file() && nobodys(path) && fs::remove_file(path).is_ok()
    })
}

/// Calls `remove` for what has a passing name that ends so, and is older than a live one that is not locked yet; returns
/// how many it removed.
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

/// Makes everything in a folder a minute old.
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
    fn sweeps_the_dead_and_not_the_living() {
        let folder = tempfile::tempdir().unwrap();
        let living = TempFile::create(folder.path(), &BLOB).unwrap();
        let dead = folder.path().join(format!(".1-1{SUFFIX}"));
        fs::write(&dead, b"half").unwrap();
        fs::write(folder.path().join("picture.png"), b"kept").unwrap();
        assert_eq!(sweep_temp(folder.path()), 0, "too young to be sure");
        age_all(folder.path());
        assert_eq!(sweep_temp(folder.path()), 1);
        assert!(!dead.exists() && living.path.exists());
        living.persist(&folder.path().join("done")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn dropped_unfinished_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut temp = TempFile::create(&folder.path().join("deep/er"), &BLOB).unwrap();
        temp.write(b"half").unwrap();
        drop(temp);
        assert_eq!(fs::read_dir(folder.path().join("deep/er")).unwrap().count(), 0);
    }
}
