//! Surface of an object at a hit: material parameters and shading normal.

use glam::Vec3;
use scene::math::num;
use scene::types::{AlphaMode, Material, NormalMap};

use super::attributes::SurfacePoint;
use super::face::geometry;
use super::media::Media;
use super::mipmap::Texels;
use super::objects::{Objects, PlacedPrimitive};
use super::surface::Surface;
use crate::geometry::bvh::Hit;
use crate::transport::bsdf::{Bsdf, BsdfParams, Frame, Layers, mirroring, straight};

impl Objects {
    /// Surface at a hit, seen from the unit direction `out` by a ray with a footprint of `width` that arrived
    /// through `media`. Transmission is left out if `straight` is true.
    pub fn surface(&self, hit: &Hit, out: Vec3, straight: bool, width: f32, media: Media) -> Surface {
        let (part, material, point) = self.point(hit);
        let media = self.sides(part, hit.back, media);
        let [a, b, c] = self.corners[hit.triangle as usize];
        let area = (b - a).cross(c - a);
        // An oblique footprint is an ellipse; the geometric mean of its axes does not blur more than necessary.
        let slant = area.normalize_or_zero().dot(out).abs().max(0.01);
        let filtered =
            SurfacePoint { width: width / (slant * area.length().max(f32::MIN_POSITIVE)).sqrt(), ..point };
        let (position, winding, margin) = geometry(&self.corners[hit.triangle as usize], hit);
        let side = if hit.back { -1.0 } else { 1.0 };
        let geometric = winding * side;
        // The shading normal, first on the side of the winding, then of the viewer.
        let smooth = match point.primitive.normals.is_empty() {
            true => winding,
            false => apply(&part.normals, Vec3::from_array(point.blend(&point.primitive.normals)))
                .normalize_or(winding),
        };
        let smooth = if smooth.dot(winding) < 0.0 { -smooth } else { smooth };
        let mapped =
            |map: Option<NormalMap>| side * map.map_or(smooth, |map| self.bump(part, &point, &map, smooth));
        // Reflection and refraction need a normal on the viewer's side, at least slightly above the horizon.
        let facing = |normal: Vec3| {
            let lift = 0.01 - normal.dot(out);
            let seen = if lift > 0.0 { (normal + out * lift).normalize_or(geometric) } else { normal };
            mirroring(seen, geometric, out)
        };
        let mut params = BsdfParams { every_lobe: self.every_lobe, ..params(&filtered, material) };
        params.inside = params.thick && hit.back && !straight;
        if part.body.is_some() {
            let [near, far] = self.indices(media);
            // From the denser side there is a critical angle, whichever side of the body that is.
            params.inside |= near > far && !straight;
            params.ior = if params.inside { near / far } else { (far / near).max(near / far) };
        }
        params.blocked = straight;
        let matte_normal = mapped(material.normal);
        let normal = facing(matte_normal);
        let frame = match params.anisotropy > 0.0 {
            true => {
                let (tangent, strength) = self.brush(part, &point, material, smooth);
                params.anisotropy *= strength;
                Frame::along(normal, tangent)
            }
            false => Frame::around(normal),
        };
        let coated = match (params.coat.0 > 0.0, material.clearcoat.normal) {
            (true, map) => Frame::around(facing(mapped(map))),
            (false, _) => frame,
        };
        let matte_frame = if matte_normal == normal { frame } else { Frame::around(matte_normal) };
        let bsdf = match material.unlit {
            true => Bsdf::matte(geometric, Vec3::ZERO),
            false => Bsdf::Layers(Layers::new([matte_frame, frame, coated], geometric, out, &params)),
        };
        let emission = emission(&filtered, material) * bsdf.under();
        let lift = Vec3::ZERO;
        Surface { position, normal: geometric, margin, bsdf, emission, media, cover: None, bed: None, lift }
    }

    /// Transmittance of the surface at a hit for light that continues in the same direction. For a body it depends
    /// on the media on the two sides; other surfaces are surrounded by air.
    pub(crate) fn straight(&self, hit: &Hit, direction: Vec3, sides: Option<[Media; 2]>) -> Vec3 {
        let (_, material, point) = self.point(hit);
        if material.transmission.factor == 0.0 {
            return Vec3::ZERO;
        }
        let mut params = params(&point, material);
        if let Some([near, far]) = sides.map(|sides| self.indices(sides)) {
            params.ior = (near / far).max(far / near);
        }
        let (_, normal, _) = geometry(&self.corners[hit.triangle as usize], hit);
        straight(&params, normal.dot(direction).abs())
    }

