//! The paper's own way: a diffusion model that was taught to show a picture at three stops less.
//!
//! What is computed is in the crate `learned`; here a panorama is handed to it, and what it shows becomes a gain.

#[cfg(feature = "learned")]
use engine::{Context, Notes};
use engine::{InputFile, NodeError, SourceFile, SourceRoot};

#[cfg(feature = "learned")]
use crate::light::linear::LinearPixels;

/// `Method::FluxKontext` as it is used.
pub(super) struct Kontext<'a> {
    pub transformer: &'a InputFile,
    pub vae: &'a InputFile,
    pub prompt: &'a InputFile,
    pub lora: &'a InputFile,
    pub strength: f64,
    pub steps: u32,
    pub guidance: f64,
    pub width_px: u32,
    pub seamless: bool,
    pub seed: u64,
}

/// How many stops darker one pass makes a panorama.
#[cfg(feature = "learned")]
pub(super) const STOPS: f64 = 3.0;
/// The most passes: from EV 0 to EV -24, the darkest exposure that can be asked for.
#[cfg(feature = "learned")]
const MAX_PASSES: f64 = 8.0;

impl<'a> Kontext<'a> {
    pub(super) fn files(&self) -> [&'a InputFile; 4] {
        [self.transformer, self.vae, self.prompt, self.lora]
    }

    pub(super) fn within(&self) -> bool {
        (0.0..=4.0).contains(&self.strength)
            && (1..=200).contains(&self.steps)
            && (0.0..=20.0).contains(&self.guidance)
            && (64..=4096).contains(&self.width_px)
    }
}

#[cfg(not(feature = "learned"))]
impl Kontext<'_> {
    pub(super) fn predict(
        &self,
        _pixels: &crate::light::linear::LinearPixels,
        _mask: &[bool],
        _darkest: f64,
        _notes: &mut engine::Notes,
        _cx: &engine::Context,
    ) -> Result<Vec<f32>, NodeError> {
        self.check().map(|()| Vec::new())
    }

    pub(super) fn check(&self) -> Result<(), NodeError> {
        Err(NodeError::new("this build has no diffusion model: it lacks the feature `learned`")
            .at("method")
            .hint("build it with `--features learned`, or use another method"))
    }

    pub(super) fn sources(&self, _root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(Vec::new())
    }
}

#[cfg(feature = "learned")]
impl Kontext<'_> {
    pub(super) fn check(&self) -> Result<(), NodeError> {
        Ok(())
    }

    /// Its files, shards included. What is missing is said with where it is to be had.
    pub(super) fn sources(&self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut files = Vec::new();
        for file in self.files() {
            let first = root.file(file);
            for shard in learned::flux::shards(&first.path) {
                let name = shard.file_name().unwrap_or_default().to_string_lossy().into_owned();
                files.push(if shard == first.path { first.clone() } else { root.beside(&first, &name) });
            }
        }
        match files.iter().find(|file| !file.path.exists()) {
            Some(missing) => Err(NodeError::new(format!("cannot find `{}`", missing.name))
                .at("method")
                .hint(learned::flux::WHERE)),
            None => Ok(files),
        }
    }

    /// The log2 gain of every clipped pixel, by the brightest exposure in which it is not clipped any more.
    pub(super) fn predict(
        &self,
        pixels: &LinearPixels,
        mask: &[bool],
        darkest: f64,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Vec<f32>, NodeError> {
        use learned::flux::{DType, Files, Settings};

        let width = pixels.width.min(self.width_px as usize) / 32 * 32;
        if width == 0 || pixels.width != 2 * pixels.height {
            let size = format!("a panorama of {} x {} pixels", pixels.width, pixels.height);
            return Err(NodeError::new(format!("{size} is too small, or not twice as wide as high"))
                .at("pano")
                .hint("the model takes panoramas of 64 x 32 pixels or more"));
        }
        let path = |file| cx.source(file).path;
        let files = Files {
            transformer: path(self.transformer),
            vae: path(self.vae),
            prompt: path(self.prompt),
            loras: vec![(path(self.lora), self.strength)],
        };
        let device = device()?;
        let model = learned::flux::Kontext::load(&files, &device, DType::F32).map_err(error)?;
        let passes = (-darkest / STOPS).ceil().clamp(1.0, MAX_PASSES) as usize;
        let settings = Settings {
            steps: self.steps as usize,
            guidance: self.guidance as f32,
            seed: self.seed,
            seamless: self.seamless,
        };
        let height = width / 2;
        notes.decision(
            "kontext",
            format!("Flux.1 Kontext made {passes} exposures at {width} x {height}, {STOPS} stops apart, each from the last"),
        );
        cx.count("diffusion-steps", (passes * settings.steps * if self.seamless { 2 } else { 1 }) as u64);
        let small = shrunk(pixels, width, height);
        let picture = learned::flux::picture(&small, (width, height), &device).map_err(error)?;
        let made = model.darker(&picture, passes, &settings, &mut Follow(cx)).map_err(error)?;
        let exposures =
            made.iter().map(learned::flux::samples).collect::<Result<Vec<_>, _>>().map_err(error)?;
        let gains = gains(&small, &exposures);
        let (mut log2_gain, mut still) = (vec![0.0; mask.len()], 0_u64);
        for (at, gain) in log2_gain.iter_mut().enumerate().filter(|(at, _)| mask[*at]) {
            let (x, y) =
                (at % pixels.width * width / pixels.width, at / pixels.width * height / pixels.height);
            let (found, clipped) = gains[y * width + x];
            *gain = found;
            still += u64::from(clipped);
        }
        if still > 0 {
            let ev = -STOPS * passes as f64;
            notes.warning(
                "still-clipped",
                format!("{still} pixels are clipped even at EV {ev}, so their gain is a lower bound; ask for a darker exposure in `evs`"),
            );
        }
        Ok(log2_gain)
    }
}

