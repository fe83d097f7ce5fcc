//! Distances to the surface at the corners of cells, fused from the depths of the views (Curless and Levoy 1996).
//! One thread computes each corner, from the views in their order, so the field has the same bits for any number of
//! threads.

use engine::{Context, NodeError};
use fearless_simd::{Level, Simd, dispatch};
use glam::Vec3;

use super::depth_view::DepthView;
use super::levels::{Cube, Levels, SIDE};

/// Number of corners of cells along the side of a cube. Corners on the faces of a cube are also stored in the
/// adjacent cubes, with the same values.
pub const CORNERS: usize = SIDE as usize + 1;
/// Number of corners of cells in a cube.
pub(super) const ALL: usize = CORNERS * CORNERS * CORNERS;

/// Maximum stored distance from the surface, in cells. For corners farther in front of the surface, this distance
/// is stored. Corners farther behind the surface are ignored.
const BAND: f32 = 3.0;
/// Maximum distance between a corner and the surface, measured along the ray, at which a view still counts as
/// seeing the surface at the corner. It is a multiple of [`BAND`]. For rays at a grazing angle, this distance is
/// much larger than the distance perpendicular to the surface.
const BEHIND: f32 = 3.0;
/// Minimum cosine of the angle between ray and normal for the depth of a pixel to count as a surface.
const FLATTEST: f32 = 0.1;
/// Weight, at a corner, of a view that sees empty space there, relative to a view that sees a surface there at a
/// right angle.
const THROUGH: f32 = 0.25;
/// Weight of a pixel at an edge between two surfaces, relative to a pixel that shows a single surface.
const AT_EDGE: f32 = 0.25;
/// Minimum number of views that must see the surface near a corner that lies behind the surface. With fewer views,
/// the surface is left out at this corner.
const VIEWS: u8 = 2;

/// Part of the field in one cube.
pub struct Block {
    /// The cube.
    pub cube: Cube,
    /// Distance from each corner to the surface, in world units, negative behind the surface; 0 if no view shows
    /// the corner.
    pub(super) distance: Box<[f32; ALL]>,
    /// Standard deviation of the distances to the surface that the views observe at the surface, in world units.
    pub(super) deviation: f32,
    /// Number of views that see the surface near each corner. It is 1 if views see only empty space there, and 0 if
    /// the corner is hidden in all views.
    views: Box<[u8; ALL]>,
    /// One bit per cell, which is 1 if all corners of the cell have a distance.
    whole: [u64; SIDE as usize],
}

/// Index of a corner.
pub fn corner(x: usize, y: usize, z: usize) -> usize {
    (z * CORNERS + y) * CORNERS + x
}

impl Block {
    /// Distance to the surface at a corner, and the number of views that see the surface there.
    pub fn at(&self, corner: usize) -> (f32, u8) {
        (self.distance[corner], self.views[corner])
    }

    /// True if the surface passes between two corners, and enough views see the surface at the corner behind it.
    pub fn crosses(&self, from: usize, to: usize) -> bool {
        let ((a, a_views), (b, b_views)) = (self.at(from), self.at(to));
        a_views > 0
            && b_views > 0
            && (a < 0.0) != (b < 0.0)
            && (if a < 0.0 { a_views } else { b_views }) >= VIEWS
    }

    /// True if all corners of a cell have a distance.
    pub fn is_whole(&self, cell: usize) -> bool {
        self.whole[cell / 64] >> (cell % 64) & 1 == 1
    }

    fn mark_whole(&mut self) {
        self.whole = [0; SIDE as usize];
        let side = SIDE as usize;
        for (z, bits) in self.whole.iter_mut().enumerate() {
            for y in 0..side {
                for x in 0..side {
                    let known =
                        |k: usize| self.views[corner(x + (k & 1), y + (k >> 1 & 1), z + (k >> 2))] > 0;
                    *bits |= u64::from((0..8).all(known)) << (y * side + x);
                }
            }
        }
    }
}

/// Memory used by a block, in bytes.
pub const BLOCK_BYTES: u64 = (ALL * 5 + 128) as u64;

/// The field: its blocks, sorted by cube.
pub struct Field<'a> {
    /// The cells, by cube.
    pub levels: &'a Levels,
    /// The parts of the field.
    pub blocks: Vec<Block>,
}

/// A row of corners, projected into a view.
#[derive(Default)]
struct Row {
    /// True for each corner whose projection lies between the centres of four pixels.
    inside: [bool; CORNERS],
    x: [f32; CORNERS],
    y: [f32; CORNERS],
    depth: [f32; CORNERS],
    /// For each corner, the distance from the eye divided by the planar depth.
    stretch: [f32; CORNERS],
}

