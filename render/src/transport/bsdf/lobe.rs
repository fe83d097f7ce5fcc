//! Classes of BSDF lobes, and the BSDF values of each class.

use glam::Vec3;

/// A class of lobes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lobe {
    /// Matte reflection and diffuse transmission, in which light leaves in any direction, and sheen.
    Diffuse,
    /// Reflection and transmission at an interface.
    Specular,
}

/// Value of one class of lobes for a pair of directions.
#[derive(Debug, Clone, Copy, Default)]
pub struct Scatter {
    /// BSDF value times the cosine of the incident direction.
    pub value: Vec3,
    /// Density with which this class samples the incident direction, including the probability of choosing the
    /// lobe.
    pub pdf: f32,
}
