//! What the network reads: numbers about the whole panorama, and numbers about each clipped cell.

use engine::Up;
use glam::DVec3;

use super::super::grid::Grid;
use super::blur::Fields;
use crate::equirect::axes;
use crate::light::measure::luminance;
use crate::light::regions::{self, Regions};
use crate::num;

/// Numbers about the whole panorama.
pub(in super::super) const OVERVIEW: usize = 40;
/// Numbers about each clipped cell.
pub(in super::super) const CELL: usize = 35;
/// Radii of the neighbourhoods, in columns of a grid of 256: 2.8, 8.4, 22.5 and 63 degrees.
const RADII: [usize; 4] = [2, 6, 16, 45];
/// Cells whose brightest channel is above this count as clipped in all channels.
const WHITE: f64 = 0.95;

/// A panorama as the network sees it.
pub(in super::super) struct Scene {
    /// The numbers about the whole panorama.
    pub overview: [f32; OVERVIEW],
    /// The clipped cells, in order.
    pub cells: Vec<ClippedCell>,
    /// Luminance times solid angle of everything seen and not clipped.
    pub open_flux: f64,
}

/// One clipped cell.
pub(in super::super) struct ClippedCell {
    /// Its index in the grid.
    pub index: usize,
    /// Its region.
    pub region: usize,
    /// The numbers about it.
    pub features: [f32; CELL],
    /// Luminance times solid angle, as clipped.
    pub flux: f64,
}

/// One connected clipped region.
struct Region {
    /// log2 of its solid angle.
    size: f64,
    share: f64,
    /// Sine of elevation: mean, largest, least.
    sine: [f64; 3],
    centre: DVec3,
    /// Root mean square angle from its centre.
    radius: f64,
    deepest: f64,
    white: f64,
    /// Mean of what lies around, near and less near.
    around: [f64; 2],
}

/// Per-cell quantities that everything below reads.
struct View<'a> {
    grid: &'a Grid,
    up: Up,
    /// Of each row.
    solid_angle: Vec<f64>,
    /// Sine of the elevation of each row.
    sine: Vec<f64>,
    rgb: Vec<[f64; 3]>,
    luminance: Vec<f64>,
    /// Solid angle where seen and not clipped, else 0.
    open: Vec<f64>,
}

fn log2(v: f64, least: f64) -> f64 {
    num::f64::log2(v.max(least))
}

impl<'a> View<'a> {
    fn new(grid: &'a Grid, up: Up) -> Self {
        let above = axes(up)[2];
        let row = |y: usize| y * grid.width;
        let solid_angle: Vec<f64> = (0..grid.height).map(|y| grid.solid_angle(row(y))).collect();
        let sine = (0..grid.height).map(|y| grid.direction(up, row(y)).dot(above)).collect();
        let rgb: Vec<[f64; 3]> = grid.rgb.iter().map(|rgb| rgb.map(|v| v.min(1.0))).collect();
        let luminance = rgb.iter().map(|rgb| luminance(*rgb)).collect();
        let open =
            |c: usize| if grid.seen[c] && !grid.clipped[c] { solid_angle[c / grid.width] } else { 0.0 };
        let open = (0..rgb.len()).map(open).collect();
        Self { grid, up, solid_angle, sine, rgb, luminance, open }
    }

    fn cells(&self) -> std::ops::Range<usize> {
        0..self.rgb.len()
    }

    fn sine(&self, cell: usize) -> f64 {
        self.sine[cell / self.grid.width]
    }

    fn solid_angle(&self, cell: usize) -> f64 {
        self.solid_angle[cell / self.grid.width]
    }

    /// Mean of `value` by weight, 0 where there is no weight.
    fn mean(&self, value: impl Fn(usize) -> f64, weight: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for cell in self.cells() {
            let weight = weight(cell);
            sum += weight * value(cell);
            total += weight;
        }
        sum / total.max(1e-9)
    }

