//! Removes noise from the flat parts of the field.
//!
//! The noise of splats is the same in all views, so more views do not remove it: neighbouring trained splats of a
//! paved path differ by centimetres. Around each corner of a cube, a plane is fitted to the surface in the eight
//! adjacent cubes. Where the surface agrees with that plane to within its own noise, which is the deviation between
//! the views, distances to the surface are replaced with distances to the plane. No point moves by more than twice
//! the noise, and parts that deviate by more, such as a kerb, do not move.

use engine::{Context, NodeError};
use glam::{DMat3, DVec3, Vec3};

use super::field::{ALL, Block, CORNERS, Field, corner};
use super::levels::{Cube, Levels, SIDE};

/// Maximum distance of a flat surface from its plane, in standard deviations of the distances that views report.
const SIGMAS: f64 = 3.0;
/// Maximum noise of a flat surface, in cells. Larger deviations from the plane count as the shape of the surface,
/// since the mesh can represent them. Without this limit, views at grazing angles, which disagree by centimetres,
/// would tilt the top of a box.
const MOST_CELLS: f64 = 0.25;
/// Minimum number of points to which a plane is fitted. A flat surface through four adjacent cubes has about four
/// times as many.
const FEWEST: f64 = 64.0;
/// Minimum length of the mean normal of a surface that faces one direction.
const COHERENT: f64 = 0.5;
/// Minimum share of the points that lie on the plane to within its noise.
const ON_PLANE: f64 = 0.7;
/// Number of blocks that are processed at once. Their old and new distances are in memory at the same time.
const GROUP: usize = 1024;

/// Sums over the surface in one or more cubes: number of points, positions, their products, and normals.
#[derive(Debug, Clone, Copy, Default)]
struct Patch {
    points: f64,
    sum: DVec3,
    /// Sums of the products of two coordinates, in the order xx, xy, xz, yy, yz, zz.
    squares: [f64; 6],
    normal: DVec3,
}

impl Patch {
    /// Sums over the surface in a cube, or over the part of it that lies on the plane `on`, if one is given.
    fn of(block: &Block, levels: &Levels, on: Option<&Plane>) -> Self {
        let cell = levels.cell_of(block.cube.level);
        let first = block.cube.corner();
        let mut patch = Self::default();
        let side = SIDE as usize;
        for z in 0..side {
            for y in 0..side {
                for x in 0..side {
                    let at = [x, y, z];
                    let (distance, views) = block.at(corner(x, y, z));
                    if views == 0 || distance.abs() >= cell {
                        continue;
                    }
                    let gradient = gradient(block, at, cell);
                    let Some(normal) = gradient.and_then(DVec3::try_normalize) else { continue };
                    let place = Vec3::from(std::array::from_fn::<f32, 3, _>(|k| {
                        (first[k] + at[k] as i32 * block.cube.step()) as f32 * levels.cell
                    }));
                    let p = place.as_dvec3() - normal * f64::from(distance);
                    if on.is_some_and(|plane| plane.distance(p.as_vec3()).abs() > plane.noise) {
                        continue;
                    }
                    patch.points += 1.0;
                    patch.sum += p;
                    let squares = [p.x * p.x, p.x * p.y, p.x * p.z, p.y * p.y, p.y * p.z, p.z * p.z];
                    patch.squares.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
                    patch.normal += normal;
                }
            }
        }
        patch
    }

    /// Adds another patch, with the weight `times` for each of its points.
    fn add(&mut self, other: &Self, times: f64) {
        self.points += times * other.points;
        self.sum += times * other.sum;
        self.squares.iter_mut().zip(other.squares).for_each(|(sum, square)| *sum += times * square);
        self.normal += times * other.normal;
    }

