//! Training of the learned prediction, on HDR panoramas and on ones made by formula.

mod amount;
mod examples;
mod procedural;
mod truth;
mod weights;

use std::path::Path;

use engine::{Digest, Notes};
use learned::exposure;
pub use learned::exposure::Recipe;

use self::examples::Course;
use self::truth::{Example, shrink};
use super::network::{CELL, Network as Forward, OVERVIEW, hidden};
use crate::error::Error;
use crate::io::exr::{self, Channel, Depth};
use crate::num;
use crate::types::{Image, Linear};
use crate::whole_sphere::light;

/// Width of the panoramas that examples are made of.
pub const WIDTH: usize = 256;

/// What may be chosen about a training.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Seed of everything that is left to chance.
    pub seed: u64,
    /// Networks whose predictions are averaged.
    pub members: usize,
    /// Parts that the places are divided into for cross-validation; 0 for none.
    pub folds: usize,
    /// Panoramas made by formula.
    pub procedural: u32,
    /// How the networks are trained.
    pub recipe: Recipe,
}

/// How far a training is.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress {
    /// Panoramas photographed, of how many.
    Examples(usize, usize),
    /// A step of a network.
    Step {
        /// The network, from 1.
        network: usize,
        /// How many networks are trained.
        networks: usize,
        /// The step, from 1.
        step: usize,
        /// How many steps each takes.
        steps: usize,
        /// The mean loss since the last report.
        loss: f32,
    },
}

/// The errors for one panorama that took no part in the training of what predicted it, in stops.
#[derive(Debug, Clone)]
pub struct Score {
    /// Name of the panorama.
    pub name: String,
    /// log2 of predicted over true mean irradiance: of the panorama as it is, and as predicted.
    pub irradiance: [f64; 2],
    /// log2 of predicted over true contrast of the dominant light, likewise.
    pub contrast: [f64; 2],
}

/// What a training gave.
pub struct Trained {
    /// The file of weights.
    pub weights: Vec<u8>,
    /// The cross-validation, in order of name.
    pub scores: Vec<Score>,
    /// The light recovered from each panorama by networks that never saw its place, as EXR, by name.
    pub recovered: Vec<(String, Vec<u8>)>,
    /// What the amount was fitted to, as comma-separated values, a line for each photograph.
    pub numbers: String,
}

/// Reads an HDR panorama, `.hdr` or `.exr`, and shrinks it to [`WIDTH`] columns.
pub fn read(name: &str, bytes: &[u8]) -> Result<Image<Linear>, Error> {
    let (width, height, mut rgb) = light(name, bytes, &mut Notes::none())?;
    if width < WIDTH || height < WIDTH / 2 || width != 2 * height {
        return Err(Error::format(
            name,
            format!("is {width}x{height}; a whole panorama of at least {WIDTH}x{} is wanted", WIDTH / 2),
        ));
    }
    rgb.iter_mut().for_each(|v| *v = if v.is_finite() { v.max(0.0) } else { 0.0 });
    Ok(shrink(width, height, &rgb))
}

/// The place that a panorama shows: files whose names differ in a number at the end, or in `_puresky`, show one.
pub fn place(name: &str) -> &str {
    let name = name.strip_suffix("_puresky").unwrap_or(name);
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if stem.len() < name.len() { stem.trim_end_matches('_') } else { name }
}

/// Trains. Networks that are done are kept in `parts` and not trained again. `tell` hears how far it is and
/// says whether to go on; a training that is stopped gives `None`.
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
    let (mut scores, mut squares, mut pictures) = (Vec::new(), Vec::new(), Vec::new());
    for fold in 0..plan.folds {
        let Some(file) = team(Some(fold), 0.0)? else { return Ok(None) };
        let forward = Forward::parse("cross-validation", &file, OVERVIEW, CELL)?;
        course.held_out(fold, plan.folds, |name, example| {
            let (score, errors) = judge(name, example, &forward);
            scores.push(score);
            squares.extend(errors);
            pictures.push(recovered(example, &forward).map(|bytes| (name.to_owned(), bytes)));
        });
    }
    scores.sort_by(|a, b| a.name.cmp(&b.name));
    let residual = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).max(0.0).sqrt();
    let weights = team(None, residual)?;
    let recovered = pictures.into_iter().collect::<Result<_, _>>()?;
    Ok(weights.map(|weights| Trained { weights, scores, recovered, numbers: course.numbers() }))
}

