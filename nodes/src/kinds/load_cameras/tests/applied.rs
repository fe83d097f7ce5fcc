//! Distortion that is applied: where lenses show points.

use glam::DVec3;
use scene::types::LensModel;

use super::*;

fn applying(path: &str) -> LoadCameras {
    LoadCameras { distortion: Distortion::Apply, ..node(path) }
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
        let of_colmap = load(&files, &applying("m")).unwrap_or_else(|e| panic!("{colmap}: {e}")).0.remove(0);
        let json = frames(
            &format!(r#"{keys}"w": 640, "h": 480, "fl_x": 500, "fl_y": 510, "cx": 320, "cy": 250, "#),
            "",
        );
        let of_json = load(&[("t.json", json.as_bytes())], &applying("t.json"));
        let of_json = of_json.unwrap_or_else(|e| panic!("{json}: {e}")).0.remove(0);
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
        let camera = load(&files, &applying("m")).unwrap_or_else(|e| panic!("{model}: {e}")).0.remove(0);
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
        let error = load(&files, &applying("m")).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("shows no direction below 85 degrees at (0, 0)"), "{model}: {error}");
        assert!(load(&files, &LoadCameras { distortion: Distortion::Ignore, ..node("m") }).is_ok());
    }
}

/// Coefficients have the same meaning in every form in which files state them. This test fails if `bend` passes
/// `found.rational()` for nerfstudio, or takes every lens with `k1` for a radial one.
#[test]
fn lenses_of_json_have_the_model_that_the_file_states() {
    let lens = |keys: &str| {
        let text = frames(&format!(r#""w": 40, "h": 30, "fl_x": 50, {keys}"#), "");
        let read = load(&[("t.json", text.as_bytes())], &applying("t.json"));
        read.map(|(cameras, notes)| (cameras[0].lens, notes.is_degraded())).map_err(|e| e.to_string())
    };
    let polynomial = |numerator, tangential| {
        let model = LensModel::Radial { numerator, denominator: [0.0; 3], tangential };
        Ok((model.into(), false))
    };
    assert_eq!(
        lens(r#""distortion_params": [0.3, 0, 0, 0, 0, 0], "#),
        polynomial([0.3, 0.0, 0.0, 0.0], [0.0; 2])
    );
    assert_eq!(lens(r#""k1": 0.1, "k4": "0.3", "#), polynomial([0.1, 0.0, 0.0, 0.3], [0.0; 2]));
    assert_eq!(lens(r#""p1": 0.01, "p2": -0.02, "#), polynomial([0.0; 4], [0.01, -0.02]));
    let fisheye = |k| Ok((LensModel::Fisheye { k }.into(), false));
    assert_eq!(lens(r#""is_fisheye": true, "#), fisheye([0.0; 4]));
    assert_eq!(lens(r#""camera_model": "OPENCV_FISHEYE", "k1": 0.1, "#), fisheye([0.1, 0.0, 0.0, 0.0]));
    assert_eq!(lens(r#""k1": 0.0, "#), Ok((LensModel::Pinhole.into(), false)));
    for keys in [
        r#""camera_model": "FISHEYE624", "k1": 0.1, "#,
        r#""camera_model": "THIN_PRISM_FISHEYE", "#,
        r#""is_fisheye": true, "p1": 0.1, "#,
        r#""k1": 0.1, "k5": 0.1, "#,
    ] {
        let error = lens(keys).err().unwrap_or_default();
        assert!(error.contains("of a model that is not supported"), "{keys}: {error}");
    }
}
