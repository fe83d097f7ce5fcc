//! Distortion, lens flags and fields of view.

use super::*;

// nerfstudio's parser reads the list `distortion_params` and numbers written as text. An earlier version ignored both,
// and rendered such cameras as pinhole cameras.
#[test]
fn distortion_is_read_in_every_form_of_nerfstudio() {
    let lens = r#""w": 40, "h": 30, "fl_x": 50, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "#;
    let bent = r#""distortion_params": [0.3, 0, 0, 0, 0, 0], "#;
    for text in [
        frames(&format!("{lens}{bent}"), ""),
        frames(lens, bent),
        frames(lens, r#""distortion_params": [0, 0, 0, 0, 0, -0.2], "#),
        frames(&format!("{lens}{bent}"), r#""k1": 0.1, "#),
        frames(r#""w": 40, "h": 30, "fl_x": 50, "k1": "0.1", "#, ""),
        frames(lens, r#""k1": " 1e-1 ", "#),
        frames(lens, r#""distortion_params": [0, 0, 0, 0, 0, 0], "k1": 0.1, "#),
    ] {
        let error = of_json(&text).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("has lens distortion (OPENCV "), "{text}: {error}");
        let ignore = LoadCameras { distortion: Distortion::Ignore, ..node("t.json") };
        assert!(load(&[("t.json", text.as_bytes())], &ignore).is_ok_and(|(_, notes)| notes.is_degraded()));
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
            let error = of_json(&text).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains("has lens distortion (OPENCV"), "{keys}: {error}");
            let ignore = LoadCameras { distortion: Distortion::Ignore, ..node("t.json") };
            let (cameras, notes) =
                load(&[("t.json", text.as_bytes())], &ignore).unwrap_or_else(|e| panic!("{keys}: {e}"));
            assert!(cameras == plain && notes.is_degraded(), "{keys}");
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
        (
            r#""w": 80, "h": 60, "fl_x": 3, "fl_y": 4, "#.to_owned(),
            r#""w": 40.0, "h": 30.0, "fl_y": 50, "#.to_owned(),
        ),
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
            let error = of_json(&text).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains("distortion") && error.contains("is_fisheye"), "{text}: {error}");
        }
    }
    for flag in ["latlong", "equirectangular", "orthographic"] {
        let error = of_json(&frames(&format!(r#""{flag}": true, {lens}"#), "")).err().map(|e| e.to_string());
        assert!(error.is_some_and(|e| e.contains(flag)));
    }
    // The first coefficient is usually 0. An earlier version then took the lens for a pinhole.
    for value in ["0.0", "-1.5"] {
        let key = format!(r#""ftheta_p0": {value}, "#);
        for text in [frames(&format!("{key}{lens}"), ""), frames(lens, &key)] {
            assert!(of_json(&text).err().is_some_and(|e| e.to_string().contains("ftheta_p0")), "{text}");
        }
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
    assert!(json(1e-3, 0.0).is_err() && json(0.0, 1e-4).is_err() && json(f64::NAN, 0.0).is_err());
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
        "OPENCV 40 30 50 50 20 15 nan 0 0 0",
    ] {
        assert!(colmap(seen).is_err(), "{seen}");
    }
}
