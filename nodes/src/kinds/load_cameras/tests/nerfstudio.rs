//! Camera paths, picture sizes and coordinates of nerfstudio.

use super::*;

// The viewer of nerfstudio writes a path of cameras: rows of 16 numbers and the vertical angle in degrees.
#[test]
fn the_path_of_a_viewer_is_read() {
    let text = |more: &str, kind: &str| {
        format!(
            r#"{{"camera_type": "{kind}", "render_height": 30, "render_width": 40, "fps": 24, "camera_path": [
            {{"camera_to_world": [0,1,0,1, 1,0,0,2, 0,0,-1,3, 0,0,0,1], "fov": 90, "aspect": 1{more}}},
            {{"camera_to_world": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1], "fov": 53.13010235415598}}]}}"#
        )
    };
    // The same matrix as a list of rows.
    let flat = "[0,1,0,1, 1,0,0,2, 0,0,-1,3, 0,0,0,1]";
    let nested = |text: &str| text.replace(flat, "[[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]");
    let (listed, _) = of_json(&nested(&text("", "perspective"))).unwrap_or_else(|e| panic!("{e}"));
    let (cameras, _) = of_json(&text("", "perspective")).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(listed, cameras);
    let [first, second] = cameras.as_slice() else { panic!("two cameras") };
    assert_eq!((first.name.as_str(), second.name.as_str()), ("00000", "00001"));
    assert_eq!((first.width_px, first.height_px, first.cx, first.cy), (40, 30, 20.0, 15.0));
    assert!((first.fx - 15.0).abs() < 1e-9 && (second.fy - 30.0).abs() < 1e-9);
    assert_eq!(first.eye(), DVec3::new(1.0, 2.0, 3.0));
    assert_eq!(first.world_from_camera().transform_vector3(DVec3::Z), DVec3::new(0.0, 0.0, 1.0));
    for wrong in [text("", "equirectangular"), text(r#", "camera_type": "fisheye""#, "perspective")] {
        let error = of_json(&wrong).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("camera type"), "{error}");
    }
}

// The synthetic scenes of NeRF have no sizes, and paths without an ending.
#[test]
fn sizes_come_from_the_pictures() {
    let raster = |width: usize, height: usize| scene::io::png::Raster {
        width,
        height,
        channels: 1,
        largest: 255,
        codes: vec![7; width * height],
        ignored: Vec::new(),
        colour: None,
    };
    let png = |w, h| scene::io::png::write(&raster(w, h), false, &[]).unwrap_or_else(|e| panic!("{e}"));
    let (wide, small) = (png(40, 30), png(20, 10));
    let pose = r#""transform_matrix": [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]"#;
    let angle = 2.0 * scene::math::num::atan2(20.0, 50.0);
    let text = format!(
        r#"{{"camera_angle_x": {angle}, "frames": [{{"file_path": "./train/r_0", {pose}}},
        {{"file_path": "train\\r_1.png", {pose}}}]}}"#
    );
    let files = [("t.json", text.as_bytes()), ("train/r_0.png", &wide[..]), ("train/r_1.png", &small[..])];
    let (cameras, _) = load(&files, &node("t.json")).unwrap_or_else(|e| panic!("{e}"));
    let sizes: Vec<_> = cameras.iter().map(|c| (c.width_px, c.height_px)).collect();
    assert_eq!(sizes, [(40, 30), (20, 10)]);
    assert!((cameras[0].fx - 50.0).abs() < 1e-9 && (cameras[1].fx - 25.0).abs() < 1e-9);
    let error = load(&files[..2], &node("t.json")).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("its picture `train/r_1.png` does not exist"), "{error}");
    // The same by the folder of the file.
    let in_folder = [
        ("c/transforms.json", text.as_bytes()),
        ("c/train/r_0.png", &wide[..]),
        ("c/train/r_1.png", &small[..]),
    ];
    let (by_folder, _) = load(&in_folder, &node("c")).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(by_folder, cameras);
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    for (name, bytes) in &in_folder {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap_or(folder.path())).unwrap_or_else(|e| panic!("{e}"));
        std::fs::write(path, bytes).unwrap_or_else(|e| panic!("{e}"));
    }
    let sources = LoadCameras::sources(&node("c"), &SourceRoot::new(folder.path()));
    assert_eq!(sources.map(|sources| sources.len()).unwrap_or_default(), 3, "the pictures are sources");
}

