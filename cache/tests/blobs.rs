//! Tests of blobs: reading returns the right bytes or nothing, whatever happens to the files.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::path::{Path, PathBuf};

use cache::{Digest, Options, Store};

fn open(folder: &Path) -> Store {
    Store::open(folder, Options::default()).unwrap()
}

fn file(folder: &Path, digest: &Digest) -> PathBuf {
    let name = digest.to_string();
    folder.join("v1/blobs").join(&name[..2]).join(name)
}

fn bytes(length: usize, seed: u8) -> Vec<u8> {
    (0..length).map(|n| (n as u8).wrapping_mul(31).wrapping_add(seed)).collect()
}

#[test]
fn every_length_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    for store in [open(folder.path()), Store::in_memory()] {
        for length in [0, 1, 31, 4095, 4096, 4097, 1 << 20] {
            let digest = store.put_blob(&bytes(length, 1)).unwrap();
            assert_eq!(digest, Digest::of(&bytes(length, 1)));
            assert_eq!(store.get_blob(&digest).unwrap(), Some(bytes(length, 1)));
            assert!(store.has_blob(&digest));
            store.put_blob(&bytes(length, 1)).unwrap();
        }
        assert!(!store.has_blob(&Digest::of(b"other")));
        assert_eq!(store.get_blob(&Digest::of(b"other")).unwrap(), None);
        store.flush().unwrap();
    }
    let store = open(folder.path());
    assert_eq!(store.get_blob(&Digest::of(&bytes(31, 1))).unwrap(), Some(bytes(31, 1)));
    assert_eq!(store.get_blob(&Digest::of(&bytes(4097, 1))).unwrap(), Some(bytes(4097, 1)));
    assert_eq!(store.take_incidents(), []);
}

#[test]
fn other_handles_see_new_blobs() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (open(folder.path()), open(folder.path()));
    assert!(!b.has_blob(&Digest::of(b"small")));
    let (small, large) = (a.put_blob(b"small").unwrap(), a.put_blob(&bytes(5000, 0)).unwrap());
    let c = open(folder.path());
    assert!(b.has_blob(&small) && b.has_blob(&large));
    assert_eq!(open(folder.path()).get_blob(&small).unwrap().as_deref(), Some(&b"small"[..]));
    assert_eq!(b.get_blob(&small).unwrap().as_deref(), Some(&b"small"[..]));
    assert_eq!(c.get_blob(&small).unwrap().as_deref(), Some(&b"small"[..]));
    let later = a.put_blob(b"later").unwrap();
    assert_eq!(c.get_blob(&later).unwrap().as_deref(), Some(&b"later"[..]));
}

#[test]
fn a_file_of_the_wrong_length_is_replaced_unread() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let digest = store.put_blob(&bytes(5000, 0)).unwrap();
    fs::write(file(folder.path(), &digest), &bytes(5000, 0)[..4000]).unwrap();
    store.put_blob(&bytes(5000, 0)).unwrap();
    assert_eq!(store.get_blob(&digest).unwrap(), Some(bytes(5000, 0)));
    assert_eq!(store.take_incidents(), []);
}

#[test]
fn bad_files_are_put_aside_and_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let good = bytes(10_000, 1);
    let other = bytes(10_000, 2);
    let digest = Digest::of(&good);
    let path = file(folder.path(), &digest);
    let flipped = |at: usize| {
        let mut bad = good.clone();
        bad[at] ^= 4;
        bad
    };
    let mut cases = vec![vec![], good[..1].to_vec(), good[..5000].to_vec(), good[..9999].to_vec(), other];
    cases.push([&good[..], b"junk"].concat());
    cases.push([&good[..6000], &[0; 4000]].concat());
    cases.extend((0..10_000).step_by(499).map(flipped));
    for bad in cases {
        store.put_blob(&good).unwrap();
        fs::write(&path, &bad).unwrap();
        assert_eq!(store.get_blob(&digest).unwrap(), None);
        assert!(!store.has_blob(&digest));
        let incidents = store.take_incidents();
        assert_eq!(incidents.len(), 1);
        assert_eq!(incidents[0].digest, Some(digest));
        assert!(incidents[0].to_string().contains(&digest.short()), "{}", incidents[0]);
        assert_eq!(fs::read(folder.path().join("v1/quarantine").join(digest.to_string())).unwrap(), bad);
        assert_eq!(store.get_blob(&digest).unwrap(), None);
        assert_eq!(store.take_incidents(), [], "said once");
        store.put_blob(&good).unwrap();
        assert_eq!(store.get_blob(&digest).unwrap().as_ref(), Some(&good));
    }
    fs::remove_file(&path).unwrap();
    assert_eq!(store.get_blob(&digest).unwrap(), None);
    assert_eq!(store.take_incidents(), [], "a missing blob does not count as damage");
    fs::create_dir(&path).unwrap();
    assert_eq!(store.get_blob(&digest).unwrap(), None);
    store.put_blob(&good).unwrap();
    assert_eq!(store.get_blob(&digest).unwrap(), Some(good));
}

#[test]
fn swapped_files_are_both_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let digests = [1, 2].map(|seed| store.put_blob(&bytes(8000, seed)).unwrap());
    let [a, b] = digests.map(|digest| file(folder.path(), &digest));
    fs::write(a, bytes(8000, 2)).unwrap();
    fs::write(b, bytes(8000, 1)).unwrap();
    assert!(digests.iter().all(|digest| store.get_blob(digest).unwrap().is_none()));
    assert_eq!(store.take_incidents().len(), 2);
}

