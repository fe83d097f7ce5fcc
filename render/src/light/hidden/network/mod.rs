//! Learned prediction: the amount and distribution of light hidden by clipping.

mod blur;
mod correction;
mod features;
mod input;
mod net;
mod overview;
mod rings;
mod scale;
#[cfg(test)]
mod tests;

use crate::light::energy_table::EnergyTable;
use crate::light::measure::luminance;
use engine::{Context, NodeError};
use scene::error::Error;
use scene::math::num;
use scene::types::{Data, Image};

use super::clipped::{Clipped, RegionLight};
use super::spread::Spread;
use super::sun;

pub use self::features::{CELL, COLOUR, OVERVIEW};
pub use self::input::Scene;
pub use self::net::{AMOUNT, HUE, Network};
pub use self::scale::LIMITS;

/// Built-in weights: safetensors in f16, made by `train-exposure` as described in docs/light.md.
pub const WEIGHTS: &[u8] = include_bytes!("../../../../weights/exposure.safetensors");
/// Name of the built-in weights in messages.
pub const FILE: &str = "exposure.safetensors";

/// Reads a weights file. `file` is the name of the file for messages.
pub fn parse(file: &str, bytes: &[u8]) -> Result<Network, Error> {
    Network::parse(file, bytes, [OVERVIEW, CELL, COLOUR])
}

/// The hidden light that an ensemble of networks predicts.
pub struct Hidden {
    /// Hidden flux of each clipped cell, the mean of the networks.
    pub cells: Vec<f64>,
    /// Standard deviation of the networks for each region, in stops.
    pub disagreement: Vec<f64>,
}

/// Prediction for a panorama.
pub struct Predicted {
    /// log2 gain of each pixel; 0 outside clipped regions.
    pub log2_gain: Vec<f32>,
    /// RGB of the hidden light of each pixel, at a luminance of 1; 0 outside clipped regions.
    pub colour: Image<Data>,
    /// The light that each region gains.
    pub regions: Vec<RegionLight>,
}

/// Number of stops by which the predicted ratio of total to visible flux is lowered. This slightly increases the mean
/// error, but hidden light is predicted less often for panoramas that have none.
const CAUTION: f64 = 0.1;

/// Hidden flux after lowering the ratio of total to visible flux by a tenth of a stop; at least 0.
pub fn cautious(hidden: f64, visible: f64) -> f64 {
    (visible * ((1.0 + hidden / visible) * num::f64::exp2(-CAUTION) - 1.0)).max(0.0)
}

/// Averages the predictions of the members of `network` for `scene`. `regions` is the number of clipped regions. If there
/// is a correction, its distributions count as much as those of the members.
pub fn hidden(network: &Network, scene: &Scene, regions: usize) -> Hidden {
    let features: Vec<&[f32]> = scene.cells.iter().map(|cell| cell.features.as_slice()).collect();
    let flux: Vec<f64> = scene.cells.iter().map(|cell| cell.flux).collect();
    let prediction = network.predict(&scene.overview, &features, &flux);
    let corrected = network.correction.as_ref().map(|correction| {
        let places: Vec<usize> = scene.cells.iter().map(|cell| scene.maps.place(cell.index)).collect();
        correction.apply(&scene.overview, &scene.maps, &places, &flux)
    });
    let amount = prediction.amount + corrected.as_ref().map_or(0.0, |corrected| corrected.amount);
    let ensembles: Vec<Vec<Vec<f64>>> =
        [prediction.shares].into_iter().chain(corrected.map(|corrected| corrected.shares)).collect();
    let weight = |members: usize| 1.0 / (ensembles.len() * members) as f64;
    let members: Vec<(f64, &Vec<f64>)> =
        ensembles.iter().flat_map(|shares| shares.iter().map(|s| (weight(shares.len()), s))).collect();
    let total = cautious(scene.open_flux * num::f64::exp2(amount.clamp(-AMOUNT, AMOUNT)), scene.visible());
    let mut cells = vec![0.0; flux.len()];
    let mut logs = vec![Vec::with_capacity(members.len()); regions];
    for &(weight, shares) in &members {
        let mut of_region = vec![0.0; regions];
        for ((sum, share), cell) in cells.iter_mut().zip(shares).zip(&scene.cells) {
            *sum += weight * total * share;
            of_region[cell.region] += share;
        }
        for (log, share) in logs.iter_mut().zip(of_region) {
            log.push((weight, num::f64::log2(share.max(1e-12))));
        }
    }
    let deviation = |logs: &Vec<(f64, f64)>| {
        let mean: f64 = logs.iter().map(|(weight, log)| weight * log).sum();
        logs.iter().map(|(weight, log)| weight * (log - mean) * (log - mean)).sum::<f64>().sqrt()
    };
    Hidden { cells, disagreement: logs.iter().map(deviation).collect() }
}

impl Hidden {
    /// Raises the light of the sun in a clear sky to at least its lower bound. Limits the light of clipped surfaces
    /// that the sun illuminates to the brightness of white paper.
    pub fn with_suns(mut self, scene: &Scene) -> Self {
        for (region, sun) in scene.suns.iter().enumerate().filter(|(_, sun)| **sun > 0.0) {
            let least = sun * sun::FLUX * scene.open_flux;
            let own = || scene.cells.iter().enumerate().filter(|(_, cell)| cell.region == region);
            let reported: f64 = own().map(|(i, _)| self.cells[i]).sum();
            if reported > 0.0 && reported < least {
                own().for_each(|(i, _)| self.cells[i] *= least / reported);
            }
        }
        self.lit_below(scene)
    }

