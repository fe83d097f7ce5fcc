//! Spherical harmonics under a rotation or reflection.
//!
//! A band of degree l maps onto itself: the coefficients c' of the rotated function f(Q^T d) are D c with D_mn =
//! integral of Y_m(Q d) Y_n(d) over the sphere. The integrand is a polynomial of degree 2l <= 8, so five
//! Gauss-Legendre nodes in z and nine angles give it exactly, up to rounding.

use glam::{DMat3, DVec3};

use crate::math::num;

/// Number of functions in the highest band, degree 4.
const WIDEST: usize = 9;

/// The matrices of bands 1 to 4.
#[derive(Debug, Clone)]
pub struct ShTurn([[[f64; WIDEST]; WIDEST]; 4]);

/// The functions of band `l` in the unit direction `d`: m = -l to l, with the Condon-Shortley phase, which is the
/// convention of the INRIA rasterizer; the common factor of the band is left out.
fn band(l: usize, d: DVec3) -> [f64; WIDEST] {
    let mut out = [0.0; WIDEST];
    // (x + iy)^m and, by the usual recurrences, P_l^m(z) over sin^m.
    let (mut re, mut im, mut diagonal) = (1.0, 0.0, 1.0);
    let mut factor = 1.0_f64;
    for m in 0..=l {
        let (mut before, mut p) = (0.0, diagonal);
        for k in m + 1..=l {
            let next = ((2 * k - 1) as f64 * d.z * p - (k + m - 1) as f64 * before) / (k - m) as f64;
            (before, p) = (p, next);
        }
        // sqrt((l - m)! / (l + m)!), with a factor of 2 under the root except for m = 0.
        let norm: f64 = if m == 0 { 1.0 } else { (2.0 / factor).sqrt() };
        out[l + m] = norm * p * re;
        if m > 0 {
            out[l - m] = norm * p * im;
        }
        (re, im) = (re * d.x - im * d.y, re * d.y + im * d.x);
        diagonal *= -((2 * m + 1) as f64);
        if m < l {
            factor *= ((l - m) * (l + m + 1)) as f64;
        }
    }
    out
}

impl ShTurn {
    /// The matrices for the orthogonal matrix `q`: a feature in direction d moves to direction `q d`.
    pub fn new(q: DMat3) -> Self {
        // Abramowitz and Stegun, table 25.4, n = 5, in closed form.
        let root = |sign: f64| (5.0 + sign * 2.0 * (10.0_f64 / 7.0).sqrt()).sqrt() / 3.0;
        let weight = |sign: f64| (322.0 + sign * 13.0 * 70.0_f64.sqrt()) / 900.0;
        let (inner, outer) = (root(-1.0), root(1.0));
        let nodes = [
            (-outer, weight(-1.0)),
            (-inner, weight(1.0)),
            (0.0, 128.0 / 225.0),
            (inner, weight(1.0)),
            (outer, weight(-1.0)),
        ];
        let mut bands = [[[0.0; WIDEST]; WIDEST]; 4];
        for (l, matrix) in (1..).zip(&mut bands) {
            // A band's sum of squares is 1 everywhere as `band` scales it, so its mean square is 1/(2l+1).
            let scale = (2 * l + 1) as f64 / (2.0 * 9.0);
            for (z, weight) in nodes {
                let r = (1.0 - z * z).sqrt();
                for k in 0..9 {
                    let (sin, cos) = num::sin_cos(std::f64::consts::TAU * f64::from(k) / 9.0);
                    let d = DVec3::new(r * cos, r * sin, z);
                    let (from, to) = (band(l, d), band(l, q * d));
                    for (row, to) in matrix.iter_mut().zip(to) {
                        for (cell, from) in row.iter_mut().zip(from) {
                            *cell += scale * weight * to * from;
                        }
                    }
                }
            }
            // Axes that are permuted or negated only move and negate coefficients, which must be exact.
            for cell in matrix.as_flattened_mut() {
                let whole = cell.round();
                if (*cell - whole).abs() < 1e-12 {
                    *cell = whole;
                }
            }
        }
        Self(bands)
    }

