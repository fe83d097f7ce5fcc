//! Upper bound of the irradiance of any surface under given light.
//!
//! The irradiance on one side of a plane is half of the sum of the light on both sides, plus half of the difference
//! between the two:
//!
//! `E(n) = 1/2 (int |n.w| L + n. int w L) <= 1/2 (sqrt(int L . int (n.w)^2 L) + |int w L|)`.

use glam::{DMat3, DVec3};

/// Upper bound of the irradiance. The arguments are integrals over the sphere of directions: `power` of the
/// radiance, `towards` of the radiance times the direction, and `squares` of the radiance times the outer product
/// of the direction with itself.
pub fn greatest_irradiance(power: f64, towards: DVec3, squares: DMat3) -> f64 {
    let trace = squares.x_axis.x + squares.y_axis.y + squares.z_axis.z;
    if trace <= 0.0 {
        return 0.0;
    }
    // The largest eigenvalue, at most 3.5 % too large: the sum of the 32nd powers is at most three times that of
    // the largest.
    let mut powers = squares * (1.0 / trace);
    for _ in 0..5 {
        powers = powers * powers;
    }
    let mut root = powers.x_axis.x + powers.y_axis.y + powers.z_axis.z;
    for _ in 0..5 {
        root = root.sqrt();
    }
    0.5 * ((power * trace * root).sqrt() + towards.length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::Points;
    use testing::direction;

    /// No surface exceeds the bound, and some surface nearly reaches it.
    #[test]
    fn irradiance_is_within_its_bound() {
        // From a single direction with light to light all around.
        for (lights, least) in [(1, 0.99), (2, 0.6), (7, 0.6), (4096, 0.8)] {
            let of = |i| direction(Points::new(5, i).pair(0)).as_dvec3();
            let (mut power, mut towards, mut squares) = (0.0, DVec3::ZERO, DMat3::ZERO);
            for (i, light) in (0..lights).map(|i| (i, 1.0 + f64::from(i % 5))) {
                let d = of(i);
                power += light;
                towards += d * light;
                squares += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * light;
            }
            let bound = greatest_irradiance(power, towards, squares);
            let irradiance = |normal: DVec3| -> f64 {
                (0..lights).map(|i| (1.0 + f64::from(i % 5)) * of(i).dot(normal).max(0.0)).sum()
            };
            let normals = (0..500).map(|i| direction(Points::new(6, i).pair(0)).as_dvec3());
            let most = normals.chain([of(0)]).map(irradiance).fold(0.0, f64::max);
            assert!(most <= bound * (1.0 + 1e-9) && most >= least * bound, "{lights}: {most} of {bound}");
        }
        assert_eq!(greatest_irradiance(0.0, DVec3::ZERO, DMat3::ZERO), 0.0);
    }
}
