//! The curve of an animated property: keys in time, and the interpolation between them (glTF 2.0, appendix C).

use crate::math::num;

/// Interpolation between the keys of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// The value of the last key.
    Step,
    /// Linear, component by component.
    Linear,
    /// Linear in angle, for unit quaternions.
    Spherical,
    /// Cubic Hermite spline, with an incoming and an outgoing tangent for each key.
    Cubic,
}

/// Cosine of the angle between two quaternions above which they are interpolated component by component, since the
/// sine of their angle is too small to divide by.
const NEARLY_EQUAL: f64 = 0.999_999;

/// An animated property over time.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Times of the keys in seconds, strictly increasing.
    times: Vec<f64>,
    /// Values of the keys, one after another. For [`Interpolation::Cubic`] each key has the incoming tangent, the
    /// value and the outgoing tangent.
    values: Vec<f64>,
    /// Number of components of the property.
    width: usize,
    interpolation: Interpolation,
}

impl Curve {
    /// Creates a curve. `width` is the number of components of the property, or `None` if it follows from the number
    /// of values.
    ///
    /// # Errors
    /// What is wrong with the keys, as the end of a sentence about the channel.
    pub fn new(
        times: Vec<f64>,
        values: Vec<f64>,
        width: Option<usize>,
        interpolation: Interpolation,
    ) -> Result<Self, String> {
        let keys = times.len();
        let is_increasing = times.windows(2).all(|pair| pair[0] < pair[1]);
        if keys == 0 || !is_increasing || times.iter().any(|t| !t.is_finite() || *t < 0.0) {
            return Err("needs key times that are finite, not negative and strictly increasing".to_owned());
        }
        let per_key = if interpolation == Interpolation::Cubic { 3 } else { 1 };
        let width = width.unwrap_or(values.len() / (keys * per_key));
        let expected = keys * per_key * width;
        if values.len() != expected || width == 0 {
            return Err(format!("has {} values; {keys} keys need {expected}", values.len()));
        }
        if values.iter().any(|value| !value.is_finite()) {
            return Err("has values that are not finite".to_owned());
        }
        Ok(Self { times, values, width, interpolation })
    }

    /// Time of the last key in seconds.
    pub fn end(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Number of components of the property.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The components of the property at a time in seconds. Before the first key, the value is that of the first
    /// key; after the last key, it is that of the last key.
    pub fn at(&self, seconds: f64) -> Vec<f64> {
        let after = self.times.partition_point(|t| *t <= seconds);
        if after == 0 {
            return self.value(0).to_vec();
        }
        let key = after - 1;
        if after == self.times.len() || self.interpolation == Interpolation::Step {
            return self.value(key).to_vec();
        }
        let step = self.times[after] - self.times[key];
        let u = (seconds - self.times[key]) / step;
        let (a, b) = (self.value(key), self.value(after));
        match self.interpolation {
            Interpolation::Step | Interpolation::Linear => mixed(a, b, 1.0 - u, u),
            Interpolation::Spherical => spherical(a, b, u),
            Interpolation::Cubic => {
                let (square, cube) = (u * u, u * u * u);
                let weights = [
                    2.0 * cube - 3.0 * square + 1.0,
                    step * (cube - 2.0 * square + u),
                    3.0 * square - 2.0 * cube,
                    step * (cube - square),
                ];
                let parts = [a, self.part(key, 2), b, self.part(after, 0)];
                let sum = |i: usize| parts.iter().zip(weights).map(|(part, weight)| weight * part[i]).sum();
                (0..self.width).map(sum).collect()
            }
        }
    }

    /// The value of a key.
    fn value(&self, key: usize) -> &[f64] {
        if self.interpolation == Interpolation::Cubic {
            self.part(key, 1)
        } else {
            &self.values[key * self.width..][..self.width]
        }
    }

    /// The incoming tangent (0), the value (1) or the outgoing tangent (2) of a key of a spline.
    fn part(&self, key: usize, part: usize) -> &[f64] {
        &self.values[(3 * key + part) * self.width..][..self.width]
    }
}

/// The sum of two lists of numbers with weights.
fn mixed(a: &[f64], b: &[f64], of_a: f64, of_b: f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| of_a * a + of_b * b).collect()
}

