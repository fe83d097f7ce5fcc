//! `extract-mesh`: the surface of a scene, from its splats.

mod report;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, Sizes};
use glam::{DVec3, Vec3};
use render::fusion::cubes::wanted;
use render::fusion::field::{self, Field};
use render::fusion::levels::{Cube, Levels};
use render::fusion::places::{Ground, Places};
use render::fusion::surface::Surface;
use render::fusion::{depth_view, pieces, simplify, tint};
use render::splat::{Blocks, Settings};
use scene::math::equirect;
use scene::types::{Mesh, Pose, Report, Rig, Splats};

engine::params! {
    /// Makes a mesh of a scene from its splats. Objects stand on the mesh, cast shadows on it, and are hidden by
    /// it.
    ///
    /// The splats are rendered from many places in empty space. The search for these places starts at `around` and
    /// `cameras`, and adds places that earlier views show to be empty; further views show the surroundings of
    /// `around` from above. The depths of all views (`RayMedian` of `splat-render`) are fused into distances to the
    /// surface, in cells that are fine near `around` and coarser farther away. The mesh has holes where no view
    /// sees the scene, and it ends at `reach_metres`, so it contains neither sky nor backdrop. Its colours are the
    /// colours of the splats without the part that depends on the direction.
    pub struct ExtractMesh {
        /// Side of the finest cells, which are used within `radius_metres` of `around`. Farther away, the size
        /// doubles in steps.
        voxel_metres: f64 = 0.015, range(1e-4, 10.0), unit("m"), other("0.2"),
            knob(Resolution, "0.04", "0.02", "0.015", "0.01");
        /// Distance from `around` up to which the finest cells are used.
        radius_metres: f64 = 1.5, range(0.01, 1000.0), unit("m"), other("0.4");
        /// Maximum distance of the mesh from `around`, or from the cameras if `around` is not wired.
        reach_metres: f64 = 12.0, range(0.1, 10000.0), unit("m"), other("1.0");
        /// Maximum number of places from which the splats are rendered, including `around` and the cameras.
        places: u32 = 28, range(1, 1000), other("3"), knob(Samples, "8", "14", "28", "56");
        /// Side of each of the six cube faces that are rendered at a place.
        size_px: u32 = 192, range(16, 2048), unit("px"), other("40"), knob(Resolution, "96", "128", "192", "320");
        /// Maximum root-mean-square error from merging triangles. In a room, a value of 0.05 removes 30 of 31
        /// triangles, and moves the surfaces by less than their noise.
        error_cells: f64 = 0.05, range(0.0, 10.0), unit("cells"), other("0.0");
        /// Minimum area of a separate piece of the mesh, given as the side of a square of the same area. Smaller
        /// pieces are removed.
        least_piece_metres: f64 = 0.15, range(0.0, 100.0), unit("m"), other("5.0");
    }
}

engine::inputs! {
    /// Inputs of [`ExtractMesh`].
    pub struct In {
        /// The scene.
        splats: Arc<Splats>,
        /// Cameras in empty space, such as the cameras of the capture or the cameras of the pictures to render.
        cameras: Option<Arc<Rig>>,
        /// Position where an object will stand.
        around: Option<Arc<Pose>>,
    }
}

engine::outputs! {
    /// Outputs of [`ExtractMesh`].
    pub struct Out {
        /// The mesh.
        mesh: Arc<Mesh>,
        /// The mesh with the confidence of each vertex as a grey colour: 0 if fewer than two views see the vertex,
        /// otherwise `1 / (1 + (d / c)^2)`, where `d` is the standard deviation of the positions of the surface in
        /// the views and `c` is half the side of a cell.
        confidence: Arc<Mesh>,
        /// Counts from the extraction, and measures of the agreement between the mesh and the splats.
        report: Arc<Report>,
    }
}

