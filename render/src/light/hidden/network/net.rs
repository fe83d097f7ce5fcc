//! Forward pass of the exposure networks. Every sum has a fixed order, so the result has the same bits on
//! every machine.

use crate::light::measure::luminance;
use scene::error::Error;
use scene::math::nn::Weights;
use scene::math::num;

use super::correction::Correction;
use super::scale::{LIMITS, activate, scaled};

/// Largest absolute value of log2 of the ratio of red or blue to green light. Larger values are clamped.
pub const HUE: f64 = 3.0;
/// Largest absolute value of log2 of the ratio of hidden to visible light. Larger values are clamped.
pub const AMOUNT: f64 = 8.0;

/// An affine map that predicts the amount of hidden light, two that predict its colour, an ensemble of networks of the
/// same shape that predict its distribution, and a correction of amount and distribution.
pub struct Network {
    /// Means and standard deviations of the features of a panorama, of a cell, and of the features that predict
    /// colour.
    scales: [(Vec<f32>, Vec<f32>); 3],
    amount: Affine,
    /// log2 of the ratio of red to green light, and of blue to green light.
    colour: [Affine; 2],
    members: Vec<Member>,
    /// `None` if the weights file has none.
    pub correction: Option<Correction>,
    /// Part of the uncertainty, in stops, that is not explained by the disagreement of the networks.
    pub residual: f64,
}

struct Member {
    linear: Vec<f32>,
    /// For each feature of a cell, the weight of each unit.
    cell: Vec<f32>,
    overview: Vec<Affine>,
    out: Vec<f32>,
}

struct Affine {
    weight: Vec<f32>,
    bias: f32,
}

/// Prediction for one panorama.
pub struct Prediction {
    /// log2 of the ratio of hidden to visible flux.
    pub amount: f64,
    /// For each network, the share of the hidden light that each cell receives.
    pub shares: Vec<Vec<f64>>,
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

impl Affine {
    fn apply(&self, x: &[f32]) -> f32 {
        dot(&self.weight, x) + self.bias
    }
}

impl Network {
    /// Reads a weights file. `file` is the name of the file for messages.
    /// `columns` are the numbers of features of a panorama, of a cell, and of those that predict colour.
    pub fn parse(file: &str, bytes: &[u8], columns: [usize; 3]) -> Result<Self, Error> {
        let [overview, cell, colour] = columns;
        let weights = Weights::parse(file, bytes)?;
        let wrong = |name: &str, shape: &[usize], wanted: &str| {
            Error::format(file, format!("tensor `{name}` has shape {shape:?} instead of {wanted}"))
        };
        let sized = |name: &str, columns: usize| {
            let (shape, values) = weights.tensor(name)?;
            if values.len() != columns {
                return Err(wrong(name, &shape, &format!("[{columns}]")));
            }
            Ok(values)
        };
        // A tensor with one row of `columns` for each member, or with several rows each.
        let rows = |name: &str, members: usize, columns: Option<usize>| {
            let (shape, values) = weights.tensor(name)?;
            let fits = shape.first() == Some(&members) && columns.is_none_or(|n| shape.last() == Some(&n));
            if !fits || values.is_empty() {
                let columns = columns.map_or("...".to_owned(), |n| n.to_string());
                return Err(wrong(name, &shape, &format!("[{members}, {columns}]")));
            }
            let each = values.len() / members;
            Ok(values.chunks_exact(each).map(<[f32]>::to_vec).collect::<Vec<_>>())
        };
        let bias = sized("amount.bias", 1)?[0];
        let amount = Affine { weight: sized("amount.linear", overview)?, bias };
        let (of_colour, bias) = (sized("colour.linear", 2 * colour)?, sized("colour.bias", 2)?);
        let hue = |i: usize| Affine { weight: of_colour[i * colour..][..colour].to_vec(), bias: bias[i] };
        let count = weights.tensor("score.out")?.0.first().copied().unwrap_or_default();
        let linear = rows("score.linear", count, Some(cell))?;
        let cells = rows("score.cell", count, Some(cell))?;
        let about = rows("score.overview", count, Some(overview))?;
        let about_bias = rows("score.bias", count, None)?;
        let out = rows("score.out", count, None)?;
        let affine = |weight: &[f32], bias: &[f32]| -> Vec<Affine> {
            let rows = weight.chunks_exact(overview).zip(bias);
            rows.map(|(row, bias)| Affine { weight: row.to_vec(), bias: *bias }).collect()
        };
        let mut members = Vec::with_capacity(count);
        for m in 0..count {
            let units = out[m].len();
            for (name, rows, each) in
                [("cell", &cells, cell), ("overview", &about, overview), ("bias", &about_bias, 1)]
            {
                let (got, wanted) = (rows[m].len(), units * each);
                if got != wanted {
                    let what = format!(
                        "tensor `score.{name}` has {got} values per network, but the {units} units of `score.out` need {wanted}"
                    );
                    return Err(Error::format(file, what));
                }
            }
            members.push(Member {
                linear: linear[m].clone(),
                cell: (0..cell)
                    .flat_map(|k| (0..units).map(move |u| (u, k)))
                    .map(|(u, k)| cells[m][u * cell + k])
                    .collect(),
                overview: affine(&about[m], &about_bias[m]),
                out: out[m].clone(),
            });
        }
        let scale = |name: &str, columns: usize| {
            let spread = sized(&format!("{name}.spread"), columns)?;
            if spread.iter().any(|v| *v <= 0.0) {
                return Err(Error::format(
                    file,
                    format!("tensor `{name}.spread` contains a value that is not above 0"),
                ));
            }
            Ok((sized(&format!("{name}.mean"), columns)?, spread))
        };
        let scales = [scale("overview", overview)?, scale("cell", cell)?, scale("colour", colour)?];
        let residual = f64::from(sized("residual", 1)?[0]);
        let correction = Correction::parse(file, &weights, overview)?;
        Ok(Self { scales, amount, colour: [hue(0), hue(1)], members, correction, residual })
    }