/// Spherical linear interpolation between two quaternions along the shorter arc.
fn spherical(a: &[f64], b: &[f64], u: f64) -> Vec<f64> {
    let length = |q: &[f64]| q.iter().map(|c| c * c).sum::<f64>().sqrt();
    let (of_a, of_b) = (1.0 / length(a), 1.0 / length(b));
    if !(of_a.is_finite() && of_b.is_finite()) {
        return mixed(a, b, 1.0 - u, u);
    }
    let cosine = a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() * of_a * of_b;
    // Both signs of a quaternion are the same rotation.
    let of_b = if cosine < 0.0 { -of_b } else { of_b };
    let cosine = cosine.abs();
    if cosine > NEARLY_EQUAL {
        return mixed(a, b, (1.0 - u) * of_a, u * of_b);
    }
    let angle = num::f64::acos(cosine);
    let sine = num::f64::sin(angle);
    mixed(a, b, num::f64::sin((1.0 - u) * angle) / sine * of_a, num::f64::sin(u * angle) / sine * of_b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(values: &[f64], width: usize, interpolation: Interpolation) -> Curve {
        Curve::new(vec![0.5, 1.0, 3.0], values.to_vec(), Some(width), interpolation)
            .unwrap_or_else(|e| panic!("{e}"))
    }

    /// A key counts at its own time, the first and the last key count outside.
    #[test]
    fn steps_and_lines_pass_through_their_keys() {
        let steps = curve(&[1.0, 2.0, 5.0], 1, Interpolation::Step);
        let lines = curve(&[1.0, 2.0, 5.0], 1, Interpolation::Linear);
        let at = [0.0, 0.5, 0.75, 1.0, 2.0, 3.0, 9.0];
        assert_eq!(at.map(|t| steps.at(t)[0]), [1.0, 1.0, 1.0, 2.0, 2.0, 5.0, 5.0]);
        assert_eq!(at.map(|t| lines.at(t)[0]), [1.0, 1.0, 1.5, 2.0, 3.5, 5.0, 5.0]);
        assert_eq!((lines.end(), lines.width()), (3.0, 1));
    }

    /// A spline whose keys and tangents are those of t^3 is t^3: this fails if the tangents are not multiplied by
    /// the length of the interval, or if incoming and outgoing tangents are exchanged.
    #[test]
    fn a_spline_reproduces_a_cubic() {
        let keys = [0.5_f64, 1.0, 3.0].map(|t| [3.0 * t * t, t * t * t, 3.0 * t * t]);
        let cubic = curve(keys.as_flattened(), 1, Interpolation::Cubic);
        for t in [0.5_f64, 0.6, 0.99, 1.0, 1.7, 2.9, 3.0] {
            assert!((cubic.at(t)[0] - t * t * t).abs() < 1e-12, "{t}");
        }
        // With other tangents on both sides of a key, only its own side matters.
        let broken = curve(&[9.0, 0.0, 0.0, 0.0, 1.0, 7.0, 0.0, 1.0, 9.0], 1, Interpolation::Cubic);
        assert!((broken.at(0.75)[0] - 0.5).abs() < 1e-12);
    }

    /// The angle grows linearly, along the shorter arc whatever the signs.
    #[test]
    fn rotations_turn_at_a_constant_rate() {
        let turn = |degrees: f64| {
            let (sin, cos) = num::sin_cos_deg(0.5 * degrees);
            [0.0, 0.0, sin, cos]
        };
        let negative = turn(90.0).map(|c| -2.0 * c);
        let spin =
            curve([turn(0.0), negative, turn(91e-5 + 90.0)].as_flattened(), 4, Interpolation::Spherical);
        for (time, degrees) in [(0.5, 0.0), (0.625, 22.5), (0.75, 45.0), (2.0, 90.0 + 45.5e-5)] {
            let q = spin.at(time);
            let expected = turn(degrees);
            let dot: f64 = q.iter().zip(expected).map(|(a, b)| a * b).sum();
            let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            assert!((dot.abs() / length - 1.0).abs() < 1e-12, "{time}: {q:?}");
        }
    }

    #[test]
    fn keys_that_are_not_valid_are_refused() {
        let of = |times: &[f64], values: &[f64], width| {
            Curve::new(times.to_vec(), values.to_vec(), width, Interpolation::Linear)
                .err()
                .unwrap_or_default()
        };
        assert!(of(&[], &[], Some(3)).contains("strictly increasing"));
        assert!(of(&[0.0, 0.0], &[1.0, 2.0], Some(1)).contains("strictly increasing"));
        assert!(of(&[-1.0], &[1.0], Some(1)).contains("not negative"));
        assert!(of(&[0.0, f64::NAN], &[1.0, 2.0], Some(1)).contains("finite"));
        assert_eq!(of(&[0.0, 1.0], &[1.0; 5], Some(3)), "has 5 values; 2 keys need 6");
        assert_eq!(of(&[0.0, 1.0], &[1.0; 5], None), "has 5 values; 2 keys need 4");
        assert!(of(&[0.0], &[f64::INFINITY], Some(1)).contains("not finite"));
    }
}
