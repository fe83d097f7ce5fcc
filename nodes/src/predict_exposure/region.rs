//! The regression by region: one gain for each connected clipped region, spread by a fixed profile.

use engine::{Context, NodeError, Up};
use glam::DVec3;

use crate::color::luminance;
use crate::equirect::{direction, pixel_solid_angle};
use crate::light::linear::LinearPixels;
use crate::light::{measure, regions};
use crate::num;

/// Width of the grid the regression was fitted on; a finer panorama is judged on this grid.
const WORK_WIDTH: usize = 256;
/// Cells around a region that count as its surroundings.
const RING: usize = 3;

/// Mean and spread of each feature, and its weight, in the order of [`features`]. Ridge regression of
/// log2 mean gain on 4123 regions of 28 HDR panoramas at 5 exposures each, 256x128: fitted by
/// `eval_pano.py` (`Classical.fit`) of the evidence for this task, stored there as `classical.json`.
const MEAN: [f64; 9] = [0.0, -7.542, 6.265, 0.229, 0.357, 0.993, 0.619, 0.032, 0.232];
const SPREAD: [f64; 9] = [1.0, 2.404, 3.169, 0.534, 0.151, 0.032, 1.193, 0.118, 0.092];
const WEIGHT: [f64; 9] = [1.012, 0.411, -0.149, 0.362, -0.269, -0.008, -0.235, -0.064, 0.082];
/// Gains are kept in this range of stops, as in the fit.
const STOPS: (f64, f64) = (0.0, 14.0);
/// The gain within a region grows as (distance to the edge / largest distance)^4, as in the fit.
const PROFILE_POWER: i32 = 4;
/// A grid cell is clipped when any pixel in it is, so that a sun smaller than a cell is found. The
/// light of a region is at most that of so many times the area of its clipped pixels.
const LARGEST_DILUTION: f64 = 16.0;

/// A clear sky's sun: a compact region above the horizon (sine of elevation) and smaller than this (log2
/// sr) that holds at least this share of all that is clipped, amid a ring at least as blue as red. The
/// regression, made mostly of windows and glints, is too timid there.
const SUN: SunRule = SunRule { log2_solid_angle: -2.5, sine: 0.03, share: 0.35, flux: 0.5 };

/// When a region is taken for the sun, and the least it then gives.
struct SunRule {
    log2_solid_angle: f64,
    sine: f64,
    share: f64,
    /// Of the flux of everything unclipped. A physical sun gives about 1.7 times as much; over the 74
    /// panoramas of hdri-train, cross-validated by place, half lowers the mean error from 0.95 to 0.93
    /// stops of irradiance and from 2.20 to 2.09 of contrast, where once or more than once does no better.
    /// The thresholds and this number were chosen on those panoramas, so that is no test on unseen ones.
    flux: f64,
}

/// What was found about one region.
pub(super) struct Found {
    pub sun: bool,
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    pub solid_angle: f64,
    pub mean_log2_gain: f64,
    pub peak_log2_gain: f64,
}

/// The panorama averaged over the cells of the grid of the fit.
struct Grid {
    width: usize,
    height: usize,
    rgb: Vec<[f64; 3]>,
    clipped: Vec<bool>,
    seen: Vec<bool>,
    cell_of: Vec<u32>,
}

impl Grid {
    fn new(pixels: &LinearPixels, mask: &[bool], alpha: &[f32]) -> Self {
        let (w, h) = (pixels.width, pixels.height);
        let (width, height) = (WORK_WIDTH.min(w), (WORK_WIDTH / 2).min(h));
        let n = width * height;
        let (mut sums, mut rgb) = (vec![0.0; n], vec![[0.0; 3]; n]);
        let (mut clipped, mut seen) = (vec![false; n], vec![false; n]);
        let mut cell_of = Vec::with_capacity(w * h);
        for y in 0..h {
            let solid_angle = pixel_solid_angle(w, h, y);
            for x in 0..w {
                let at = y * w + x;
                let cell = (2 * y + 1) * height / (2 * h) * width + (2 * x + 1) * width / (2 * w);
                cell_of.push(cell as u32);
                sums[cell] += solid_angle;
                for (sum, value) in rgb[cell].iter_mut().zip(pixels.rgb[at]) {
                    *sum += solid_angle * f64::from(value);
                }
                clipped[cell] |= mask[at];
                seen[cell] |= alpha[at] >= super::SEEN;
            }
        }
        for (rgb, sum) in rgb.iter_mut().zip(&sums) {
            *rgb = rgb.map(|v| v / sum.max(f64::MIN_POSITIVE));
        }
        Self { width, height, rgb, clipped, seen, cell_of }
    }

