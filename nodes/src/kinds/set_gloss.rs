//! `set-gloss`: specular reflection of a mesh, or of a flat part of it.

use std::sync::Arc;

use engine::{Context, ContextField, Kind, NodeError, Notes};
use glam::DVec3;
use scene::math::{equirect, num};
use scene::types::{Gloss, Mesh, Pose};

engine::params! {
    /// Makes a mesh, or a flat part of it, glossy, so that it reflects its surroundings and the objects.
    ///
    /// `path-trace` treats a mesh as matte unless this kind makes it glossy. The gloss is that of a dielectric of index
    /// `ior`, over the matte colours of the mesh, or of a metal with these colours. A polished floor has a roughness of
    /// 0.05 to 0.3; a wet one has an index of 1.33; a mirror is `roughness: 0.0, metallic: 1.0`.
    ///
    /// If `at` is wired, only the triangles near the ground plane of that pose become glossy; all others stay as they
    /// are. Several nodes in a row give several parts their own gloss. Triangles are not cut, so a part is as exact as
    /// the triangles are small. The splats do not change: the ratio of `path-trace` darkens or brightens what they show.
    pub struct SetGloss {
        /// Perceptual roughness; 0 is a mirror.
        roughness: f64 = 0.2, range(0.0, 1.0), other("0.5");
        /// Factor of the reflectance of the dielectric; 0 reflects nothing.
        specular: f64 = 1.0, range(0.0, 1.0), other("0.3");
        /// Index of refraction of the dielectric; 1 reflects nothing.
        ior: f64 = 1.5, range(1.0, 3.0), other("1.33");
        /// Metalness, from 0 (dielectric) to 1 (metal).
        metallic: f64 = 0.0, range(0.0, 1.0), other("0.5");
        /// With `at`: maximum distance of the corners of a glossy triangle from the plane.
        thickness_metres: f64 = 0.05, range(1e-4, 100.0), unit("m"), other("0.001");
        /// With `at`: maximum angle between the normal of a glossy triangle, on either side, and the normal of the
        /// plane.
        max_tilt_deg: f64 = 30.0, range(0.0, 90.0), unit("deg"), other("0.5");
        /// With `at`: length of the part along the right axis of the pose. `None` does not limit it.
        width_metres: Option<f64> = None, range(1e-3, 1e5), unit("m"), other("0.5");
        /// With `at`: length of the part along the forward axis of the pose. `None` does not limit it.
        depth_metres: Option<f64> = None, range(1e-3, 1e5), unit("m"), other("0.4");
        /// With `at`: reflects by the normal of the plane, so that the bumps of a captured mesh do not distort
        /// reflections. `false` reflects by the normal of each triangle.
        flat: bool = true, other("false");
    }
}

engine::inputs! {
    /// Inputs of [`SetGloss`].
    pub struct In {
        /// The mesh.
        mesh: Arc<Mesh>,
        /// Middle of the flat part that becomes glossy, and its rotation, as in `plane`. Without it, the whole mesh
        /// becomes glossy.
        at: Option<Arc<Pose>>,
    }
}

engine::outputs! {
    /// Outputs of [`SetGloss`].
    pub struct Out {
        /// The same mesh with its gloss.
        mesh: Arc<Mesh>,
    }
}

/// A flat part of a mesh, in world units.
struct Part {
    middle: DVec3,
    /// Unit axes: right, forward and up.
    axes: [DVec3; 3],
    /// Maximum distance from the middle along each axis.
    reach: [f64; 3],
    /// Minimum cosine between the normal of a triangle and the up axis.
    cosine: f64,
}

impl SetGloss {
    /// The part around a pose.
    fn part(&self, at: &Pose, cx: &Context) -> Result<Part, NodeError> {
        let metre = 1.0 / cx.metres_per_unit();
        let turned = |axis: DVec3| at.world_from_local.transform_vector3(axis).normalize_or_zero();
        let axes = equirect::axes(cx.up()).map(turned);
        let middle = at.translation();
        let straight = axes[0].cross(axes[1]).dot(axes[2]);
        if !middle.is_finite() || straight.is_nan() || straight <= 0.5 {
            return Err(NodeError::new("the pose is not finite, mirrors the plane or flattens it").at("at"));
        }
        let half = |side: Option<f64>| side.map_or(f64::INFINITY, |side| 0.5 * side * metre);
        let reach = [half(self.width_metres), half(self.depth_metres), self.thickness_metres * metre];
        let (_, cosine) = num::sin_cos(self.max_tilt_deg.to_radians());
        Ok(Part { middle, axes, reach, cosine })
    }
}

