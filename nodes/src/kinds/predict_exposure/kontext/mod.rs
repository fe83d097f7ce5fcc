//! The method of the paper: a diffusion model that was trained to darken a picture by three stops.
//!
//! The model is in the crate `learned`; this module passes it a panorama, and turns its output into a gain.

use engine::{InputFile, NodeError};

#[cfg(not(feature = "learned"))]
mod absent;
#[cfg(feature = "learned")]
mod model;
#[cfg(feature = "learned")]
pub(super) mod picture;

/// Text for errors about a missing file: the files that a user must supply, where to find them, and their sizes.
pub(super) const WHERE: &str = "you must supply four files. `flux1-kontext-dev.safetensors` (23.8 GB; \
    a GGUF file with 4 bits per weight takes 6.7 GB) and `ae.safetensors` (0.3 GB) can be downloaded from \
    huggingface.co/black-forest-labs/FLUX.1-Kontext-dev after you accept the non-commercial licence there. The others \
    are the encoded prompt (4 MB) and a LoRA for exposure, made by `train-exposure --backend flux-kontext`. The \
    method needs memory for the transformer file plus 7 GB. See docs/kontext.md";

/// Hint for errors about a missing file. `None` in a build without the feature `learned`, which reports the missing
/// feature instead.
pub(super) const SUPPLIED: Option<&str> = if cfg!(feature = "learned") { Some(WHERE) } else { None };

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

impl<'a> Kontext<'a> {
    pub(super) fn files(&self) -> [&'a InputFile; 4] {
        [self.transformer, self.vae, self.prompt, self.lora]
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
}
