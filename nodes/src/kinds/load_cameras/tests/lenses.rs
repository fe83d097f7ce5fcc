//! Distortion, lens flags and fields of view.

use super::*;
use glam::DVec3;
use scene::types::LensModel;

/// Cameras of a JSON file whose distortion is ignored, and the note about this.
fn ignored(text: &str) -> (Vec<Camera>, String) {
    let ignore = LoadCameras { distortion: Distortion::Ignore, ..node("t.json") };
    let (cameras, notes) =
        load(&[("t.json", text.as_bytes())], &ignore).unwrap_or_else(|e| panic!("{text}: {e}"));
    assert!(notes.is_degraded(), "{text}");
    let text = notes.iter().find(|note| note.id == "distortion-ignored").map(|note| note.text.clone());
    (cameras, text.unwrap_or_default())
}

/// Points in the frame of a camera, and where OpenCV 5.0.0 shows them (`projectPoints`, `fisheye.projectPoints`) with
/// a focal length of 500 and 510 pixels and the principal point (320, 250).
fn opencv() -> [(&'static str, &'static str, [[f64; 2]; 12]); 3] {
    [
        (
            "OPENCV 640 480 500 510 320 250 -0.28 0.07 1.2e-3 -8e-4",
            r#""k1": -0.28, "k2": 0.07, "k3": 0.0, "p1": 1.2e-3, "p2": -8e-4, "#,
            OPENCV,
        ),
        (
            "FULL_OPENCV 640 480 500 510 320 250 0.3 0.1 5e-4 -3e-4 0.02 0.2 0.05 0.004",
            r#""camera_model": "FULL_OPENCV", "k1": 0.3, "k2": 0.1, "k3": 0.02, "k4": 0.2, "k5": 0.05, "k6": 0.004, "p1": 5e-4, "p2": -3e-4, "#,
            RATIONAL,
        ),
        (
            "OPENCV_FISHEYE 640 480 500 510 320 250 0.03 -0.01 4e-3 -7e-4",
            r#""camera_model": "OPENCV_FISHEYE", "k1": 0.03, "k2": -0.01, "k3": 4e-3, "k4": -7e-4, "#,
            FISHEYE,
        ),
    ]
}
const OPENCV: [[f64; 2]; 12] = [
    [76.331805, 69.662789],
    [76.619289, 272.727075],
    [91.896409, 398.183731],
    [257.201238, 79.421960],
    [257.776806, 271.164150],
    [261.433910, 389.355742],
    [430.595136, 99.600674],
    [429.502188, 268.649885],
    [423.962649, 373.833511],
    [513.081794, 118.788470],
    [511.164728, 266.353080],
    [503.115702, 359.124550],
];
const RATIONAL: [[f64; 2]; 12] = [
    [30.365432, 35.313213],
    [50.088822, 275.094824],
    [60.043059, 418.791055],
    [253.841467, 70.140282],
    [257.381030, 271.293991],
    [259.392432, 394.236547],
    [437.095278, 90.757967],
    [431.665394, 268.997354],
    [428.339653, 378.971186],
    [532.261194, 105.700229],
    [523.316259, 267.325020],
    [517.645229, 367.668048],
];
const FISHEYE: [[f64; 2]; 12] = [
    [76.182512, 69.131754],
    [77.315613, 272.503461],
    [92.547011, 397.637668],
    [257.328771, 79.534258],
    [257.826154, 271.139108],
    [261.610573, 388.966836],
    [430.578694, 99.612976],
    [429.444964, 268.605644],
    [423.808665, 373.532311],
    [513.142085, 118.663382],
    [510.984504, 266.233683],
    [502.874407, 358.810272],
];

