//! Clipped regions, and the estimate for each of them.

use crate::light::linear::LinearPixels;
use crate::light::measure;
use crate::light::regions::{self, Regions};
use engine::Up;
use glam::DVec3;
use scene::math::color::luminance;
use scene::math::equirect::{axes, pixel_solid_angle};
use scene::math::num;

use super::grid::Grid;
use super::spread::Given;

/// Clipped parts of a panorama, on the grid.
pub struct Clipped<'a> {
    /// Up axis of the panorama.
    pub up: Up,
    /// The panorama.
    pub pixels: &'a LinearPixels,
    /// For each pixel, true if it is clipped.
    pub mask: &'a [bool],
    /// White level of the panorama, above 0 and at most 1.
    pub ceiling: f64,
    /// The panorama on the grid.
    pub grid: Grid,
    /// Connected clipped regions of the grid.
    pub labels: Regions,
    /// Cells of each region.
    pub members: Vec<Vec<usize>>,
}

impl<'a> Clipped<'a> {
    /// The clipped parts of a panorama with its coverage `alpha`, its clipped pixels and its white level.
    pub fn new(up: Up, alpha: &[f32], (pixels, mask, ceiling): (&'a LinearPixels, &'a [bool], f64)) -> Self {
        let grid = Grid::new(pixels, mask, alpha);
        let labels = regions::label(&grid.clipped, grid.width);
        let mut members = vec![Vec::new(); labels.count];
        for (cell, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                members[*region as usize].push(cell);
            }
        }
        Self { up, pixels, mask, ceiling, grid, labels, members }
    }

    /// Regions, each with the predicted gain of its pixels.
    pub fn with_gain(&self, log2_gain: &[f32]) -> Vec<RegionLight> {
        let n = self.labels.count;
        let (mut size, mut before, mut after) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        let mut peak = vec![0.0_f64; n];
        for at in (0..self.mask.len()).filter(|&at| self.mask[at]) {
            let Some(i) = self.labels.of[self.grid.cell_of[at] as usize] else { continue };
            let (i, gain) = (i as usize, f64::from(log2_gain[at]));
            let own = pixel_solid_angle(self.pixels.width, self.pixels.height, at / self.pixels.width);
            let flux = own * f64::from(luminance(self.pixels.rgb[at]));
            size[i] += own;
            before[i] += flux;
            after[i] += flux * num::f64::exp2(gain);
            peak[i] = peak[i].max(gain);
        }
        let mean = |i: usize| if before[i] > 0.0 { num::f64::log2(after[i] / before[i]) } else { 0.0 };
        let given = |i: usize| Given { mean_log2_gain: mean(i), peak_log2_gain: peak[i] };
        (0..n).map(|i| self.found(i, size[i], given(i))).collect()
    }

    /// Estimate for region `i`, from the solid angle of its clipped pixels and the light given to it.
    pub fn found(&self, i: usize, solid_angle: f64, given: Given) -> RegionLight {
        let toward = |&c: &usize| self.grid.direction(self.up, c) * self.grid.clipped_angle(c);
        let centre: DVec3 = self.members[i].iter().map(toward).sum();
        let centre = centre.try_normalize().unwrap_or(axes(self.up)[2]);
        let (azimuth_deg, elevation_deg) = measure::angles_deg(self.up, centre);
        RegionLight {
            sun: false,
            azimuth_deg,
            elevation_deg,
            solid_angle,
            mean_log2_gain: given.mean_log2_gain,
            peak_log2_gain: given.peak_log2_gain,
            uncertainty: None,
            colour: None,
        }
    }
}

/// Estimate of the hidden light of one region.
pub struct RegionLight {
    /// True if it counts as the sun.
    pub sun: bool,
    /// Azimuth of its centre in degrees, clockwise from forward.
    pub azimuth_deg: f64,
    /// Elevation of its centre in degrees above the horizon.
    pub elevation_deg: f64,
    /// Solid angle in steradians.
    pub solid_angle: f64,
    /// Base-2 logarithm of the ratio of its light with and without the hidden light.
    pub mean_log2_gain: f64,
    /// Largest base-2 logarithm of the gain of a pixel.
    pub peak_log2_gain: f64,
    /// Standard deviation of the mean gain, in stops; `None` if unknown.
    pub uncertainty: Option<f64>,
    /// RGB of the hidden light, at a luminance of 1; `None` if it is the colour of the panorama.
    pub colour: Option<[f64; 3]>,
}
