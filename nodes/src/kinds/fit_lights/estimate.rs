//! Robust estimate of hidden fluxes from the ratios of the colours of neighbouring points.

use std::f64::consts::LN_2;

use render::light::measure::luminance;
use scene::math::num;

use super::pairs::Pair;
use super::system::Matrix;

/// Scales of the robust comparison, as natural logarithms, from the first stage to the last. The first stages let
/// the fit leave a poor prediction.
const SPREADS: [f64; 4] = [1.0, 0.5, LAST, LAST];
/// Scale of the last stage.
const LAST: f64 = 0.25;
/// Steps per stage.
const STEPS: usize = 8;
/// Longest step of an unknown, as a natural logarithm.
const LONGEST: f64 = 1.0;
/// Known light that every point receives in addition, relative to the median, so that no logarithm is infinite.
const FLOOR: f64 = 0.01;
/// Number of parts of the place whose separate estimates are compared.
const PARTS: u32 = 4;

/// Standard deviations of what is assumed about the light before the place is looked at, in stops.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prior {
    /// Deviation of the hidden light of one emitter.
    pub emitter: f64,
    /// Deviation of one channel of this light.
    pub colour: f64,
    /// Deviation of the hidden light of all emitters together.
    pub total: f64,
    /// Deviation of the known light, which the surfaces of the place show.
    pub known: f64,
    /// Deviation of one channel of the known light.
    pub known_colour: f64,
}

/// Points with the light that they receive, and pairs of points that are compared.
pub(super) struct Observed {
    /// Natural logarithm of the captured radiance of each point.
    pub logs: Vec<[f64; 3]>,
    /// Irradiance of each point from surfaces and sky that are not clipped.
    pub known: Vec<[f64; 3]>,
    /// Displayed light of the emitters, and all light of emitters that are not fitted.
    pub shown: Vec<[f64; 3]>,
    /// Irradiance of each point by each emitter, for a hidden flux of 1.
    pub by_emitter: Vec<Vec<f64>>,
    /// Pairs of points.
    pub pairs: Vec<Pair>,
    /// Group of each point. Errors of points in one group are correlated.
    pub groups: Vec<u32>,
    /// Number of groups.
    pub group_count: usize,
    /// Part of the place that each point is in, below [`PARTS`].
    pub parts: Vec<u32>,
}

/// The estimate.
pub(super) struct Estimate {
    /// Hidden flux of each emitter.
    pub fluxes: Vec<[f64; 3]>,
    /// Standard error of the luminance of each of these fluxes, in stops.
    pub error_stops: Vec<f64>,
    /// The same without the comparison.
    pub prior_stops: Vec<f64>,
    /// Factor of the known light.
    pub known: [f64; 3],
    /// Cost of each group of pairs with constant light, with the predicted fluxes, and with the estimate.
    pub costs: [Vec<f64>; 3],
}

impl Observed {
    /// Natural logarithm of the light of each point, and the share of each emitter (then of the known light) in it.
    fn lights(&self, unknown: &[f64]) -> (Vec<[f64; 3]>, Vec<Vec<[f64; 3]>>) {
        let emitters = self.by_emitter.len();
        let factor = |index: usize| [0, 1, 2].map(|c| num::f64::exp(unknown[3 * index + c]));
        let factors: Vec<[f64; 3]> = (0..=emitters).map(factor).collect();
        let mut logs = Vec::with_capacity(self.logs.len());
        let mut shares = vec![Vec::with_capacity(self.logs.len()); emitters + 1];
        for point in 0..self.logs.len() {
            let part = |index: usize, channel: usize| {
                let of = self.by_emitter.get(index).map_or(self.known[point][channel], |by| by[point]);
                factors[index][channel] * of
            };
            let sum = [0, 1, 2].map(|channel| {
                let parts = (0..=emitters).map(|index| part(index, channel)).sum::<f64>();
                parts + self.shown[point][channel]
            });
            logs.push(sum.map(num::f64::ln));
            for (index, shares) in shares.iter_mut().enumerate() {
                shares.push([0, 1, 2].map(|channel| part(index, channel) / sum[channel]));
            }
        }
        (logs, shares)
    }