    /// The scaled features. `which` is an index in [`LIMITS`].
    fn scaled(&self, which: usize, values: &[f32]) -> Vec<f32> {
        let (mean, spread) = &self.scales[which];
        scaled(values, (mean.as_slice(), spread), LIMITS[which])
    }

    /// Predicts the RGB of the hidden light of a region, scaled to a luminance of 1.
    pub fn colour(&self, features: &[f32]) -> [f64; 3] {
        let features = self.scaled(2, features);
        let ratio = |map: &Affine| num::f64::exp2(f64::from(map.apply(&features)).clamp(-HUE, HUE));
        let rgb = [ratio(&self.colour[0]), 1.0, ratio(&self.colour[1])];
        let luminance = luminance(rgb);
        rgb.map(|v| v / luminance)
    }

    /// Predicts the amount and distribution of hidden light, without the correction. `flux` is the visible flux of each
    /// cell.
    pub fn predict(&self, overview: &[f32], cells: &[&[f32]], flux: &[f64]) -> Prediction {
        let overview = self.scaled(0, overview);
        let cells: Vec<Vec<f32>> = cells.iter().map(|cell| self.scaled(1, cell)).collect();
        Prediction {
            amount: f64::from(self.amount.apply(&overview)).clamp(-AMOUNT, AMOUNT),
            shares: self.members.iter().map(|member| member.shares(&overview, &cells, flux)).collect(),
        }
    }
}

impl Member {
    fn shares(&self, overview: &[f32], cells: &[Vec<f32>], flux: &[f64]) -> Vec<f64> {
        let about: Vec<f32> = self.overview.iter().map(|u| u.apply(overview)).collect();
        let units = self.out.len();
        let mut sums = vec![0.0_f32; units];
        // The sum of each unit is over the features in order. All units are summed together, so that the compiler can
        // vectorise over them.
        let mut score = |cell: &Vec<f32>| {
            sums.fill(0.0);
            for (value, weights) in cell.iter().zip(self.cell.chunks_exact(units)) {
                sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight * value);
            }
            let outputs = sums.iter().zip(&about).zip(&self.out);
            let inner = outputs.fold(0.0, |sum, ((v, about), out)| sum + out * activate(v + about));
            f64::from(dot(&self.linear, cell) + inner)
        };
        let scores: Vec<f64> = cells.iter().map(&mut score).collect();
        let largest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> =
            scores.iter().zip(flux).map(|(score, flux)| num::f64::exp(score - largest) * flux).collect();
        let total: f64 = weights.iter().sum();
        let share = |w: f64| if total > 0.0 { w / total } else { 0.0 };
        weights.into_iter().map(share).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::hidden::network::{CELL, COLOUR, OVERVIEW, WEIGHTS};
    use safetensors::SafeTensors;
    use safetensors::tensor::{Dtype, TensorView, serialize};