    /// Quantiles of `values` by weight; ties in the order of the cells.
    fn quantiles<const N: usize>(
        &self,
        values: &[f64],
        weight: impl Fn(usize) -> f64,
        at: [f64; N],
    ) -> [f64; N] {
        let mut order: Vec<usize> = self.cells().filter(|&cell| weight(cell) > 0.0).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let total: f64 = order.iter().map(|&cell| weight(cell)).sum();
        let (mut sum, mut found, mut next) = (0.0, [0.0; N], 0);
        for &cell in &order {
            sum += weight(cell);
            while next < N && sum >= at[next] * total {
                found[next] = values[cell];
                next += 1;
            }
        }
        found
    }

    /// How steeply log luminance changes, in stops per cell of the horizon.
    fn steepness(&self, log: &[f64]) -> Vec<f64> {
        let (width, height) = (self.grid.width, self.grid.height);
        let steepness = |cell: usize| {
            let (x, y) = (cell % width, cell / width);
            let row = y * width;
            let narrow = (1.0 - self.sine[y] * self.sine[y]).sqrt().max(0.2);
            let across = (log[row + (x + 1) % width] - log[row + (x + width - 1) % width]) / (2.0 * narrow);
            let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
            let steps = (below - above).max(1) as f64;
            let down = (log[below * width + x] - log[above * width + x]) / steps;
            (across * across + down * down).sqrt()
        };
        self.cells().map(steepness).collect()
    }

    /// The numbers about the whole panorama.
    fn overview(&self, sizes: &[f64]) -> [f32; OVERVIEW] {
        let sphere = 4.0 * std::f64::consts::PI;
        let sky = |c: usize| if self.sine(c) > 0.05 { self.open[c] } else { 0.0 };
        let ground = |c: usize| if self.sine(c) < -0.05 { self.open[c] } else { 0.0 };
        let zenith = |c: usize| if self.sine(c) > 0.7 { self.open[c] } else { 0.0 };
        let nadir = |c: usize| if self.sine(c) < -0.5 { self.open[c] } else { 0.0 };
        let horizon = |c: usize| if self.sine(c).abs() < 0.25 { self.open[c] } else { 0.0 };
        let all = |c: usize| self.open[c];
        let brightness = |weight: &dyn Fn(usize) -> f64| log2(self.mean(|c| self.luminance[c], weight), 1e-4);
        let hue = |weight: &dyn Fn(usize) -> f64| {
            log2(self.mean(|c| self.rgb[c][2], weight), 1e-3)
                - log2(self.mean(|c| self.rgb[c][0], weight), 1e-3)
        };
        let log: Vec<f64> = self.luminance.iter().map(|l| log2(*l, 2e-3)).collect();
        let steepness = self.steepness(&log);
        let near = regions::grow(&self.grid.clipped, self.grid.width, 2);
        let away = |weight: f64, c: usize| if near[c] { 0.0 } else { weight };
        let is = |yes: bool| if yes { 1.0 } else { 0.0 };
        let blue = |c: usize| is(self.rgb[c][2] > 1.2 * self.rgb[c][0] && self.luminance[c] > 0.03);
        let clipped = |c: usize| is(self.grid.clipped[c]);
        let flux = |weight: &dyn Fn(usize) -> f64| -> f64 {
            self.cells().map(|c| weight(c) * self.luminance[c]).sum()
        };
        let (open_flux, total) = (flux(&all), sizes.iter().sum::<f64>());
        let mut dipole = DVec3::ZERO;
        for c in self.cells().filter(|&c| self.open[c] > 0.0) {
            dipole += self.grid.direction(self.up, c) * (self.luminance[c] * self.open[c]);
        }
        let dipole = dipole / open_flux.max(1e-6);
        let saturation = |c: usize| {
            let [r, g, b] = self.rgb[c];
            let largest = r.max(g).max(b);
            (largest - r.min(g).min(b)) / largest.max(1e-3)
        };
        let mut numbers = Vec::with_capacity(OVERVIEW);
        numbers.extend([&sky as &dyn Fn(usize) -> f64, &ground, &zenith, &nadir, &horizon].map(brightness));
        numbers.extend([&sky as &dyn Fn(usize) -> f64, &ground, &zenith, &horizon].map(hue));
        numbers.extend(self.quantiles(&log, all, [0.05, 0.25, 0.5, 0.75, 0.95]));
        numbers.extend(self.quantiles(&log, ground, [0.1, 0.5, 0.9]));
        numbers.extend(self.quantiles(&log, sky, [0.1, 0.5, 0.9]));
        numbers.extend(self.quantiles(&steepness, |c| away(ground(c), c), [0.5, 0.9, 0.98]));
        numbers.extend(self.quantiles(&steepness, |c| away(sky(c), c), [0.5, 0.9, 0.98]));
        numbers.push(self.mean(blue, |c| if self.sine(c) > 0.05 { self.solid_angle(c) } else { 0.0 }));
        numbers.push(self.mean(blue, all));
        numbers.push(self.mean(clipped, |c| if self.sine(c) > 0.0 { self.solid_angle(c) } else { 0.0 }));
        numbers.push(self.mean(clipped, |c| if self.sine(c) > 0.0 { 0.0 } else { self.solid_angle(c) }));
        numbers.push(dipole.dot(axes(self.up)[2]));
        numbers.push(dipole.length());
        numbers.push(num::f64::log2(1.0 + sizes.len() as f64));
        numbers.push(sizes.iter().fold(0.0, |a: f64, b| a.max(*b)) / total.max(1e-9));
        numbers.push(self.mean(saturation, all));
        numbers.push(self.mean(|c| is(self.luminance[c] < 0.02), all));
        numbers.push(self.mean(|c| is(self.luminance[c] > 0.5), all));
        numbers.push(log2(total / sphere, 1e-4));
        numbers.push(log2(open_flux / sphere, 1e-4));
        numbers.push(log2(flux(&|c| self.solid_angle(c)) / sphere, 1e-4));
        std::array::from_fn(|i| numbers.get(i).copied().unwrap_or(0.0) as f32)
    }

