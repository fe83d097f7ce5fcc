//! Training of the exposure network. In panoramas whose bright light is clipped, the network predicts which cells
//! the hidden light comes from. The total amount of hidden light is fitted separately, beforehand. The network
//! scores each clipped cell, and the softmax of the scores distributes the amount among the cells. Unlike a
//! regression per cell, this can assign all light to one cell.

use candle_core::{D, Device, Result, Tensor, Var};

/// Photographed panoramas, stored as arrays with one row per panorama. Every panorama is described by the same
/// number of clipped cells. If it has more clipped cells, only a selection is used, and some of the selected cells
/// stand for several cells. If it has fewer, cells without light are added.
pub struct Examples {
    /// Number of panoramas.
    pub count: usize,
    /// Number of clipped cells per panorama.
    pub cells: usize,
    /// Features that describe each panorama as a whole.
    pub overview: Vec<f32>,
    /// Features of each cell.
    pub features: Vec<f32>,
    /// For each cell, the natural logarithm of the product of its visible flux and the number of cells that it
    /// stands for; -1e9 for an added cell.
    pub log_flux: Vec<f32>,
    /// Hidden flux of each cell, multiplied by the number of cells that it stands for.
    pub hidden: Vec<f32>,
    /// Cosine of the angle between the cell's direction and the normal of the plane on which contrast is measured,
    /// for cells near the dominant light; 0 for other cells.
    pub near: Vec<f32>,
    /// Like `near`, but for cells far from the dominant light; 0 for cells near this light.
    pub far: Vec<f32>,
    /// Eight fluxes of each panorama, in this order:
    /// - visible flux: the total, the flux on the plane from cells near the dominant light, and the flux on the
    ///   plane from all other cells;
    /// - flux of the ground truth: the same three values;
    /// - hidden flux: the value of the ground truth, and the fitted value.
    pub fluxes: Vec<[f32; 8]>,
    /// Weight of each panorama in the loss.
    pub weight: Vec<f32>,
}

/// Settings of the training. The shipped weights were trained with the default values.
#[derive(Debug, Clone)]
pub struct Recipe {
    /// Number of hidden units of the network.
    pub units: usize,
    /// Number of steps of gradient descent (Adam).
    pub steps: usize,
    /// Number of examples per step.
    pub batch: usize,
    /// Learning rate, before it is scaled. It is scaled by a factor that falls linearly from 1 to 0 during the
    /// training, and in the first 20 steps also by a factor that rises linearly to 1.
    pub rate: f64,
    /// Weight of the contrast error in the loss.
    pub contrast: f64,
    /// Weight in the loss of the cross-entropy between the predicted and the true position of the hidden light.
    pub place: f64,
    /// Weight decay of the linear part of the network, and of the part with hidden units.
    pub decay: [f64; 2],
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            units: 12,
            steps: 200,
            batch: 32,
            rate: 0.02,
            contrast: 1.0,
            place: 1.0,
            decay: [0.005, 0.003],
        }
    }
}

/// Mean and standard deviation of each column.
#[derive(Debug, Clone)]
pub struct Scale {
    /// Mean of each column.
    pub mean: Vec<f32>,
    /// Standard deviation of each column.
    pub spread: Vec<f32>,
}

impl Scale {
    /// Computes the mean and standard deviation of each column. `values` contains rows of `columns` numbers. Only
    /// rows for whose index `counts` returns true are used.
    pub fn of(values: &[f32], columns: usize, counts: impl Fn(usize) -> bool) -> Self {
        let (mut sums, mut squares, mut n) = (vec![0.0_f64; columns], vec![0.0_f64; columns], 0.0);
        for (_, row) in values.chunks_exact(columns).enumerate().filter(|(i, _)| counts(*i)) {
            n += 1.0;
            for ((sum, square), v) in sums.iter_mut().zip(&mut squares).zip(row) {
                *sum += f64::from(*v);
                *square += f64::from(*v) * f64::from(*v);
            }
        }
        let n = f64::max(n, 1.0);
        let mean = sums.iter().map(|s| (s / n) as f32).collect();
        let spread = sums
            .iter()
            .zip(&squares)
            .map(|(s, q)| ((q / n - s / n * (s / n)).max(0.0).sqrt() + 1e-4) as f32)
            .collect();
        Self { mean, spread }
    }

