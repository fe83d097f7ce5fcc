//! Features of the whole panorama: visible surfaces compared with the visible light that falls on them.
//!
//! A surface of albedo a that reflects the radiance L receives the irradiance pi L / a. If this is more than the
//! visible light provides, some light is hidden. So the ground is compared with the light from above, and walls
//! with the light from the opposite side.

use crate::light::regions;
use glam::DVec3;
use scene::math::equirect::axes;
use scene::math::num;

use super::features::{GridQuantities, OVERVIEW, WHITE, log2};

/// Lower bound for shares, brightnesses and solid angles (in steradians). Smaller values are raised to it.
const LEAST: f64 = 1e-4;
/// Lower bound of the luminance of a cell.
const BLACK: f64 = 2e-3;
/// Luminance below which a cell is dark.
const DARK: f64 = 0.02;
/// Sine of the elevation above which cells are sky. Cells below its negative are ground.
const HORIZON: f64 = 0.05;
/// Sine of the elevation below which ground cells are near the viewer.
const NEAR: f64 = -0.3;
/// Largest absolute sine of the elevation of cells that can be walls.
const WALL: f64 = 0.4;
/// Half the width of the neighbourhood over which walls are evaluated, in columns, for a grid 256 columns wide.
const REACH: usize = 8;
/// Minimum unclipped share of a neighbourhood over which walls are evaluated.
const OPEN: f64 = 0.06;

