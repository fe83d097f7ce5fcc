//! Ridge regression: affine maps that are fitted to weighted samples.

/// An affine map from scaled features to a number.
pub(super) struct Ridge {
    pub weight: Vec<f32>,
    pub bias: f32,
}

/// One of the samples to which a map is fitted.
pub(super) struct Sample<'a> {
    /// Scaled features.
    pub numbers: &'a [f32],
    /// Value that the map should have.
    pub value: f64,
    /// Weight of the sample in the fit.
    pub weight: f64,
}

impl Ridge {
    /// Minimises the weighted mean of the squared errors, plus `penalty` times the sum of the squared weights of the
    /// features.
    pub fn fit(samples: &[Sample<'_>], penalty: f64) -> Self {
        let columns = samples.first().map_or(0, |sample| sample.numbers.len());
        let total: f64 = samples.iter().map(|s| s.weight).sum::<f64>().max(f64::MIN_POSITIVE);
        let mut mean = vec![0.0; columns];
        for sample in samples {
            let part = sample.weight / total;
            mean.iter_mut().zip(sample.numbers).for_each(|(m, v)| *m += part * f64::from(*v));
        }
        let centre = samples.iter().map(|s| s.weight * s.value).sum::<f64>() / total;
        // Normal equations around the means, row by row; the last column is the right-hand side.
        let mut rows = vec![vec![0.0; columns + 1]; columns];
        for sample in samples {
            let off: Vec<f64> = sample.numbers.iter().zip(&mean).map(|(v, m)| f64::from(*v) - m).collect();
            let error = sample.value - centre;
            for (row, a) in rows.iter_mut().zip(&off) {
                let part = sample.weight / total * a;
                row.iter_mut().zip(off.iter().chain([&error])).for_each(|(to, b)| *to += part * b);
            }
        }
        for (i, row) in rows.iter_mut().enumerate() {
            row[i] += penalty;
        }
        let weight = solve(rows);
        let bias = centre - weight.iter().zip(&mean).map(|(w, m)| w * m).sum::<f64>();
        Self { weight: weight.iter().map(|w| *w as f32).collect(), bias: bias as f32 }
    }

    /// Value of the map for the scaled features `numbers`.
    pub fn of(&self, numbers: &[f32]) -> f64 {
        let sum = numbers.iter().zip(&self.weight).fold(0.0, |sum, (v, w)| sum + v * w);
        f64::from(sum + self.bias)
    }
}

/// Solves linear equations by Gaussian elimination. The last column of `rows` is the right-hand side, and the other
/// columns are a positive definite matrix, so that no pivot is 0.
fn solve(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let n = rows.len();
    for i in 0..n {
        let (above, below) = rows.split_at_mut(i + 1);
        let pivot = &above[i];
        for row in below {
            let factor = row[i] / pivot[i];
            row[i..].iter_mut().zip(&pivot[i..]).for_each(|(v, p)| *v -= factor * p);
        }
    }
    let mut found = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| rows[i][k] * found[k]).sum();
        found[i] = (rows[i][n] - known) / rows[i][i];
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::geometry::sampling::{hash, unit};

    const PENALTY: f64 = 0.08;

    // At the minimum, the derivatives by every weight and the bias are 0. This test fails if `penalty` is not
    // added, or if a sign is changed in `solve`.
    #[test]
    fn a_fit_is_the_least_of_its_cost() {
        let rows: Vec<Vec<f32>> =
            (0..40).map(|i| (0..6).map(|k| unit(hash(i, k)) * 4.0 - 2.0).collect()).collect();
        let sample = |(i, row): (usize, &'_ Vec<f32>)| {
            let amount = f64::from(row[0] - 2.0 * row[3]) + f64::from(unit(hash(i as u32, 9)));
            (amount, 0.5 + f64::from(unit(hash(i as u32, 10))))
        };
        let reported: Vec<(f64, f64)> = rows.iter().enumerate().map(sample).collect();
        let samples: Vec<Sample<'_>> = rows
            .iter()
            .zip(&reported)
            .map(|(numbers, &(value, weight))| Sample { numbers, value, weight })
            .collect();
        let fitted = Ridge::fit(&samples, PENALTY);
        let total: f64 = samples.iter().map(|s| s.weight).sum();
        let slope = |k: Option<usize>| -> f64 {
            let of = |s: &Sample<'_>| {
                let error = fitted.of(s.numbers) - s.value;
                s.weight / total * error * k.map_or(1.0, |k| f64::from(s.numbers[k]))
            };
            samples.iter().map(of).sum::<f64>() + k.map_or(0.0, |k| PENALTY * f64::from(fitted.weight[k]))
        };
        assert!((0..6).map(Some).chain([None]).all(|k| slope(k).abs() < 1e-5));
        assert!(fitted.weight[0] > 0.5 && fitted.weight[3] < -1.0);
    }
}
