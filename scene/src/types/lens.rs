//! Lens distortion: where a lens shows a direction, and which direction a position of the picture shows.
//!
//! Directions are slopes (x/z, y/z) in the frame of the camera. A lens maps them to the slopes at which a pinhole
//! camera would show them; focal length and principal point convert these to pixels.

use engine::Corrupt;
use glam::{DMat2, DVec2};
use serde::Serialize;

use crate::math::num;

/// Largest slope that is used, the tangent of 85 degrees. Depths are along the axis of the camera, so no lens can
/// show 90 degrees.
const STEEPEST: f64 = 11.43;
/// Number of steps per unit of slope in which [`limit`] looks for the end of the range in which a lens is invertible.
const STEPS: f64 = 256.0;
/// Maximum number of steps of Newton's method. It squares the error in each, and starts within the range.
const NEWTON: usize = 24;

/// Model of lens distortion, with the formulas of OpenCV and COLMAP.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub enum LensModel {
    /// No distortion.
    #[default]
    Pinhole,
    /// The radius r is multiplied by (1 + n1 r^2 + n2 r^4 + n3 r^6 + n4 r^8) / (1 + d1 r^2 + d2 r^4 + d3 r^6), then the
    /// tangential part with p1 and p2 is added. OpenCV's k1, k2, k3 are n1, n2, n3 and its k4, k5, k6 are d1, d2, d3.
    Radial {
        /// n1 to n4.
        numerator: [f64; 4],
        /// d1 to d3.
        denominator: [f64; 3],
        /// p1 and p2.
        tangential: [f64; 2],
    },
    /// The angle a from the axis is shown at the radius a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8).
    Fisheye {
        /// k1 to k4.
        k: [f64; 4],
    },
    /// The radius r is shown at atan(2 r tan(omega / 2)) / omega.
    FieldOfView {
        /// Omega, in radians.
        omega: f64,
    },
    /// The radius s of the picture shows the radius s / (1 + k s^2).
    Division {
        /// The coefficient k.
        k: f64,
    },
}

/// A lens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Lens {
    model: LensModel,
    /// Largest radius, in slopes, up to which farther directions are shown farther from the principal point.
    limit: f64,
}

impl Default for Lens {
    fn default() -> Self {
        Self::PINHOLE
    }
}

impl From<LensModel> for Lens {
    fn from(model: LensModel) -> Self {
        if model == LensModel::Pinhole { Self::PINHOLE } else { Self { model, limit: limit(&model) } }
    }
}

impl Lens {
    /// A lens without distortion.
    pub const PINHOLE: Self = Self { model: LensModel::Pinhole, limit: f64::INFINITY };

    /// True if the lens has no distortion.
    pub fn is_pinhole(&self) -> bool {
        self.model == LensModel::Pinhole
    }

    /// Largest radius, in slopes, up to which farther directions are shown farther from the principal point. Beyond it,
    /// the formulas fold the picture over, so nothing beyond it is visible.
    pub fn limit(&self) -> f64 {
        self.limit
    }

    /// Position at which the lens shows a slope. Beyond the [`limit`](Self::limit), the position has no meaning.
    pub fn distort(&self, slope: DVec2) -> DVec2 {
        let [scale, _] = radial(&self.model, slope.length_squared());
        slope * scale + self.tangential(slope)
    }

    /// Derivative of [`distort`](Self::distort).
    pub fn derivative(&self, slope: DVec2) -> DMat2 {
        let r2 = slope.length_squared();
        let [scale, along] = radial(&self.model, r2);
        let turn = if r2 > 0.0 { (along - scale) / r2 } else { 0.0 };
        let DVec2 { x, y } = slope;
        let mut found =
            DMat2::from_cols_array(&[scale + turn * x * x, turn * x * y, turn * x * y, scale + turn * y * y]);
        if let LensModel::Radial { tangential: [p1, p2], .. } = self.model {
            let mixed = 2.0 * (p1 * x + p2 * y);
            let own = [2.0 * p1 * y + 6.0 * p2 * x, 6.0 * p1 * y + 2.0 * p2 * x];
            found += DMat2::from_cols_array(&[own[0], mixed, mixed, own[1]]);
        }
        found
    }