/// Lenses of COLMAP and nerfstudio show points where OpenCV shows them, to the sixth digit that is given, and a
/// position of the picture shows the direction of its point. This test fails if `p1` and `p2` are swapped, or if `k4` of
/// the rational model is a coefficient of r^8.
#[test]
fn lenses_show_points_where_opencv_shows_them() {
    let images = "3 1 0 0 0 0 0 0 7 a.png\n";
    for (colmap, keys, wanted) in opencv() {
        let cameras = format!("7 {colmap}\n");
        let files = [("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", images.as_bytes())];
        let of_colmap = load(&files, &node("m")).unwrap_or_else(|e| panic!("{colmap}: {e}")).0.remove(0);
        let json = frames(
            &format!(r#"{keys}"w": 640, "h": 480, "fl_x": 500, "fl_y": 510, "cx": 320, "cy": 250, "#),
            "",
        );
        let of_json = of_json(&json).unwrap_or_else(|e| panic!("{json}: {e}")).0.remove(0);
        assert_eq!(of_colmap.lens, of_json.lens, "{colmap}");
        for (i, [u, v]) in wanted.into_iter().enumerate() {
            let point =
                DVec3::new([-1.1, -0.3, 0.6, 1.2][i / 3], [-0.8, 0.1, 0.7][i % 3], 2.0 + 0.1 * i as f64);
            let [x, y] = of_colmap.pixel(point).unwrap_or_else(|| panic!("{colmap}: {point}"));
            assert!((x - u).abs() < 1e-6 && (y - v).abs() < 1e-6, "{colmap}: {x} {y}, not {u} {v}");
            let off = of_colmap.ray(u, v) * point.z - point;
            assert!(off.length() < 1e-7, "{colmap}: {off}");
        }
    }
}

/// The other models of COLMAP show points 0, 4 and 11 of the test above where pycolmap 4.2.1 shows them
/// (`img_from_cam`).
#[test]
fn lenses_show_points_where_colmap_shows_them() {
    let images = "3 1 0 0 0 0 0 0 7 a.png\n";
    let points = [DVec3::new(-1.1, -0.8, 2.0), DVec3::new(-0.3, 0.1, 2.4), DVec3::new(1.2, 0.7, 3.1)];
    for (model, wanted) in [
        (
            "SIMPLE_RADIAL 640 480 500 320 250 -0.1",
            [[57.718750, 59.250000], [257.608507, 270.797164], [509.661307, 360.635762]],
        ),
        (
            "RADIAL 640 480 500 320 250 -0.2 0.05",
            [[67.496289, 66.360938], [257.716072, 270.761309], [506.164553, 358.595989]],
        ),
        (
            "SIMPLE_RADIAL_FISHEYE 640 480 500 320 250 -0.04",
            [[81.946036, 76.869844], [257.900630, 270.699790], [500.666938, 355.389047]],
        ),
        (
            "RADIAL_FISHEYE 640 480 500 320 250 -0.04 0.01",
            [[81.638799, 76.646399], [257.900447, 270.699851], [500.724267, 355.422489]],
        ),
        (
            "SIMPLE_FISHEYE 640 480 500 320 250",
            [[78.500514, 74.364010], [257.857968, 270.714011], [501.958855, 356.142665]],
        ),
        (
            "FISHEYE 640 480 500 510 320 250",
            [[78.500514, 70.851290], [257.857968, 271.128291], [501.958855, 358.265518]],
        ),
        (
            "FOV 640 480 500 510 320 250 0.9",
            [[58.823843, 56.254778], [253.267923, 272.688906], [516.072996, 366.663432]],
        ),
        (
            "SIMPLE_DIVISION 640 480 500 320 250 -0.2",
            [[66.598662, 65.708118], [257.715520, 270.761493], [506.342335, 358.699695]],
        ),
        (
            "DIVISION 640 480 500 510 320 250 0.15",
            [[22.702703, 29.459459], [257.336386, 271.305629], [519.759212, 368.856731]],
        ),
    ] {
        let cameras = format!("7 {model}\n");
        let files = [("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", images.as_bytes())];
        let camera = load(&files, &node("m")).unwrap_or_else(|e| panic!("{model}: {e}")).0.remove(0);
        for (point, [u, v]) in points.into_iter().zip(wanted) {
            let [x, y] = camera.pixel(point).unwrap_or_else(|| panic!("{model}: {point}"));
            assert!((x - u).abs() < 1e-6 && (y - v).abs() < 1e-6, "{model}: {x} {y}, not {u} {v}");
            assert!((camera.ray(u, v) * point.z - point).length() < 1e-7, "{model}: {point}");
        }
    }
}

/// A lens that shows no direction at a corner of its picture is refused.
#[test]
fn lenses_that_do_not_cover_the_picture_are_refused() {
    let images = "3 1 0 0 0 0 0 0 7 a.png\n";
    for model in ["SIMPLE_RADIAL 640 480 500 320 240 -0.6", "SIMPLE_FISHEYE 640 480 100 320 240"] {
        let cameras = format!("7 {model}\n");
        let files = [("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", images.as_bytes())];
        let error = load(&files, &node("m")).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("shows no direction below 85 degrees at (0, 0)"), "{model}: {error}");
        assert!(load(&files, &LoadCameras { distortion: Distortion::Ignore, ..node("m") }).is_ok());
    }
}

