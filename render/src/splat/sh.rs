//! Real spherical harmonics in the order and signs of the INRIA rasterizer (forward.cu,
//! `computeColorFromSH`), continued to degree 4 in the same convention (gsplat, `_torch_impl.py`).

/// Number of basis functions up to degree 4.
pub(super) const MAX_LEN: usize = 25;

/// The basis functions up to `degree` (0 to 4) in the unit direction `(x, y, z)` from eye to splat.
#[inline(always)]
pub(super) fn basis(degree: u32, [x, y, z]: [f32; 3]) -> [f32; MAX_LEN] {
    let mut b = [0.0; MAX_LEN];
    b[0] = 0.282_094_8;
    if degree == 0 {
        return b;
    }
    b[1] = -0.488_602_52 * y;
    b[2] = 0.488_602_52 * z;
    b[3] = -0.488_602_52 * x;
    if degree == 1 {
        return b;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, yz, xz) = (x * y, y * z, x * z);
    b[4] = 1.092_548_5 * xy;
    b[5] = -1.092_548_5 * yz;
    b[6] = 0.315_391_57 * (2.0 * zz - xx - yy);
    b[7] = -1.092_548_5 * xz;
    b[8] = 0.546_274_24 * (xx - yy);
    if degree == 2 {
        return b;
    }
    b[9] = -0.590_043_6 * y * (3.0 * xx - yy);
    b[10] = 2.890_611_4 * xy * z;
    b[11] = -0.457_045_8 * y * (4.0 * zz - xx - yy);
    b[12] = 0.373_176_34 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    b[13] = -0.457_045_8 * x * (4.0 * zz - xx - yy);
    b[14] = 1.445_305_7 * z * (xx - yy);
    b[15] = -0.590_043_6 * x * (xx - 3.0 * yy);
    if degree == 3 {
        return b;
    }
    b[16] = 2.503_343 * xy * (xx - yy);
    b[17] = -1.770_130_8 * yz * (3.0 * xx - yy);
    b[18] = 0.946_174_7 * xy * (7.0 * zz - 1.0);
    b[19] = -0.669_046_5 * yz * (7.0 * zz - 3.0);
    b[20] = 0.105_785_55 * (zz * (35.0 * zz - 30.0) + 3.0);
    b[21] = -0.669_046_5 * xz * (7.0 * zz - 3.0);
    b[22] = 0.473_087_35 * (xx - yy) * (7.0 * zz - 1.0);
    b[23] = -1.770_130_8 * xz * (xx - 3.0 * yy);
    b[24] = 0.625_835_7 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
    b
}

/// Gradient with respect to the direction of a function of the basis functions up to `degree` (0 to 3), from its
/// derivatives by each of them. The basis functions are differentiated as polynomials in three coordinates.
#[inline(always)]
pub(super) fn by_direction(degree: u32, [x, y, z]: [f32; 3], by: &[f32; 16]) -> [f32; 3] {
    if degree == 0 {
        return [0.0; 3];
    }
    let mut out = [-0.488_602_52 * by[3], -0.488_602_52 * by[1], 0.488_602_52 * by[2]];
    let mut add = |weight: f32, [dx, dy, dz]: [f32; 3]| {
        out[0] += weight * dx;
        out[1] += weight * dy;
        out[2] += weight * dz;
    };
    if degree >= 2 {
        add(1.092_548_5 * by[4], [y, x, 0.0]);
        add(-1.092_548_5 * by[5], [0.0, z, y]);
        add(0.315_391_57 * by[6], [-2.0 * x, -2.0 * y, 4.0 * z]);
        add(-1.092_548_5 * by[7], [z, 0.0, x]);
        add(0.546_274_24 * by[8], [2.0 * x, -2.0 * y, 0.0]);
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (xy, yz, xz) = (x * y, y * z, x * z);
        add(-0.590_043_6 * by[9], [6.0 * xy, 3.0 * (xx - yy), 0.0]);
        add(2.890_611_4 * by[10], [yz, xz, xy]);
        add(-0.457_045_8 * by[11], [-2.0 * xy, 4.0 * zz - xx - 3.0 * yy, 8.0 * yz]);
        add(0.373_176_34 * by[12], [-6.0 * xz, -6.0 * yz, 6.0 * zz - 3.0 * xx - 3.0 * yy]);
        add(-0.457_045_8 * by[13], [4.0 * zz - 3.0 * xx - yy, -2.0 * xy, 8.0 * xz]);
        add(1.445_305_7 * by[14], [2.0 * xz, -2.0 * yz, xx - yy]);
        add(-0.590_043_6 * by[15], [3.0 * (xx - yy), -6.0 * xy, 0.0]);
    }
    out
}