#[test]
fn a_quarantine_that_cannot_be_made_does_not_matter() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    fs::write(folder.path().join("v1/quarantine"), b"a file in the way").unwrap();
    let digest = store.put_blob(&bytes(8000, 1)).unwrap();
    fs::write(file(folder.path(), &digest), b"bad").unwrap();
    assert_eq!(store.get_blob(&digest).unwrap(), None);
    assert!(store.take_incidents()[0].what.ends_with("; removed"));
    store.put_blob(&bytes(8000, 1)).unwrap();
    assert_eq!(store.get_blob(&digest).unwrap(), Some(bytes(8000, 1)));
}

#[test]
fn flipped_small_blobs_are_lost_alone() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let digests: Vec<Digest> = (0..5).map(|seed| store.put_blob(&bytes(40, seed)).unwrap()).collect();
    drop(store);
    let log = folder.path().join("v1/blobs.log");
    let good = fs::read(&log).unwrap();
    for at in 64..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 0x10;
        fs::write(&log, bad).unwrap();
        let store = Store::open(folder.path(), Options { read_only: true, ..Options::default() }).unwrap();
        let found = |n: &usize| match store.get_blob(&digests[*n]).unwrap() {
            Some(found) => found == bytes(40, *n as u8) || panic!("wrong bytes"),
            None => false,
        };
        let hit = (at - 64) / (64 + 40);
        let expected: Vec<usize> = (0..5).filter(|n| *n != hit).collect();
        assert_eq!((0..5).filter(found).collect::<Vec<_>>(), expected, "byte {at}");
    }
    // Damages the log of an open store. Values in memory were verified earlier; others are verified now.
    fs::write(&log, &good).unwrap();
    let store = open(folder.path());
    store.put_blob_as(&digests[4], b"").unwrap();
    let liar = Digest::of(b"never written");
    store.put_blob_as(&liar, b"lie").unwrap();
    assert_eq!(store.get_blob(&liar).unwrap(), None);
    assert_eq!(store.take_incidents().len(), 1);
    assert!(!open(folder.path()).has_blob(&liar));
}

#[test]
fn a_log_beyond_memory_is_read_from_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let blob = |n: u32| [&n.to_le_bytes()[..], &[9; 4000]].concat();
    let digests: Vec<Digest> = (0..3000).map(|n| store.put_blob(&blob(n)).unwrap()).collect();
    for store in [store, open(folder.path())] {
        for n in [0, 1, 2000, 2500, 2999_u32] {
            assert_eq!(store.get_blob(&digests[n as usize]).unwrap(), Some(blob(n)));
        }
    }
}

#[test]
fn read_only_gives_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let (small, large) = (store.put_blob(b"small").unwrap(), store.put_blob(&bytes(5000, 0)).unwrap());
    store.put_record(&small, b"record").unwrap();
    drop(store);
    let snapshot = || {
        let mut names: Vec<_> =
            fs::read_dir(folder.path().join("v1")).unwrap().map(|e| e.unwrap().path()).collect();
        names.sort();
        names
    };
    let before = snapshot();
    fs::write(file(folder.path(), &large), b"bad").unwrap();
    let store = Store::open(folder.path(), Options { read_only: true, ..Options::default() }).unwrap();
    assert!(store.is_read_only() && !open(folder.path()).is_read_only());
    assert_eq!(store.get_blob(&small).unwrap().as_deref(), Some(&b"small"[..]));
    assert_eq!(store.get_record(&small).as_deref(), Some(&b"record"[..]));
    assert_eq!(store.get_blob(&large).unwrap(), None);
    assert_eq!(store.get_blob(&large).unwrap(), None);
    assert_eq!(store.take_incidents().len(), 1, "said once, though the file cannot be moved");
    let new = store.put_blob(&bytes(6000, 0)).unwrap();
    store.put_blob(b"new").unwrap();
    store.put_record(&large, b"new").unwrap();
    store.remove_record(&small).unwrap();
    store.history_put("book", "n", b"v");
    store.flush().unwrap();
    store.sweep();
    assert!(matches!(store.lease(&small), cache::LeaseState::Acquired(_)));
    assert!(!store.has_blob(&new) && store.get_record(&large).is_none());
    drop(store);
    assert_eq!(snapshot(), before);
    assert_eq!(fs::read(file(folder.path(), &large)).unwrap(), b"bad");

    let missing = folder.path().join("missing");
    let store = Store::open(&missing, Options { read_only: true, ..Options::default() }).unwrap();
    assert_eq!((store.get_record(&small), store.get_blob(&small).unwrap()), (None, None));
    assert!(!missing.exists());

    let file = folder.path().join("file");
    fs::write(&file, b"").unwrap();
    let error = Store::open(&file, Options::default()).unwrap_err();
    assert!(error.to_string().contains("file"), "{error}");
}

#[test]
fn threads_share_a_store() {
    fn shared<T: Send + Sync>(_: &T) {}
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    shared(&store);
    std::thread::scope(|scope| {
        for thread in 0..4_u8 {
            let store = &store;
            scope.spawn(move || {
                for n in 0..50_u8 {
                    let blob = bytes(if n % 2 == 0 { 100 } else { 5000 }, n);
                    let digest = store.put_blob(&blob).unwrap();
                    assert_eq!(store.get_blob(&digest).unwrap(), Some(blob));
                    store.put_record(&Digest::of(&[thread, n]), &[thread, n]).unwrap();
                }
            });
        }
    });
    assert_eq!(store.record_keys().unwrap().len(), 200);
    assert_eq!(store.take_incidents(), []);
}
