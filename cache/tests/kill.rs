//! Kills a process, or simulates a disk error, at every failpoint, and then checks the cache. The tests need the
//! feature `failpoints`, which the tests of the program turn on for the whole workspace. They run this test program as
//! a child process, with the test `child`.
#![cfg(feature = "failpoints")]
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::process::Command;

use cache::{Digest, Error, Fsync, LeaseState, Limits, Options, Result, Store, failpoint, publish_file};

fn open(folder: &Path) -> Result<Store> {
    Store::open(folder, Options { fsync: Fsync::Always, read_only: false })
}

fn content(n: u8) -> Vec<u8> {
    vec![n; if n.is_multiple_of(2) { 50 } else { 6000 }]
}

fn key(n: u8) -> Digest {
    Digest::of(&[n])
}

const ROUNDS: u8 = 6;

/// Performs each operation of the store at least once, and writes the names of the successful operations to a file.
fn work(folder: &Path) -> Result<()> {
    let mut acknowledged = OpenOptions::new().create(true).append(true).open(folder.join("log")).unwrap();
    // Each line is written in one call, so that a kill leaves no incomplete line.
    let mut note = |line: String| acknowledged.write_all((line + "\n").as_bytes()).unwrap();
    let mut store = open(&folder.join("cache"))?;
    if store.is_read_only() {
        assert!(store.why_read_only().is_some_and(|why| why.starts_with("disk full: cannot create")));
        store = open(&folder.join("cache"))?;
    }
    for n in 0..ROUNDS {
        let _lease = matches!(store.lease(&key(n)), LeaseState::Acquired(_));
        let digest = Digest::of(&content(n));
        if store.get_record(&key(n)).as_deref() == Some(&content(n)[..]) && store.get_blob(&digest)?.is_some()
        {
            continue;
        }
        store.put_blob_as(&digest, &content(n))?;
        note(format!("blob {n}"));
        store.put_record(&key(n), &content(n))?;
        note(format!("record {n}"));
        // Replaced entries, so that there is something to compact.
        store.put_record(&key(99), &vec![n; 500_000])?;
        publish_file(&folder.join("out/picture.png"), &vec![n; 3000])?;
        note(format!("file {n}"));
    }
    // One damaged blob that was not acknowledged.
    let bad = store.put_blob(&[77; 9000])?;
    let name = bad.to_string();
    fs::write(folder.join("cache/v1/blobs").join(&name[..2]).join(&name), b"bad").unwrap();
    assert_eq!(store.get_blob(&bad)?, None);
    store.flush()?;
    // A collection removes blobs that no record names, and nothing else.
    let orphan = store.put_blob(&[78; 9000])?;
    let names = |payload: &[u8]| vec![Digest::of(payload)];
    store.collect(&Limits::default(), &names, std::time::Duration::from_secs(60))?;
    assert!(!store.has_blob(&orphan));
    note("done".to_owned());
    Ok(())
}

#[test]
#[ignore = "a part of the other tests"]
fn child() {
    let Some(folder) = std::env::var_os("CACHE_TEST_FOLDER") else { return };
    match work(Path::new(&folder)) {
        Ok(()) => {}
        Err(error) => {
            // An error names what failed, and a second try succeeds.
            assert!(matches!(&error, Error::Io { .. } | Error::Full { .. }), "{error}");
            assert!(error.to_string().contains(&*folder.to_string_lossy()), "{error}");
            check(Path::new(&folder), "after an error, same process");
            work(Path::new(&folder)).unwrap();
        }
    }
}

/// Runs a child process, with the given failpoint enabled. Returns true if the process did not end successfully.
fn run(folder: &Path, failpoint: Option<&str>) -> bool {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "child", "--ignored", "--nocapture"]).env("CACHE_TEST_FOLDER", folder);
    command.env_remove("LIGHTHARMONY_FAILPOINT");
    if let Some(place) = failpoint {
        command.env("LIGHTHARMONY_FAILPOINT", place);
    }
    let output = command.output().unwrap();
    // 101 is a panic, and a failed test; an abort has no code at all.
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_ne!(output.status.code(), Some(101), "{failpoint:?}: {printed}");
    !output.status.success()
}

