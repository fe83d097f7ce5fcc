//! Small symmetric systems of linear equations.

/// Square matrix.
#[derive(Debug, Clone)]
pub(super) struct Matrix {
    size: usize,
    /// Row by row.
    values: Vec<f64>,
}

impl Matrix {
    /// Matrix of zeros with `size` rows.
    pub fn zero(size: usize) -> Self {
        Self { size, values: vec![0.0; size * size] }
    }

    /// Element in a row and a column.
    pub fn at(&self, row: usize, column: usize) -> f64 {
        self.values[row * self.size + column]
    }

    /// Adds a number to an element.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        self.values[row * self.size + column] += value;
    }

    /// Multiplies all elements.
    pub fn scale(&mut self, by: f64) {
        self.values.iter_mut().for_each(|value| *value *= by);
    }

    /// Copies the elements below the diagonal to those above it.
    pub fn mirrored(mut self) -> Self {
        for row in 0..self.size {
            for column in 0..row {
                self.values[column * self.size + row] = self.at(row, column);
            }
        }
        self
    }

    /// Solves the equations of a symmetric positive-definite matrix by Cholesky's method. `None` if the matrix is not
    /// positive definite.
    pub fn solve(&self, right: &[f64]) -> Option<Vec<f64>> {
        let n = self.size;
        let mut factor = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let inner: f64 = (0..j).map(|k| factor[i * n + k] * factor[j * n + k]).sum();
                let rest = self.at(i, j) - inner;
                factor[i * n + j] = if i == j {
                    if !(rest > 0.0 && rest.is_finite()) {
                        return None;
                    }
                    rest.sqrt()
                } else {
                    rest / factor[j * n + j]
                };
            }
        }
        let mut solved = right.to_vec();
        for i in 0..n {
            let inner: f64 = (0..i).map(|k| factor[i * n + k] * solved[k]).sum();
            solved[i] = (solved[i] - inner) / factor[i * n + i];
        }
        for i in (0..n).rev() {
            let inner: f64 = (i + 1..n).map(|k| factor[k * n + i] * solved[k]).sum();
            solved[i] = (solved[i] - inner) / factor[i * n + i];
        }
        Some(solved)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // This test fails if `solve` uses the transposed factor in the second substitution.
    #[test]
    fn the_solution_satisfies_the_equations() {
        let mut matrix = Matrix::zero(3);
        for (i, row) in [[4.0, 1.0, -0.5], [1.0, 3.0, 0.7], [-0.5, 0.7, 2.0]].into_iter().enumerate() {
            row.into_iter().enumerate().for_each(|(j, value)| matrix.add(i, j, value));
        }
        let right = [1.0, -2.0, 0.25];
        let solved = matrix.solve(&right).expect("positive definite");
        for (i, want) in right.into_iter().enumerate() {
            let sum: f64 = (0..3).map(|j| matrix.at(i, j) * solved[j]).sum();
            assert!((sum - want).abs() < 1e-12);
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_is_refused() {
        let mut matrix = Matrix::zero(2);
        matrix.add(0, 0, 1.0);
        assert!(matrix.solve(&[1.0, 1.0]).is_none());
        matrix.add(1, 1, f64::NAN);
        assert!(matrix.solve(&[1.0, 1.0]).is_none());
    }
}
