//! Models of COLMAP, placeholders in place of files, and the number of cameras before the run.

use super::count::READ_WHOLE;
use super::*;

/// The size of the pictures, for the top level of a file.
const SIZE: &str = r#""w": 40, "h": 30, "#;

// The models of COLMAP 4.2 that earlier versions do not know. An earlier version refused them without their names.
#[test]
fn new_models_of_colmap_are_named() {
    let images = "3 1 0 0 0 0 0 0 7 a.png\n";
    let of = |model: &str| {
        let cameras = format!("7 {model}\n");
        let files = [("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", images.as_bytes())];
        load(&files, &node("m"))
    };
    for (model, says) in [
        (
            "RAD_TAN_THIN_PRISM_FISHEYE 40 30 50 50 20 15 0 0 0 0 0 0 0 0 0 0 0 0",
            "(RAD_TAN_THIN_PRISM_FISHEYE [",
        ),
        ("SIMPLE_DIVISION 40 30 50 20 15 -0.3", "(SIMPLE_DIVISION [-0.3])"),
        ("DIVISION 40 30 50 51 20 15 -1e9", "(DIVISION ["),
        ("SIMPLE_FISHEYE 40 30 50 20 15", "(SIMPLE_FISHEYE [])"),
        ("FISHEYE 40 30 50 50 20 15", "(FISHEYE [])"),
        ("EUCM 40 30 50 50 20 15 0.5 1", "(EUCM [0.5, 1.0])"),
        (
            "EQUIRECTANGULAR 40 20 40 20",
            "camera 7 has the camera model `EQUIRECTANGULAR`, which is not a persp",
        ),
        ("TOMORROW 40 30 50", "camera 7 has the camera model `TOMORROW`, which is unknown"),
        (
            "PINHOLE 40 30 50 20 15",
            "camera 7 has the wrong number of parameters, 3 (the camera model `PINHOLE` needs 4)",
        ),
    ] {
        let error = of(model).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{model}: {error}");
    }
    for pinhole in [
        "SIMPLE_DIVISION 40 30 50 20 15 0",
        "SIMPLE_DIVISION 40 30 50 20 15 1e-6",
        "DIVISION 40 30 50 50 20 15 -1e-6",
        "EUCM 40 30 50 50 20 15 0 1",
    ] {
        let (cameras, notes) = of(pinhole).unwrap_or_else(|e| panic!("{pinhole}: {e}"));
        assert_eq!(
            (cameras[0].fx, cameras[0].fy, cameras[0].cx, notes.is_degraded()),
            (50.0, 50.0, 20.0, false)
        );
    }
    // The numbers of the models in binary files.
    let (cameras, images) = binary_files();
    for (number, params, says) in [
        (11_u32, 16, "(RAD_TAN_THIN_PRISM_FISHEYE"),
        (12, 4, "(SIMPLE_DIVISION"),
        (13, 5, "(DIVISION"),
        (14, 3, "(SIMPLE_FISHEYE"),
        (15, 4, "(FISHEYE"),
        (16, 6, "(EUCM"),
        (17, 2, "`EQUIRECTANGULAR`"),
        (18, 2, "camera 7 uses camera model number 18, which is unknown"),
    ] {
        let mut cameras = cameras[..32].to_vec();
        cameras[12..16].copy_from_slice(&number.to_le_bytes());
        cameras.extend((0..params).flat_map(|_| 0.5_f64.to_le_bytes()));
        let files = [("m/cameras.bin", &cameras[..]), ("m/images.bin", &images[..])];
        let error = load(&files, &node("m")).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{number}: {error}");
    }
}

// A binary file with 2815 cameras begins like JPEG XL, which is not refused here.
#[test]
fn placeholders_inside_a_model_are_named() {
    let pointer: &[u8] = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n";
    let (cameras, images) = binary_files();
    let text = self::images();
    for (files, name) in [
        ([("m/cameras.bin", pointer), ("m/images.bin", &images[..])], "cameras.bin"),
        ([("m/cameras.bin", &cameras[..]), ("m/images.bin", pointer)], "images.bin"),
        ([("m/cameras.txt", pointer), ("m/images.txt", text.as_bytes())], "cameras.txt"),
        ([("m/cameras.txt", CAMERAS.as_bytes()), ("m/images.txt", pointer)], "images.txt"),
    ] {
        let error = load(&files, &node("m")).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("git lfs pull") && error.contains(name), "{error}");
    }
    let mut many = 2815_u64.to_le_bytes().to_vec();
    many.extend(&images[8..]);
    let error = load(&[("m/cameras.bin", &cameras[..]), ("m/images.bin", &many[..])], &node("m"));
    let error = error.err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("ends too early"), "{error}");
    // Pictures that are read for their sizes.
    let text = frames(r#""fl_x": 50, "#, "");
    for (bytes, says) in [
        (pointer, "its picture `images/a.png` is not supported: a Git LFS pointer"),
        (&b"nothing"[..], "its picture `images/a.png` cannot be read"),
    ] {
        let error = load(&[("t.json", text.as_bytes()), ("images/a.png", bytes)], &node("t.json"));
        let error = error.err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{error}");
    }
}

