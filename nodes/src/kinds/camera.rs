//! `camera`: a single pinhole camera, defined by its position and target.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes, ViewCount};
use glam::{DMat4, DVec3};
use scene::math::equirect::axes;
use scene::math::num;
use scene::math::num::sin_cos_deg;
use scene::types::view::check_name;
use scene::types::{self, Rig};

engine::params! {
    /// A camera that stands at `eye` and looks at `target`.
    ///
    /// It is upright with respect to the scene's `up` unless rolled, with square pixels and the principal point in
    /// the middle of the picture.
    pub struct Camera {
        /// Position of the camera.
        eye: [f64; 3], range(-1e12, 1e12), unit("world units"), other("(3.0, 2.0, 2.0)");
        /// Point that appears in the middle of the picture.
        target: [f64; 3], range(-1e12, 1e12), unit("world units"), other("(0.0, 0.0, 0.5)");
        /// Width of the picture.
        width_px: u32 = 1280, range(1, 65536), unit("px"), other("640");
        /// Height of the picture.
        height_px: u32 = 720, range(1, 65536), unit("px"), other("480");
        /// Vertical field of view.
        fov_y_deg: f64 = 45.0, range(0.001, 179.9), unit("degrees"), other("60.0");
        /// Rotates the camera clockwise about its line of sight, so the picture turns counter-clockwise.
        roll_deg: f64 = 0.0, range(-360, 360), unit("degrees"), other("10.0");
        /// Name of the view, which replaces `{view}` in paths.
        name: String = "camera".to_owned(), other("\"left\"");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// The camera.
    pub struct Out {
        /// A rig of one camera.
        rig: Arc<Rig>,
    }
}

impl Kind for Camera {
    const NAME: &'static str = "camera";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up];
    const STORE: Keep = Keep::Cheap;
    const INSTANT: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        let towards = DVec3::from_array(p.target) - DVec3::from_array(p.eye);
        if towards.length() == 0.0 {
            return Err(NodeError::new(
                "`eye` and `target` are the same point, so the camera has no direction",
            )
            .at("target"));
        }
        check_name(&p.name)
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::Known(1)
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let [_, _, up] = axes(cx.up());
        let eye = DVec3::from_array(p.eye);
        let forward = (DVec3::from_array(p.target) - eye).normalize();
        let right = forward.cross(up);
        // Below this, the direction of the horizon is rounding noise.
        if right.length() < 1e-9 {
            return Err(NodeError::new(
                "the camera looks along the up axis, so the top of the picture is undefined",
            )
            .at("target")
            .hint("move `eye` or `target` a little sideways"));
        }
        let right = right.normalize();
        let down = forward.cross(right);
        let (s, c) = sin_cos_deg(p.roll_deg);
        let (x, y) = (right * c + down * s, down * c - right * s);
        let half_tangent = num::f64::tan((p.fov_y_deg / 2.0).to_radians());
        let focal = f64::from(p.height_px) / 2.0 / half_tangent;
        let camera = types::Camera {
            name: p.name.clone(),
            width_px: p.width_px,
            height_px: p.height_px,
            fx: focal,
            fy: focal,
            cx: f64::from(p.width_px) / 2.0,
            cy: f64::from(p.height_px) / 2.0,
            lens: types::Lens::PINHOLE,
            world_from_camera: DMat4::from_cols(
                x.extend(0.0),
                y.extend(0.0),
                forward.extend(0.0),
                eye.extend(1.0),
            )
            .to_cols_array(),
        };
        Ok((Out { rig: Arc::new(Rig { cameras: vec![camera] }) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};

    fn camera(up: Up, p: &Camera) -> Result<types::Camera, NodeError> {
        Camera::check(p)?;
        let cx = Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        Ok(Camera::run(p, In {}, &cx)?.0.rig.cameras[0].clone())
    }
    fn plain(eye: [f64; 3], target: [f64; 3]) -> Camera {
        let name = "camera".to_owned();
        Camera { eye, target, width_px: 64, height_px: 48, fov_y_deg: 45.0, roll_deg: 0.0, name }
    }

    #[test]
    fn target_is_in_the_middle_and_up_is_up() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let c = camera(up, &plain([3.0, 1.5, 2.0], [0.5, 0.25, 0.0])).unwrap_or_else(|e| panic!("{e}"));
            let m = c.camera_from_world();
            let middle = m.transform_point3(DVec3::new(0.5, 0.25, 0.0));
            assert!(middle.x.abs() < 1e-12 && middle.y.abs() < 1e-12 && middle.z > 0.0);
            let above = m.transform_vector3(axes(up)[2]);
            assert!(above.y < 0.0 && above.x.abs() < 1e-12, "up points to the top of the picture");
            let edge = c.direction(32.0, 0.0).dot(c.direction(32.0, 48.0));
            assert!((num::f64::acos(edge).to_degrees() - 45.0).abs() < 1e-9);
            let turn = c.world_from_camera() * m;
            assert!((turn - DMat4::IDENTITY).to_cols_array().iter().all(|v| v.abs() < 1e-12));
        }
    }

    #[test]
    fn roll_turns_the_camera_clockwise() {
        let p = Camera { roll_deg: 90.0, ..plain([0.0, -5.0, 0.0], [0.0; 3]) };
        let c = camera(Up::PlusZ, &p).unwrap_or_else(|e| panic!("{e}"));
        // A camera lying on its right side has its own right pointing down.
        assert!((c.world_from_camera().transform_vector3(DVec3::X) - DVec3::NEG_Z).length() < 1e-12);
    }

    #[test]
    fn what_has_no_answer_is_refused() {
        assert!(camera(Up::PlusZ, &plain([1.0; 3], [1.0; 3])).is_err());
        assert!(camera(Up::PlusZ, &plain([0.0, 0.0, 5.0], [0.0; 3])).is_err());
        assert!(camera(Up::PlusY, &plain([0.0, 0.0, 5.0], [0.0; 3])).is_ok());
    }
}