/// Largest colour value, where white is 1. After conversion to linear light, which has an exponent of 2.4, the
/// value is still a finite f32.
pub(super) const LARGEST: f32 = 1e15;

/// Colour of a splat seen along `direction`: the sum of the basis functions weighted by `coefficients`, plus one
/// half, clamped to at least 0. Values above [`LARGEST`], and NaN from sums that overflow, become [`LARGEST`].
#[inline(always)]
pub(super) fn colour(degree: u32, coefficients: &[[f32; 3]], direction: [f32; 3]) -> [f32; 3] {
    let basis = basis(degree, direction);
    let used = ((degree + 1) * (degree + 1)) as usize;
    let mut rgb = [0.0_f32; 3];
    for (weight, triple) in basis.iter().zip(coefficients).take(used) {
        for (sum, value) in rgb.iter_mut().zip(triple) {
            *sum += weight * value;
        }
    }
    rgb.map(|c| if c + 0.5 < LARGEST { (c + 0.5).max(0.0) } else { LARGEST })
}

/// Same as [`colour`], but evaluates all functions up to degree 4, with coefficients of 0 above `degree`. The
/// result has the same bits.
pub(super) fn colour_of_all(degree: u32, coefficients: &[[f32; 3]], direction: [f32; 3]) -> [f32; 3] {
    let used = ((degree + 1) * (degree + 1)) as usize;
    let mut all = [[0.0; 3]; MAX_LEN];
    all[..used].copy_from_slice(&coefficients[..used]);
    colour(4, &all, direction)
}

#[cfg(test)]
mod tests {
    use super::*;

    // The functions are orthonormal over the sphere, which determines every constant and every polynomial.
    #[test]
    fn basis_is_orthonormal() {
        let (rows, columns) = (1000, 64);
        let mut gram = [[0.0_f64; MAX_LEN]; MAX_LEN];
        for i in 0..rows {
            let z = (i as f64 + 0.5) / rows as f64 * 2.0 - 1.0;
            let r = (1.0 - z * z).sqrt();
            for j in 0..columns {
                let (sin, cos) =
                    scene::math::num::sin_cos(std::f64::consts::TAU * f64::from(j) / f64::from(columns));
                let b = basis(4, [(r * cos) as f32, (r * sin) as f32, z as f32]).map(f64::from);
                for k in 0..MAX_LEN {
                    for l in 0..MAX_LEN {
                        gram[k][l] += b[k] * b[l];
                    }
                }
            }
        }
        let weight = 4.0 * std::f64::consts::PI / (rows as f64 * f64::from(columns));
        for (k, row) in gram.iter().enumerate() {
            for (l, sum) in row.iter().enumerate() {
                let expected = if k == l { 1.0 } else { 0.0 };
                // The midpoint rule over z has an error of 3e-5 with 1000 rows.
                assert!((sum * weight - expected).abs() < 1e-4, "{k} {l} {}", sum * weight);
            }
        }
    }

    // Orthonormality does not determine signs: those of degree 1 to 3 equal INRIA's along the diagonal.
    #[test]
    fn signs_follow_the_inria_rasterizer() {
        let s = 1.0 / 3.0_f32.sqrt();
        let b = basis(4, [s, s, s]);
        let negative: Vec<usize> = (0..MAX_LEN).filter(|i| b[*i] < -1e-6).collect();
        assert_eq!(negative, [1, 3, 5, 7, 9, 11, 12, 13, 17, 20, 24].to_vec());
        let b = basis(4, [0.0, 0.0, 1.0]);
        assert!(b[2] > 0.0 && b[6] > 0.0 && b[12] > 0.0 && b[20] > 0.0);
    }

    #[test]
    fn colour_is_cut_at_0_and_where_it_would_not_be_finite() {
        assert_eq!(colour(0, &[[-10.0, 0.0, 100.0]], [0.0, 0.0, 1.0]), [0.0, 0.5, 100.0 * 0.282_094_8 + 0.5]);
        // Along z the third function is above 0: sums that overflow upwards, downwards, and both ways.
        let most = f32::MAX;
        let [up, down] = [[most; 3], [-most; 3]];
        let seen = |coefficients: [[f32; 3]; 9]| colour(2, &coefficients, [0.0, 0.0, 1.0]);
        let none = [0.0; 3];
        assert_eq!(seen([up, none, up, none, none, none, up, none, none]), [LARGEST; 3]);
        assert_eq!(seen([down, none, down, none, none, none, down, none, none]), [0.0; 3]);
        assert!(seen([up, down, up, up, none, none, [f32::NEG_INFINITY; 3], up, up])[0] <= LARGEST);
        assert!(scene::math::color::linear_from_srgb(LARGEST).is_finite());
    }
}
