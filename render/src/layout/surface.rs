//! Level surfaces with free space above them.

use glam::DVec3;

use super::grid::Grid;

/// Number of cells that must be free above a surface.
const CLEAR: usize = 5;
/// Maximum number of surfaces that are examined in each column.
const STACKED: usize = 4;
/// Height of the free space above a place, in multiples of `Wish::enough`, at which the place gets half the score
/// that it would get under the open sky. Objects under a cover are dark and hard to see.
const COVERED: f64 = 10.0;
/// Minimum number of cells of a surface.
const FEWEST: usize = 30;

/// Level surface and the place on it that is farthest from its edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Position of the place, in world units.
    pub place: DVec3,
    /// Distance from the place to the edge of the surface or to the nearest object on it, in world units.
    pub radius: f64,
    /// Height above the floor, in world units.
    pub height: f64,
    /// Free space above the place, in world units.
    pub clearance: f64,
    /// Area of the surface, in square world units.
    pub area: f64,
    /// Quality of the place for an object; larger is better.
    pub score: f64,
}

/// Requirements for a place.
#[derive(Debug, Clone, Copy)]
pub struct Wish {
    /// Range of heights above the floor that are examined, in world units.
    pub heights: [f64; 2],
    /// Distance from the edge, in world units, beyond which more distance does not improve a place.
    pub enough: f64,
    /// Point that the place should be near, and the distance that counts as near, in world units.
    pub near: (DVec3, f64),
}

/// Level surfaces of a grid, each with its best place, best first. Surfaces with equal scores are in the order of
/// the grid.
pub fn surfaces(grid: &Grid, floor: f64, wish: &Wish) -> Vec<Surface> {
    let [nx, ny, nz] = grid.size;
    // Tops of the solid cells of each column, from the lowest.
    let mut tops: Vec<Vec<(u16, u16)>> = vec![Vec::new(); nx * ny];
    let allowed = |z: usize| {
        let height = grid.low.z + (z as f64 + 1.0) * grid.cell - floor;
        (wish.heights[0]..=wish.heights[1]).contains(&height)
    };
    for (c, list) in tops.iter_mut().enumerate() {
        let (x, y) = (c % nx, c / nx);
        let mut z = 0;
        while z < nz && list.len() < STACKED {
            if grid.is_solid([x, y, z]) && allowed(z) {
                let free = (z + 1..nz).take_while(|&above| !grid.is_solid([x, y, above])).count();
                if free >= CLEAR.min(nz - z - 1) && free > 0 {
                    // If nothing is above it up to the end of the grid, it is under the open sky.
                    let open = z + 1 + free == nz;
                    list.push((z as u16, if open { u16::MAX } else { free as u16 }));
                }
            }
            z += 1;
        }
    }
    // Neighbours at nearly the same height are one surface.
    let mut taken: Vec<Vec<bool>> = tops.iter().map(|list| vec![false; list.len()]).collect();
    let mut found = Vec::new();
    for c in 0..nx * ny {
        for k in 0..tops[c].len() {
            if taken[c][k] {
                continue;
            }
            taken[c][k] = true;
            let mut cells = vec![(c, k)];
            let mut next = 0;
            while next < cells.len() {
                let (at, own) = cells[next];
                next += 1;
                let z = tops[at][own].0;
                let (x, y) = (at % nx, at / nx);
                let sides = [
                    (x > 0).then(|| at - 1),
                    (x + 1 < nx).then_some(at + 1),
                    (y > 0).then(|| at.wrapping_sub(nx)),
                    (y + 1 < ny).then_some(at + nx),
                ];
                for side in sides.into_iter().flatten() {
                    if let Some(other) =
                        (0..tops[side].len()).find(|&o| tops[side][o].0.abs_diff(z) <= 1 && !taken[side][o])
                    {
                        taken[side][other] = true;
                        cells.push((side, other));
                    }
                }
            }
            if cells.len() >= FEWEST {
                found.extend(best(grid, floor, wish, &tops, &cells));
            }
        }
    }
    found.sort_by(|a: &Surface, b| b.score.total_cmp(&a.score));
    found
}

/// Best place of one surface, which consists of `cells`.
fn best(
    grid: &Grid,
    floor: f64,
    wish: &Wish,
    tops: &[Vec<(u16, u16)>],
    cells: &[(usize, usize)],
) -> Option<Surface> {
    let [nx, ny, _] = grid.size;
    // Distance to the nearest cell outside the surface, by two sweeps (chamfer 3-4).
    let mut far = vec![0_u32; nx * ny];
    cells.iter().for_each(|&(c, _)| far[c] = u32::MAX / 2);
    let get = |far: &[u32], x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && (x as usize) < nx && (y as usize) < ny;
        if inside { far[y as usize * nx + x as usize] } else { 0 }
    };
    for pass in 0..2 {
        for n in 0..nx * ny {
            let c = if pass == 0 { n } else { nx * ny - 1 - n };
            if far[c] == 0 {
                continue;
            }
            let (x, y) = ((c % nx) as isize, (c / nx) as isize);
            let s = if pass == 0 { -1 } else { 1 };
            let near = [(x + s, y, 3), (x - 1, y + s, 4), (x, y + s, 3), (x + 1, y + s, 4)];
            far[c] = near.into_iter().fold(far[c], |least, (x, y, by)| least.min(get(&far, x, y) + by));
        }
    }
    // Score each cell of the surface; the best becomes its place.
    let mut best: Option<Surface> = None;
    for &(c, k) in cells {
        let (x, y) = (c % nx, c / nx);
        let (z, free) = tops[c][k];
        let radius = f64::from(far[c]) / 3.0 * grid.cell;
        let top = grid.top([x, y, z as usize]);
        let place = grid.axes * top;
        let away = (place - wish.near.0).length() / wish.near.1;
        let detail = grid.detail(x, y).map_or(0.0, |size| 1.0 / (1.0 + size / grid.cell));
        let clearance = if free == u16::MAX { f64::INFINITY } else { f64::from(free) * grid.cell };
        let open = 1.0 / (1.0 + COVERED * wish.enough / clearance);
        let score = (radius / wish.enough).min(1.0) * detail * open / (1.0 + away * away);
        if best.is_none_or(|best| score > best.score) {
            let height = top.z - floor;
            let area = cells.len() as f64 * grid.cell * grid.cell;
            best = Some(Surface { place, radius, height, clearance, area, score });
        }
    }
    best
}
