//! Selects the cubes that contain a surface or are near one. At least two views must see points in or near a cube.

use engine::{Context, NodeError};
use glam::Vec3;

use super::depth_view::{DepthView, EDGE};
use super::levels::{Cube, Levels, SIDE};

/// Minimum number of views that must see a surface in or near a cube.
const VIEWS: usize = 2;

/// Minimum confidence, from 0 to 255, of a pixel whose point adds cubes.
const TRUST: u8 = 16;

/// Maximum distance from a point to the cubes that are added for it, in cells.
const AROUND: f32 = 1.5;

/// Adds to `found` the cube that contains a point, and the cubes near the point.
fn add(levels: &Levels, point: Vec3, found: &mut Vec<Cube>) {
    let Some(cube) = levels.cube_at(point) else { return };
    let cell = levels.cell_of(cube.level);
    let within = point / cell - Vec3::from(cube.at.map(|at| (at * SIDE) as f32));
    let near = within.to_array().map(|v| {
        let low = if v < AROUND { -1 } else { 0 };
        let high = if v > SIDE as f32 - AROUND { 1 } else { 0 };
        [low, high]
    });
    for z in near[2][0]..=near[2][1] {
        for y in near[1][0]..=near[1][1] {
            for x in near[0][0]..=near[0][1] {
                if [x, y, z] == [0; 3] {
                    if found.last() != Some(&cube) {
                        found.push(cube);
                    }
                    continue;
                }
                // The neighbour may be of another level.
                let offset = Vec3::new(x as f32, y as f32, z as f32) * (2.0 * AROUND * cell);
                found.extend(levels.cube_at(point + offset).filter(|other| *other != cube));
            }
        }
    }
}

/// Cubes that contain the points that a view sees, and cubes near these points.
fn of_view(view: &DepthView, levels: &Levels) -> Vec<Cube> {
    let mut found = Vec::new();
    for y in 0..view.height {
        for x in 0..view.width {
            let at = y * view.width + x;
            let Some(point) = view.point(x, y).filter(|_| view.marks[at][0] >= TRUST) else { continue };
            add(levels, view.eye + point, &mut found);
            // Far from the camera and at grazing angles, adjacent pixels show points farther apart than cubes.
            for (other, inside) in [((x + 1, y), x + 1 < view.width), ((x, y + 1), y + 1 < view.height)] {
                let Some(next) = Some(other).filter(|_| inside).and_then(|(x, y)| view.point(x, y)) else {
                    continue;
                };
                let (a, b) = (view.inverse[at], view.inverse[other.1 * view.width + other.0]);
                let Some(cube) =
                    levels.cube_at(view.eye + point).filter(|_| (a - b).abs() <= EDGE * a.max(b))
                else {
                    continue;
                };
                let steps = (next - point).length() / (levels.cell_of(cube.level) * 0.5 * SIDE as f32);
                for step in 1..=(steps.min(64.0) as usize) {
                    add(
                        levels,
                        view.eye + point + (next - point) * (step as f32 / (steps + 1.0)),
                        &mut found,
                    );
                }
            }
        }
        if y % 16 == 15 {
            found.sort_unstable();
            found.dedup();
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// Cubes in or near which at least two views see points, in ascending order. If there are more than `most`, only
/// the cubes nearest to the foci are returned, and the second value is true.
pub fn wanted(
    views: &[DepthView],
    levels: &Levels,
    most: usize,
    cx: &Context,
) -> Result<(Vec<Cube>, bool), NodeError> {
    let by_view = cx.for_each_tile(views.len(), |i| of_view(&views[i], levels))?;
    let mut all = by_view.concat();
    drop(by_view);
    all.sort_unstable();
    let mut cubes: Vec<Cube> =
        all.chunk_by(|a, b| a == b).filter(|same| same.len() >= VIEWS).map(|same| same[0]).collect();
    let too_many = cubes.len() > most;
    if too_many {
        let mut by_distance: Vec<(f32, Cube)> =
            cubes.iter().map(|cube| (levels.distance_to(*cube), *cube)).collect();
        by_distance.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        cubes = by_distance[..most].iter().map(|(_, cube)| *cube).collect();
        cubes.sort_unstable();
    }
    Ok((cubes, too_many))
}
