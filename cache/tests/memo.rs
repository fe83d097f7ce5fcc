//! Tests of memos: an unchanged file is not read again, and a changed file always is.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs::{self, File};
use std::path::Path;
use std::time::{Duration, SystemTime};

use cache::{Digest, FileStamp, Options, Store};

fn open(folder: &Path) -> Store {
    Store::open(folder, Options::default()).unwrap()
}

fn settled(mut stamp: FileStamp) -> FileStamp {
    stamp.taken_ns += 10_000_000_000;
    stamp
}

#[test]
fn a_settled_memo_serves_and_a_fresh_one_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(&folder.path().join("cache"));
    let path = folder.path().join("source");
    fs::write(&path, b"one").unwrap();
    let (one, lie) = (Digest::of(b"one"), Digest::of(b"a lie, to see where the answer comes from"));
    assert_eq!(store.digest_file(&path).unwrap(), (one, 3));

    let stamp = FileStamp::of(&path).unwrap();
    assert!(!stamp.is_settled() && settled(stamp).is_settled());
    store.memo_put(&path, &stamp, &lie);
    assert_eq!(store.memo_get(&path, &stamp), None, "as young as the file");
    assert_eq!(store.digest_file(&path).unwrap(), (one, 3));

    store.memo_put(&path, &settled(stamp), &lie);
    assert_eq!(store.digest_file(&path).unwrap(), (lie, 3), "served");
    store.flush().unwrap();
    assert_eq!(
        open(&folder.path().join("cache")).digest_file(&path).unwrap(),
        (lie, 3),
        "by a new process too"
    );
    assert_eq!(
        store.digest_file(&folder.path().join("./source")).unwrap(),
        (lie, 3),
        "one path, two spellings"
    );

    // Another file of the same name, length and time.
    let time = fs::metadata(&path).unwrap().modified().unwrap();
    fs::write(folder.path().join("new"), b"two").unwrap();
    File::options().write(true).open(folder.path().join("new")).unwrap().set_modified(time).unwrap();
    fs::rename(folder.path().join("new"), &path).unwrap();
    assert_eq!(store.digest_file(&path).unwrap(), (Digest::of(b"two"), 3));

    // The same file, rewritten in place, with its time restored: only ctime differs.
    let known = settled(FileStamp::of(&path).unwrap());
    store.memo_put(&path, &known, &Digest::of(b"two"));
    // The clock of the file system may be coarse, but it advances.
    while FileStamp::of(&path).unwrap().ctime_ns == known.ctime_ns {
        std::thread::sleep(Duration::from_millis(5));
        fs::write(&path, b"six").unwrap();
        File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
    }
    assert_eq!(store.digest_file(&path).unwrap(), (Digest::of(b"six"), 3));
}

#[test]
fn edits_at_any_speed_are_seen() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(&folder.path().join("cache"));
    let path = folder.path().join("source");
    for n in 0..300_u32 {
        let content = format!("{n:08}");
        fs::write(&path, &content).unwrap();
        assert_eq!(store.digest_file(&path).unwrap().0, Digest::of(content.as_bytes()), "edit {n}");
    }
}

#[test]
fn a_file_from_the_future_is_always_read() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(&folder.path().join("cache"));
    let path = folder.path().join("source");
    fs::write(&path, b"one").unwrap();
    let future = SystemTime::now() + Duration::from_secs(365 * 24 * 3600);
    File::options().write(true).open(&path).unwrap().set_modified(future).unwrap();
    let stamp = settled(FileStamp::of(&path).unwrap());
    assert!(!stamp.is_settled());
    store.memo_put(&path, &stamp, &Digest::of(b"lie"));
    assert_eq!(store.digest_file(&path).unwrap().0, Digest::of(b"one"));
}

#[test]
fn a_clock_that_jumps_costs_reading_and_gives_no_wrong_digest() {
    const YEAR: i64 = 365 * 24 * 3600 * 1_000_000_000;
    let folder = tempfile::tempdir().unwrap();
    let store = open(&folder.path().join("cache"));
    let path = folder.path().join("source");
    // When the memo is stored, the clock is either a year behind, so that files seem to be from the future, or a
    // year ahead.
    for (jump, trusted) in [(-YEAR, false), (YEAR, true)] {
        fs::write(&path, b"one").unwrap();
        let mut stamp = FileStamp::of(&path).unwrap();
        stamp.taken_ns += jump;
        store.memo_put(&path, &stamp, &Digest::of(b"one"));
        assert_eq!(store.memo_get(&path, &stamp).is_some(), trusted, "{jump}");
        assert_eq!(store.digest_file(&path).unwrap().0, Digest::of(b"one"));
        // Whatever the clock was then, and whatever the time of the edit.
        for (content, year) in [("three", 0), ("seventh", 1), ("eleventh!", -1)] {
            fs::write(&path, content).unwrap();
            let time = SystemTime::UNIX_EPOCH + Duration::from_nanos((stamp.mtime_ns + year * YEAR) as u64);
            File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
            assert_eq!(store.digest_file(&path).unwrap().0, Digest::of(content.as_bytes()));
        }
    }
}

#[test]
fn errors_and_long_files() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::in_memory();
    assert!(store.digest_file(&folder.path().join("missing")).is_err());
    assert!(store.digest_file(folder.path()).is_err(), "a folder");
    let path = folder.path().join("long");
    let content = vec![5; 1_000_003];
    fs::write(&path, &content).unwrap();
    assert_eq!(store.digest_file(&path).unwrap(), (Digest::of(&content), 1_000_003));
}

#[test]
fn history_keeps_the_last() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    assert_eq!(store.history_get("book", "trace"), None);
    store.history_put("book", "trace", b"1.5");
    store.history_put("book", "trace", b"2.5");
    assert_eq!(store.history_get("book", "trace").as_deref(), Some(&b"2.5"[..]));
    drop(store);
    assert_eq!(
        open(folder.path()).history_get("book", "trace").as_deref(),
        Some(&b"2.5"[..]),
        "a drop writes it"
    );
}
