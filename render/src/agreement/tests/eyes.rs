//! Objects so small or so low that their middles are in the splats or below the ground.

use engine::Up;
use glam::DVec3;

use super::{add, coarse, coarse_camera, faces, good_camera, mesh, splats_on};
use crate::agreement::{CapturedPlace, Comparison, compare};
use scene::math::equirect::axes;
use scene::types::{Camera, Mesh, Splats};
use testing::context;

fn around(splats: &Splats, mesh: &Mesh, camera: Camera, middle: DVec3) -> Comparison {
    let place = CapturedPlace {
        splats,
        mesh,
        cameras: &[camera],
        around: &[middle],
        axes: axes(Up::PlusZ),
        metre: 1.0,
    };
    compare(&place, &context()).expect("runs").expect("surfaces")
}

/// Over a floor of large splats, a small object raises no warning. This test fails if `free` returns the middle of the
/// object.
#[test]
fn small_objects_over_large_splats_raise_no_alarm() {
    let (splats, mesh) = coarse();
    for height in [0.02, 0.05, 0.1, 0.25] {
        for foot in [DVec3::new(1.0, 0.5, 0.0), DVec3::new(-0.3, -0.5, 0.0)] {
            let found = around(&splats, &mesh, coarse_camera(), foot + DVec3::Z * height);
            assert_eq!(found.findings(), [], "{foot} {height}: {found:?}");
        }
    }
}

/// Below the ground, captures have splats that meshes lack. An object there raises no warning. This test fails if
/// `free` returns the middle of the object.
#[test]
fn objects_below_the_ground_raise_no_alarm() {
    let low = DVec3::new(-0.6, -1.1, -0.75);
    let [x, y, z] = [DVec3::X * 1.2, DVec3::Y * 1.2, DVec3::Z * 0.6];
    let mut all = faces();
    all.extend([[low, x, y], [low, x, z], [low + y, x, z], [low, y, z], [low + x, y, z], [low + z, x, y]]);
    let splats = splats_on(&all, 0.06, 0.035, 0.0);
    let mut mesh = mesh(None);
    // The skirt of a mesh reaches below the ground.
    add(&mut mesh, DVec3::new(-3.0, 2.0, -1.0), DVec3::X * 6.0, DVec3::Z);
    let found = around(&splats, &mesh, good_camera(), DVec3::new(0.0, -0.5, -0.4));
    assert_eq!(found.findings(), [], "{found:?}");
}
