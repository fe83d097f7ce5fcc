//! The colour difference CIEDE2000 (Sharma, Wu and Dalal 2005), between display-encoded pictures.

use engine::{Context, NodeError};

use super::plane::Plane;
use crate::math::num;

/// The CIEDE2000 difference of every pixel of two sRGB-encoded pictures (0 to 1, three channels). A difference of
/// about 1 is just visible; black and white differ by 100. Uses CIELAB under D65 for the 2 degree observer, with
/// the three parametric factors set to 1.
pub fn ciede2000_map(a: &Plane, b: &Plane, cx: &Context) -> Result<Vec<f64>, NodeError> {
    let rows = cx.for_each_tile(a.height, |y| {
        let pixel = |p: &Plane, x: usize| {
            let at = (y * p.width + x) * p.channels;
            lab([p.samples[at], p.samples[at + 1], p.samples[at + 2]])
        };
        (0..a.width).map(|x| difference(pixel(a, x), pixel(b, x))).collect::<Vec<_>>()
    })?;
    Ok(rows.concat())
}

/// CIELAB of an sRGB-encoded colour. The matrix and the white point are rounded as in scikit-image, which computes
/// the values in most papers.
fn lab(srgb: [f64; 3]) -> [f64; 3] {
    const XYZ: [[f64; 3]; 3] =
        [[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]];
    const WHITE: [f64; 3] = [0.95047, 1.0, 1.08883];
    let linear = srgb.map(|v| if v > 0.04045 { num::pow((v + 0.055) / 1.055, 2.4) } else { v / 12.92 });
    let f: [f64; 3] = std::array::from_fn(|i| {
        let t = (XYZ[i][0] * linear[0] + XYZ[i][1] * linear[1] + XYZ[i][2] * linear[2]) / WHITE[i];
        if t > 0.008856 { libm::cbrt(t) } else { 7.787 * t + 16.0 / 116.0 }
    });
    [116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])]
}

/// The difference between two colours in CIELAB. Numbers in the comments are the numbers of equations in the paper.
fn difference(one: [f64; 3], two: [f64; 3]) -> f64 {
    let pow7 = |x: f64| {
        let x2 = x * x;
        x2 * x2 * x2 * x
    };
    // 2 to 7: near grey, less weight.
    let chroma = |c: [f64; 3]| (c[1] * c[1] + c[2] * c[2]).sqrt();
    let mean7 = pow7(0.5 * (chroma(one) + chroma(two)));
    let g = 0.5 * (1.0 - (mean7 / (mean7 + pow7(25.0))).sqrt());
    let polar = |c: [f64; 3]| {
        let a = (1.0 + g) * c[1];
        let chroma = (a * a + c[2] * c[2]).sqrt();
        let hue = if chroma == 0.0 { 0.0 } else { num::atan2(c[2], a).to_degrees() };
        (chroma, if hue < 0.0 { hue + 360.0 } else { hue })
    };
    let ((c1, h1), (c2, h2)) = (polar(one), polar(two));
    // 8 to 11.
    let grey = c1 * c2 == 0.0;
    let turn = match h2 - h1 {
        _ if grey => 0.0,
        d if d > 180.0 => d - 360.0,
        d if d < -180.0 => d + 360.0,
        d => d,
    };
    let (d_l, d_c) = (two[0] - one[0], c2 - c1);
    let d_h = 2.0 * (c1 * c2).sqrt() * num::f64::sin((0.5 * turn).to_radians());
    // 12 to 14.
    let (l, c) = (0.5 * (one[0] + two[0]), 0.5 * (c1 + c2));
    let h = match (h1 - h2).abs() {
        _ if grey => h1 + h2,
        apart if apart <= 180.0 => 0.5 * (h1 + h2),
        _ if h1 + h2 < 360.0 => 0.5 * (h1 + h2 + 360.0),
        _ => 0.5 * (h1 + h2 - 360.0),
    };
    // 15 to 22.
    let cos = |deg: f64| num::f64::cos(deg.to_radians());
    let t = 1.0 - 0.17 * cos(h - 30.0) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + 6.0)
        - 0.20 * cos(4.0 * h - 63.0);
    let bend = (h - 275.0) / 25.0;
    let theta = 30.0 * num::f64::exp(-bend * bend);
    let r_c = 2.0 * (pow7(c) / (pow7(c) + pow7(25.0))).sqrt();
    let off = (l - 50.0) * (l - 50.0);
    let s_l = 1.0 + 0.015 * off / (20.0 + off).sqrt();
    let (s_c, s_h) = (1.0 + 0.045 * c, 1.0 + 0.015 * c * t);
    let r_t = -num::f64::sin((2.0 * theta).to_radians()) * r_c;
    let (l, c, h) = (d_l / s_l, d_c / s_c, d_h / s_h);
    (l * l + c * c + h * h + r_t * c * h).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    // Pairs 1, 4, 7, 10, 14, 20 and 34 of the table of test data in the paper, which prints four digits.
    #[test]
    fn the_pairs_of_the_paper() {
        for (one, two, wanted) in [
            ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
            ([50.0, -1.3802, -84.2814], [50.0, 0.0, -82.7485], 1.0000),
            ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
            ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0010], 7.1792),
            ([50.0, -0.0010, 2.4900], [50.0, 0.0011, -2.4900], 4.7461),
            ([50.0, 2.5, 0.0], [50.0, 3.2592, 0.3350], 1.0000),
            ([2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082),
        ] {
            let found = difference(one, two);
            assert!((found - wanted).abs() < 6e-5, "{one:?} {two:?}: {found}, not {wanted}");
            assert!((difference(two, one) - wanted).abs() < 6e-5);
        }
    }

    #[test]
    fn nothing_and_everything() {
        assert_eq!(difference(lab([0.3, 0.5, 0.7]), lab([0.3, 0.5, 0.7])), 0.0);
        assert!((difference(lab([0.0; 3]), lab([1.0; 3])) - 100.0).abs() < 1e-4);
    }
}
