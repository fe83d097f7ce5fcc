//! Tests of the names of nodes, frames and fields on the command line, and of the errors for wrong names.

use std::collections::BTreeSet;

use crate::Place;

/// A graph that renders six frames of a small picture, and a film of these frames.
const FRAMES: &str = r#"Graph(
    version: 1,
    scene: (up: "+z"),
    axes: (frame: Range(998, 1004)),
    nodes: (
        demo:   DemoScene(place: Courtyard, splats: 2000, width_px: 16, height_px: 16, truth_width_px: 32),
        camera: Camera(eye: (2.0, -2.5, Axis("frame")), target: (0.0, 0.0, 0.2), width_px: 16, height_px: 16, fov_y_deg: 40.0),
        view:   SplatRender(splats: "demo.splats", rig: "camera"),
        each:   WriteImage(image: "view", path: "f_{frame}_{frame:6}.png"),
        all:    Gather(input: "view", over: "frame"),
        film:   WriteAnimation(frames: "all", path: "film.png"),
    ),
)"#;

fn names(place: &Place) -> BTreeSet<String> {
    place.outputs().into_keys().collect()
}

#[test]
fn frames_are_named_by_ranges_and_keep_their_names() {
    let place = Place::new(FRAMES);
    let wanted = |frames: &[u32]| -> BTreeSet<String> {
        frames.iter().map(|frame| format!("f_{frame:04}_{frame:06}.png")).collect()
    };
    place.run(&["--frames", "999-1001"]).good();
    assert_eq!(names(&place), wanted(&[999, 1000, 1001]), "what gathers all frames is left alone");
    std::fs::remove_dir_all(place.path("out")).unwrap();
    place.run(&["--only", "each/frame=1000..1002"]).good();
    assert_eq!(names(&place), wanted(&[1000, 1001, 1002]));
    std::fs::remove_dir_all(place.path("out")).unwrap();
    place.run(&["--only", "each/frame=0999", "--frames", "998-1003"]).good();
    assert_eq!(names(&place), wanted(&[999]));
    // Frames that do not exist are named. This test fails if `at_frames` compares neither end of the range.
    for (range, says) in
        [("1003-1010", "the frames 998 to 1003"), ("990-998", "others of 990-998"), ("999-1000", "")]
    {
        let output = place.call(&["run", "graph.ron", "--frames", range]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success() && text.contains(says), "{range}: {text}");
        assert_eq!(text.contains("do not exist"), !says.is_empty(), "{range}: {text}");
    }
    for wrong in ["7-5", "x", "1-", "5000-6000"] {
        assert_eq!(place.call(&["run", "graph.ron", "--frames", wrong]).status.code(), Some(2), "{wrong}");
    }
}

#[test]
fn a_wrong_name_is_answered_with_a_near_one_that_exists() {
    let place = Place::new(FRAMES);
    let reported = |arguments: &[&str]| {
        let output = place.call(&[&["run", "graph.ron"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let text = reported(&["--only", "eech/frame=1000"]);
    assert!(text.contains("did you mean `each/frame=1000`?"), "{text}");
    assert!(text.contains("its nodes are demo, camera, view, each, film\n"), "each once: {text}");
    let text = reported(&["--only", "each/frame=3"]);
    assert!(
        text.contains(
            "`each` has no instance `frame=3`; it has instances at `frame` 998, 999, 1000, 1001, 1002, 1003"
        ),
        "{text}"
    );
    assert!(
        reported(&["--only", "demo/frame=3"]).contains("`demo` does not vary along an axis"),
        "not along the axis"
    );
    let text = reported(&["--set", "camera.eye=22,5,20"]);
    assert!(text.contains("in a shell: --set 'camera.eye=(22, 5, 20)'"), "{text}");
    let text = reported(&["--set", "camera.fov=20"]);
    assert!(text.contains("did you mean `fov_y_deg`?"), "{text}");
}

/// A kind of a feature that this build lacks is named with the feature.
#[cfg(not(feature = "video"))]
#[test]
fn a_kind_of_a_feature_is_named() {
    let place = Place::new(&FRAMES.replace(
        r#"WriteAnimation(frames: "all", path: "film.png")"#,
        r#"WriteVideo(frames: "all", path: "film.mp4")"#,
    ));
    let output = place.call(&["check", "graph.ron"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(
        text.contains("no kind of node is named `WriteVideo`") && text.contains("--features video"),
        "{text}"
    );
    assert!(!text.contains("did you mean"), "{text}");
}