impl Row {
    /// Projects a row without branches, so that the compiler can vectorise it.
    #[inline(always)]
    fn project(&mut self, view: &DepthView, places: &[Vec3; CORNERS]) {
        let [right, bottom] = [view.width, view.height].map(|side| (side - 1) as f32);
        for (i, place) in places.iter().enumerate() {
            let offset = *place - view.eye;
            let depth = offset.dot(view.forward);
            let inverse = 1.0 / depth;
            let x = view.focal[0] * (offset.dot(view.right) * inverse) + view.middle[0] - 0.5;
            let y = view.focal[1] * (offset.dot(view.down) * inverse) + view.middle[1] - 0.5;
            (self.x[i], self.y[i], self.depth[i]) = (x, y, depth);
            self.stretch[i] = offset.length() * inverse;
            self.inside[i] = (depth > 1e-6) & (x >= 0.0) & (y >= 0.0) & (x < right) & (y < bottom);
        }
    }
}

/// Computes one block. `far` is 1 divided by the square of the depth at which a surface has half the weight of a
/// surface at depth 0.
#[inline(always)]
fn fused(cube: Cube, views: &[DepthView], levels: &Levels, far: f32) -> Block {
    let cell = levels.cell_of(cube.level);
    let first = cube.corner();
    let place = |x: usize, y: usize, z: usize| {
        let at = [x, y, z].map(|i| i as i32 * cube.step());
        Vec3::from([0, 1, 2].map(|k| (first[k] + at[k]) as f32)) * levels.cell
    };
    let band = BAND * cell;
    let half = 0.5 * SIDE as f32 * cell;
    let (middle, radius) = (place(0, 0, 0) + Vec3::splat(half), half * 1.7321);
    let (mut sums, mut weights, mut counts) = ([0.0_f32; ALL], [0.0_f32; ALL], [0_u8; ALL]);
    // Sums over the views that see a surface here: weights, distances and their squares.
    let mut at_surface = [[0.0_f32; 3]; ALL];
    let mut row = Row::default();
    for view in views.iter().filter(|view| view.may_see(middle, radius, BEHIND * band)) {
        for z in 0..CORNERS {
            for y in 0..CORNERS {
                let places: [Vec3; CORNERS] = std::array::from_fn(|x| place(x, y, z));
                row.project(view, &places);
                for x in (0..CORNERS).filter(|x| row.inside[*x]) {
                    let (inverse, one_surface, nearest) = view.surface([row.x[x], row.y[x]]);
                    let [trust, cosine] = view.marks[nearest].map(|mark| f32::from(mark) * (1.0 / 255.0));
                    let at = corner(x, y, z);
                    let near = 1.0 / (1.0 + row.depth[x] * row.depth[x] * far);
                    let mut weight = trust * near * if one_surface { 1.0 } else { AT_EDGE };
                    // Distance of the corner in front of the surface: along the ray, and then perpendicular to the
                    // surface.
                    let before = if inverse > 0.0 {
                        (1.0 / inverse - row.depth[x]) * row.stretch[x]
                    } else {
                        f32::INFINITY
                    };
                    let mut distance = before * cosine;
                    if distance >= band || cosine < FLATTEST && before > BEHIND * band {
                        weight *= THROUGH;
                        distance = band;
                    } else if distance < -band || before < -BEHIND * band || cosine < FLATTEST {
                        continue;
                    } else {
                        weight *= cosine * cosine;
                        counts[at] = counts[at].saturating_add(u8::from(weight > 0.0));
                        let by_weight = weight * distance;
                        let [all, sum, squares] = &mut at_surface[at];
                        (*all, *sum) = (*all + weight, *sum + by_weight);
                        *squares += by_weight * distance;
                    }
                    sums[at] += weight * distance;
                    weights[at] += weight;
                }
            }
        }
    }
    let mut block = Block {
        cube,
        distance: Box::new([0.0; ALL]),
        deviation: 0.0,
        views: Box::new([0; ALL]),
        whole: [0; SIDE as usize],
    };
    let mut deviations: Vec<f32> = Vec::new();
    for at in 0..ALL {
        if weights[at] > 0.0 {
            block.distance[at] = sums[at] / weights[at];
            block.views[at] = counts[at].max(1);
            let [all, sum, squares] = at_surface[at];
            if counts[at] >= VIEWS && block.distance[at].abs() < cell {
                let mean = sum / all;
                deviations.push((squares / all - mean * mean).max(0.0).sqrt());
            }
        }
    }
    // The median, because at edges, where views see other surfaces, the deviation is not noise.
    deviations.sort_unstable_by(f32::total_cmp);
    block.deviation = deviations.get(deviations.len() / 2).copied().unwrap_or(0.0);
    block.mark_whole();
    block
}

impl DepthView {
    /// True unless a ball is certainly outside the picture, or certainly hidden behind the visible surface by more
    /// than `behind`.
    fn may_see(&self, middle: Vec3, radius: f32, behind: f32) -> bool {
        let offset = middle - self.eye;
        let depth = offset.dot(self.forward);
        if depth < -radius {
            return false;
        }
        // The four planes through the eye and the edges, times the lengths of their normals.
        let edge = |side: Vec3, focal: f32, room: f32| {
            let along = focal * offset.dot(side) - room * depth;
            along * along.abs() <= radius * radius * (focal * focal + room * room)
        };
        let (width, height) = (self.width as f32, self.height as f32);
        edge(self.right, self.focal[0], width - self.middle[0])
            && edge(-self.right, self.focal[0], self.middle[0])
            && edge(self.down, self.focal[1], height - self.middle[1])
            && edge(-self.down, self.focal[1], self.middle[1])
            && !self.hides(offset, radius, behind)
    }
}