/// Regions count for the uncertainty that hold at least this share of the hidden light.
const MATTERS: f64 = 0.05;
/// Errors of regions are cut off at so many stops.
const LARGEST_ERROR: f64 = 4.0;

/// Scores the prediction for one example, and gives for each region that matters the square of its error in
/// stops less that of the disagreement.
fn judge(name: &str, example: &Example, network: &Forward) -> (Score, Vec<f64>) {
    let regions = regions_of(example);
    let predicted = hidden(network, &example.scene, regions);
    let errors = |cells: &[f64]| {
        let mut sums = example.visible;
        for (hidden, toward) in cells.iter().zip(&example.toward) {
            sums[0] += hidden;
            sums[1] += hidden * toward[0];
            sums[2] += hidden * toward[1];
        }
        let contrast = |[_, near, far]: [f64; 3]| (near / far.max(1e-9)).max(1e-4);
        let log = |a: f64, b: f64| num::f64::log2(a / b);
        [log(sums[0], example.truth[0]), log(contrast(sums), contrast(example.truth))]
    };
    let before = errors(&vec![0.0; predicted.cells.len()]);
    let mut of_region = vec![[0.0; 2]; regions];
    for (cell, (told, real)) in example.scene.cells.iter().zip(predicted.cells.iter().zip(&example.hidden)) {
        of_region[cell.region][0] += told;
        of_region[cell.region][1] += real;
    }
    let total: f64 = example.hidden.iter().sum();
    let square = |(region, [told, real]): (usize, &[f64; 2])| {
        let error = num::f64::log2(told.max(1e-12) / real).clamp(-LARGEST_ERROR, LARGEST_ERROR);
        let disagreement = predicted.disagreement[region];
        (*real > MATTERS * total && total > 0.0).then_some(error * error - disagreement * disagreement)
    };
    let squares = of_region.iter().enumerate().filter_map(square).collect();
    let after = errors(&predicted.with_suns(&example.scene).cells);
    let score =
        Score { name: name.to_owned(), irradiance: [before[0], after[0]], contrast: [before[1], after[1]] };
    (score, squares)
}

/// The light recovered from the plain photograph of a panorama, as EXR.
fn recovered(example: &Example, network: &Forward) -> Result<Vec<u8>, Error> {
    let predicted = hidden(network, &example.scene, regions_of(example)).with_suns(&example.scene);
    let mut samples: Vec<f32> = example.rgb.iter().flat_map(|rgb| rgb.map(|v| v as f32)).collect();
    for (cell, hidden) in example.scene.cells.iter().zip(&predicted.cells) {
        let gain = 1.0 + hidden / cell.flux.max(1e-12);
        samples[3 * cell.index..][..3].iter_mut().for_each(|v| *v = (f64::from(*v) * gain) as f32);
    }
    file(&samples)
}

fn regions_of(example: &Example) -> usize {
    example.scene.cells.iter().map(|cell| cell.region + 1).max().unwrap_or(0)
}

fn file(samples: &[f32]) -> Result<Vec<u8>, Error> {
    let channel = |(c, name): (usize, &str)| {
        let samples = samples.iter().skip(c).step_by(3).copied().collect();
        (Channel { name: name.to_owned(), samples }, Depth::Float)
    };
    let channels = ["R", "G", "B"].into_iter().enumerate().map(channel).collect();
    Ok(exr::write(WIDTH, WIDTH / 2, channels, "linear", None)?.0)
}

#[cfg(test)]
mod tests;
