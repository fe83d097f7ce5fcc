//! The filmic curve of Hable: "Uncharted 2: HDR Lighting" (Game Developers Conference, 2010).

/// Light that is shown as white.
const WHITE: f64 = 11.2;
/// Gain before the curve, which shows middle grey about as dark as a display without a curve does.
const GAIN: f64 = 2.0;

/// Light of a display, 0 to 1, for one channel of scene light. Negative light counts as 0.
pub(super) fn compressed(light: f64) -> f64 {
    (curve((light.max(0.0) * GAIN).min(WHITE)) / curve(WHITE)).clamp(0.0, 1.0)
}

/// The curve with its published constants: shoulder strength 0.15, linear strength 0.50, linear angle 0.10, toe
/// strength 0.20, toe numerator 0.02, toe denominator 0.30.
fn curve(x: f64) -> f64 {
    let (a, b, c, d, e, f) = (0.15, 0.50, 0.10, 0.20, 0.02, 0.30);
    (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f
}
