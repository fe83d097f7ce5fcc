//! The method of the paper: a diffusion model that was trained to darken a picture by three stops.
//!
//! The model is in a crate with a tensor library ([`diffusion`]); this module passes it a panorama, and turns its
//! output into a gain.

use engine::{Context, InputFile, NodeError, Notes, SourceFile, SourceRoot};
use render::light::energy_table::EnergyTable;
use render::light::hidden::diffusion::{
    self, DiffusionModel, ModelFiles, PassSettings, Planes, STOPS, WHERE, gains, shrunk,
};
use render::light::linear::LinearPixels;
use scene::math::color::{linear_from_srgb, luminance};
use scene::math::num;

use super::photographs::report_still;

/// Maximum number of passes. Eight passes of three stops lead from EV 0 to EV -24, the darkest exposure that can be
/// requested.
const MAX_PASSES: f64 = 8.0;

/// Parameters of `Method::FluxKontext`.
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

fn model() -> Result<&'static dyn DiffusionModel, NodeError> {
    diffusion::model().ok_or_else(|| {
        NodeError::new("this build lacks the feature `learned`, which contains the diffusion model")
            .at("method")
            .hint(format!("build it with `--features learned`, or use another method; {WHERE}"))
    })
}

impl<'a> Kontext<'a> {
    pub(super) fn files(&self) -> [&'a InputFile; 4] {
        [self.transformer, self.vae, self.prompt, self.lora]
    }

    /// Checks that this build has the model.
    pub(super) fn check(&self) -> Result<(), NodeError> {
        model().map(|_| ())
    }

    /// Checks that the numeric parameters are within their ranges.
    pub(super) fn check_numbers(&self) -> Result<(), NodeError> {
        let numbers = [
            ("strength", self.strength, 0.0, 4.0),
            ("steps", f64::from(self.steps), 1.0, 200.0),
            ("guidance", self.guidance, 0.0, 20.0),
            ("width_px", f64::from(self.width_px), 64.0, 4096.0),
        ];
        match numbers.into_iter().find(|(_, value, low, high)| !(*low..=*high).contains(value)) {
            Some((name, value, low, high)) => {
                let what = format!("`{name}` of `FluxKontext` must be {low} to {high}, but is {value}");
                Err(NodeError::new(what).at("method"))
            }
            None => Ok(()),
        }
    }

    /// Memory of the published model for a panorama of `width` columns in addition to its files, in bytes. A
    /// smaller model needs less.
    pub(super) fn memory(&self, width: usize) -> u64 {
        let width = self.width(width);
        diffusion::model().map_or(0, |model| model.memory((width, width / 2)))
    }

    /// Width of the picture that is given to the model, in pixels.
    fn width(&self, width: usize) -> usize {
        width.min(self.width_px as usize) / 32 * 32
    }

    /// Files of the model, with shards and the `config.json` next to them. If a file is missing, the error gives
    /// the address from which it can be downloaded.
    pub(super) fn sources(&self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let Some(model) = diffusion::model() else { return Ok(Vec::new()) };
        let mut files = Vec::new();
        for file in self.files() {
            let first = root.file(file);
            for shard in model.shards(&first.path) {
                let name = shard.file_name().unwrap_or_default().to_string_lossy().into_owned();
                files.push(if shard == first.path { first.clone() } else { root.sibling(&first, &name) });
            }
        }
        for file in [self.transformer, self.vae] {
            let config = root.sibling(&root.file(file), "config.json");
            if config.path.exists() && !files.contains(&config) {
                files.push(config);
            }
        }
        match files.iter().find(|file| !file.path.exists()) {
            Some(missing) => {
                Err(NodeError::new(format!("cannot find `{}`", missing.name)).at("method").hint(WHERE))
            }
            None => Ok(files),
        }
    }

    /// log2 gain of every clipped pixel, from the brightest exposure in which it is not clipped.
    pub(super) fn predict(
        &self,
        pixels: &LinearPixels,
        mask: &[bool],
        darkest: f64,
        energies: &mut EnergyTable,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Vec<f32>, NodeError> {
        let model = model()?;
        let width = self.width(pixels.width);
        if width == 0 || pixels.width != 2 * pixels.height {
            let size = format!("a panorama of {} x {} pixels", pixels.width, pixels.height);
            return Err(NodeError::new(format!("{size} is too small, or not twice as wide as high"))
                .at("pano")
                .hint("the model takes panoramas of 64 x 32 pixels or more"));
        }
        let path = |file| cx.source(file).path;
        let files = ModelFiles {
            transformer: path(self.transformer),
            vae: path(self.vae),
            prompt: path(self.prompt),
            lora: path(self.lora),
            strength: self.strength,
        };
        let passes = (-darkest / STOPS).ceil().clamp(1.0, MAX_PASSES) as usize;
        let settings = PassSettings {
            steps: self.steps as usize,
            guidance: self.guidance as f32,
            seed: self.seed,
            seamless: self.seamless,
        };
        let height = width / 2;
        notes.decision(
            "kontext",
            format!("Flux.1 Kontext made exposures of {width} x {height} pixels, each {STOPS} stops darker than the previous one (count: {passes})"),
        );
        cx.count("diffusion-steps", (passes * settings.steps * if self.seamless { 2 } else { 1 }) as u64);
        let small = shrunk(pixels, width, height);
        let picture = Planes { samples: &small, size: (width, height) };
        let exposures = model.darker(&files, picture, passes, settings, cx)?;
        let gains = gains(&small, &exposures);
        if mask.contains(&true) {
            record(energies, (width, height), &small, &gains, pixels, mask, cx)?;
        }
        let (mut log2_gain, mut still) = (vec![0.0; mask.len()], 0);
        for (at, gain) in log2_gain.iter_mut().enumerate().filter(|(at, _)| mask[*at]) {
            let (x, y) =
                (at % pixels.width * width / pixels.width, at / pixels.width * height / pixels.height);
            let (found, clipped) = gains[y * width + x];
            *gain = found;
            still += usize::from(clipped);
        }
        report_still(still, notes);
        Ok(log2_gain)
    }
}

/// Records two steps for the energy report: the light of `small`, which is the picture given to the model, and the
/// light of `small` after the gains are applied. Each gain is applied to the fraction of the pixel that is clipped
/// in the panorama.
fn record(
    energies: &mut EnergyTable,
    (width, height): (usize, usize),
    small: &[f32],
    gains: &[(f32, bool)],
    pixels: &LinearPixels,
    mask: &[bool],
    cx: &Context,
) -> Result<(), NodeError> {
    let plane = width * height;
    let shown = |at: usize| f64::from(luminance([0, 1, 2].map(|c| linear_from_srgb(small[c * plane + at]))));
    let mut light: Vec<f64> = (0..plane).map(shown).collect();
    energies.record_panorama("input of the model", width, &light, cx)?;
    let mut clipped = vec![[0.0; 2]; plane];
    for (at, is) in mask.iter().enumerate() {
        let (x, y) = (at % pixels.width * width / pixels.width, at / pixels.width * height / pixels.height);
        let [part, all] = &mut clipped[y * width + x];
        (*part, *all) = (*part + f64::from(u8::from(*is)), *all + 1.0);
    }
    for ((light, (gain, _)), [part, all]) in light.iter_mut().zip(gains).zip(clipped) {
        *light *= 1.0 + part / f64::max(all, 1.0) * (num::f64::exp2(f64::from(*gain)) - 1.0);
    }
    energies.record_panorama("output of the model", width, &light, cx)
}
