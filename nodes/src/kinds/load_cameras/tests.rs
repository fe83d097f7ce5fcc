mod applied;
mod lenses;
mod models;
mod nerfstudio;

use super::*;
use engine::{Scene, Up};
use glam::DVec3;
use scene::types::pick::matches;

fn node(path: &str) -> LoadCameras {
    LoadCameras::of(InputFile(path.into()))
}

fn load(files: &[(&str, &[u8])], p: &LoadCameras) -> Result<(Vec<Camera>, Notes), NodeError> {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    for (name, bytes) in files {
        let path = folder.path().join(name);
        path.parent().map(std::fs::create_dir_all).transpose().unwrap_or_else(|e| panic!("{e}"));
        std::fs::write(path, bytes).unwrap_or_else(|e| panic!("{e}"));
    }
    LoadCameras::sources(p, &SourceRoot::new(folder.path()))?;
    let cx = Context::detached(
        Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false },
        folder.path(),
    );
    LoadCameras::run(p, In {}, &cx).map(|(out, notes)| (out.rig.cameras.clone(), notes))
}

// One camera at (1, 2, 3), turned a quarter about z: its x is +y of the world, its y is -x.
const OWN: &str = r#"{"views": [{"name": "a", "w": 40, "h": 30, "fx": 50, "fy": 51, "cx": 20.5, "cy": 14,
    "c2w_opencv": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
const OPENGL: &str = r#"{"views": [{"name": "a", "w": 40, "h": 30, "fx": 50, "fy": 51, "cx": 20.5, "cy": 14,
    "c2w_opengl": [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]}]}"#;
const STUDIO: &str = r#"{"w": 40.0, "h": 30, "fl_x": 50, "fl_y": 51, "cx": 20.5, "cy": 14, "k1": 0.0, "frames":
    [{"file_path": "images/a.png", "transform_matrix": [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]}]}"#;
const INRIA: &str = r#"[{"id": 0, "img_name": "a", "width": 40, "height": 30, "fx": 50, "fy": 51,
    "position": [1, 2, 3], "rotation": [[0, -1, 0], [1, 0, 0], [0, 0, 1]]}]"#;
const CAMERAS: &str = "# id\n7 PINHOLE 40 30 50 51 20.5 14\n";

/// Text of an `images.txt` that describes the same camera by its transform from world to camera: a rotation R by
/// -90 degrees and the translation -R (1, 2, 3) = (-2, 1, -3).
fn images() -> String {
    let h = 0.5_f64.sqrt();
    format!("# id\n3 {h} 0 0 -{h} -2 1 -3 7 set/a.png\n1 2 -1 3 4 -1\n4 1 0 0 0 0 0 0 7 a b.png\n\n")
}

