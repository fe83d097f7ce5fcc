//! First arrangement of a scene: the place and the size of the object, and the camera that sees it.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::types::{Object, Rig, Splats};

use super::camera::{Subject, Viewpoint, best_view};
use super::grid::Grid;
use super::surface::{Surface, Wish, surfaces};
use crate::geometry::level::LevelEstimate;
use crate::geometry::support::median;

/// Minimum confidence at which an estimated scale is used for the size of the object.
const KNOWN: f64 = 0.5;
/// Range of heights above the floor at which objects are placed, in metres, if the scale is known.
const HEIGHTS: [f64; 2] = [-0.1, 1.15];
/// Minimum radius of a level surface on which the object is placed if the scene has no floor, as a share of the
/// radius of the scene.
const SMALL: f64 = 0.1;
/// Distance from the middle of the scene to the inserted object, as a share of the radius of the scene. It is used
/// if the scene is a captured object without ground.
const ASIDE: f64 = 0.35;
/// Maximum radius of an object, as a share of the distance from its place to the edge of the surface.
const ROOM: f64 = 0.7;

/// Bounding box of an object in the frame of its file: y up, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extents {
    /// Smallest coordinates.
    pub low: DVec3,
    /// Largest coordinates.
    pub high: DVec3,
}

impl Extents {
    /// Bounding box of all corners of the triangles of an object. `None` if it has no triangles.
    pub fn of(object: &Object) -> Option<Self> {
        let points = object
            .primitives
            .iter()
            .flat_map(|part| part.triangles.iter().flatten().map(|&v| part.positions[v as usize]));
        let mut all = points.map(|p| DVec3::from(p.map(f64::from))).filter(|p| p.is_finite()).map(|p| (p, p));
        let first = all.next()?;
        let (low, high) = all.fold(first, |(low, high), (p, _)| (low.min(p), high.max(p)));
        Some(Self { low, high })
    }

    /// Width, height and depth, in metres.
    pub fn size(&self) -> DVec3 {
        self.high - self.low
    }

    /// Largest horizontal distance from the vertical axis through the middle of the object, in metres.
    pub fn reach(&self) -> f64 {
        0.5 * self.size().with_y(0.0).length()
    }
}

/// Placement of the object and the camera in an upright scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrangement {
    /// Surface that the object stands on. `None` if no level surface was found; the object then stands at the
    /// lowest point of the scene.
    pub surface: Option<Surface>,
    /// Point that the object stands on, in world units.
    pub place: DVec3,
    /// Scale of the object, where 1 is its true size.
    pub scale: f64,
    /// True if `scale` follows from the available space, and not from the size of the object.
    pub fitted: bool,
    /// The camera. `None` if no camera in free space sees the place.
    pub view: Option<Viewpoint>,
}

/// Finds a place for the object, and a camera that sees it. `metres_per_unit` is the length of a world unit in
/// metres, which converts the size of the object to world units.
pub fn arrange(
    splats: &Splats,
    stand: &LevelEstimate,
    object: &Extents,
    metres_per_unit: f64,
    cameras: Option<&Rig>,
    cx: &Context,
) -> Result<Arrangement, NodeError> {
    let grid = Grid::new(splats, stand);
    cx.check()?;
    let up = DVec3::from_array(stand.up);
    let known = stand.scale.metres_per_unit.is_some() && stand.scale.confidence >= KNOWN;
    let tall = stand.ceiling.map_or(0.6 * stand.radius, |ceiling| ceiling - stand.floor);
    let reach = (object.reach() / metres_per_unit).max(1e-9);
    // If the scale is not known, the object's own size is clamped to a range that looks right in the scene.
    let enough =
        if known { reach / ROOM } else { (reach / ROOM).clamp(0.008 * stand.radius, 0.08 * stand.radius) };
    let heights =
        if known { HEIGHTS.map(|h| h / metres_per_unit) } else { [-0.05 * stand.radius, 0.45 * tall] };
    let centre = DVec3::from_array(stand.centre);
    let near = match cameras {
        // In front of the cameras, where the capture is good.
        Some(rig) if !rig.cameras.is_empty() => {
            let n = rig.cameras.len() as f64;
            let eyes = rig.cameras.iter().fold(DVec3::ZERO, |sum, camera| sum + camera.eye()) / n;
            (eyes + (centre - eyes) * 0.5, 0.35 * stand.radius)
        }
        _ => (centre, 0.35 * stand.radius),
    };
    let wish = Wish { heights, enough: enough.max(2.0 * grid.cell), near };
    let found = surfaces(&grid, stand.floor, &wish);
    cx.check()?;
    let size = object.size();
    // If there is no reliable floor, a level surface counts only if it is large.
    let worth = |surface: &&Surface| stand.floor_confidence >= 0.3 || surface.radius > SMALL * stand.radius;
    let surface = found.first().filter(worth).map(|surface| settled(splats, &grid, surface, stand.floor));
    // Next to a captured object without ground, level with its lowest point.
    let alone = || {
        let lowest = lowest(splats, stand, up);
        centre + grid.axes.x_axis * (ASIDE * stand.radius) + up * (lowest - centre.dot(up))
    };
    let place = surface.map_or_else(alone, |surface| surface.place);
    let (room, clearance) =
        surface.map_or((0.2 * stand.radius, f64::INFINITY), |s| (ROOM * s.radius, 0.9 * s.clearance));
    let largest = (room / reach).min(clearance / (size.y / metres_per_unit)).max(1e-9);
    // Its own size if that fits; otherwise a size that looks right there.
    let wanted = ROOM * wish.enough / reach;
    let fits = largest >= 1.0 && (known || (0.99..1.01).contains(&wanted));
    let scale = if fits { 1.0 } else { rounded(largest.min(wanted)) };
    let height = size.y / metres_per_unit * scale;
    let extent = (1.1 * size.max_element() / metres_per_unit * scale).max(2.0 * grid.cell);
    let hint: Vec<DVec3> =
        cameras.map(|rig| rig.cameras.iter().map(|c| c.eye()).collect()).unwrap_or_default();
    let subject = Subject { place, height, extent };
    let view = best_view(splats, &grid, &subject, &hint, cx)?;
    Ok(Arrangement { surface, place, scale, fitted: !fits, view })
}

