//! Tests of the command `cache`.

use std::path::PathBuf;

use crate::Place;

const GRAPH: &str = r#"Graph(version: 1, scene: (up: "+z"), nodes: (
    pic:  LoadImage(path: "in.hdr"),
    save: WriteExr(image: "pic", path: "out.exr"),
))
"#;

/// A test folder whose graph writes one picture and has run once.
fn place() -> Place {
    let place = Place::new(GRAPH);
    let mut picture = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 64\n".to_vec();
    picture.extend((0..64 * 64_u32).flat_map(|n| [(n % 251) as u8, (n % 241) as u8, 90, 128]));
    std::fs::write(place.path("in.hdr"), picture).unwrap();
    place.run(&[]).good();
    place
}

fn printed(place: &Place, arguments: &[&str]) -> (i32, String) {
    let output = place.call(&[&["cache"], arguments].concat());
    let text = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(text).unwrap())
}

fn large_blobs(place: &Place) -> Vec<PathBuf> {
    let folders = std::fs::read_dir(place.path("cache/v1/blobs")).into_iter().flatten().flatten();
    folders
        .flat_map(|folder| std::fs::read_dir(folder.path()).unwrap())
        .map(|file| file.unwrap().path())
        .collect()
}

#[test]
fn damage_is_named_put_aside_and_made_again() {
    let place = place();
    let bytes = place.outputs();
    let (code, text) = printed(&place, &["stat"]);
    assert!(code == 0 && text.contains("results  2\n"), "{text}");
    assert_eq!(printed(&place, &["verify"]).0, 0);
    let blobs = large_blobs(&place);
    assert_eq!(blobs.len(), 1, "the file of the sink");
    std::fs::write(&blobs[0], b"nonsense").unwrap();
    for _ in 0..2 {
        let (code, text) = printed(&place, &["verify"]);
        assert_eq!((code, text.matches("damaged: value").count()), (1, 1), "{text}");
        assert!(text.contains(blobs[0].file_name().unwrap().to_str().unwrap()), "{text}");
    }
    let (code, text) = printed(&place, &["repair"]);
    assert!(code == 0 && text.contains("moved aside"), "{text}");
    assert_eq!(printed(&place, &["verify"]).0, 0);
    std::fs::remove_dir_all(place.path("out")).unwrap();
    assert_eq!(place.run(&[]).good().nodes("ran"), ["save"]);
    assert!(place.outputs() == bytes);
}

#[test]
fn collecting_pinning_and_copying() {
    let place = place();
    let (code, text) = printed(&place, &["gc", "--max-size", "0", "--dry-run"]);
    assert!(code == 0 && text.starts_with("would be removed: results 2,"), "{text}");
    let (code, text) = printed(&place, &["copy", "--to", "other", "graph.ron"]);
    assert!(code == 0 && text.starts_with("copied to other (results: 2)"), "{text}");
    let (code, text) = printed(&place, &["copy", "--to", "whole"]);
    assert!(code == 0 && text.starts_with("copied to whole (results: 2)"), "everything: {text}");
    assert_eq!(printed(&place, &["pin"]), (0, "nothing is pinned\n".to_owned()));
    let (code, text) = printed(&place, &["pin", "graph.ron"]);
    assert!(code == 0 && text.contains("graph.ron (known results: 2, nodes: 2)"), "{text}");
    let (code, text) = printed(&place, &["gc", "--max-size", "0"]);
    assert!(code == 0 && text.contains("pinned results, which are kept: 2\n"), "{text}");
    assert_eq!(place.run(&[]).good().nodes("cached"), ["pic", "save"]);
    assert!(printed(&place, &["stat"]).1.contains("graph.ron (results: 2)\n"));
    assert_eq!(printed(&place, &["pin", "graph.ron", "--remove"]).0, 0);
    assert!(!printed(&place, &["stat"]).1.contains("graph.ron"));
    assert!(printed(&place, &["gc", "--max-size", "0"]).1.starts_with("removed: results 2,"));
    assert_eq!(place.run(&["--cache", "other"]).good().nodes("cached"), ["pic", "save"], "from the copy");
    assert_eq!(place.run(&[]).good().nodes("ran"), ["pic", "save"]);
    assert!(printed(&place, &["gc", "--max-age", "1d"]).1.starts_with("removed: results 0,"), "just used");
}

#[test]
fn wrong_arguments_say_what_to_write() {
    let place = place();
    let (code, text) = printed(&place, &["gc", "--max-age", "soon"]);
    assert!(code == 2 && text.contains("`soon` is not a time"), "{text}");
    let (code, text) = printed(&place, &["gc", "--max-size", "much"]);
    assert!(code == 2 && text.contains("`much` is not a size"), "{text}");
    let (code, text) = printed(&place, &["stat", "--cache", "nowhere"]);
    assert!(code == 2 && text.contains("there is no cache in `nowhere`"), "{text}");
    assert!(!place.path("nowhere").exists());
    for fsync in ["always", "off", "batch"] {
        place.run(&["--fsync", fsync]).good();
    }
}

#[test]
fn a_collection_where_no_cache_is_yet_succeeds() {
    let place = place();
    let (code, text) = printed(&place, &["gc", "--max-size", "1G", "--cache", "nowhere"]);
    assert!(code == 0 && text.contains("no cache in `nowhere` yet"), "{code}: {text}");
    assert!(!place.path("nowhere").exists());
}

#[test]
fn a_run_without_a_usable_cache_says_so_and_completes() {
    let place = place();
    let bytes = place.outputs();
    std::fs::remove_dir_all(place.path("out")).unwrap();
    // A file in place of the cache folder, and a file in place of the folder of the current format within the
    // cache.
    std::fs::write(place.path("file"), b"a file").unwrap();
    std::fs::create_dir(place.path("odd")).unwrap();
    std::fs::write(place.path("odd/v1"), b"a file").unwrap();
    for cache in ["file", "odd"] {
        let reported = place.run(&["--cache", cache]).good();
        let warned: Vec<_> = reported.events.iter().filter(|event| event["event"] == "warning").collect();
        assert_eq!(warned.len(), 1, "{warned:?}");
        let text = warned[0]["text"].as_str().unwrap();
        assert!(text.contains(cache) && text.contains("LIGHTHARMONY_CACHE"), "{text}");
        assert!(place.outputs() == bytes);
        std::fs::remove_dir_all(place.path("out")).unwrap();
        // Other commands do not fail either.
        assert_eq!(place.call(&["plan", "graph.ron", "--cache", cache]).status.code(), Some(0));
    }
    assert_eq!(std::fs::read(place.path("file")).unwrap(), b"a file");
}

#[cfg(unix)]
#[test]
fn a_file_size_limit_is_an_error_with_a_message() {
    let place = place();
    std::fs::remove_dir_all(place.path("out")).unwrap();
    let script = "ulimit -f 4; exec \"$0\" run graph.ron --cache small";
    let mut command = std::process::Command::new("sh");
    command.args(["-c", script]).arg(env!("CARGO_BIN_EXE_lightharmony")).current_dir(place.folder.path());
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("file size limit reached (`ulimit -f`)") && text.contains("out.exr"), "{text}");
    place.run(&["--cache", "small"]).good();
}
