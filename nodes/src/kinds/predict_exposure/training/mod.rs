//! Training of the learned prediction, on HDR panoramas and procedural panoramas.

mod amount;
mod examples;
mod judge;
mod procedural;
mod truth;
mod weights;

use std::path::Path;

use engine::{Digest, Notes};
use learned::exposure;
pub use learned::exposure::Recipe;

use self::examples::Course;
use self::judge::Judged;
use self::truth::shrink;
use super::network::{CELL, Network as Forward, OVERVIEW};
use crate::error::Error;
use crate::light::whole_sphere::light;
use crate::types::{Image, Linear};

/// Width of the panoramas in training, and the smallest width that is accepted.
pub const WIDTH: usize = 256;
/// Width of the finer panoramas, which are also evaluated: four pixels per cell of the grid.
pub const FINE: usize = 512;

/// Settings of a training run.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of networks whose predictions are averaged.
    pub members: usize,
    /// Number of folds of the cross-validation; 0 for no cross-validation.
    pub folds: usize,
    /// Number of procedural panoramas.
    pub procedural: u32,
    /// Training parameters of the networks.
    pub recipe: Recipe,
}

/// Progress of a training run.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress {
    /// Number of panoramas that have been photographed, and number of all panoramas.
    Examples(usize, usize),
    /// A step of a network.
    Step {
        /// Number of the network that is trained, counted from 1.
        network: usize,
        /// Number of networks to train.
        networks: usize,
        /// Number of the step, counted from 1.
        step: usize,
        /// Number of steps of each network.
        steps: usize,
        /// Mean loss since the last report.
        loss: f32,
    },
}

/// Errors for one held-out panorama, in stops.
#[derive(Debug, Clone)]
pub struct Score {
    /// Name of the panorama.
    pub name: String,
    /// log2 of the mean irradiance divided by its true value: first for the photograph without a prediction, then
    /// with the prediction.
    pub irradiance: [f64; 2],
    /// log2 of the contrast of the dominant light divided by its true value: first for the photograph without a
    /// prediction, then with the prediction.
    pub contrast: [f64; 2],
}

/// Result of a training run.
pub struct Trained {
    /// Bytes of the weights file.
    pub weights: Vec<u8>,
    /// Scores of the cross-validation, in order of name.
    pub scores: Vec<Score>,
    /// Scores for photographs of [`FINE`] columns, of the panoramas that have this size.
    pub finer: Vec<Score>,
    /// Name of each panorama, and the light recovered from its photograph, as the bytes of an EXR file. The
    /// networks that recovered the light were trained without the panoramas of the same location.
    pub recovered: Vec<(String, Vec<u8>)>,
    /// Predicted and true fluxes of each clipped region of the panoramas in `recovered`, as comma-separated values.
    pub regions: String,
    /// Data to which the model of the total hidden light was fitted, as comma-separated values, one line per
    /// photograph.
    pub numbers: String,
}

/// Reads an HDR panorama, `.hdr` or `.exr`, and shrinks it to [`FINE`] columns, or to [`WIDTH`] columns if it has
/// fewer than [`FINE`].
pub fn read(name: &str, bytes: &[u8]) -> Result<Image<Linear>, Error> {
    let (width, height, mut rgb) = light(name, bytes, &mut Notes::none())?;
    if width < WIDTH || height < WIDTH / 2 || width != 2 * height {
        return Err(Error::format(
            name,
            format!(
                "is {width}x{height}; a panorama must be twice as wide as high, and at least {WIDTH}x{}",
                WIDTH / 2
            ),
        ));
    }
    rgb.iter_mut().for_each(|v| *v = if v.is_finite() { v.max(0.0) } else { 0.0 });
    Ok(shrink((width, height), &rgb, if width < FINE { WIDTH } else { FINE }))
}

/// Name of the location that a panorama shows. Files whose names differ only in a number at the end, or in
/// `_puresky`, show the same location.
pub fn place(name: &str) -> &str {
    let name = name.strip_suffix("_puresky").unwrap_or(name);
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if stem.len() < name.len() { stem.trim_end_matches('_') } else { name }
}

