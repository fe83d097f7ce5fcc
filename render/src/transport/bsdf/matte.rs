//! Lambertian reflection.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::frame::{Frame, cosine};
use super::lobe::Scatter;
use crate::geometry::sampling::Points;

/// Lambertian reflection, used for the receiver.
#[derive(Debug, Clone, Copy)]
pub struct Matte {
    /// Frame around the geometric normal on the side of the viewer.
    frame: Frame,
    /// Linear albedo.
    pub albedo: Vec3,
}

impl Matte {
    /// A matte surface with an albedo. `normal` is the geometric normal on the side of the viewer.
    #[inline]
    pub fn new(normal: Vec3, albedo: Vec3) -> Self {
        Self { frame: Frame::around(normal), albedo }
    }

    /// Unit geometric normal on the side of the viewer.
    #[inline]
    pub fn normal(&self) -> Vec3 {
        self.frame.normal()
    }

    /// Evaluates the reflection of light from the unit direction `incident`.
    #[inline]
    pub fn eval(&self, incident: Vec3) -> Scatter {
        let pdf = incident.dot(self.normal()).max(0.0) * FRAC_1_PI;
        Scatter { value: self.albedo * pdf, pdf }
    }

    /// Cosine-distributed incident direction, chosen by two random numbers. `None` if it is below the surface.
    #[inline]
    pub fn direction(&self, point: [f32; 2]) -> Option<Vec3> {
        let incident = self.frame.from(cosine(point)).normalize_or_zero();
        (incident.dot(self.normal()) > 0.0).then_some(incident)
    }

    /// Samples an incident direction. Also returns the value and density for the direction. `None` if the direction
    /// is below the surface.
    #[inline]
    pub fn sample(&self, points: &Points, pair: u32) -> Option<(Vec3, Scatter)> {
        let incident = self.frame.from(cosine(points.pair(pair))).normalize_or_zero();
        let scatter = self.eval(incident);
        (scatter.pdf > 0.0 && scatter.value.is_finite()).then_some((incident, scatter))
    }
}
