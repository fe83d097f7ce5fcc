//! Tests of objects on a rough wall: they and their shadows look as they do on a smooth wall.

use super::*;

/// A wall of 5 cm cells that faces -y, with the given noise along y.
pub(super) fn rough_wall(noise: f32) -> Mesh {
    let side = 81_u32;
    let mut mesh = Mesh::default();
    for i in 0..side * side {
        let [x, z] = [i % side, i / side].map(|k| k as f32 / 20.0 - 2.0);
        mesh.positions.push([
            x,
            noise * (2.0 * render::geometry::sampling::unit(render::geometry::sampling::mix(i)) - 1.0),
            z,
        ]);
    }
    for i in (0..side * (side - 1)).filter(|i| i % side + 1 < side) {
        mesh.triangles.extend([[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]);
    }
    mesh
}

/// Renders a framed picture with the given thickness and distance from the wall. Returns two sums over the pixels:
/// the coverage of the framed picture, and the share of light that it takes from the wall, where the wall is
/// visible.
fn seen(noise: f32, (thick, off): (f32, f64), eye: DVec3, contact_metres: Option<f64>) -> [f64; 2] {
    let picture = box_mesh([-0.4, -thick, -0.3], [0.4, 0.0, 0.3], false);
    let objects = [placed(&picture, matte(0.5), DVec3::Y * -off)];
    let how = PathTrace { contact_metres, ..params(64, Surroundings::OPEN) };
    let (out, _) = render(&how, &rough_wall(noise), &objects, &rig(eye, DVec3::ZERO, 32, 3.0), &white());
    let cover = samples(&out.object).chunks(4).map(|pixel| f64::from(pixel[3])).sum();
    let pixels = samples(&out.without).chunks(3).zip(samples(&out.with).chunks(3));
    let bare = pixels.zip(samples(&out.object).chunks(4)).filter(|(_, object)| object[3] == 0.0);
    [cover, bare.map(|((a, b), _)| 1.0 - f64::from(b[0] / a[0].max(1e-6))).sum()]
}

/// A framed picture on a rough wall is completely visible from the front and from the side. Tested with a thickness
/// of 2 cm, and with a thickness of 4 mm, which is less than the noise of the wall. This test fails if `Side::flat`
/// finds no sides, or with `contact_metres: 0`.
#[test]
fn a_picture_on_a_rough_wall_is_whole() {
    for eye in [DVec3::new(0.1, -3.0, 0.2), DVec3::new(2.4, -1.2, 0.4)] {
        for thick in [0.02, 0.004] {
            let [cover, shadow] = seen(0.0, (thick, 0.0), eye, None);
            let [found, dark] = seen(0.005, (thick, 0.0), eye, None);
            let [eaten, _] = seen(0.005, (thick, 0.0), eye, Some(0.0));
            assert!((found / cover - 1.0).abs() < 0.005, "{eye} {thick}: {found} for {cover}");
            assert!(thick > 0.01 || eaten < 0.985 * cover, "{eye}: the noise reaches over the picture");
            // The rough wall shades itself, in `without` too, so its shadows differ from those on a smooth wall.
            assert!((dark - shadow).abs() < 0.2 * shadow.abs() + 0.2, "{eye} {thick}: {dark} for {shadow}");
        }
    }
}

/// An object a few centimetres from the wall does not count as resting on it. This test fails if `gap` is as large
/// as `deep` in `Side::rests`.
#[test]
fn what_stands_near_a_wall_stays_off_it() {
    let eye = DVec3::new(2.4, -1.2, 0.4);
    assert_eq!(seen(0.005, (0.02, 0.03), eye, None), seen(0.005, (0.02, 0.03), eye, Some(0.0)));
}
