//! Tests of `show`, of `inspect` with pictures, and of the help.

use crate::{INSERT, Place};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn any_node_is_shown_without_editing_the_graph() {
    let place = Place::new(INSERT);
    for (node, size) in [("trace.depth", (96, 54)), ("pano", (64, 32)), ("env", (64, 32)), ("faces", (0, 0))]
    {
        let output = place.call(&["show", "graph.ron", node]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert_eq!(text(&output.stdout), format!("out/{node}.png\n"));
        let shown = text(&place.call(&["inspect", &format!("out/{node}.png")]).stdout);
        if node == "faces" {
            // Six faces in a grid with gaps.
            assert!(shown.contains("104x68 pixels") || shown.contains("68x104 pixels"), "{shown}");
        } else {
            assert!(shown.contains(&format!("{}x{} pixels", size.0, size.1)), "{shown}");
        }
    }
    for (wrong, why) in [
        ("demo.rig", "`demo.rig` has the type rig"),
        ("trace.deep", "`trace` has no output `deep`; its outputs are"),
        ("nobody", "no node `nobody`"),
    ] {
        let output = place.call(&["show", "graph.ron", wrong]);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains(why), "{}", text(&output.stderr));
    }
}

/// Meshes, splats and objects are drawn from above and in views, whose cameras are printed.
#[test]
fn scenes_are_shown_with_cameras_to_paste() {
    let place = Place::new(INSERT);
    for node in ["demo.proxy", "demo.splats", "demo.object", "placed"] {
        let output = place.call(&["show", "graph.ron", node]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let printed = text(&output.stdout);
        assert!(printed.starts_with(&format!("out/{node}.png\n")), "{printed}");
        assert!(printed.contains("view 1  Camera(eye: ("), "{printed}");
        assert!(std::fs::read(place.path(&format!("out/{node}.png"))).unwrap().starts_with(b"\x89PNG"));
    }
}

/// Thumbnails are those of results in the cache, and only of nodes with pictures.
#[test]
fn a_drawing_of_a_graph_has_thumbnails_of_known_pictures() {
    let place = Place::new(INSERT);
    let drawn = |more: &[&str]| {
        let output = place.call(&[&["graph", "graph.ron", "--format", "svg"], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout).matches("<image x=").count()
    };
    assert_eq!(drawn(&["--thumbnails"]), 0, "nothing was computed");
    assert_eq!(place.call(&["run", "graph.ron", "--only", "pano"]).status.code(), Some(0));
    assert_eq!(drawn(&["--thumbnails"]), 3, "the light of `demo`, `faces` and `pano`");
    assert_eq!(drawn(&[]), 0);
    let output = place.call(&["graph", "graph.ron", "--thumbnails"]);
    assert_eq!(output.status.code(), Some(2), "Graphviz gets no pictures");
}

/// The same pixel in a view of the splats and in a view of the mesh gives the same point of the floor.
#[test]
fn a_pixel_gives_the_point_that_it_shows() {
    let place = Place::new(INSERT);
    let picked = |view: &str| {
        let output = place.call(&["pick", "graph.ron", view, "30,45"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let printed = text(&output.stdout);
        let position = printed.lines().next().unwrap().trim_start_matches("position").trim().to_owned();
        let numbers = position.trim_matches(['(', ')']).split(", ").map(|n| n.parse::<f64>().unwrap());
        (numbers.collect::<Vec<_>>(), printed)
    };
    let (on_mesh, printed) = picked("trace");
    assert!(
        printed.contains("or  Pose(pixel: Some((30.0, 45.0)), rig: \"camera\", mesh: \"demo.proxy\")"),
        "{printed}"
    );
    assert!(on_mesh[2].abs() < 0.02, "the floor: {on_mesh:?}");
    // The option moves the object and keeps its direction and size.
    let set = printed.lines().find_map(|line| line.trim().strip_prefix("or  --set '")).unwrap_or_default();
    let set = set.split_once('\'').unwrap_or_default().0;
    assert!(set.starts_with("pose.translation=("), "{printed}");
    assert_eq!(place.call(&["check", "graph.ron", "--set", set]).status.code(), Some(0));
    let (on_splats, printed) = picked("view");
    assert!(printed.contains("splats: \"demo.splats\")"), "{printed}");
    let apart = (0..3).map(|k| (on_mesh[k] - on_splats[k]).abs()).fold(0.0, f64::max);
    assert!(apart < 0.1, "4000 splats are 10 cm apart: {on_mesh:?} {on_splats:?}");
    let both = place.call(&["pick", "graph.ron", "trace", "30,45", "60,45"]);
    let printed = text(&both.stdout);
    let distance = printed.lines().find_map(|line| line.strip_prefix("distance")).unwrap().trim().to_owned();
    let units: f64 = distance.split(' ').next().unwrap().parse().unwrap();
    assert!(units > 0.1 && distance.contains(" m with this scene"), "{distance}");
    for (arguments, why) in [
        (["view", "96.5,3"], "lies outside"),
        (["view", "here"], "is not the position of a pixel"),
        (["final", "1,1"], "is not a view of the scene"),
    ] {
        let output = place.call(&[&["pick", "graph.ron"], &arguments[..]].concat());
        assert_ne!(output.status.code(), Some(0));
        assert!(text(&output.stderr).contains(why), "{}", text(&output.stderr));
    }
}

#[test]
fn plates_and_cameras_are_compared_before_a_run() {
    let place = Place::new(INSERT);
    assert_eq!(place.call(&["check", "graph.ron"]).status.code(), Some(0));
    place.run(&["--only", "save"]).good();
    let plate = INSERT
        .replace("nodes: (", "nodes: (plate: LoadImage(path: \"out/final.png\"),")
        .replace("background: \"view\"", "background: \"plate\"")
        .replace("width_px: 96, height_px: 54, fov", "width_px: 48, height_px: 54, fov");
    place.write(&plate);
    let output = place.call(&["check", "graph.ron"]);
    assert_eq!(output.status.code(), Some(2));
    let errors = text(&output.stderr);
    assert!(errors.contains("`object` is 48x54 pixels, but `background` is 96x54"), "{errors}");
}

#[test]
fn help_has_groups_and_an_example() {
    let help = text(&Place::new("").call(&["--help"]).stdout);
    for part in
        ["Run a graph:\n", "Share and reproduce:\n", "Example:\n", "lightharmony run graph.ron", "Options:"]
    {
        assert!(help.contains(part), "{part} is missing in\n{help}");
    }
    let list = text(&Place::new("").call(&["nodes"]).stdout);
    assert!(list.starts_with("load\n") && list.contains("\nwrite\n"), "{list}");
    assert!(text(&Place::new("").call(&["nodes", "shadow"]).stdout).contains("shadow-ratio"));
}
