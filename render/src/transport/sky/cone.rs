//! Cones of directions, and sampling of directions towards objects.

use glam::Vec3;

use crate::geometry::sampling::{Points, circle, unit};
use crate::transport::bsdf::Frame;

/// Index of the first of three pairs of sample dimensions for rays towards objects. In this order, the pairs decide
/// the direction, whether a ray is sent, and whether the sample estimates a change at all.
pub(crate) const TOWARDS: u32 = 1 << 17;
/// A cone of directions around a unit axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// Unit axis.
    pub axis: Vec3,
    /// Cosine of the angle between the axis and the boundary; -1 for all directions.
    pub cosine: f32,
}

impl Cone {
    /// All directions.
    pub const ALL: Self = Self { axis: Vec3::Z, cosine: -1.0 };

    /// Cone that contains the given unit vectors, with a small margin for rounding.
    pub fn around(directions: impl Iterator<Item = Vec3> + Clone) -> Self {
        let Some(axis) = directions.clone().sum::<Vec3>().try_normalize() else { return Self::ALL };
        let cosine = directions.map(|d| d.dot(axis)).fold(1.0, f32::min) - 1e-5;
        Self { axis, cosine }
    }

    /// Cone that contains the directions from any point of one box to any point of another.
    pub fn between(from: [Vec3; 2], to: [Vec3; 2]) -> Self {
        // The difference vectors fill a box, and a cone of less than a right angle contains a box if it contains
        // its corners.
        let (low, high) = (to[0] - from[1], to[1] - from[0]);
        let Some(axis) = (low + high).try_normalize() else { return Self::ALL };
        let mut cosine = 1.0_f32;
        for corner in 0..8_u32 {
            let side = |k: usize| if corner >> k & 1 == 1 { high[k] } else { low[k] };
            let corner = Vec3::new(side(0), side(1), side(2));
            cosine = cosine.min(corner.dot(axis) / corner.length());
        }
        // NaN, where a corner coincides with the start, also fails the comparison.
        if cosine > 1e-3 { Self { axis, cosine: cosine - 1e-5 } } else { Self::ALL }
    }

    /// True if two cones share a direction. The result may also be true for cones that barely miss each other.
    /// [`CellGrid`] tests many cones at once.
    #[cfg(test)]
    pub fn meets(&self, other: &Self) -> bool {
        if self.cosine <= 0.0 || other.cosine <= 0.0 {
            return true;
        }
        let together = self.cosine * other.cosine - sine(self.cosine) * sine(other.cosine);
        self.axis.dot(other.axis) >= together - 1e-5
    }

    /// Solid angle.
    pub fn solid_angle(&self) -> f32 {
        std::f32::consts::TAU * (1.0 - self.cosine)
    }
}

/// Sine of the angle that has the given cosine.
pub fn sine(cosine: f32) -> f32 {
    (1.0 - cosine * cosine).max(0.0).sqrt()
}

/// Sampling of rays towards objects, uniform over a cone, with at most one ray per sample.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Towards {
    pub(crate) cone: Cone,
    /// Probability density by solid angle within the cone, including the probability that a ray is sent; 0 if
    /// no rays are sent.
    pub(crate) pdf: f32,
}

impl Towards {
    /// Sampling that sends no rays, used for example if the objects may be in any direction.
    pub(crate) const NOWHERE: Self = Self { cone: Cone::ALL, pdf: 0.0 };

    /// Sampling with `rays` rays per steradian, but at most one ray in total.
    pub(crate) fn within(cone: Cone, rays: f32) -> Self {
        let pdf = if cone.cosine > 0.0 { rays.min(1.0 / cone.solid_angle()) } else { 0.0 };
        Self { cone, pdf }
    }

    /// Density with which a direction is sampled.
    pub(crate) fn pdf(&self, direction: Vec3) -> f32 {
        let inside = self.pdf > 0.0 && direction.dot(self.cone.axis) >= self.cone.cosine;
        if inside { self.pdf } else { 0.0 }
    }

    /// Balance heuristic (Veach 1997): weight of a scattered ray with density `pdf` against rays towards objects.
    pub(crate) fn share(&self, direction: Vec3, pdf: f32) -> f32 {
        let own = self.pdf(direction);
        if own > 0.0 { pdf / (pdf + own) } else { 1.0 }
    }

    /// Direction of the ray of a sample. `None` if no ray is sent.
    pub(crate) fn ray(&self, points: &Points) -> Option<Vec3> {
        let chance = self.pdf * self.cone.solid_angle();
        let sends = self.pdf > 0.0 && (chance >= 1.0 || unit(points.bits(TOWARDS + 1)[0]) < chance);
        sends.then(|| self.direction(points.pair(TOWARDS)))
    }

    /// Direction within the cone, chosen by two random numbers.
    fn direction(&self, [u, v]: [f32; 2]) -> Vec3 {
        let (sin, cos) = circle(u);
        // Measured from the axis, so that narrow cones keep their precision.
        let below = v * (1.0 - self.cone.cosine);
        let radius = (below * (2.0 - below)).max(0.0).sqrt();
        let local = Vec3::new(radius * cos, radius * sin, 1.0 - below);
        Frame::around(self.cone.axis).from(local)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::stream;
    use testing::chi_square;

    /// Chi-square test of directions against their density, over rings and sectors of the cone, and of the share of
    /// samples with a ray. This test fails if `below` is replaced with `v * below` in `direction`, or if `within`
    /// does not limit `rays`.
    #[test]
    fn rays_to_the_objects_fill_their_cone_evenly() {
        let axis = Vec3::new(0.48, -0.6, 0.64);
        for cosine in [0.1_f32, 0.7, 0.96, 1.0 - 1e-5] {
            let cone = Cone { axis, cosine };
            let towards = Towards::within(cone, 1.0);
            let across = axis.any_orthonormal_vector();
            let (n, mut counts) = (100_000, vec![0.0; 12 * 12 + 1]);
            for i in 0..n {
                let points = Points::new(stream(4, i, 0), 0);
                let sent = towards.ray(&points).is_some();
                let ray = towards.direction(points.pair(TOWARDS)).as_dvec3();
                assert!((ray.length() - 1.0).abs() < 1e-5);
                // 1 - cosine is computed from the chord, which keeps its digits.
                let below = 0.5 * (ray - axis.as_dvec3()).length_squared() / f64::from(1.0 - cosine);
                let [x, y] = [across, axis.cross(across)].map(|side| ray.dot(side.as_dvec3()));
                let turns = scene::math::num::atan2(y, x) / std::f64::consts::TAU + 0.5;
                let [ring, sector] = [below, turns].map(|at| ((12.0 * at) as usize).min(11));
                counts[if sent { ring * 12 + sector } else { 144 }] += 1.0;
            }
            let sent = f64::from(towards.pdf * cone.solid_angle());
            assert!(sent <= 1.0 + 1e-6);
            let mut expected = vec![f64::from(n) * sent / 144.0; 144];
            expected.push(f64::from(n) * (1.0 - sent).max(0.0));
            let z = chi_square(&counts, &expected);
            assert!(z < 4.0, "{cosine}: {z}");
        }
    }
}