fn binary_files() -> (Vec<u8>, Vec<u8>) {
    let h = 0.5_f64.sqrt();
    let mut cameras: Vec<u8> = 1_u64.to_le_bytes().to_vec();
    cameras.extend([7_u32, 1].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([40_u64, 30].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([50.0_f64, 51.0, 20.5, 14.0].iter().flat_map(|v| v.to_le_bytes()));
    let mut images: Vec<u8> = 1_u64.to_le_bytes().to_vec();
    images.extend(3_u32.to_le_bytes());
    images.extend([h, 0.0, 0.0, -h, -2.0, 1.0, -3.0].iter().flat_map(|v: &f64| v.to_le_bytes()));
    images.extend(7_u32.to_le_bytes());
    images.extend(b"set/a.png\0");
    images.extend(1_u64.to_le_bytes());
    images.extend([0; 24]);
    (cameras, images)
}

fn near(a: &Camera, b: &Camera) -> bool {
    let close = |x: f64, y: f64| (x - y).abs() < 1e-12;
    (&a.name, a.width_px, a.height_px) == (&b.name, b.width_px, b.height_px)
        && close(a.fx, b.fx)
        && close(a.cy, b.cy)
        && a.world_from_camera.iter().zip(&b.world_from_camera).all(|(x, y)| close(*x, *y))
}

#[test]
fn six_ways_to_write_one_camera() {
    let own = load(&[("a.json", OWN.as_bytes())], &node("a.json")).unwrap_or_else(|e| panic!("{e}")).0;
    let [camera] = own.as_slice() else { panic!("one camera") };
    assert_eq!(camera.eye(), DVec3::new(1.0, 2.0, 3.0));
    assert_eq!(camera.world_from_camera().transform_vector3(DVec3::X), DVec3::Y);
    let (cameras, images_bin) = binary_files();
    let text = images();
    type Files<'a> = &'a [(&'a str, &'a [u8])];
    let ways: [(&str, Files<'_>); 5] = [
        ("a.json", &[("a.json", OPENGL.as_bytes())]),
        ("transforms.json", &[("transforms.json", STUDIO.as_bytes())]),
        ("m", &[("m/sparse/0/cameras.txt", CAMERAS.as_bytes()), ("m/sparse/0/images.txt", text.as_bytes())]),
        ("m/images.bin", &[("m/cameras.bin", &cameras), ("m/images.bin", &images_bin)]),
        ("c.json", &[("c.json", INRIA.as_bytes())]),
    ];
    for (path, files) in ways {
        let (found, _) = load(files, &node(path)).unwrap_or_else(|e| panic!("{path}: {e}"));
        let same = found.iter().find(|c| c.name == "a").unwrap_or_else(|| panic!("{path}: {found:?}"));
        let mut same = same.clone();
        if path == "c.json" {
            // INRIA's file has no principal point; it is the middle.
            assert_eq!((same.cx, same.cy), (20.0, 15.0));
            (same.cx, same.cy) = (camera.cx, camera.cy);
        }
        assert!(near(&same, camera), "{path}: {same:?}");
    }
}

#[test]
fn distortion_is_refused_or_reported() {
    let bent = STUDIO.replace("\"k1\": 0.0", "\"k1\": 0.1");
    let files: [(&str, &[u8]); 1] = [("t.json", bent.as_bytes())];
    assert!(load(&files, &node("t.json")).is_err());
    let ignore = LoadCameras { distortion: Distortion::Ignore, ..node("t.json") };
    assert!(load(&files, &ignore).is_ok_and(|(_, notes)| notes.is_degraded()));
    let straight = "7 OPENCV 40 30 50 51 20.5 14 0 0 0 0\n";
    let (text, fish) = (images(), straight.replace("OPENCV", "OPENCV_FISHEYE"));
    let colmap = |cameras: &str| {
        load(&[("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", text.as_bytes())], &node("m"))
    };
    assert!(colmap(straight).is_ok());
    assert!(colmap(&fish).is_err(), "a fisheye bends even with zeros");
    assert!(colmap("7 SIMPLE_RADIAL 40 30 50 20 15 0.01\n").is_err());
    // A model that is not a perspective camera is refused by name, even with `Ignore`.
    let model = |name: &str, p: &LoadCameras| {
        let text = STUDIO.replace("\"k1\": 0.0", &format!("\"camera_model\": \"{name}\""));
        load(&[("t.json", text.as_bytes())], p)
    };
    let refused = model("EQUIRECTANGULAR", &ignore).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(refused.contains("`EQUIRECTANGULAR`"), "{refused}");
    let fish = model("OPENCV_FISHEYE", &node("t.json")).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(fish.contains("distortion (OPENCV_FISHEYE)"), "{fish}");
    assert!(model("OPENCV_FISHEYE", &ignore).is_ok_and(|(_, notes)| notes.is_degraded()));
}

// COLMAP writes a line of points after each camera, even if it is empty; other programs leave such lines out.
#[test]
fn cameras_without_lines_of_points_are_all_there() {
    let pose = "1 0 0 0 0 0 0 7";
    for text in [
        format!("1 {pose} a.png\n2 {pose} b.png\n3 {pose} c d.png\n"),
        format!("1 {pose} a.png\n\n2 {pose} b.png\n10.5 20 -1\n3 {pose} c d.png\n\n"),
        format!("# x\n1 {pose} a.png\n1 2 3 4 5 -1 7 8 9\n2 {pose} b.png\n3 {pose} c d.png\n1 2 3"),
    ] {
        let files = [("m/cameras.txt", CAMERAS.as_bytes()), ("m/images.txt", text.as_bytes())];
        let (found, _) = load(&files, &node("m")).unwrap_or_else(|e| panic!("{e}"));
        let names: Vec<&str> = found.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c d"], "{text}");
    }
    for text in [format!("1 {pose} a.png\n1 2\n"), format!("x {pose} a.png\n"), "1 2 3 4\n".to_owned()] {
        let files = [("m/cameras.txt", CAMERAS.as_bytes()), ("m/images.txt", text.as_bytes())];
        assert!(load(&files, &node("m")).is_err(), "{text}");
    }
}

#[test]
fn picks_names_globs_and_ranges() {
    let pictures = ["view_0", "view_1", "day/left.png", "view_10"];
    let names = view_names(&pictures);
    let pick = |wishes: &[&str]| {
        chosen(&wishes.iter().map(|w| Pick::from(*w)).collect::<Vec<_>>(), &names, &pictures).ok()
    };
    assert_eq!(pick(&[]), Some(vec![0, 1, 2, 3]));
    assert_eq!(pick(&["left", "view_?"]), Some(vec![2, 0, 1]));
    assert_eq!(pick(&["view_1*"]), Some(vec![1, 3]));
    assert_eq!(pick(&["day/*", "day/left.png", "day/left"]), Some(vec![2]));
    assert_eq!(pick(&["0..4..2"]), Some(vec![0, 2]));
    assert_eq!(pick(&["1..", "*"]), Some(vec![1, 2, 3, 0]));
    assert_eq!(pick(&["right"]), None);
    assert_eq!(pick(&["9..12"]), None);
    assert!(matches("*a*b", "xxaxxab") && !matches("*a*b", "xxaxx") && matches("*", ""));
}

#[test]
fn resolution_keeps_the_field_of_view() {
    let p = LoadCameras { resolution: 0.33, ..node("a.json") };
    let (cameras, _) = load(&[("a.json", OWN.as_bytes())], &p).unwrap_or_else(|e| panic!("{e}"));
    let c = &cameras[0];
    assert_eq!((c.width_px, c.height_px), (13, 10));
    assert!((c.fx / 13.0 - 50.0 / 40.0).abs() < 1e-12 && (c.cy / 10.0 - 14.0 / 30.0).abs() < 1e-12);
}

#[test]
fn names_become_view_names() {
    for (picture, name) in [
        ("a/b/IMG_1.JPG", "IMG_1"),
        ("frame.0001", "frame.0001"),
        ("x{view}.png", "x_view_"),
        ("..", "camera"),
        (".png", ".png"),
    ] {
        assert_eq!(view_names(&[picture]), [name]);
    }
    // As many folders as needed to distinguish them, and none otherwise. This test fails if `..=deepest` is changed
    // to `..deepest`.
    let clash = ["a/x/1.png", "b/x/1.png", "b\\y\\1.png", "b/2.png"];
    assert_eq!(view_names(&clash), ["a_x_1", "b_x_1", "y_1", "2"]);
    assert_eq!(view_names(&["s/1.png", "s/1.jpg"]), ["s_1", "s_1"]);
}

/// Pictures of the same name in two folders are distinguished by the folder. Two cameras with the same picture can
/// only be distinguished by their index.
#[test]
fn pictures_of_one_name_keep_their_folders() {
    let set = |paths: [&str; 2]| {
        let pose = "[[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]";
        let frames = paths.map(|path| format!(r#"{{"file_path": "{path}", "transform_matrix": {pose}}}"#));
        format!(r#"{{"w": 40, "h": 30, "fl_x": 50, "fl_y": 51, "frames": [{}]}}"#, frames.join(","))
    };
    let of = |paths, picked: &[&str]| {
        let pick = picked.iter().map(|wish| Pick::from(*wish)).collect();
        let loaded = load(&[("t.json", set(paths).as_bytes())], &LoadCameras { pick, ..node("t.json") });
        loaded.map(|(cameras, _)| cameras.into_iter().map(|camera| camera.name).collect::<Vec<_>>())
    };
    let days = ["day1/IMG_1.jpg", "day2/IMG_1.jpg"];
    assert_eq!(of(days, &[]).unwrap_or_default(), ["day1_IMG_1", "day2_IMG_1"]);
    assert_eq!(of(days, &["day2/IMG_1"]).unwrap_or_default(), ["day2_IMG_1"]);
    let reported = of(["a.jpg"; 2], &[]).expect_err("are alike");
    assert!(format!("{reported:?}").contains("3..4"), "{reported:?}");
    assert_eq!(of(["a.jpg"; 2], &["1..2"]).unwrap_or_default(), ["a"]);
}

#[test]
fn hostile_files_are_errors() {
    let (cameras, images_bin) = binary_files();
    for end in 0..cameras.len() {
        assert!(colmap::binary("m", &cameras[..end], &images_bin).is_err());
    }
    for end in 0..images_bin.len() {
        assert!(colmap::binary("m", &cameras, &images_bin[..end]).is_err());
    }
    let mut many = images_bin;
    many[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(colmap::binary("m", &cameras, &many).is_err());
    for text in [OWN, OPENGL, STUDIO, INRIA] {
        for end in 0..text.len() - 1 {
            assert!(
                json::read(
                    "a",
                    &text.as_bytes()[..end],
                    "views",
                    &|_| Err("is missing".to_owned()),
                    &mut Notes::none()
                )
                .is_err()
            );
        }
    }
    for (from, to) in [
        ("1, 2, 3]", "1, 2]"),
        ("[0, -1, 0]", "[0, -2, 0]"),
        ("[0, -1, 0]", "[0, 1, 0]"),
        ("50", "-50"),
        ("40", "0"),
    ] {
        let hurt = INRIA.replace(from, to);
        assert_ne!(hurt, INRIA);
        assert!(load(&[("c.json", hurt.as_bytes())], &node("c.json")).is_err(), "{to}");
    }
    assert!(load(&[("c.json", b"{\"other\": 3}")], &node("c.json")).is_err());
    assert!(load(&[], &node("nowhere")).is_err());
}

/// A glTF camera looks along -z, with y up. The node of the camera is rotated and scaled, and is a child of another
/// node.
#[test]
fn cameras_of_gltf_come_into_the_world_as_objects_do() {
    let json = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"translation": [1, 2, 3], "children": [1, 2]},
                  {"name": "shot", "camera": 0, "scale": [2, 2, 2], "rotation": [0, 0.7071067811865476, 0, 0.7071067811865476]},
                  {"camera": 1}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.5707963267948966, "aspectRatio": 2.0, "znear": 0.1}},
                    {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}}]}"#;
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    std::fs::write(folder.path().join("a.gltf"), json).unwrap_or_else(|e| panic!("{e}"));
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 0.5, seed: 0, exhaustive: false };
    let cx = Context::detached(scene, folder.path().display().to_string());
    let p = LoadCameras { resolution: 0.5, ..node("a.gltf") };
    let (out, notes) = LoadCameras::run(&p, In {}, &cx).unwrap_or_else(|e| panic!("{e}"));
    let [camera] = &out.rig.cameras[..] else { panic!("{:?}", out.rig) };
    assert_eq!((camera.name.as_str(), camera.width_px, camera.height_px), ("shot", 1080, 540));
    // glTF angles are single precision: half an ulp of 1.57 is 6e-8, times 270 pixels.
    assert!((camera.fy - 270.0).abs() < 2e-5);
    // (1, 2, 3) of y up is (1, -3, 2) of z up, in units of half a metre.
    assert!((camera.eye() - DVec3::new(2.0, -6.0, 4.0)).length() < 1e-9);
    // -z turned by a quarter about y is -x.
    assert!((camera.direction(camera.cx, camera.cy) - DVec3::NEG_X).length() < 1e-9);
    assert!(notes.iter().any(|note| note.id == "parallel-cameras"));
    let turned = [0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let p = LoadCameras { matrix: Some(turned), ..p };
    let camera = LoadCameras::run(&p, In {}, &cx).unwrap_or_else(|e| panic!("{e}")).0.rig.cameras[0].clone();
    assert!((camera.eye() - DVec3::new(7.0, 2.0, 4.0)).length() < 1e-9);
    assert!((camera.direction(camera.cx, camera.cy) - DVec3::NEG_Y).length() < 1e-9);
    // The keys are in a file next to the model: from (1, 2, 3) to (5, 2, 3) in two seconds.
    let keys: Vec<u8> =
        [0.0_f32, 2.0, 1.0, 2.0, 3.0, 5.0, 2.0, 3.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    std::fs::write(folder.path().join("keys.bin"), keys).unwrap_or_else(|e| panic!("{e}"));
    let animation = r#""buffers": [{"uri": "keys.bin", "byteLength": 32}],
        "bufferViews": [{"buffer": 0, "byteLength": 8}, {"buffer": 0, "byteOffset": 8, "byteLength": 24}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"},
                      {"bufferView": 1, "componentType": 5126, "count": 2, "type": "VEC3"}],
        "animations": [{"name": "move", "samplers": [{"input": 0, "output": 1}],
                        "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}], "cameras""#;
    let moving = json.replacen("\"cameras\"", animation, 1);
    std::fs::write(folder.path().join("a.gltf"), moving).unwrap_or_else(|e| panic!("{e}"));
    let p = LoadCameras { clip: Some("move".into()), time_s: 0.5, ..node("a.gltf") };
    let sources = LoadCameras::sources(&p, &SourceRoot::new(folder.path())).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(sources.len(), 2);
    let camera = LoadCameras::run(&p, In {}, &cx).unwrap_or_else(|e| panic!("{e}")).0.rig.cameras[0].clone();
    assert!((camera.eye() - DVec3::new(4.0, -6.0, 4.0)).length() < 1e-9);
    let text = LoadCameras { clip: Some("move".into()), ..node("a.json") };
    assert!(LoadCameras::check(&text).is_err() && LoadCameras::check(&p).is_ok());
}

/// Files that hold no usable camera are named with what to do. This test fails if `read` takes a list of poses for
/// INRIA's cameras, or if orthographic cameras are only left out.
#[test]
fn poses_without_lenses_and_orthographic_cameras_are_named() {
    let poses = r#"[{"file_path": "images/a.png", "transform": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]}]"#;
    let error = of_json(poses).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("`ns-export cameras`") && error.contains("use the `transforms.json`"), "{error}");
    let gltf = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"camera": 0}],
        "cameras": [{"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}}]}"#;
    let error = load(&[("a.gltf", gltf.as_bytes())], &node("a.gltf")).err();
    let error = error.map(|e| e.to_string()).unwrap_or_default();
    assert!(
        error.contains("only orthographic cameras (count: 1)") && error.contains("perspective"),
        "{error}"
    );
}

// Some exporters write tabs or two spaces between words. An earlier version refused them as "not understood".
#[test]
fn words_of_colmap_texts_are_separated_by_any_white_space() {
    let (wide, spaced) = (images().replace("0 0 -", "0\t 0  -"), CAMERAS.replace(' ', "\t"));
    assert_ne!(wide, images());
    let of = |cameras: &str, images: &str| {
        load(&[("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", images.as_bytes())], &node("m"))
            .unwrap_or_else(|e| panic!("{e}"))
            .0
    };
    let cameras = of(&spaced, &wide);
    assert_eq!(cameras, of(CAMERAS, &images()));
    assert_eq!(cameras[0].name, "a b", "a name may hold spaces");
}

// 200,000 cameras and a pattern that picks all of them twice took minutes when each was looked up in a list.
#[test]
fn picking_many_cameras_takes_no_longer_than_reading_them() {
    let names: Vec<String> = (0..200_000).map(|i| format!("c{i}")).collect();
    let pictures: Vec<&str> = names.iter().map(String::as_str).collect();
    let start = std::time::Instant::now();
    let wishes = ["5..6", "*", "c*"].map(Pick::from);
    let chosen = chosen(&wishes, &names, &pictures).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((chosen.len(), chosen[0], chosen[1], chosen[6]), (200_000, 5, 0, 6));
    assert!(start.elapsed().as_secs() < 10, "{:?}", start.elapsed());
}

// A model as text that becomes one in binary while the graph runs.
#[test]
fn files_that_appear_while_it_runs_ask_for_another_run() {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(name), bytes).unwrap_or_else(|e| panic!("{e}"));
    };
    write("cameras.txt", CAMERAS.as_bytes());
    write("images.txt", images().as_bytes());
    let sources =
        LoadCameras::sources(&node("."), &SourceRoot::new(folder.path())).unwrap_or_else(|e| panic!("{e}"));
    let cx = Context::detached(
        Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false },
        folder.path(),
    );
    let cx = cx.having_listed(&sources);
    assert!(LoadCameras::run(&node("."), In {}, &cx).is_ok());
    let (cameras, images) = binary_files();
    write("cameras.bin", &cameras);
    write("images.bin", &images);
    let error = LoadCameras::run(&node("."), In {}, &cx).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("changed while the graph was running"), "{error}");
}

