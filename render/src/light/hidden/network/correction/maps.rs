//! Input of the correction: maps of what is visible, and of what is clipped.

use std::f64::consts::PI;

use glam::DVec3;
use scene::math::num;

use super::super::features::{GridQuantities, WHITE};
use super::layers::Map;

/// Number of columns and rows of the maps.
const WIDTH: usize = 64;
const HEIGHT: usize = 32;
/// Number of maps.
pub const CHANNELS: usize = 14;
/// Columns and rows of the map of irradiance, which is interpolated.
const COARSE: [usize; 2] = [32, 16];
/// Term added to radiances before their logarithm is taken.
const BLACK: f64 = 1e-3;
/// Term added to irradiances over pi before their logarithm is taken.
const DARK: f64 = 1e-4;

/// Maps of a panorama with [`CHANNELS`] channels.
pub struct Maps {
    map: Map,
    /// Column of the grid at which the maps begin, and numbers of columns and rows of the grid.
    start: usize,
    grid: [usize; 2],
}

/// Sums over the part of the grid in one cell of the maps of twice the size.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Solid angle of the visible unclipped part, and light times this solid angle.
    open: f64,
    open_rgb: [f64; 3],
    /// Solid angle of the clipped part, of that clipped in all channels, and of that clipped in red and in blue.
    clipped: f64,
    white: f64,
    clipped_red: f64,
    clipped_blue: f64,
    /// Luminance times solid angle of the visible part.
    light: f64,
}

impl Maps {
    /// Computes the maps. They begin at the azimuth of the light's first harmonic, so a rotated or mirrored panorama has
    /// the same maps, rotated or mirrored.
    pub fn new(view: &GridQuantities<'_>) -> Self {
        let (columns, rows) = (view.grid.width, view.grid.height);
        let (width, height) = (2 * WIDTH, 2 * HEIGHT);
        let start = start(view);
        let mut sums = vec![Sums::default(); width * height];
        for y in 0..height {
            for x in 0..width {
                for row in covered(y, height, rows) {
                    for column in covered(x, width, columns) {
                        let cell = row * columns + (column + start) % columns;
                        sums[y * width + x].add(view, cell);
                    }
                }
            }
        }
        let irradiance = irradiance(&sums);
        let above: f64 =
            sums.iter().enumerate().map(|(at, sums)| sums.light * sine(at / width, height).max(0.0)).sum();
        let above = num::f64::log2(above / PI + DARK);
        let mut values = Vec::with_capacity(width * height * CHANNELS);
        for (at, sums) in sums.iter().enumerate() {
            let of = sums.channels(at / width, irradiance[at], above);
            values.extend(of.map(|v| v as f32));
        }
        let map = Map { width, height, channels: CHANNELS, values }.halved();
        Self { map, start, grid: [columns, rows] }
    }

    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Index of the cell of the maps that contains the cell `at` of the grid.
    pub fn place(&self, at: usize) -> usize {
        let [columns, rows] = self.grid;
        let (x, y) = ((at % columns + columns - self.start) % columns, at / columns);
        (2 * y + 1) * HEIGHT / (2 * rows) * WIDTH + (2 * x + 1) * WIDTH / (2 * columns)
    }

    /// The maps of the mirrored panorama.
    pub fn mirrored(&self) -> Self {
        let mut map = self.map.clone();
        for row in map.values.chunks_exact_mut(WIDTH * CHANNELS) {
            let cells: Vec<f32> = row.chunks_exact(CHANNELS).rev().flatten().copied().collect();
            row.copy_from_slice(&cells);
        }
        Self { map, ..*self }
    }

    /// Index of a cell of the maps in the mirrored maps.
    pub fn mirror(at: usize) -> usize {
        at - at % WIDTH + WIDTH - 1 - at % WIDTH
    }
}

impl Sums {
    fn add(&mut self, view: &GridQuantities<'_>, cell: usize) {
        let (open, clipped) = (view.open[cell], view.clipped[cell]);
        self.open += open;
        for (sum, v) in self.open_rgb.iter_mut().zip(view.open_rgb[cell]) {
            *sum += v * open;
        }
        self.clipped += clipped;
        self.white += if view.least(cell) > WHITE { clipped } else { 0.0 };
        self.clipped_red += if view.clipped_rgb[cell][0] > WHITE { clipped } else { 0.0 };
        self.clipped_blue += if view.clipped_rgb[cell][2] > WHITE { clipped } else { 0.0 };
        self.light += view.luminance[cell] * (open + clipped);
    }

