//! One network: maps of half, a quarter and an eighth of the size, a summary of the panorama, and back to the full size.

use scene::math::num;

use super::super::features::OVERVIEW;
use super::layers::{Layer, Map, activate};
use super::maps::CHANNELS;

/// Channels of the maps, from the finest to the coarsest.
const WIDTHS: [usize; 4] = [12, 20, 28, 40];
/// Number of weighted means over the coarsest map.
const MEANS: usize = 4;
/// Number of units of the summary.
const UNITS: usize = 32;
/// Cells of a convolution.
const TAPS: usize = 9;
/// Largest absolute correction of the amount, in stops.
const REACH: f64 = 2.0;

/// Names in the weights file, numbers of inputs and numbers of outputs of the layers.
pub const LAYERS: [(&str, usize, usize); 17] = [
    ("a0", TAPS * CHANNELS, WIDTHS[0]),
    ("a1", TAPS * WIDTHS[0], WIDTHS[1]),
    ("b1", TAPS * WIDTHS[1], WIDTHS[1]),
    ("a2", TAPS * WIDTHS[1], WIDTHS[2]),
    ("b2", TAPS * WIDTHS[2], WIDTHS[2]),
    ("a3", TAPS * WIDTHS[2], WIDTHS[3]),
    ("b3", TAPS * WIDTHS[3], WIDTHS[3]),
    ("att", WIDTHS[3], MEANS),
    ("h1", (1 + MEANS) * WIDTHS[3] + OVERVIEW, UNITS),
    ("h2", UNITS, 1),
    ("gl", UNITS, WIDTHS[3]),
    ("u2", WIDTHS[3] + WIDTHS[2], WIDTHS[2]),
    ("v2", TAPS * WIDTHS[2], WIDTHS[2]),
    ("u1", WIDTHS[2] + WIDTHS[1], WIDTHS[1]),
    ("v1", TAPS * WIDTHS[1], WIDTHS[1]),
    ("u0", WIDTHS[1] + WIDTHS[0], WIDTHS[0]),
    ("s", WIDTHS[0], 1),
];

/// The layers of a network, in the order of [`LAYERS`].
pub struct Member {
    layers: Vec<Layer>,
}

/// Result of one network.
pub struct Output {
    /// Correction of the amount in stops, at most [`REACH`].
    pub amount: f64,
    /// Score of each cell of the map.
    pub scores: Vec<f32>,
}

impl Member {
    pub fn new(layers: Vec<(Vec<f32>, Vec<f32>)>) -> Self {
        Self { layers: layers.into_iter().map(Layer::new).collect() }
    }

    /// Computes the result for a map of [`CHANNELS`] channels. `overview` holds the scaled features of the panorama.
    pub fn apply(&self, map: &Map, overview: &[f32]) -> Output {
        let [a0, a1, b1, a2, b2, a3, b3, attention, summary, amount, back, u2, v2, u1, v1, u0, score] =
            std::array::from_fn(|i| &self.layers[i]);
        let refined = |map: Map, layer: &Layer| layer.convolved(&map).activated().plus(&map);
        let coarser = |map: &Map, first: &Layer, second: &Layer| {
            refined(first.convolved(&map.halved()).activated(), second)
        };
        let finest = a0.convolved(map).activated();
        let half = coarser(&finest, a1, b1);
        let quarter = coarser(&half, a2, b2);
        let eighth = coarser(&quarter, a3, b3);

        let summary: Vec<f32> =
            summary.affine(&means(&eighth, attention, overview)).into_iter().map(activate).collect();
        let amount = f64::from(amount.affine(&summary)[0]);
        let eighth = eighth.plus_everywhere(&back.affine(&summary));

        let merged =
            |coarse: &Map, fine: &Map, layer: &Layer| layer.cells(&coarse.doubled_with(fine)).activated();
        let quarter = refined(merged(&eighth, &quarter, u2), v2);
        let half = refined(merged(&quarter, &half, u1), v1);
        let scores = score.cells(&merged(&half, &finest, u0)).values;
        Output { amount: REACH * tanh(amount / REACH), scores }
    }
}

/// The mean over the sphere, [`MEANS`] means with the weights of `attention`, and `overview`.
fn means(map: &Map, attention: &Layer, overview: &[f32]) -> Vec<f32> {
    let sphere = 4.0 * std::f64::consts::PI;
    let size = |at: usize| -> f64 {
        let edge = |y: usize| num::f64::cos(std::f64::consts::PI * y as f64 / map.height as f64);
        let y = at / map.width;
        (edge(y) - edge(y + 1)) * 2.0 * std::f64::consts::PI / map.width as f64
    };
    let cells = || map.values.chunks_exact(map.channels).enumerate();
    let mean = |weight: &dyn Fn(usize) -> f64| -> Vec<f32> {
        let mut sums = vec![0.0_f64; map.channels];
        for (at, cell) in cells() {
            let weight = weight(at);
            sums.iter_mut().zip(cell).for_each(|(sum, v)| *sum += weight * f64::from(*v));
        }
        sums.into_iter().map(|v| v as f32).collect()
    };
    let mut out = mean(&|at| size(at) / sphere);
    let logits = attention.cells(map).values;
    for head in 0..MEANS {
        let logit = |at: usize| f64::from(logits[at * MEANS + head]);
        let count = map.width * map.height;
        let largest = (0..count).map(logit).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = (0..count).map(|at| size(at) * num::f64::exp(logit(at) - largest)).collect();
        let total: f64 = weights.iter().sum();
        out.extend(mean(&|at| weights[at] / total));
    }
    out.extend_from_slice(overview);
    out
}

fn tanh(x: f64) -> f64 {
    let e = num::f64::exp(-2.0 * x.abs());
    ((1.0 - e) / (1.0 + e)).copysign(x)
}