/// File of nerfstudio or instant-ngp with one frame. `top` and `frame` are the lens keys at the top level of the
/// file and in the frame.
fn frames(top: &str, frame: &str) -> String {
    format!(
        r#"{{{top}"frames": [{{"file_path": "images/a.png", {frame}
        "transform_matrix": [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]}}]}}"#
    )
}

fn of_json(text: &str) -> Result<(Vec<Camera>, Notes), NodeError> {
    load(&[("t.json", text.as_bytes())], &node("t.json"))
}

#[test]
fn marks_fill_and_back_slashes_are_read() {
    let (wanted, _) = of_json(STUDIO).unwrap_or_else(|e| panic!("{e}"));
    let marked = format!("\u{feff}{STUDIO}");
    for text in [marked, format!("{STUDIO}\0\0\0"), STUDIO.replace("images/", ".\\\\images\\\\")] {
        let (cameras, _) = of_json(&text).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert!(near(&cameras[0], &wanted[0]), "{text}");
    }
    for text in [OWN, INRIA] {
        assert!(of_json(&format!("\u{feff}{text}")).is_ok());
    }
    let (text, cameras) = (format!("\u{feff}{}", images()), format!("\u{feff}{CAMERAS}"));
    let files = [("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", text.as_bytes())];
    assert_eq!(load(&files, &node("m")).unwrap_or_else(|e| panic!("{e}")).0.len(), 2);
}

