//! Tests of records: whatever happens to the file, reading returns what was stored, or nothing.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use cache::{Digest, Error, Fsync, Options, Store};

fn open(folder: &Path) -> Store {
    Store::open(folder, Options { fsync: Fsync::Off, read_only: false }).unwrap()
}

fn log(folder: &Path) -> PathBuf {
    folder.join("v1/records.log")
}

fn key(n: u32) -> Digest {
    Digest::of(&n.to_le_bytes())
}

fn payload(n: u32) -> Vec<u8> {
    format!("payload {n} ").repeat(1 + n as usize % 4).into_bytes()
}

const COUNT: u32 = 8;

/// A folder with a log of eight records, the bytes of the log, and the offsets at which its entries end.
fn filled() -> (tempfile::TempDir, Vec<u8>, Vec<usize>) {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let length = || fs::metadata(log(folder.path())).unwrap().len() as usize;
    let mut ends = vec![length()];
    for n in 0..COUNT {
        store.put_record(&key(n), &payload(n)).unwrap();
        ends.push(length());
    }
    drop(store);
    let bytes = fs::read(log(folder.path())).unwrap();
    (folder, bytes, ends)
}

/// The numbers of the records that `store` contains. Panics if a record has a wrong value.
fn found(store: &Store) -> Vec<u32> {
    let there = |n: &u32| {
        let value = store.get_record(&key(*n));
        assert!(value.is_none() || value == Some(payload(*n)), "wrong value for {n}");
        value.is_some()
    };
    (0..COUNT).filter(there).collect()
}

/// Checks that the store in `folder` contains exactly the records `expected`, accepts new ones, and finds them when
/// it is opened again.
fn still_works(folder: &Path, expected: &[u32], what: &str) {
    let store = open(folder);
    assert_eq!(found(&store), expected, "{what}");
    store.put_record(&key(100), b"after").unwrap();
    let other = open(folder);
    assert_eq!(other.get_record(&key(100)).as_deref(), Some(&b"after"[..]), "{what}");
    assert_eq!(found(&other), expected, "{what}");
    store.flush().unwrap();
    let third = open(folder);
    assert_eq!(third.get_record(&key(100)).as_deref(), Some(&b"after"[..]), "{what}");
    assert_eq!(found(&third), expected, "{what}");
    assert_eq!(third.take_incidents(), [], "{what}: the damage is gone once it was dealt with");
}

#[test]
fn truncated_at_every_byte() {
    let (folder, bytes, ends) = filled();
    for cut in 0..=bytes.len() {
        fs::write(log(folder.path()), &bytes[..cut]).unwrap();
        // Half of the head still contains the salt, but no entry follows.
        let whole = ends.iter().skip(1).filter(|end| **end <= cut).count() as u32;
        still_works(folder.path(), &(0..whole).collect::<Vec<_>>(), &format!("cut at {cut}"));
    }
}

#[test]
fn every_byte_flipped() {
    let (folder, bytes, ends) = filled();
    for at in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[at] ^= 1 << (at % 8);
        fs::write(log(folder.path()), &bad).unwrap();
        let hit = ends.iter().position(|end| at < *end).unwrap() as u32;
        // A flip in the head of the file affects no record.
        let kept: Vec<u32> = (0..COUNT).filter(|n| n + 1 != hit).collect();
        still_works(folder.path(), &kept, &format!("byte {at} flipped"));
    }
}

#[test]
fn junk_zeros_and_a_lost_head() {
    let (folder, bytes, ends) = filled();
    let all: Vec<u32> = (0..COUNT).collect();
    for junk in [&b"LHe1"[..], b"junk", &[0; 5000], &[0xff; 70], &bytes[10..200], &b"LHe1".repeat(300)] {
        fs::write(log(folder.path()), [&bytes, junk].concat()).unwrap();
        still_works(folder.path(), &all, "junk at the end");
        let middle = ends[3];
        fs::write(log(folder.path()), [&bytes[..middle], junk, &bytes[middle..]].concat()).unwrap();
        still_works(folder.path(), &all, "junk in the middle");
    }
    for zeros in 1..200 {
        let mut bad = bytes.clone();
        let start = bytes.len() - zeros;
        bad[start..].fill(0);
        fs::write(log(folder.path()), &bad).unwrap();
        let whole = ends.iter().skip(1).filter(|end| **end <= start).count() as u32;
        still_works(folder.path(), &(0..whole).collect::<Vec<_>>(), "zeros at the end");
    }
    let mut bad = bytes;
    bad[..64].fill(0);
    fs::write(log(folder.path()), &bad).unwrap();
    still_works(folder.path(), &[], "no head");
    assert_eq!(fs::read_dir(folder.path().join("v1/quarantine")).unwrap().count(), 1);
    fs::remove_file(log(folder.path())).unwrap();
    still_works(folder.path(), &[], "no log");
    fs::write(folder.path().join("v1/records.lock"), b"junk").unwrap();
    still_works(folder.path(), &[], "junk in the lock");
}

#[test]
fn a_log_of_another_cache_inside_a_payload_is_not_read() {
    let (folder, inner, _) = filled();
    let outer = tempfile::tempdir().unwrap();
    let store = open(outer.path());
    store.put_record(&key(50), &inner).unwrap();
    drop((store, folder));
    let mut bytes = fs::read(log(outer.path())).unwrap();
    bytes[64] ^= 1;
    fs::write(log(outer.path()), &bytes).unwrap();
    assert_eq!(found(&open(outer.path())), []);
}

