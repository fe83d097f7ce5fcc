//! Tests with full disks and with folders that cannot be written. The disk is a small tmpfs, mounted in a namespace
//! of the child process. Where the system does not permit mounting it, the test prints a message and passes;
//! `kill.rs` simulates the same error on every system.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may panic and speak")]

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use cache::{Digest, Error, Fsync, Limits, Options, Store};

fn content(n: u32, length: usize) -> Vec<u8> {
    n.to_le_bytes().iter().copied().cycle().take(length).collect()
}

#[test]
#[ignore = "a part of the other test"]
fn child_on_a_small_disk() {
    let Some(folder) = std::env::var_os("CACHE_TEST_FOLDER") else { return };
    let folder = Path::new(&folder);
    for length in [200, 3000, 20_000] {
        let cache = folder.join(length.to_string());
        let open = || Store::open(&cache, Options { fsync: Fsync::Off, read_only: false }).unwrap();
        let store = open();
        let (mut blobs, mut records) = (Vec::new(), Vec::new());
        let mut errors = Vec::new();
        for n in 0..10_000 {
            let content = content(n, length);
            match store.put_blob(&content) {
                Ok(digest) => blobs.push((digest, content)),
                Err(error) => errors.push(error),
            }
            match store.put_record(&Digest::of(&n.to_le_bytes()), &n.to_be_bytes()) {
                Ok(()) => records.push(n),
                Err(error) => errors.push(error),
            }
            if errors.len() > 20 {
                break;
            }
        }
        assert!(errors.len() > 20, "the disk was never full");
        for error in &errors {
            assert!(matches!(error, Error::Full { .. }), "{error:?}");
            assert!(error.to_string().starts_with("disk full: cannot "), "{error}");
            assert!(error.to_string().contains(&*cache.to_string_lossy()), "{error}");
        }
        for store in [store, open()] {
            for (digest, content) in &blobs {
                assert_eq!(store.get_blob(digest).unwrap().as_ref(), Some(content));
            }
            for n in &records {
                assert_eq!(store.get_record(&Digest::of(&n.to_le_bytes())), Some(n.to_be_bytes().to_vec()));
            }
            let _ = store.take_incidents();
        }
        // A collection frees space if values are files. If they are in the log, which must be rewritten, it may
        // fail to free space, but does no harm.
        let names = |bytes: &[u8]| -> Vec<Digest> {
            let n = u32::from_be_bytes(*bytes.first_chunk().unwrap());
            vec![Digest::of(&content(n, length))]
        };
        let _ = fs::write(folder.join("rest"), vec![0; 1 << 20]);
        let store = open();
        let size = store.collect(&Limits { dry_run: true, ..Limits::default() }, &names, Duration::ZERO);
        let max_size = Some(size.unwrap().before / 3);
        match store.collect(&Limits { max_size, ..Limits::default() }, &names, Duration::ZERO) {
            Ok(gone) => assert!(gone.after < gone.before / 2 && gone.records > 0, "{gone:?}"),
            Err(error) => assert!(matches!(error, Error::Full { .. }) && length < 4096, "{error}"),
        }
        drop(store);
        let _ = fs::remove_file(folder.join("rest"));
        // No space even for an empty log.
        let _ = fs::write(folder.join("rest"), vec![0; 1 << 20]);
        let none = Store::open(&folder.join("more"), Options::default());
        assert!(matches!(&none, Ok(store) if store.is_read_only()), "{none:?}");
        let _ = fs::remove_file(folder.join("rest"));
        // With free space, the cache works again.
        let _ = (fs::remove_dir_all(cache.join("v1/blobs")), fs::remove_file(cache.join("v1/blobs.log")));
        let store = open();
        let digest = store.put_blob(&content(1, length)).unwrap();
        assert_eq!(store.get_blob(&digest).unwrap(), Some(content(1, length)));
        drop(store);
        fs::remove_dir_all(cache).unwrap();
    }
}

#[test]
fn a_full_disk_is_an_error_and_no_harm() {
    for size in ["64k", "300k", "1m"] {
        let folder = tempfile::tempdir().unwrap();
        let run = |script: &str| {
            let mut command = Command::new("unshare");
            command.args(["-Urm", "sh", "-c", script]).arg(std::env::current_exe().unwrap());
            command.env("CACHE_TEST_FOLDER", folder.path()).env("SIZE", size);
            command.output()
        };
        let mount = r#"mount -t tmpfs -o size=$SIZE none "$CACHE_TEST_FOLDER""#;
        if !run(mount).is_ok_and(|output| output.status.success()) {
            eprintln!("left out: no tmpfs can be mounted here");
            return;
        }
        let output =
            run(&format!(r#"{mount} && exec "$0" --exact child_on_a_small_disk --ignored"#)).unwrap();
        assert!(output.status.success(), "{size}: {}", String::from_utf8_lossy(&output.stdout));
    }
}

#[test]
#[ignore = "a part of the other test"]
fn child_without_rights() {
    let Some(folder) = std::env::var_os("CACHE_TEST_FOLDER") else { return };
    let store = Store::open(Path::new(&folder), Options::default()).unwrap();
    assert!(store.is_read_only());
    for length in [200, 20_000] {
        assert_eq!(store.get_blob(&Digest::of(&content(1, length))).unwrap(), Some(content(1, length)));
        let new = store.put_blob(&content(2, length)).unwrap();
        assert!(!store.has_blob(&new));
    }
    assert_eq!(store.get_record(&Digest::of(b"k")).as_deref(), Some(&b"record"[..]));
    store.put_record(&Digest::of(b"k"), b"changed").unwrap();
    store.flush().unwrap();
    assert_eq!(store.take_incidents(), []);
}

#[test]
fn a_folder_without_rights_is_read_only() {
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::process::CommandExt;
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let store = Store::open(&cache, Options::default()).unwrap();
    for length in [200, 20_000] {
        store.put_blob(&content(1, length)).unwrap();
    }
    store.put_record(&Digest::of(b"k"), b"record").unwrap();
    drop(store);
    let mode = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    let program = folder.path().join("program");
    // Copied by another process: a file handle of this one, open for writing, might be inherited by the child of
    // another test, and then the program could not be started.
    assert!(
        Command::new("cp").arg(std::env::current_exe().unwrap()).arg(&program).status().unwrap().success()
    );
    mode(folder.path(), 0o755);
    mode(&program, 0o755);
    // Once with writable files in read-only folders, once with read-only files.
    for files in [0o666, 0o444] {
        for name in ["records.log", "records.lock", "blobs.log", "blobs.lock"] {
            mode(&cache.join("v1").join(name), files);
        }
        for name in ["v1/temp", "v1/blobs", "v1", ""] {
            mode(&cache.join(name), 0o555);
        }
        let mut command = Command::new(&program);
        command.args(["--exact", "child_without_rights", "--ignored"]).env("CACHE_TEST_FOLDER", &cache);
        // Root can write anywhere, so run as nobody if that is permitted.
        let output = command.uid(65534).output().or_else(|_| {
            let mut command = Command::new(&program);
            command.args(["--exact", "child_without_rights", "--ignored"]);
            command.env("CACHE_TEST_FOLDER", &cache).output()
        });
        let output = output.unwrap();
        assert!(output.status.success(), "{files:o}: {}", String::from_utf8_lossy(&output.stdout));
    }
    for name in ["", "v1", "v1/blobs", "v1/temp"] {
        mode(&cache.join(name), 0o755);
    }
}