/// Files that are damaged at one to four places give cameras or an error, and never cause a panic.
#[test]
fn damaged_files_of_cameras_are_survived() {
    let path = r#"{"camera_type": "perspective", "render_height": 30, "render_width": 40, "camera_path": [
        {"camera_to_world": [0,1,0,1, 1,0,0,2, 0,0,-1,3, 0,0,0,1], "fov": 90}]}"#;
    let flags = STUDIO.replace("\"k1\": 0.0", "\"k1\": 1e-9, \"is_fisheye\": false, \"camera_angle_x\": 0.7");
    let parser = r#"{"transform": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], "scale": 0.5}"#;
    let text = images();
    let mut seed = 1_u64;
    let mut next = |below: usize| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % below.max(1)
    };
    let words: [&[u8]; 7] =
        [b"null", b"-1", b"1e999", b"[]", b"18446744073709551616", b"nan", b"\xef\xbb\xbf"];
    let mut hurt = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        for _ in 0..=next(4) {
            let at = next(bytes.len());
            match next(4) {
                0 if !bytes.is_empty() => bytes[at] ^= 1 << next(8),
                1 => drop(bytes.splice(at..at, words[next(7)].iter().copied())),
                2 => drop(bytes.drain(at..(at + next(9)).min(bytes.len()))),
                _ => bytes.truncate(bytes.len() - next(9).min(bytes.len())),
            }
        }
        bytes
    };
    for _ in 0..4000 {
        for whole in [OWN, OPENGL, INRIA, path, &flags] {
            let bytes = hurt(whole.as_bytes());
            json::pictures_without_size(&bytes);
            if let Ok(cameras) = json::read("a", &bytes, "views", &|_| Ok([40, 30]), &mut Notes::none()) {
                let p = node("a.json");
                for camera in &cameras {
                    drop(finish(&p, camera, "a".to_owned(), &mut Notes::none()));
                }
            }
        }
        drop(colmap::text("m", &hurt(CAMERAS.as_bytes()), &hurt(text.as_bytes())));
        if let Ok(parser) = Dataparser::read("d", &hurt(parser.as_bytes())) {
            drop(parser.after_applied("a", &hurt(STUDIO.as_bytes())));
        }
    }
}

// An axis of numbers picks the cameras of a file one after the other. An earlier version refused numbers.
#[test]
fn indices_pick_cameras() {
    let of = |text: &str| serde_json::from_str::<Vec<Pick>>(text).map_err(|e| e.to_string());
    assert_eq!(of("[0, \"a\", 12]"), Ok(vec!["0..1".into(), "a".into(), "12..13".into()]));
    assert!(of("[-1]").is_err() && of("[1.5]").is_err() && of("[true]").is_err());
    assert!(of("[18446744073709551615]").is_err());
}