    /// Fits a plane to the points. The second value is true if the points lie on the plane to within the noise.
    /// `None` if there are too few points or their normals disagree.
    fn plane(&self, noise: f64) -> Option<(Plane, bool)> {
        if self.points < FEWEST || self.normal.length() < COHERENT * self.points {
            return None;
        }
        let middle = self.sum / self.points;
        let [xx, xy, xz, yy, yz, zz] = self.squares.map(|square| square / self.points);
        let spread = DMat3::from_cols(
            DVec3::new(xx, xy, xz) - middle * middle.x,
            DVec3::new(xy, yy, yz) - middle * middle.y,
            DVec3::new(xz, yz, zz) - middle * middle.z,
        );
        // The direction of minimum spread, by inverse iteration from the mean normal.
        let size = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
        let inverse = (spread + DMat3::from_diagonal(DVec3::splat(1e-9 * size))).inverse();
        let facing = self.normal.normalize();
        let mut normal = facing;
        for _ in 0..4 {
            normal = (inverse * normal).try_normalize()?;
        }
        normal *= normal.dot(facing).signum();
        let off = normal.dot(spread * normal).max(0.0);
        let plane =
            Plane { normal: normal.as_vec3(), offset: normal.dot(middle) as f32, noise: noise as f32 };
        (normal.dot(facing) > 0.7).then_some((plane, off <= noise * noise))
    }
}

/// Gradient of the distance at a corner. `None` if the distance at an adjacent corner is unknown.
fn gradient(block: &Block, at: [usize; 3], cell: f32) -> Option<DVec3> {
    let mut gradient = [0.0_f64; 3];
    for (k, slope) in gradient.iter_mut().enumerate() {
        let (mut low, mut high) = (at, at);
        low[k] = low[k].saturating_sub(1);
        high[k] += 1;
        let of = |[x, y, z]: [usize; 3]| {
            let (distance, views) = block.at(corner(x, y, z));
            (views > 0).then_some(distance)
        };
        *slope = f64::from((of(high)? - of(low)?) / ((high[k] - low[k]) as f32 * cell));
    }
    Some(DVec3::from(gradient))
}

/// A plane, with the noise of the surface around it.
#[derive(Debug, Clone, Copy)]
struct Plane {
    normal: Vec3,
    offset: f32,
    noise: f32,
}

impl Plane {
    /// Signed distance from the plane, positive on the side that the surface faces.
    fn distance(&self, place: Vec3) -> f32 {
        self.normal.dot(place) - self.offset
    }

    /// Amount that is subtracted from `distance`, the distance of the field at `place`. If it differs from the
    /// distance to the plane by at most the noise, the amount is the whole difference. For larger differences the
    /// amount decreases, and reaches 0 at twice the noise.
    fn excess(&self, place: Vec3, distance: f32) -> f32 {
        let off = distance - self.distance(place);
        off * (2.0 - off.abs() / self.noise.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
    }
}

/// The eight corners of a cube. A corner is identified by the cube that extends from it in the positive directions.
fn ends(cube: Cube) -> [Cube; 8] {
    std::array::from_fn(|i| Cube {
        level: cube.level,
        at: std::array::from_fn(|k| cube.at[k] + (i as i32 >> k & 1)),
    })
}

impl Field<'_> {
    /// Removes noise from the flat parts of the field.
    pub(super) fn flatten(&mut self, cx: &Context) -> Result<(), NodeError> {
        let (blocks, levels) = (&self.blocks, self.levels);
        let patches = tiled(blocks.len(), &|i| Patch::of(&blocks[i], levels, None), cx)?;
        let mut lattice: Vec<Cube> = blocks.iter().flat_map(|block| ends(block.cube)).collect();
        lattice.sort_unstable();
        lattice.dedup();
        let plane = |i: usize| {
            let around = self.around(lattice[i]);
            let sum = |of: &dyn Fn(usize) -> Patch| {
                around.iter().fold(Patch::default(), |mut sum, (index, times)| {
                    sum.add(&of(*index), *times);
                    sum
                })
            };
            let all = sum(&|index| patches[index]);
            let mut noise: Vec<f32> = around
                .iter()
                .filter(|(index, _)| patches[*index].points >= FEWEST / 8.0)
                .map(|(index, _)| blocks[*index].deviation)
                .collect();
            noise.sort_unstable_by(f32::total_cmp);
            let deviation = f64::from(*noise.get(noise.len() / 2)?);
            let noise = (SIGMAS * deviation).min(MOST_CELLS * f64::from(levels.cell_of(lattice[i].level)));
            let (first, is_flat) = all.plane(noise)?;
            if is_flat {
                return Some(first);
            }
            // Objects on the plane, or deep holes: fit again without them.
            let on = sum(&|index| Patch::of(&blocks[index], levels, Some(&first)));
            on.plane(noise).filter(|_| on.points >= ON_PLANE * all.points).map(|(plane, _)| plane)
        };
        let planes = tiled(lattice.len(), &plane, cx)?;
        for first in (0..self.blocks.len()).step_by(GROUP) {
            let blocks = &self.blocks;
            let count = GROUP.min(blocks.len() - first);
            let of = |i: usize| {
                let block = &blocks[first + i];
                let around =
                    ends(block.cube).map(|end| lattice.binary_search(&end).ok().and_then(|i| planes[i]));
                around.iter().any(Option::is_some).then(|| flat(block, &around, levels))
            };
            let changed = tiled(count, &of, cx)?;
            for (block, distance) in self.blocks[first..first + count].iter_mut().zip(changed) {
                block.distance =
                    distance.unwrap_or_else(|| std::mem::replace(&mut block.distance, Box::new([0.0; ALL])));
            }
        }
        Ok(())
    }
}