    /// Limits the light predicted below the horizon. By daylight, clipped pixels there are lit surfaces and
    /// not lamps, and a white surface reflects at most its irradiance over pi. Light predicted beyond that is
    /// moved above the horizon.
    fn lit_below(mut self, scene: &Scene) -> Self {
        let certain = scene.suns.iter().copied().fold(0.0, f64::max);
        let above: f64 =
            self.cells.iter().zip(&scene.cells).filter(|(_, cell)| cell.sine > 0.0).map(|(v, _)| v).sum();
        if certain <= 0.0 || above <= 0.0 {
            return self;
        }
        let white = (scene.above + above) / std::f64::consts::PI;
        let mut moved = 0.0;
        for (hidden, cell) in self.cells.iter_mut().zip(&scene.cells).filter(|(_, cell)| cell.sine < 0.0) {
            let too_much = certain * (*hidden - (white * cell.size - cell.flux).max(0.0)).max(0.0);
            *hidden -= too_much;
            moved += too_much;
        }
        for (hidden, _) in self.cells.iter_mut().zip(&scene.cells).filter(|(_, cell)| cell.sine > 0.0) {
            *hidden *= 1.0 + moved / above;
        }
        self
    }
}

/// Predicts the log2 gain of every pixel, which is 0 outside clipped regions, the colour of hidden light, and the light
/// that each region gains.
pub fn predict(
    network: &Network,
    clipped: &Clipped<'_>,
    energies: &mut EnergyTable,
    cx: &Context,
) -> Result<Predicted, NodeError> {
    let Clipped { up, pixels, mask, ceiling, ref grid, ref labels, .. } = *clipped;
    let scene = Scene::new(grid, up, labels, ceiling);
    cx.check()?;
    cx.progress(0.4);
    let mut log2_gain = vec![0.0_f32; mask.len()];
    let hidden = hidden(network, &scene, labels.count).with_suns(&scene);
    let mut light: Vec<f64> = grid.rgb.iter().map(|rgb| luminance(*rgb)).collect();
    let mut enter = |step: &'static str, light: &[f64]| {
        let cell = |c: usize| (grid.direction(up, c), grid.solid_angle(c), light[c]);
        energies.record(step, grid.height, cx, |y| (y * grid.width..(y + 1) * grid.width).map(cell))
    };
    if !scene.cells.is_empty() {
        enter("on the grid", &light)?;
        for (cell, hidden) in scene.cells.iter().zip(&hidden.cells) {
            light[cell.index] += hidden / grid.solid_angle(cell.index);
        }
        enter("predicted on the grid", &light)?;
    }
    // Log of hidden over visible light of each clipped cell; cells of a region are interpolated.
    let mut log_ratio = vec![None; grid.rgb.len()];
    let mut excess = vec![0.0; labels.count];
    for (cell, hidden) in scene.cells.iter().zip(&hidden.cells) {
        excess[cell.region] += hidden;
        if cell.flux > 0.0 {
            log_ratio[cell.index] = Some(num::f64::log2((hidden / cell.flux).max(1e-12)));
        }
    }
    let profile = |region: usize, at: usize| {
        let place = grid.place(at % pixels.width, at / pixels.width, pixels.height);
        let [(left, right_part), (top, low_part)] =
            place.map(|at| ((at - 0.5).floor(), (at - 0.5) - (at - 0.5).floor()));
        let (mut sum, mut total) = (0.0, 0.0);
        for (row, of_row) in [(top, 1.0 - low_part), (top + 1.0, low_part)] {
            for (column, of_column) in [(left, 1.0 - right_part), (left + 1.0, right_part)] {
                let row = row.clamp(0.0, (grid.height - 1) as f64) as usize;
                let column = (column + grid.width as f64) as usize % grid.width;
                let (cell, weight) = (row * grid.width + column, of_row * of_column);
                if let Some(ratio) = log_ratio[cell]
                    && labels.of[cell] == Some(region as u32)
                {
                    sum += weight * ratio;
                    total += weight;
                }
            }
        }
        if total > 0.0 { num::f64::exp2(sum / total) } else { 1.0 }
    };
    let spread = Spread::new(pixels, mask, grid, labels, profile, cx)?;
    let mut found = Vec::with_capacity(labels.count);
    let mut colour = Image::<Data>::new(pixels.width, pixels.height, 3);
    for (i, excess) in excess.into_iter().enumerate() {
        let given = spread.apply(i, excess, pixels, &mut log2_gain);
        let rgb = network.colour(&scene.colours[i]);
        for at in spread.pixels(i) {
            colour.samples[3 * at..][..3].copy_from_slice(&rgb.map(|v| v as f32));
        }
        // The increase of the gain for one standard deviation more hidden light, in its logarithm.
        let disagreement = hidden.disagreement[i];
        let error = (network.residual * network.residual + disagreement * disagreement).sqrt();
        let ratio = (num::f64::exp2(given.mean_log2_gain) - 1.0) * num::f64::exp2(error);
        let uncertainty = Some(num::f64::log2(1.0 + ratio) - given.mean_log2_gain);
        found.push(RegionLight {
            sun: scene.suns[i] > 0.0,
            uncertainty,
            colour: Some(rgb),
            ..clipped.found(i, spread.solid_angle[i], given)
        });
    }
    cx.progress(0.8);
    Ok(Predicted { log2_gain, colour, regions: found })
}