    /// Neighbourhoods of every cell at each radius: share that is clipped, log2 mean of what is not, its
    /// blue over red in stops, share that is clipped in all channels.
    fn neighbourhoods(&self) -> Vec<Vec<[f64; 4]>> {
        let field = |c: usize| {
            let (all, open, [r, _, b]) = (self.solid_angle(c), self.open[c], self.rgb[c]);
            let white = r.min(self.rgb[c][1]).min(b) > WHITE;
            let clipped = if self.grid.clipped[c] { all } else { 0.0 };
            let white = if white { all } else { 0.0 };
            [clipped, self.luminance[c] * open, r * open, b * open, open, white, all]
        };
        let fields = Fields { width: self.grid.width, values: self.cells().map(field).collect() };
        let describe = |[clipped, light, red, blue, open, white, all]: [f64; 7]| {
            let all = all.max(1e-12);
            let brightness = num::f64::log2((light + 2e-5 * all) / (open + 1e-3 * all) + 1e-3);
            let hue = num::f64::log2((blue + 1e-5 * all) / (red + 1e-5 * all)).clamp(-3.0, 3.0);
            [clipped / all, brightness, hue, white / all]
        };
        RADII
            .iter()
            .map(|radius| {
                let blurred = fields.blurred((radius * self.grid.width / 256).max(1));
                blurred.values.into_iter().map(describe).collect()
            })
            .collect()
    }

