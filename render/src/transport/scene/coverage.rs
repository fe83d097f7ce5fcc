//! Coverage of surfaces: alpha cut-outs, alpha blending, and back faces that are invisible to the camera.

use scene::types::AlphaMode;

use super::bodies::nearer;
use super::mipmap::Texels;
use super::objects::Objects;
use crate::geometry::bvh::{Hit, Ray};
use crate::geometry::sampling::{fraction, hash, unit};

impl Objects {
    /// Share of rays that the surface at a hit stops: 0 where it is cut out, alpha where it is blended. If `camera`
    /// is true, back faces of single-sided surfaces are invisible, except back faces of bodies.
    pub fn coverage(&self, hit: &Hit, camera: bool) -> f32 {
        if self.opaque {
            return 1.0;
        }
        let (part, material, point) = self.point(hit);
        if camera && self.is_hidden_back(hit) {
            return 0.0;
        }
        if part.opaque {
            return 1.0;
        }
        let alpha = material.base_colour[3]
            * point.texture(material.base_colour_texture, Texels::Numbers)[3]
            * point.vertex_colour()[3];
        let there = match material.alpha_mode {
            AlphaMode::Opaque => return 1.0,
            AlphaMode::Mask(cutoff) => f32::from(u8::from(alpha >= cutoff)),
            AlphaMode::Blend => alpha,
        };
        if there > 0.0 { there.min(1.0) } else { 0.0 }
    }

    /// True if a hit is on the back of a face that is invisible from behind: the material is single-sided, and the
    /// face does not belong to a body.
    pub fn is_hidden_back(&self, hit: &Hit) -> bool {
        if !hit.back {
            return false;
        }
        let (part, _, _, material) = self.part(hit.triangle);
        !material.double_sided && part.body.is_none()
    }

    /// Decides at random whether a ray with the random key `key` stops at the surface. The probability is the
    /// coverage of the surface.
    pub fn accepts(&self, hit: &Hit, key: u32, camera: bool) -> bool {
        let coverage = self.coverage(hit, camera);
        coverage == 1.0 || unit(hash(key, hit.triangle)) < coverage
    }

    /// Surface that is visible along a camera ray. One random number chooses among all surfaces along the ray: each
    /// surface takes its share of the range of numbers that the surfaces in front of it leave. Stratified numbers
    /// therefore give stratified coverage. One ray is cast for each surface; `rays` counts them. The flag is true
    /// if the ray passes the back of a face, invisible from behind, before the surface.
    pub fn front(&self, ray: Ray, number: u32, rays: &mut u64) -> Option<(Hit, bool)> {
        let mut number = fraction(number);
        let mut passed: Option<Hit> = None;
        // Distance to the nearest back. The search visits every hit that is nearer than its result.
        let mut back = f32::INFINITY;
        loop {
            *rays += 1;
            let behind = |hit: &Hit| passed.is_none_or(|last| nearer(&last, hit).is_lt());
            let hit = self.bvh.closest(ray, |hit| {
                let there = self.coverage(hit, true) > 0.0;
                if !there && self.is_hidden_back(hit) {
                    back = back.min(hit.t);
                }
                there && behind(hit)
            })?;
            let coverage = f64::from(self.coverage(&hit, true));
            if number < coverage {
                return Some((hit, back < hit.t));
            }
            number = (number - coverage) / (1.0 - coverage);
            passed = Some(hit);
        }
    }
}