// The axis `Cameras("rig")` needs the number of cameras before the run. An earlier version hid the error of a file, and
// did not count the cameras of a text above 4 MiB.
#[test]
fn cameras_are_counted_before_the_run_or_the_error_is_reported() {
    let count = |files: &[(&str, &[u8])], p: &LoadCameras| {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap_or_else(|e| panic!("{e}"));
        }
        LoadCameras::views(p, &SourceRoot::new(folder.path()))
    };
    let pointer: &[u8] = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n";
    let fish = frames(r#""w": 40, "h": 30, "fl_x": 50, "is_fisheye": true, "#, "");
    let blind = frames(r#""w": 40, "h": 30, "#, "");
    for (bytes, says, advice) in [
        (pointer, "git lfs pull", ""),
        (fish.as_bytes(), "has lens distortion (OPENCV, `is_fisheye`)", "undistort"),
        (blind.as_bytes(), "has neither `fl_x` nor `camera_angle_x`", ""),
    ] {
        let counted = count(&[("t.json", bytes)], &node("t.json"));
        let ViewCount::Uncounted { why, hint } = counted else { panic!("{counted:?}") };
        assert!(why.contains(says) && hint.unwrap_or_default().contains(advice), "{why}");
    }
    let picked = LoadCameras { pick: vec!["nothing".into()], ..node("t.json") };
    assert!(matches!(count(&[("t.json", STUDIO.as_bytes())], &picked), ViewCount::Uncounted { .. }));
    assert_eq!(count(&[("t.json", STUDIO.as_bytes())], &node("t.json")), ViewCount::Known(1));
    // Images of 100,000 bytes each, as COLMAP writes them for many points.
    let points = "12.5 100.25 -1 ".repeat(7000);
    let text: String = (0..60).map(|i| format!("{i} 1 0 0 0 0 0 0 7 {i} b.png\n{points}\n")).collect();
    assert!(text.len() as u64 > READ_WHOLE);
    let files = [("cameras.txt", CAMERAS.as_bytes()), ("images.txt", text.as_bytes())];
    assert_eq!(count(&files, &node(".")), ViewCount::Known(60));
    // All lines of points are left out, in every form that the reader accepts.
    for text in [images(), format!("\u{feff}{}", images()), images().replace('\n', "\r\n")] {
        let read = colmap::text("m", CAMERAS.as_bytes(), text.as_bytes()).unwrap_or_else(|e| panic!("{e}"));
        let counted = colmap::count_images(&mut text.as_bytes()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((counted, read.len()), (2, 2), "{text}");
    }
    assert_eq!(colmap::count_images(&mut "1 2 3 ".repeat(100_000).as_bytes()).ok(), Some(0));
}

/// Along each axis a focal length comes from the frame, or from the file if the frame has none and the file only this one.
/// An earlier version ignored the `fl_y` of the file when the frame had an `fl_x`.
#[test]
fn focal_lengths_of_frames_and_files_are_combined() {
    let focal = |top: &str, frame: &str| {
        let (cameras, _) = of_json(&frames(&format!("{SIZE}{top}"), frame)).unwrap_or_else(|e| panic!("{e}"));
        (cameras[0].fx, cameras[0].fy)
    };
    assert_eq!(focal(r#""fl_y": 60, "#, r#""fl_x": 50, "#), (50.0, 60.0));
    assert_eq!(focal(r#""fl_x": 60, "#, r#""fl_y": 50, "#), (60.0, 50.0));
    // A lens of its own.
    assert_eq!(focal(r#""fl_x": 60, "fl_y": 61, "#, r#""fl_x": 50, "#), (50.0, 50.0));
    assert_eq!(focal(r#""fl_x": 60, "fl_y": 61, "#, ""), (60.0, 61.0));
    assert_eq!(focal("", r#""fl_x": 50, "fl_y": 51, "#), (50.0, 51.0));
    assert_eq!(focal(r#""fl_y": 61, "#, ""), (61.0, 61.0));
}

/// A matrix as a list of 16 numbers, as paths of nerfstudio's viewer have it. An earlier version read it there only.
#[test]
fn matrices_may_be_lists_of_16_numbers() {
    let text = frames(&format!("{SIZE}\"fl_x\": 50, "), "");
    let flat = text.replace("[[", "[").replace("]]", "]").replace("], [", ", ");
    let of = |text: &str| of_json(text).unwrap_or_else(|e| panic!("{text}: {e}")).0;
    assert_ne!(text, flat);
    assert_eq!(of(&text), of(&flat));
}

/// The key `camera_type` of nerfstudio's viewer in a `transforms.json`. An earlier version ignored it, so that fisheyes
/// became pinhole cameras.
#[test]
fn the_camera_type_of_a_frame_or_file_is_used() {
    let key = |name: &str| format!(r#""camera_type": "{name}", "#);
    let text = |top: &str, frame: &str| frames(&format!(r#"{SIZE}{top}"fl_x": 50, "#), frame);
    let error =
        |top: &str, frame: &str| of_json(&text(top, frame)).err().map(|e| e.to_string()).unwrap_or_default();
    assert_eq!(error(&key("perspective"), ""), "");
    assert!(error(&key("fisheye"), "").contains("lens distortion (OPENCV, `camera_type` fisheye)"));
    assert!(error("", &key("FISHEYE")).contains("lens distortion"));
    assert!(error(&key("equirectangular"), "").contains("camera type `equirectangular`"));
}