/// Checks that every result that was reported as stored is in the cache, and that no stored result is wrong.
fn check(folder: &Path, what: &str) {
    let log = fs::read_to_string(folder.join("log")).unwrap_or_default();
    let store = open(&folder.join("cache")).unwrap();
    let mut last_file = None;
    for line in log.split_inclusive('\n') {
        // A line without its end was being written when the process died.
        let Some((kind, n)) = line.strip_suffix('\n').and_then(|line| line.split_once(' ')) else { continue };
        let n: u8 = n.parse().unwrap();
        match kind {
            "blob" => {
                let found = store.get_blob(&Digest::of(&content(n))).unwrap();
                assert_eq!(found, Some(content(n)), "{what}: {line}");
            }
            "record" => assert_eq!(store.get_record(&key(n)), Some(content(n)), "{what}: {line}"),
            _ => last_file = Some(n),
        }
    }
    for n in 0..ROUNDS {
        let (record, blob) = (store.get_record(&key(n)), store.get_blob(&Digest::of(&content(n))).unwrap());
        assert!(record.is_none() || record == Some(content(n)), "{what}: wrong record {n}");
        assert!(blob.is_none() || blob == Some(content(n)), "{what}: wrong blob {n}");
        assert!(matches!(store.lease(&key(n)), LeaseState::Acquired(_)), "{what}: a dead holder");
    }
    assert_eq!(store.take_incidents(), [], "{what}: a stop does not count as damage");
    match fs::read(folder.join("out/picture.png")) {
        Ok(found) => {
            assert_eq!(found, vec![found[0]; 3000], "{what}: half a file");
            assert!(last_file.is_none_or(|n| found[0] >= n), "{what}: an older file");
        }
        Err(_) => assert_eq!(last_file, None, "{what}: no file"),
    }
}

/// Counts for failpoints: the child process is stopped when it reaches a failpoint for the first, second, third,
/// seventh or twelfth time. `work` reaches no failpoint more than twelve times.
const COUNTS: [u64; 5] = [1, 2, 3, 7, 12];

#[test]
fn killed_at_every_place_nothing_acknowledged_is_lost() {
    for name in failpoint::NAMES {
        for count in COUNTS {
            let folder = tempfile::tempdir().unwrap();
            let place = format!("{name}:{count}");
            let stopped = run(folder.path(), Some(&place));
            assert!(stopped || count > 1, "{name} is never reached");
            if !stopped {
                break;
            }
            check(folder.path(), &place);
            // Killed again while it recovers, then allowed to finish.
            run(folder.path(), Some(&place));
            check(folder.path(), &place);
            assert!(!run(folder.path(), None), "{place}: the work cannot be finished");
            check(folder.path(), &place);
            assert!(fs::read_to_string(folder.path().join("log")).unwrap().ends_with("done\n"));
        }
    }
}

#[test]
fn errors_at_every_place_are_reported_and_harm_nothing() {
    for name in failpoint::NAMES {
        for (count, effect) in [(1, "error"), (2, "full"), (5, "error")] {
            let folder = tempfile::tempdir().unwrap();
            let place = format!("{name}:{count}:{effect}");
            assert!(!run(folder.path(), Some(&place)), "{place}");
            check(folder.path(), &place);
            for below in ["out", "cache/v1/temp"] {
                let mut left = fs::read_dir(folder.path().join(below)).unwrap();
                assert!(
                    left.all(|entry| entry.unwrap().file_name() == "picture.png"),
                    "{place}: left in {below}"
                );
            }
        }
    }
}

#[test]
fn killed_at_any_moment() {
    for round in 0..20_u64 {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "child", "--ignored"]).env("CACHE_TEST_FOLDER", folder.path());
        let mut child = command.stdout(File::create(folder.path().join("output")).unwrap()).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(round * 2));
        child.kill().unwrap();
        child.wait().unwrap();
        check(folder.path(), &format!("round {round}"));
        assert!(!run(folder.path(), None));
        check(folder.path(), &format!("round {round}"));
    }
}
