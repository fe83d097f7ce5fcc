//! BSDFs: how surfaces scatter light.
//!
//! The receiver is matte. Objects have glTF materials: from top to bottom, a clearcoat, a sheen, and a base that is
//! a mix of metal and dielectric, where the dielectric is a gloss over a matte, translucent or transparent layer.
//! Each layer transmits the light that its directional albedo does not reflect, so that energy is conserved and
//! white surfaces absorb no light.
//!
//! The lobes form two classes. Each class is sampled separately and has its own weights against light samples,
//! because the receiver may be visible to rays of one class and transparent to rays of the other.

mod albedo;
mod dielectric;
mod ggx;
mod glass;
mod gloss;
mod layers;
mod sheen;
#[cfg(test)]
mod tests;
mod thin_film;

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use crate::geometry::sampling::{Points, circle};
pub use layers::{Layers, straight};

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

/// Parameters of the BSDF of a surface point, after texture lookup. For details, see the types of the same names in
/// [`types`](crate::types).
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

/// Orthonormal frame, as the columns of a matrix.
#[derive(Debug, Clone, Copy)]
pub struct Frame([Vec3; 3]);

impl Frame {
    /// Creates a frame whose third axis is a unit vector (Duff et al. 2017).
    pub fn around(n: Vec3) -> Self {
        let sign = 1.0_f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self([
            Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            Vec3::new(b, sign + n.y * n.y * a, -n.y),
            n,
        ])
    }

    /// Creates a frame whose third axis is a unit vector, and whose first axis is as close as possible to
    /// `tangent`.
    pub fn along(n: Vec3, tangent: Vec3) -> Self {
        match (tangent - n * n.dot(tangent)).try_normalize() {
            Some(t) => Self([t, n.cross(t), n]),
            None => Self::around(n),
        }
    }

    /// The third axis.
    pub fn normal(&self) -> Vec3 {
        self.0[2]
    }

    /// Transforms a direction of the scene to this frame.
    fn to(&self, d: Vec3) -> Vec3 {
        Vec3::new(d.dot(self.0[0]), d.dot(self.0[1]), d.dot(self.0[2]))
    }

    /// Transforms a direction from this frame to the scene.
    pub(super) fn from(&self, d: Vec3) -> Vec3 {
        self.0[0] * d.x + self.0[1] * d.y + self.0[2] * d.z
    }

    /// Transforms the direction to a viewer into this frame. If the result is below the horizon, it is moved above
    /// it.
    fn viewer(&self, out: Vec3) -> Vec3 {
        let local = self.to(out);
        Vec3::new(local.x, local.y, local.z.max(1e-4)).normalize()
    }
}

/// Normal for which the mirror direction of the viewer is above the surface. It lies between `bent` and the surface
/// normal, as close as possible to `bent`. Light mirrored from below the surface would be lost.
pub fn mirroring(bent: Vec3, surface: Vec3, out: Vec3) -> Vec3 {
    let least = (0.9 * out.dot(surface)).min(0.01);
    let sees_above = |normal: Vec3| 2.0 * normal.dot(out) * normal.dot(surface) - out.dot(surface) >= least;
    if sees_above(bent) {
        return bent;
    }
    let between = |t: f32| bent.lerp(surface, t).normalize_or(surface);
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..10 {
        let middle = 0.5 * (low + high);
        if sees_above(between(middle)) { high = middle } else { low = middle }
    }
    between(high)
}

/// A cosine-distributed direction in local coordinates, chosen by two random numbers.
fn cosine([u, v]: [f32; 2]) -> Vec3 {
    let (sin, cos) = circle(u);
    let r = v.sqrt();
    Vec3::new(r * cos, r * sin, (1.0 - v).max(0.0).sqrt())
}

/// The BSDF of a surface point, seen from a given direction.
#[derive(Debug, Clone, Copy)]
#[expect(
    clippy::large_enum_variant,
    reason = "a value stays on the stack while one vertex of a path is shaded"
)]
pub enum Bsdf {
    /// Lambertian reflection, used for the receiver.
    Matte {
        /// Frame around the geometric normal on the side of the viewer.
        frame: Frame,
        /// Linear albedo.
        albedo: Vec3,
    },
    /// A material of an object.
    Layers(Layers),
}

impl Bsdf {
    /// A matte surface with an albedo. `normal` is the geometric normal on the side of the viewer.
    pub fn matte(normal: Vec3, albedo: Vec3) -> Self {
        Self::Matte { frame: Frame::around(normal), albedo }
    }

    /// Unit normal of the side from which the surface receives all of its light. `None` if it receives light from
    /// both sides.
    pub fn lit_side(&self) -> Option<Vec3> {
        match self {
            Self::Matte { frame, .. } => Some(frame.normal()),
            Self::Layers(layers) => layers.lit_side(),
        }
    }

    /// Share of the emission of the base that clearcoat and sheen transmit to the viewer.
    pub fn under(&self) -> f32 {
        match self {
            Self::Matte { .. } => 1.0,
            Self::Layers(layers) => layers.under(),
        }
    }

    /// True if the surface is matte and opaque, so that light samples alone find all of its light.
    pub fn is_matte(&self) -> bool {
        matches!(self, Self::Matte { .. })
    }

    /// Albedo of a matte surface. `None` for other surfaces.
    pub fn matte_albedo(&self) -> Option<Vec3> {
        match self {
            Self::Matte { albedo, .. } => Some(*albedo),
            Self::Layers(_) => None,
        }
    }

    /// Evaluates the diffuse and specular lobes for light from the unit direction `incident`.
    pub fn eval(&self, incident: Vec3) -> [Scatter; 2] {
        match self {
            Self::Matte { frame, albedo } => {
                let pdf = incident.dot(frame.normal()).max(0.0) * FRAC_1_PI;
                [Scatter { value: *albedo * pdf, pdf }, Scatter::default()]
            }
            Self::Layers(layers) => layers.eval(incident),
        }
    }

    /// Samples a class of lobes and an incident direction. Also returns the value and density of this class for the
    /// direction. `None` if the direction is on the wrong side of the surface.
    pub fn sample(&self, points: &Points, pair: u32) -> Option<(Lobe, Vec3, Scatter)> {
        let point = points.pair(pair);
        let (lobe, incident) = match self {
            Self::Matte { frame, .. } => (Lobe::Diffuse, frame.from(cosine(point))),
            Self::Layers(layers) => layers.sample(point, points.pair(pair + 1)[0])?,
        };
        let incident = incident.normalize_or_zero();
        let scatter = self.eval(incident)[lobe as usize];
        (scatter.pdf > 0.0 && scatter.value.is_finite()).then_some((lobe, incident, scatter))
    }
}