/// Height along `up` below which a thousandth of the splats of a scene lie: the lowest point without outliers.
fn lowest(splats: &Splats, stand: &LevelEstimate, up: DVec3) -> f64 {
    let centre = DVec3::from_array(stand.centre);
    let inside = |i: &usize| splats.opacities[*i] > 0.3 && (splats.mean(*i) - centre).length() < stand.radius;
    let mut heights: Vec<f64> = (0..splats.len()).filter(inside).map(|i| splats.mean(i).dot(up)).collect();
    heights.sort_by(f64::total_cmp);
    heights.get(heights.len() / 1000).copied().unwrap_or(stand.floor)
}

/// Moves a surface to the median height of the splats around its place. This height is more accurate than the
/// height of the grid cells.
fn settled(splats: &Splats, grid: &Grid, surface: &Surface, floor: f64) -> Surface {
    let up = grid.axes.z_axis;
    let reach = (0.5 * surface.radius).max(1.5 * grid.cell);
    let near = |i: &usize| {
        let v = splats.mean(*i) - surface.place;
        let rise = v.dot(up);
        splats.opacities[*i] > 0.3 && rise.abs() < 1.5 * grid.cell && (v - up * rise).length() < reach
    };
    let heights: Vec<f64> = (0..splats.len()).filter(near).map(|i| splats.mean(i).dot(up)).collect();
    let Some(height) = median(heights) else { return *surface };
    let place = surface.place + up * (height - surface.place.dot(up));
    Surface { place, height: height - floor, ..*surface }
}

/// Rounds down to two significant digits.
fn rounded(value: f64) -> f64 {
    let mut unit = 1e-9;
    while unit * 100.0 <= value {
        unit *= 10.0;
    }
    (value / unit).floor() * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::level;
    use crate::look::of_mesh;
    use scene::types::Mesh;

    /// Adds a level square to a mesh, centred at a point. `half` is half the length of a side.
    fn square(mesh: &mut Mesh, [x, y, z]: [f32; 3], half: f32) {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0_f32]]
                .map(|[u, v]| [x + u * half, y + v * half, z]),
        );
        mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|v| v + first)));
    }

    /// An object is placed on the ground and not under a roof, even if the roof is in the middle of the scene. This
    /// test fails if `COVERED` is 0.
    #[test]
    fn an_object_stands_under_the_open_sky() {
        let mut mesh = Mesh::default();
        square(&mut mesh, [0.0; 3], 3.0);
        square(&mut mesh, [0.1, -0.1, 1.5], 0.8);
        let splats = of_mesh(&mesh);
        let stand = level::upright(&splats, DVec3::Z, None).expect("a scene");
        let object = Extents { low: DVec3::new(-0.1, 0.0, -0.1), high: DVec3::new(0.1, 0.2, 0.1) };
        let cx = Context::detached(
            engine::Scene { up: engine::Up::PlusZ, metres_per_unit: 1.0, seed: 1, exhaustive: false },
            "",
        );
        let found = arrange(&splats, &stand, &object, 1.0, None, &cx).unwrap_or_else(|e| panic!("{e}"));
        let aside = (found.place.x - 0.1).abs().max((found.place.y + 0.1).abs());
        assert!(found.place.z.abs() < 0.05 && aside > 0.8 && aside < 2.5, "{found:?}");
    }

    #[test]
    fn numbers_are_rounded_to_two_digits() {
        for (value, expected) in [(0.123, 0.12), (1.0, 1.0), (99.9, 99.0), (1234.0, 1200.0)] {
            assert!((rounded(value) / expected - 1.0).abs() < 1e-9, "{value}");
        }
    }
}