#[test]
fn the_last_value_wins_and_removal_is_final() {
    let folder = tempfile::tempdir().unwrap();
    for store in [open(folder.path()), Store::in_memory()] {
        store.put_record(&key(1), b"first").unwrap();
        store.put_record(&key(1), b"").unwrap();
        assert_eq!(store.get_record(&key(1)).as_deref(), Some(&b""[..]));
        store.put_record(&key(2), b"two").unwrap();
        store.remove_record(&key(1)).unwrap();
        store.remove_record(&key(3)).unwrap();
        assert_eq!(store.get_record(&key(1)), None);
        assert_eq!(store.record_keys().unwrap(), [key(2)]);
    }
    let store = open(folder.path());
    assert_eq!(store.record_keys().unwrap(), [key(2)]);
    store.put_record(&key(1), b"again").unwrap();
    assert_eq!(open(folder.path()).get_record(&key(1)).as_deref(), Some(&b"again"[..]));
    let error = store.put_record(&key(4), &vec![0; (16 << 20) + 1]).unwrap_err();
    assert!(matches!(error, Error::RecordTooLarge { length: 16_777_217, .. }));
    store.put_record(&key(4), &vec![7; 16 << 20]).unwrap();
    assert_eq!(open(folder.path()).get_record(&key(4)), Some(vec![7; 16 << 20]));
}

#[test]
fn other_handles_see_appends_and_compaction() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (open(folder.path()), open(folder.path()));
    a.put_record(&key(1), b"one").unwrap();
    assert_eq!(b.get_record(&key(1)).as_deref(), Some(&b"one"[..]));
    b.put_record(&key(2), b"two").unwrap();
    for n in 0..40_u8 {
        a.put_record(&key(3), &vec![n; 100_000]).unwrap();
    }
    a.history_put("book", "note", b"kept");
    let before = fs::metadata(log(folder.path())).unwrap().len();
    a.flush().unwrap();
    let after = fs::metadata(log(folder.path())).unwrap().len();
    assert!(before > 4_000_000 && after < 110_000, "{before} {after}");
    // `b` still has the old file open.
    b.put_record(&key(4), b"four").unwrap();
    a.put_record(&key(5), b"five").unwrap();
    for store in [&a, &b, &open(folder.path())] {
        let expected: BTreeMap<u32, Vec<u8>> = [
            (1, b"one".to_vec()),
            (2, b"two".to_vec()),
            (3, vec![39; 100_000]),
            (4, b"four".to_vec()),
            (5, b"five".to_vec()),
        ]
        .into();
        for (n, value) in expected {
            assert_eq!(store.get_record(&key(n)), Some(value), "{n}");
        }
        assert_eq!(store.history_get("book", "note").as_deref(), Some(&b"kept"[..]));
    }
}

#[test]
fn a_reader_with_a_torn_tail_sees_what_replaces_it() {
    let (folder, bytes, ends) = filled();
    let cut = ends[COUNT as usize - 1];
    // The last entry lacks one byte and is followed by another entry, since bytes of a log are never changed.
    let torn = &bytes[..bytes.len() - 1];
    fs::write(log(folder.path()), torn).unwrap();
    let reader = open(folder.path());
    assert_eq!(found(&reader).len(), COUNT as usize - 1);
    open(folder.path()).put_record(&key(8), b"eight").unwrap();
    assert!(fs::read(log(folder.path())).unwrap().starts_with(torn));
    assert_eq!(reader.get_record(&key(8)).as_deref(), Some(&b"eight"[..]));
    assert_eq!(reader.take_incidents(), [], "a truncated entry does not count as damage");
    // Earlier versions cut off a torn entry. It is then replaced by an entry of exactly the same length.
    fs::write(log(folder.path()), torn).unwrap();
    let reader = open(folder.path());
    assert_eq!(found(&reader).len(), COUNT as usize - 1);
    fs::write(log(folder.path()), &bytes[..cut]).unwrap();
    let size = torn.len() - cut - 64;
    open(folder.path()).put_record(&key(9), &vec![1; size]).unwrap();
    assert_eq!(fs::metadata(log(folder.path())).unwrap().len() as usize, torn.len());
    assert_eq!(reader.get_record(&key(9)), Some(vec![1; size]));
}

#[test]
fn the_folder_may_vanish() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(&folder.path().join("cache"));
    store.put_record(&key(1), b"one").unwrap();
    store.put_blob(&[1; 10]).unwrap();
    fs::remove_dir_all(folder.path().join("cache")).unwrap();
    store.put_record(&key(2), b"two").unwrap();
    let (small, large) = (store.put_blob(&[2; 10]).unwrap(), store.put_blob(&[2; 10_000]).unwrap());
    store.flush().unwrap();
    let other = open(&folder.path().join("cache"));
    assert_eq!(other.get_record(&key(2)).as_deref(), Some(&b"two"[..]));
    assert_eq!(other.get_blob(&small).unwrap(), Some(vec![2; 10]));
    assert_eq!(other.get_blob(&large).unwrap(), Some(vec![2; 10_000]));
}
