//! Distribution of the hidden light of a region over its clipped pixels.

use crate::light::linear::LinearPixels;
use crate::light::regions::Regions;
use engine::{Context, NodeError};
use scene::math::color::luminance;
use scene::math::equirect::pixel_solid_angle;
use scene::math::num;

use super::grid::Grid;

/// Maximum ratio of the area of clipped cells to the area of the clipped pixels in them. A cell counts as clipped
/// if any of its pixels is, so its area may be much larger. A gain that was fitted for whole cells is applied to
/// their area, but to at most this many times the area of the clipped pixels.
const LARGEST_DILUTION: f64 = 16.0;

/// Clipped pixels of each region, and the profile of its light.
pub struct Spread {
    /// Clipped pixels of each region. For each pixel: its index, its value of the profile, and its solid angle.
    pixels: Vec<Vec<(u32, f64, f64)>>,
    /// Solid angle of the clipped pixels of each region.
    pub solid_angle: Vec<f64>,
    /// For each region, the sum of luminance times solid angle over its clipped pixels.
    pub flux: Vec<f64>,
    /// For each region, the luminance of its clipped pixels times the solid angle of the whole cells that contain
    /// them. The ratio to `flux` is at most `LARGEST_DILUTION`.
    pub cell_flux: Vec<f64>,
}

/// Light added to a region.
pub struct Given {
    /// log2 of the ratio of the region's flux with the added light to its flux without the added light.
    pub mean_log2_gain: f64,
    /// Largest log2 gain of a pixel.
    pub peak_log2_gain: f64,
}

impl Spread {
    /// Collects the clipped pixels of each region. `profile` returns a number that is proportional to the gain of a
    /// clipped pixel minus 1. The factor of proportionality may differ between regions.
    pub fn new(
        image: &LinearPixels,
        mask: &[bool],
        grid: &Grid,
        labels: &Regions,
        profile: impl Fn(usize, usize) -> f64 + Send + Sync,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let rows = cx.for_each_tile(image.height, |y| {
            let at = |x| y * image.width + x;
            let pixel = |at: usize| Some((labels.of[grid.cell_of[at] as usize]? as usize, at));
            let clipped = (0..image.width).map(at).filter(|&at| mask[at]);
            clipped.filter_map(pixel).map(|(i, at)| (i, at, profile(i, at))).collect::<Vec<_>>()
        })?;
        let mut pixels = vec![Vec::new(); labels.count];
        let (mut solid_angle, mut flux) = (vec![0.0; labels.count], vec![0.0; labels.count]);
        for (y, row) in rows.into_iter().enumerate() {
            let size = pixel_solid_angle(image.width, image.height, y);
            for (i, at, profile) in row {
                pixels[i].push((at as u32, profile, size));
                solid_angle[i] += size;
                flux[i] += size * f64::from(luminance(image.rgb[at]));
            }
        }
        let mut cells = vec![0.0; labels.count];
        for (cell, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                cells[*region as usize] += grid.solid_angle(cell);
            }
        }
        let cell_flux = (0..labels.count)
            .map(|i| flux[i] * (cells[i] / solid_angle[i]).clamp(1.0, LARGEST_DILUTION))
            .collect();
        Ok(Self { pixels, solid_angle, flux, cell_flux })
    }

    /// Indices of the clipped pixels of region `i`.
    pub fn pixels(&self, i: usize) -> impl Iterator<Item = usize> {
        self.pixels[i].iter().map(|&(at, ..)| at as usize)
    }

    /// Writes the log2 gain of each pixel of region `i`, so that together the pixels add `excess` of flux.
    pub fn apply(&self, i: usize, excess: f64, image: &LinearPixels, log2_gain: &mut [f32]) -> Given {
        let light = |at: u32| f64::from(luminance(image.rgb[at as usize]));
        let weight: f64 = self.pixels[i].iter().map(|&(at, profile, size)| profile * size * light(at)).sum();
        let scale = if weight > 0.0 { excess / weight } else { 0.0 };
        let mut peak = 0.0_f64;
        for &(at, profile, _) in &self.pixels[i] {
            let log = num::f64::log2(1.0 + scale * profile);
            peak = peak.max(log);
            log2_gain[at as usize] = log as f32;
        }
        let gain = if self.flux[i] > 0.0 { excess / self.flux[i] } else { 0.0 };
        Given { mean_log2_gain: num::f64::log2(1.0 + gain), peak_log2_gain: peak }
    }
}
