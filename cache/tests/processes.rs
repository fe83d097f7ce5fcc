//! Tests with several processes that use one cache. The tests run this test program as a child process, with the
//! test `child`.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use cache::{Digest, Fsync, LeaseState, Options, Store};

fn open(folder: &Path) -> Store {
    Store::open(folder, Options { fsync: Fsync::Off, read_only: false }).unwrap()
}

fn spawn(role: &str, folder: &Path) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--ignored", "--nocapture"])
        .env("CACHE_TEST_ROLE", role)
        .env("CACHE_TEST_FOLDER", folder)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

fn wait_for_line(child: &mut Child, line: &str) {
    let output = BufReader::new(child.stdout.take().unwrap());
    assert!(output.lines().any(|found| found.unwrap() == line), "the child never said {line}");
}

const APPENDS: u32 = 400;

fn record(role: &str, n: u32) -> (Digest, Vec<u8>) {
    let payload = format!("{role} {n} ").repeat(1 + n as usize % 50).into_bytes();
    (Digest::of(&payload), payload)
}

#[test]
#[ignore = "a part of the other tests"]
#[allow(clippy::print_stdout, reason = "the parent listens")]
fn child() {
    let Ok(role) = std::env::var("CACHE_TEST_ROLE") else { return };
    let folder = std::env::var_os("CACHE_TEST_FOLDER").unwrap();
    let store = open(Path::new(&folder));
    let key = Digest::of(b"leased");
    match role.as_str() {
        "hold" => {
            let LeaseState::Acquired(_lease) = store.lease(&key) else { panic!("busy") };
            println!("\nheld");
            std::thread::sleep(Duration::from_secs(60));
        }
        "count" => {
            // Every read and write of the number is under the lease; otherwise increments would be lost.
            for _ in 0..50 {
                let LeaseState::Acquired(_lease) =
                    store.wait_for_lease(&key, Duration::from_secs(60), &|| false)
                else {
                    panic!("timed out");
                };
                let path = Path::new(&folder).join("number");
                let number: u32 = fs::read_to_string(&path).unwrap().parse().unwrap();
                std::thread::yield_now();
                fs::write(&path, (number + 1).to_string()).unwrap();
            }
        }
        writer => {
            for n in 0..APPENDS {
                let (key, payload) = record(writer, n);
                store.put_record(&key, &payload).unwrap();
                assert_eq!(store.put_blob(&payload).unwrap(), key);
                // Replaced entries, so that each process compacts while the other appends.
                store.put_record(&Digest::of(writer.as_bytes()), &vec![n as u8; 20_000]).unwrap();
                if n % 20 == 19 {
                    store.flush().unwrap();
                }
            }
        }
    }
}

#[test]
fn two_processes_and_two_handles_lose_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let watcher = open(folder.path());
    let mut children = ["left", "right"].map(|role| spawn(role, folder.path()));
    std::thread::scope(|scope| {
        for role in ["here", "there"] {
            let store = open(folder.path());
            scope.spawn(move || {
                for n in 0..APPENDS {
                    let (key, payload) = record(role, n);
                    store.put_record(&key, &payload).unwrap();
                    store.put_blob(&payload).unwrap();
                    assert_eq!(store.get_record(&key), Some(payload));
                }
            });
        }
    });
    children.iter_mut().for_each(|child| assert!(child.wait().unwrap().success()));
    for store in [watcher, open(folder.path())] {
        for role in ["left", "right", "here", "there"] {
            for n in 0..APPENDS {
                let (key, payload) = record(role, n);
                assert_eq!(store.get_record(&key).as_ref(), Some(&payload), "{role} {n}");
                assert_eq!(store.get_blob(&key).unwrap(), Some(payload), "{role} {n}");
            }
        }
        assert_eq!(store.take_incidents(), []);
    }
    let size = fs::metadata(folder.path().join("v1/records.log")).unwrap().len();
    assert!(size < 10_000_000, "compaction ran: {size} of {} bytes", APPENDS * 2 * 20_000);
}

#[test]
fn a_killed_holder_makes_way() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let key = Digest::of(b"leased");
    let mut child = spawn("hold", folder.path());
    wait_for_line(&mut child, "held");
    assert!(matches!(store.lease(&key), LeaseState::Busy));
    assert!(matches!(store.lease(&Digest::of(b"other")), LeaseState::Acquired(_)));
    let start = Instant::now();
    assert!(matches!(store.wait_for_lease(&key, Duration::from_millis(100), &|| false), LeaseState::Busy));
    assert!(start.elapsed() >= Duration::from_millis(100));
    assert!(matches!(store.wait_for_lease(&key, Duration::from_secs(60), &|| true), LeaseState::Busy));
    child.kill().unwrap();
    child.wait().unwrap();
    let LeaseState::Acquired(lease) = store.lease(&key) else { panic!("still busy") };
    assert!(matches!(store.lease(&key), LeaseState::Busy), "not even to ourselves");
    drop(lease);
    assert_eq!(fs::read_dir(folder.path().join("v1/leases")).unwrap().count(), 0);
}

#[test]
fn leases_exclude_through_many_removals_of_their_file() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("number"), "0").unwrap();
    let mut children = [(); 4].map(|()| spawn("count", folder.path()));
    children.iter_mut().for_each(|child| assert!(child.wait().unwrap().success()));
    assert_eq!(fs::read_to_string(folder.path().join("number")).unwrap(), "200");
}

#[test]
fn leases_that_cannot_be_locked_are_given_to_all() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    fs::write(folder.path().join("v1/leases"), b"a file in the way").unwrap();
    let (a, b) = (store.lease(&Digest::of(b"k")), store.lease(&Digest::of(b"k")));
    assert!(matches!((a, b), (LeaseState::Acquired(_), LeaseState::Acquired(_))));
}

#[test]
fn sweeping_removes_what_the_dead_left_and_nothing_of_the_living() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let leases = folder.path().join("v1/leases");
    let temp = folder.path().join("v1/temp");
    let LeaseState::Acquired(lease) = store.lease(&Digest::of(b"living")) else { panic!("busy") };
    fs::write(leases.join(Digest::of(b"dead").to_string()), b"").unwrap();
    let old = std::time::SystemTime::now() - Duration::from_secs(2 * 24 * 3600);
    for (name, time) in [(".1-1.lightharmony-temp", Some(old)), (".1-2.lightharmony-temp", None)] {
        let file = fs::File::create(temp.join(name)).unwrap();
        time.into_iter().for_each(|time| file.set_modified(time).unwrap());
    }
    assert_eq!(store.sweep(), 1);
    let count = |folder: &Path| fs::read_dir(folder).unwrap().count();
    assert_eq!((count(&leases), count(&temp)), (1, 1));
    assert!(matches!(store.lease(&Digest::of(b"living")), LeaseState::Busy));
    drop(lease);
    assert_eq!(count(&leases), 0);
}

#[test]
fn a_stopped_process_stops_nobody_for_long() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let stopped = fs::File::open(folder.path().join("v1/records.lock")).unwrap();
    stopped.lock().unwrap();
    let start = Instant::now();
    for n in 0..20 {
        let (key, payload) = record("here", n);
        store.put_record(&key, &payload).unwrap();
    }
    // One wait of two seconds; twenty waits would be forty seconds.
    assert!(start.elapsed() < Duration::from_secs(30), "waits once, not every time");
    let other = open(folder.path());
    drop(stopped);
    for n in 0..20 {
        let (key, payload) = record("here", n);
        assert_eq!(other.get_record(&key), Some(payload));
    }
}