    /// Slope that the lens shows at a position. For a position that shows none, it is a slope at the
    /// [`limit`](Self::limit); see [`shows`](Self::shows).
    pub fn undistort(&self, at: DVec2) -> DVec2 {
        if self.is_pinhole() {
            return at;
        }
        let distance = at.length();
        if distance == 0.0 {
            return at;
        }
        let mut slope = at * (self.radius(distance) / distance);
        if !matches!(self.model, LensModel::Radial { tangential, .. } if tangential != [0.0; 2]) {
            return slope;
        }
        for _ in 0..NEWTON {
            let off = self.distort(slope) - at;
            let derivative = self.derivative(slope);
            if off.length_squared() <= 1e-30 || derivative.determinant() <= 0.0 {
                break;
            }
            slope -= derivative.inverse() * off;
            slope = slope.clamp_length_max(self.limit);
        }
        slope
    }

    /// True if the lens shows a direction at a position.
    pub fn shows(&self, at: DVec2) -> bool {
        (self.distort(self.undistort(at)) - at).length() <= 1e-9 * (1.0 + at.length())
    }

    /// The radius that the radial part shows at `distance` from the principal point, at most [`limit`](Self::limit).
    fn radius(&self, distance: f64) -> f64 {
        let shown = |r: f64| radial(&self.model, r * r)[0] * r;
        let (mut low, mut high) = (0.0, self.limit);
        if shown(high) <= distance {
            return high;
        }
        let mut r = distance.min(high);
        for _ in 0..4 * NEWTON {
            let [scale, along] = radial(&self.model, r * r);
            let off = scale * r - distance;
            if off > 0.0 {
                high = r;
            } else {
                low = r;
            }
            let step = off / along;
            let next = r - step;
            // Newton's step, or a bisection if it leaves the interval.
            let next = if next > low && next < high { next } else { 0.5 * (low + high) };
            if (next - r).abs() <= 1e-15 * r {
                break;
            }
            r = next;
        }
        r
    }

    fn tangential(&self, DVec2 { x, y }: DVec2) -> DVec2 {
        let LensModel::Radial { tangential: [p1, p2], .. } = self.model else { return DVec2::ZERO };
        let r2 = x * x + y * y;
        DVec2::new(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
    }

    /// The number of the model and its coefficients; empty for a pinhole.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        match self.model {
            LensModel::Pinhole => Vec::new(),
            LensModel::Radial { numerator, denominator, tangential } => {
                [&[1.0], &numerator[..], &denominator, &tangential].concat()
            }
            LensModel::Fisheye { k } => [&[2.0], &k[..]].concat(),
            LensModel::FieldOfView { omega } => vec![3.0, omega],
            LensModel::Division { k } => vec![4.0, k],
        }
    }

    /// The lens with these [`numbers`](Self::numbers).
    pub(crate) fn of_numbers(numbers: &[f64]) -> Result<Self, Corrupt> {
        let model = match *numbers {
            [] => LensModel::Pinhole,
            [1.0, n1, n2, n3, n4, d1, d2, d3, p1, p2] => LensModel::Radial {
                numerator: [n1, n2, n3, n4],
                denominator: [d1, d2, d3],
                tangential: [p1, p2],
            },
            [2.0, k1, k2, k3, k4] => LensModel::Fisheye { k: [k1, k2, k3, k4] },
            [3.0, omega] => LensModel::FieldOfView { omega },
            [4.0, k] => LensModel::Division { k },
            _ => return Err(Corrupt(format!("the lens {numbers:?} is unknown"))),
        };
        Ok(model.into())
    }
}

/// For the radius whose square is `r2`: the factor by which the radial part multiplies the radius, and the derivative
/// of the shown radius.
fn radial(model: &LensModel, r2: f64) -> [f64; 2] {
    match *model {
        LensModel::Pinhole => [1.0; 2],
        LensModel::Radial { numerator, denominator, .. } => {
            let ([n, by_n], [d, by_d]) = (polynomial(&numerator, r2), polynomial(&denominator, r2));
            let scale = n / d;
            [scale, scale + 2.0 * r2 * (by_n - scale * by_d) / d]
        }
        LensModel::Fisheye { k } => {
            let r = r2.sqrt();
            let angle = num::atan2(r, 1.0);
            let [factor, by_square] = polynomial(&k, angle * angle);
            let along = (factor + 2.0 * angle * angle * by_square) / (1.0 + r2);
            [if r > 0.0 { angle * factor / r } else { 1.0 }, along]
        }
        LensModel::FieldOfView { omega } => {
            let by = 2.0 * num::f64::tan(0.5 * omega);
            let r = r2.sqrt();
            let along = by / (omega * (1.0 + by * by * r2));
            [if r > 0.0 { num::atan2(by * r, 1.0) / (omega * r) } else { along }, along]
        }
        LensModel::Division { k } => {
            let root = (1.0 - 4.0 * k * r2).sqrt();
            let scale = 2.0 / (1.0 + root);
            // s = 2 r / (1 + root), so ds/dr = 2 / (1 + root) + 2 r * (4 k r / root) / (1 + root)^2 = scale / root.
            [scale, scale / root]
        }
    }
}