    /// Subtracts the mean of each column, divides by its standard deviation, and clamps the result to ± `limit`.
    pub fn apply(&self, values: &mut [f32], limit: f32) {
        for row in values.chunks_exact_mut(self.mean.len()) {
            for ((v, mean), spread) in row.iter_mut().zip(&self.mean).zip(&self.spread) {
                *v = ((*v - mean) / spread).clamp(-limit, limit);
            }
        }
    }
}

/// A trained network. Its inputs must be scaled; see [`Scale`].
#[derive(Debug, Clone)]
pub struct Network {
    /// Name, shape and values of each tensor, as in the weights file.
    pub tensors: Vec<(&'static str, Vec<usize>, Vec<f32>)>,
}

struct Weights {
    linear: Var,
    cell: Var,
    overview: Var,
    bias: Var,
    out: Var,
}

/// A seeded generator of random numbers (SplitMix64).
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn even(&mut self) -> f32 {
        ((self.bits() >> 40) as f32 / (1_u64 << 23) as f32) - 1.0
    }

    fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
    }
}

/// Slope of the activation function for negative inputs.
const LEAK: f64 = 0.1;

fn unit(x: &Tensor) -> Result<Tensor> {
    x.relu()? + ((x - x.relu()?)? * LEAK)?
}

impl Weights {
    fn new(columns: (usize, usize), units: usize, random: &mut Random, device: &Device) -> Result<Self> {
        let (overview, cell) = columns;
        let mut var = |rows: usize, columns: usize, size: f64| {
            // Uniform numbers, with the variance of normal numbers of standard deviation `size`.
            let values: Vec<f32> =
                (0..rows * columns).map(|_| random.even() * (size * 1.732_050_8) as f32).collect();
            Var::from_vec(values, (rows, columns), device)
        };
        Ok(Self {
            linear: var(cell, 1, 0.0)?,
            cell: var(cell, units, 1.0 / (cell as f64).sqrt())?,
            overview: var(overview, units, 0.3 / (overview as f64).sqrt())?,
            bias: var(1, units, 0.0)?,
            out: var(units, 1, 0.3 / (units as f64).sqrt())?,
        })
    }

    fn of(network: &Network) -> Result<Self> {
        // The file has one row per unit; here there is one column per unit.
        let var = |k: usize| {
            let (_, shape, values) = &network.tensors[k];
            let (columns, rows) = match shape[..] {
                [units, numbers] => (units, numbers),
                [numbers] => (1, numbers),
                _ => (1, values.len()),
            };
            let tensor = Tensor::from_vec(values.clone(), (columns, rows), &Device::Cpu)?;
            Var::from_tensor(&tensor.t()?.contiguous()?)
        };
        Ok(Self {
            linear: var(0)?,
            cell: var(1)?,
            overview: var(2)?,
            bias: Var::from_tensor(&var(3)?.t()?.contiguous()?)?,
            out: var(4)?,
        })
    }

    fn vars(&self) -> [&Var; 5] {
        [&self.linear, &self.cell, &self.overview, &self.bias, &self.out]
    }

    /// Returns, for each cell, the natural logarithm of the fraction of the hidden light that comes from this cell.
    fn forward(&self, overview: &Tensor, features: &Tensor, log_flux: &Tensor) -> Result<Tensor> {
        let (n, cells, columns) = features.dims3()?;
        let flat = features.reshape((n * cells, columns))?;
        let about = overview.matmul(&self.overview)?.broadcast_add(&self.bias)?.unsqueeze(1)?;
        let units = self.out.dim(0)?;
        let inner = flat.matmul(&self.cell)?.reshape((n, cells, units))?.broadcast_add(&about)?;
        let bent = unit(&inner)?.reshape((n * cells, units))?.matmul(&self.out)?;
        let score = (flat.matmul(&self.linear)? + bent)?.reshape((n, cells))?;
        let score = (score + log_flux)?;
        let largest = score.max_keepdim(D::Minus1)?.detach();
        let score = score.broadcast_sub(&largest)?;
        let total = score.exp()?.sum_keepdim(D::Minus1)?.log()?;
        score.broadcast_sub(&total)
    }
}

/// A smooth approximation of the absolute value.
fn magnitude(x: &Tensor) -> Result<Tensor> {
    (x.sqr()? + 0.05)?.sqrt()
}

fn log2(x: &Tensor) -> Result<Tensor> {
    x.log()? * std::f64::consts::LOG2_E
}

