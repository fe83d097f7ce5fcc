//! Tests of the collection, verification and copying of a cache.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use cache::{Digest, Error, Fsync, Limits, Options, Store};

const DAY: Duration = Duration::from_secs(24 * 60 * 60);

fn open(folder: &Path) -> Store {
    Store::open(folder, Options { fsync: Fsync::Off, read_only: false }).unwrap()
}

/// The digests of the blobs that a record names. In these tests, the payload of a record is the list of these
/// digests.
fn names(payload: &[u8]) -> Vec<Digest> {
    payload.as_chunks::<32>().0.iter().map(|digest| Digest::from_bytes(*digest)).collect()
}

fn key(n: u8) -> Digest {
    Digest::of(&[n])
}

/// A value of `length` bytes that differs for every `n`.
fn value(n: u8, length: usize) -> Vec<u8> {
    (0..length).map(|at| n ^ (at % 251) as u8).collect()
}

/// Creates a cache with records 0 to 9. Each record names a large blob of its own, a small blob of its own, and a
/// blob that all records share. Records with higher numbers were used later.
fn filled() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let shared = store.put_blob(&[9; 5000]).unwrap();
    for n in 0..10 {
        let blobs = [store.put_blob(&value(n, 100_000)).unwrap(), store.put_blob(&[n; 50]).unwrap(), shared];
        store.put_record(&key(n), &blobs.map(|digest| *digest.as_bytes()).concat()).unwrap();
    }
    store.flush().unwrap();
    (0..10).for_each(|n| set_used(folder.path(), n, 20 - u64::from(n)));
    folder
}

fn blob_path(folder: &Path, digest: &Digest) -> PathBuf {
    let name = digest.to_string();
    folder.join("v1/blobs").join(&name[..2]).join(name)
}

/// Sets the last use of record `n` to `days` days ago, by changing the file time of its large blob.
fn set_used(folder: &Path, n: u8, days: u64) {
    let path = blob_path(folder, &Digest::of(&value(n, 100_000)));
    let file = File::options().write(true).open(path).unwrap();
    file.set_modified(SystemTime::now() - DAY * days as u32).unwrap();
}

fn collect(store: &Store, limits: Limits) -> cache::Collected {
    store.collect(&limits, &names, Duration::ZERO).unwrap()
}

fn size(folder: &Path) -> u64 {
    let mut folders = vec![folder.join("v1")];
    let mut size = 0;
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let meta = entry.metadata().unwrap();
            if meta.is_dir() { folders.push(entry.path()) } else { size += meta.len() }
        }
    }
    size
}

/// The numbers of the stored records. Panics if a blob that a record names is missing.
fn whole(folder: &Path) -> Vec<u8> {
    let store = open(folder);
    let found = |n: &u8| {
        let Some(payload) = store.get_record(&key(*n)) else { return false };
        names(&payload)
            .iter()
            .for_each(|blob| assert!(store.get_blob(blob).unwrap().is_some(), "record {n}"));
        true
    };
    let found = (0..10).filter(found).collect();
    assert_eq!(store.take_incidents(), []);
    found
}

#[test]
fn the_longest_unused_goes_first_and_the_limit_holds() {
    let folder = filled();
    let limits = Limits { max_size: Some(600_000), ..Limits::default() };
    let store = open(folder.path());
    let plan = collect(&store, Limits { dry_run: true, ..limits });
    assert_eq!(whole(folder.path()).len(), 10, "only reported");
    // Reading counts as use.
    (0..10).for_each(|n| set_used(folder.path(), n, 20 - u64::from(n)));
    let done = collect(&store, limits);
    assert_eq!((done.records, done.blobs), (plan.records, plan.blobs));
    // Down to the low water mark, and no further.
    assert_eq!((done.records, done.blobs), (5, 10));
    assert_eq!(whole(folder.path()), [5, 6, 7, 8, 9]);
    assert!(done.after == size(folder.path()) && done.after <= 600_000, "{done:?}");
    let again = collect(&store, limits);
    assert_eq!((again.records, again.blobs), (0, 0), "no thrash");
    let all = collect(&store, Limits { max_size: Some(0), ..limits });
    assert_eq!((all.records, whole(folder.path())), (5, vec![]));
    assert!(size(folder.path()) < 1000, "{}", size(folder.path()));
}