/// 1 + c1 x + c2 x^2 + .., and its derivative.
fn polynomial(coefficients: &[f64], x: f64) -> [f64; 2] {
    let (mut value, mut slope) = (0.0, 0.0);
    for c in coefficients.iter().rev() {
        slope = slope * x + value;
        value = value * x + c;
    }
    // The sum so far is c1 + c2 x + ..
    [1.0 + value * x, value + slope * x]
}

/// Largest radius up to which the shown radius increases, at most [`STEEPEST`].
fn limit(model: &LensModel) -> f64 {
    let increases = |r: f64| {
        let [scale, along] = radial(model, r * r);
        scale.is_finite() && along.is_finite() && scale > 0.0 && along > 0.0
    };
    let last = (STEEPEST * STEPS) as u32;
    let end = (1..=last).find(|step| !increases(f64::from(*step) / STEPS));
    let Some(end) = end else { return STEEPEST };
    let [mut low, mut high] = [end - 1, end].map(|step| f64::from(step) / STEPS);
    for _ in 0..52 {
        let middle = 0.5 * (low + high);
        if increases(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lenses as calibrations have them, the last but one with an end of its range within the picture.
    fn lenses() -> Vec<Lens> {
        let radial =
            |numerator, denominator, tangential| LensModel::Radial { numerator, denominator, tangential };
        [
            LensModel::Pinhole,
            radial([-0.28, 0.07, 0.0, 0.0], [0.0; 3], [1.2e-3, -8e-4]),
            radial([0.11, -0.02, 3e-3, -1e-4], [0.05, 0.01, 1e-3], [0.0; 2]),
            radial([-0.4, 0.0, 0.0, 0.0], [0.0; 3], [0.0; 2]),
            LensModel::Fisheye { k: [0.03, -0.01, 4e-3, -7e-4] },
            LensModel::Fisheye { k: [0.0; 4] },
            LensModel::FieldOfView { omega: 0.9 },
            LensModel::Division { k: -0.2 },
            LensModel::Division { k: 0.1 },
        ]
        .map(Lens::from)
        .to_vec()
    }

    fn slopes(within: f64) -> impl Iterator<Item = DVec2> {
        (0..400).map(move |i| {
            let (r, angle) = (f64::from(i) / 400.0 * within, 2.399_963 * f64::from(i));
            DVec2::from_angle(angle) * r
        })
    }

    /// `undistort` undoes `distort` up to the limit. This test fails if the derivative of the tangential part is left
    /// out, and if the bisection is.
    #[test]
    fn a_position_shows_the_slope_that_is_shown_there() {
        for lens in lenses() {
            for slope in slopes(0.98 * lens.limit().min(2.0)) {
                let at = lens.distort(slope);
                let found = lens.undistort(at);
                assert!((found - slope).length() < 1e-9, "{lens:?} {slope}: {found}");
                assert!(lens.shows(at));
            }
        }
        // 1 - 3 * 0.4 r^2 is 0 there.
        let lens = lenses()[3];
        assert!((lens.limit() - (1.0 / 1.2_f64).sqrt()).abs() < 1e-9, "{}", lens.limit());
        let beyond = DVec2::new(0.7, 0.0);
        assert!(!lens.shows(beyond) && (lens.undistort(beyond).length() - lens.limit()).abs() < 1e-9);
    }

    #[test]
    fn numbers_are_those_of_the_lens() {
        for lens in lenses() {
            assert!(Lens::of_numbers(&lens.numbers()).is_ok_and(|found| found == lens), "{lens:?}");
        }
        for wrong in [&[0.0][..], &[1.0, 0.1], &[5.0, 0.1], &[f64::NAN]] {
            assert!(Lens::of_numbers(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        for lens in lenses() {
            for slope in slopes(0.9 * lens.limit().min(2.0)).step_by(7) {
                let step = 1e-6;
                let by = |d: DVec2| {
                    (lens.distort(slope + d * step) - lens.distort(slope - d * step)) / (2.0 * step)
                };
                let off = lens.derivative(slope) - DMat2::from_cols(by(DVec2::X), by(DVec2::Y));
                assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-8), "{lens:?} {slope}: {off}");
            }
        }
    }
}