impl Part {
    /// True if a triangle belongs to the part: its centroid lies in the rectangle, and all corners near the plane.
    fn contains(&self, corners: [DVec3; 3]) -> bool {
        let [a, b, c] = corners.map(|corner| corner - self.middle);
        let [right, forward, up] = self.axes;
        let centroid = (a + b + c) / 3.0;
        let inside =
            centroid.dot(right).abs() <= self.reach[0] && centroid.dot(forward).abs() <= self.reach[1];
        let near = [a, b, c].iter().all(|corner| corner.dot(up).abs() <= self.reach[2]);
        // Rounding may move the cosine of a level triangle below 1.
        let level = (b - a).cross(c - a).normalize_or_zero().dot(up).abs() >= self.cosine - 1e-9;
        inside && near && level
    }
}

/// Number of a gloss in the list of a mesh, counted from 1; 0 for a gloss that reflects nothing. A gloss that the list
/// does not have is added.
fn number(glosses: &mut Vec<Gloss>, gloss: Gloss) -> u32 {
    if !gloss.reflects() {
        return 0;
    }
    let at = glosses.iter().position(|known| *known == gloss).unwrap_or_else(|| {
        glosses.push(gloss);
        glosses.len() - 1
    });
    at as u32 + 1
}

impl Kind for SetGloss {
    const NAME: &'static str = "set-gloss";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, In { mesh, at }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let part = at.map(|at| params.part(&at, cx)).transpose()?;
        let normal = part.as_ref().filter(|_| params.flat).map_or(DVec3::ZERO, |part| part.axes[2]);
        let gloss = Gloss {
            roughness: params.roughness as f32,
            metallic: params.metallic as f32,
            ior: params.ior as f32,
            specular: params.specular as f32,
            normal: normal.as_vec3().to_array(),
        };
        let mut mesh = Mesh::clone(&mesh);
        let mut known = std::mem::take(&mut mesh.glosses);
        let own = number(&mut known, gloss);
        let mut gloss_of = std::mem::take(&mut mesh.gloss_of);
        gloss_of.resize(mesh.triangles.len(), 0);
        let mut count = 0_u64;
        for (triangle, of) in mesh.triangles.iter().zip(&mut gloss_of) {
            let corners = triangle.map(|corner| mesh.position(corner));
            if part.as_ref().is_none_or(|part| part.contains(corners)) {
                *of = own;
                count += 1;
            }
        }
        if count == 0 && !mesh.triangles.is_empty() {
            let hint = "raise `thickness_metres` or `max_tilt_deg`, move the pose onto the surface, or raise `width_metres` and `depth_metres` if the triangles are larger";
            return Err(NodeError::new("no triangle of the mesh lies in the part around `at`")
                .at("at")
                .hint(hint));
        }
        let all = gloss_of.len();
        notes.decision("gloss", format!("{count} of the {all} triangles of the mesh get this gloss"));
        // A gloss that no triangle has any more is not part of the mesh.
        for of in gloss_of.iter_mut().filter(|of| **of > 0) {
            *of = number(&mut mesh.glosses, known[*of as usize - 1]);
        }
        if !mesh.glosses.is_empty() {
            mesh.gloss_of = gloss_of;
        }
        Ok((Out { mesh: Arc::new(mesh) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, DQuat};

    use super::*;
    use testing::context;

    /// A floor of four squares at height 0, and a wall above its left edge.
    fn corner() -> Mesh {
        let mut mesh = Mesh::default();
        for y in 0..3 {
            for x in 0..3 {
                mesh.positions.push([x as f32 - 1.0, y as f32 - 1.0, 0.0]);
            }
        }
        mesh.positions.extend([[-1.0, -1.0, 2.0], [-1.0, 1.0, 2.0]]);
        for first in [0, 1, 3, 4] {
            mesh.triangles.extend([[first, first + 1, first + 4], [first, first + 4, first + 3]]);
        }
        mesh.triangles.extend([[0, 6, 9], [6, 10, 9]]);
        mesh
    }

    fn run(params: &SetGloss, mesh: Mesh, at: Option<DMat4>) -> Result<Arc<Mesh>, NodeError> {
        let at = at.map(|world_from_local| Arc::new(Pose { world_from_local }));
        SetGloss::run(params, In { mesh: Arc::new(mesh), at }, &context()).map(|(out, _)| out.mesh)
    }

    fn glossy(mesh: &Mesh) -> Vec<usize> {
        (0..mesh.triangles.len()).filter(|&i| mesh.gloss(i).is_some()).collect()
    }

    /// The part is chosen by distance, angle and rectangle. This test fails if any of the three conditions of
    /// `contains` is left out, or if `reach` has no factor of 0.5.
    #[test]
    fn only_the_part_around_the_pose_is_glossy() {
        let params = SetGloss::default();
        let home = Some(DMat4::IDENTITY);
        assert_eq!(glossy(&run(&params, corner(), None).expect("runs")).len(), 10);
        assert_eq!(glossy(&run(&params, corner(), home).expect("runs")), (0..8).collect::<Vec<_>>());
        let thick = SetGloss { thickness_metres: 5.0, ..SetGloss::default() };
        assert_eq!(glossy(&run(&thick, corner(), home).expect("runs")).len(), 8);
        let steep = SetGloss { max_tilt_deg: 90.0, ..thick };
        assert_eq!(glossy(&run(&steep, corner(), home).expect("runs")).len(), 10);
        let aside = Some(DMat4::from_translation(DVec3::new(-0.5, -0.5, 0.0)));
        let square = SetGloss { width_metres: Some(1.0), depth_metres: Some(1.0), ..SetGloss::default() };
        assert_eq!(glossy(&run(&square, corner(), aside).expect("runs")), [0, 1]);
        let long = SetGloss { depth_metres: None, ..square };
        assert_eq!(glossy(&run(&long, corner(), aside).expect("runs")), [0, 1, 4, 5]);
        // The wall, by a pose that is turned onto it.
        let turn = DMat4::from_rotation_translation(
            DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2),
            DVec3::new(-1.0, 0.0, 1.0),
        );
        let wall = run(&params, corner(), Some(turn)).expect("runs");
        assert_eq!(glossy(&wall), [8, 9]);
        let normal = wall.gloss(8).expect("glossy").normal;
        assert!((normal[0].abs() - 1.0).abs() < 1e-6, "{normal:?}");
        let bumpy = SetGloss { flat: false, ..SetGloss::default() };
        assert_eq!(run(&bumpy, corner(), home).expect("runs").gloss(0).map(|g| g.normal), Some([0.0; 3]));
        let high = Some(DMat4::from_translation(DVec3::Z));
        assert!(run(&params, corner(), high).is_err());
    }

    /// This test fails if a second gloss replaces the first one everywhere, or if a gloss that reflects nothing, or that no
    /// triangle has any more, is kept in the list.
    #[test]
    fn parts_keep_their_gloss_and_no_gloss_is_the_same_mesh() {
        let home = Some(DMat4::IDENTITY);
        let all = run(&SetGloss { roughness: 0.4, ..SetGloss::default() }, corner(), None).expect("runs");
        let both =
            run(&SetGloss { metallic: 1.0, ..SetGloss::default() }, Mesh::clone(&all), home).expect("runs");
        assert_eq!(both.glosses.len(), 2);
        assert_eq!([0, 9].map(|i| both.gloss(i).map(|gloss| gloss.metallic)), [Some(1.0), Some(0.0)]);
        let again = run(&SetGloss::default(), Mesh::clone(&both), None).expect("runs");
        assert_eq!(*again, *run(&SetGloss::default(), corner(), None).expect("runs"));
        for none in
            [SetGloss { specular: 0.0, ..SetGloss::default() }, SetGloss { ior: 1.0, ..SetGloss::default() }]
        {
            assert_eq!(*run(&none, corner(), None).expect("runs"), corner());
            assert_eq!(glossy(&run(&none, Mesh::clone(&all), home).expect("runs")), [8, 9]);
        }
    }
}