impl Field<'_> {
    /// Indices of the blocks around a corner of cubes, each with the area that one of its points represents,
    /// relative to the area of a point at the level of the corner. Where cubes of two levels meet, some of the
    /// blocks are larger or smaller than the cubes of that level.
    fn around(&self, end: Cube) -> Vec<(usize, f64)> {
        let find = |cube: Cube| self.blocks.binary_search_by(|block| block.cube.cmp(&cube)).ok();
        let mut found: Vec<(usize, f64)> = Vec::with_capacity(8);
        for i in 0..8 {
            let at: [i32; 3] = std::array::from_fn(|k| end.at[k] - (i >> k & 1));
            if let Some(index) = find(Cube { level: end.level, at }) {
                found.push((index, 1.0));
                continue;
            }
            let larger = find(Cube { level: end.level + 1, at: at.map(|v| v >> 1) });
            if let Some(index) = larger {
                if found.iter().all(|(other, _)| *other != index) {
                    found.push((index, 4.0));
                }
            } else if end.level > 0 {
                let smaller = ends(Cube { level: end.level - 1, at: at.map(|v| 2 * v) });
                found.extend(smaller.into_iter().filter_map(find).map(|index| (index, 0.25)));
            }
        }
        found
    }
}

/// Calls `of` for every index below `count` in parallel. Returns the results in the order of the indices.
fn tiled<T: Send>(count: usize, of: &(dyn Fn(usize) -> T + Sync), cx: &Context) -> Result<Vec<T>, NodeError> {
    const TILE: usize = 64;
    let groups = cx.for_each_tile(count.div_ceil(TILE), |tile| {
        (tile * TILE..((tile + 1) * TILE).min(count)).map(of).collect::<Vec<T>>()
    })?;
    Ok(groups.into_iter().flatten().collect())
}

/// Flattened distances of a block. From each distance, its excess over the plane (see [`Plane::excess`]) is
/// subtracted. The excess is interpolated between the planes at the eight corners of the block.
fn flat(block: &Block, planes: &[Option<Plane>; 8], levels: &Levels) -> Box<[f32; ALL]> {
    let first = block.cube.corner();
    let mut distance = block.distance.clone();
    for z in 0..CORNERS {
        for y in 0..CORNERS {
            for x in 0..CORNERS {
                let (at, own) = ([x, y, z], corner(x, y, z));
                if block.at(own).1 == 0 {
                    continue;
                }
                let place = Vec3::from(std::array::from_fn::<f32, 3, _>(|k| {
                    (first[k] + at[k] as i32 * block.cube.step()) as f32 * levels.cell
                }));
                let mut excess = 0.0;
                for (i, plane) in planes.iter().enumerate() {
                    let share = |k: usize| {
                        let along = at[k] as f32 * (1.0 / SIDE as f32);
                        if i >> k & 1 == 1 { along } else { 1.0 - along }
                    };
                    let weight = share(0) * share(1) * share(2);
                    if let Some(plane) = plane.filter(|_| weight > 0.0) {
                        excess += weight * plane.excess(place, distance[own]);
                    }
                }
                distance[own] -= excess;
            }
        }
    }
    distance
}
