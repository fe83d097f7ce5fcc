//! `pose`: the position, direction and size of an object.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes, Wired};
use glam::{DMat3, DMat4, DVec3};
use render::pick::{on_mesh, on_splats};
use scene::math::equirect::{axes, yaw};
use scene::math::num;
use scene::types::{Mesh, Pose, Rig, Splats};

engine::params! {
    /// The pose of an object: the position of the origin of its file, the direction it faces, and its size.
    ///
    /// Files that are made to be placed have their origin at the foot of the object; many others have it in the
    /// middle. `snap` moves such objects onto the ground below them.
    ///
    /// The object is scaled, rotated about the up axis of the scene (counter-clockwise seen from above), and then
    /// translated. Give `matrix` instead for any other affine transform, or `pixel` to put the object where a view
    /// shows the ground.
    pub struct PoseNode {
        /// World position of the origin of the object's file.
        translation: [f64; 3] = [0.0; 3], range(-1e12, 1e12), unit("world units"), other("(0.5, 0.0, 0.2)");
        /// Rotation about the up axis, counter-clockwise seen from above.
        yaw_deg: f64 = 0.0, range(-36000, 36000), unit("degrees"), other("30.0");
        /// Uniform scale. A negative scale mirrors all three axes, so the object hangs below its origin. To mirror
        /// an object that stands upright, give a `matrix`.
        scale: f64 = 1.0, range(-1e9, 1e9), other("2.0");
        /// Affine transform from the object's frame (axes of the world) to the world: 16 numbers in row-major
        /// order. Replaces `translation`, `yaw_deg` and `scale`.
        matrix: Option<[f64; 16]> = None, other("Some((1.0, 0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))");
        /// A pixel of the view `rig`, counted from the upper left, that shows the ground on `mesh` or
        /// `splats`. `translation` is added to that point of the ground. A pixel that shows no ground, or
        /// ground steeper than 45 degrees, is an error. With another camera or another picture size, the same pixel
        /// is another place; the note `picked` states the place, to write it as `translation` instead.
        pixel: Option<[f64; 2]> = None, range(0, 65536), unit("px"), other("Some((20.5, 25.5))");
    }
}
engine::inputs! {
    /// Inputs of [`PoseNode`]: the view that `pixel` refers to, and the place that it shows. They are used
    /// only with `pixel`.
    pub struct In {
        /// The view that `pixel` refers to: a rig of one camera.
        rig: Option<Arc<Rig>>,
        /// Mesh of the place that the view shows; `splats` can be given instead.
        mesh: Option<Arc<Mesh>>,
        /// The splats of the place.
        splats: Option<Arc<Splats>>,
    }
}
engine::outputs! {
    /// Outputs of [`PoseNode`].
    pub struct Out {
        /// The transform from the object's frame to the world.
        pose: Arc<Pose>,
        /// The translation alone. It stays the same while the object is only rotated or scaled, so what depends on it
        /// is not computed again: wire it to `around` of `extract-mesh` and to `at` of `cube-rig`.
        position: Arc<Pose>,
    }
}

impl Kind for PoseNode {
    const NAME: &'static str = "pose";
    const VERSION: u32 = 2;
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
        if p.pixel.is_some() || p.translation != [0.0; 3] || p.yaw_deg != 0.0 || p.scale != 1.0 {
            return Err(NodeError::new("`matrix` already contains translation, yaw and scale")
                .at("matrix")
                .hint("give either `matrix` or the other parameters"));
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

    fn check_wires(p: &Self, wired: &Wired) -> Result<(), NodeError> {
        let [rig, mesh, splats] = ["rig", "mesh", "splats"].map(|input| !wired.of(input).is_empty());
        match (p.pixel.is_some(), rig, mesh != splats) {
            (true, true, true) => Ok(()),
            (false, _, _) if !(rig || mesh || splats) => Ok(()),
            (true, _, _) => Err(NodeError::new("`pixel` needs a camera and the scene that the camera shows")
                .at("pixel")
                .hint("wire `rig`, and either `mesh` or `splats`")),
            (false, _, _) => Err(NodeError::new(
                "`rig`, `mesh` and `splats` are used only with `pixel`, which is not given",
            )
            .at("pixel")
            .hint("write `pixel: (x, y)`, or remove the wires")),
        }
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let ground = match p.pixel {
            Some(pixel) => ground(pixel, &inputs, cx, &mut notes).map_err(|e| e.at("pixel"))?,
            None => DVec3::ZERO,
        };
        let world_from_local = match p.matrix {
            Some(matrix) => row_major(&matrix),
            None => {
                let rotation = yaw(axes(cx.up()), p.yaw_deg);
                let linear = rotation * p.scale;
                DMat4::from_cols(
                    linear.x_axis.extend(0.0),
                    linear.y_axis.extend(0.0),
                    linear.z_axis.extend(0.0),
                    (ground + DVec3::from_array(p.translation)).extend(1.0),
                )
            }
        };
        if DMat3::from_mat4(world_from_local).determinant() < 0.0 {
            notes.decision("mirrored", "the pose mirrors the object");
        }
        let position = DMat4::from_translation(world_from_local.w_axis.truncate());
        let [pose, position] =
            [world_from_local, position].map(|world_from_local| Arc::new(Pose { world_from_local }));
        Ok((Out { pose, position }, notes))
    }
}

/// Point of the ground that the pixel `pixel` shows.
fn ground(pixel: [f64; 2], inputs: &In, cx: &Context, notes: &mut Notes) -> Result<DVec3, NodeError> {
    let cameras = inputs.rig.as_deref().map_or(&[][..], |rig| &rig.cameras);
    let [camera] = cameras else {
        return Err(NodeError::new(format!(
            "`rig` has {} cameras, but `pixel` needs exactly one",
            cameras.len()
        ))
        .hint("load a single camera, for example by `LoadCameras(pick: [\"name\"])`"));
    };
    let picked = match (&inputs.mesh, &inputs.splats) {
        (Some(mesh), None) => on_mesh(mesh, camera, pixel)?,
        (None, Some(splats)) => on_splats(splats, camera, pixel, cx)?,
        _ => return Err(NodeError::new("wire exactly one of `mesh` and `splats` as the ground")),
    };
    let [_, _, up] = axes(cx.up());
    let (level, across) = (picked.normal.dot(up), picked.normal.cross(up).length());
    if level < across {
        let steep = num::atan2(across, level).to_degrees();
        let what = format!(
            "pixel ({}, {}) of `{}` shows a surface that is {steep:.0} degrees from level, which is too steep to stand on",
            pixel[0], pixel[1], camera.name
        );
        return Err(NodeError::new(what).hint("choose a pixel that shows the ground"));
    }
    let [x, y, z] = picked.position.to_array();
    notes.decision("picked", format!("the pixel shows the ground at ({x:.4}, {y:.4}, {z:.4})"));
    Ok(picked.position)
}

fn row_major(rows: &[f64; 16]) -> DMat4 {
    DMat4::from_cols_array(rows).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};
    use scene::math::num::sin_cos_deg;

