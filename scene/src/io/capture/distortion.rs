//! Lens distortion of camera models, and upper bounds on how far it moves a point of the picture.

use crate::types::LensModel;

/// Distortion coefficients of the camera models of OpenCV and COLMAP, except the fisheye models. OpenCV uses `k4`
/// in the denominator of its rational model, and nerfstudio as the coefficient of r^8. The bound of
/// [`Coefficients::pixels`] holds for both uses.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Coefficients {
    /// Radial coefficients k1 to k6.
    pub k: [f64; 6],
    /// Tangential coefficients p1 and p2.
    pub p: [f64; 2],
    /// `omega` of COLMAP's FOV model.
    pub omega: f64,
}

/// Lens distortion of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Bend {
    /// Model and its coefficients, for messages.
    pub text: String,
    /// The model, if it is one that cameras can have.
    pub model: Option<LensModel>,
    /// Upper bound of the displacement of a point of the picture, in pixels; infinite for fisheye lenses.
    pub pixels: f64,
}

/// Displacement in pixels below which distortion is ignored, since it is not visible.
pub const INVISIBLE_PX: f64 = 0.05;

impl Coefficients {
    /// Upper bound of the displacement, in pixels, for a picture of this size and a lens (fx, fy, cx, cy):
    /// the sum of the absolute terms at the corner farthest from the principal point.
    pub fn pixels(&self, [width, height]: [u64; 2], [fx, fy, cx, cy]: [f64; 4]) -> f64 {
        let far = |size: u64, middle: f64, focal: f64| middle.abs().max((size as f64 - middle).abs()) / focal;
        let (x, y) = (far(width, cx, fx), far(height, cy, fy));
        let r2 = x * x + y * y;
        let r = r2.sqrt();
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let powers = [r2, r4, r6, r2.max(r4 * r4), r4.max(r4 * r6), r6.max(r6 * r6)];
        let radial: f64 = self.k.iter().zip(powers).map(|(k, power)| k.abs() * power).sum();
        let tangential = 4.0 * r * (self.p[0].abs() + self.p[1].abs());
        let fov = self.omega * self.omega * (r2 / 3.0 + 1.0 / 12.0);
        fx.max(fy) * r * (radial + tangential + fov)
    }

    /// The lens model, with OpenCV's use of `k4` to `k6` as the denominator.
    pub fn rational(&self) -> LensModel {
        let [k1, k2, k3, denominator @ ..] = self.k;
        LensModel::Radial { numerator: [k1, k2, k3, 0.0], denominator, tangential: self.p }
    }

    /// The lens model, with nerfstudio's use of `k4` as the coefficient of r^8. `None` if `k5` or `k6` is not 0.
    pub fn polynomial(&self) -> Option<LensModel> {
        let [k1, k2, k3, k4, k5, k6] = self.k;
        let model =
            LensModel::Radial { numerator: [k1, k2, k3, k4], denominator: [0.0; 3], tangential: self.p };
        ([k5, k6] == [0.0; 2]).then_some(model)
    }

    /// The fisheye model with `k1` to `k4`. `None` if another coefficient is not 0.
    pub fn fisheye(&self) -> Option<LensModel> {
        let [k @ .., k5, k6] = self.k;
        ([k5, k6, self.p[0], self.p[1]] == [0.0; 4]).then_some(LensModel::Fisheye { k })
    }

    /// True if the lens has no distortion.
    pub fn is_zero(&self) -> bool {
        *self == Self::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bound is at least the true displacement of OpenCV's model, and not much larger.
    #[test]
    fn displacement_is_bounded() {
        let (size, lens) = ([640, 480], [500.0, 510.0, 320.0, 250.0]);
        for c in [
            Coefficients { k: [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0], ..Coefficients::default() },
            Coefficients { k: [-1e-3, 2e-3, 1e-3, 0.0, 0.0, 0.0], p: [1e-4, -2e-4], omega: 0.0 },
            Coefficients { p: [1e-3, 1e-3], ..Coefficients::default() },
        ] {
            let mut most = 0.0_f64;
            for (u, v) in
                (0..=20).flat_map(|i| (0..=20).map(move |j| (f64::from(i) / 20.0, f64::from(j) / 20.0)))
            {
                let (x, y) = ((u * 640.0 - lens[2]) / lens[0], (v * 480.0 - lens[3]) / lens[1]);
                let r2 = x * x + y * y;
                let radial = c.k[0] * r2 + c.k[1] * r2 * r2 + c.k[2] * r2 * r2 * r2;
                let dx = x * radial + 2.0 * c.p[0] * x * y + c.p[1] * (r2 + 2.0 * x * x);
                let dy = y * radial + c.p[0] * (r2 + 2.0 * y * y) + 2.0 * c.p[1] * x * y;
                most = most.max(glam::DVec2::new(dx * lens[0], dy * lens[1]).length());
            }
            let bound = c.pixels(size, lens);
            assert!((most..6.0 * most).contains(&bound), "{most} {bound}");
        }
        assert!(Coefficients::default().is_zero());
    }
}
