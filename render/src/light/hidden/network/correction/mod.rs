//! Correction of the predicted hidden light by small convolutional networks, which see maps of the whole panorama. They
//! correct the amount that the regression predicts, and distribute the light over the clipped cells.

mod layers;
mod maps;
mod member;
#[cfg(test)]
mod tests;

use scene::error::Error;
use scene::math::nn::Weights;
use scene::math::num;

pub use self::maps::Maps;
use self::member::{LAYERS, Member};
use super::scale::{LIMITS, scaled};

/// Part of the mean correction of the networks that is added to the amount. The whole of it was worse in
/// cross-validation (docs/evidence/light.md).
const PART: f64 = 0.5;

/// An ensemble of networks of the same shape.
pub struct Correction {
    /// Means and standard deviations of the features of the panorama.
    scale: (Vec<f32>, Vec<f32>),
    members: Vec<Member>,
}

/// Result for one panorama.
pub struct Corrected {
    /// Term to be added to log2 of the ratio of hidden to visible flux.
    pub amount: f64,
    /// For each network, the share of the hidden light that each cell receives.
    pub shares: Vec<Vec<f64>>,
}

impl Correction {
    /// Reads the tensors `map.*` of a weights file; `None` if it has none. `file` is the name of the file for messages,
    /// and `features` the number of features of the panorama.
    pub fn parse(file: &str, weights: &Weights<'_>, features: usize) -> Result<Option<Self>, Error> {
        let names = LAYERS.iter().flat_map(|(name, ..)| [weight_of(name), bias_of(name)]);
        let scale_names = ["map.mean", "map.spread"];
        if !names.chain(scale_names.map(str::to_owned)).any(|name| weights.has(&name)) {
            return Ok(None);
        }
        let count = weights.tensor(&weight_of(LAYERS[0].0))?.0.first().copied().unwrap_or_default();
        let sized = |name: &str, wanted: &[usize]| {
            let (shape, values) = weights.tensor(name)?;
            if shape != wanted {
                let what = format!("tensor `{name}` has shape {shape:?} instead of {wanted:?}");
                return Err(Error::format(file, what));
            }
            Ok(values)
        };
        let [mean, spread] = scale_names.map(|name| sized(name, &[features]));
        let (mean, spread) = (mean?, spread?);
        if spread.iter().any(|v| *v <= 0.0) {
            return Err(Error::format(file, "tensor `map.spread` contains a value that is not above 0"));
        }
        let mut layers: Vec<Vec<(Vec<f32>, Vec<f32>)>> = vec![Vec::with_capacity(LAYERS.len()); count];
        for (name, inputs, outputs) in LAYERS {
            let weight = sized(&weight_of(name), &[count, inputs, outputs])?;
            let bias = sized(&bias_of(name), &[count, outputs])?;
            let of_members = weight.chunks_exact(inputs * outputs).zip(bias.chunks_exact(outputs));
            for (layers, (weight, bias)) in layers.iter_mut().zip(of_members) {
                layers.push((weight.to_vec(), bias.to_vec()));
            }
        }
        let members = layers.into_iter().map(Member::new).collect();
        Ok(Some(Self { scale: (mean, spread), members }))
    }

    /// Computes the correction for a panorama with the features `overview` and the maps `maps`. `places` holds, for each
    /// clipped cell, its index in a map, and `flux` its visible flux.
    pub fn apply(&self, overview: &[f32], maps: &Maps, places: &[usize], flux: &[f64]) -> Corrected {
        let (mean, spread) = &self.scale;
        let overview = scaled(overview, (mean.as_slice(), spread), LIMITS[0]);
        let mut corrected = Corrected { amount: 0.0, shares: Vec::with_capacity(self.members.len()) };
        let mirrored = maps.mirrored();
        for member in &self.members {
            // The mean over the panorama and its mirror image, so that mirrored panoramas have mirrored light.
            let (plain, mirror) =
                (member.apply(maps.map(), &overview), member.apply(mirrored.map(), &overview));
            corrected.amount += PART * 0.5 * (plain.amount + mirror.amount) / self.members.len() as f64;
            let score = |at: &usize| {
                0.5 * (f64::from(plain.scores[*at]) + f64::from(mirror.scores[Maps::mirror(*at)]))
            };
            let scores: Vec<f64> = places.iter().map(score).collect();
            corrected.shares.push(shares(&scores, flux));
        }
        corrected
    }
}

/// Shares of the hidden light: proportional to the visible flux times the exponential of the score.
fn shares(scores: &[f64], flux: &[f64]) -> Vec<f64> {
    let largest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> =
        scores.iter().zip(flux).map(|(score, flux)| num::f64::exp(score - largest) * flux).collect();
    let total: f64 = weights.iter().sum();
    weights.into_iter().map(|w| if total > 0.0 { w / total } else { 0.0 }).collect()
}

fn weight_of(layer: &str) -> String {
    format!("map.{layer}.weight")
}

fn bias_of(layer: &str) -> String {
    format!("map.{layer}.bias")
}
