//! `cube-rig`: six cameras that cover all directions around a point.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes, ViewCount};
use glam::DVec3;
use scene::math::{equirect, num};
use scene::types::{Camera, Pose, Rig};

engine::choices! {
    /// Orientation of the cube of cameras.
    pub enum Turn {
        /// Rotated so that no face looks along an axis of the world. Files of captures quantise positions along the
        /// axes, so a camera that looks along an axis sees many splats of equal depth, which are drawn in file
        /// order.
        OffAxis,
        /// Not rotated: each face looks along an axis of the world, as in other tools.
        Aligned,
    }
}

engine::params! {
    /// Places six cameras around a point above an object's foot, for a panorama of its surroundings.
    ///
    /// Only the translation of the pose is used: rotating or scaling the object does not change the rig. Each face
    /// is wider than 90 degrees, so that `stitch` can blend neighbours.
    pub struct CubeRig {
        /// Height of the cameras above the origin of the pose, along the up axis.
        height_metres: f64 = 0.5, range(-1000.0, 1000.0), unit("m"), other("0.75");
        /// Width and height of each face, including the guard band.
        size_px: u32 = 512, range(1, 8192), unit("px"), other("64"),
            knob(Resolution, "128", "256", "512", "1024");
        /// Angle by which a face extends beyond 45 degrees on each side.
        guard_deg: f64 = 3.0, range(0.0, 30.0), unit("degrees"), other("5.0");
        /// Orientation of the cube.
        turn: Turn = Turn::OffAxis, other("Aligned");
    }
}
engine::inputs! {
    /// Inputs of [`CubeRig`].
    pub struct In {
        /// Pose of the object.
        at: Arc<Pose>,
    }
}
engine::outputs! {
    /// Outputs of [`CubeRig`].
    pub struct Out {
        /// The cameras: front, right, back, left, up, down.
        rig: Arc<Rig>,
    }
}

/// Rotations of an off-axis cube about up, then right, then forward, in degrees. Other angles far from 0, 45 and 90
/// would work as well. With these angles, the viewing direction of every face is at least 15 degrees from every
/// axis.
const OFF_AXIS_DEG: [f64; 3] = [27.0, 19.0, 11.0];

/// Rotates the perpendicular unit vectors `a` and `b` in their plane by `degrees`, from `a` towards `b`.
fn turned(a: DVec3, b: DVec3, degrees: f64) -> (DVec3, DVec3) {
    let (sin, cos) = num::sin_cos(degrees.to_radians());
    (a * cos + b * sin, b * cos - a * sin)
}

/// The six cameras at `eye`. `axes` are the right, forward and up directions of the world.
pub(crate) fn cube(eye: DVec3, axes: [DVec3; 3], size_px: u32, guard_deg: f64, turn: Turn) -> Rig {
    let [mut right, mut forward, mut above] = axes;
    if turn == Turn::OffAxis {
        (right, forward) = turned(right, forward, OFF_AXIS_DEG[0]);
        (forward, above) = turned(forward, above, OFF_AXIS_DEG[1]);
        (above, right) = turned(above, right, OFF_AXIS_DEG[2]);
    }
    let faces = [
        ("front", right, forward),
        ("right", -forward, right),
        ("back", -right, -forward),
        ("left", forward, -right),
        ("up", right, above),
        ("down", right, -above),
    ];
    let half = 0.5 * f64::from(size_px);
    let focal = half / num::f64::tan((45.0 + guard_deg).to_radians());
    let cameras = faces
        .into_iter()
        .map(|(name, x, z)| Camera::centred(name, [size_px; 2], focal, [x, z.cross(x), z], eye));
    Rig { cameras: cameras.collect() }
}

impl Kind for CubeRig {
    const NAME: &'static str = "cube-rig";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    const INSTANT: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::Known(6)
    }

    fn run(params: &Self, In { at }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let axes = equirect::axes(cx.up());
        let eye = at.translation() + axes[2] * (params.height_metres / cx.metres_per_unit());
        if !eye.is_finite() {
            return Err(NodeError::new("the position of the cameras is not finite").at("at"));
        }
        let rig = cube(eye, axes, params.size_px, params.guard_deg, params.turn);
        Ok((Out { rig: Arc::new(rig) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use engine::Up;
    use glam::DMat4;

    use super::*;

    #[test]
    fn every_direction_is_seen_and_no_face_looks_along_an_axis() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let rig = cube(DVec3::new(1.0, 2.0, 3.0), equirect::axes(up), 64, 3.0, Turn::OffAxis);
            for camera in &rig.cameras {
                let m = camera.world_from_camera();
                let (x, y, z) = (m.x_axis.truncate(), m.y_axis.truncate(), m.z_axis.truncate());
                assert!((x.cross(y) - z).length() < 1e-12 && (z.length() - 1.0).abs() < 1e-12);
                let closest = z.abs().max_element();
                assert!(closest < 0.97, "{} looks along an axis: {z}", camera.name);
            }
            for i in 0..40 {
                for j in 0..80 {
                    let d = equirect::direction(up, (f64::from(j) + 0.5) / 80.0, (f64::from(i) + 0.5) / 40.0);
                    let seen = rig.cameras.iter().any(|camera| {
                        let local = camera.camera_from_world().transform_vector3(d);
                        let (u, v) = (
                            local.x / local.z * camera.fx + camera.cx,
                            local.y / local.z * camera.fy + camera.cy,
                        );
                        local.z > 0.0 && (0.0..=64.0).contains(&u) && (0.0..=64.0).contains(&v)
                    });
                    assert!(seen);
                }
            }
        }
    }

    #[test]
    fn only_the_translation_of_the_pose_enters() {
        let cx = testing::context();
        let params = CubeRig { height_metres: 0.5, size_px: 16, guard_deg: 3.0, turn: Turn::OffAxis };
        let rig = |m: DMat4| {
            let pose = Arc::new(Pose { world_from_local: m });
            CubeRig::run(&params, In { at: pose }, &cx).expect("runs").0.rig
        };
        let foot = DVec3::new(1.0, -2.0, 0.25);
        let plain = rig(DMat4::from_translation(foot));
        let (a, b) = turned(DVec3::X, DVec3::Y, 30.0);
        let other = DMat4::from_cols(
            (a * 2.0).extend(0.0),
            (b * 2.0).extend(0.0),
            (DVec3::Z * 2.0).extend(0.0),
            foot.extend(1.0),
        );
        assert_eq!(plain, rig(other));
        assert_eq!(plain.cameras[0].eye(), foot + DVec3::Z * 0.5);
    }
}
