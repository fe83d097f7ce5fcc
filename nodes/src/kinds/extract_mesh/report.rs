//! The report of `extract-mesh`: counts, the ground around the focus, and the agreement between the mesh and the
//! splats in each camera.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use render::fusion::fit::fit;
use render::fusion::levels::Levels;
use render::fusion::surface::Surface;
use render::fusion::tint::Seen;
use render::geometry::bvh::Bvh;
use render::geometry::support::GroundPlane;
use render::splat::{Blocks, Settings};
use scene::types::{Camera, Cell, Rig, Splats, Table};

/// Maximum number of cameras that are compared.
const CAMERAS: usize = 16;
/// Distance from the focus within which the ground is measured, in metres.
const GROUND_METRES: f64 = 0.5;
/// Maximum height above or below the focus at which the ground is measured, in metres.
const HEIGHT_METRES: f64 = 0.25;

fn count(name: &str, value: usize) -> Vec<Cell> {
    vec![Cell::Text(name.to_owned()), Cell::Count(value as u64)]
}

/// Table of counts by name.
pub(super) fn counts(rows: &[(&str, usize)]) -> Table {
    Table::new("counts", ["item", "count"], rows.iter().map(|(name, value)| count(name, *value)).collect())
}

/// Cell with a length in millimetres, converted from world units; a missing cell if `units` is `None`. `metre` is
/// the length of a metre in world units.
fn mm(units: Option<f64>, metre: f64) -> Cell {
    units.map_or(Cell::Missing, |units| Cell::Number(units / metre * 1000.0))
}

/// Table with the height, slope and roughness of the surface around a focus, the number of views that see it, and
/// the deviation between them.
pub(super) fn ground(surface: &Surface, seen: &[Seen], focus: Vec3, axes: [DVec3; 3], metre: f64) -> Table {
    let (radius, height) = ((GROUND_METRES * metre) as f32, (HEIGHT_METRES * metre) as f32);
    let [right, forward, up] = axes.map(|axis| axis.as_vec3());
    let mut points = Vec::new();
    let (mut views, mut deviations) = (Vec::new(), Vec::new());
    for (point, seen) in surface.points.iter().zip(seen) {
        let offset = *point - focus;
        let [x, y, z] = [right, forward, up].map(|axis| offset.dot(axis));
        if x * x + y * y < radius * radius && z.abs() < height {
            points.push([x, y, z].map(f64::from));
            views.push(f64::from(seen.views));
            deviations.push(f64::from(seen.deviation));
        }
    }
    let level = GroundPlane::of(&points);
    let median = |mut values: Vec<f64>| {
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let slope = level.map(|level| {
        let [x, y] = level.slope;
        (x * x + y * y).sqrt()
    });
    let rows = vec![vec![
        Cell::Count(points.len() as u64),
        mm(level.map(|level| level.height), metre),
        slope.map_or(Cell::Missing, Cell::Number),
        mm(level.map(|level| level.roughness), metre),
        median(views).map_or(Cell::Missing, Cell::Number),
        mm(median(deviations), metre),
    ]];
    let columns = [
        "vertices",
        "height above `around` (mm)",
        "slope (rise over run)",
        "roughness (mm)",
        "views per vertex, median",
        "deviation between views, median (mm)",
    ];
    Table::new("ground", columns, rows)
}

/// Table that compares the mesh with the splats in the view of each camera.
pub(super) fn views(
    scene: (&Splats, &Blocks, &Settings),
    (surface, origin): (&Surface, DVec3),
    rig: &Rig,
    (levels, metre): (&Levels, f64),
    cx: &Context,
) -> Result<Table, NodeError> {
    let (splats, blocks, settings) = scene;
    let corners: Vec<[Vec3; 3]> =
        surface.triangles.iter().map(|triangle| triangle.map(|i| surface.points[i as usize])).collect();
    let triangles = Bvh::build(&corners);
    drop(corners);
    let every = rig.cameras.len().div_ceil(CAMERAS).max(1);
    let within = |point: Vec3| levels.cube_at(point).is_some();
    let row = |camera: &Camera| {
        let fit = fit((splats, blocks), (&triangles, origin), camera, &within, settings, cx)?;
        let share = |share: f64| Cell::Number(share * 100.0);
        Ok(vec![
            Cell::Text(camera.name.clone()),
            mm(fit.median, metre),
            mm(fit.most, metre),
            share(fit.holes),
            share(fit.extra),
            share(fit.backs),
            fit.silhouettes[0].map_or(Cell::Missing, share),
            fit.silhouettes[1].map_or(Cell::Missing, share),
        ])
    };
    let rows = rig.cameras.iter().step_by(every).map(row).collect::<Result<Vec<_>, NodeError>>()?;
    let columns = [
        "view",
        "distance between mesh and splats, median (mm)",
        "distance between mesh and splats, 95th percentile (mm)",
        "pixels with splats but no mesh (%)",
        "pixels with mesh but no splats (%)",
        "pixels that show the back of the mesh (%)",
        "silhouette pixels of the splats with a silhouette of the mesh nearby (%)",
        "silhouette pixels of the mesh with a silhouette of the splats nearby (%)",
    ];
    Ok(Table::new("views", columns, rows))
}