    /// Rotates the coefficients of one splat in place. They are RGB triples, degree 0 first.
    pub fn apply(&self, sh: &mut [[f32; 3]]) {
        let mut start = 1;
        for (l, matrix) in (1..).zip(&self.0) {
            let Some(own) = sh.get_mut(start..start + 2 * l + 1) else { return };
            let mut turned = [[0.0_f64; 3]; WIDEST];
            for (to, row) in turned.iter_mut().zip(matrix).take(own.len()) {
                for (weight, from) in row.iter().zip(own.iter()) {
                    for (sum, value) in to.iter_mut().zip(from) {
                        *sum += weight * f64::from(*value);
                    }
                }
            }
            for (to, from) in own.iter_mut().zip(turned) {
                *to = from.map(|value| value as f32);
            }
            start += 2 * l + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(sh: &[[f32; 3]], d: DVec3) -> f64 {
        let mut start = 1;
        let mut sum = f64::from(sh[0][0]);
        for l in 1..=4 {
            let own = &sh[start..start + 2 * l + 1];
            sum += band(l, d).iter().zip(own).map(|(b, c)| b * f64::from(c[0])).sum::<f64>();
            start += 2 * l + 1;
        }
        sum
    }

    fn coefficients() -> Vec<[f32; 3]> {
        (0..25).map(|i| [(i * 37 % 19) as f32 / 10.0 - 0.9, i as f32, -(i as f32)]).collect()
    }

    // The polynomials of the INRIA code up to the factor of the band, one per degree and sign (forward.cu).
    #[test]
    fn functions_are_those_of_the_inria_rasterizer() {
        let d = DVec3::new(0.36, 0.48, 0.8);
        let (x, y, z) = (d.x, d.y, d.z);
        let first = band(1, d);
        assert!((first[0] + y).abs() < 1e-15 && (first[1] - z).abs() < 1e-15 && (first[2] + x).abs() < 1e-15);
        let ratio = 1.092_548_430_592_079 / 0.315_391_565_252_52;
        let second = band(2, d);
        let middle = second[2] / (2.0 * z * z - x * x - y * y);
        assert!((second[0] - ratio * middle * x * y).abs() < 1e-12);
        assert!((second[1] + ratio * middle * y * z).abs() < 1e-12);
        assert!((second[4] - 0.5 * ratio * middle * (x * x - y * y)).abs() < 1e-12);
        let third = band(3, d);
        let middle = third[3] / (z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)) / 0.373_176_332_590_115_4;
        let edge = -0.590_043_589_926_643_5 * y * (3.0 * x * x - y * y);
        assert!((third[0] - middle * edge).abs() < 1e-12);
        let near = 1.445_305_721_320_277 * z * (x * x - y * y);
        assert!((third[5] - middle * near).abs() < 1e-12);
    }

    #[test]
    fn turned_function_looks_the_same_from_the_turned_side() {
        let s = 0.5_f64.sqrt();
        let rotation = DMat3::from_cols_array(&[s, s, 0.0, -0.5, 0.5, s, 0.5, -0.5, s]);
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        for q in [rotation, mirror, mirror * rotation, DMat3::IDENTITY] {
            let turn = ShTurn::new(q);
            let mut sh = coefficients();
            turn.apply(&mut sh);
            for d in [DVec3::X, DVec3::new(0.36, 0.48, 0.8), DVec3::new(-0.48, 0.64, -0.6)] {
                let (before, after) = (value(&coefficients(), d), value(&sh, q * d));
                // Coefficients are f32 of up to 25.
                assert!((before - after).abs() < 1e-5, "{before} {after}");
            }
        }
    }

    // A half turn only changes signs, so coefficients must keep every bit.
    #[test]
    fn half_turns_are_exact() {
        let turn = ShTurn::new(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)));
        let mut sh = coefficients();
        turn.apply(&mut sh);
        for (a, b) in sh.iter().zip(coefficients()) {
            assert!(a.iter().zip(b).all(|(a, b)| a.abs() == b.abs()));
        }
        turn.apply(&mut sh);
        assert_eq!(sh, coefficients());
    }
}
