//! Tests of the index of a log. The index only saves time: reading must return what was stored, whatever happens to
//! the index or to the log.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::path::{Path, PathBuf};

use cache::{Digest, Fsync, Options, Store};

/// Number of records. It is large enough that the log gets an index.
const COUNT: u32 = 1500;

fn open(folder: &Path) -> Store {
    Store::open(folder, Options { fsync: Fsync::Off, read_only: false }).unwrap()
}

fn file(folder: &Path, name: &str) -> PathBuf {
    folder.join("v1").join(name)
}

fn key(n: u32) -> Digest {
    Digest::of(&n.to_le_bytes())
}

fn payload(n: u32) -> Vec<u8> {
    format!("payload {n}").into_bytes()
}

fn filled() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    (0..COUNT).for_each(|n| store.put_record(&key(n), &payload(n)).unwrap());
    store.flush().unwrap();
    assert!(file(folder.path(), "records.index").exists());
    folder
}

/// Number of records that `store` contains. Panics if a record has a wrong value.
fn found(store: &Store) -> u32 {
    let there = |n: &u32| {
        let value = store.get_record(&key(*n));
        assert!(value.is_none() || value == Some(payload(*n)), "wrong value for {n}");
        value.is_some()
    };
    (0..COUNT).filter(there).count() as u32
}

#[test]
fn what_follows_the_index_counts_more() {
    let folder = filled();
    let store = open(folder.path());
    assert_eq!(found(&store), COUNT);
    store.put_record(&key(7), b"new").unwrap();
    store.remove_record(&key(8)).unwrap();
    store.remove_record(&key(9)).unwrap();
    store.put_record(&key(9), b"again").unwrap();
    store.put_record(&key(COUNT), b"more").unwrap();
    for store in [store, open(folder.path())] {
        let get = |n| store.get_record(&key(n));
        assert_eq!(get(7).as_deref(), Some(&b"new"[..]));
        assert_eq!((get(8), get(9).as_deref()), (None, Some(&b"again"[..])));
        assert_eq!((get(COUNT).as_deref(), get(COUNT + 1)), (Some(&b"more"[..]), None));
        let keys = store.record_keys().unwrap();
        assert_eq!(keys.len() as u32, COUNT);
        assert!(keys.is_sorted() && !keys.contains(&key(8)));
    }
    // A second index contains all of it.
    let store = open(folder.path());
    (COUNT..2 * COUNT).for_each(|n| store.put_record(&key(n), &payload(n)).unwrap());
    store.flush().unwrap();
    for store in [store, open(folder.path())] {
        assert_eq!(store.get_record(&key(7)).as_deref(), Some(&b"new"[..]));
        assert_eq!(store.get_record(&key(8)), None);
        assert_eq!(store.record_keys().unwrap().len() as u32, 2 * COUNT - 1);
    }
}

#[test]
fn a_damaged_index_is_not_believed() {
    let folder = filled();
    let path = file(folder.path(), "records.index");
    let good = fs::read(&path).unwrap();
    let mut bad: Vec<Vec<u8>> = (0..good.len())
        .step_by(good.len() / 50)
        .map(|at| {
            let mut bytes = good.clone();
            bytes[at] ^= 0x20;
            bytes
        })
        .collect();
    bad.extend([Vec::new(), vec![0; good.len()], good[..4096].to_vec(), [&good[..], &good[..]].concat()]);
    for bytes in bad {
        fs::write(&path, bytes).unwrap();
        let store = open(folder.path());
        assert_eq!(found(&store), COUNT);
        assert_eq!(store.record_keys().unwrap().len() as u32, COUNT);
        assert_eq!(store.take_incidents(), [], "the log itself is whole");
    }
}

