//! `pose`: where an object stands.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes};
use glam::{DMat3, DMat4, DVec3};

use crate::math::equirect::{axes, yaw};
use crate::types::Pose;

engine::params! {
    /// The pose of an object: where the origin of its file lies, the direction it faces, and its size.
    ///
    /// The origin is at the foot in files that are made to be placed, and in the middle in many others: `snap`
    /// moves those onto the ground below them.
    ///
    /// The object is scaled, rotated about the up axis of the scene (counter-clockwise seen from above), and then
    /// translated. Give `matrix` instead for any other affine transform.
    pub struct PoseNode {
        /// Position of the origin of the object's file, in the world.
        translation: [f64; 3] = [0.0; 3], range(-1e12, 1e12), unit("world units"), other("(0.5, 0.0, 0.2)");
        /// Rotation about the up axis, counter-clockwise seen from above.
        yaw_deg: f64 = 0.0, range(-36000, 36000), unit("degrees"), other("30.0");
        /// Uniform scale. A negative scale mirrors all three axes, so the object hangs below its origin; for a
        /// mirrored object that stands, give a `matrix`.
        scale: f64 = 1.0, range(-1e9, 1e9), other("2.0");
        /// Affine transform from the object's frame (axes of the world) to the world: 16 numbers in row-major
        /// order. Replaces the three parameters above.
        matrix: Option<[f64; 16]> = None, other("Some((1.0, 0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`PoseNode`].
    pub struct Out {
        /// The transform from the object's frame to the world.
        pose: Arc<Pose>,
    }
}

impl Kind for PoseNode {
    const NAME: &'static str = "pose";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up];
    const STORE: Keep = Keep::Cheap;
    const INSTANT: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        let Some(m) = p.matrix else {
            return if p.scale == 0.0 {
                Err(NodeError::new("a scale of 0 makes the object vanish").at("scale"))
            } else {
                Ok(())
            };
        };
        if p.translation != [0.0; 3] || p.yaw_deg != 0.0 || p.scale != 1.0 {
            return Err(NodeError::new("`matrix` already holds translation, yaw and scale")
                .at("matrix")
                .hint("give either `matrix`, or the others"));
        }
        if m[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(NodeError::new("the last row of `matrix` must be 0, 0, 0, 1").at("matrix").hint(
                "the matrix is in row-major order; the translation is at the end of the first three rows",
            ));
        }
        let det = DMat3::from_mat4(row_major(&m)).determinant();
        if det == 0.0 || !det.is_finite() {
            return Err(NodeError::new("the determinant of `matrix` must be finite and not 0").at("matrix"));
        }
        Ok(())
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let world_from_local = match p.matrix {
            Some(matrix) => row_major(&matrix),
            None => {
                let rotation = yaw(axes(cx.up()), p.yaw_deg);
                let linear = rotation * p.scale;
                DMat4::from_cols(
                    linear.x_axis.extend(0.0),
                    linear.y_axis.extend(0.0),
                    linear.z_axis.extend(0.0),
                    DVec3::from_array(p.translation).extend(1.0),
                )
            }
        };
        let mut notes = Notes::none();
        if DMat3::from_mat4(world_from_local).determinant() < 0.0 {
            notes.decision("mirrored", "the pose mirrors the object");
        }
        Ok((Out { pose: Arc::new(Pose { world_from_local }) }, notes))
    }
}

fn row_major(rows: &[f64; 16]) -> DMat4 {
    DMat4::from_cols_array(rows).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::num::sin_cos_deg;
    use engine::{Scene, Up};

    pub(crate) fn pose(up: Up, p: &PoseNode) -> Pose {
        let cx = Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        let (out, _) = PoseNode::run(p, In {}, &cx).unwrap_or_else(|e| panic!("{e}"));
        (*out.pose).clone()
    }
    fn plain() -> PoseNode {
        PoseNode { translation: [0.0; 3], yaw_deg: 0.0, scale: 1.0, matrix: None }
    }

    #[test]
    fn quarter_turns_are_exact_and_counter_clockwise_from_above() {
        for (up, from, to) in [
            (Up::PlusZ, DVec3::X, DVec3::Y),
            (Up::PlusY, DVec3::X, DVec3::NEG_Z),
            (Up::MinusY, DVec3::X, DVec3::Z),
        ] {
            let p = PoseNode { yaw_deg: 90.0, ..plain() };
            assert_eq!(pose(up, &p).world_from_local.transform_point3(from), to);
            let full = PoseNode { yaw_deg: -360.0, ..plain() };
            assert_eq!(pose(up, &full).world_from_local, DMat4::IDENTITY);
        }
    }

    #[test]
    fn turns_and_scales_before_it_moves() {
        let p = PoseNode { translation: [1.0, 2.0, 3.0], yaw_deg: 90.0, scale: 2.0, matrix: None };
        let moved = pose(Up::PlusZ, &p).world_from_local.transform_point3(DVec3::X);
        assert_eq!(moved, DVec3::new(1.0, 4.0, 3.0));
    }

    #[test]
    fn matrix_equals_the_parts_and_is_row_major() {
        let (s, c) = sin_cos_deg(20.0);
        let m = [c, -s, 0.0, 1.0, s, c, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 1.0];
        let a = pose(Up::PlusZ, &PoseNode { matrix: Some(m), ..plain() });
        let b = pose(Up::PlusZ, &PoseNode { translation: [1.0, 2.0, 3.0], yaw_deg: 20.0, ..plain() });
        assert_eq!(a, b);
    }

    #[test]
    fn flat_and_contradictory_poses_are_refused() {
        assert!(PoseNode::check(&PoseNode { scale: 0.0, ..plain() }).is_err());
        let identity = DMat4::IDENTITY.to_cols_array();
        let both = PoseNode { matrix: Some(identity), yaw_deg: 1.0, ..plain() };
        assert!(PoseNode::check(&both).is_err());
        let mut flat = identity;
        flat[0] = 0.0;
        assert!(PoseNode::check(&PoseNode { matrix: Some(flat), ..plain() }).is_err());
        assert!(PoseNode::check(&PoseNode { matrix: Some(identity), ..plain() }).is_ok());
        let mut column_major = identity;
        column_major[12] = 3.0;
        assert!(PoseNode::check(&PoseNode { matrix: Some(column_major), ..plain() }).is_err());
    }
}
