//! `plane`: a level rectangle as ground for objects.

use std::sync::Arc;

use engine::{Context, ContextField, Kind, NodeError, Notes};
use glam::DVec3;
use render::splat::{Settings, render};
use scene::math::color::linear_from_srgb;
use scene::math::equirect;
use scene::types::{Camera, Mesh, Pose, SplatEncoding, Splats};

engine::params! {
    /// Makes a rectangle at a pose: a quick replacement for the mesh of a place, for objects on level ground.
    ///
    /// The rectangle lies in the ground plane of the pose and rotates with it. If `splats` is wired, the vertices
    /// have the colours of the splats within `thickness_metres` of the rectangle, seen from straight above.
    /// Vertices without such splats have the median of these colours. The rest of the scene receives no shadows,
    /// hides no objects and reflects no light: use `extract-mesh` for a mesh of the whole scene.
    pub struct Plane {
        /// Length of the side along the right axis of the pose.
        width_metres: f64 = 6.0, range(1e-3, 1e5), unit("m"), other("2.0");
        /// Length of the side along the forward axis of the pose.
        depth_metres: f64 = 6.0, range(1e-3, 1e5), unit("m"), other("3.0");
        /// Side of the squares that the rectangle consists of. Each corner of a square has a colour.
        square_metres: f64 = 0.1, range(1e-3, 1e5), unit("m"), other("0.5");
        /// Maximum distance above or below the rectangle at which splats contribute to its colours.
        thickness_metres: f64 = 0.15, range(1e-4, 100.0), unit("m"), other("0.01");
    }
}
engine::inputs! {
    /// Inputs of [`Plane`].
    pub struct In {
        /// Position of the middle of the rectangle, and its rotation.
        at: Arc<Pose>,
        /// The scene from which the rectangle takes its colours. Without it, the rectangle has no colours.
        splats: Option<Arc<Splats>>,
    }
}
engine::outputs! {
    /// Outputs of [`Plane`].
    pub struct Out {
        /// The rectangle; its front side faces up.
        mesh: Arc<Mesh>,
    }
}

/// Maximum number of squares per side.
const MOST: f64 = 1024.0;

impl Kind for Plane {
    const NAME: &'static str = "plane";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(params: &Self) -> Result<(), NodeError> {
        let side = params.width_metres.max(params.depth_metres);
        if side / params.square_metres > MOST {
            let least = side / MOST;
            return Err(NodeError::new(format!("the plane would have more than {MOST} squares per side"))
                .at("square_metres")
                .hint(format!("`square_metres` must be at least {least:.4}")));
        }
        Ok(())
    }

    fn run(params: &Self, In { at, splats }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(params)?;
        let mut notes = Notes::none();
        let metre = 1.0 / cx.metres_per_unit();
        let turned = |axis: DVec3| at.world_from_local.transform_vector3(axis).normalize_or_zero();
        let [right, forward, up] = equirect::axes(cx.up()).map(turned);
        let middle = at.translation();
        let straight = right.cross(forward).dot(up);
        if !middle.is_finite() || straight.is_nan() || straight <= 0.5 {
            return Err(NodeError::new("the pose is not finite, mirrors the plane or flattens it").at("at"));
        }
        let sides = [params.width_metres, params.depth_metres];
        let squares = sides.map(|side| ((side / params.square_metres).ceil() as u32).max(1));
        let along =
            |i: u32, axis: usize| (f64::from(i) / f64::from(squares[axis]) - 0.5) * sides[axis] * metre;
        let mut mesh = Mesh::default();
        let mut places = Vec::new();
        for y in 0..=squares[1] {
            for x in 0..=squares[0] {
                places.push(middle + right * along(x, 0) + forward * along(y, 1));
            }
        }
        for place in &places {
            let high = place.as_vec3();
            mesh.positions.push(high.to_array());
            mesh.positions_low.push((*place - high.as_dvec3()).as_vec3().to_array());
        }
        if mesh.positions_low.iter().flatten().all(|low| *low == 0.0) {
            mesh.positions_low.clear();
        }
        let columns = squares[0] + 1;
        for y in 0..squares[1] {
            for x in 0..squares[0] {
                let first = y * columns + x;
                mesh.triangles.push([first, first + 1, first + columns + 1]);
                mesh.triangles.push([first, first + columns + 1, first + columns]);
            }
        }
        if let Some(splats) = splats {
            let thickness = params.thickness_metres * metre;
            mesh.colours = colours(
                &splats,
                [right, forward, up],
                (sides.map(|side| side * metre), squares),
                middle,
                thickness,
                cx,
            )?;
            if mesh.colours.is_empty() {
                let text = format!(
                    "no splat lies within {} m of the plane, so the plane has no colours",
                    params.thickness_metres
                );
                notes.warning("plane-without-colours", text);
            }
        }
        Ok((Out { mesh: Arc::new(mesh) }, notes))
    }
}