    fn region(&self, cells: &[usize], total: f64, depth: &[f32], around: &[Vec<[f64; 4]>]) -> Region {
        let mut region = Region {
            size: 0.0,
            share: 0.0,
            sine: [0.0, -1.0, 1.0],
            centre: DVec3::ZERO,
            radius: 0.0,
            deepest: 0.0,
            white: 0.0,
            around: [0.0; 2],
        };
        let mut size = 0.0;
        for &c in cells {
            let (solid_angle, sine, [r, g, b]) = (self.solid_angle(c), self.sine(c), self.rgb[c]);
            size += solid_angle;
            region.sine =
                [region.sine[0] + sine * solid_angle, region.sine[1].max(sine), region.sine[2].min(sine)];
            region.centre += self.grid.direction(self.up, c) * solid_angle;
            region.deepest = region.deepest.max(f64::from(depth[c]));
            region.white += if r.min(g).min(b) > WHITE { solid_angle } else { 0.0 };
            region.around[0] += around[1][c][1] * solid_angle;
            region.around[1] += around[2][c][1] * solid_angle;
        }
        region.centre = region.centre.try_normalize().unwrap_or(axes(self.up)[2]);
        region.sine[0] /= size;
        region.white /= size;
        region.around = region.around.map(|v| v / size);
        let spread = |&c: &usize| {
            let angle = self.angle(c, region.centre);
            angle * angle * self.solid_angle(c)
        };
        region.radius = (cells.iter().map(spread).sum::<f64>() / size).sqrt();
        region.size = num::f64::log2(size);
        region.share = size / total;
        region
    }

    fn angle(&self, cell: usize, from: DVec3) -> f64 {
        num::f64::acos(self.grid.direction(self.up, cell).dot(from).clamp(-1.0, 1.0))
    }

    fn cell(&self, c: usize, region: &Region, depth: f64, around: &[Vec<[f64; 4]>]) -> [f32; CELL] {
        let mut numbers = Vec::with_capacity(CELL);
        for radius in around {
            numbers.extend(radius[c]);
        }
        let (sine, [r, g, b]) = (self.sine(c), self.rgb[c]);
        let angle = self.angle(c, region.centre);
        numbers.extend([log2(depth, 1.0), r.min(g).min(b), sine, sine * sine, sine.abs()]);
        numbers.extend([depth / region.deepest.max(1e-9), region.size, region.share, sine - region.sine[0]]);
        numbers.extend([(angle / region.radius.max(0.01)).min(3.0), angle, region.sine[1] - sine]);
        numbers.extend([log2(region.deepest, 1.0), log2(region.radius, 1e-3), region.white]);
        numbers.extend([region.sine[2], region.size - 2.0 * log2(region.radius, 1e-2)]);
        numbers.extend(region.around);
        std::array::from_fn(|i| numbers.get(i).copied().unwrap_or(0.0) as f32)
    }
}

impl Scene {
    /// Describes a panorama whose clipped regions are `labels`.
    pub(in super::super) fn new(grid: &Grid, up: Up, labels: &Regions) -> Self {
        let view = View::new(grid, up);
        let mut members = vec![Vec::new(); labels.count];
        for (cell, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                members[*region as usize].push(cell);
            }
        }
        let sizes: Vec<f64> = members.iter().map(|m| m.iter().map(|&c| view.solid_angle(c)).sum()).collect();
        let total = sizes.iter().sum();
        let around = view.neighbourhoods();
        let depth = regions::distance_to_edge(&grid.clipped, grid.width);
        let regions: Vec<Region> =
            members.iter().map(|cells| view.region(cells, total, &depth, &around)).collect();
        let cell = |(index, region): (usize, &Option<u32>)| {
            let region = (*region)? as usize;
            let features = view.cell(index, &regions[region], f64::from(depth[index]), &around);
            let flux = view.luminance[index] * view.solid_angle(index);
            Some(ClippedCell { index, region, features, flux })
        };
        Self {
            overview: view.overview(&sizes),
            cells: labels.of.iter().enumerate().filter_map(cell).collect(),
            open_flux: view.cells().map(|c| view.luminance[c] * view.open[c]).sum(),
        }
    }
}
