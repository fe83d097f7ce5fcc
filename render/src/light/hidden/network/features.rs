//! Features of the clipped cells and regions of a panorama.

use crate::light::measure::luminance;
use engine::Up;
use glam::DVec3;
use scene::math::equirect::axes;
use scene::math::num;

use super::super::grid::Grid;
use super::blur::{FIELDS, Fields};
use super::rings::RINGS;

/// Number of features of the whole panorama.
pub const OVERVIEW: usize = 23;
/// Number of features of each clipped cell.
pub const CELL: usize = 60;
/// Number of features of each clipped region that predict the colour of its light.
pub const COLOUR: usize = PROFILE + 2 + ABOUT_COLOUR.len();
/// Number of features of [`Region::profile`].
const PROFILE: usize = 19;
/// Indices of the features of the whole panorama that predict the colour of a light.
const ABOUT_COLOUR: [usize; 7] = [0, 8, 10, 15, 16, 17, 21];
/// Indices of the rings whose colour is a feature.
const COLOURED: [usize; 4] = [0, 1, 2, 4];
/// Radii of the neighbourhoods, in columns of a grid of 256: 2.8, 8.4, 22.5 and 63 degrees.
const RADII: [usize; 4] = [2, 6, 16, 45];
/// Minimum value of the darkest channel at which a cell counts as clipped in all channels.
pub const WHITE: f64 = 0.95;

/// Description of the neighbourhood of a cell; see [`GridQuantities::neighbourhoods`].
pub type Neighbourhood = [f64; 5];

/// One connected clipped region.
pub struct Region {
    /// log2 of the solid angle of the region.
    size: f64,
    share: f64,
    /// Mean, largest and smallest sine of the elevation of the cells.
    sine: [f64; 3],
    centre: DVec3,
    /// Root mean square angle from the centre of the region.
    radius: f64,
    deepest: f64,
    white: f64,
    /// Mean brightness of the near surroundings and of the wider surroundings.
    around: [f64; 2],
    /// Brightness of the rings around the region, their colour, the share of the region that is clipped in each
    /// channel, and the colour of its clipped part.
    profile: [f64; PROFILE],
}

/// Quantities per cell that the features are computed from.
pub struct GridQuantities<'a> {
    pub grid: &'a Grid,
    pub up: Up,
    /// For each row, the solid angle of one cell.
    solid_angle: Vec<f64>,
    /// Sine of the elevation of each row.
    sine: Vec<f64>,
    /// Luminance of the visible part of each cell.
    pub luminance: Vec<f64>,
    /// Solid angle of the visible unclipped part of each cell.
    pub open: Vec<f64>,
    /// Mean light of the visible unclipped part of each cell.
    pub open_rgb: Vec<[f64; 3]>,
    /// Luminance of `open_rgb`.
    pub open_luminance: Vec<f64>,
    /// Solid angle of the visible clipped part of each cell.
    pub clipped: Vec<f64>,
    /// Mean light of the visible clipped part of each cell.
    pub clipped_rgb: Vec<[f64; 3]>,
    /// Luminance of `clipped_rgb`.
    pub clipped_luminance: Vec<f64>,
}

pub fn log2(v: f64, least: f64) -> f64 {
    num::f64::log2(v.max(least))
}

impl<'a> GridQuantities<'a> {
    /// Computes the quantities of a panorama whose white level is `ceiling`. Light is scaled so that white becomes
    /// 1.
    pub fn new(grid: &'a Grid, up: Up, ceiling: f64) -> Self {
        let above = axes(up)[2];
        let row = |y: usize| y * grid.width;
        let solid_angle: Vec<f64> = (0..grid.height).map(|y| grid.solid_angle(row(y))).collect();
        let sine = (0..grid.height).map(|y| grid.direction(up, row(y)).dot(above)).collect();
        let held = |light: &[[f64; 3]]| -> Vec<[f64; 3]> {
            light.iter().map(|rgb| rgb.map(|v| (v / ceiling).min(1.0))).collect()
        };
        let bright = |light: &[[f64; 3]]| -> Vec<f64> { light.iter().map(|rgb| luminance(*rgb)).collect() };
        let (open_rgb, clipped_rgb) = (held(&grid.open_rgb), held(&grid.clipped_rgb));
        let cells = 0..grid.rgb.len();
        Self {
            grid,
            up,
            solid_angle,
            sine,
            luminance: bright(&held(&grid.rgb)),
            open: cells.clone().map(|c| grid.open_angle(c)).collect(),
            open_luminance: bright(&open_rgb),
            open_rgb,
            clipped: cells.map(|c| grid.clipped_angle(c)).collect(),
            clipped_luminance: bright(&clipped_rgb),
            clipped_rgb,
        }
    }

