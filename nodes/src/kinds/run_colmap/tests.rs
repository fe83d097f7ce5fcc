//! Reconstructions by a stand-in for COLMAP, and every way in which they fail.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use engine::{Scene, Up};
use glam::DVec3;
use scene::io::capture::write::model as write_model;
use scene::io::png::{Raster, write};
use scene::types::{Camera, Cell, Point};

use super::*;

/// Number of photographs in the folder.
const ALL: usize = 5;
/// A stand-in for COLMAP that copies photographs and a model; `extra` is further code.
const STAND_IN: &str = r#"#!/bin/sh
here=$(dirname "$0")
EXTRA
case $1 in
help) echo "COLMAP 3.8 -- a stand-in";;
feature_extractor) test "$2" = --help || echo "Processed file [1/5]";;
mapper) mkdir -p sparse/0 sparse/1; cp "$here"/model/*.bin sparse/1; printf '\1\0\0\0\0\0\0\0' > sparse/0/images.bin;;
image_undistorter) test "$5" = sparse/1 || exit 9; mkdir -p out/sparse out/images
  cp "$here"/model/*.bin out/sparse; cp photos/* out/images;;
esac
"#;

/// A folder with photographs, a program and the model that it gives. The model has the first `with` photographs, around
/// the point (5, 5, 5), with +y down as COLMAP often has it; its points have the given reprojection error.
fn place(with: usize, error_px: f64, extra: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("is made");
    let at = |name: &str| folder.path().join(name);
    for name in ["photos", "model/sparse/0"] {
        std::fs::create_dir_all(at(name)).expect("is made");
    }
    std::fs::write(at("colmap.sh"), STAND_IN.replace("EXTRA", extra)).expect("is written");
    std::fs::set_permissions(at("colmap.sh"), PermissionsExt::from_mode(0o755)).expect("is set");
    for index in 0..ALL {
        let codes = vec![40 * index as u16; 6 * 4 * 3];
        let raster = Raster {
            width: 6,
            height: 4,
            channels: 3,
            largest: 255,
            codes,
            colour: None,
            ignored: Vec::new(),
        };
        std::fs::write(at(&format!("photos/p{index}.png")), write(&raster, true, &[]).expect("encodes"))
            .expect("is written");
    }
    let photo = |index: usize| {
        let angle = index as f64 * 1.2;
        let (sin, cos) = (scene::math::num::f64::sin(angle), scene::math::num::f64::cos(angle));
        let (down, forward) = (DVec3::Y, DVec3::new(-cos, 0.0, -sin));
        // The cameras are 2 units above the lowest points.
        let eye = DVec3::splat(5.0) + DVec3::new(3.0 * cos, -2.0, 3.0 * sin);
        let camera =
            Camera::centred(&format!("p{index}"), [6, 4], 5.0, [down.cross(forward), down, forward], eye);
        Photo { camera, pixels: Vec::new() }
    };
    let point = |index: i32| Point {
        position: [5.0 + index as f32 * 0.1, 5.0 - index.rem_euclid(4) as f32, 5.0],
        rgb: [0.5; 3],
    };
    let photos = Photos { photos: (0..with).map(photo).collect(), points: (-20..=20).map(point).collect() };
    for (name, mut bytes) in write_model(&photos) {
        if name.ends_with("points3D.bin") {
            for index in 0..photos.points.len() {
                bytes[8 + index * 51 + 35..][..8].copy_from_slice(&error_px.to_le_bytes());
            }
        }
        std::fs::write(at("model").join(name.rsplit('/').next().unwrap_or(name)), bytes).expect("is written");
    }
    folder
}

fn params() -> RunColmap {
    RunColmap {
        path: InputFile("photos".to_owned()),
        largest_side_px: 640,
        matching: Matching::Exhaustive,
        lens: Lens::SimpleRadial,
        same_camera: true,
        least_share: 0.5,
        alignment: Alignment::Upright,
        camera_height_metres: 1.5,
        program: Some("./colmap.sh".to_owned()),
    }
}

fn run_in(folder: &Path, p: &RunColmap) -> Result<(Out, Notes), NodeError> {
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 0.5, seed: 1, exhaustive: false };
    RunColmap::run(p, In {}, &Context::detached(scene, folder))
}

/// The largest of two models is used, and stands upright on the ground in metres. This test fails if `largest_model`
/// takes the model with the lowest number, or if `upright` does not rotate the cameras.
#[test]
fn poses_points_and_photographs_are_read_and_upright() {
    let folder = place(ALL, 0.5, "");
    let (out, notes) = run_in(folder.path(), &params()).unwrap_or_else(|e| panic!("{e}"));
    let (photos, rig) = (&out.photos, &out.rig);
    assert_eq!((photos.photos.len(), photos.points.len(), rig.cameras.len()), (ALL, 41, ALL));
    assert_eq!(photos.photos[1].pixels, vec![[40, 40, 40, 255]; 24]);
    for camera in &rig.cameras {
        // 1.5 m are 3 units.
        assert!((camera.eye().z - 3.0).abs() < 1e-5, "{:?}", camera.eye());
        let down = camera.world_from_camera().y_axis.truncate();
        assert!((down + DVec3::Z).length() < 1e-6, "{down}");
        let across = camera.eye() - DVec3::Z * camera.eye().z;
        assert!((across.length() - 4.5).abs() < 0.3, "3 units became 4.5: {across}");
    }
    let lowest = photos.points.iter().map(|point| point.position[2]).fold(f32::INFINITY, f32::min);
    assert!(lowest.abs() < 1e-5, "{lowest}");
    let ids: Vec<&str> = notes.iter().map(|note| note.id.as_str()).collect();
    assert_eq!(ids, ["several-models", "scale-assumed"]);
    let rows = &out.report.tables[0].rows;
    assert_eq!(rows[0][1], Cell::Text("COLMAP 3.8".to_owned()));
    assert_eq!((&rows[2][1], &rows[4][1]), (&Cell::Count(5), &Cell::Number(0.5)));

    let plain = RunColmap { alignment: Alignment::AsReconstructed, ..params() };
    let (out, _) = run_in(folder.path(), &plain).unwrap_or_else(|e| panic!("{e}"));
    assert!((out.rig.cameras[0].eye() - DVec3::new(8.0, 3.0, 5.0)).length() < 1e-9);
}

/// This test fails if `judge` compares the number of photographs instead of their share.
#[test]
fn few_poses_and_large_errors_are_reported_with_numbers() {
    let folder = place(4, 2.5, "");
    let (out, notes) = run_in(folder.path(), &params()).unwrap_or_else(|e| panic!("{e}"));
    let text = |id: &str| notes.iter().find(|note| note.id == id).map_or("", |note| note.text.as_str());
    assert!(text("few-poses").contains("4 of 5 photographs (80 %)"), "{notes:?}");
    assert!(text("reprojection-error").contains("is 2.50 pixels"), "{notes:?}");
    assert_eq!(out.report.tables[1].rows[4], ["p4", "no"].map(|cell| Cell::Text(cell.to_owned())));
    for (with, least) in [(2, 0.0), (4, 0.9)] {
        let p = RunColmap { least_share: least, ..params() };
        let error = run_in(place(with, 0.5, "").path(), &p).err().expect("has too few").to_string();
        assert!(
            error.contains(&format!("poses of {with} of 5 photographs")) && error.contains("p4.png"),
            "{error}"
        );
    }
}

#[test]
fn every_failure_is_named() {
    for (extra, text) in [
        (
            "test $1 = exhaustive_matcher && test \"$2\" != --help && echo no space left >&2 && exit 4",
            "`COLMAP (matches)` failed with exit status: 4; the last lines of its standard error are:\n  no space left",
        ),
        ("test $1 = mapper && exit 0", "found no two photographs"),
        ("test $1 = mapper && echo failed to create sparse model >&2 && exit 1", "found no two photographs"),
        ("test $1 = image_undistorter && exit 0", "did not write `sparse/cameras.bin`"),
        (
            "test $1 = image_undistorter && mkdir out/sparse && cp \"$here\"/model/*.bin out/sparse && exit 0",
            "did not write `images/p0.png`",
        ),
    ] {
        let error = run_in(place(ALL, 0.5, extra).path(), &params()).err().expect("fails");
        assert!(error.to_string().contains(text), "{extra}: {error}");
    }
    let folder = place(ALL, 0.5, "");
    for (program, text) in [("./gone.sh", "was not found at"), ("no-such-colmap", "in the folders of `PATH`")]
    {
        let p = RunColmap { program: Some(program.to_owned()), ..params() };
        let error = RunColmap::sources(&p, &SourceRoot::new(folder.path())).expect_err("is missing");
        let hint = error.advice().unwrap_or_default();
        assert!(error.to_string().contains(text) && hint.contains("pip install pycolmap"), "{error} {hint}");
    }
    std::fs::remove_file(folder.path().join("photos/p0.png")).expect("is there");
    for index in 1..3 {
        std::fs::remove_file(folder.path().join(format!("photos/p{index}.png"))).expect("is there");
    }
    let error = run_in(folder.path(), &params()).err().expect("has too few").to_string();
    assert!(error.contains("contains 2 PNG or JPEG files"), "{error}");
}

/// This test fails if a step does not look at the cancellation of the run.
#[test]
fn a_step_is_cancelled() {
    let folder = place(ALL, 0.5, "test $1 = mapper && sleep 100");
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 1, exhaustive: false };
    let cx = Context::detached(scene, folder.path()).stopping_at(0.5);
    let start = Instant::now();
    assert!(RunColmap::run(&params(), In {}, &cx).is_err());
    assert!(cx.cancelled() && start.elapsed() < Duration::from_secs(50));
}
