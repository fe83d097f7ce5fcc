//! Training of the LoRA that makes a panorama three stops darker. As in the paper, it is trained on pairs of
//! exposures made from HDR panoramas, with one fixed prompt and a frozen base model.

use std::path::{Path, PathBuf};

use crate::flux::{
    DType, Error as Flux, Files, Kontext, Pair, TrainSettings, Trainer, Watch, device, picture,
};
use engine::{Digest, DigestWriter, Notes};
use render::light::linear::{LinearPixels, max3};
use render::light::whole_sphere::light;
use scene::error::Error;
use scene::math::color::{linear_from_srgb, luminance};
use scene::math::equirect::pixel_solid_angle;

use render::light::hidden::diffusion::{STOPS, WHERE, shrunk};

/// Inputs and settings of a training run.
#[derive(Debug, Clone)]
pub struct LoraPlan {
    /// File of the Flux.1 Kontext transformer.
    pub transformer: PathBuf,
    /// File of the model's autoencoder.
    pub vae: PathBuf,
    /// File of the encoded text prompt.
    pub prompt: PathBuf,
    /// Rank of the LoRA matrices. The LoRA parameter alpha has the same value.
    pub rank: usize,
    /// Learning rate: the largest change of a weight per step.
    pub rate: f64,
    /// Seed of the random number generator.
    pub seed: u64,
    /// Total number of training steps.
    pub steps: u64,
    /// Width of the pictures, a multiple of 32.
    pub width: usize,
}

/// Progress of a training run.
#[derive(Debug, Clone, PartialEq)]
pub enum LoraProgress {
    /// Number of panoramas that have been encoded, and number of all panoramas.
    Pairs(usize, usize),
    /// Number of steps that have been done, number of all steps, and loss of the last step.
    Step(u64, u64, f32),
}

/// Exposures from which training pairs are made, in stops relative to EV 0. Each is the exposure of the brighter
/// picture of a pair.
const FROM: [f64; 2] = [0.0, -STOPS];
/// Number of steps between checkpoints.
const KEPT: u64 = 50;
/// Encoded value of the median luminance at EV 0.
const MEDIAN: f32 = 0.5;
/// Maximum share of the sphere that is clipped at EV 0.
const MOST_CLIPPED: f64 = 0.15;

/// Reads an HDR panorama, `.hdr` or `.exr`.
fn read(path: &Path) -> Result<LinearPixels, Error> {
    let name = path.display().to_string();
    let bytes =
        std::fs::read(path).map_err(|error| Error::format(&name, format!("cannot be read: {error}")))?;
    let (width, height, rgb) = light(&name, &bytes, &mut Notes::none())?;
    if width != 2 * height || height == 0 {
        return Err(Error::format(
            &name,
            format!("is {width}x{height} pixels; a panorama must be twice as wide as high"),
        ));
    }
    let sound = |v: f32| if v.is_finite() { v.max(0.0) } else { 0.0 };
    let rgb = rgb.as_chunks::<3>().0.iter().map(|rgb| rgb.map(sound)).collect();
    Ok(LinearPixels { width, height, rgb, broken: 0, negative: 0, ceiling: true })
}

/// Factor that scales luminance to EV 0.
fn exposure(pixels: &LinearPixels) -> f32 {
    // (value, solid angle), in rising order; equal values stay in the order of pixels.
    let sorted = |value: &dyn Fn([f32; 3]) -> f32| {
        let at = |i: usize| pixel_solid_angle(pixels.width, pixels.height, i / pixels.width);
        let mut list: Vec<(f32, f64)> =
            pixels.rgb.iter().enumerate().map(|(i, rgb)| (value(*rgb), at(i))).collect();
        list.retain(|(value, _)| *value > 0.0);
        list.sort_by(|a, b| a.0.total_cmp(&b.0));
        list
    };
    // The value below which a given share of the solid angle lies.
    let quantile = |list: &[(f32, f64)], share: f64| {
        let total: f64 = list.iter().map(|(_, size)| size).sum();
        let mut below = 0.0;
        let found = list.iter().find(|(_, size)| {
            below += size;
            below >= share * total
        });
        found.or(list.last()).map_or(1.0, |(value, _)| *value)
    };
    let wanted = linear_from_srgb(MEDIAN) / quantile(&sorted(&luminance), 0.5);
    wanted.min(1.0 / quantile(&sorted(&max3), 1.0 - MOST_CLIPPED))
}

/// Photograph that a camera would take of light multiplied by `scale`: display-encoded planes, clipped to white.
fn shot(pixels: &LinearPixels, scale: f32, (width, height): (usize, usize)) -> Vec<f32> {
    let rgb = pixels.rgb.iter().map(|rgb| rgb.map(|v| (v * scale).min(1.0))).collect();
    shrunk(&LinearPixels { rgb, ..*pixels }, width, height)
}