    pub fn cells(&self) -> std::ops::Range<usize> {
        0..self.luminance.len()
    }

    pub fn sine(&self, cell: usize) -> f64 {
        self.sine[cell / self.grid.width]
    }

    pub fn solid_angle(&self, cell: usize) -> f64 {
        self.solid_angle[cell / self.grid.width]
    }

    /// Values for each of [`RADII`] and each cell, which describe the neighbourhood of the cell: the clipped share,
    /// log2 of the mean luminance of the unclipped part, the ratio of blue to red of the unclipped part in stops, the
    /// share that is clipped in all channels, and the ratio of green to red of the unclipped part in stops.
    pub fn neighbourhoods(&self) -> Vec<Vec<Neighbourhood>> {
        let field = |c: usize| {
            let (all, open, [r, g, b]) = (self.solid_angle(c), self.open[c], self.open_rgb[c]);
            let clipped = self.clipped[c];
            let white = if self.least(c) > WHITE { clipped } else { 0.0 };
            [clipped, self.open_luminance[c] * open, r * open, b * open, open, white, all, g * open]
        };
        let fields = Fields { width: self.grid.width, values: self.cells().map(field).collect() };
        let describe = |[clipped, light, red, blue, open, white, all, green]: [f64; FIELDS]| {
            let all = all.max(1e-12);
            let brightness = num::f64::log2((light + 2e-5 * all) / (open + 1e-3 * all) + 1e-3);
            let hue = |light: f64| num::f64::log2((light + 1e-5 * all) / (red + 1e-5 * all)).clamp(-3.0, 3.0);
            [clipped / all, brightness, hue(blue), white / all, hue(green)]
        };
        RADII
            .iter()
            .map(|radius| {
                let blurred = fields.blurred((radius * self.grid.width / 256).max(1));
                blurred.values.into_iter().map(describe).collect()
            })
            .collect()
    }

    /// Value of the darkest channel of the clipped part of a cell.
    pub fn least(&self, cell: usize) -> f64 {
        self.clipped_rgb[cell].into_iter().fold(1.0, f64::min)
    }

    /// Features of a region from the rings around it; see [`Region::profile`].
    fn profile(&self, cells: &[usize], rings: &[[f64; 3]; RINGS]) -> [f64; PROFILE] {
        let stops = |light: f64, of: f64, least: f64| num::f64::log2((light + least) / (of + least));
        let mut numbers = Vec::with_capacity(PROFILE);
        numbers.extend(rings.map(|rgb| log2(luminance(rgb), 1e-4)));
        numbers.extend(COLOURED.map(|ring| stops(rings[ring][0], rings[ring][1], 1e-4)));
        numbers.extend(COLOURED.map(|ring| stops(rings[ring][2], rings[ring][1], 1e-4)));
        let size: f64 = cells.iter().map(|&c| self.clipped[c]).sum();
        let share = |channel: usize| {
            let full = |&&c: &&usize| self.clipped_rgb[c][channel] > WHITE;
            cells.iter().filter(full).map(|&c| self.clipped[c]).sum::<f64>() / size
        };
        numbers.extend([0, 1, 2].map(share));
        let mean = |channel: usize| {
            cells.iter().map(|&c| self.clipped[c] * self.clipped_rgb[c][channel]).sum::<f64>() / size
        };
        numbers.extend([0, 2].map(|channel| stops(mean(channel), mean(1), 1e-2)));
        std::array::from_fn(|i| numbers.get(i).copied().unwrap_or(0.0))
    }

