//! Distortion and fields of view in the forms that nerfstudio writes.

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