    /// Parses the built-in weights after `change` has modified the shapes and bytes of the tensors.
    fn changed(change: impl Fn(&str, &mut Vec<usize>, &mut Vec<u8>) -> bool) -> Result<Network, Error> {
        let tensors = SafeTensors::deserialize(WEIGHTS).expect("is sound");
        let mut kept = Vec::new();
        for (name, view) in tensors.tensors() {
            let (mut shape, mut bytes) = (view.shape().to_vec(), view.data().to_vec());
            if change(&name, &mut shape, &mut bytes) {
                kept.push((name, shape, bytes));
            }
        }
        let view = |(name, shape, bytes)| (name, TensorView::new(Dtype::F16, shape, bytes).expect("fits"));
        let views =
            kept.iter().map(|(name, shape, bytes)| view((name.as_str(), shape.clone(), bytes.as_slice())));
        let file = serialize(views, None).expect("serializes");
        Network::parse("w", &file, [OVERVIEW, CELL, COLOUR])
    }

    /// An error about wrong weights names the tensor.
    #[test]
    fn wrong_weights_are_refused_by_name() {
        let shipped = SafeTensors::deserialize(WEIGHTS).expect("is sound");
        for name in shipped.names().into_iter().map(String::from) {
            let message =
                |result: Result<Network, Error>| result.err().map(|e| e.to_string()).unwrap_or_default();
            let missing = message(changed(|n, _, _| n != name));
            assert!(missing.contains(&format!("`{name}` is missing")), "{missing}");
            let nan = message(changed(|n, _, bytes| {
                if n == name {
                    bytes[1] = 0x7e;
                }
                true
            }));
            assert!(nan.contains(&name) && nan.contains("NaN"), "{nan}");
            let longer = message(changed(|n, shape, bytes| {
                if n == name {
                    let last = shape.len() - 1;
                    let rows: usize = shape[..last].iter().product();
                    shape[last] += 1;
                    bytes.resize(bytes.len() + 2 * rows, 0);
                }
                true
            }));
            assert!(longer.contains(&format!("`{name}`")), "{name}: {longer}");
        }
    }