// nerfstudio's parser reads the list `distortion_params` and numbers written as text. An earlier version ignored both,
// and rendered such cameras as pinhole cameras.
#[test]
fn distortion_is_read_in_every_form_of_nerfstudio() {
    let lens = r#""w": 40, "h": 30, "fl_x": 50, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "#;
    let bent = r#""distortion_params": [0.3, 0, 0, 0, 0, 0], "#;
    for text in [
        frames(&format!("{lens}{bent}"), ""),
        frames(lens, bent),
        frames(lens, r#""distortion_params": [0, 0, 0, 0, 0, -0.02], "#),
        frames(&format!("{lens}{bent}"), r#""k1": 0.1, "#),
        frames(r#""w": 40, "h": 30, "fl_x": 50, "k1": "0.1", "#, ""),
        frames(lens, r#""k1": " 1e-1 ", "#),
        frames(lens, r#""distortion_params": [0, 0, 0, 0, 0, 0], "k1": 0.1, "#),
    ] {
        let camera = of_json(&text).unwrap_or_else(|e| panic!("{text}: {e}")).0.remove(0);
        assert!(!camera.lens.is_pinhole(), "{text}");
        assert!(ignored(&text).0[0].lens.is_pinhole(), "{text}");
    }
    for none in ["[0, 0, 0, 0, 0, 0]", "[0.0, 0, 0, 0]", "null", "[]"] {
        let text = frames(&format!(r#"{lens}"distortion_params": {none}, "#), "");
        assert!(of_json(&text).is_ok_and(|(_, notes)| !notes.is_degraded()), "{text}");
    }
    for (wrong, says) in [
        (r#""distortion_params": [0.1, 0, 0, 0], "#, "of length 4, instead of the six numbers"),
        (r#""distortion_params": 0.1, "#, "not a list of numbers"),
        (r#""distortion_params": [null, 0, 0, 0, 0, 0], "#, "entries are not numbers"),
        (r#""k1": [0.1], "#, "`k1` that is not a number"),
        (r#""p2": "small", "#, "`p2` that is not a number"),
        (r#""cx": true, "#, "`cx` that is not a number"),
    ] {
        let error = of_json(&frames(lens, wrong)).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{wrong}: {error}");
    }
    // All numbers may be text. An earlier version took the middle of the picture for such a principal point.
    let text = frames(r#""w": "40", "h": "30.0", "fl_x": "50", "cx": "21", "cy": "14", "#, "");
    let camera = of_json(&text).unwrap_or_else(|e| panic!("{e}")).0.remove(0);
    assert_eq!(
        (camera.width_px, camera.height_px, camera.fx, camera.cx, camera.cy),
        (40, 30, 50.0, 21.0, 14.0)
    );
}

/// Keys of lenses in INRIA's and in lightharmony's own JSON have the meaning that they have in nerfstudio's. This test
/// fails if `inria` or `own` does not call `bend`, or `inria` takes the middle of the picture for `cx`.
#[test]
fn keys_of_lenses_count_in_every_json() {
    for whole in [OWN, INRIA] {
        let with = |keys: &str| whole.replace("\"fy\": 51,", &format!("\"fy\": 51, {keys}"));
        let plain = of_json(whole).unwrap_or_else(|e| panic!("{e}")).0;
        for keys in [r#""k1": 0.2,"#, r#""p2": -0.1,"#, r#""k4": "0.3","#, r#""is_fisheye": true,"#] {
            let text = with(keys);
            assert_ne!(text, whole);
            let (bent, notes) = of_json(&text).unwrap_or_else(|e| panic!("{keys}: {e}"));
            assert!(bent.iter().all(|camera| !camera.lens.is_pinhole()) && !notes.is_degraded(), "{keys}");
            let (cameras, distortion) = ignored(&text);
            assert!(cameras == plain && distortion.contains("(OPENCV"), "{keys}: {distortion}");
        }
        let (cameras, notes) = of_json(&with(r#""k1": 1e-6,"#)).unwrap_or_else(|e| panic!("{e}"));
        assert!(cameras == plain && notes.iter().any(|note| note.id == "distortion-invisible"));
        let (_, notes) = of_json(&with(r#""k1": 0, "k2": 0.0, "camera_model": "OPENCV","#))
            .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(notes.iter().count(), 0);
        let error = of_json(&with(r#""k1": [1],"#)).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("`k1` that is not a number"), "{error}");
    }
    for (keys, middle) in [
        ("\"cx\": 10, \"cy\": 11.5,", (10.0, 11.5)),
        ("\"cx\": 10.0,", (10.0, 15.0)),
        ("\"cy\": \"3\",", (20.0, 3.0)),
        ("\"cx\": null,", (20.0, 15.0)),
    ] {
        let text = INRIA.replace("\"fy\": 51,", &format!("\"fy\": 51, {keys}"));
        let (cameras, _) = of_json(&text).unwrap_or_else(|e| panic!("{keys}: {e}"));
        assert_eq!((cameras[0].cx, cameras[0].cy), middle, "{keys}");
    }
}

// `camera_angle_x` in degrees instead of radians gave a focal length without meaning.
#[test]
fn angles_outside_half_a_turn_are_errors() {
    for (key, angle, says) in [
        ("camera_angle_x", "40", "radians"),
        ("camera_angle_x", "7.0", "radians"),
        ("camera_angle_y", "300", "radians"),
        ("camera_angle_x", "0", "radians"),
        ("x_fov", "180", "180 degrees"),
        ("y_fov", "-40", "180 degrees"),
    ] {
        let text = frames(&format!(r#""w": 40, "h": 30, "{key}": {angle}, "#), "");
        let error = of_json(&text).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(&format!("`{key}` {}", angle.trim_end_matches(".0"))), "{text}: {error}");
        assert!(error.contains(says), "{text}: {error}");
    }
    let path = r#"{"render_height": 30, "render_width": 40, "camera_path": [
        {"camera_to_world": [0,1,0,1, 1,0,0,2, 0,0,-1,3, 0,0,0,1], "fov": 200}]}"#;
    let error = of_json(path).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("`fov` 200, which is not between 0 and 180 degrees"), "{error}");
}

// A frame's own lens counts, whatever the top of the file says. An earlier version took the angle of the top.
#[test]
fn the_lens_of_a_frame_counts_before_that_of_the_file() {
    let angle = 2.0 * scene::math::num::atan2(20.0, 50.0);
    let degrees = angle.to_degrees();
    let size = r#""w": 40, "h": 30, "#;
    for (top, frame) in [
        (r#""camera_angle_x": 1.5, "#.to_owned(), format!(r#""camera_angle_x": {angle}, {size}"#)),
        (format!(r#""camera_angle_x": {angle}, {size}"#), String::new()),
        (format!(r#""fl_x": 77, "fl_y": 99, {size}"#), format!(r#""camera_angle_x": {angle}, "#)),
        (format!(r#""camera_angle_x": 0.3, "camera_angle_y": 0.2, {size}"#), r#""fl_x": 50, "#.to_owned()),
        (format!(r#""fl_x": 50, "camera_angle_x": 0.3, {size}"#), String::new()),
        (size.to_owned(), format!(r#""x_fov": {degrees}, "#)),
        (r#""w": 80, "h": 60, "fl_x": 3, "#.to_owned(), r#""w": 40.0, "h": 30.0, "fl_y": 50, "#.to_owned()),
    ] {
        let text = frames(&top, &frame);
        let camera = of_json(&text).unwrap_or_else(|e| panic!("{text}: {e}")).0.remove(0);
        assert!((camera.fx - 50.0).abs() < 1e-9 && (camera.fy - 50.0).abs() < 1e-9, "{text}: {camera:?}");
        assert_eq!((camera.width_px, camera.height_px, camera.cx, camera.cy), (40, 30, 20.0, 15.0));
    }
}

// instant-ngp says the lens by flags, at the top or in a frame.
#[test]
fn flags_of_lenses_are_read() {
    let lens = r#""w": 40, "h": 30, "fl_x": 50, "#;
    for flag in [r#""is_fisheye": true, "#, r#""is_fisheye": 1, "#, r#""is_fisheye": "True", "#] {
        for text in [frames(&format!("{flag}{lens}"), ""), frames(lens, flag)] {
            let (cameras, distortion) = ignored(&text);
            assert!(
                cameras[0].lens.is_pinhole() && distortion.contains("is_fisheye"),
                "{text}: {distortion}"
            );
            let camera = of_json(&text).unwrap_or_else(|e| panic!("{text}: {e}")).0.remove(0);
            assert_eq!(camera.lens, LensModel::Fisheye { k: [0.0; 4] }.into(), "{text}");
        }
    }
    for flag in ["latlong", "equirectangular", "orthographic"] {
        let error = of_json(&frames(&format!(r#""{flag}": true, {lens}"#), "")).err().map(|e| e.to_string());
        assert!(error.is_some_and(|e| e.contains(flag)));
    }
    // A frame may say that it is not a fisheye.
    for text in [
        frames(&format!(r#""is_fisheye": false, {lens}"#), ""),
        frames(&format!(r#""is_fisheye": true, {lens}"#), r#""is_fisheye": false, "#),
        frames(&format!(r#""camera_model": "pinhole", {lens}"#), ""),
        frames(&format!(r#""camera_model": "SIMPLE_RADIAL", "k1": 0.0, {lens}"#), ""),
    ] {
        assert!(of_json(&text).is_ok(), "{text}");
    }
    let error = of_json(&frames(&format!(r#""camera_model": "omnidirectional", {lens}"#), ""));
    assert!(error.err().is_some_and(|e| e.to_string().contains("`omnidirectional`")));
}

// Undistorters leave coefficients that move nothing. An earlier version refused them.
#[test]
fn distortion_far_below_a_pixel_is_left_out() {
    let lens = r#""w": 4000, "h": 3000, "fl_x": 3000, "#;
    let json = |k1: f64, p2: f64| of_json(&frames(&format!(r#""k1": {k1:e}, "p2": {p2:e}, {lens}"#), ""));
    for (k1, p2) in [(1e-6, 0.0), (-1e-6, 1e-7), (0.0, 1e-6)] {
        let (_, notes) = json(k1, p2).unwrap_or_else(|e| panic!("{e}"));
        assert!(notes.iter().any(|note| note.id == "distortion-invisible") && !notes.is_degraded());
    }
    for (k1, p2) in [(1e-3, 0.0), (0.0, 1e-4)] {
        assert!(!json(k1, p2).unwrap_or_else(|e| panic!("{e}")).0[0].lens.is_pinhole());
    }
    assert!(json(f64::NAN, 0.0).is_err());
    let text = images();
    let colmap = |model: &str| {
        let cameras = format!("7 {model}\n");
        load(&[("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", text.as_bytes())], &node("m"))
    };
    for tiny in [
        "SIMPLE_RADIAL 40 30 50 20 15 1e-6",
        "RADIAL 40 30 50 20 15 0 -1e-6",
        "OPENCV 40 30 50 50 20 15 0 0 1e-6 0",
        "FULL_OPENCV 40 30 50 50 20 15 0 0 0 0 1e-6 0 0 1e-7",
        "FOV 40 30 50 50 20 15 1e-4",
    ] {
        assert!(colmap(tiny).is_ok_and(|(_, notes)| !notes.is_degraded()), "{tiny}");
    }
    for seen in [
        "RADIAL 40 30 50 20 15 0 -0.3",
        "FULL_OPENCV 40 30 50 50 20 15 0 0 0 0 0.4 0 0 0",
        "FOV 40 30 50 50 20 15 0.7",
        "SIMPLE_RADIAL_FISHEYE 40 30 50 20 15 1e-9",
    ] {
        let (cameras, _) = colmap(seen).unwrap_or_else(|e| panic!("{seen}: {e}"));
        assert!(cameras.iter().all(|camera| !camera.lens.is_pinhole()), "{seen}");
    }
    assert!(colmap("OPENCV 40 30 50 50 20 15 nan 0 0 0").is_err());
}
