//! Energy of a panorama, for reports of the light that each step adds or removes.

use engine::Up;
use scene::math::equirect::{axes, direction, pixel_solid_angle};

/// Energy of an equirectangular picture. The energies before and after a step show how much light the step adds or
/// removes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Energy {
    /// Integral of the luminance over the sphere.
    pub power: f64,
    /// Irradiance on a plane that faces up.
    pub ground: f64,
    /// Largest luminance.
    pub peak: f64,
}

impl Energy {
    /// Computes the energy of a picture. `luminance` holds the luminance of each pixel, row by row.
    pub fn of(up: Up, width: usize, luminance: &[f64]) -> Self {
        let (height, above) = (luminance.len() / width.max(1), axes(up)[2]);
        let mut energy = Self::default();
        for (y, row) in luminance.chunks_exact(width.max(1)).enumerate() {
            let size = pixel_solid_angle(width, height, y);
            let facing = direction(up, 0.5, (y as f64 + 0.5) / height as f64).dot(above).max(0.0) * size;
            for luminance in row {
                energy.power += luminance * size;
                energy.ground += luminance * facing;
                energy.peak = energy.peak.max(*luminance);
            }
        }
        energy
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    // This test fails if `direction` is taken at y / height, or if `facing` lacks the factor `size`.
    #[test]
    fn a_uniform_sphere_has_four_pi_and_gives_the_ground_pi() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let energy = Energy::of(up, 64, &vec![2.0; 64 * 32]);
            assert!((energy.power - 8.0 * PI).abs() < 1e-9 && energy.peak == 2.0);
            assert!((energy.ground - 2.0 * PI).abs() < 0.01, "{energy:?}");
        }
    }
}
