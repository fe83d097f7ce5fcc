//! Tests with objects of the wrong type in the cache folder. Whatever is at the path of a file or folder of the
//! cache, a run completes: the obstacle is moved away, nothing is created or changed through a link, and no
//! operation waits for a pipe.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc;
use std::time::Duration;

use cache::{Digest, Fsync, LeaseState, Limits, Options, Store};

fn open(folder: &Path) -> Store {
    Store::open(folder, Options { fsync: Fsync::Batch, read_only: false }).unwrap()
}

fn large() -> Vec<u8> {
    vec![3; 9000]
}

/// Performs every operation that a run performs, and checks the results.
fn work(store: &Store) {
    let running = store.begin_run("graph", &|| false);
    let LeaseState::Acquired(lease) = store.lease(&Digest::of(b"key")) else { panic!("the lease is busy") };
    let (small, large) = (store.put_blob(b"small").unwrap(), store.put_blob(&large()).unwrap());
    store.put_record(&Digest::of(b"key"), small.as_bytes()).unwrap();
    store.history_put("graph", "node", b"note");
    store.last_run_put("graph", b"last");
    let _ = store.last_run_get("graph");
    store.flush().unwrap();
    assert_eq!(store.get_blob(&small).unwrap().as_deref(), Some(&b"small"[..]));
    assert_eq!(store.get_blob(&large).unwrap(), Some(self::large()));
    assert_eq!(store.get_record(&Digest::of(b"key")).as_deref(), Some(&small.as_bytes()[..]));
    drop((lease, running));
    let _ = store.pins();
    store.sweep();
}

/// The paths of all folders and files in a cache, relative to its folder.
fn names(folder: &Path) -> Vec<PathBuf> {
    let (mut names, mut folders) = (Vec::new(), vec![folder.join("v1")]);
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap().map(Result::unwrap) {
            names.push(entry.path().strip_prefix(folder).unwrap().to_path_buf());
            if entry.file_type().unwrap().is_dir() {
                folders.push(entry.path());
            }
        }
    }
    names.sort();
    names
}

/// Creates a cache that contains every folder and file of the format.
fn used(folder: &Path) {
    let store = open(folder);
    work(&store);
    store.pin("graph", &[Digest::of(b"key")]).unwrap();
    fs::create_dir_all(folder.join("v1/quarantine")).unwrap();
    fs::write(folder.join("v1/leases").join(Digest::of(b"key").to_string()), b"").unwrap();
    for log in ["records", "blobs"] {
        fs::write(folder.join("v1").join(log).with_extension("index"), b"").unwrap();
    }
}

fn remove(path: &Path) {
    if path.is_dir() { fs::remove_dir_all(path).unwrap() } else { fs::remove_file(path).unwrap() }
}

const OBSTACLES: [&str; 7] =
    ["folder", "full folder", "file", "dangling link", "link to itself", "link to a file", "pipe"];

/// Creates an obstacle of the type `what` at `path`. The targets of links are in `outside`.
fn obstruct(path: &Path, outside: &Path, what: &str) {
    match what {
        "folder" => fs::create_dir(path).unwrap(),
        "full folder" => {
            fs::create_dir(path).unwrap();
            fs::write(path.join("content"), b"content").unwrap();
        }
        "file" => fs::write(path, b"content").unwrap(),
        "dangling link" => symlink(outside.join("missing"), path).unwrap(),
        "link to itself" => symlink(path, path).unwrap(),
        "link to a file" => symlink(outside.join("theirs"), path).unwrap(),
        _ => assert!(Command::new("mkfifo").arg(path).status().unwrap().success()),
    }
}

/// Runs `act` on another thread; panics if it does not end, for example because it waits for a pipe.
fn in_time(what: String, act: impl FnOnce() + Send + 'static) {
    let (done, ended) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        act();
        let _ = done.send(());
    });
    match ended.recv_timeout(Duration::from_secs(20)) {
        Err(mpsc::RecvTimeoutError::Timeout) => panic!("{what}: does not end"),
        _ => thread.join().unwrap_or_else(|_| panic!("{what}: failed")),
    }
}