#[cfg(feature = "learned")]
mod with_model {
    use learned::flux::{Device, Error, Watch};

    use super::STOPS;
    use crate::color::{linear_from_srgb, luminance, srgb_from_linear};
    use crate::light::linear::{LinearPixels, max3};
    use crate::num;
    use engine::{Context, NodeError};

    /// A GPU where the build knows one and there is one.
    pub(super) fn device() -> Result<Device, NodeError> {
        learned::flux::device().map_err(error)
    }

    pub(super) fn error(error: Error) -> NodeError {
        match error {
            Error::Stopped => NodeError::cancelled(),
            other => NodeError::new(other.to_string()).at("method"),
        }
    }

    /// Follows the model for the engine.
    pub(super) struct Follow<'a>(pub &'a Context);

    impl Watch for Follow<'_> {
        fn check(&mut self) -> Result<(), Error> {
            if self.0.cancelled() { Err(Error::Stopped) } else { Ok(()) }
        }

        fn progress(&mut self, done: f64) {
            self.0.progress(done as f32);
        }
    }

    /// Display-encoded, channel by channel, each pixel the mean of the light that falls on it.
    pub(in super::super) fn shrunk(pixels: &LinearPixels, width: usize, height: usize) -> Vec<f32> {
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

    /// How much of pixel `i` of `n` lies in pixel `j` of `m`, in pixels of the first.
    fn overlap(i: usize, n: usize, j: usize, m: usize) -> f64 {
        let (low, high) = ((i * m).max(j * n), ((i + 1) * m).min((j + 1) * n));
        high.saturating_sub(low) as f64 / m as f64
    }

    /// A channel above this, in linear light, is clipped as far as anybody can tell.
    const CLIPPED: f32 = 0.9;

    /// For each pixel the log2 of its luminance, in the brightest exposure that shows it unclipped, over that of the
    /// panorama, at least 0; and whether none shows it so. Pictures are display-encoded, channel by channel.
    pub(super) fn gains(base: &[f32], exposures: &[Vec<f32>]) -> Vec<(f32, bool)> {
        let count = base.len() / 3;
        let pixel = |planes: &[f32], at: usize| [0, 1, 2].map(|c| linear_from_srgb(planes[c * count + at]));
        (0..count)
            .map(|at| {
                let own = f64::from(luminance(pixel(base, at))).max(1e-4);
                let open = exposures.iter().position(|planes| max3(pixel(planes, at)) <= CLIPPED);
                let shown = open.unwrap_or(exposures.len().saturating_sub(1));
                let Some(planes) = exposures.get(shown) else { return (0.0, false) };
                let stops = STOPS * (shown + 1) as f64;
                let light = f64::from(luminance(pixel(planes, at))) * num::f64::exp2(stops);
                (num::f64::log2((light / own).max(1.0)) as f32, open.is_none())
            })
            .collect()
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn shrinking_keeps_the_mean_of_light() {
            let rgb: Vec<[f32; 3]> = (0..12 * 6).map(|i| [0.01 * i as f32, 0.5, 0.0]).collect();
            let mean = rgb.iter().map(|rgb| f64::from(rgb[0])).sum::<f64>() / 72.0;
            let pixels = LinearPixels { width: 12, height: 6, rgb, broken: 0, negative: 0 };
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
            // Of light 0.5, 4, 40 and 4000 at exposures of 0, -3 and -6 stops.
            let lights = [0.5_f32, 4.0, 40.0, 4000.0];
            let shot = |stops: f32| -> Vec<f32> {
                let one = lights.map(|light| srgb_from_linear((light * num::f32::exp2(-stops)).min(1.0)));
                [one, one, one].concat()
            };
            let found = gains(&shot(0.0), &[shot(3.0), shot(6.0)]);
            let wanted = [(0.5, false), (4.0, false), (40.0, false), (64.0, true)];
            for ((gain, clipped), (light, still)) in found.into_iter().zip(wanted) {
                assert!(
                    (gain - num::f32::log2(light / f32::min(light, 1.0))).abs() < 1e-3,
                    "{gain} for {light}"
                );
                assert_eq!(clipped, still);
            }
        }
    }
}
#[cfg(feature = "learned")]
pub(super) use with_model::shrunk;
#[cfg(feature = "learned")]
use with_model::{Follow, device, error, gains};
