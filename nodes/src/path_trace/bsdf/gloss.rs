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
    index: f32,
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
        Self { index: look.ior, f0, strength, roughness }
    }

    /// What it reflects towards a viewer.
    pub fn albedo(&self, cosine: f32) -> f32 {
        if self.strength == 0.0 {
            return 0.0;
        }
        self.strength * albedo::with_gain(self.f0, self.index, cosine, self.roughness)
    }

    /// Matte stuff below gets what the interface leaves of the light from a direction, and the viewer what it
    /// leaves of what that stuff gives. This factor makes white stay white (Kelemen and Szirmay-Kalos 2001).
    pub fn between(&self) -> f32 {
        if self.strength == 0.0 {
            return 1.0;
        }
        1.0 / (1.0 - self.strength * albedo::mean_reflection(self.f0, self.index, self.roughness)).max(1e-3)
    }
}

/// Reflection at facets.
#[derive(Debug, Clone, Copy)]
pub struct Gloss {
    /// The facets.
    pub ggx: Ggx,
    /// Relative index of the other side.
    eta: f32,
    /// Reflectance of the dielectric, at normal and at grazing incidence, times its share.
    dielectric: [Vec3; 2],
    /// That of the metal.
    metal: [Vec3; 2],
    /// Gives back what is lost between facets.
    gain: Vec3,
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
                eta,
                dielectric: [Vec3::splat(glass::normal(look.ior)).lerp(look.base, m), Vec3::ONE],
                metal: [Vec3::ZERO; 2],
                gain: Vec3::splat(gain),
                albedo: Vec3::splat(reflected * gain).lerp(look.base, m),
                left: passed * gain,
            };
        }
        let tinted = (look.specular.1 * glass::normal(look.ior)).min(Vec3::ONE);
        let (mut dielectric, mut metal) = (tinted, look.base);
        let (share, index, thickness) = look.film;
        if share > 0.0 {
            let film = |f0: Vec3, rise| f0.lerp(film::normal(index, thickness, f0, cosine, rise), share);
            dielectric = film(dielectric, glass::rise(cosine, look.ior));
            metal = film(metal, schlick(cosine));
        }
        let strength = interface.strength;
        let single = |f0: Vec3, [a, b]: [f32; 2]| f0 * a + Vec3::splat(b);
        let mut of_dielectric = albedo::dielectric(cosine, roughness, look.ior);
        let mut of_metal = albedo::metal(cosine, roughness);
        if look.anisotropy > 0.0 {
            let brushed = albedo::brushed(&ggx, out);
            let more = brushed.iter().sum::<f32>() / of_metal.iter().sum::<f32>().max(1e-3);
            (of_dielectric, of_metal) = (of_dielectric.map(|v| v * more), brushed);
        }
        let all = of_metal.iter().sum::<f32>().clamp(1e-3, 1.0);
        let gains = |f0: Vec3, average: &dyn Fn(f32) -> f32| {
            Vec3::from_array(f0.to_array().map(|f0| albedo::gain(average(f0), all, roughness)))
        };
        let covered = single(dielectric, of_dielectric)
            * gains(dielectric, &|f0| albedo::average(f0, look.ior))
            * strength;
        let shiny = single(metal, of_metal) * gains(metal, &albedo::average_metal);
        // The gain of the mix is such that its albedo is the mix of the two albedos.
        let albedo = covered.lerp(shiny, m);
        let once = (single(dielectric, of_dielectric) * strength).lerp(single(metal, of_metal), m);
        let gain = albedo / once.max(Vec3::splat(1e-6));
        let left = (1.0 - covered.max_element()).max(0.0);
        // A metal always reflects fully at grazing angles; a dielectric only where it has an interface.
        let dielectric = [dielectric, Vec3::ONE].map(|f| f * (strength * (1.0 - m)));
        Self { ggx, eta: look.ior, dielectric, metal: [metal, Vec3::ONE].map(|f| f * m), gain, albedo, left }
    }

    /// Reflection from `incident` to `out`, both above, and the cosine of either to the facet.
    pub fn eval(&self, out: Vec3, incident: Vec3) -> (Scatter, f32) {
        let mirror = self.ggx.mirror(out, incident);
        let risen = |[f0, f90]: [Vec3; 2], rise: f32| f0 * (1.0 - rise) + f90 * rise;
        let fresnel = risen(self.dielectric, glass::rise(mirror.cosine, self.eta))
            + risen(self.metal, schlick(mirror.cosine));
        (Scatter { value: fresnel * self.gain * mirror.value, pdf: mirror.pdf }, mirror.cosine)
    }
}
