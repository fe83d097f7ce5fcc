//! Estimate of the memory that an edit needs, which is computed before any weights are read.

use super::attention::MAX_SCORES;
use super::config::Config;
use super::conv::MAX_UNROLLED;
use super::loader::Tally;
use super::vae::VaeConfig;

/// Estimated memory, in bytes, that an edit needs when it is computed in f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    /// Memory of all weights, in the types in which they are stored.
    pub weights: u64,
    /// Memory of the largest matrix after its conversion to the type of the computation.
    pub widened: u64,
    /// Peak memory of all intermediate values.
    pub activations: u64,
}

impl Memory {
    /// Estimates the memory that an edit of a picture of `width` x `height` pixels needs, with a prompt of `texts`
    /// tokens.
    pub fn of(
        (config, transformer): (&Config, &Tally),
        (vae_config, vae): (&VaeConfig, &Tally),
        (width, height): (usize, usize),
        texts: usize,
    ) -> Self {
        const F32: usize = 4;
        let tokens = texts + 2 * (width / 16) * (height / 16);
        // For each token, a block holds: the token, its norm, queries, keys and values before and after their
        // rotation, the result of attention, and the hidden layer before and after the activation function.
        let numbers = tokens * (16 * config.hidden + 4 * config.mlp);
        let blocks = (numbers + 3 * MAX_SCORES) * F32;
        // The decoder needs most memory in a residual block with `widths[1]` channels at full size: for its input,
        // the norm of the input before and after the activation function, a padded copy, and the output.
        let channels = vae_config.widths.get(1).or(vae_config.widths.first()).copied().unwrap_or(0);
        let pixels = (6 * channels * width * height + MAX_UNROLLED) * F32;
        Self {
            weights: transformer.resident + vae.resident,
            widened: transformer.largest * F32 as u64,
            activations: blocks.max(pixels) as u64,
        }
    }

    /// Memory that an edit with the published model and a prompt of 512 tokens needs in addition to the weights. It
    /// is computed without opening any file.
    pub fn published(size: (usize, usize)) -> u64 {
        let config = Config::kontext();
        let largest = (config.hidden * (3 * config.hidden + config.mlp)) as u64;
        let transformer = Tally { largest, ..Tally::default() };
        Self::of((&config, &transformer), (&VaeConfig::flux(), &Tally::default()), size, 512).total()
    }

    /// The sum of all parts.
    pub fn total(&self) -> u64 {
        self.weights + self.widened + self.activations
    }
}
