//! Reference in float64 for the ground under an object. Every triangle is tested against every vertical line, and
//! the plane with the most points is found by trying many more planes than the node does.

use glam::{DMat3, DVec3};
use scene::types::{Cell, Mesh, Placed, Report};

/// Number of vertical lines along each side of the region under the foot.
const GRID: u32 = 24;
/// Maximum distance between a plane and a point that belongs to it, in metres.
const NEAR: f64 = 0.02;

/// Values from the node's report: the distance by which the object was moved, then the normal of the ground.
pub fn reported(report: &Report) -> Vec<f64> {
    let number = |cell: &Cell| if let Cell::Number(n) = cell { *n } else { f64::NAN };
    let row: Vec<f64> = report.tables[0].rows[0].iter().map(number).collect();
    vec![row[0], row[2], row[3], row[4]]
}

/// Reference values for [`reported`], for an object that is at most `reach` above or below the ground. The world is
/// in metres with z up.
pub fn found(mesh: &Mesh, placed: &Placed, reach: f64) -> Vec<f64> {
    let corners: Vec<DVec3> = placed
        .object
        .primitives
        .iter()
        .flat_map(|p| p.triangles.iter().flatten().map(|i| p.positions[*i as usize].map(f64::from)))
        .map(|p| placed.world_from_object.transform_point3(DVec3::from(p)))
        .collect();
    let bounds = |points: &[DVec3]| {
        let fold = |f: fn(DVec3, DVec3) -> DVec3| points.iter().copied().reduce(f).unwrap();
        (fold(DVec3::min), fold(DVec3::max))
    };
    let (low, high) = bounds(&corners);
    // The foot is the lowest fiftieth of the height; the region is half as large again around it.
    let foot: Vec<DVec3> =
        corners.iter().copied().filter(|p| p.z <= low.z + 0.02 * (high.z - low.z)).collect();
    let (a, b) = bounds(&foot);
    let (middle, half) = ((a + b) * 0.5, ((b - a) * 0.75).max((high - low) * 0.125));
    let triangles: Vec<[DVec3; 3]> = mesh.triangles.iter().map(|t| t.map(|i| mesh.position(i))).collect();
    let mut points = Vec::new();
    for k in 0..GRID * GRID {
        let place = [k % GRID, k / GRID].map(|i| f64::from(2 * i + 1) / f64::from(GRID) - 1.0);
        let (x, y) = (place[0] * half.x, place[1] * half.y);
        for [a, b, c] in &triangles {
            let normal = (*b - *a).cross(*c - *a);
            // Ground faces up, no steeper than 45 degrees.
            if normal.normalize_or_zero().z < 0.7 {
                continue;
            }
            let from = DVec3::new(middle.x + x, middle.y + y, 0.0);
            let side = |p: DVec3, q: DVec3| (q - p).truncate().perp_dot((from - p).truncate());
            let height = (a.dot(normal) - from.dot(normal)) / normal.z - low.z;
            let inside = [side(*a, *b), side(*b, *c), side(*c, *a)].into_iter().all(|s| s >= 0.0);
            if inside && height.abs() <= reach {
                points.push(DVec3::new(x, y, height));
            }
        }
    }
    let best = densest(&points);
    let of_plane: Vec<DVec3> = points.into_iter().filter(|p| over(best, *p).abs() <= NEAR).collect();
    let slope = least_squares(&of_plane);
    let mut heights: Vec<f64> =
        of_plane.iter().map(|p| over(DVec3::new(0.0, slope.x, slope.y), *p)).collect();
    heights.sort_by(f64::total_cmp);
    let normal = DVec3::new(-slope.x, -slope.y, 1.0).normalize();
    vec![heights[heights.len() / 2], normal.x, normal.y, normal.z]
}

/// Height of a point above a plane. The plane is given by its height at the origin and its slopes along x and y.
fn over(plane: DVec3, p: DVec3) -> f64 {
    p.z - plane.x - plane.y * p.x - plane.z * p.y
}

/// The plane with the most points. Candidates are the horizontal planes through each point, and the planes through
/// any three points of a subset, which contains every 23rd point.
fn densest(points: &[DVec3]) -> DVec3 {
    let some: Vec<DVec3> = points.iter().copied().step_by(23).collect();
    let mut planes: Vec<DVec3> = points.iter().map(|p| DVec3::new(p.z, 0.0, 0.0)).collect();
    for (i, a) in some.iter().enumerate() {
        for (j, b) in some.iter().enumerate().skip(i + 1) {
            for c in &some[j + 1..] {
                let normal = (*b - *a).cross(*c - *a).normalize_or_zero();
                if normal.z.abs() >= 0.7 {
                    let rise = normal.truncate() / -normal.z;
                    planes.push(DVec3::new(a.z - rise.dot(a.truncate()), rise.x, rise.y));
                }
            }
        }
    }
    let held = |plane: &DVec3| points.iter().filter(|p| over(*plane, **p).abs() <= NEAR).count();
    let nearer = |a: &DVec3, b: &DVec3| b.x.abs().total_cmp(&a.x.abs());
    planes.into_iter().max_by(|a, b| held(a).cmp(&held(b)).then_with(|| nearer(a, b))).unwrap()
}

/// Fits a plane to points by least squares of the vertical distances, and returns it in the form that [`over`]
/// reads.
fn least_squares(points: &[DVec3]) -> DVec3 {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let (mut moments, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for p in points {
        let row = (*p - mean).with_z(1.0);
        moments += DMat3::from_cols(row * row.x, row * row.y, row);
        right += row * (p.z - mean.z);
    }
    moments.inverse() * right
}
