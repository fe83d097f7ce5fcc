//! The inserted objects as triangles in one frame, and what a ray finds on them.
//!
//! Light that passes a transmissive surface is bent and blurred for the camera and for specular rays. For
//! rays of matte surfaces, and so for shadows, it goes straight and is only dimmed and tinted: caustics of
//! refraction are left out, and both strategies that look for light from a matte surface agree on that.

use std::sync::Arc;

use engine::NodeError;
use glam::{DMat3, DVec3, Vec3};

use super::attributes::SurfacePoint;
use super::bsdf::{Bsdf, BsdfParams, Frame, Layers, mirroring, straight};
use super::contact::Ground;
use super::emitters::{COARSE, EmitterSample, Emitters};
use super::media::{Body, Media};
use super::mipmap::{Mipmap, Texels};
use super::receiver::{Receiver, Surface, geometry, margin};
use super::shades::Shades;
use super::touching::Touching;
use crate::bvh::{Bvh, Hit, Ray};
use crate::color::linear_from_srgb8;
use crate::error::Error;
use crate::num;
use crate::sampling::{hash, unit};
use crate::types::{AlphaMode, Material, NormalMap, Object, Placed, Primitive};

/// One primitive of one placed object.
#[derive(Debug)]
pub(super) struct PlacedPrimitive {
    pub(super) placed: usize,
    primitive: usize,
    /// Index of its first triangle in the tree.
    pub(super) first: u32,
    /// Normals to the frame of the scene: inverse transpose, columns.
    normals: [Vec3; 3],
    /// Tangents to the frame of the scene, columns.
    tangents: [Vec3; 3],
    mirrored: bool,
    opaque: bool,
    /// Whether light passes it straight.
    pub(super) clear: bool,
    /// The body that it bounds, if light comes into it.
    pub(super) body: Option<u32>,
}

/// The inserted objects.
#[derive(Debug)]
pub struct Objects {
    /// Their tree.
    pub bvh: Bvh,
    pub(super) corners: Vec<[Vec3; 3]>,
    pub(super) parts: Vec<PlacedPrimitive>,
    placed: Vec<Arc<Placed>>,
    decode: [f32; 256],
    /// Smaller copies of the textures of each placed object.
    mipmaps: Vec<Vec<Mipmap>>,
    opaque: bool,
    /// Whether light passes any of their surfaces.
    pub clear: bool,
    /// Whether the camera sees them.
    pub shown: bool,
    /// Whether lobes are evaluated that their materials do not have.
    pub every_lobe: bool,
    /// The insides that light can be in, and the box around them.
    pub(super) bodies: Vec<Body>,
    pub(super) held: Option<(Vec3, Vec3)>,
    /// What shines on them.
    pub emitters: Emitters,
    /// Where light of lamps comes through some of them.
    pub shades: Shades,
    /// Where they lie on the receiver.
    pub touching: Touching,
    /// What they stand on.
    pub ground: Ground,
    /// The farthest that a flat one was lifted off another: see [`super::stacked`].
    pub(super) lifted: f32,
}

fn columns(m: DMat3) -> [Vec3; 3] {
    [m.x_axis.as_vec3(), m.y_axis.as_vec3(), m.z_axis.as_vec3()]
}

fn apply(m: &[Vec3; 3], v: Vec3) -> Vec3 {
    m[0] * v.x + m[1] * v.y + m[2] * v.z
}

/// Corners in the order that keeps the outside in front after a mirroring transform.
fn wound([a, b, c]: [u32; 3], mirrored: bool) -> [u32; 3] {
    if mirrored { [a, c, b] } else { [a, b, c] }
}

/// Of the most that a picture has somewhere, the least that is looked for there: a texel among 128 by 128.
const FAINT: f32 = 1.0 / 16384.0;

/// Squares of lattices over all triangles that shine, beyond 32 to a side.
const CELLS: usize = 1 << 17;

impl Objects {
    /// Triangles of the objects, relative to `origin`, where there is no receiver.
    pub fn new(placed: &[Arc<Placed>], origin: DVec3) -> Result<Self, NodeError> {
        Self::on(None, placed, origin)
    }

