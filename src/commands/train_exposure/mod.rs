//! `train-exposure`: trains the weights of the learned exposure prediction.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::{Args, ValueEnum};
use learned::training::{self, Plan, Progress, Recipe, Score};

mod lora;

use lora::TrainLora;

use crate::session::Error;
use crate::terminal;
use crate::terminal::training::Follow;

/// Trains the learned exposure prediction on HDR panoramas.
#[derive(Debug, Args)]
pub struct TrainExposure {
    /// Folders of whole HDR panoramas, .exr or .hdr, at least 256x128
    #[arg(required = true)]
    panoramas: Vec<PathBuf>,
    /// The weights file to write; finished networks are kept next to it, so that an interrupted training can be
    /// continued
    #[arg(long, default_value = "exposure.safetensors")]
    out: PathBuf,
    /// Random seed
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Number of networks whose predictions are averaged
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=64))]
    members: u64,
    /// Number of folds of the cross-validation; panoramas of the same place are always in the same fold. 0 means no
    /// cross-validation
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u64).range(0..=64))]
    folds: u64,
    /// Number of procedural panoramas in addition to the panoramas in the folder
    #[arg(long, default_value_t = 160, value_parser = clap::value_parser!(u32).range(0..=100_000))]
    procedural: u32,
    /// Number of training steps of each network
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    steps: u64,
    /// A folder for the results of the cross-validation: recovered light of panoramas outside the training set, and
    /// predictions per region (`regions.csv`)
    #[arg(long)]
    recovered: Option<PathBuf>,
    /// A CSV file to write, with the data to which the amount of hidden light is fitted
    #[arg(long)]
    numbers: Option<PathBuf>,
    /// The model to train
    #[arg(long, value_enum, default_value_t = Backend::Networks)]
    backend: Backend,
    #[command(flatten)]
    lora: TrainLora,
}

/// The model to train.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Backend {
    /// The networks that `predict-exposure` uses by default
    Networks,
    /// A LoRA for `method: FluxKontext(..)`, with weights of your own
    FluxKontext,
}

impl TrainExposure {
    /// Trains the model. Returns exit code 0, 1 if a file cannot be read or written, or 130 if it is interrupted.
    pub fn run(self) -> Result<u8, Error> {
        match self.train() {
            Ok(code) => Ok(code),
            Err(message) => {
                terminal::error(&message);
                Ok(1)
            }
        }
    }

    fn train(&self) -> Result<u8, String> {
        if self.backend == Backend::FluxKontext {
            return self.lora.run(&panoramas(&self.panoramas)?, &self.out, self.seed, self.steps);
        }
        let panoramas = read(&panoramas(&self.panoramas)?)?;
        let recipe = Recipe { steps: self.steps as usize, ..Recipe::default() };
        let plan = Plan {
            seed: self.seed,
            members: self.members as usize,
            folds: self.folds as usize,
            procedural: self.procedural,
            recipe,
        };
        let mut follow = Follow::new();
        let stopped = follow.stopped();
        let mut show = |progress: Progress| {
            match progress {
                Progress::Examples(at, of) => follow.show("photographs".to_owned(), at as u64, of as u64),
                Progress::Step { network, networks, step, steps, loss } => {
                    let text = format!("network {network} of {networks}, loss {loss:.3}");
                    follow.show(text, ((network - 1) * steps + step) as u64, (networks * steps) as u64);
                }
            }
            !stopped.load(Ordering::Relaxed)
        };
        let parts = self.out.with_extension("parts");
        let trained = training::train(panoramas, &plan, &parts, &mut show).map_err(|e| e.to_string())?;
        follow.end();
        let Some(trained) = trained else {
            terminal::error("interrupted; run the same command again to continue");
            return Ok(130);
        };
        cache::publish_file(&self.out, &trained.weights).map_err(|e| e.to_string())?;
        if let Some(folder) = &self.recovered {
            for (name, bytes) in &trained.recovered {
                cache::publish_file(&folder.join(format!("{name}.exr")), bytes).map_err(|e| e.to_string())?;
            }
            let path = folder.join("regions.csv");
            cache::publish_file(&path, trained.regions.as_bytes()).map_err(|e| e.to_string())?;
        }
        if let Some(path) = &self.numbers {
            cache::publish_file(path, trained.numbers.as_bytes()).map_err(|e| e.to_string())?;
        }
        let text = format!(
            "{}{}wrote {} (bytes: {})\n",
            table("", &trained.scores),
            table(", finer", &trained.finer),
            self.out.display(),
            trained.weights.len()
        );
        terminal::print(&text).map_err(|e| e.to_string())?;
        Ok(0)
    }
}

/// The HDR panoramas in some folders, in order of their names. Two files with the same name, apart from the
/// extension, are an error, since results are stored by name.
fn panoramas(folders: &[PathBuf]) -> Result<Vec<PathBuf>, String> {
    let mut paths = Vec::new();
    for folder in folders {
        let failed = |error: std::io::Error| format!("cannot read `{}`: {error}", folder.display());
        let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
            .and_then(|entries| entries.map(|entry| entry.map(|e| e.path())).collect())
            .map_err(failed)?;
        let is = |path: &PathBuf, end: &str| path.extension().is_some_and(|it| it.eq_ignore_ascii_case(end));
        found.retain(|path| is(path, "exr") || is(path, "hdr"));
        if found.is_empty() {
            return Err(format!("`{}` contains no .exr or .hdr file", folder.display()));
        }
        paths.append(&mut found);
    }
    paths.sort_by_key(|path| (name(path), path.clone()));
    match paths.windows(2).find(|pair| name(&pair[0]) == name(&pair[1])) {
        Some([a, b]) => {
            Err(format!("`{}` and `{}` have the same name; rename one", a.display(), b.display()))
        }
        _ => Ok(paths),
    }
}

/// Name of a panorama: the name of its file without the extension.
fn name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn read(paths: &[PathBuf]) -> Result<Vec<(String, scene::types::Image<scene::types::Linear>)>, String> {
    let read = |path: &PathBuf| {
        let bytes = std::fs::read(path).map_err(|e| format!("cannot read `{}`: {e}", path.display()))?;
        let image = training::read(&path.display().to_string(), &bytes).map_err(|e| e.to_string())?;
        Ok((name(path), image))
    };
    paths.iter().map(read).collect()
}

/// Formats a table of the mean and median errors, in stops, over panoramas outside the training set. The table has
/// one row per measure of error, and `of` is appended to the title of each row.
fn table(of: &str, scores: &[Score]) -> String {
    if scores.is_empty() {
        return String::new();
    }
    let mut text = String::new();
    if of.is_empty() {
        text += "cross-validation by place: absolute error, stops   mean  median\n";
    }
    let mut row = |name: &str, value: &dyn Fn(&Score) -> f64| {
        let mut values: Vec<f64> = scores.iter().map(|score| value(score).abs()).collect();
        values.sort_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let name = format!("{name}{of}");
        text += &format!("{name:<48} {mean:>6.3} {:>7.3}\n", values[values.len() / 2]);
    };
    row("irradiance before recovery", &|s| s.irradiance[0]);
    row("irradiance after recovery", &|s| s.irradiance[1]);
    row("contrast before recovery", &|s| s.contrast[0]);
    row("contrast after recovery", &|s| s.contrast[1]);
    text
}
