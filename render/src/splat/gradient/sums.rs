//! Sums over pixels from which the gradient of a footprint follows.

use std::ops::AddAssign;

/// Sums over the pixels that a footprint covers. `q` is the derivative of the loss by the exponent of alpha to base
/// 2, divided by ln 2; `t` and `s` are the coordinates of `Footprint`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sums {
    /// Sum of `q`.
    pub q: f32,
    /// Sum of `q t`.
    pub t: f32,
    /// Sum of `q t^2`.
    pub tt: f32,
    /// Sum of `q s`.
    pub s: f32,
    /// Sum of `q t s`.
    pub ts: f32,
    /// Sum of `q s^2`.
    pub ss: f32,
    /// Gradient with respect to the colour of the splat.
    pub rgb: [f32; 3],
    /// Sum of the weights of the splat. It is 0 only if the splat is not blended into any pixel.
    pub weight: f32,
}

impl Sums {
    /// Sums over no pixels.
    pub const ZERO: Self =
        Self { q: 0.0, t: 0.0, tt: 0.0, s: 0.0, ts: 0.0, ss: 0.0, rgb: [0.0; 3], weight: 0.0 };
}

impl AddAssign for Sums {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.q += other.q;
        self.t += other.t;
        self.tt += other.tt;
        self.s += other.s;
        self.ts += other.ts;
        self.ss += other.ss;
        for (sum, value) in self.rgb.iter_mut().zip(other.rgb) {
            *sum += value;
        }
        self.weight += other.weight;
    }
}