/// The examples of one training step, as tensors.
struct Batch {
    overview: Tensor,
    features: Tensor,
    log_flux: Tensor,
    hidden: Tensor,
    near: Tensor,
    far: Tensor,
    fluxes: [Tensor; 8],
    weight: Tensor,
}

impl Batch {
    fn new(examples: &Examples, chosen: &[usize], device: &Device) -> Result<Self> {
        let (n, cells) = (chosen.len(), examples.cells);
        let gather = |values: &[f32]| {
            let width = values.len() / examples.count;
            let rows: Vec<f32> =
                chosen.iter().flat_map(|&i| &values[i * width..(i + 1) * width]).copied().collect();
            Tensor::from_vec(rows, (n, width), device)
        };
        let features = gather(&examples.features)?;
        let columns = features.dim(1)? / cells;
        let mut fluxes = Vec::with_capacity(8);
        for k in 0..8 {
            let column: Vec<f32> = chosen.iter().map(|&i| examples.fluxes[i][k]).collect();
            fluxes.push(Tensor::from_vec(column, n, device)?);
        }
        let fluxes = fluxes.try_into().map_err(|_| candle_core::Error::Msg("eight fluxes".to_owned()))?;
        Ok(Self {
            overview: gather(&examples.overview)?,
            features: features.reshape((n, cells, columns))?,
            log_flux: gather(&examples.log_flux)?,
            hidden: gather(&examples.hidden)?,
            near: gather(&examples.near)?,
            far: gather(&examples.far)?,
            fluxes,
            weight: gather(&examples.weight)?.squeeze(1)?,
        })
    }

    fn loss(&self, weights: &Weights, recipe: &Recipe) -> Result<Tensor> {
        let log_share = weights.forward(&self.overview, &self.features, &self.log_flux)?;
        let share = log_share.exp()?;
        let [_, near, far, true_all, true_near, true_far, hidden, predicted] = &self.fluxes;
        let on_plane = |own: &Tensor, toward: &Tensor| -> Result<Tensor> {
            own + (predicted * (&share * toward)?.sum(D::Minus1)?)?
        };
        let (near, far) = (on_plane(near, &self.near)?, on_plane(far, &self.far)?);
        let ratio = |near: &Tensor, far: &Tensor| log2(&((near + 1e-4)? / (far + 1e-9)?)?);
        let contrast = (ratio(&near, &far)? - ratio(true_near, true_far)?)?;
        // Cross-entropy of the position of the hidden light, weighted by its share of all light.
        let total = (self.hidden.sum(D::Minus1)? + 1e-12)?;
        let place = ((&self.hidden * &log_share)?.sum(D::Minus1)?.neg()? / total)?;
        let place = (place * (hidden / true_all)?)?;
        let loss = ((magnitude(&contrast)? * recipe.contrast)? + (place * recipe.place)?)?;
        let loss = ((loss * &self.weight)?.sum_all()? / self.weight.sum_all()?)?;
        let square = |var: &Var| var.sqr()?.sum_all();
        let inner = (square(&weights.cell)? + (square(&weights.overview)? * 2.0)?)?;
        let inner = (inner + square(&weights.out)?)?;
        let loss = (loss + (square(&weights.linear)? * recipe.decay[0])?)?;
        loss + (inner * recipe.decay[1])?
    }
}

/// The Adam optimiser, with its running moments of the gradients.
struct Adam {
    first: Vec<Tensor>,
    second: Vec<Tensor>,
}

impl Adam {
    fn step(&mut self, vars: &[&Var], loss: &Tensor, rate: f64, count: usize) -> Result<()> {
        let gradients = loss.backward()?;
        // Powers are computed as repeated products, so that they are equal on all machines.
        let power = |base: f64| (0..count).fold(1.0, |p, _| p * base);
        let (one, two) = (1.0 - power(0.9), 1.0 - power(0.98));
        for (i, var) in vars.iter().enumerate() {
            let Some(gradient) = gradients.get(var) else { continue };
            // A gradient keeps the values alive from which it was computed. Without `detach` the moments would keep
            // those of every step.
            let gradient = gradient.detach();
            self.first[i] = ((&self.first[i] * 0.9)? + (&gradient * 0.1)?)?;
            self.second[i] = ((&self.second[i] * 0.98)? + (gradient.sqr()? * 0.02)?)?;
            let change = ((&self.first[i] / one)? / ((&self.second[i] / two)?.sqrt()? + 1e-6)?)?;
            var.set(&(var.as_tensor() - (change * rate)?)?)?;
        }
        Ok(())
    }
}