/// Trains the networks. Each finished network is stored in the folder `parts`, so that it need not be trained
/// again. `tell` receives the progress and returns whether to continue. Returns `None` if `tell` stopped the
/// training.
pub fn train(
    panoramas: Vec<(String, Image<Linear>)>,
    plan: &Plan,
    parts: &Path,
    tell: &mut dyn FnMut(Progress) -> bool,
) -> Result<Option<Trained>, Error> {
    let Some(course) = Course::new(panoramas, plan, tell)? else { return Ok(None) };
    let digest = Digest::of(format!("{} {:?} {}", plan.seed, plan.recipe, course.digest()).as_bytes());
    let parts = parts.join(digest.to_string());
    let networks = (plan.folds + 1) * plan.members;
    let mut number = 0;
    let mut team = |fold: Option<usize>, residual: f64| -> Result<Option<Vec<u8>>, Error> {
        let chosen = course.chosen(fold, plan.folds);
        if chosen.is_empty() {
            let what = match fold {
                Some(_) => {
                    "in one fold of the cross-validation, none of the training panoramas has a clipped pixel: use fewer folds (`--folds`), more panoramas, or procedural panoramas (`--procedural`)"
                }
                None => {
                    "no panorama has a clipped pixel, so there is nothing to learn from: use more panoramas, or procedural panoramas (`--procedural`)"
                }
            };
            return Err(Error::Mismatch(what.to_owned()));
        }
        let scales = course.scales(&chosen);
        let amount = course.amount(&chosen, &scales);
        let mut scaled = None;
        let mut members = Vec::with_capacity(plan.members);
        for member in 0..plan.members {
            let fold = fold.map_or("all".to_owned(), |f| format!("{f}of{}", plan.folds));
            let path = parts.join(format!("{fold}-{member}.safetensors"));
            number += 1;
            if let Some(done) = weights::read_part(&path) {
                members.push(done);
                continue;
            }
            let examples = scaled.get_or_insert_with(|| course.scaled(&scales, &amount));
            let mut say = |step, loss| {
                let (network, steps) = (number, plan.recipe.steps);
                tell(Progress::Step { network, networks, step, steps, loss })
            };
            let seed = plan.seed.wrapping_mul(1_000_003).wrapping_add(member as u64);
            let network = exposure::train(examples, &chosen, &plan.recipe, seed, &mut say)
                .map_err(|error| Error::Mismatch(format!("training failed: {error}")))?;
            let Some(network) = network else { return Ok(None) };
            weights::write_part(&path, &network)?;
            members.push(network);
        }
        weights::file(&scales, &amount, &members, residual as f32).map(Some)
    };
    let mut regions = judge::COLUMNS.to_owned();
    let (mut held, mut finer) = (Vec::new(), Vec::new());
    for fold in 0..plan.folds {
        let Some(file) = team(Some(fold), 0.0)? else { return Ok(None) };
        let forward = Forward::parse("cross-validation", &file, OVERVIEW, CELL)?;
        for of in course.held_out(fold, plan.folds) {
            let judged = Judged::new(&of.name, &of.plain, &forward)?;
            regions += &judged.lines(fold);
            held.push(judged);
            finer.extend(of.fine.iter().map(|example| judge::judged(&of.name, example, &forward)));
        }
    }
    held.sort_by(|a, b| a.score.name.cmp(&b.score.name));
    finer.sort_by(|a, b| a.name.cmp(&b.name));
    let residual = judge::residual(&held);
    let Some(weights) = team(None, residual)? else { return Ok(None) };
    let scores = held.iter().map(|judged| judged.score.clone()).collect();
    let recovered = held.into_iter().map(|judged| (judged.score.name, judged.recovered)).collect();
    Ok(Some(Trained { weights, scores, finer, recovered, regions, numbers: course.numbers() }))
}

#[cfg(test)]
mod tests;