    pub(crate) fn pose(up: Up, p: &PoseNode) -> Pose {
        let cx = Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        let (out, _) = PoseNode::run(p, In { rig: None, mesh: None, splats: None }, &cx)
            .unwrap_or_else(|e| panic!("{e}"));
        (*out.pose).clone()
    }
    fn plain() -> PoseNode {
        PoseNode { translation: [0.0; 3], yaw_deg: 0.0, scale: 1.0, matrix: None, pixel: None }
    }

    #[test]
    fn the_position_does_not_depend_on_rotation_and_scale() {
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        let position = |p: PoseNode| {
            let none = In { rig: None, mesh: None, splats: None };
            PoseNode::run(&p, none, &cx).unwrap_or_else(|e| panic!("{e}")).0.position.world_from_local
        };
        let at = [1.0, 2.0, 3.0];
        let expected = DMat4::from_translation(DVec3::from_array(at));
        assert_eq!(position(PoseNode { translation: at, ..plain() }), expected);
        assert_eq!(position(PoseNode { translation: at, yaw_deg: 40.0, scale: -2.5, ..plain() }), expected);
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
        let p =
            PoseNode { translation: [1.0, 2.0, 3.0], yaw_deg: 90.0, scale: 2.0, matrix: None, pixel: None };
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

    /// Floor at z = 0.5 that ends with a wall at y = 2, and a camera in front of the wall. The top of the wall is
    /// at z = 1.5.
    fn place() -> (Mesh, scene::types::Camera) {
        let mut mesh = Mesh::default();
        let mut quad = |corners: [[f32; 3]; 4]| {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(corners);
            mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|v| v + first)));
        };
        quad([[-4.0, -4.0, 0.5], [4.0, -4.0, 0.5], [4.0, 2.0, 0.5], [-4.0, 2.0, 0.5]]);
        quad([[-4.0, 2.0, 0.5], [4.0, 2.0, 0.5], [4.0, 2.0, 1.5], [-4.0, 2.0, 1.5]]);
        let forward = DVec3::new(0.0, 1.0, -0.3).normalize();
        let axes = [DVec3::X, forward.cross(DVec3::X), forward];
        let eye = DVec3::new(0.0, -3.0, 1.7);
        (mesh, scene::types::Camera::centred("view", [64, 48], 40.0, axes, eye))
    }

    fn at(pixel: [f64; 2], on_splats: bool) -> Result<Pose, NodeError> {
        let (mesh, camera) = place();
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        let splats = on_splats.then(|| Arc::new(render::look::of_mesh(&mesh)));
        let mesh = (!on_splats).then(|| Arc::new(mesh));
        let inputs = In { rig: Some(Arc::new(Rig { cameras: vec![camera] })), mesh, splats };
        let p = PoseNode { pixel: Some(pixel), translation: [0.0, 0.0, 0.25], ..plain() };
        PoseNode::run(&p, inputs, &cx).map(|(out, _)| (*out.pose).clone())
    }

    /// A pixel places an object only where it shows the ground. This test fails if `level < across` is changed to
    /// `level < -across` in `ground`.
    #[test]
    fn an_object_stands_where_a_pixel_shows_the_ground_and_nowhere_else() {
        let (_, camera) = place();
        let wanted = DVec3::new(0.6, 0.2, 0.5);
        let local = camera.camera_from_world().transform_point3(wanted);
        let pixel = [local.x / local.z * 40.0 + 32.0, local.y / local.z * 40.0 + 24.0];
        for (on_splats, bound) in [(false, 1e-9), (true, 0.03)] {
            let pose = at(pixel, on_splats).unwrap_or_else(|e| panic!("{e}"));
            let off = pose.world_from_local.w_axis.truncate() - DVec3::new(0.0, 0.0, 0.25) - wanted;
            assert!(off.length() < bound, "{off}");
            for (pixel, word) in
                [([32.0, 17.0], "degrees from level"), ([32.0, 2.0], "shows"), ([64.5, 3.0], "outside")]
            {
                let error = at(pixel, on_splats).expect_err("no ground").to_string();
                assert!(error.contains(word), "{error}");
            }
        }
        let both =
            PoseNode { pixel: Some([1.0, 1.0]), matrix: Some(DMat4::IDENTITY.to_cols_array()), ..plain() };
        assert!(PoseNode::check(&both).is_err());
    }
}