#[test]
fn a_run_completes_whatever_lies_where_a_file_or_folder_of_the_cache_belongs() {
    let example = tempfile::tempdir().unwrap();
    used(example.path());
    let names = names(example.path());
    assert!(names.len() >= 18, "{names:?}");
    for name in &names {
        for what in OBSTACLES {
            let (cache, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            fs::write(outside.path().join("theirs"), b"theirs").unwrap();
            used(cache.path());
            remove(&cache.path().join(name));
            obstruct(&cache.path().join(name), outside.path(), what);
            let (folder, case) = (cache.path().to_path_buf(), format!("{} as {what}", name.display()));
            let label = case.clone();
            in_time(case.clone(), move || {
                // Opening it for reading neither changes anything nor fails.
                let looks = Store::open(&folder, Options { read_only: true, ..Options::default() }).unwrap();
                let _ =
                    (looks.get_record(&Digest::of(b"key")), looks.get_blob(&Digest::of(b"small")).unwrap());
                let _ = (looks.stat().unwrap(), looks.pins(), looks.last_run_get("graph"));
                drop(looks);
                let store = open(&folder);
                assert!(!store.is_read_only(), "{label}: {:?}", store.why_read_only());
                work(&store);
                drop(store);
                // The second run finds an intact cache and reports nothing.
                let store = open(&folder);
                let known = store.get_record(&Digest::of(b"key"));
                assert_eq!(known.as_deref(), Some(&Digest::of(b"small").as_bytes()[..]), "{label}");
                work(&store);
                assert_eq!(store.take_incidents(), [], "{label}");
                let limits = Limits { max_size: Some(0), ..Limits::default() };
                store.collect(&limits, &|_| Vec::new(), Duration::from_secs(5)).unwrap();
            });
            let theirs: Vec<_> =
                fs::read_dir(outside.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
            assert_eq!(theirs, [outside.path().join("theirs")], "{case}: made something through a link");
            assert_eq!(fs::read(&theirs[0]).unwrap(), b"theirs", "{case}: changed something through a link");
        }
    }
}

#[test]
fn what_lay_in_the_way_is_reported_once_and_kept_aside() {
    let cache = tempfile::tempdir().unwrap();
    used(cache.path());
    for name in ["records.log", "temp"] {
        let path = cache.path().join("v1").join(name);
        remove(&path);
        obstruct(&path, cache.path(), if name == "temp" { "file" } else { "full folder" });
    }
    let store = open(cache.path());
    let reports: Vec<String> = store.take_incidents().iter().map(ToString::to_string).collect();
    assert_eq!(reports.len(), 2, "{reports:?}");
    assert!(
        reports.iter().all(|report| report.contains("is not a") && report.contains("quarantine")),
        "{reports:?}"
    );
    let aside = cache.path().join("v1/quarantine");
    let kept = fs::read_dir(&aside).unwrap().map(|entry| entry.unwrap().path());
    let contents: Vec<_> =
        kept.map(|path| fs::read(path.join("content")).or_else(|_| fs::read(path)).unwrap()).collect();
    assert_eq!(contents, [b"content", b"content"]);
    drop(store);
    assert_eq!(open(cache.path()).take_incidents(), []);
}

#[test]
fn a_link_to_a_folder_is_a_folder() {
    let (cache, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    used(cache.path());
    let blobs = cache.path().join("v1/blobs");
    fs::rename(&blobs, elsewhere.path().join("blobs")).unwrap();
    symlink(elsewhere.path().join("blobs"), &blobs).unwrap();
    let store = open(cache.path());
    assert_eq!(store.get_blob(&Digest::of(&large())).unwrap(), Some(large()));
    work(&store);
    assert_eq!(store.take_incidents(), []);
    assert!(fs::symlink_metadata(&blobs).unwrap().is_symlink());
}

#[test]
fn a_cache_that_cannot_be_opened_is_replaced_by_one_that_keeps_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"not a cache").unwrap();
    let error = Store::open(&file, Options::default()).unwrap_err();
    let store = Store::unavailable(error.to_string());
    assert!(store.is_read_only() && store.why_read_only().is_some_and(|why| why.contains("file")));
    let running = store.begin_run("graph", &|| false);
    let digest = store.put_blob(b"small").unwrap();
    store.put_record(&digest, b"record").unwrap();
    assert_eq!((store.get_blob(&digest).unwrap(), store.get_record(&digest)), (None, None));
    store.history_put("graph", "node", b"note");
    assert!(matches!(store.lease(&digest), LeaseState::Acquired(_)));
    store.flush().unwrap();
    assert_eq!(store.take_incidents(), []);
    drop(running);
    drop(store);
    assert_eq!(fs::read(&file).unwrap(), b"not a cache");
}
