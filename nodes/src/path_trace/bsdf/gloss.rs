//! The surface of the base: the interface of the dielectric and the metal.

use glam::Vec3;

use super::albedo;
use super::film;
use super::ggx::{Ggx, schlick};
use super::glass;
use super::{Look, Scatter};

/// The interface of a dielectric, as far as it covers what lies below; by default there is none.
#[derive(Debug, Clone, Copy, Default)]
pub struct Interface {
    /// Largest channel of the reflectance at normal incidence, for a strength of 1.
    f0: f32,
    strength: f32,
    roughness: f32,
}

impl Interface {
    /// Of a look, seen from a direction of its frame.
    pub fn new(look: &Look, out: Vec3) -> Self {
        let roughness = Ggx::brushed(look.roughness, look.anisotropy).roughness(out);
        let strength = if look.ior > 1.0 { look.specular.0 } else { 0.0 };
        let f0 = (glass::normal(look.ior) * look.specular.1.max_element()).min(1.0);
        Self { f0, strength, roughness }
    }

    /// What it reflects towards a viewer.
    pub fn albedo(&self, cosine: f32) -> f32 {
        if self.strength == 0.0 {
            return 0.0;
        }
        self.strength * albedo::with_gain(self.f0, cosine, self.roughness)
    }

    /// Matte stuff below gets what the interface leaves of the light from a direction, and the viewer what it
    /// leaves of what that stuff gives. This factor makes white stay white (Kelemen and Szirmay-Kalos 2001).
    pub fn between(&self) -> f32 {
        if self.strength == 0.0 {
            return 1.0;
        }
        1.0 / (1.0 - self.strength * albedo::mean_reflection(self.f0, self.roughness)).max(1e-3)
    }
}

/// Reflection at facets.
#[derive(Debug, Clone, Copy)]
pub struct Gloss {
    /// The facets.
    pub ggx: Ggx,
    f0: Vec3,
    f90: Vec3,
    /// Gives back what is lost between facets.
    gain: Vec3,
    /// Relative index of the other side, where this is the inner side of a body.
    inner: Option<f32>,
    /// What it reflects towards the viewer.
    pub albedo: Vec3,
    /// What the dielectric's interface leaves to what lies below.
    pub left: f32,
}

impl Gloss {
    /// Of a look, seen from a direction of its frame.
    pub fn new(look: &Look, interface: &Interface, out: Vec3) -> Self {
        let ggx = Ggx::brushed(look.roughness, look.anisotropy);
        let (m, roughness, cosine) = (look.metallic, ggx.roughness(out), out.z);
        if look.inside {
            // The whole interface: without it nothing would be reflected beyond the critical angle.
            let eta = glass::steep(1.0 / look.ior);
            let [reflected, passed] = albedo::interface(cosine, roughness, eta);
            let gain = 1.0 / (reflected + passed).max(1e-3);
            return Self {
                ggx,
                f0: Vec3::splat(glass::normal(look.ior)).lerp(look.base, m),
                f90: Vec3::ONE,
                gain: Vec3::splat(gain),
                inner: Some(eta),
                albedo: Vec3::splat(reflected * gain).lerp(look.base, m),
                left: passed * gain,
            };
        }
        let tinted = (look.specular.1 * glass::normal(look.ior)).min(Vec3::ONE);
        let (mut dielectric, mut metal) = (tinted, look.base);
        let (share, index, thickness) = look.film;
        if share > 0.0 {
            let film = |f0: Vec3| f0.lerp(film::normal(index, thickness, f0, cosine), share);
            (dielectric, metal) = (film(dielectric), film(metal));
        }
        let strength = interface.strength;
        let f0 = (dielectric * strength).lerp(metal, m);
        // A metal always reflects fully at grazing angles; a dielectric only where it has an interface.
        let f90 = Vec3::splat(strength + (1.0 - strength) * m);
        let [a, b] = albedo::reflection(cosine, roughness);
        let all = (a + b).clamp(1e-3, 1.0);
        // The gain of the mix is such that its albedo is the mix of the two albedos.
        let again = |f0: f32| albedo::again(albedo::average(f0), all, roughness);
        let full = |f0: Vec3| (f0 * a + Vec3::splat(b)) * Vec3::from_array(f0.to_array().map(again));
        let covered = full(dielectric) * strength;
        let albedo = covered.lerp(full(metal), m);
        let gain = albedo / (f0 * a + f90 * b).max(Vec3::splat(1e-6));
        let left = (1.0 - covered.max_element()).max(0.0);
        Self { ggx, f0, f90, gain, inner: None, albedo, left }
    }

    /// Reflection from `incident` to `out`, both above, and the cosine of either to the facet.
    pub fn eval(&self, out: Vec3, incident: Vec3) -> (Scatter, f32) {
        let mirror = self.ggx.mirror(out, incident);
        let fresnel = match self.inner {
            None => {
                let c5 = schlick(mirror.cosine);
                self.f0 * (1.0 - c5) + self.f90 * c5
            }
            // From inside the angle on the outer side counts, and beyond the critical one all is reflected.
            Some(eta) => {
                let c5 = glass::other(mirror.cosine, eta).map_or(1.0, schlick);
                self.f0 * (1.0 - c5) + self.f90 * c5
            }
        };
        (Scatter { value: fresnel * self.gain * mirror.value, pdf: mirror.pdf }, mirror.cosine)
    }
}