/// Trains one network on the examples with the indices `chosen`. Their features must be scaled. Uses a GPU if the
/// build supports GPUs and a GPU is present. After each step, `tell` receives the number of finished steps and the
/// loss, and returns true to continue. Returns `None` if `tell` stopped the training.
pub fn train(
    examples: &Examples,
    chosen: &[usize],
    recipe: &Recipe,
    seed: u64,
    mut tell: impl FnMut(usize, f32) -> bool,
) -> Result<Option<Network>> {
    let columns = (
        examples.overview.len() / examples.count.max(1),
        examples.features.len() / (examples.count * examples.cells).max(1),
    );
    let mut random = Random(seed);
    let device = Device::cuda_if_available(0)?;
    let weights = Weights::new(columns, recipe.units, &mut random, &device)?;
    let vars = weights.vars();
    let zeros = || vars.iter().map(|var| var.zeros_like()).collect::<Result<Vec<_>>>();
    let mut adam = Adam { first: zeros()?, second: zeros()? };
    for step in 0..recipe.steps {
        let batch: Vec<usize> =
            (0..recipe.batch.min(chosen.len())).map(|_| chosen[random.below(chosen.len())]).collect();
        let loss = Batch::new(examples, &batch, &device)?.loss(&weights, recipe)?;
        let done = step as f64 / recipe.steps as f64;
        let rate = recipe.rate * (1.0 - done) * f64::min(1.0, (step + 1) as f64 / 20.0);
        adam.step(&vars, &loss, rate, step + 1)?;
        if !tell(step + 1, loss.to_scalar()?) {
            return Ok(None);
        }
    }
    let flat = |var: &Var| var.flatten_all()?.to_vec1::<f32>();
    let transposed = |var: &Var| var.t()?.contiguous()?.flatten_all()?.to_vec1::<f32>();
    let tensors = vec![
        ("score.linear", vec![columns.1], flat(&weights.linear)?),
        ("score.cell", vec![recipe.units, columns.1], transposed(&weights.cell)?),
        ("score.overview", vec![recipe.units, columns.0], transposed(&weights.overview)?),
        ("score.bias", vec![recipe.units], flat(&weights.bias)?),
        ("score.out", vec![recipe.units], flat(&weights.out)?),
    ];
    Ok(Some(Network { tensors }))
}

/// Predicts the distribution of the hidden light of one panorama: for each cell, the fraction that comes from this
/// cell. The features must be scaled.
pub fn predict(network: &Network, overview: &[f32], features: &[f32], log_flux: &[f32]) -> Result<Vec<f32>> {
    let cells = log_flux.len();
    let tensor = |values: &[f32], shape: &[usize]| Tensor::from_vec(values.to_vec(), shape, &Device::Cpu);
    let log_share = Weights::of(network)?.forward(
        &tensor(overview, &[1, overview.len()])?,
        &tensor(features, &[1, cells, features.len() / cells.max(1)])?,
        &tensor(log_flux, &[1, cells])?,
    )?;
    log_share.exp()?.squeeze(0)?.to_vec1()
}

#[cfg(test)]
mod tests {
    use super::*;

    // The moments must not refer to the operations that computed them, because these operations would keep the
    // values of every step in memory. This test fails if `Adam::step` does not call `detach`.
    #[test]
    fn moments_hold_no_history() {
        let var = || Var::from_vec(vec![1.0_f32, 2.0], 2, &Device::Cpu).expect("fits");
        let (a, b) = (var(), var());
        let zeros = || vec![a.zeros_like().expect("fits"), b.zeros_like().expect("fits")];
        let mut adam = Adam { first: zeros(), second: zeros() };
        for count in 1..3 {
            let loss = (a.as_tensor() * b.as_tensor()).and_then(|t| t.sum_all()).expect("multiplies");
            adam.step(&[&a, &b], &loss, 0.1, count).expect("steps");
        }
        assert!(adam.first.iter().chain(&adam.second).all(|moment| !moment.track_op()));
        assert!(a.to_vec1::<f32>().expect("is there")[0] < 1.0);
    }
}
