//! Seam to the diffusion model of the method `FluxKontext`, which is in a crate with a tensor library.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use engine::{Context, NodeError};

use crate::light::exposure::{Shown, measured};
use crate::light::linear::LinearPixels;
use scene::math::color::{linear_from_srgb, srgb_from_linear};

/// Number of stops by which one pass darkens a panorama.
pub const STOPS: f64 = 3.0;

/// Text for errors about a missing file: the files that a user must supply, where to find them, and their sizes.
pub const WHERE: &str = "you must supply four files. `flux1-kontext-dev.safetensors` (23.8 GB; \
    a GGUF file with 4 bits per weight takes 6.7 GB) and `ae.safetensors` (0.3 GB) can be downloaded from \
    huggingface.co/black-forest-labs/FLUX.1-Kontext-dev after you accept the non-commercial licence there. The others \
    are the encoded prompt (4 MB) and a LoRA for exposure, made by `train-exposure --backend flux-kontext`. The \
    method needs memory for the transformer file plus 7 GB. See docs/kontext.md";

/// Files of the model.
#[derive(Debug, Clone)]
pub struct ModelFiles {
    /// The transformer, or its first shard.
    pub transformer: PathBuf,
    /// The autoencoder.
    pub vae: PathBuf,
    /// The encoded prompt.
    pub prompt: PathBuf,
    /// The LoRA for the exposure.
    pub lora: PathBuf,
    /// Strength of the LoRA; 1 is the strength it was trained with.
    pub strength: f64,
}

/// Settings of a pass.
#[derive(Debug, Clone, Copy)]
pub struct PassSettings {
    /// Number of denoising steps.
    pub steps: usize,
    /// Guidance scale.
    pub guidance: f32,
    /// Seed of the initial noise.
    pub seed: u64,
    /// True to compute each step twice, so that no seam is visible.
    pub seamless: bool,
}

/// A picture: display-encoded planes, one per channel, and its width and height.
#[derive(Debug, Clone, Copy)]
pub struct Planes<'a> {
    /// Red, green and blue, each row by row, from 0 to 1.
    pub samples: &'a [f32],
    /// Width and height in pixels.
    pub size: (usize, usize),
}

/// A diffusion model that was trained to darken a picture by [`STOPS`].
pub trait DiffusionModel: Send + Sync {
    /// Memory of the published model for a picture of this size in addition to its files, in bytes. A smaller model
    /// needs less.
    fn memory(&self, size: (usize, usize)) -> u64;

    /// The file itself, or all shards of which it is the first.
    fn shards(&self, first: &Path) -> Vec<PathBuf>;

    /// Exposures of a picture, one per pass, each [`STOPS`] below the previous one; samples as in [`Planes`].
    ///
    /// # Errors
    /// If a file cannot be read, the model fails, or the run was cancelled.
    fn darker(
        &self,
        files: &ModelFiles,
        picture: Planes<'_>,
        passes: usize,
        settings: PassSettings,
        cx: &Context,
    ) -> Result<Vec<Vec<f32>>, NodeError>;
}

static MODEL: OnceLock<&'static dyn DiffusionModel> = OnceLock::new();

/// Sets the model for the whole process. The first model that is set stays.
pub fn set_model(model: &'static dyn DiffusionModel) {
    let _ = MODEL.set(model);
}

/// The model, if this build has one.
pub fn model() -> Option<&'static dyn DiffusionModel> {
    MODEL.get().copied()
}

/// Shrinks a panorama. Returns display-encoded planes, one per channel. Each pixel is the mean of the light in the
/// area that it covers.
pub fn shrunk(pixels: &LinearPixels, width: usize, height: usize) -> Vec<f32> {
    let mut planes = vec![0.0; 3 * width * height];
    let span = |i: usize, of: usize, from: usize| (i * from / of)..((i + 1) * from).div_ceil(of);
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut area) = ([0.0; 3], 0.0);
            for row in span(y, height, pixels.height) {
                let tall = overlap(row, pixels.height, y, height);
                for column in span(x, width, pixels.width) {
                    let share = tall * overlap(column, pixels.width, x, width);
                    area += share;
                    let rgb = pixels.rgb[row * pixels.width + column];
                    sum.iter_mut().zip(rgb).for_each(|(sum, v)| *sum += share * f64::from(v));
                }
            }
            for (c, sum) in sum.into_iter().enumerate() {
                planes[(c * height + y) * width + x] =
                    srgb_from_linear(((sum / area) as f32).clamp(0.0, 1.0));
            }
        }
    }
    planes
}

/// Fraction of pixel `i` in a row of `n` pixels that lies within pixel `j` in a row of `m` pixels. Both rows have
/// the same total length.
fn overlap(i: usize, n: usize, j: usize, m: usize) -> f64 {
    let (low, high) = ((i * m).max(j * n), ((i + 1) * m).min((j + 1) * n));
    high.saturating_sub(low) as f64 / m as f64
}

/// Gain of each pixel from the exposures of the model, and whether the pixel is clipped in all of them.
/// Pictures are display-encoded, channel by channel. Each exposure is [`STOPS`] below the previous one.
pub fn gains(base: &[f32], exposures: &[Vec<f32>]) -> Vec<(f32, bool)> {
    let count = base.len() / 3;
    let pixel = |planes: &[f32], at: usize| [0, 1, 2].map(|c| linear_from_srgb(planes[c * count + at]));
    let shown = |at: usize| {
        let made = exposures.iter().enumerate();
        made.map(move |(i, planes)| Shown::display(-STOPS * (i + 1) as f64, pixel(planes, at)))
    };
    (0..count).map(|at| measured(pixel(base, at), shown(at)).unwrap_or((0.0, true))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::math::num;

    #[test]
    fn shrinking_keeps_the_mean_of_light() {
        let rgb: Vec<[f32; 3]> = (0..12 * 6).map(|i| [0.01 * i as f32, 0.5, 0.0]).collect();
        let mean = rgb.iter().map(|rgb| f64::from(rgb[0])).sum::<f64>() / 72.0;
        let pixels = LinearPixels { width: 12, height: 6, rgb, broken: 0, negative: 0, ceiling: true };
        for (width, height) in [(12, 6), (6, 3), (5, 4), (1, 1)] {
            let small = shrunk(&pixels, width, height);
            let count = width * height;
            let red: f64 = small[..count].iter().map(|v| f64::from(linear_from_srgb(*v))).sum();
            assert!((red / count as f64 - mean).abs() < 1e-5, "{width} x {height}");
            assert!(small[2 * count..].iter().all(|v| *v == 0.0));
        }
    }

    #[test]
    fn a_gain_is_read_from_the_brightest_exposure_that_is_not_clipped() {
        // Light of 0.5, 4, 40 and 4000 at exposures of 0, -3 and -6 stops.
        let lights = [0.5_f32, 4.0, 40.0, 4000.0];
        let shot = |stops: f32| -> Vec<f32> {
            let one = lights.map(|light| srgb_from_linear((light * num::f32::exp2(-stops)).min(1.0)));
            [one, one, one].concat()
        };
        let found = gains(&shot(0.0), &[shot(3.0), shot(6.0)]);
        let wanted = [(0.5, false), (4.0, false), (40.0, false), (64.0, true)];
        for ((gain, clipped), (light, still)) in found.into_iter().zip(wanted) {
            assert!((gain - num::f32::log2(light / f32::min(light, 1.0))).abs() < 1e-3, "{gain} for {light}");
            assert_eq!(clipped, still);
        }
    }
}