    fn direction(&self, up: Up, cell: usize) -> DVec3 {
        let (x, y) = ((cell % self.width) as f64 + 0.5, (cell / self.width) as f64 + 0.5);
        direction(up, x / self.width as f64, y / self.height as f64)
    }

    fn solid_angle(&self, cell: usize) -> f64 {
        pixel_solid_angle(self.width, self.height, cell / self.width)
    }

    fn mean_of(&self, cells: impl Iterator<Item = usize>) -> f64 {
        let (mut sum, mut n) = (0.0, 0.0);
        for cell in cells {
            sum += self.rgb[cell].iter().sum::<f64>();
            n += 3.0;
        }
        // Half of white where there is nothing to average, as in the fit.
        if n > 0.0 { sum / n } else { 0.5 }
    }
}

/// The log2 gain of every pixel, 0 outside of clipped regions, and the regions.
pub(super) fn predict(
    up: Up,
    pixels: &LinearPixels,
    mask: &[bool],
    alpha: &[f32],
    cx: &Context,
) -> Result<(Vec<f32>, Vec<Found>), NodeError> {
    let grid = Grid::new(pixels, mask, alpha);
    let labels = regions::label(&grid.clipped, grid.width);
    let mut members = vec![Vec::new(); labels.count];
    for (cell, region) in labels.of.iter().enumerate() {
        if let Some(region) = region {
            members[*region as usize].push(cell);
        }
    }
    let total: f64 = (0..grid.clipped.len()).filter(|&c| grid.clipped[c]).map(|c| grid.solid_angle(c)).sum();
    let rest = grid.mean_of((0..grid.clipped.len()).filter(|&c| !grid.clipped[c] && grid.seen[c]));
    cx.progress(0.2);
    let regression = cx.for_each_tile(labels.count, |i| {
        let (weights, blue) = features(&grid, up, &members[i], total, rest);
        let z = |k: usize| (weights[k] - MEAN[k]) / SPREAD[k] * WEIGHT[k];
        let stops = (0..9).map(z).sum::<f64>().clamp(STOPS.0, STOPS.1);
        let [_, log2_solid_angle, _, sine, .., share, _] = weights;
        let compact = log2_solid_angle < SUN.log2_solid_angle && share > SUN.share;
        (stops, compact && sine > SUN.sine && blue)
    })?;
    cx.progress(0.5);
    let spread = Spread::new(pixels, mask, &grid, &labels, cx)?;
    let unclipped: f64 = (0..grid.clipped.len())
        .filter(|&cell| !grid.clipped[cell] && grid.seen[cell])
        .map(|cell| f64::from(luminance(grid.rgb[cell].map(|v| v as f32))) * grid.solid_angle(cell))
        .sum();
    let stops: Vec<f64> = regression
        .iter()
        .zip(&spread.base_flux)
        .map(|(&(stops, sun), &flux)| {
            let least = if sun && flux > 0.0 { num::f64::log2(SUN.flux * unclipped / flux) } else { 0.0 };
            stops.max(least).clamp(STOPS.0, STOPS.1)
        })
        .collect();
    let mut found = Vec::with_capacity(labels.count);
    let mut log2_gain = vec![0.0_f32; mask.len()];
    for (i, cells) in members.iter().enumerate() {
        let peak = spread.apply(i, stops[i], pixels, &mut log2_gain);
        let centre = cells.iter().fold(DVec3::ZERO, |s, &c| s + grid.direction(up, c) * grid.solid_angle(c));
        let (azimuth_deg, elevation_deg) =
            measure::angles_deg(up, centre.try_normalize().unwrap_or(DVec3::Z));
        let solid_angle = spread.solid_angle[i];
        found.push(Found {
            sun: regression[i].1,
            azimuth_deg,
            elevation_deg,
            solid_angle,
            mean_log2_gain: stops[i],
            peak_log2_gain: peak,
        });
    }
    Ok((log2_gain, found))
}