/// Digest of the training data: the panoramas in order, the model, the prompt, and the size of the pictures.
fn learned_from(panoramas: &[PathBuf], files: &Files, width: usize) -> Result<String, Error> {
    let mut all = format!("{width}");
    for path in [&files.transformer, &files.vae, &files.prompt].into_iter().chain(panoramas) {
        let mut digest = DigestWriter::new();
        let read = std::fs::File::open(path).and_then(|mut file| std::io::copy(&mut file, &mut digest));
        read.map_err(|error| Error::format(path.display().to_string(), format!("cannot be read: {error}")))?;
        all += &format!(" {}", digest.finish());
    }
    Ok(Digest::of(all.as_bytes()).to_string())
}

struct Stoppable<'a>(&'a dyn Fn() -> bool);

impl Watch for Stoppable<'_> {
    fn check(&mut self) -> Result<(), Flux> {
        if (self.0)() { Err(Flux::Stopped) } else { Ok(()) }
    }
}

/// Trains a LoRA and writes it to `out`, in the layout of `diffusers`. Returns true if the training is finished,
/// and false if it was stopped. The state of a stopped run is stored next to `out` (`.state`). The same call then
/// continues from this state, with the same result as an uninterrupted run.
///
/// # Errors
/// Fails if [`crate::flux`] refuses the model's files, if a panorama cannot be read, or if `out` cannot be
/// written.
pub fn train(
    panoramas: &[PathBuf],
    plan: &LoraPlan,
    out: &Path,
    stopped: &dyn Fn() -> bool,
    on_progress: &mut dyn FnMut(LoraProgress),
) -> Result<bool, Error> {
    let flux = |error: Flux| Error::Mismatch(error.to_string());
    let files = Files {
        transformer: plan.transformer.clone(),
        vae: plan.vae.clone(),
        prompt: plan.prompt.clone(),
        loras: Vec::new(),
    };
    for file in [&files.transformer, &files.vae, &files.prompt] {
        if !file.exists() {
            let what = format!("does not exist; {}", WHERE);
            return Err(Error::format(file.display().to_string(), what));
        }
    }
    let settings = TrainSettings {
        rank: plan.rank,
        alpha: plan.rank as f64,
        rate: plan.rate,
        guidance: 1.0,
        seed: plan.seed,
    };
    // Checked now rather than after hours.
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|error| {
        Error::format(folder.display().to_string(), format!("cannot be created: {error}"))
    })?;
    let learned_from = learned_from(panoramas, &files, plan.width)?;
    let device = device().map_err(flux)?;
    let model = Kontext::load(&files, &device, DType::F32).map_err(flux)?;
    let mut trainer = Trainer::new(model, settings).map_err(flux)?;
    let state = out.with_added_extension("state");
    if state.exists() {
        trainer.load_state(&state, &learned_from).map_err(flux)?;
        if trainer.done() > plan.steps {
            let what = format!(
                "contains a run of {} steps, more than the {} steps requested; remove the file to start again",
                trainer.done(),
                plan.steps
            );
            return Err(Error::format(state.display().to_string(), what));
        }
    }
    let size = (plan.width, plan.width / 2);
    let mut watch = Stoppable(stopped);
    let mut pairs: Vec<Pair> = Vec::new();
    for (i, path) in panoramas.iter().enumerate() {
        on_progress(LoraProgress::Pairs(i, panoramas.len()));
        let pixels = read(path)?;
        let zero = exposure(&pixels);
        for ev in FROM {
            let at = |ev: f64| {
                let scale = zero * scene::math::num::f64::exp2(ev) as f32;
                picture(&shot(&pixels, scale, size), size, &device).map_err(flux)
            };
            match trainer.pair(&at(ev)?, &at(ev - STOPS)?, &mut watch) {
                Ok(pair) => pairs.push(pair),
                Err(Flux::Stopped) => return Ok(false),
                Err(error) => return Err(flux(error)),
            }
        }
    }
    while trainer.done() < plan.steps {
        let next = trainer.next(pairs.len());
        match trainer.step(&pairs[next], &mut watch) {
            Ok(loss) => on_progress(LoraProgress::Step(trainer.done(), plan.steps, loss)),
            Err(Flux::Stopped) => {
                trainer.save_state(&state, &learned_from).map_err(flux)?;
                return Ok(false);
            }
            Err(error) => return Err(flux(error)),
        }
        if trainer.done().is_multiple_of(KEPT) {
            trainer.save_state(&state, &learned_from).map_err(flux)?;
        }
    }
    trainer.save_state(&state, &learned_from).and_then(|()| trainer.save(out)).map_err(flux)?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ev_0_shows_the_median_as_a_half_unless_too_much_were_clipped() {
        let panorama = |light: &dyn Fn(usize) -> f32| {
            let rgb = (0..64 * 32).map(|i| [light(i % 64); 3]).collect();
            LinearPixels { width: 64, height: 32, rgb, broken: 0, negative: 0, ceiling: true }
        };
        let half = linear_from_srgb(0.5);
        assert!((exposure(&panorama(&|_| 3.0)) - half / 3.0).abs() < 1e-6);
        // A quarter of the sphere is a hundred times brighter: it stays at white.
        let bright = panorama(&|x| if x < 16 { 100.0 } else { 1.0 });
        assert!((exposure(&bright) - 0.01).abs() < 1e-6);
        let dark = shot(&bright, exposure(&bright) * 0.125, (32, 16));
        assert!((linear_from_srgb(dark[0]) - 0.125).abs() < 1e-4);
    }
}