/// Height above the position of the object, in metres, of the point at which the search for viewpoints in empty
/// space starts.
const EYE_METRES: f64 = 0.45;
/// Near plane of the views that are fused, in metres. A larger value would cut away the ground below a place, which
/// would then count as empty space.
const NEAR_METRES: f64 = 0.2;
/// Depth at which a surface seen in a view has half the weight of a very near surface, in metres.
const HALF_METRES: f64 = 2.0;
/// Maximum length of an edge of the mesh, in cells.
const LONGEST_CELLS: f64 = 16.0;
/// Maximum number of cubes of cells that are fused.
const MOST_CUBES: usize = 1 << 16;

impl Kind for ExtractMesh {
    const NAME: &'static str = "extract-mesh";
    const VERSION: u32 = 5;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let pixels = u64::from(params.size_px) * u64::from(params.size_px);
        let views = u64::from(params.places) * 6 + 16;
        let drawn = render::splat::most_bytes(
            inputs.splats.len() as u64,
            (params.size_px.into(), params.size_px.into()),
        );
        let field = MOST_CUBES as u64 * field::BLOCK_BYTES;
        Cost { bytes: views * depth_view::DepthView::bytes(pixels) + drawn.max(field) }
    }

    fn work(params: &Self, sizes: &Sizes) -> f64 {
        let pixels = f64::from(params.size_px) * f64::from(params.size_px);
        f64::from(params.places) * (sizes.of("splats") * 0.3 + 10.0 * pixels)
    }

    fn run(
        params: &Self,
        In { splats, cameras, around }: In,
        cx: &Context,
    ) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let metre = 1.0 / cx.metres_per_unit();
        let axes = equirect::axes(cx.up());
        let eyes: Vec<DVec3> =
            cameras.iter().flat_map(|rig| rig.cameras.iter().map(|camera| camera.eye())).collect();
        let at = around.as_deref().map(Pose::translation);
        let Some(origin) = at.or(eyes.first().copied()) else {
            return Err(NodeError::new(
                "the search for empty space has no starting point: neither `around` nor `cameras` is wired",
            )
            .at("around")
            .hint("wire the pose of an object to `around`, or cameras in empty space to `cameras`"));
        };
        let local = |point: DVec3| (point - origin).as_vec3();
        let above = at.map(|foot| local(foot + axes[2] * (EYE_METRES * metre)));
        let seeds: Vec<Vec3> = above.into_iter().chain(eyes.iter().map(|eye| local(*eye))).collect();

        let near = NEAR_METRES * metre;
        let settings = Settings { sh_degree: 0, compensate: splats.antialiased, near, ..Settings::default() };
        let blocks = Blocks::of(&splats, cx)?;
        let ground = Ground {
            splats: &splats,
            blocks: &blocks,
            settings: &settings,
            origin,
            axes,
            metre,
            size_px: params.size_px,
        };
        let focus = at.map(local);
        let progress = |done: f32| cx.progress(0.5 * done);
        let mut places = Places::grown(&ground, &seeds, focus, params.places as usize, &progress, cx)?;

        if places.blocked > 0 {
            let text = format!(
                "places inside a surface were left out (count: {}); check that `around` is above the ground and \
                 that the cameras are in empty space",
                places.blocked
            );
            notes.warning("place-blocked", text);
        }
        let [cell, radius, reach] = [params.voxel_metres, params.radius_metres, params.reach_metres]
            .map(|metres| (metres * metre) as f32);
        let levels = match focus {
            Some(focus) => Levels::new(cell, vec![focus], radius, reach),
            None => Levels::new(2.0 * cell, places.eyes[..places.given].to_vec(), 2.0 * radius, reach),
        };
        let (cubes, too_many) = wanted(&places.views, &levels, MOST_CUBES, cx)?;
        if too_many {
            report_cut(&cubes, &levels, metre, &mut notes);
        }
        cx.progress(0.55);
        let field = Field::fused(&cubes, &places.views, &levels, (HALF_METRES * metre) as f32, cx)?;
        cx.progress(0.75);
        let mut surface = Surface::of(&field, cx)?;
        let held = field.blocks.len();
        drop(field);
        let raw = surface.triangles.len();
        let side = params.least_piece_metres * metre;
        let pieces = pieces::without_small(&mut surface, &|level| {
            side.max(4.0 * f64::from(levels.cell_of(level)))
                * side.max(4.0 * f64::from(levels.cell_of(level)))
        });
        let seen = tint::seen(&surface, &places.views, &levels, cx)?;
        let view_count = places.views.len();
        places.views = Vec::new();
        cx.progress(0.85);
        let bounds = |level: u8| {
            let cell = f64::from(levels.cell_of(level));
            (params.error_cells * cell, LONGEST_CELLS * cell)
        };
        let (surface, seen) = simplify::simplified(surface, seen, &bounds, cx)?;
        if surface.triangles.is_empty() {
            notes.degraded("empty", "the mesh is empty: the views show no surface");
        }

        let mesh = mesh_of(&surface, &seen, origin, cell);
        let confidences = seen.iter().zip(&surface.levels).map(|(seen, level)| {
            let ratio = 2.0 * seen.deviation / levels.cell_of(*level);
            let confidence = if seen.views < 2 { 0.0 } else { 1.0 / (1.0 + ratio * ratio) };
            [confidence; 3]
        });
        let confidence = Mesh { colours: confidences.collect(), ..mesh.clone() };
        cx.count("mesh_views", view_count as u64);
        cx.count("mesh_cubes", held as u64);
        cx.count("mesh_triangles", mesh.triangles.len() as u64);
        let mut tables = vec![report::counts(&[
            ("places", places.eyes.len()),
            ("places taken from `around` and `cameras`", places.given),
            ("candidate places too close to a surface", places.failed),
            ("views of `around` from above", places.steep),
            ("cubes of cells that were fused", held),
            ("triangles before simplification", raw),
            ("triangles", mesh.triangles.len()),
            ("vertices", mesh.positions.len()),
            ("pieces", pieces.kept),
            ("pieces removed", pieces.dropped),
        ])];
        tables.extend(focus.map(|focus| report::ground(&surface, &seen, focus, axes, metre)));
        if let Some(rig) = &cameras {
            let scene = (&*splats, &blocks, &settings);
            tables.push(report::views(scene, (&surface, origin), rig, (&levels, metre), cx)?);
        }
        let report = Report { title: "Mesh from splats".to_owned(), tables };
        let (mesh, confidence) = (Arc::new(mesh), Arc::new(confidence));
        Ok((Out { mesh, confidence, report: Arc::new(report) }, notes))
    }
}