    /// The channels of a cell of row `y`. `irradiance` is log2 of the irradiance over pi of a surface that faces back
    /// from there, and `above` that of a surface that faces up.
    fn channels(&self, y: usize, irradiance: f64, above: f64) -> [f64; CHANNELS] {
        let size = solid_angle(y, 2 * WIDTH, 2 * HEIGHT);
        let [r, g, b] = self.open_rgb.map(|v| v / self.open.max(1e-12));
        let is_open = if self.open > 0.0 { 1.0 } else { 0.0 };
        let radiance = num::f64::log2(crate::light::measure::luminance([r, g, b]) + BLACK);
        let hue = |v: f64| is_open * num::f64::log2((v + BLACK) / (g + BLACK)).clamp(-3.0, 3.0);
        let sine = sine(y, 2 * HEIGHT);
        [
            is_open * (radiance / 3.0 + 1.0),
            is_open * (radiance - irradiance) / 2.0,
            is_open * (radiance - above) / 2.0,
            hue(r),
            hue(b),
            self.clipped / size,
            self.white / size,
            self.clipped_red / size,
            self.clipped_blue / size,
            self.open / size,
            sine,
            sine.abs(),
            irradiance / 2.0,
            above / 2.0,
        ]
    }
}

/// Column of the grid that is nearest to the azimuth of the first harmonic of the visible light.
fn start(view: &GridQuantities<'_>) -> usize {
    let columns = view.grid.width;
    let mut sums = vec![0.0_f64; columns];
    for cell in view.cells() {
        sums[cell % columns] += view.luminance[cell] * (view.open[cell] + view.clipped[cell]);
    }
    let angle = |column: usize| 2.0 * PI * (column as f64 + 0.5) / columns as f64;
    let (mut x, mut y) = (0.0, 0.0);
    for (column, sum) in sums.into_iter().enumerate() {
        let (sin, cos) = num::sin_cos(angle(column));
        (x, y) = (x + sum * cos, y + sum * sin);
    }
    let turn = num::atan2(y, x) / (2.0 * PI) * columns as f64;
    (turn + columns as f64).round() as usize % columns
}

/// Indices of the `from` divisions of an axis that lie in division `at` of `of`; the nearest one if `from` is less than
/// `of`.
fn covered(at: usize, of: usize, from: usize) -> std::ops::Range<usize> {
    let first = at * from / of;
    first..((at + 1) * from / of).max(first + 1)
}

/// Solid angle of a cell of row `y`, in steradians.
fn solid_angle(y: usize, width: usize, height: usize) -> f64 {
    let edge = |y: usize| num::f64::cos(PI * y as f64 / height as f64);
    (edge(y) - edge(y + 1)) * 2.0 * PI / width as f64
}

/// Mean sine of the elevation of row `y`: of its two halves, as in training.
fn sine(y: usize, height: usize) -> f64 {
    let of = |part: f64| num::f64::cos(PI * (y as f64 + part) / height as f64);
    0.5 * (of(0.25) + of(0.75))
}

/// log2 of the irradiance over pi, for each cell, of a surface that is seen in its direction and faces the viewer. It
/// is computed for [`COARSE`] directions and interpolated.
fn irradiance(fine: &[Sums]) -> Vec<f64> {
    let (width, height) = (2 * WIDTH, 2 * HEIGHT);
    let [columns, rows] = COARSE;
    let (across, down) = (width / columns, height / rows);
    let mut light = vec![(0.0, 0.0); columns * rows];
    let mut directions = vec![DVec3::ZERO; columns * rows];
    for (at, sums) in fine.iter().enumerate() {
        let (x, y) = (at % width, at / width);
        let coarse = y / down * columns + x / across;
        light[coarse].0 += sums.light;
        light[coarse].1 += sums.open + sums.clipped;
        let (sin, cos) = num::sin_cos(PI * (y as f64 + 0.5) / height as f64);
        let (east, north) = num::sin_cos(2.0 * PI * (x as f64 + 0.5) / width as f64);
        directions[coarse] += DVec3::new(sin * north, sin * east, cos) * solid_angle(y, width, height);
    }
    let directions: Vec<DVec3> = directions.into_iter().map(DVec3::normalize).collect();
    let flux: Vec<f64> = light
        .into_iter()
        .enumerate()
        .map(|(at, (light, seen))| {
            let size = solid_angle(at / columns, columns, rows);
            if seen > 0.01 * size { light / seen.max(1e-6) * size } else { 0.0 }
        })
        .collect();
    let received = |at: usize| -> f64 {
        let each = directions.iter().zip(&flux).map(|(d, flux)| (-directions[at].dot(*d)).max(0.0) * flux);
        num::f64::log2(each.sum::<f64>() / PI + DARK)
    };
    let coarse: Vec<f64> = (0..columns * rows).map(received).collect();
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        let v = ((y as f64 + 0.5) / down as f64 - 0.5).clamp(0.0, (rows - 1) as f64);
        let (top, low) = (v.floor() as usize, v - v.floor());
        for x in 0..width {
            let u = (x as f64 + 0.5) / across as f64 - 0.5 + columns as f64;
            let (left, right) = (u.floor() as usize, u - u.floor());
            let row = |y: usize| {
                let at = |x: usize| coarse[y.min(rows - 1) * columns + x % columns];
                at(left) * (1.0 - right) + at(left + 1) * right
            };
            out.push(row(top) * (1.0 - low) + row(top + 1) * low);
        }
    }
    out
}