#[test]
fn age_history_and_pins_decide() {
    let folder = filled();
    let store = open(folder.path());
    store.pin("kept", &[key(0), key(1)]).unwrap();
    assert_eq!(store.pins(), [("kept".to_owned(), 2)]);
    // A graph with a record in its history was run today.
    drop(store.begin_run("graph", &|| false));
    store.history_put("graph", "node", key(2).as_bytes());
    store.flush().unwrap();
    // The limit differs from every age by at least half a day, so that the time of day does not matter.
    let old = Limits { max_age: Some(DAY * 29 / 2), ..Limits::default() };
    let done = collect(&store, old);
    assert_eq!((done.records, done.pinned), (3, 2), "3, 4 and 5 were used 17 to 15 days ago");
    assert_eq!(whole(folder.path()), [0, 1, 2, 6, 7, 8, 9]);
    assert!(store.unpin("kept").unwrap() && !store.unpin("kept").unwrap());
    (0..2).for_each(|n| set_used(folder.path(), n, 30));
    collect(&open(folder.path()), old);
    assert_eq!(whole(folder.path()), [2, 6, 7, 8, 9]);
}

#[test]
fn what_nothing_names_goes_and_dead_weight_with_it() {
    let folder = filled();
    let store = open(folder.path());
    let orphans = [store.put_blob(&[1; 70_000]).unwrap(), store.put_blob(b"small").unwrap()];
    let done = collect(&store, Limits::default());
    assert_eq!((done.records, done.blobs, done.before - done.after > 70_000), (0, 2, true));
    assert!(orphans.iter().all(|blob| !open(folder.path()).has_blob(blob)));
    assert_eq!(whole(folder.path()).len(), 10);
}

#[test]
fn a_run_at_work_keeps_collections_away_and_the_reverse() {
    let folder = filled();
    let (store, other) = (open(folder.path()), open(folder.path()));
    let running = store.begin_run("graph", &|| false);
    let also = other.begin_run("graph", &|| false);
    let all = Limits { max_size: Some(0), ..Limits::default() };
    for _ in 0..2 {
        let refused = other.collect(&all, &names, Duration::from_millis(20));
        assert!(matches!(refused, Err(Error::InUse { .. })), "{refused:?}");
    }
    assert_eq!(whole(folder.path()).len(), 10);
    drop(running);
    assert!(other.collect(&all, &names, Duration::ZERO).is_err(), "the other one is still at work");
    drop(also);
    assert_eq!(other.collect(&all, &names, Duration::ZERO).unwrap().records, 10);
}

#[test]
fn a_check_finds_exactly_what_is_damaged() {
    let folder = filled();
    let check = |repair| open(folder.path()).check(repair, &names, &mut |_| true).unwrap();
    let good = check(false);
    assert!(good.is_whole() && (good.records, good.blobs) == (10, 21), "{good:?}");
    // One damaged blob, one missing blob, one damaged record.
    let bad = Digest::of(&value(3, 100_000));
    let mut bytes = fs::read(blob_path(folder.path(), &bad)).unwrap();
    bytes[777] ^= 1;
    fs::write(blob_path(folder.path(), &bad), bytes).unwrap();
    fs::remove_file(blob_path(folder.path(), &Digest::of(&value(5, 100_000)))).unwrap();
    let log = folder.path().join("v1/records.log");
    let mut bytes = fs::read(&log).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&log, bytes).unwrap();
    for _ in 0..2 {
        let found = check(false);
        // The damaged record is the last in its log, where it could be one that is being written.
        assert_eq!((found.records, &found.bad[..]), (9, &[bad][..]));
        let mut incomplete = [key(3), key(5)];
        incomplete.sort();
        assert_eq!(found.incomplete, incomplete, "verify changes nothing");
    }
    assert!(!check(true).is_whole());
    let healed = check(false);
    assert!(healed.is_whole() && healed.records == 7, "{healed:?}");
    assert_eq!(whole(folder.path()), [0, 1, 2, 4, 6, 7, 8]);
    // The next collection empties the quarantine and reports the size that is left.
    for _ in 0..2 {
        let done = collect(&open(folder.path()), Limits::default());
        assert_eq!(
            (done.after, open(folder.path()).stat().unwrap().quarantine_bytes),
            (size(folder.path()), 0)
        );
    }
    assert_eq!(whole(folder.path()), [0, 1, 2, 4, 6, 7, 8]);
}

#[test]
fn a_copy_holds_what_was_asked_for_and_nothing_bad() {
    let folder = filled();
    let other = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    fs::write(blob_path(folder.path(), &Digest::of(&value(2, 100_000))), b"bad").unwrap();
    let asked = [key(1), key(2), key(77)];
    assert_eq!(store.copy_to(&open(other.path()), Some(&asked), &names, &mut |_| true).unwrap(), 1);
    assert_eq!(whole(other.path()), [1]);
    assert_eq!(store.copy_to(&open(other.path()), None, &names, &mut |_| true).unwrap(), 9);
    assert_eq!(whole(other.path()), [0, 1, 3, 4, 5, 6, 7, 8, 9]);
    let stat = open(other.path()).stat().unwrap();
    assert_eq!((stat.records, stat.large_blobs, stat.small_blobs), (9, 10, 9));
    assert_eq!(stat.bytes, size(other.path()));
}