/// The mesh of a surface in world units. `origin` is the origin of its points, and `cell` the size of a cell.
fn mesh_of(surface: &Surface, seen: &[tint::Seen], origin: DVec3, cell: f32) -> Mesh {
    let far = surface.points.iter().map(|p| p.abs().max_element()).fold(0.0, f32::max);
    let whole = |point: &Vec3| origin + point.as_dvec3();
    let high = |point: &Vec3| whole(point).as_vec3();
    // True if rounding to f32 would move a point by a hundredth of a cell or more.
    let coarse =
        (origin.abs().max_element() + f64::from(far)) * f64::from(f32::EPSILON) > 0.01 * f64::from(cell);
    let low = |point: &Vec3| (whole(point) - high(point).as_dvec3()).as_vec3().to_array();
    Mesh {
        positions: surface.points.iter().map(|point| high(point).to_array()).collect(),
        positions_low: if coarse { surface.points.iter().map(low).collect() } else { Vec::new() },
        colours: seen.iter().map(|seen| seen.colour).collect(),
        triangles: surface.triangles.clone(),
        ..Mesh::default()
    }
}

/// Reports that the mesh ends where the number of cubes reaches its limit.
fn report_cut(cubes: &[Cube], levels: &Levels, metre: f64, notes: &mut Notes) {
    let farthest = cubes.iter().map(|cube| levels.distance_to(*cube)).fold(0.0, f32::max);
    let text = format!(
        "the mesh extends only {:.2} m from `around` or the cameras, because the number of cubes of cells is limited to {MOST_CUBES}; for a larger mesh, raise `voxel_metres`",
        f64::from(farthest) / metre
    );
    notes.degraded("mesh-cut", text);
}
