//! Tests of a graph with twelve pictures of a rotating object. Nodes that the rotation does not affect run only
//! once.

use crate::{INSERT, Place};

/// A graph of a whole insertion, with the object at 12 angles.
fn turntable() -> String {
    INSERT
        .replace("nodes: (", "axes: (frame: Range(0, 12)),\n    nodes: (")
        .replace("yaw_deg: 30.0", "yaw_deg: Track(\"frame\", [(0, 0.0), (11, 330.0)])")
        .replace("samples: 4", "samples: 1")
        .replace("final.png", "final_{frame}.png")
        .replace("        layers:", "        all:    Gather(input: \"final\", over: \"frame\"),\n        layers:")
        .replace(
            "layers: WriteExr(layers: [\"final\", \"trace.without\", \"trace.with\", \"shadow\"], path: \"layers.exr\")",
            "film:   WriteAnimation(frames: \"all\", path: \"film.png\"),\n        sheet:  ContactSheet(images: \"all\")",
        )
        .replace("light.json", "light_{frame}.json")
}

#[test]
fn twelve_frames_share_what_the_turn_does_not_touch() {
    let place = Place::new(&turntable());
    let reported = place.run(&["--only", "save,film,sheet"]).good();
    let ran = reported.nodes("ran");
    let times = |name: &str| ran.iter().filter(|id| id.split('/').next() == Some(name)).count();
    for once in ["demo", "camera", "faces", "pano", "dark", "env", "view", "film", "sheet"] {
        assert_eq!(times(once), 1, "{once} in {ran:?}");
    }
    for each in ["trace", "shadow", "final", "save"] {
        assert_eq!(times(each), 12, "{each}");
    }
    // A frame equals the picture of a graph with that angle alone, including its recipe.
    let frames = place.outputs();
    let one = INSERT.replace("yaw_deg: 30.0", "yaw_deg: 90.0").replace("samples: 4", "samples: 1");
    let alone = Place::new(&one);
    alone.run(&["--only", "save"]).good();
    assert_eq!(frames["final_03.png"], alone.outputs()["final.png"]);
    assert_ne!(frames["final_03.png"], frames["final_04.png"]);
    assert!(frames.contains_key("film.png"));
    // Twelve more in between: the old ones come from the cache.
    let finer = place.run(&[
        "--only",
        "save",
        "--set",
        "axes.frame=Range(0, 12, 0.5)",
        "--set",
        "save.path=f_{frame}.png",
    ]);
    let again = finer.good();
    assert_eq!(again.nodes("ran").iter().filter(|id| id.starts_with("trace/")).count(), 11);
}