    pub fn region(
        &self,
        (cells, rings): (&[usize], &[[f64; 3]; RINGS]),
        total: f64,
        depth: &[f32],
        around: &[Vec<Neighbourhood>],
    ) -> Region {
        let mut region = Region {
            size: 0.0,
            share: 0.0,
            sine: [0.0, -1.0, 1.0],
            centre: DVec3::ZERO,
            radius: 0.0,
            deepest: 0.0,
            white: 0.0,
            around: [0.0; 2],
            profile: self.profile(cells, rings),
        };
        let mut size = 0.0;
        for &c in cells {
            let (solid_angle, sine) = (self.clipped[c], self.sine(c));
            size += solid_angle;
            region.sine =
                [region.sine[0] + sine * solid_angle, region.sine[1].max(sine), region.sine[2].min(sine)];
            region.centre += self.grid.direction(self.up, c) * solid_angle;
            region.deepest = region.deepest.max(f64::from(depth[c]));
            region.white += if self.least(c) > WHITE { solid_angle } else { 0.0 };
            region.around[0] += around[1][c][1] * solid_angle;
            region.around[1] += around[2][c][1] * solid_angle;
        }
        region.centre = region.centre.try_normalize().unwrap_or(axes(self.up)[2]);
        region.sine[0] /= size;
        region.white /= size;
        region.around = region.around.map(|v| v / size);
        let spread = |&c: &usize| {
            let angle = self.angle(c, region.centre);
            angle * angle * self.clipped[c]
        };
        region.radius = (cells.iter().map(spread).sum::<f64>() / size).sqrt();
        region.size = num::f64::log2(size);
        region.share = size / total;
        region
    }

    fn angle(&self, cell: usize, from: DVec3) -> f64 {
        num::f64::acos(self.grid.direction(self.up, cell).dot(from).clamp(-1.0, 1.0))
    }

    pub fn cell(&self, c: usize, region: &Region, depth: f64, around: &[Vec<Neighbourhood>]) -> [f32; CELL] {
        let mut numbers = Vec::with_capacity(CELL);
        for radius in around {
            numbers.extend(radius[c]);
        }
        // The brightness of the opposite side, which a light would illuminate, and of the floor, which would mirror
        // the light.
        let (width, last) = (self.grid.width, self.grid.height - 1);
        let below = (last - c / width) * width + c % width;
        let opposite = below - c % width + (c % width + width / 2) % width;
        numbers.extend([around[3][opposite][1], around[1][below][1]]);
        let sine = self.sine(c);
        let angle = self.angle(c, region.centre);
        numbers.extend([log2(depth, 1.0), self.least(c), sine, sine * sine, sine.abs()]);
        numbers.extend([depth / region.deepest.max(1e-9), region.size, region.share, sine - region.sine[0]]);
        numbers.extend([(angle / region.radius.max(0.01)).min(3.0), angle, region.sine[1] - sine]);
        numbers.extend([log2(region.deepest, 1.0), log2(region.radius, 1e-3), region.white]);
        numbers.extend([region.sine[2], region.size - 2.0 * log2(region.radius, 1e-2)]);
        numbers.extend(region.around);
        numbers.extend(region.profile);
        std::array::from_fn(|i| numbers.get(i).copied().unwrap_or(0.0) as f32)
    }
}

impl Region {
    /// Features that predict the colour of the light of the region, given the features of the whole panorama.
    pub fn colour(&self, overview: &[f32; OVERVIEW]) -> [f32; COLOUR] {
        let own = self.profile.into_iter().chain([self.size, self.sine[0]]).map(|v| v as f32);
        let numbers: Vec<f32> = own.chain(ABOUT_COLOUR.map(|i| overview[i])).collect();
        std::array::from_fn(|i| numbers.get(i).copied().unwrap_or(0.0))
    }
}
