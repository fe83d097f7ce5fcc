//! Subdivision of space into cubes of eight cells per side. The size of the cells doubles from level to level, with
//! increasing distance from the places where objects will stand.

use glam::Vec3;

/// Number of cells along the side of a cube.
pub const SIDE: i32 = 8;

/// Ratio of the reach of a level (see [`Levels::reach`]) to the reach of the next finer level.
const GROWTH: f32 = 2.5;

/// Maximum number of levels.
pub const MOST: usize = 7;

/// Cube of cells: its level, and its position in units of cubes of that level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cube {
    /// Level of the cells: their side is `2^level` times the side of the finest cells.
    pub level: u8,
    /// Position along x, y and z, in cubes of the level.
    pub at: [i32; 3],
}

impl Cube {
    /// Side of a cell of the cube, in units of the finest cells.
    pub fn step(self) -> i32 {
        1 << self.level
    }

    /// The corner of the cube that has the smallest coordinates, in units of the finest cells.
    pub fn corner(self) -> [i32; 3] {
        self.at.map(|at| at * (SIDE << self.level))
    }
}

/// Levels of cells, which determine the size of the cells at each position.
#[derive(Debug, Clone)]
pub struct Levels {
    /// Side of the finest cells, in world units.
    pub cell: f32,
    /// Points around which cells are finest.
    pub foci: Vec<Vec3>,
    /// For each level, the maximum distance of its cells from the nearest focus, in world units. The mesh ends at
    /// the reach of the last level.
    pub reach: Vec<f32>,
}

impl Levels {
    /// Creates the levels. Cells have the side `cell` up to the distance `radius` from the foci, and the last level
    /// ends at the distance `reach`. All are in world units.
    pub fn new(cell: f32, foci: Vec<Vec3>, radius: f32, reach: f32) -> Self {
        let mut reaches = vec![radius.min(reach)];
        while let Some(last) = reaches.last().copied().filter(|last| *last < reach) {
            let next = if reaches.len() + 1 == MOST { reach } else { (last * GROWTH).min(reach) };
            reaches.push(next);
        }
        Self { cell, foci, reach: reaches }
    }

    /// Side of the cells of a level, in world units.
    pub fn cell_of(&self, level: u8) -> f32 {
        self.cell * (1_u32 << level) as f32
    }

    /// Distance from the nearest focus to a box.
    fn distance(&self, low: Vec3, high: Vec3) -> f32 {
        let of = |focus: &Vec3| (*focus - focus.clamp(low, high)).length_squared();
        self.foci.iter().map(of).fold(f32::INFINITY, f32::min).sqrt()
    }

    /// Distance from the nearest focus to a cube.
    pub fn distance_to(&self, cube: Cube) -> f32 {
        let side = self.cell_of(cube.level) * SIDE as f32;
        let low = Vec3::from(cube.at.map(|at| at as f32)) * side;
        self.distance(low, low + Vec3::splat(side))
    }

    /// True if the space of this cube is divided into smaller cubes.
    pub fn is_split(&self, cube: Cube) -> bool {
        cube.level > 0 && self.distance_to(cube) < self.reach[cube.level as usize - 1]
    }

    /// Cube that contains a point. `None` if the point is beyond the reach of the last level.
    pub fn cube_at(&self, point: Vec3) -> Option<Cube> {
        if !point.is_finite() || self.distance(point, point) >= *self.reach.last()? {
            return None;
        }
        for level in (0..self.reach.len() as u8).rev() {
            let side = self.cell_of(level) * SIDE as f32;
            let cube = Cube { level, at: (point / side).to_array().map(|v| v.floor() as i32) };
            if !self.is_split(cube) {
                return Some(cube);
            }
        }
        None
    }
}
