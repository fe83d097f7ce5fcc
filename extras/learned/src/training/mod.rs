//! Training of the learned prediction, on HDR panoramas and procedural panoramas.

mod examples;
mod judge;
mod plan;
mod procedural;
mod ridge;
mod truth;
mod weights;

use std::path::Path;

use crate::exposure;
pub use crate::exposure::Recipe;
use engine::{Digest, Notes};
use render::light::whole_sphere::light;
use scene::error::Error;
use scene::types::{Image, Linear};

use self::examples::Course;
pub use self::examples::place;
use self::judge::Judged;
pub use self::judge::Score;
pub use self::plan::{Plan, Progress};
use self::truth::shrink;
pub use self::truth::{FINE, WIDTH};
use render::light::hidden::network::{CELL, COLOUR, Network as Forward, OVERVIEW};

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
                "is {width}x{height} pixels; a panorama must be twice as wide as high, and at least {WIDTH}x{}",
                WIDTH / 2
            ),
        ));
    }
    rgb.iter_mut().for_each(|v| *v = if v.is_finite() { v.max(0.0) } else { 0.0 });
    Ok(shrink((width, height), &rgb, if width < FINE { WIDTH } else { FINE }))
}

/// Trains the networks. Each finished network is stored in the folder `parts`, so that it need not be trained
/// again. `on_progress` receives the progress and returns whether to continue. Returns `None` if `on_progress`
/// stopped the training.
pub fn train(
    panoramas: Vec<(String, Image<Linear>)>,
    plan: &Plan,
    parts: &Path,
    on_progress: &mut dyn FnMut(Progress) -> bool,
) -> Result<Option<Trained>, Error> {
    let Some(course) = Course::new(panoramas, plan, on_progress)? else { return Ok(None) };
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
        let (amount, colour) = (course.amount(&chosen, &scales), course.colour(&chosen, &scales));
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
            let mut on_step = |step, loss| {
                let (network, steps) = (number, plan.recipe.steps);
                on_progress(Progress::Step { network, networks, step, steps, loss })
            };
            let seed = plan.seed.wrapping_mul(1_000_003).wrapping_add(member as u64);
            let network = exposure::train(examples, &chosen, &plan.recipe, seed, &mut on_step)
                .map_err(|error| Error::Mismatch(format!("training failed: {error}")))?;
            let Some(network) = network else { return Ok(None) };
            weights::write_part(&path, &network)?;
            members.push(network);
        }
        weights::file(&scales, (&amount, &colour), &members, residual as f32).map(Some)
    };
    let mut regions = judge::COLUMNS.to_owned();
    let (mut held, mut finer) = (Vec::new(), Vec::new());
    for fold in 0..plan.folds {
        let Some(file) = team(Some(fold), 0.0)? else { return Ok(None) };
        let forward = Forward::parse("cross-validation", &file, [OVERVIEW, CELL, COLOUR])?;
        for of in course.held_out(fold, plan.folds) {
            let judged = Judged::new(&of.name, &of.plain, &forward)?;
            regions += &judged.lines(fold);
            held.push(judged);
            finer.extend(of.fine.iter().map(|example| judge::judged(&of.name, example, &forward)));
        }
    }
    held.sort_by(|a, b| a.score.name.cmp(&b.score.name));
    finer.sort_by(|a, b| a.name.cmp(&b.name));
    let residual = if held.is_empty() { judge::RESIDUAL } else { judge::residual(&held) };
    let Some(weights) = team(None, residual)? else { return Ok(None) };
    let scores = held.iter().map(|judged| judged.score.clone()).collect();
    let recovered = held.into_iter().map(|judged| (judged.score.name, judged.recovered)).collect();
    Ok(Some(Trained { weights, scores, finer, recovered, regions, numbers: course.numbers() }))
}

#[cfg(test)]
mod tests;