    /// Difference between the observed and the computed logarithm of the ratio of a pair.
    fn residual(&self, [a, b]: Pair, lights: &[[f64; 3]]) -> [f64; 3] {
        let (a, b) = (a as usize, b as usize);
        [0, 1, 2].map(|c| self.logs[a][c] - self.logs[b][c] - lights[a][c] + lights[b][c])
    }

    /// Robust cost of the pairs of each group: r^2 / (r^2 + spread^2), where r^2 is the mean over the channels
    /// (Geman and McClure's error).
    fn costs(&self, lights: Option<&[[f64; 3]]>, spread: f64) -> Vec<f64> {
        let constant = vec![[0.0; 3]; if lights.is_none() { self.logs.len() } else { 0 }];
        let lights = lights.unwrap_or(&constant);
        let mut costs = vec![0.0; self.group_count];
        for pair in &self.pairs {
            let square = mean_square(self.residual(*pair, lights));
            costs[self.groups[pair[0] as usize] as usize] += square / (square + spread * spread);
        }
        costs
    }

    /// Adds the floor to the known light. It is part of the known light, since the data would otherwise determine the
    /// overall scale by it.
    fn raise(&mut self) {
        for channel in 0..3 {
            let light = |point: usize| self.known[point][channel] + self.shown[point][channel];
            let mut lights: Vec<f64> = (0..self.logs.len()).map(light).collect();
            let middle = lights.len() / 2;
            let floor = (FLOOR * *lights.select_nth_unstable_by(middle, f64::total_cmp).1).max(1e-9);
            self.known.iter_mut().for_each(|known| known[channel] += floor);
        }
    }
}

fn mean_square(r: [f64; 3]) -> f64 {
    (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) / 3.0
}

/// Normal equations of the comparison: the matrix, the gradient, and the gradient of each group.
struct Normal {
    matrix: Matrix,
    gradient: Vec<f64>,
    by_group: Vec<Vec<f64>>,
}

impl Normal {
    fn of(observed: &Observed, only: Option<u32>, unknown: &[f64], spread: f64) -> Self {
        let (lights, shares) = observed.lights(unknown);
        let count = unknown.len();
        let mut matrix = Matrix::zero(count);
        let mut by_group = vec![vec![0.0; count]; observed.group_count];
        let mut row = vec![0.0; count];
        for pair in &observed.pairs {
            if only.is_some_and(|part| observed.parts[pair[0] as usize] != part) {
                continue;
            }
            let r = observed.residual(*pair, &lights);
            let fit = spread * spread / (spread * spread + mean_square(r));
            let weight = fit * fit;
            let [a, b] = pair.map(|point| point as usize);
            for (row, shares) in row.chunks_exact_mut(3).zip(&shares) {
                row.iter_mut().enumerate().for_each(|(c, value)| *value = shares[a][c] - shares[b][c]);
            }
            let group = &mut by_group[observed.groups[a] as usize];
            for (i, (sum, value)) in group.iter_mut().zip(&row).enumerate() {
                *sum += weight * value * r[i % 3];
                for j in (i % 3..=i).step_by(3) {
                    matrix.add(i, j, weight * value * row[j]);
                }
            }
        }
        let gradient = (0..count).map(|i| by_group.iter().map(|group| group[i]).sum()).collect();
        Self { matrix: matrix.mirrored(), gradient, by_group }
    }

    /// Factor by which the comparison counts, so that its matrix agrees with the observed spread of the gradients of
    /// the groups (the adjustment of composite likelihoods by Pauli, Racugno and Ventura 2011). Unknowns are in
    /// units of their standard deviation before the comparison.
    fn weight(&self, scales: &[f64]) -> f64 {
        let groups = self.by_group.len() as f64;
        let (mut curvature, mut spread) = (0.0, 0.0);
        for (i, scale) in scales.iter().enumerate() {
            let mean = self.gradient[i] / groups;
            let squares = self.by_group.iter().map(|group| (group[i] - mean) * (group[i] - mean));
            curvature += scale * scale * self.matrix.at(i, i);
            spread += scale * scale * squares.sum::<f64>();
        }
        if spread > 0.0 { curvature / spread } else { 0.0 }
    }
}