    /// The forward pass of the built-in networks agrees with the same computation in f64, for features in and
    /// beyond the range of real panoramas. This test fails if `LEAK` is 0, or if the two limits of `LIMITS` are
    /// exchanged.
    #[test]
    fn the_forward_pass_is_that_of_float64() {
        let network = Network::parse("w", WEIGHTS, [OVERVIEW, CELL, COLOUR]).expect("is sound");
        let weights = Weights::parse("w", WEIGHTS).expect("is sound");
        let tensor = |name: &str| -> Vec<f64> {
            weights.tensor(name).expect("is there").1.into_iter().map(f64::from).collect()
        };
        let (mut state, spread) =
            (0, |name: &str| [tensor(&format!("{name}.mean")), tensor(&format!("{name}.spread"))]);
        let mut numbers = |[means, spreads]: &[Vec<f64>; 2]| -> Vec<f32> {
            let number = |(mean, spread): (&f64, &f64)| {
                state += 1;
                let [at, _] = crate::geometry::sampling::Points::new(3, state).bits(0);
                (mean + spread * 10.0 * (f64::from(at) / 4_294_967_296.0 - 0.5)) as f32
            };
            means.iter().zip(spreads).map(number).collect()
        };
        let (whole, cell_scale) = (spread("overview"), spread("cell"));
        let overview = numbers(&whole);
        let cells: Vec<Vec<f32>> = (0..50).map(|_| numbers(&cell_scale)).collect();
        let flux: Vec<f64> = (1..=50).map(f64::from).collect();
        let views: Vec<&[f32]> = cells.iter().map(Vec::as_slice).collect();
        let found = network.predict(&overview, &views, &flux);

        let scaled = |values: &[f32], [means, spreads]: &[Vec<f64>; 2], limit: f64| -> Vec<f64> {
            let each = values.iter().zip(means).zip(spreads);
            each.map(|((v, mean), spread)| ((f64::from(*v) - mean) / spread).clamp(-limit, limit)).collect()
        };
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let overview = scaled(&overview, &whole, 3.0);
        let amount = sum(&tensor("amount.linear"), &overview) + tensor("amount.bias")[0];
        assert!((found.amount - amount.clamp(-8.0, 8.0)).abs() < 1e-5, "{} {amount}", found.amount);
        let [linear, inner, about, bias, out] =
            ["linear", "cell", "overview", "bias", "out"].map(|name| tensor(&format!("score.{name}")));
        let (members, units) = (found.shares.len(), out.len() / found.shares.len());
        let mut largest = 0.0_f64;
        for member in 0..members {
            let score = |cell: &Vec<f32>| {
                let cell = scaled(cell, &cell_scale, 4.0);
                let unit = |u: usize| {
                    let u = member * units + u;
                    let rows = [(&inner, CELL, &cell), (&about, OVERVIEW, &overview)];
                    let x: f64 =
                        rows.iter().map(|(rows, n, x)| sum(&rows[u * n..(u + 1) * n], x)).sum::<f64>()
                            + bias[u];
                    out[u] * if x > 0.0 { x } else { 0.1 * x }
                };
                sum(&linear[member * CELL..(member + 1) * CELL], &cell) + (0..units).map(unit).sum::<f64>()
            };
            let scores: Vec<f64> = cells.iter().map(score).collect();
            let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let weights: Vec<f64> =
                scores.iter().zip(&flux).map(|(score, flux)| flux * num::f64::exp(score - most)).collect();
            let total: f64 = weights.iter().sum();
            for (share, weight) in found.shares[member].iter().zip(weights) {
                largest = largest.max((share - weight / total).abs());
            }
        }
        assert!(largest < 1e-5, "{largest}");

        let colour_scale = spread("colour");
        let features = numbers(&colour_scale);
        let values = scaled(&features, &colour_scale, 3.0);
        let hue = |i: usize| {
            let value =
                sum(&tensor("colour.linear")[i * COLOUR..][..COLOUR], &values) + tensor("colour.bias")[i];
            num::f64::exp2(value.clamp(-3.0, 3.0))
        };
        let rgb = network.colour(&features);
        assert!(
            (rgb[0] / rgb[1] - hue(0)).abs() < 1e-4 && (rgb[2] / rgb[1] - hue(1)).abs() < 1e-4,
            "{rgb:?}"
        );
        assert!((luminance(rgb) - 1.0).abs() < 1e-12);
    }

    /// The largest f16 weights do not overflow.
    #[test]
    fn the_largest_weights_stay_finite() {
        let network = changed(|name, _, bytes| {
            if !name.contains("spread") {
                bytes.chunks_exact_mut(2).for_each(|b| b.copy_from_slice(&[0xff, 0x7b]));
            }
            true
        })
        .expect("is sound");
        let cells = [[1e4; CELL], [-1e4; CELL], [0.0; CELL]];
        let views: Vec<&[f32]> = cells.iter().map(|cell| cell.as_slice()).collect();
        let prediction = network.predict(&[1e4; OVERVIEW], &views, &[1.0, 2.0, 3.0]);
        assert!(prediction.amount.abs() <= AMOUNT);
        for shares in &prediction.shares {
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}