    /// Triangles of the objects, relative to `origin`, as they lie on one another and on the receiver.
    pub fn on(receiver: Option<&Receiver>, placed: &[Arc<Placed>], origin: DVec3) -> Result<Self, NodeError> {
        let mut objects = Self {
            bvh: Bvh::default(),
            corners: Vec::new(),
            parts: Vec::new(),
            placed: placed.to_vec(),
            decode: linear_from_srgb8(),
            mipmaps: placed
                .iter()
                .map(|one| one.object.textures.iter().map(|_| Mipmap::default()).collect())
                .collect(),
            opaque: true,
            clear: false,
            shown: true,
            every_lobe: false,
            bodies: Vec::new(),
            held: None,
            emitters: Emitters::new(&[], |_| 1, |_, _| Vec3::ZERO),
            shades: Shades::default(),
            touching: Touching::default(),
            ground: Ground::default(),
            lifted: 0.0,
        };
        for (index, one) in placed.iter().enumerate() {
            let matrix = one.world_from_object;
            let linear = DMat3::from_mat4(matrix);
            let mirrored = linear.determinant() < 0.0;
            let size = num::pow(linear.determinant().abs(), 1.0 / 3.0);
            for (number, primitive) in one.object.primitives.iter().enumerate() {
                let material = one.object.materials.get(primitive.material as usize);
                let (Some(material), true) = (material, primitive.is_consistent()) else {
                    let what = format!("part {number} of object {index} names what it does not have");
                    return Err(NodeError::from(Error::Mismatch(what)).at("objects"));
                };
                let opaque = material.alpha_mode == AlphaMode::Opaque;
                objects.opaque &= opaque && material.double_sided;
                let clear = material.transmission.factor > 0.0;
                objects.clear |= clear;
                let lets_in = clear || material.diffuse_transmission.strength.factor > 0.0;
                let body = material.volume.filter(|_| lets_in).map(|volume| {
                    // It grows with the object, which keeps its looks.
                    let absorption = Vec3::from_array(volume) / size as f32;
                    let absorption = if absorption.is_finite() { absorption } else { Vec3::ZERO };
                    objects.body(Body { placed: index, absorption, ior: material.ior })
                });
                objects.parts.push(PlacedPrimitive {
                    placed: index,
                    primitive: number,
                    first: objects.corners.len() as u32,
                    normals: columns(linear.inverse().transpose()),
                    tangents: columns(linear),
                    mirrored,
                    opaque,
                    clear,
                    body,
                });
                let place = |i: u32| {
                    let local = DVec3::from_array(primitive.positions[i as usize].map(f64::from));
                    (matrix.transform_point3(local) - origin).as_vec3()
                };
                let first = objects.corners.len();
                objects.corners.extend(primitive.triangles.iter().map(|&t| wound(t, mirrored).map(place)));
                if body.is_some() {
                    let held = objects.corners[first..].iter().flatten().filter(|p| p.is_finite());
                    let held = held.map(|&p| (p, p)).chain(objects.held);
                    objects.held = held.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
                }
            }
        }
        objects.bvh = Bvh::build(&objects.corners);
        objects.lift_sheets(receiver);
        let shining = objects.placed.iter().flat_map(|one| &one.object.materials).any(Material::shines);
        if shining {
            // Of a lamp so small that the mean of the picture is rounded to black a little is looked for.
            let emission =
                |hit: &Hit, width| objects.emission(hit, width).max(objects.peak(hit, width) * FAINT);
            let finest = objects.finest();
            objects.emitters =
                Emitters::new(&objects.corners, |triangle| objects.lattice(triangle, finest), emission);
            objects.shades = Shades::of(&objects);
        }
        Ok(objects)
    }

    /// The number of a body; surfaces of one object around the same stuff share it.
    fn body(&mut self, body: Body) -> u32 {
        let at = self.bodies.iter().position(|known| *known == body).unwrap_or(self.bodies.len());
        if at == self.bodies.len() {
            self.bodies.push(body);
        }
        at as u32
    }

