//! Emission of objects: at the hits of rays, and as a distribution for light samples.

use glam::Vec3;
use scene::types::Material;

use super::attributes::SurfacePoint;
use super::emitters::{COARSE, EmitterSample, Emitters};
use super::media::Media;
use super::mipmap::Texels;
use super::object_surface::emission;
use super::objects::Objects;
use crate::geometry::bvh::Hit;

/// Minimum emission that light samples assume, as a share of the maximum of the emission texture over the
/// footprint. It is the share of one texel in 128 by 128 texels.
const FAINT: f32 = 1.0 / 16384.0;

/// Desired total number of lattice cells for the emissive triangles of all objects. It may be exceeded, since each
/// lattice may have 32 cells per side.
const CELLS: usize = 1 << 17;

impl Objects {
    /// Emission at a hit towards a unit direction, attenuated by clearcoat and sheen.
    pub fn emission_towards(&self, hit: &Hit, out: Vec3) -> Vec3 {
        let (_, material, _) = self.point(hit);
        if material.unlit
            || (material.clearcoat.strength.factor == 0.0 && material.sheen.colour.factor == [0.0; 3])
        {
            return self.emission(hit, 0.0);
        }
        let back = self.normal(hit.triangle).dot(out) < 0.0;
        self.surface(&Hit { back, ..*hit }, out, false, 0.0, Media::default()).emission
    }

    /// Emission of the material at a hit, averaged over a footprint. `width` is the width of the footprint, as a
    /// fraction of the square root of twice the area of the triangle.
    pub fn emission(&self, hit: &Hit, width: f32) -> Vec3 {
        let (_, material, point) = self.point(hit);
        emission(&SurfacePoint { width, ..point }, material)
    }

    /// Light distribution of all emissive triangles.
    pub(crate) fn find_emitters(&self) -> Emitters {
        // A lamp so small that the average rounds to black keeps a small probability.
        let emission = |hit: &Hit, width| self.emission(hit, width).max(self.peak(hit, width) * FAINT);
        let finest = self.finest();
        Emitters::new(&self.corners, |triangle| self.lattice(triangle, finest), emission)
    }

    /// Same as [`emission`](Self::emission), with the maximum of the emission texture over the footprint instead of
    /// the mean. Black if there is no texture.
    fn peak(&self, hit: &Hit, width: f32) -> Vec3 {
        let (_, material, point) = self.point(hit);
        let [r, g, b, _] = material.base_colour;
        let (most, picture) = match material.unlit {
            true => ([r, g, b], material.base_colour_texture),
            false => (material.emissive, material.emissive_texture),
        };
        let Some(picture) = picture else { return Vec3::ZERO };
        let [r, g, b, _] = SurfacePoint { width, ..point }.texture(Some(picture), Texels::Peaks);
        Vec3::from_array(most) * Vec3::new(r, g, b)
    }

    /// Maximum number of cells per side of a lattice: 32, or more for scenes with few emissive triangles, such as a
    /// panel of lights.
    fn finest(&self) -> u32 {
        let shining = self.parts.iter().map(|part| {
            let object = &self.placed()[part.placed].object;
            let primitive = &object.primitives[part.primitive];
            let shines = object.materials.get(primitive.material as usize).is_some_and(Material::shines);
            if shines { primitive.triangles.len() } else { 0 }
        });
        let each = CELLS / shining.sum::<usize>().max(1);
        (each.isqrt() as u32).max(COARSE)
    }

    /// Number of cells per side of the lattice that samples a triangle's emission texture: one cell per four texels
    /// of the width of the triangle, at most `finest`.
    fn lattice(&self, triangle: u32, finest: u32) -> u32 {
        let hit = Hit { t: 0.0, triangle, b1: 0.0, b2: 0.0, back: false };
        let (_, material, point) = self.point(&hit);
        let picture = if material.unlit { material.base_colour_texture } else { material.emissive_texture };
        let texels = picture.map_or(0.0, |picture| point.texels(picture));
        // NaN becomes 0.
        ((texels / 4.0).ceil() as u32).clamp(1, finest)
    }

    /// Samples a point in proportion to its emission, from random numbers. There must be an emitter.
    pub fn sample_emitter(&self, choice: u32, place: [u32; 2]) -> EmitterSample {
        self.emitters.sample(&self.corners, choice, place)
    }
}
