//! The verb `cache`, used as a person does.

use std::path::PathBuf;

use crate::Place;

const GRAPH: &str = r#"Graph(version: 1, scene: (up: "+z"), nodes: (
    pic:  LoadImage(path: "in.hdr"),
    save: WriteExr(image: "pic", path: "out.exr"),
))
"#;

/// A graph of one picture, run once.
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
    assert!(code == 0 && text.contains("2 records"), "{text}");
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
    assert!(code == 0 && text.contains("put aside"), "{text}");
    assert_eq!(printed(&place, &["verify"]).0, 0);
    std::fs::remove_dir_all(place.path("out")).unwrap();
    assert_eq!(place.run(&[]).good().nodes("ran"), ["save"]);
    assert!(place.outputs() == bytes);
}

#[test]
fn collecting_pinning_and_copying() {
    let place = place();
    let (code, text) = printed(&place, &["gc", "--max-size", "0", "--dry-run"]);
    assert!(code == 0 && text.starts_with("would remove 2 results"), "{text}");
    let (code, text) = printed(&place, &["copy", "--to", "other", "graph.ron"]);
    assert!(code == 0 && text.starts_with("copied 2 results"), "{text}");
    let (code, text) = printed(&place, &["copy", "--to", "whole"]);
    assert!(code == 0 && text.starts_with("copied 2 results"), "everything: {text}");
    assert_eq!(printed(&place, &["pin"]), (0, "nothing is pinned\n".to_owned()));
    let (code, text) = printed(&place, &["pin", "graph.ron"]);
    assert!(code == 0 && text.contains("2 of 2 results are known"), "{text}");
    let (code, text) = printed(&place, &["gc", "--max-size", "0"]);
    assert!(code == 0 && text.contains("2 results are pinned and stay"), "{text}");
    assert_eq!(place.run(&[]).good().nodes("cached"), ["pic", "save"]);
    assert!(printed(&place, &["stat"]).1.contains("graph.ron: 2 records"));
    assert_eq!(printed(&place, &["pin", "graph.ron", "--remove"]).0, 0);
    assert!(!printed(&place, &["stat"]).1.contains("graph.ron"));
    assert!(printed(&place, &["gc", "--max-size", "0"]).1.starts_with("removed 2 results"));
    assert_eq!(place.run(&["--cache", "other"]).good().nodes("cached"), ["pic", "save"], "from the copy");
    assert_eq!(place.run(&[]).good().nodes("ran"), ["pic", "save"]);
    assert!(printed(&place, &["gc", "--max-age", "1d"]).1.starts_with("removed 0 results"), "just used");
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