impl GridQuantities<'_> {
    /// Computes the features, given the cells of each region and their solid angles.
    pub fn overview(&self, members: &[Vec<usize>], sizes: &[f64]) -> [f32; OVERVIEW] {
        let sphere = 4.0 * std::f64::consts::PI;
        let grid = self.grid;
        let is = |yes: bool| if yes { 1.0 } else { 0.0 };
        let light = |c: usize| self.luminance[c];
        let seen = |c: usize| is(grid.seen[c]) * self.solid_angle(c);
        let all = |c: usize| self.open[c];
        let sky = |c: usize| is(self.sine(c) > HORIZON) * self.open[c];
        let ground = |c: usize| is(self.sine(c) < -HORIZON) * self.open[c];
        let near = |c: usize| is(self.sine(c) < NEAR) * self.open[c];
        // Mean radiance weighted by cosine: irradiance over pi, of planes that face up and down.
        let above = |c: usize| seen(c) * self.sine(c).max(0.0);
        let below = |c: usize| seen(c) * (-self.sine(c)).max(0.0);
        let from_above = log2(self.mean(light, above), LEAST);
        // Without unclipped cells, the brightness is white.
        let brightness = |weight: &dyn Fn(usize) -> f64| {
            let light = |c: usize| self.open_luminance[c];
            if self.cells().any(|c| weight(c) > 0.0) { log2(self.mean(light, weight), LEAST) } else { 0.0 }
        };
        let hue = |weight: &dyn Fn(usize) -> f64| {
            let sum =
                |channel: usize| self.cells().map(|c| weight(c) * self.open_rgb[c][channel]).sum::<f64>();
            num::f64::log2(sum(2) + 1e-5) - num::f64::log2(sum(0) + 1e-5)
        };
        let (inner, outer) =
            (regions::grow(&grid.clipped, grid.width, 2), regions::grow(&grid.clipped, grid.width, 6));
        let ring = |c: usize| is(outer[c] && !inner[c]) * self.open[c];
        let on_ground: Vec<f64> = self.open_luminance.iter().map(|l| log2(*l, BLACK) - from_above).collect();
        let sum = |light: &[f64], weight: &dyn Fn(usize) -> f64| -> f64 {
            light.iter().enumerate().map(|(c, light)| weight(c) * light).sum()
        };
        let bright = |weight: &dyn Fn(usize) -> f64| sum(&self.luminance, weight);
        let bright_clipped = |weight: &dyn Fn(usize) -> f64| sum(&self.clipped_luminance, weight);
        let share = |part: f64, of: f64| log2(part / of.max(1e-9), 1e-3);
        let size = |upper: bool| -> f64 {
            self.cells().filter(|&c| (self.sine(c) > 0.0) == upper).map(|c| self.clipped[c]).sum()
        };
        let mut dipole = DVec3::ZERO;
        for c in self.cells().filter(|&c| self.open[c] > 0.0) {
            dipole += grid.direction(self.up, c) * (self.open_luminance[c] * self.open[c]);
        }
        let open_flux = sum(&self.open_luminance, &all);
        let dipole = dipole / open_flux.max(1e-6);
        let upward = axes(self.up)[2];

        let mut numbers = vec![from_above, log2(self.mean(light, below), LEAST)];
        numbers.extend(self.quantiles(&on_ground, near, [0.05, 0.25, 0.5, 0.75, 0.95]));
        numbers.push(share(bright_clipped(&|c| grid.share[c] * above(c)), bright(&above)));
        numbers.push(share(bright_clipped(&|c| self.clipped[c]), bright(&seen)));
        numbers.push(self.walls());
        numbers.push(brightness(&sky));
        numbers.extend(
            [size(true), size(false), sizes.iter().copied().fold(0.0, f64::max)].map(|v| log2(v, LEAST)),
        );
        // A region that fills part of a cell counts by that part, so that glints do not count as many lamps.
        let filled = |cells: &Vec<usize>| cells.iter().map(|&c| grid.share[c]).sum::<f64>().min(1.0);
        numbers.push(num::f64::log2(1.0 + members.iter().map(filled).sum::<f64>()));
        numbers.extend([&sky as &dyn Fn(usize) -> f64, &ground, &ring].map(hue));
        numbers.push(dipole.dot(upward));
        numbers.push((dipole - upward * dipole.dot(upward)).length());
        numbers.push(log2(open_flux / sphere, LEAST));
        numbers.push(
            self.cells().map(|c| is(self.open_luminance[c] < DARK) * self.open[c]).sum::<f64>() / sphere,
        );
        // The share of the clipped part that is clipped in all channels.
        let white = |c: usize| is(self.least(c) > WHITE) * self.clipped[c];
        let (white, clipped) = (self.cells().map(white).sum::<f64>(), self.clipped.iter().sum::<f64>());
        numbers.push(white / f64::max(clipped, 1e-9));
        std::array::from_fn(|i| numbers.get(i).copied().unwrap_or(0.0) as f32)
    }

    /// Weighted mean of `value`; 0 if all weights are 0.
    fn mean(&self, value: impl Fn(usize) -> f64, weight: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for cell in self.cells() {
            let weight = weight(cell);
            sum += weight * value(cell);
            total += weight;
        }
        sum / total.max(1e-9)
    }

    /// Weighted quantiles of `values`; 0 if all weights are 0. Equal values are taken in the order of the cells.
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

    /// Brightness of walls relative to the visible light that falls on them from the opposite side, in stops:
    /// the mean over all azimuths at which walls are visible.
    fn walls(&self) -> f64 {
        let width = self.grid.width;
        // For each column: unclipped light and solid angle near the horizon, the whole solid angle there, and light
        // and solid angle that a wall on the opposite side receives, weighted by the cosine of elevation.
        let mut columns = vec![[0.0; 5]; width];
        for c in self.cells() {
            let (size, sine, column) = (self.solid_angle(c), self.sine(c), &mut columns[c % width]);
            if sine.abs() < WALL {
                column[0] += self.open_luminance[c] * self.open[c];
                column[1] += self.open[c];
                column[2] += size;
            }
            if self.grid.seen[c] {
                let facing = size * (1.0 - sine * sine).max(0.0).sqrt();
                column[3] += self.luminance[c] * facing;
                column[4] += facing;
            }
        }
        let cosine: Vec<f64> =
            (0..width).map(|x| num::f64::cos(std::f64::consts::TAU * x as f64 / width as f64)).collect();
        let reach = REACH * width / 256;
        let (mut sum, mut count) = (0.0, 0.0);
        for x in 0..width {
            let (mut wall, mut shone) = ([0.0; 3], [0.0; 2]);
            for column in 0..=2 * reach {
                let column = &columns[(x + width + column - reach) % width];
                wall.iter_mut().zip(column).for_each(|(sum, v)| *sum += v);
            }
            for (column, values) in columns.iter().enumerate() {
                let facing = (-cosine[(column + width - x) % width]).max(0.0);
                shone.iter_mut().zip(&values[3..]).for_each(|(sum, v)| *sum += facing * v);
            }
            if wall[1] > OPEN * wall[2] {
                sum += log2(wall[0] / wall[1], LEAST) - log2(shone[0] / shone[1].max(1e-9), LEAST);
                count += 1.0;
            }
        }
        sum / f64::max(count, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::input::Scene;
    use super::*;
    use crate::light::hidden::grid::Grid;
    use engine::Up;

    /// Features of a grey world of brightness `above` above the horizon and `below` below it, with one clipped
    /// cell.
    fn numbers(above: f64, below: f64) -> [f32; OVERVIEW] {
        let (width, height) = (64, 32);
        let cells = width * height;
        let grey = |c: usize| if c < cells / 2 { above } else { below };
        let rgb: Vec<[f64; 3]> = (0..cells).map(|c| [grey(c); 3]).collect();
        let mut grid = Grid {
            width,
            height,
            open_rgb: rgb.clone(),
            rgb,
            clipped_rgb: vec![[0.0; 3]; cells],
            clipped: vec![false; cells],
            share: vec![0.0; cells],
            seen: vec![true; cells],
            cell_of: Vec::new(),
            start: (0, width),
        };
        let lamp = 5 * width + 3;
        (grid.rgb[lamp], grid.clipped[lamp]) = ([1.0; 3], true);
        (grid.open_rgb[lamp], grid.clipped_rgb[lamp], grid.share[lamp]) = ([0.0; 3], [1.0; 3], 1.0);
        Scene::new(&grid, Up::PlusZ, &regions::label(&grid.clipped, width), 1.0).overview
    }

    // In a white furnace every surface is as bright as its illumination; a ground that reflects a quarter is two
    // stops darker. This test fails without `- from_above`.
    #[test]
    fn surfaces_are_judged_against_what_shines_on_them() {
        let furnace = numbers(0.25, 0.25);
        assert!((furnace[0] + 2.0).abs() < 0.02 && (furnace[1] + 2.0).abs() < 1e-3, "{furnace:?}");
        assert!(furnace[2..7].iter().all(|v| v.abs() < 0.02), "{furnace:?}");
        assert!(furnace[9].abs() < 0.01, "walls: {furnace:?}");
        let ground = numbers(0.4, 0.1);
        assert!(ground[2..7].iter().all(|v| (v + 2.0).abs() < 0.02), "{ground:?}");
        assert!((ground[1] - num::f32::log2(0.1)).abs() < 1e-3);
        // All clipped cells are above the horizon, in one region.
        assert!(furnace[13] == furnace[11] && furnace[14] == 1.0, "{furnace:?}");
    }
}
