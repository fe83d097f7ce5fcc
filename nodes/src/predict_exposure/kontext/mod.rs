//! The paper's own way: a diffusion model that was taught to show a picture at three stops less.
//!
//! What is computed is in the crate `learned`; here a panorama is handed to it, and what it shows becomes a gain.

use engine::InputFile;

#[cfg(not(feature = "learned"))]
mod absent;
#[cfg(feature = "learned")]
mod model;
#[cfg(feature = "learned")]
pub(super) mod picture;

/// Where its weights are to be had.
#[cfg(feature = "learned")]
pub(super) const SUPPLIED: Option<&str> = Some(learned::flux::WHERE);
/// A build without it says that instead.
#[cfg(not(feature = "learned"))]
pub(super) const SUPPLIED: Option<&str> = None;

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