    /// The box around each placed object, as far as its corners are finite: lower corner, upper corner.
    pub fn boxes(&self) -> Vec<(Vec3, Vec3)> {
        let mut boxes = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); self.placed.len()];
        for (index, part) in self.parts.iter().enumerate() {
            let end = self.parts.get(index + 1).map_or(self.corners.len(), |next| next.first as usize);
            let corners = self.corners[part.first as usize..end].iter().flatten().filter(|p| p.is_finite());
            let (low, high) = &mut boxes[part.placed];
            corners.for_each(|p| (*low, *high) = (low.min(*p), high.max(*p)));
        }
        boxes
    }

    /// What they were made from.
    pub fn placed(&self) -> &[Arc<Placed>] {
        &self.placed
    }

    /// True when no ray can meet them.
    pub fn is_empty(&self) -> bool {
        self.bvh.bounds().is_none()
    }

    pub(super) fn part(&self, triangle: u32) -> (&PlacedPrimitive, &Object, &Primitive, &Material) {
        let at = self.parts.partition_point(|part| part.first <= triangle).saturating_sub(1);
        let part = &self.parts[at];
        let object = &*self.placed[part.placed].object;
        let primitive = &object.primitives[part.primitive];
        (part, object, primitive, &object.materials[primitive.material as usize])
    }

    fn point<'a>(&'a self, hit: &'a Hit) -> (&'a PlacedPrimitive, &'a Material, SurfacePoint<'a>) {
        let (part, object, primitive, material) = self.part(hit.triangle);
        let corner = wound(primitive.triangles[(hit.triangle - part.first) as usize], part.mirrored);
        let mipmaps = &self.mipmaps[part.placed];
        (
            part,
            material,
            SurfacePoint { object, primitive, corner, hit, decode: &self.decode, mipmaps, width: 0.0 },
        )
    }

    /// Whether a ray of the given random key meets the surface at a hit or passes through its cut-outs.
    /// `camera` rays also pass through the backs of single-sided surfaces, but for those of bodies, in whose stuff they are.
    pub fn accepts(&self, hit: &Hit, key: u32, camera: bool) -> bool {
        self.opaque || self.meets(hit, camera, || unit(hash(key, hit.triangle)))
    }

    /// Whether the camera sees anything of the surface at a hit: more than some share of what it sees there.
    pub fn shows(&self, hit: &Hit, share: f32) -> bool {
        self.opaque || self.meets(hit, true, || share)
    }

    /// Whether the surface at a hit is not cut out there, and where it is blended covers more than a share.
    fn meets(&self, hit: &Hit, camera: bool, share: impl FnOnce() -> f32) -> bool {
        let (part, material, point) = self.point(hit);
        if camera && hit.back && !material.double_sided && part.body.is_none() {
            return false;
        }
        if part.opaque {
            return true;
        }
        let alpha = material.base_colour[3]
            * point.texture(material.base_colour_texture, Texels::Numbers)[3]
            * point.vertex_colour()[3];
        match material.alpha_mode {
            AlphaMode::Opaque => true,
            AlphaMode::Mask(cutoff) => alpha >= cutoff,
            AlphaMode::Blend => share() < alpha,
        }
    }

    /// What passes straight through the surface at a hit, which the ray of the given direction meets; that of a
    /// body between the media on its sides, or in the air.
    pub(super) fn straight(&self, hit: &Hit, direction: Vec3, sides: Option<[Media; 2]>) -> Vec3 {
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

    /// How far along its ray the receiver counts as met before an object: where glass stands on it, the two are in
    /// one place, and what leaves the glass is the receiver's; where something flat lies on it, that is met first.
    pub fn reach(&self, hit: &Hit, direction: Vec3) -> f32 {
        let slack = self.slack(hit, direction);
        if slack > 0.0 {
            return hit.t - slack;
        }
        let part = self.part(hit.triangle).0;
        if !hit.back || !(part.clear || part.body.is_some()) {
            return hit.t;
        }
        let slant = self.normal(hit.triangle).dot(direction).abs().max(0.01);
        hit.t + 2.0 * margin(&self.corners[hit.triangle as usize]) / slant
    }

    /// A surface of another part in the very place of a hit, beyond which a ray that passes the first would start: that of
    /// a table on which glass stands, or of what fills the glass.
    pub fn touching(&self, hit: &Hit, surface: &Surface, direction: Vec3, key: u32) -> Option<Hit> {
        let slant = direction.dot(surface.normal).abs().max(0.01);
        let start = surface.position + surface.normal * surface.margin;
        let ray = Ray { t_max: 2.0 * surface.margin / slant, ..Ray::new(start, direction) };
        let own = self.part(hit.triangle).0.first;
        self.bvh.closest(ray, |hit| self.part(hit.triangle).0.first != own && self.accepts(hit, key, false))
    }

    /// The surface at a hit, seen from the unit direction `out` by a ray of some width there; without what passes
    /// it where `straight`. The ray came through `media`.
    pub fn surface(&self, hit: &Hit, out: Vec3, straight: bool, width: f32, media: Media) -> Surface {
        let (part, material, point) = self.point(hit);
        let media = self.sides(part, hit.back, media);
        let [a, b, c] = self.corners[hit.triangle as usize];
        let area = (b - a).cross(c - a);
        // Seen aslant a ray is wider one way; the mean of both ways blurs no more than it must.
        let slant = area.normalize_or_zero().dot(out).abs().max(0.01);
        let filtered =
            SurfacePoint { width: width / (slant * area.length().max(f32::MIN_POSITIVE)).sqrt(), ..point };
        let (position, winding, margin) = geometry(&self.corners[hit.triangle as usize], hit);
        let side = if hit.back { -1.0 } else { 1.0 };
        let geometric = winding * side;
        // Shading normal on the side of the winding, then of the viewer.
        let smooth = match point.primitive.normals.is_empty() {
            true => winding,
            false => apply(&part.normals, Vec3::from_array(point.blend(&point.primitive.normals)))
                .normalize_or(winding),
        };
        let smooth = if smooth.dot(winding) < 0.0 { -smooth } else { smooth };
        let facing = |normal: Vec3| {
            // A bent normal may turn away from the viewer; bend it back to just this side of the horizon.
            let (normal, lift) = (normal * side, 0.01 - normal.dot(out) * side);
            let seen = if lift > 0.0 { (normal + out * lift).normalize_or(geometric) } else { normal };
            mirroring(seen, geometric, out)
        };
        let bent =
            |map: Option<NormalMap>| facing(map.map_or(smooth, |map| self.bump(part, &point, &map, smooth)));
        let mut params = BsdfParams { every_lobe: self.every_lobe, ..params(&filtered, material) };
        params.inside = params.thick && hit.back && !straight;
        if part.body.is_some() {
            let [near, far] = self.indices(media);
            // From the denser side there is a critical angle, on whichever side of the body that is.
            params.inside |= near > far && !straight;
            params.ior = if params.inside { near / far } else { (far / near).max(near / far) };
        }
        params.blocked = straight;
        let normal = bent(material.normal);
        let frame = match params.anisotropy > 0.0 {
            true => {
                let (tangent, strength) = self.brush(part, &point, material, smooth);
                params.anisotropy *= strength;
                Frame::along(normal, tangent)
            }
            false => Frame::around(normal),
        };
        let coated = match (params.coat.0 > 0.0, material.clearcoat.normal) {
            (true, map) => Frame::around(bent(map)),
            (false, _) => frame,
        };
        let bsdf = match material.unlit {
            true => Bsdf::matte(geometric, Vec3::ZERO),
            false => Bsdf::Layers(Layers::new([frame, coated], geometric, out, &params)),
        };
        let emission = emission(&filtered, material) * bsdf.under();
        Surface { position, normal: geometric, margin, bsdf, emission, media, cover: None, bed: None }
    }

    /// Unit normal of a triangle, by its winding.
    pub fn normal(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners[triangle as usize];
        (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3()
    }

    /// What shines at a hit towards a unit direction: less than the material emits where a coat or sheen is over it.
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

    /// What the material emits at a hit, on the mean over a width as a share of the square root of twice the triangle's area.
    pub fn emission(&self, hit: &Hit, width: f32) -> Vec3 {
        let (_, material, point) = self.point(hit);
        emission(&SurfacePoint { width, ..point }, material)
    }

    /// The most that the picture of what the material emits has over a width, as [`emission`](Self::emission) has the mean;
    /// black without a picture.
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

    /// Squares a side of the finest lattices: 32, and more of few triangles, such as a panel of lights.
    fn finest(&self) -> u32 {
        let shining = self.parts.iter().map(|part| {
            let object = &self.placed[part.placed].object;
            let primitive = &object.primitives[part.primitive];
            let shines = object.materials.get(primitive.material as usize).is_some_and(Material::shines);
            if shines { primitive.triangles.len() } else { 0 }
        });
        let each = CELLS / shining.sum::<usize>().max(1);
        (each.isqrt() as u32).max(COARSE)
    }

    /// Squares a side of the lattice by which the picture of what a triangle emits is looked at: of four texels, as a
    /// rule, and at most `finest`.
    fn lattice(&self, triangle: u32, finest: u32) -> u32 {
        let hit = Hit { t: 0.0, triangle, b1: 0.0, b2: 0.0, back: false };
        let (_, material, point) = self.point(&hit);
        let picture = if material.unlit { material.base_colour_texture } else { material.emissive_texture };
        let texels = picture.map_or(0.0, |picture| point.texels(picture));
        // What is not a number is 0.
        ((texels / 4.0).ceil() as u32).clamp(1, finest)
    }

    /// A point that shines, from fractions; there must be some.
    pub fn sample_emitter(&self, choice: u32, place: [u32; 2]) -> EmitterSample {
        self.emitters.sample(&self.corners, choice, place)
    }

    /// Tangent across a normal, by stored tangents or by texture coordinates, and the sign of the bitangent.
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
                // Up the picture is against v.
                ((e * t.y - f * s.y) * area.signum(), -area.signum())
            }
        };
        ((tangent - normal * normal.dot(tangent)).normalize_or_zero(), hand)
    }

    /// The normal of a normal map.
    fn bump(&self, part: &PlacedPrimitive, point: &SurfacePoint<'_>, map: &NormalMap, normal: Vec3) -> Vec3 {
        let [x, y, z, _] = point.texture(Some(map.texture), Texels::Numbers).map(|c| 2.0 * c - 1.0);
        let (tangent, hand) = self.tangent(part, point, map.texture.uv_set, normal);
        let bitangent = normal.cross(tangent) * hand;
        ((tangent * x + bitangent * y) * map.scale + normal * z).normalize_or(normal)
    }

    /// The direction of the brush of an anisotropic surface, and its strength by the texture.
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

