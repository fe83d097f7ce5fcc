//! Adam (Kingma and Ba 2015) for the rows of a table of which few change per iteration. The moments of a row change
//! only if the row does, and its bias is corrected by the number of its own updates.

/// Decay of the first moment per update.
pub const BETA1: f32 = 0.9;
/// Decay of the second moment per update.
pub const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-15;

/// Factors that correct the bias of the moments after a number of updates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    first: f32,
    /// Square root of the factor on the second moment.
    second: f32,
}

/// Corrections for all numbers of updates. The bias of the second moment is below the precision of f32 at the end
/// of the table.
#[derive(Debug, Clone)]
pub struct Corrections(Vec<Correction>);

/// Number of updates after which the corrections are 1.
const CORRECTED: usize = 20_000;

impl Default for Corrections {
    /// Computes the corrections.
    fn default() -> Self {
        let (mut power1, mut power2) = (1.0_f64, 1.0_f64);
        let of = |_| {
            power1 *= f64::from(BETA1);
            power2 *= f64::from(BETA2);
            Correction { first: (1.0 / (1.0 - power1)) as f32, second: (1.0 / (1.0 - power2)).sqrt() as f32 }
        };
        Self((0..CORRECTED).map(of).collect())
    }
}

impl Corrections {
    /// Correction for the update with this number, from 1.
    pub fn of(&self, update: u32) -> Correction {
        let at = (update as usize).clamp(1, CORRECTED) - 1;
        self.0.get(at).copied().unwrap_or(Correction { first: 1.0, second: 1.0 })
    }
}

/// Updates the moments of a row and subtracts the step from its parameters. `rates` has the learning rate of each
/// parameter. All slices have equal lengths.
#[inline(always)]
pub fn update(
    parameters: &mut [f32],
    gradient: &[f32],
    (first, second): (&mut [f32], &mut [f32]),
    rates: &[f32],
    correction: Correction,
) {
    let n = parameters.len();
    let (gradient, first, second, rates) = (&gradient[..n], &mut first[..n], &mut second[..n], &rates[..n]);
    for i in 0..n {
        let g = gradient[i];
        let m = BETA1 * first[i] + (1.0 - BETA1) * g;
        let v = BETA2 * second[i] + (1.0 - BETA2) * (g * g);
        first[i] = m;
        second[i] = v;
        parameters[i] -= rates[i] * correction.first * m / (v.sqrt() * correction.second + EPSILON);
    }
}

/// Adam for a few parameters that change at every use.
pub fn update_few<const N: usize>(
    parameters: &mut [f32; N],
    gradient: [f32; N],
    moments: &mut [[f32; N]; 2],
    rate: f32,
    correction: Correction,
) {
    let [first, second] = moments;
    update(parameters, &gradient, (first, second), &[rate; N], correction);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first step has the length of the learning rate whatever the size of the gradient, and steps agree with
    /// the formulas of the paper in f64.
    #[test]
    fn steps_follow_the_paper() {
        let corrections = Corrections::default();
        let (mut parameter, mut moments) = ([1.0_f32], [[0.0_f32]; 2]);
        let (mut m, mut v, mut expected) = (0.0_f64, 0.0_f64, 1.0_f64);
        for update in 1..=50_u32 {
            let g = f64::from((update * 7 % 5) as f32 - 1.5) * 1e-6;
            update_few(&mut parameter, [g as f32], &mut moments, 0.01, corrections.of(update));
            m = 0.9 * m + 0.1 * g;
            v = 0.999 * v + 0.001 * g * g;
            let (b1, b2) = (
                1.0 - scene::math::num::pow(0.9, f64::from(update)),
                1.0 - scene::math::num::pow(0.999, f64::from(update)),
            );
            expected -= 0.01 * (m / b1) / ((v / b2).sqrt() + 1e-15);
            if update == 1 {
                assert!((parameter[0] - 0.99).abs() < 1e-6 || (parameter[0] - 1.01).abs() < 1e-6);
            }
        }
        assert!((f64::from(parameter[0]) - expected).abs() < 2e-5, "{} {expected}", parameter[0]);
        assert!(corrections.of(u32::MAX).second - 1.0 < 1e-6);
    }
}
