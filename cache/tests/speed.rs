//! Measures the time that cache operations take. To run the measurements, use `cargo test --release -p
//! lightharmony-cache --test speed -- --ignored --nocapture`.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement for people")]

use std::time::Instant;

use cache::{Digest, Fsync, KeyWriter, Options, Store};

fn best(name: &str, mut act: impl FnMut()) {
    let mut times: Vec<f64> = Vec::new();
    for _ in 0..15 {
        let start = Instant::now();
        act();
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    println!("{name}: best {:.2} ms, median {:.2} ms", times[0], times[7]);
}

fn key(n: u64) -> cache::Key {
    let mut walk = KeyWriter::new("splat-render");
    walk.u64("version", 1);
    walk.group("parameters", |walk| {
        for name in ["near", "far", "gamma", "lambda"] {
            walk.f64(name, n as f64);
        }
        walk.str("bounds", "Exact");
        walk.bool("sort", true);
        for name in ["width_px", "height_px", "samples", "sh_degree"] {
            walk.u64(name, n);
        }
    });
    walk.group("inputs", |walk| {
        walk.digest("splats", Digest::from_bytes([7; 32]));
        walk.digest("rig", Digest::from_bytes([8; 32]));
    });
    walk.str("profile", "portable");
    walk.finish().unwrap()
}

#[test]
#[ignore = "a measurement"]
fn speed() {
    const COUNT: u64 = 10_000;
    best("10,000 keys of 15 fields", || (0..COUNT).for_each(|n| drop(std::hint::black_box(key(n)))));
    best("10,000 manifests as text", || (0..COUNT).for_each(|n| drop(key(n).manifest.to_string())));

    let folder = tempfile::tempdir().unwrap();
    let keys: Vec<Digest> = (0..COUNT).map(|n| Digest::of(&n.to_le_bytes())).collect();
    let payload = vec![42; 600];
    let store = Store::open(folder.path(), Options::default()).unwrap();
    let start = Instant::now();
    keys.iter().for_each(|key| store.put_record(key, &payload).unwrap());
    println!("10,000 put_record of 600 bytes: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    let start = Instant::now();
    keys.iter().for_each(|key| assert!(store.put_blob(key.as_bytes()).is_ok()));
    println!("10,000 put_blob of 32 bytes: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    let start = Instant::now();
    keys.iter().for_each(|key| assert!(store.get_record(&Digest::of(key.as_bytes())).is_none()));
    println!("10,000 misses: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    let start = Instant::now();
    store.flush().unwrap();
    println!("flush: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);

    let open = || Store::open(folder.path(), Options::default()).unwrap();
    best("open with 10,000 records", || drop(open()));
    best("open and 10,000 get_record", || {
        let store = open();
        keys.iter().for_each(|key| assert!(store.get_record(key).is_some()));
    });
    let blobs: Vec<Digest> = keys.iter().map(|key| Digest::of(key.as_bytes())).collect();
    best("open and 10,000 has_blob of small blobs", || {
        let store = open();
        blobs.iter().for_each(|blob| assert!(store.has_blob(blob)));
    });
    best("open and 10,000 get_blob of small blobs", || {
        let store = open();
        blobs.iter().for_each(|blob| assert!(store.get_blob(blob).unwrap().is_some()));
    });

    for (name, fsync) in [("off", Fsync::Off), ("batch", Fsync::Batch), ("always", Fsync::Always)] {
        // The work of a run: a large value and its record, two hundred times, and the end of the run.
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), Options { fsync, read_only: false }).unwrap();
        let start = Instant::now();
        for n in 0..200_u64 {
            store.put_blob(&n.to_le_bytes().repeat(8192)).unwrap();
            store.put_record(&Digest::of(&n.to_le_bytes()), &payload).unwrap();
        }
        store.flush().unwrap();
        println!("fsync {name}: 200 results of 64 KiB: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    }

    let sources = tempfile::tempdir().unwrap();
    let paths: Vec<_> = (0..COUNT).map(|n| sources.path().join(format!("{n}.txt"))).collect();
    let old = std::time::SystemTime::now() - std::time::Duration::from_secs(100);
    for path in &paths {
        std::fs::write(path, b"source").unwrap();
        std::fs::File::options().write(true).open(path).unwrap().set_modified(old).unwrap();
    }
    std::thread::sleep(std::time::Duration::from_millis(2100));
    paths.iter().for_each(|path| assert!(store.digest_file(path).is_ok()));
    best("10,000 digest_file by memo", || {
        paths.iter().for_each(|path| assert!(store.digest_file(path).is_ok()));
    });
}