/// Precision of the unknowns before the comparison, without the total.
fn precision(prior: &Prior, emitters: usize) -> Matrix {
    let mut matrix = Matrix::zero(3 * emitters + 3);
    for index in 0..=emitters {
        let (all, one) =
            if index < emitters { (prior.emitter, prior.colour) } else { (prior.known, prior.known_colour) };
        let [all, one] = [all, one].map(|stops| stops * stops * LN_2 * LN_2);
        for a in 0..3 {
            for b in 0..3 {
                let shared = all / (one * (one + 3.0 * all));
                matrix.add(3 * index + a, 3 * index + b, f64::from(u8::from(a == b)) / one - shared);
            }
        }
    }
    matrix
}

/// Derivative of the logarithm of the luminance of a flux by the logarithms of its channels.
fn luminance_shares(flux: [f64; 3], sum: f64) -> [f64; 3] {
    [0, 1, 2].map(|channel| {
        let mut only = [0.0; 3];
        only[channel] = flux[channel];
        luminance(only) / sum
    })
}

/// The estimate of one set of pairs.
struct Fit<'a> {
    observed: &'a Observed,
    prior: &'a Prior,
    /// Predicted unknowns.
    start: Vec<f64>,
    precision: Matrix,
    scales: Vec<f64>,
}

impl<'a> Fit<'a> {
    fn new(observed: &'a Observed, predicted: &[[f64; 3]], prior: &'a Prior) -> Self {
        let emitters = predicted.len();
        let start: Vec<f64> =
            predicted.iter().flatten().map(|flux| num::f64::ln(*flux)).chain([0.0; 3]).collect();
        let scale = |i: usize| {
            let known = i >= 3 * emitters;
            let (all, one) =
                if known { (prior.known, prior.known_colour) } else { (prior.emitter, prior.colour) };
            LN_2 * (all * all + one * one).sqrt()
        };
        let scales = (0..start.len()).map(scale).collect();
        Self { observed, prior, start, precision: precision(prior, emitters), scales }
    }

    /// Hidden fluxes of some unknowns.
    fn fluxes(&self, unknown: &[f64]) -> Vec<[f64; 3]> {
        let emitters = self.start.len() / 3 - 1;
        (0..emitters).map(|e| [0, 1, 2].map(|c| num::f64::exp(unknown[3 * e + c]))).collect()
    }

    /// Adds the assumptions to the equations: each emitter by itself, and all together.
    fn assume(&self, unknown: &[f64], matrix: &mut Matrix, gradient: &mut [f64]) {
        let off: Vec<f64> = unknown.iter().zip(&self.start).map(|(now, start)| now - start).collect();
        for (i, gradient) in gradient.iter_mut().enumerate() {
            for (j, off) in off.iter().enumerate() {
                matrix.add(i, j, self.precision.at(i, j));
                *gradient -= self.precision.at(i, j) * off;
            }
        }
        let sum = |fluxes: &[[f64; 3]]| fluxes.iter().map(|flux| luminance(*flux)).sum::<f64>();
        let fluxes = self.fluxes(unknown);
        let (now, before) = (sum(&fluxes), sum(&self.fluxes(&self.start)));
        let total = self.prior.total * LN_2;
        let slopes: Vec<f64> = fluxes.iter().flat_map(|flux| luminance_shares(*flux, now)).collect();
        let off = num::f64::ln(now / before);
        for (i, slope) in slopes.iter().enumerate() {
            gradient[i] -= slope * off / (total * total);
            slopes
                .iter()
                .enumerate()
                .for_each(|(j, other)| matrix.add(i, j, slope * other / (total * total)));
        }
    }

