//! Parameters of the BSDF of a surface point.

use glam::Vec3;

/// Parameters of the BSDF of a surface point, after texture lookup. For details, see the types of the same names in
/// [`types`](scene::types).
#[derive(Debug, Clone, Copy)]
pub struct BsdfParams {
    /// Linear base colour.
    pub base: Vec3,
    /// Metalness from 0 (dielectric) to 1 (metal).
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Index of refraction; 1 means no interface.
    pub ior: f32,
    /// Scale of the dielectric's reflectance, and its tint at normal incidence.
    pub specular: (f32, Vec3),
    /// Share of the light below the dielectric interface that is transmitted.
    pub transmission: f32,
    /// True if transmission is refracted; otherwise the surface is a thin wall.
    pub thick: bool,
    /// True if a thick body is seen from inside, or from the side with the higher index of refraction.
    pub inside: bool,
    /// True if transmission is left out. This is the case for rays that pass straight through transmissive
    /// surfaces.
    pub blocked: bool,
    /// Diffuse transmission: the share of the matte light that leaves on the other side of the surface, and its
    /// colour.
    pub through: (f32, Vec3),
    /// Strength of anisotropy; its direction is the tangent of the frame.
    pub anisotropy: f32,
    /// Share of the surface that has a thin film, index of refraction of the film, and its thickness in nanometres.
    pub film: (f32, f32, f32),
    /// Colour and roughness of the sheen.
    pub sheen: (Vec3, f32),
    /// Share and roughness of the clearcoat.
    pub coat: (f32, f32),
    /// True if lobes whose weight is 0 are evaluated like all others.
    pub every_lobe: bool,
}

impl Default for BsdfParams {
    /// A white, matte surface with an index of 1.5.
    fn default() -> Self {
        Self {
            base: Vec3::ONE,
            metallic: 0.0,
            roughness: 1.0,
            ior: 1.5,
            specular: (1.0, Vec3::ONE),
            transmission: 0.0,
            thick: false,
            inside: false,
            blocked: false,
            through: (0.0, Vec3::ONE),
            anisotropy: 0.0,
            film: (0.0, 1.3, 0.0),
            sheen: (Vec3::ZERO, 0.0),
            coat: (0.0, 0.0),
            every_lobe: false,
        }
    }
}
