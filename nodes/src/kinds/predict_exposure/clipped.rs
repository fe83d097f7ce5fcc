//! Clipped regions, and the estimate for each of them.

use engine::Up;
use glam::DVec3;
use render::light::linear::LinearPixels;
use render::light::measure;
use render::light::regions::{self, Regions};
use scene::math::color::luminance;
use scene::math::equirect::{axes, pixel_solid_angle};
use scene::math::num;

use super::grid::Grid;
use super::spread::Given;

/// Clipped parts of a panorama, on the grid.
pub(super) struct Clipped<'a> {
    pub(super) up: Up,
    pub(super) pixels: &'a LinearPixels,
    pub(super) mask: &'a [bool],
    /// White level of the panorama, above 0 and at most 1.
    pub(super) ceiling: f64,
    pub(super) grid: Grid,
    pub(super) labels: Regions,
    /// Cells of each region.
    pub(super) members: Vec<Vec<usize>>,
}

impl<'a> Clipped<'a> {
    pub(super) fn new(
        up: Up,
        alpha: &[f32],
        (pixels, mask, ceiling): (&'a LinearPixels, &'a [bool], f64),
    ) -> Self {
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
    pub(super) fn with_gain(&self, log2_gain: &[f32]) -> Vec<RegionLight> {
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
    pub(super) fn found(&self, i: usize, solid_angle: f64, given: Given) -> RegionLight {
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
pub(super) struct RegionLight {
    pub(super) sun: bool,
    pub(super) azimuth_deg: f64,
    pub(super) elevation_deg: f64,
    pub(super) solid_angle: f64,
    pub(super) mean_log2_gain: f64,
    pub(super) peak_log2_gain: f64,
    /// Standard deviation of the mean gain, in stops; `None` if unknown.
    pub(super) uncertainty: Option<f64>,
    /// RGB of the hidden light, at a luminance of 1; `None` if it is the colour of the panorama.
    pub(super) colour: Option<[f64; 3]>,
}
