//! BSDFs: how surfaces scatter light.
//!
//! The receiver is matte, or a gloss over a matte layer. Objects have glTF materials: from top to bottom, a clearcoat, a
//! sheen, and a base that is a mix of metal and dielectric, where the dielectric is a gloss over a matte, translucent or
//! transparent layer. Each layer transmits the light that its directional albedo does not reflect, so that energy is conserved and
//! white surfaces absorb no light.
//!
//! The lobes form two classes. Each class is sampled separately and has its own weights against light samples,
//! because the receiver may be visible to rays of one class and transparent to rays of the other.

mod albedo;
mod dielectric;
mod frame;
mod ggx;
mod glass;
mod gloss;
mod layers;
mod lobe;
mod matte;
mod params;
mod sheen;
#[cfg(test)]
mod tests;
mod thin_film;

use glam::Vec3;

use crate::geometry::sampling::Points;
pub use frame::Frame;
pub use layers::{Layers, straight};
pub use lobe::{Lobe, Scatter};
pub use matte::Matte;
pub use params::BsdfParams;

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

/// The BSDF of a surface point, seen from a given direction.
#[derive(Debug, Clone, Copy)]
#[expect(
    clippy::large_enum_variant,
    reason = "a value stays on the stack while one vertex of a path is shaded"
)]
pub enum Bsdf {
    /// Lambertian reflection, used for a matte receiver.
    Matte(Matte),
    /// A material of an object, or of a glossy part of the receiver.
    Layers(Layers),
}

impl Bsdf {
    /// A matte surface with an albedo. `normal` is the geometric normal on the side of the viewer.
    pub fn matte(normal: Vec3, albedo: Vec3) -> Self {
        Self::Matte(Matte::new(normal, albedo))
    }

    /// A glossy surface of the receiver. `normal` is the geometric normal on the side of the viewer. The last argument
    /// contains the unit normal of the reflection, on either side or 0 for the geometric normal, and the unit direction
    /// to the viewer.
    pub fn glossy(normal: Vec3, params: &BsdfParams, (bent, out): (Vec3, Vec3)) -> Self {
        let bent = if bent.dot(normal) < 0.0 { -bent } else { bent };
        let bent = if bent == Vec3::ZERO { normal } else { bent };
        // The mirror direction of the viewer must be above the surface.
        let lift = 0.01 - bent.dot(out);
        let seen = if lift > 0.0 { (bent + out * lift).normalize_or(normal) } else { bent };
        let shading = mirroring(seen, normal, out);
        let matte = Frame::around(normal);
        let frame = if shading == normal { matte } else { Frame::around(shading) };
        Self::Layers(Layers::new([matte, frame, frame], normal, out, params).reflecting())
    }

    /// Unit normal of the side from which the surface receives all of its light. `None` if it receives light from
    /// both sides.
    pub fn lit_side(&self) -> Option<Vec3> {
        match self {
            Self::Matte(matte) => Some(matte.normal()),
            Self::Layers(layers) => layers.lit_side(),
        }
    }

    /// Share of the emission of the base that clearcoat and sheen transmit to the viewer.
    pub fn under(&self) -> f32 {
        match self {
            Self::Matte(_) => 1.0,
            Self::Layers(layers) => layers.under(),
        }
    }

    /// True if the surface is matte and opaque, so that light samples alone find all of its light.
    pub fn is_matte(&self) -> bool {
        matches!(self, Self::Matte(_))
    }

    /// Albedo of a matte surface. `None` for other surfaces.
    pub fn matte_albedo(&self) -> Option<Vec3> {
        match self {
            Self::Matte(matte) => Some(matte.albedo),
            Self::Layers(_) => None,
        }
    }

    /// Evaluates the diffuse and specular lobes for light from the unit direction `incident`.
    pub fn eval(&self, incident: Vec3) -> [Scatter; 2] {
        match self {
            Self::Matte(matte) => [matte.eval(incident), Scatter::default()],
            Self::Layers(layers) => layers.eval(incident),
        }
    }

    /// Samples a class of lobes and an incident direction. Also returns the value and density of this class for the
    /// direction. `None` if the direction is on the wrong side of the surface.
    pub fn sample(&self, points: &Points, pair: u32) -> Option<(Lobe, Vec3, Scatter)> {
        let (lobe, incident) = match self {
            Self::Matte(matte) => {
                let (incident, scatter) = matte.sample(points, pair)?;
                return Some((Lobe::Diffuse, incident, scatter));
            }
            Self::Layers(layers) => layers.sample(points.pair(pair), points.pair(pair + 1)[0])?,
        };
        let incident = incident.normalize_or_zero();
        let scatter = self.eval(incident)[lobe as usize];
        (scatter.pdf > 0.0 && scatter.value.is_finite()).then_some((lobe, incident, scatter))
    }
}