    /// Tangent perpendicular to a normal, from stored tangents or texture coordinates, and the sign of the
    /// bitangent.
    fn tangent(
        &self,
        part: &PlacedPrimitive,
        point: &SurfacePoint<'_>,
        uv_set: u32,
        normal: Vec3,
    ) -> (Vec3, f32) {
        let (tangent, hand) = match point.primitive.tangents.is_empty() {
            false => {
                let [x, y, z, _] = point.blend(&point.primitive.tangents);
                let hand = point.primitive.tangents[point.corner[0] as usize][3].signum();
                let mirror = if part.mirrored { -1.0 } else { 1.0 };
                (apply(&part.tangents, Vec3::new(x, y, z)), hand * mirror)
            }
            true => {
                let [a, b, c] = self.corners[point.hit.triangle as usize];
                let [p, q, r] = point.coordinates(uv_set);
                let (e, f, s, t) = (b - a, c - a, q - p, r - p);
                let area = s.x * t.y - t.x * s.y;
                // The bitangent points up in the texture, against v.
                ((e * t.y - f * s.y) * area.signum(), -area.signum())
            }
        };
        ((tangent - normal * normal.dot(tangent)).normalize_or_zero(), hand)
    }

    /// Normal from a normal map.
    fn bump(&self, part: &PlacedPrimitive, point: &SurfacePoint<'_>, map: &NormalMap, normal: Vec3) -> Vec3 {
        let [x, y, z, _] = point.texture(Some(map.texture), Texels::Numbers).map(|c| 2.0 * c - 1.0);
        let (tangent, hand) = self.tangent(part, point, map.texture.uv_set, normal);
        let bitangent = normal.cross(tangent) * hand;
        ((tangent * x + bitangent * y) * map.scale + normal * z).normalize_or(normal)
    }

    /// Direction of the anisotropy, from its rotation and texture, and the factor by which the texture scales its
    /// strength.
    fn brush(
        &self,
        part: &PlacedPrimitive,
        point: &SurfacePoint<'_>,
        material: &Material,
        normal: Vec3,
    ) -> (Vec3, f32) {
        let brush = &material.anisotropy;
        let (tangent, hand) = self.tangent(part, point, brush.texture.map_or(0, |t| t.uv_set), normal);
        let bitangent = normal.cross(tangent) * hand;
        let (sin, cos) = num::sin_cos(f64::from(brush.rotation));
        let (sin, cos) = (sin as f32, cos as f32);
        let [x, y, strength] = match brush.texture {
            Some(texture) => {
                let [x, y, strength, _] = point.texture(Some(texture), Texels::Numbers);
                [2.0 * x - 1.0, 2.0 * y - 1.0, strength]
            }
            None => [1.0, 0.0, 1.0],
        };
        (tangent * (cos * x - sin * y) + bitangent * (sin * x + cos * y), strength)
    }
}

fn apply(m: &[Vec3; 3], v: Vec3) -> Vec3 {
    m[0] * v.x + m[1] * v.y + m[2] * v.z
}

/// Parameters of a material at a point.
pub(crate) fn params(point: &SurfacePoint<'_>, material: &Material) -> BsdfParams {
    let texels = match material.alpha_mode {
        AlphaMode::Opaque => Texels::Colours,
        // With a cutoff of 0 every texel is covered.
        AlphaMode::Mask(cutoff) if cutoff <= 0.0 => Texels::Colours,
        AlphaMode::Mask(_) | AlphaMode::Blend => Texels::CoveredColours,
    };
    let base = point.texture(material.base_colour_texture, texels);
    let point = &SurfacePoint { width: 0.0, ..*point };
    let colour = point.vertex_colour();
    let channel = |c: usize| (material.base_colour[c] * base[c] * colour[c]).clamp(0.0, 1.0);
    let [_, green, blue, _] = point.texture(material.metallic_roughness_texture, Texels::Numbers);
    let mut params = BsdfParams {
        base: Vec3::new(channel(0), channel(1), channel(2)),
        metallic: (material.metallic * blue).clamp(0.0, 1.0),
        roughness: (material.roughness * green).clamp(0.0, 1.0),
        ior: material.ior,
        transmission: point.number(&material.transmission, 0),
        thick: material.volume.is_some(),
        specular: (point.number(&material.specular.strength, 3), point.colour(&material.specular.colour)),
        anisotropy: material.anisotropy.strength,
        ..BsdfParams::default()
    };
    let film = &material.iridescence;
    if film.strength.factor > 0.0 {
        let [thin, full] = film.thickness_nm;
        let t =
            film.thickness_texture.map_or(1.0, |texture| point.texture(Some(texture), Texels::Numbers)[1]);
        params.film = (point.number(&film.strength, 0), film.ior, thin + (full - thin) * t);
    }
    let (sheen, coat, through) = (&material.sheen, &material.clearcoat, &material.diffuse_transmission);
    if sheen.colour.factor != [0.0; 3] {
        params.sheen = (point.colour(&sheen.colour), point.number(&sheen.roughness, 3));
    }
    if coat.strength.factor > 0.0 {
        params.coat = (point.number(&coat.strength, 0), point.number(&coat.roughness, 1));
    }
    if through.strength.factor > 0.0 {
        params.through = (point.number(&through.strength, 3), point.colour(&through.colour));
    }
    params
}

/// Emission of a material at a point.
pub(crate) fn emission(point: &SurfacePoint<'_>, material: &Material) -> Vec3 {
    if material.unlit {
        return params(point, material).base;
    }
    if material.emissive == [0.0; 3] {
        return Vec3::ZERO;
    }
    let [r, g, b, _] = point.texture(material.emissive_texture, Texels::Colours);
    Vec3::from_array(material.emissive) * Vec3::new(r, g, b)
}