// nerfstudio exports splats in the coordinates of its data parser, while the cameras stay in those of the capture.
#[test]
fn cameras_follow_the_data_parser() {
    let parser = r#"{"transform": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], "scale": 0.5}"#;
    let with = |cameras: &str, parser: &str| {
        let p = LoadCameras { dataparser: Some(InputFile("dp.json".into())), ..node("transforms.json") };
        load(&[("transforms.json", cameras.as_bytes()), ("dp.json", parser.as_bytes())], &p)
    };
    let (cameras, _) = with(STUDIO, parser).unwrap_or_else(|e| panic!("{e}"));
    // The eye (1, 2, 3): (-2 + 1, 1 + 2, 3 + 3) / 2; its x, which is +y, becomes -x.
    assert_eq!(cameras[0].eye(), DVec3::new(-0.5, 1.5, 3.0));
    assert_eq!(cameras[0].world_from_camera().transform_vector3(DVec3::X), -DVec3::X);
    // Poses that have the applied transform already: the parser maps from before it. Its inverse is taken first.
    let applied =
        r#""applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "applied_scale": 2.0,"#;
    let text = STUDIO.replacen('{', &format!("{{{applied}"), 1);
    let (cameras, _) = with(&text, parser).unwrap_or_else(|e| panic!("{e}"));
    // Before it, the eye is at (1, -3, 2); then (3 + 1, 1 + 2, 2 + 3) / 4.
    assert_eq!(cameras[0].eye(), DVec3::new(1.0, 0.75, 1.25));
    for wrong in [
        "{}",
        r#"{"transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}"#,
        r#"{"transform": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}"#,
        r#"{"transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 0}"#,
        r#"{"transform": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "scale": 1}"#,
    ] {
        assert!(with(STUDIO, wrong).is_err(), "{wrong}");
    }
    // In the folder of the cameras and not used: a warning.
    let files = [("transforms.json", STUDIO.as_bytes()), ("dataparser_transforms.json", parser.as_bytes())];
    let (_, notes) = load(&files, &node("transforms.json")).unwrap_or_else(|e| panic!("{e}"));
    assert!(notes.iter().any(|note| note.id == "dataparser-unused"));
    let (_, notes) = load(&files[..1], &node("transforms.json")).unwrap_or_else(|e| panic!("{e}"));
    assert!(notes.iter().all(|note| note.id != "dataparser-unused"));
    // The folder stands for its file.
    let inside = files.map(|(name, bytes)| (format!("c/{name}"), bytes));
    let inside: Vec<_> = inside.iter().map(|(name, bytes)| (name.as_str(), *bytes)).collect();
    let (_, notes) = load(&inside, &node("c")).unwrap_or_else(|e| panic!("{e}"));
    assert!(notes.iter().any(|note| note.id == "dataparser-unused"));
}

/// `dataparser` is refused for cameras that are in the coordinates of the splats, and reported for cameras that are
/// usually not in the coordinates of a capture for nerfstudio.
#[test]
fn the_data_parser_is_for_cameras_of_the_capture() {
    let parser = r#"{"transform": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], "scale": 0.5}"#;
    let with = |cameras: &str| {
        let p = LoadCameras { dataparser: Some(InputFile("dp.json".into())), ..node("c.json") };
        load(&[("c.json", cameras.as_bytes()), ("dp.json", parser.as_bytes())], &p)
    };
    let viewer = r#"{"render_height": 30, "render_width": 40, "camera_path": [
        {"camera_to_world": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1], "fov": 90}]}"#;
    let error = with(viewer).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("already in the coordinates of the splats"), "{error}");
    let doubtful = |cameras: &str| {
        let (_, notes) = with(cameras).unwrap_or_else(|e| panic!("{e}"));
        notes.iter().any(|note| note.id == "dataparser-doubtful")
    };
    assert_eq!([INRIA, STUDIO, OWN].map(doubtful), [true, false, false]);
}
