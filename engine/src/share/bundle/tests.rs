use std::io::Cursor;
use std::time::{Duration, Instant};

use super::*;

/// A bundle that contains every type of part.
fn bundle() -> Vec<u8> {
    let mut parts = BundleParts::default();
    parts.file("graph.ron", b"Graph()".to_vec());
    parts.file("graph.lock", b"Lock()".to_vec());
    parts.file("inputs/0/a.ply", vec![7; 300]);
    parts.file("inputs/1/a.ply", vec![7; 300]);
    parts.file("empty", Vec::new());
    parts.record(Digest::of(b"key"), b"a record".to_vec());
    parts.value(b"a value".to_vec());
    let mut bytes = Vec::new();
    parts.write(&mut bytes).unwrap_or_else(|e| panic!("{e}"));
    bytes
}

/// Opens and unpacks a bundle. Returns the names of the unpacked files. Fails if any other file remains, even after
/// an error.
fn unpack(bytes: &[u8]) -> Result<Vec<String>, BundleError> {
    let place = tempfile::tempdir().expect("a folder");
    let target = place.path().join("target");
    let result = Bundle::open(Cursor::new(bytes)).and_then(|mut bundle| {
        bundle.unpack(&target)?;
        bundle.check()
    });
    let list = |folder: &std::path::Path| {
        let entries = std::fs::read_dir(folder).expect("a folder");
        let mut names: Vec<String> =
            entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    };
    match result {
        Ok(()) => assert_eq!(list(place.path()), ["target"]),
        // A damaged value is detected when it is read; the graph is complete.
        Err(_) => assert!(list(place.path()).is_empty() || list(place.path()) == ["target"]),
    }
    result.map(|()| list(&target))
}

/// A bundle with this index and these blobs, and a valid header.
fn sealed(index: &[u8], contents: &[u8]) -> Vec<u8> {
    [&head(index), index, contents].concat()
}

/// An index with one blob, to which all `names` refer.
fn index(names: &[&str], content: &[u8]) -> Vec<u8> {
    let mut to = Encoder::default();
    to.u64(1);
    digest(&mut to, &Digest::of(content));
    to.u64(content.len() as u64);
    to.u64(names.len() as u64);
    for name in names {
        to.str(name);
        to.u32(0);
    }
    to.u64(0);
    to.u64(0);
    to.finish()
}

#[test]
fn what_was_packed_comes_out_and_the_bytes_are_the_same() {
    let bytes = bundle();
    assert_eq!(bytes, bundle());
    let names = unpack(&bytes).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(names, [".lightharmony-bundle", "empty", "graph.lock", "graph.ron", "inputs"]);
    let bundle = Bundle::open(Cursor::new(&bytes)).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(bundle.results(), (1, 1));
    assert_eq!(bundle.contents.len(), 6, "equal contents are held once");
}

#[test]
fn every_cut_and_every_flip_is_noticed() {
    let bytes = bundle();
    for end in 0..bytes.len() {
        assert!(unpack(&bytes[..end]).is_err(), "cut at {end}");
    }
    for at in 0..bytes.len() {
        let mut hurt = bytes.clone();
        hurt[at] ^= 1 << (at % 8);
        assert!(unpack(&hurt).is_err(), "flip at {at}");
    }
    assert!(unpack(&[bytes, vec![0]].concat()).is_err(), "one byte more");
}

#[test]
fn hostile_names_are_refused_before_anything_is_written() {
    let good = ["graph.lock", "graph.ron"];
    assert!(unpack(&sealed(&index(&good, b"x"), b"x")).is_ok());
    for bad in ["../out", "/etc/passwd", "a/../../b", "c:\\x", "a\0", "con", "z/", "x/./y"] {
        let mut names = good.to_vec();
        names.push(bad);
        names.sort_unstable();
        let error = unpack(&sealed(&index(&names, b"x"), b"x")).expect_err(bad);
        assert!(matches!(error, BundleError::Name { .. }), "{bad}: {error}");
    }
    for pair in [["a", "a"], ["A", "a"], ["a", "a/b"], ["b", "a"]] {
        assert!(unpack(&sealed(&index(&pair, b"x"), b"x")).is_err(), "{pair:?}");
    }
}

#[test]
fn sizes_are_not_believed() {
    let huge = |count: u64, length: u64| {
        let mut to = Encoder::default();
        to.u64(count);
        digest(&mut to, &Digest::of(b""));
        to.u64(length);
        to.finish()
    };
    for (count, length) in [(u64::MAX, 0), (1 << 40, 0), (1, u64::MAX), (1, 1 << 50), (2, u64::MAX)] {
        assert!(Bundle::open(Cursor::new(sealed(&huge(count, length), b""))).is_err());
    }
    let mut long = sealed(b"", b"");
    long[12..20].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(Bundle::open(Cursor::new(long)).is_err());
}

/// Mutates the index of a bundle and corrects its digest, so that the code behind the digest check is reached. No
/// mutation may panic or leave a file. For a longer run: `LIGHTHARMONY_FUZZ_SECONDS=600 cargo test --release -p
/// lightharmony-engine mutations`.
#[test]
fn mutations_of_the_index_never_panic_and_leave_nothing() {
    let bytes = bundle();
    let end = HEAD + u64::from_le_bytes(*bytes[12..].first_chunk().expect("a head")) as usize;
    let seconds = std::env::var("LIGHTHARMONY_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let until = seconds.map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let (mut opened, mut rounds) = (0, 0);
    for round in (0_u64..).take_while(|round| until.map_or(*round < 3000, |until| Instant::now() < until)) {
        rounds += 1;
        let dice = Digest::of(&round.to_le_bytes());
        let mut dice = dice.as_bytes().iter().map(|byte| usize::from(*byte));
        let mut roll =
            |sides: usize| (dice.next().unwrap_or(0) * 256 + dice.next().unwrap_or(0)) % sides.max(1);
        let mut index = bytes[HEAD..end].to_vec();
        for _ in 0..=roll(3) {
            let at = roll(index.len());
            match roll(6) {
                0 => index[at] ^= 1 << roll(8),
                1 => index[at] = [0, 1, 0x7f, 0xff, b'.', b'/', b'\\'][roll(7)],
                2 => drop(index.remove(at)),
                3 => index.insert(at, roll(256) as u8),
                4 => index.truncate(at),
                _ => {
                    let from = roll(index.len());
                    let piece = index[from..(from + 48).min(index.len())].to_vec();
                    index.splice(at..at, piece);
                }
            }
            if index.is_empty() {
                break;
            }
        }
        opened += usize::from(unpack(&sealed(&index, &bytes[end..])).is_ok());
    }
    assert!(opened < rounds, "most of them are not bundles");
}
