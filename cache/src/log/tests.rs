//! Tests of a log with two writers, one of which writes without the lock.

use std::fs;
use std::io::Write;
use std::path::Path;

use super::*;
use crate::failpoint;
use crate::temp::TempFile;

fn settings(folder: &Path) -> Settings {
    let path = |name: &str| folder.join(name);
    Settings {
        path: path("x.log"),
        lock: path("x.lock"),
        temp: path("temp"),
        quarantine: path("quarantine"),
        writable: true,
        sync: false,
    }
}

fn key(n: u8) -> Digest {
    Digest::of(&[n])
}

/// Opens the same file as two logs. The second log does not wait for the lock.
fn two(folder: &Path) -> (Log, Log) {
    let (locked, mut other) = (Log::open(settings(folder)).unwrap(), Log::open(settings(folder)).unwrap());
    other.lock_timed_out = true;
    (locked, other)
}

#[test]
fn no_append_changes_what_is_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let (mut locked, mut other) = two(folder.path());
    let path = folder.path().join("x.log");
    locked.append(&[(1, key(0), b"whole")]).unwrap();
    let whole = fs::read(&path).unwrap();
    // First a part of an entry, as a killed writer or a full disk leaves it; then an entry written without the
    // lock.
    let torn = [&whole[..], &whole[log_head::LENGTH as usize..whole.len() - 1]].concat();
    fs::write(&path, &torn).unwrap();
    let lock = File::open(folder.path().join("x.lock")).unwrap();
    lock.lock().unwrap();
    other.append(&[(1, key(1), b"unlocked")]).unwrap();
    lock.unlock().unwrap();
    let before = fs::read(&path).unwrap();
    assert!(before.len() > torn.len() && before.starts_with(&torn), "it was appended, and nothing cut off");
    locked.append(&[(1, key(2), b"locked")]).unwrap();
    assert!(fs::read(&path).unwrap().starts_with(&before));
    for log in [&mut locked, &mut other, &mut Log::open(settings(folder.path())).unwrap()] {
        log.refresh().unwrap();
        for n in 0..3 {
            assert!(log.get(1, &key(n)).unwrap().is_some(), "entry {n}");
        }
        assert_eq!(log.take_damaged(), 0, "a truncated entry does not count as damage");
    }
}

#[test]
fn what_is_appended_in_the_last_instant_of_a_compaction_is_copied() {
    let folder = tempfile::tempdir().unwrap();
    let (mut locked, mut other) = two(folder.path());
    locked.append(&[(1, key(0), b"before")]).unwrap();
    other.refresh().unwrap();
    let length = locked.length;
    let mut new = TempFile::create(&folder.path().join("temp"), &failpoint::LOG).unwrap();
    new.write(&log_head::with(log_head::fresh_salt())).unwrap();
    // Written after compaction has checked the old file's length for the last time.
    let file = other.open.as_ref().unwrap();
    let mut bytes = Vec::new();
    Entry { kind: 1, key: key(1), payload: b"late" }.encode(file.salt, &mut bytes);
    (&file.file).write_all(&bytes).unwrap();
    locked.replace_file(&settings(folder.path()), new, length).unwrap();
    for log in [&mut locked, &mut other, &mut Log::open(settings(folder.path())).unwrap()] {
        log.refresh().unwrap();
        assert_eq!(log.get(1, &key(1)).unwrap().as_deref(), Some(&b"late"[..]));
        assert_eq!(log.get(1, &key(0)).unwrap(), None, "left out by this compaction");
    }
}
