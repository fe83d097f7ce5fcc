//! The specular part of the base layer: the dielectric interface and the metal.

use glam::Vec3;

use super::albedo::{self, Facets};
use super::dielectric;
use super::ggx::{Ggx, schlick};
use super::lobe::Scatter;
use super::params::BsdfParams;
use super::thin_film;

/// Dielectric interface of a surface. The default has a strength of 0 and reflects nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Interface {
    index: f32,
    /// Largest channel of the reflectance at normal incidence, for a strength of 1.
    f0: f32,
    strength: f32,
    roughness: f32,
}

impl Interface {
    /// The interface of a surface, seen from the direction `out` in the frame of the surface.
    pub fn new(params: &BsdfParams, out: Vec3) -> Self {
        let roughness = Ggx::anisotropic(params.roughness, params.anisotropy).roughness(out);
        let strength = if params.ior > 1.0 { params.specular.0 } else { 0.0 };
        let f0 = (dielectric::f0_of_ior(params.ior) * params.specular.1.max_element()).min(1.0);
        Self { index: params.ior, f0, strength, roughness }
    }

    /// Directional albedo towards a viewer. `cosine` is the cosine between the viewer direction and the normal.
    pub fn albedo(&self, cosine: f32) -> f32 {
        if self.strength == 0.0 {
            return 0.0;
        }
        self.strength * Facets::round(cosine, self.roughness, self.index).dielectric(self.f0)[1]
    }

    /// Factor for the light that the matte layer below the interface reflects. It accounts for light that the
    /// interface reflects back to the matte layer, so that white surfaces reflect all light (Kelemen and
    /// Szirmay-Kalos 2001).
    pub fn between(&self) -> f32 {
        if self.strength == 0.0 {
            return 1.0;
        }
        1.0 / (1.0 - self.strength * albedo::mean_reflection(self.f0, self.index, self.roughness)).max(1e-3)
    }
}

/// Specular reflection at microfacets.
#[derive(Debug, Clone, Copy)]
pub struct Gloss {
    /// Distribution of microfacets.
    pub ggx: Ggx,
    /// Albedos of the facets towards the viewer.
    pub facets: Facets,
    /// Index of refraction of the other side, relative to the side of the viewer.
    pub eta: f32,
    /// Reflectance of the dielectric at normal and grazing incidence, times the share of the surface that is
    /// dielectric.
    dielectric: [Vec3; 2],
    /// Reflectance of the metal at normal and grazing incidence, times the share of the surface that is metal.
    metal: [Vec3; 2],
    /// Factor that compensates for the energy that single scattering loses.
    gain: Vec3,
    /// Directional albedo towards the viewer.
    pub albedo: Vec3,
    /// Share of the light that the dielectric interface transmits to the layers below.
    pub left: Vec3,
}

impl Gloss {
    /// The gloss of a surface, seen from the direction `out` in the frame of the surface.
    pub fn new(params: &BsdfParams, interface: &Interface, out: Vec3) -> Self {
        let ggx = Ggx::anisotropic(params.roughness, params.anisotropy);
        let (m, cosine, eta) = (params.metallic, out.z, dielectric::relative(params));
        // Without interface, metal and transmission the facets have no effect, and no table is made.
        if interface.strength == 0.0
            && m == 0.0
            && params.transmission == 0.0
            && !params.inside
            && !params.every_lobe
        {
            let none = [Vec3::ZERO; 2];
            let (gain, albedo, left) = (Vec3::ZERO, Vec3::ZERO, Vec3::ONE);
            return Self {
                ggx,
                facets: Facets::NONE,
                eta,
                dielectric: none,
                metal: none,
                gain,
                albedo,
                left,
            };
        }
        let facets = Facets::new(&ggx, out, eta);
        if params.inside {
            // The interface counts fully, since otherwise nothing would be reflected beyond the critical angle.
            let f0 = dielectric::f0_of_ior(params.ior);
            let [reflected, _] = facets.dielectric(f0);
            let gain = 1.0 / (reflected + facets.passed).max(1e-3);
            return Self {
                ggx,
                facets,
                eta,
                dielectric: [Vec3::splat(f0).lerp(params.base, m), Vec3::ONE],
                metal: [Vec3::ZERO; 2],
                gain: Vec3::splat(gain),
                albedo: Vec3::splat(reflected * gain).lerp(params.base, m),
                left: Vec3::splat(facets.passed * gain),
            };
        }
        let tinted = (params.specular.1 * dielectric::f0_of_ior(params.ior)).min(Vec3::ONE);
        let strength = interface.strength;
        let (share, index, thickness) = params.film;
        let film = |f0: Vec3, rise: f32| match share > 0.0 || params.every_lobe {
            true => f0.lerp(thin_film::f0(index, thickness, f0, cosine, rise), share),
            false => f0,
        };
        let over_dielectric = |f0: Vec3| film(f0, dielectric::rise(cosine, params.ior));
        let (dielectric, metal) = (over_dielectric(tinted), film(params.base, schlick(cosine)));
        let [covered_once, covered] = each(dielectric, |f0| facets.dielectric(f0)).map(|v| v * strength);
        let [shiny_once, shiny] = each(metal, |f0| facets.metal(f0));
        // The gain of the mix makes its albedo the mix of the two albedos.
        let albedo = covered.lerp(shiny, m);
        let gain = albedo / covered_once.lerp(shiny_once, m).max(Vec3::splat(1e-6));
        // A tint colours reflection and not transmission; a film colours both.
        let widest = over_dielectric(Vec3::splat(interface.f0));
        let left = Vec3::ONE - each(widest, |f0| facets.dielectric(f0))[1] * strength;
        // A metal always reflects fully at grazing angles; a dielectric only where it has an interface.
        let dielectric = [dielectric, Vec3::ONE].map(|f| f * (strength * (1.0 - m)));
        let metal = [metal, Vec3::ONE].map(|f| f * m);
        Self { ggx, facets, eta, dielectric, metal, gain, albedo, left }
    }

    /// Reflection from `incident` to `out`, both above the surface, and the cosine between either direction
    /// and the facet.
    pub fn eval(&self, out: Vec3, incident: Vec3) -> (Scatter, f32) {
        let mirror = self.ggx.mirror(out, incident);
        let risen = |[f0, f90]: [Vec3; 2], rise: f32| f0 * (1.0 - rise) + f90 * rise;
        let fresnel = risen(self.dielectric, dielectric::rise(mirror.cosine, self.eta))
            + risen(self.metal, schlick(mirror.cosine));
        (Scatter { value: fresnel * self.gain * mirror.value, pdf: mirror.pdf }, mirror.cosine)
    }
}

/// Applies a function with two results to each channel. Returns one colour made of the first results and one made
/// of the second results.
fn each(v: Vec3, f: impl Fn(f32) -> [f32; 2]) -> [Vec3; 2] {
    let [r, g, b] = v.to_array().map(f);
    [0, 1].map(|k| Vec3::new(r[k], g[k], b[k]))
}
