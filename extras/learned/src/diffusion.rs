//! The diffusion model of the method `FluxKontext` of `predict-exposure`.

use std::path::{Path, PathBuf};

use engine::{Context, NodeError};
use render::light::hidden::diffusion::{self, DiffusionModel, ModelFiles, PassSettings, Planes};

use crate::flux::{self, DType, Error, Files, Kontext, Memory, Settings, Watch};

/// Flux.1 Kontext, loaded from its files for every call.
struct Flux;

impl DiffusionModel for Flux {
    fn memory(&self, size: (usize, usize)) -> u64 {
        Memory::published(size)
    }

    fn shards(&self, first: &Path) -> Vec<PathBuf> {
        flux::shards(first)
    }

    fn darker(
        &self,
        files: &ModelFiles,
        picture: Planes<'_>,
        passes: usize,
        settings: PassSettings,
        cx: &Context,
    ) -> Result<Vec<Vec<f32>>, NodeError> {
        let files = Files {
            transformer: files.transformer.clone(),
            vae: files.vae.clone(),
            prompt: files.prompt.clone(),
            loras: vec![(files.lora.clone(), files.strength)],
        };
        let PassSettings { steps, guidance, seed, seamless } = settings;
        let settings = Settings { steps, guidance, seed, seamless };
        let made = || {
            let device = flux::device()?;
            let model = Kontext::load(&files, &device, DType::F32)?;
            let picture = flux::picture(picture.samples, picture.size, &device)?;
            let made = model.darker(&picture, passes, &settings, &mut Follow(cx))?;
            made.iter().map(flux::samples).collect::<Result<Vec<_>, _>>()
        };
        made().map_err(|error| match error {
            Error::Stopped => NodeError::cancelled(),
            other => NodeError::new(other.to_string()).at("method"),
        })
    }
}

/// Makes the model known to `predict-exposure`, for the whole process.
pub fn install() {
    diffusion::set_model(&Flux);
}

/// Passes progress from the model to the engine, and requests to stop from the engine to the model.
struct Follow<'a>(&'a Context);

impl Watch for Follow<'_> {
    fn check(&mut self) -> Result<(), Error> {
        if self.0.cancelled() { Err(Error::Stopped) } else { Ok(()) }
    }

    fn progress(&mut self, done: f64) {
        self.0.progress(done as f32);
    }
}