/// What a material emits at a point.
fn emission(point: &SurfacePoint<'_>, material: &Material) -> Vec3 {
    if material.unlit {
        return params(point, material).base;
    }
    if material.emissive == [0.0; 3] {
        return Vec3::ZERO;
    }
    let [r, g, b, _] = point.texture(material.emissive_texture, Texels::Colours);
    Vec3::from_array(material.emissive) * Vec3::new(r, g, b)
}

/// What a material says at a point.
fn params(point: &SurfacePoint<'_>, material: &Material) -> BsdfParams {
    let texels = match material.alpha_mode {
        AlphaMode::Opaque => Texels::Colours,
        // Cut off at 0 all of it is there.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A mirror keeps the outside outside.
    #[test]
    fn row_68_mirrored_objects_keep_their_front() {
        let object = Object {
            primitives: vec![Primitive {
                positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                normals: vec![[0.0, 0.0, 1.0]; 3],
                triangles: vec![[0, 1, 2]],
                ..Primitive::default()
            }],
            materials: vec![Material { double_sided: false, ..Material::default() }],
            textures: Vec::new(),
        };
        let mirror = glam::DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        let placed = Arc::new(Placed { object: Arc::new(object), world_from_object: mirror });
        let objects = Objects::new(&[placed], DVec3::ZERO).expect("consistent");
        let ray = Ray::new(Vec3::new(-0.2, 0.2, 1.0), Vec3::NEG_Z);
        let hit = objects.bvh.closest(ray, |hit| objects.accepts(hit, 0, true)).expect("front");
        assert!(!hit.back);
        let surface = objects.surface(&hit, Vec3::Z, false, 0.0, Media::default());
        assert!((surface.normal - Vec3::Z).length() < 1e-6);
        let behind = Ray::new(Vec3::new(-0.2, 0.2, -1.0), Vec3::Z);
        assert!(objects.bvh.closest(behind, |hit| objects.accepts(hit, 0, true)).is_none());
        assert!(objects.bvh.any(behind, |hit| objects.accepts(hit, 0, false)));
    }
}
