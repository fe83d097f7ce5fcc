//! Scaling of features, and the activation of the networks.

/// Slope of the activation (leaky ReLU) below 0.
const LEAK: f32 = 0.1;
/// Largest absolute value of a scaled feature of a panorama, of a cell, and of the features that predict colour, in
/// standard deviations. Larger values are clamped.
pub const LIMITS: [f32; 3] = [3.0, 4.0, 3.0];

/// Leaky ReLU.
pub fn activate(x: f32) -> f32 {
    if x > 0.0 { x } else { LEAK * x }
}

/// Subtracts the mean of each feature, divides by its standard deviation, and clamps the result to `limit`.
pub fn scaled(values: &[f32], (mean, spread): (&[f32], &[f32]), limit: f32) -> Vec<f32> {
    let scaled = values.iter().zip(mean).zip(spread).map(|((v, mean), spread)| (v - mean) / spread);
    scaled.map(|v| v.clamp(-limit, limit)).collect()
}