    /// The best unknowns, and the weight of the comparison. `only` limits the pairs to one part of the place.
    fn solve(&self, only: Option<u32>) -> (Vec<f64>, f64) {
        let (mut unknown, mut weight) = (self.start.clone(), None);
        for (stage, spread) in SPREADS.into_iter().enumerate() {
            for step in 0..STEPS {
                let normal = Normal::of(self.observed, only, &unknown, spread);
                // The gradients of the groups are those of errors only near the optimum.
                if weight.is_none() || (stage + 2 >= SPREADS.len() && step % 4 == 0) {
                    weight = Some(normal.weight(&self.scales));
                }
                let Normal { mut matrix, mut gradient, .. } = normal;
                let by = weight.unwrap_or(0.0);
                matrix.scale(by);
                gradient.iter_mut().for_each(|value| *value *= by);
                self.assume(&unknown, &mut matrix, &mut gradient);
                let Some(change) = matrix.solve(&gradient) else { break };
                let longest = change.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
                let by = if longest > LONGEST { LONGEST / longest } else { 1.0 };
                unknown.iter_mut().zip(&change).for_each(|(value, change)| *value += by * change);
            }
        }
        (unknown, weight.unwrap_or(0.0))
    }

    /// Standard errors of the luminance of each hidden flux in stops, if the comparison counts with a weight.
    fn errors(&self, unknown: &[f64], weight: f64) -> Vec<f64> {
        let normal = Normal::of(self.observed, None, unknown, LAST);
        let (mut matrix, mut gradient) = (normal.matrix, normal.gradient);
        matrix.scale(weight);
        self.assume(unknown, &mut matrix, &mut gradient);
        let error = |(e, flux): (usize, &[f64; 3])| {
            let mut slope = vec![0.0; self.start.len()];
            slope[3 * e..3 * e + 3].copy_from_slice(&luminance_shares(*flux, luminance(*flux)));
            let solved = matrix.solve(&slope).unwrap_or_default();
            solved.iter().zip(&slope).map(|(a, b)| a * b).sum::<f64>().max(0.0).sqrt() / LN_2
        };
        self.fluxes(unknown).iter().enumerate().map(error).collect()
    }
}

/// Estimates the hidden fluxes of the emitters. `predicted` are the fluxes of the prediction, which are positive.
/// The standard errors are the larger of two: from the groups, and from the separate estimates of the parts.
pub(super) fn estimate(mut observed: Observed, predicted: &[[f64; 3]], prior: &Prior) -> Estimate {
    observed.raise();
    let fit = Fit::new(&observed, predicted, prior);
    let (unknown, weight) = fit.solve(None);
    let parts: Vec<Vec<[f64; 3]>> = (0..PARTS).map(|part| fit.fluxes(&fit.solve(Some(part)).0)).collect();
    let disagreement = |emitter: usize| {
        let stops: Vec<f64> = parts.iter().map(|fluxes| num::f64::log2(luminance(fluxes[emitter]))).collect();
        let mean = stops.iter().sum::<f64>() / f64::from(PARTS);
        let squares = stops.iter().map(|stops| (stops - mean) * (stops - mean)).sum::<f64>();
        (squares / f64::from(PARTS * (PARTS - 1))).sqrt()
    };
    let errors = fit.errors(&unknown, weight);
    let lights = |unknown: &[f64]| observed.lights(unknown).0;
    Estimate {
        error_stops: errors.iter().enumerate().map(|(e, error)| error.max(disagreement(e))).collect(),
        prior_stops: fit.errors(&fit.start, 0.0),
        known: [0, 1, 2].map(|c| num::f64::exp(unknown[3 * predicted.len() + c])),
        costs: [
            observed.costs(None, LAST),
            observed.costs(Some(&lights(&fit.start)), LAST),
            observed.costs(Some(&lights(&unknown)), LAST),
        ],
        fluxes: fit.fluxes(&unknown),
    }
}
