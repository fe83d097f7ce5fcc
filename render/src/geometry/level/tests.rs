//! Tests on synthetic scenes: rooms with and without a ceiling, a yard, and noise.

use glam::{DMat3, DVec3};
use scene::math::num;
use scene::types::Camera;

use super::*;

/// Pseudo-random number from 0 to 1: element `i` of the sequence with the number `of`.
fn unit(i: usize, of: usize) -> f64 {
    let mut x = (i as u64 * 61 + of as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A rotation by an angle about an axis.
fn about(axis: DVec3, angle: f64) -> DMat3 {
    let axis = axis.normalize();
    let [x, y] = axes::across(axis);
    let (s, c) = num::sin_cos(angle);
    let from = DMat3::from_cols(x, y, axis);
    let to = DMat3::from_cols(x * c + y * s, y * c - x * s, axis);
    to * from.transpose()
}

/// Ten arbitrary rotations, and the six rotations that map up to an axis.
fn rotations() -> Vec<DMat3> {
    let arbitrary = (0..10).map(|i| {
        let axis = DVec3::new(unit(i, 0) - 0.5, unit(i, 1) - 0.5, unit(i, 2) - 0.5);
        about(axis, unit(i, 3) * 6.0)
    });
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    arbitrary.chain(axes.map(|axis| turn(DVec3::Z, axis))).collect()
}

struct Made(Splats);

impl Made {
    fn new() -> Self {
        Self(Splats::empty())
    }

    /// Adds a rectangle of flat splats. `u` and `v` are half of its sides.
    fn sheet(&mut self, count: usize, middle: [f64; 3], [u, v]: [DVec3; 2], luma: f32) {
        let normal = u.cross(v).normalize();
        let turn = turn(DVec3::Z, normal);
        for i in 0..count {
            let noise = (unit(i, 7) - 0.5) * 0.01;
            let at = DVec3::from_array(middle)
                + u * (unit(i, 5) * 2.0 - 1.0)
                + v * (unit(i, 6) * 2.0 - 1.0)
                + normal * noise;
            let size = (u.cross(v).length() / count as f64).sqrt();
            self.push(at, [size, size, 0.002], turn, luma);
        }
    }

    fn push(&mut self, at: DVec3, scale: [f64; 3], turn: DMat3, luma: f32) {
        let s = &mut self.0;
        s.means.push(at.as_vec3().to_array());
        s.scales.push(scale.map(|v| v as f32));
        s.quats.push(scene::io::splats::quaternion(turn).map(|v| v as f32));
        s.opacities.push(0.9);
        s.sh.push([(luma - 0.5) / 0.282_094_8; 3]);
    }

    /// Adds a box on the floor.
    fn thing(&mut self, [x, y]: [f64; 2], [a, b, h]: [f64; 3]) {
        let (i, j, k) = (DVec3::X * a, DVec3::Y * b, DVec3::Z * h * 0.5);
        self.sheet(200, [x, y, h], [i, j], 0.4);
        for sign in [-1.0, 1.0] {
            self.sheet(150, [x + a * sign, y, h * 0.5], [j, k], 0.3);
            self.sheet(150, [x, y + b * sign, h * 0.5], [i, k], 0.3);
        }
    }

    /// A room of 5 by 4 by 2.6 units with a table, a cupboard and two seats.
    fn room(ceiling: bool) -> Self {
        let mut room = Self::new();
        let (i, j, k) = (DVec3::X * 2.5, DVec3::Y * 2.0, DVec3::Z * 1.3);
        room.sheet(2000, [0.0; 3], [i, j], 0.3);
        if ceiling {
            room.sheet(2000, [0.0, 0.0, 2.6], [i, j], 0.85);
        }
        for sign in [-1.0, 1.0] {
            room.sheet(1300, [2.5 * sign, 0.0, 1.3], [j, k], 0.65);
            room.sheet(1600, [0.0, 2.0 * sign, 1.3], [i, k], 0.65);
        }
        room.thing([0.3, 0.2], [0.8, 0.5, 0.75]);
        room.thing([-2.0, 1.2], [0.4, 0.6, 1.9]);
        room.thing([1.6, -0.9], [0.3, 0.3, 0.45]);
        room.thing([-0.9, -0.7], [0.25, 0.25, 0.45]);
        room
    }

    fn turned(&self, turn: DMat3, shift: DVec3) -> Splats {
        let mut splats = self.0.clone();
        let turn = scene::io::splats::Turn::new(turn, 1.0, shift);
        for i in 0..splats.len() {
            let mut row = scene::io::splats::Row {
                mean: splats.means[i],
                mean_low: [0.0; 3],
                quat: splats.quats[i],
                scale: splats.scales[i],
                opacity: splats.opacities[i],
            };
            turn.apply(&mut row, &mut splats.sh[i..=i]);
            (splats.means[i], splats.quats[i]) = (row.mean, row.quat);
        }
        splats
    }
}

fn degrees(a: DVec3, b: DVec3) -> f64 {
    num::atan2(a.cross(b).length(), a.dot(b)).to_degrees()
}

#[test]
fn a_closed_room_is_not_taken_upside_down_however_it_lies() {
    for (made, ceiling) in [(Made::room(true), Some(2.6)), (Made::room(false), None)] {
        for turn in rotations() {
            let shift = DVec3::new(3.0, -2.0, 5.0);
            let found = of_splats(&made.turned(turn, shift), None).expect("a scene");
            let up = turn * DVec3::Z;
            assert!(degrees(DVec3::from_array(found.up), up) < 1.0, "{found:?}");
            assert!(found.is_floor_sure(), "{found:?}");
            assert!((found.floor - shift.dot(up)).abs() < 0.02, "{found:?}");
            assert_eq!(found.ceiling.is_some(), ceiling.is_some());
            if let (Some(found), Some(ceiling)) = (found.ceiling, ceiling) {
                assert!((found - shift.dot(up) - ceiling).abs() < 0.03, "{found}");
            }
        }
    }
}

#[test]
fn a_room_gives_its_scale_and_a_field_does_not() {
    let room = of_splats(&Made::room(true).0, None).expect("a scene");
    assert_eq!(room.scale.metres_per_unit, Some(1.0));
    let open = of_splats(&Made::room(false).0, None).expect("a scene");
    assert_eq!(open.scale.metres_per_unit, None);
}

#[test]
fn noise_has_no_up() {
    for count in [0, 2, 5, 50, 500, 5000, 30_000] {
        let mut noise = Made::new();
        for i in 0..count {
            let at = DVec3::new(unit(i, 0), unit(i, 1), unit(i, 2)) * 4.0;
            let axis = DVec3::new(unit(i, 3) - 0.5, unit(i, 4) - 0.5, unit(i, 5) - 0.5);
            noise.push(at, [0.05, 0.05, 0.01], turn(DVec3::Z, axis.normalize()), unit(i, 6) as f32);
        }
        let found = of_splats(&noise.0, None);
        assert!(found.as_ref().is_none_or(|found| !found.is_sure()), "{count}: {found:?}");
    }
}

/// Cameras at eye height that look in different directions, each rotated about its viewing direction by `roll`.
fn cameras(turn: DMat3, roll: f64, count: usize) -> Rig {
    let camera = |i: usize| {
        let (s, c) = num::sin_cos(i as f64 * 0.7);
        let forward = DVec3::new(c, s, -0.3 + 0.4 * unit(i, 1)).normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let down = forward.cross(right);
        let (sr, cr) = num::sin_cos(roll);
        let axes = [right * cr + down * sr, down * cr - right * sr, forward].map(|v| turn * v);
        let eye = turn * DVec3::new(0.4 * s, 0.3 * c, 1.5);
        Camera::centred(&format!("c{i}"), [640, 480], 500.0, axes, eye)
    };
    Rig { cameras: (0..count).map(camera).collect() }
}

/// Random splats give no estimate. Cameras that are held level determine the up direction, and cameras that are
/// held on their side leave two opposite directions possible.
#[test]
fn cameras_say_what_surfaces_do_not() {
    let mut noise = Made::new();
    for i in 0..3000 {
        let at = DVec3::new(unit(i, 0) - 0.5, unit(i, 1) - 0.5, unit(i, 2)) * 6.0;
        noise.push(at, [0.05; 3], DMat3::IDENTITY, 0.5);
    }
    for turn in rotations() {
        let splats = noise.turned(turn, DVec3::ZERO);
        let found = of_splats(&splats, Some(&cameras(turn, 0.02, 20))).expect("a scene");
        assert!(degrees(DVec3::from_array(found.up), turn * DVec3::Z) < 3.0, "{found:?}");
        assert!(found.is_sure() && found.by_cameras && !found.is_floor_sure(), "{found:?}");
        let side = of_splats(&splats, Some(&cameras(turn, 1.57, 20))).expect("a scene");
        assert!(!side.is_sure(), "{side:?}");
    }
    // Cameras of another frame do not change the estimate for a room, and do not count as agreeing.
    let room = Made::room(true);
    let other = of_splats(&room.0, Some(&cameras(about(DVec3::X, 1.2), 0.0, 20))).expect("a scene");
    assert!(degrees(DVec3::from_array(other.up), DVec3::Z) < 1.0 || !other.is_sure(), "{other:?}");
    let own = of_splats(&room.0, Some(&cameras(DMat3::IDENTITY, 0.0, 20))).expect("a scene");
    assert!(own.is_floor_sure() && own.by_cameras, "{own:?}");
}

/// A few splats that lie on a leaning plane are not a floor: level cameras give the vertical. This test fails if the
/// normal of such a plane replaces the direction of the cameras.
#[test]
fn level_cameras_are_more_exact_than_a_vague_floor() {
    let mut vague = Made::new();
    for i in 0..3000 {
        let at = DVec3::new(unit(i, 0) - 0.5, unit(i, 1) - 0.5, unit(i, 2)) * 6.0;
        vague.push(at, [0.05; 3], DMat3::IDENTITY, 0.5);
    }
    let lean = about(DVec3::X, 0.2);
    for i in 0..90 {
        let at = lean * (DVec3::new(unit(i, 5) - 0.5, unit(i, 6) - 0.5, 0.0) * 5.0);
        vague.push(at, [0.1, 0.1, 0.005], lean, 0.9);
    }
    let found = of_splats(&vague.0, Some(&cameras(DMat3::IDENTITY, 0.0, 40))).expect("a scene");
    assert!(degrees(DVec3::from_array(found.up), DVec3::Z) < 1.0 && found.is_sure(), "{found:?}");
}