/// Same as [`fused`], compiled for each instruction set.
#[inline(always)]
fn fused_at<S: Simd>(_simd: S, cube: Cube, views: &[DepthView], levels: &Levels, far: f32) -> Block {
    fused(cube, views, levels, far)
}

impl<'a> Field<'a> {
    /// Fuses the views in the given cubes, which must be sorted. A surface at a depth of `half_at` world units has
    /// half the weight of a surface at depth 0.
    pub fn fused(
        cubes: &[Cube],
        views: &[DepthView],
        levels: &'a Levels,
        half_at: f32,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        const GROUP: usize = 16;
        let far = 1.0 / (half_at * half_at);
        let groups = cx.for_each_tile(cubes.len().div_ceil(GROUP), |group| {
            let cubes = &cubes[group * GROUP..((group + 1) * GROUP).min(cubes.len())];
            let level = Level::new();
            let one = |cube: &Cube| dispatch!(level, simd => fused_at(simd, *cube, views, levels, far));
            let kept = cubes.iter().map(one).filter(Block::is_of_use);
            kept.collect::<Vec<_>>()
        })?;
        let mut field = Self { levels, blocks: groups.into_iter().flatten().collect() };
        field.flatten(cx)?;
        field.join_levels(cx)?;
        Ok(field)
    }

    /// Index of the block, and index of the cell in this block, that contain the given finest cell. `None` if no
    /// block contains it.
    pub fn locate(&self, at: [i32; 3]) -> Option<(usize, usize)> {
        for level in 0..self.levels.reach.len() as u8 {
            let cell = at.map(|v| v >> level);
            let cube = Cube { level, at: cell.map(|v| v.div_euclid(SIDE)) };
            if let Ok(index) = self.blocks.binary_search_by(|block| block.cube.cmp(&cube)) {
                let [x, y, z] = cell.map(|v| v.rem_euclid(SIDE) as usize);
                return Some((index, (z * SIDE as usize + y) * SIDE as usize + x));
            }
        }
        None
    }

    /// Makes the distances equal where cubes of two sizes meet: the corners that they share get the distances of
    /// the smaller cube.
    fn join_levels(&mut self, cx: &Context) -> Result<(), NodeError> {
        for level in 1..self.levels.reach.len() as u8 {
            let blocks: Vec<usize> =
                (0..self.blocks.len()).filter(|i| self.blocks[*i].cube.level == level).collect();
            let field = &*self;
            let changes = cx.for_each_tile(blocks.len(), |i| field.inherited(&field.blocks[blocks[i]]))?;
            for (block, changes) in blocks.into_iter().zip(changes).filter(|(_, changes)| !changes.is_empty())
            {
                let block = &mut self.blocks[block];
                for (corner, distance, views) in changes {
                    block.distance[corner] = distance;
                    block.views[corner] = views;
                }
                block.mark_whole();
            }
        }
        Ok(())
    }

    /// Corners that a block shares with finer blocks. For each: its index, and the distance and number of views
    /// that the finest of these blocks has there.
    fn inherited(&self, block: &Block) -> Vec<(usize, f32, u8)> {
        let level = block.cube.level;
        let side = self.levels.cell_of(level) * SIDE as f32;
        if self.levels.distance_to(block.cube) - 1.8 * side >= self.levels.reach[level as usize - 1] {
            return Vec::new();
        }
        let (first, mut changes) = (block.cube.corner(), Vec::new());
        let last = CORNERS - 1;
        for z in 0..CORNERS {
            for y in 0..CORNERS {
                for x in 0..CORNERS {
                    if ![x, y, z].iter().any(|i| *i == 0 || *i == last) {
                        continue;
                    }
                    let at: [i32; 3] =
                        std::array::from_fn(|k| first[k] + [x, y, z][k] as i32 * block.cube.step());
                    let mut finest: Option<(u8, f32, u8)> = None;
                    for around in 0..8 {
                        let cell: [i32; 3] = std::array::from_fn(|k| at[k] - (around >> k & 1));
                        let Some((index, _)) = self.locate(cell) else { continue };
                        let other = &self.blocks[index];
                        if other.cube.level >= finest.map_or(level, |(level, ..)| level) {
                            continue;
                        }
                        let origin = other.cube.corner();
                        let [x, y, z]: [usize; 3] =
                            std::array::from_fn(|k| ((at[k] - origin[k]) >> other.cube.level) as usize);
                        let (distance, views) = other.at(corner(x, y, z));
                        if views > 0 {
                            finest = Some((other.cube.level, distance, views));
                        }
                    }
                    changes.extend(finest.map(|(_, distance, views)| (corner(x, y, z), distance, views)));
                }
            }
        }
        changes
    }
}

impl Block {
    /// True if the surface may pass through the block or along its faces.
    fn is_of_use(&self) -> bool {
        self.whole.iter().any(|bits| *bits != 0)
    }
}
