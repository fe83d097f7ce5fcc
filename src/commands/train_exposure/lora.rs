//! `train-exposure --backend flux-kontext`: training of a LoRA that makes panoramas three stops darker.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::Args;
use learned::lora::{self, LoraPlan, LoraProgress};

use crate::terminal;
use crate::terminal::training::Follow;

/// Arguments of the training of a LoRA.
#[derive(Debug, Args)]
#[command(next_help_heading = "Options of --backend flux-kontext")]
pub struct TrainLora {
    /// The transformer of Flux.1 Kontext: safetensors (or its first shard) or GGUF
    #[arg(long, default_value = "flux1-kontext-dev.safetensors")]
    transformer: PathBuf,
    /// The autoencoder of Flux.1 Kontext
    #[arg(long, default_value = "ae.safetensors")]
    vae: PathBuf,
    /// The encoded prompt: tensors `t5` and `clip`
    #[arg(long, default_value = "prompt.safetensors")]
    prompt: PathBuf,
    /// Rank of the updates; alpha has the same value
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u64).range(1..=1024))]
    rank: u64,
    /// Learning rate: the approximate change of a weight per step
    #[arg(long, default_value_t = 1e-4)]
    rate: f64,
    /// Width of the training panoramas in pixels, a multiple of 32
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u64).range(32..=4096))]
    width: u64,
}

impl TrainLora {
    /// Trains on `panoramas` and writes `out`. Returns exit code 130 if it is interrupted.
    pub fn run(&self, panoramas: &[PathBuf], out: &Path, seed: u64, steps: u64) -> Result<u8, String> {
        if !(self.width.is_multiple_of(32) && self.rate > 0.0 && self.rate <= 1.0) {
            return Err(
                "`--width` must be a multiple of 32, and `--rate` must be above 0 and at most 1".to_owned()
            );
        }
        let plan = LoraPlan {
            transformer: self.transformer.clone(),
            vae: self.vae.clone(),
            prompt: self.prompt.clone(),
            rank: self.rank as usize,
            rate: self.rate,
            seed,
            steps,
            width: self.width as usize,
        };
        let mut follow = Follow::new();
        let stopped = follow.stopped();
        // Moving average of the loss. Every step has another noise level, so a single loss means little.
        let mut smooth: Option<f32> = None;
        let mut show = |progress: LoraProgress| {
            let (text, at, of) = match progress {
                LoraProgress::Pairs(at, of) => ("panoramas".to_owned(), at as u64, of as u64),
                LoraProgress::Step(at, of, loss) => {
                    let mean = smooth.map_or(loss, |mean| mean + 0.05 * (loss - mean));
                    smooth = Some(mean);
                    (format!("loss {mean:.4}"), at, of)
                }
            };
            follow.show(text, at, of);
        };
        let is_stopped = || stopped.load(Ordering::Relaxed);
        let done = lora::train(panoramas, &plan, out, &is_stopped, &mut show).map_err(|e| e.to_string())?;
        follow.end();
        if !done {
            terminal::error("interrupted; run the same command again to continue");
            return Ok(130);
        }
        let loss = smooth.map_or(String::new(), |loss| format!(", loss {loss:.4}"));
        terminal::print(&format!("wrote {} (steps: {steps}{loss})\n", out.display()))
            .map_err(|e| e.to_string())?;
        Ok(0)
    }
}