/// Colours of the corners of the squares, row by row, seen from straight above. Empty if no splat lies near the
/// plane.
fn colours(
    splats: &Splats,
    [right, forward, up]: [DVec3; 3],
    (sides, squares): ([f64; 2], [u32; 2]),
    middle: DVec3,
    thickness: f64,
    cx: &Context,
) -> Result<Vec<[f32; 3]>, NodeError> {
    let corners = squares.map(|count| count + 1);
    // High enough that the outermost rays are nearly straight down.
    let height = 4.0 * sides[0].max(sides[1]);
    let camera = Camera {
        // One pixel per corner.
        fx: height * f64::from(squares[0]) / sides[0],
        fy: height * f64::from(squares[1]) / sides[1],
        ..Camera::centred("above", corners, 1.0, [right, -forward, -up], middle + up * height)
    };
    let near = (height - thickness).max(1e-12);
    let settings = Settings { sh_degree: 0, compensate: splats.antialiased, near, ..Settings::default() };
    let seen = render(splats, &camera, None, &settings, cx)?;
    let linear = |c: f32| if splats.encoding == SplatEncoding::Linear { c } else { linear_from_srgb(c) };
    let colour = |i: usize| {
        let [r, g, b, alpha]: [f32; 4] = std::array::from_fn(|c| seen.rgba[4 * i + c]);
        let near = f64::from(seen.depth[i]) < height + thickness;
        (alpha > 0.5 && near).then(|| [r, g, b].map(|c| linear((c / alpha).clamp(0.0, 1.0))))
    };
    // The first row of the picture is the last of the corners.
    let [columns, rows] = corners.map(|count| count as usize);
    let place = |i: usize| (rows - 1 - i / columns) * columns + i % columns;
    let found: Vec<Option<[f32; 3]>> = (0..columns * rows).map(|i| colour(place(i))).collect();
    let median = |c: usize| {
        let mut all: Vec<f32> = found.iter().flatten().map(|colour| colour[c]).collect();
        all.sort_unstable_by(f32::total_cmp);
        all.get(all.len() / 2).copied()
    };
    let [Some(r), Some(g), Some(b)] = [0, 1, 2].map(median) else { return Ok(Vec::new()) };
    Ok(found.into_iter().map(|colour| colour.unwrap_or([r, g, b])).collect())
}

#[cfg(test)]
mod tests {
    use glam::DMat4;

    use super::*;
    use testing::context;

    fn plane(params: &Plane, pose: DMat4, splats: Option<Arc<Splats>>) -> Arc<Mesh> {
        let at = Arc::new(Pose { world_from_local: pose });
        Plane::run(params, In { at, splats }, &context()).expect("runs").0.mesh
    }

    // This test fails if the order of the corners or the sign of `forward` is changed.
    #[test]
    fn it_lies_level_and_faces_up() {
        let params = Plane { width_metres: 2.0, depth_metres: 1.0, square_metres: 0.3, ..Plane::default() };
        let mesh = plane(&params, DMat4::from_translation(DVec3::new(5.0, 1.0, 0.5)), None);
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (8 * 5, 2 * 7 * 4));
        assert!(mesh.colours.is_empty());
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| mesh.position(i));
            let normal = (b - a).cross(c - a);
            assert!(normal.z > 0.0 && normal.truncate().length() < 1e-9);
        }
        let sum: DVec3 = (0..40).map(|i| mesh.position(i)).sum();
        assert!((sum / 40.0 - DVec3::new(5.0, 1.0, 0.5)).length() < 1e-6);
        let turned = glam::DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let across = plane(&params, DMat4::from_quat(turned), None);
        let reach = |axis: usize| across.positions.iter().map(|p| p[axis]).fold(0.0, f32::max);
        assert!((reach(0) - 0.5).abs() < 1e-6 && (reach(1) - 1.0).abs() < 1e-6);
    }

    /// Red ground to the left and green ground to the right, with a blue board a metre above both.
    fn ground() -> Splats {
        let mut splats = Splats::empty();
        let mut add = |mean: [f32; 3], dc: [f32; 3]| {
            splats.means.push(mean);
            splats.quats.push([1.0, 0.0, 0.0, 0.0]);
            splats.scales.push([0.08, 0.08, 0.002]);
            splats.opacities.push(0.95);
            splats.sh.push(dc);
        };
        for i in 0..1600 {
            let (x, y) = ((i % 40) as f32 * 0.05 - 0.975, (i / 40) as f32 * 0.05 - 0.975);
            add([x, y, 0.0], if x < 0.0 { [1.7, -1.7, -1.7] } else { [-1.7, 1.7, -1.7] });
            add([x, y, 1.0], [-1.7, -1.7, 1.7]);
        }
        splats
    }

    // This test fails if `near` has its default value, or if the rows are not reversed.
    #[test]
    fn its_colours_are_those_of_what_lies_in_it() {
        let params = Plane { width_metres: 3.0, depth_metres: 1.5, ..Plane::default() };
        let mesh = plane(&params, DMat4::from_translation(DVec3::Y * 0.2), Some(Arc::new(ground())));
        assert_eq!(mesh.colours.len(), mesh.positions.len());
        for (place, colour) in mesh.positions.iter().zip(&mesh.colours) {
            assert!(colour[2] < 0.1, "{place:?} {colour:?}");
            if place[0].abs() > 0.15 && place[0].abs() < 0.85 && place[1] < 0.85 {
                assert!((colour[0] > colour[1]) == (place[0] < 0.0), "{place:?} {colour:?}");
            }
        }
        let far = DMat4::from_translation(DVec3::Z * 0.5);
        assert!(plane(&params, far, Some(Arc::new(ground()))).colours.is_empty());
    }

    #[test]
    fn too_many_squares_are_an_error() {
        let params = Plane { square_metres: 0.001, ..Plane::default() };
        assert!(Plane::check(&params).is_err());
    }
}