#[test]
fn damage_behind_the_index_costs_what_it_lies_in_and_is_reported() {
    let folder = filled();
    let path = file(folder.path(), "records.log");
    let index = fs::read(file(folder.path(), "records.index")).unwrap();
    let good = fs::read(&path).unwrap();
    for at in (64..good.len()).step_by(good.len() / 40) {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        fs::write(&path, bytes).unwrap();
        fs::write(file(folder.path(), "records.index"), &index).unwrap();
        let store = open(folder.path());
        assert_eq!(found(&store), COUNT - 1, "byte {at}");
        let reported: Vec<String> = store.take_incidents().iter().map(ToString::to_string).collect();
        assert!(matches!(&reported[..], [one] if one.contains("damaged data")), "{reported:?}");
        store.flush().unwrap();
        let store = open(folder.path());
        assert_eq!((found(&store), store.take_incidents()), (COUNT - 1, vec![]), "healed");
    }
    for cut in [0, 63, 64, 1000, good.len() / 2, good.len() - 1] {
        fs::write(&path, &good[..cut]).unwrap();
        fs::write(file(folder.path(), "records.index"), &index).unwrap();
        let store = open(folder.path());
        assert!(found(&store) < COUNT, "cut at {cut}");
        store.put_record(&key(COUNT), b"after").unwrap();
        assert_eq!(
            open(folder.path()).get_record(&key(COUNT)).as_deref(),
            Some(&b"after"[..]),
            "cut at {cut}"
        );
        // An index that covers more than the rest of the log must not hide later entries, however long the log
        // gets.
        for n in 1..40 {
            store.put_record(&key(COUNT + n), &vec![n as u8; 1000]).unwrap();
            let value = open(folder.path()).get_record(&key(COUNT + n));
            assert_eq!(value, Some(vec![n as u8; 1000]), "cut at {cut}");
        }
    }
}

#[test]
fn an_index_of_a_log_that_was_replaced_is_not_used() {
    let folder = filled();
    let other = filled();
    fs::copy(file(other.path(), "records.index"), file(folder.path(), "records.index")).unwrap();
    assert_eq!(found(&open(folder.path())), COUNT);
    fs::remove_file(file(folder.path(), "records.log")).unwrap();
    assert_eq!(found(&open(folder.path())), 0);
}

#[test]
fn two_processes_with_one_index_see_each_other() {
    let folder = filled();
    let (a, b) = (open(folder.path()), open(folder.path()));
    a.put_record(&key(COUNT), b"a").unwrap();
    assert_eq!(b.get_record(&key(COUNT)).as_deref(), Some(&b"a"[..]));
    // Compaction by one process is detected by the other.
    for round in 0..40_u8 {
        a.put_record(&key(COUNT + 1), &vec![round; 100_000]).unwrap();
    }
    a.flush().unwrap();
    b.put_record(&key(COUNT + 2), b"b").unwrap();
    for store in [a, b, open(folder.path())] {
        assert_eq!(found(&store), COUNT);
        assert_eq!(store.get_record(&key(COUNT + 2)).as_deref(), Some(&b"b"[..]));
        assert_eq!(store.get_record(&key(COUNT + 1)).map(|value| value[0]), Some(39));
    }
}

#[test]
fn half_an_entry_that_was_read_does_not_hide_what_replaces_it() {
    let folder = filled();
    let path = file(folder.path(), "records.log");
    let whole = fs::read(&path).unwrap();
    let last = whole.len() - (64 + payload(COUNT - 1).len());
    fs::write(&path, &whole[..last + 70]).unwrap();
    fs::remove_file(file(folder.path(), "records.index")).unwrap();
    let store = open(folder.path());
    assert_eq!(found(&store), COUNT - 1);
    store.put_record(&key(COUNT), b"in its place").unwrap();
    // Compaction must keep it, too.
    (0..30).for_each(|_| store.put_record(&key(COUNT + 1), &[0; 100_000]).unwrap());
    store.flush().unwrap();
    assert_eq!(store.get_record(&key(COUNT)).as_deref(), Some(&b"in its place"[..]));
    assert_eq!((found(&store), store.take_incidents()), (COUNT - 1, vec![]));
}