/// The nine numbers of a region: 1, log2 solid angle, a tenth of its square, mean sine of elevation,
/// mean brightness of its ring, length of the mean direction (1 when compact), log2 of all clipped
/// solid angle, share of it, and the mean of everything unclipped. And whether the ring is at least as
/// blue as it is red.
fn features(grid: &Grid, up: Up, cells: &[usize], total: f64, rest: f64) -> ([f64; 9], bool) {
    let above = crate::equirect::axes(up)[2];
    let (mut size, mut sine, mut sum) = (0.0, 0.0, DVec3::ZERO);
    let mut own = vec![false; grid.clipped.len()];
    for &cell in cells {
        let (d, solid_angle) = (grid.direction(up, cell), grid.solid_angle(cell));
        size += solid_angle;
        sine += d.dot(above) * solid_angle;
        sum += d;
        own[cell] = true;
    }
    let grown = regions::grow(&own, grid.width, RING);
    let around = || (0..own.len()).filter(|&c| grown[c] && !grid.clipped[c] && grid.seen[c]);
    let ring = grid.mean_of(around());
    let blue = around().map(|cell| grid.rgb[cell][2] - grid.rgb[cell][0]).sum::<f64>() >= 0.0;
    let log = num::f64::log2(size);
    let compact = sum.length() / cells.len() as f64;
    let share = size / total;
    let features =
        [1.0, log, log * log / 10.0, sine / size, ring, compact, num::f64::log2(total), share, rest];
    (features, blue)
}

/// How the light of each region is spread over its pixels.
struct Spread {
    /// Per region: clipped pixels and their profile times solid angle.
    pixels: Vec<Vec<(u32, f64, f64)>>,
    /// Solid angle of the clipped pixels.
    solid_angle: Vec<f64>,
    /// Luminance times solid angle that the gain of the region acts on.
    base_flux: Vec<f64>,
}

impl Spread {
    fn new(
        image: &LinearPixels,
        mask: &[bool],
        grid: &Grid,
        labels: &regions::Regions,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        cx.check()?;
        let distance = regions::distance_to_edge(mask, image.width);
        cx.check()?;
        let region = |at: usize| labels.of[grid.cell_of[at] as usize].map(|region| region as usize);
        let mut farthest = vec![0.0_f64; labels.count];
        for at in (0..mask.len()).filter(|&at| mask[at]) {
            if let Some(i) = region(at) {
                farthest[i] = farthest[i].max(f64::from(distance[at]));
            }
        }
        let mut pixels = vec![Vec::new(); labels.count];
        let (mut solid_angle, mut flux) = (vec![0.0; labels.count], vec![0.0; labels.count]);
        for y in 0..image.height {
            let size = pixel_solid_angle(image.width, image.height, y);
            for at in (y * image.width..(y + 1) * image.width).filter(|&at| mask[at]) {
                let Some(i) = region(at) else { continue };
                let near = f64::from(distance[at]) / farthest[i];
                let profile = (0..PROFILE_POWER).fold(1.0, |p, _| p * near);
                pixels[i].push((at as u32, profile, size));
                solid_angle[i] += size;
                flux[i] += size * f64::from(luminance(image.rgb[at]));
            }
        }
        let mut cells_size = vec![0.0; labels.count];
        for (cell, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                cells_size[*region as usize] += grid.solid_angle(cell);
            }
        }
        // The fit took whole cells for clipped, so its gain acts on the area of the cells.
        let base_flux = (0..labels.count)
            .map(|i| flux[i] * (cells_size[i] / solid_angle[i]).clamp(1.0, LARGEST_DILUTION))
            .collect();
        Ok(Self { pixels, solid_angle, base_flux })
    }

    /// Writes the log2 gain of each pixel of region `i`, so that together they add
    /// (2^stops - 1) x base flux; gives the largest.
    fn apply(&self, i: usize, stops: f64, image: &LinearPixels, log2_gain: &mut [f32]) -> f64 {
        let excess = (num::f64::exp2(stops) - 1.0) * self.base_flux[i];
        let light = |at: u32| f64::from(luminance(image.rgb[at as usize]));
        let weight: f64 = self.pixels[i].iter().map(|&(at, profile, size)| profile * size * light(at)).sum();
        let scale = if weight > 0.0 { excess / weight } else { 0.0 };
        let mut peak = 0.0_f64;
        for &(at, profile, _) in &self.pixels[i] {
            let log = num::f64::log2(1.0 + scale * profile);
            peak = peak.max(log);
            log2_gain[at as usize] = log as f32;
        }
        peak
    }
}
