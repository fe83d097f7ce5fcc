//! The receiver and the objects as triangles in one frame, and what a ray finds on them.

use std::sync::Arc;

use engine::NodeError;
use glam::{DMat3, DVec3, Vec2, Vec3};

use super::bsdf::{Bsdf, Look};
use crate::bvh::{Bvh, Hit, Ray};
use crate::color::linear_from_srgb8;
use crate::error::Error;
use crate::sampling::{hash, unit};
use crate::types::{AlphaMode, Material, Mesh, Object, Placed, Primitive, TextureRef, Wrap};

/// Albedo of a receiver without vertex colours.
pub const GREY: f32 = 0.5;

/// A point of a surface as light transport sees it.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Where, in the frame of the scene.
    pub position: Vec3,
    /// Unit geometric normal on the side of the viewer.
    pub normal: Vec3,
    /// How far rays must start off the surface not to meet it again.
    pub margin: f32,
    /// How it scatters.
    pub bsdf: Bsdf,
    /// What it emits towards the viewer.
    pub emission: Vec3,
}

impl Surface {
    /// A ray that leaves the surface.
    pub fn leave(&self, direction: Vec3) -> Ray {
        let side = self.margin.copysign(direction.dot(self.normal));
        Ray::new(self.position + self.normal * side, direction)
    }
}

/// Position, unit normal of the winding, and margin of a hit. The margin covers the rounding of corners,
/// barycentrics and the ray's origin, each a few units in the last place of the largest coordinate.
fn geometry(corners: &[Vec3; 3], hit: &Hit) -> (Vec3, Vec3, f32) {
    let [a, b, c] = *corners;
    let position = a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2;
    let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
    let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
    (position, normal, reach * (8.0 * f32::EPSILON))
}

/// The mesh that stands for the place.
#[derive(Debug, Default)]
pub struct Receiver {
    /// Its tree.
    pub bvh: Bvh,
    corners: Vec<[Vec3; 3]>,
    colours: Vec<[Vec3; 3]>,
    /// Vertex colours beyond [0, 1] or not finite, which were clamped.
    pub clamped: u64,
}

impl Receiver {
    /// Triangles of a mesh, relative to `origin`.
    pub fn new(mesh: &Mesh, origin: DVec3) -> Self {
        let place =
            |i: u32| (DVec3::from_array(mesh.positions[i as usize].map(f64::from)) - origin).as_vec3();
        let corners: Vec<[Vec3; 3]> = mesh.triangles.iter().map(|t| t.map(place)).collect();
        let mut clamped = 0;
        let albedos: Vec<Vec3> = mesh
            .colours
            .iter()
            .map(|colour| {
                // An albedo above 1 would make light; NaN fails the comparison and becomes 0.
                let good = colour.map(|v| if v > 0.0 { v.min(1.0) } else { 0.0 });
                clamped += u64::from(good != *colour);
                Vec3::from_array(good)
            })
            .collect();
        let colours = match albedos.is_empty() {
            true => Vec::new(),
            false => mesh.triangles.iter().map(|t| t.map(|i| albedos[i as usize])).collect(),
        };
        Self { bvh: Bvh::build(&corners), corners, colours, clamped }
    }

    /// Unit normal of a triangle, by its winding.
    pub fn normal(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners[triangle as usize];
        (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3()
    }

    /// The surface at a hit, seen from the unit direction `out`.
    pub fn surface(&self, hit: &Hit, out: Vec3) -> Surface {
        let (position, normal, margin) = geometry(&self.corners[hit.triangle as usize], hit);
        let normal = if hit.back { -normal } else { normal };
        let albedo = match self.colours.get(hit.triangle as usize) {
            Some([a, b, c]) => *a * (1.0 - hit.b1 - hit.b2) + *b * hit.b1 + *c * hit.b2,
            None => Vec3::splat(GREY),
        };
        Surface { position, normal, margin, bsdf: Bsdf::diffuse(normal, out, albedo), emission: Vec3::ZERO }
    }
}

/// One primitive of one placed object.
#[derive(Debug)]
struct Part {
    placed: usize,
    primitive: usize,
    /// Index of its first triangle in the tree.
    first: u32,
    /// Normals to the frame of the scene: inverse transpose, columns.
    normals: [Vec3; 3],
    /// Tangents to the frame of the scene, columns.
    tangents: [Vec3; 3],
    mirrored: bool,
    opaque: bool,
}

/// The inserted objects.
#[derive(Debug)]
pub struct Objects {
    /// Their tree.
    pub bvh: Bvh,
    corners: Vec<[Vec3; 3]>,
    parts: Vec<Part>,
    placed: Vec<Arc<Placed>>,
    decode: [f32; 256],
    opaque: bool,
    /// What the materials ask for and this renderer leaves out, each named once.
    pub dropped: Vec<&'static str>,
}

fn columns(m: DMat3) -> [Vec3; 3] {
    [m.x_axis.as_vec3(), m.y_axis.as_vec3(), m.z_axis.as_vec3()]
}

fn apply(m: &[Vec3; 3], v: Vec3) -> Vec3 {
    m[0] * v.x + m[1] * v.y + m[2] * v.z
}

impl Objects {
    /// Triangles of the objects, relative to `origin`.
    pub fn new(placed: &[Arc<Placed>], origin: DVec3) -> Result<Self, NodeError> {
        let mut objects = Self {
            bvh: Bvh::default(),
            corners: Vec::new(),
            parts: Vec::new(),
            placed: placed.to_vec(),
            decode: linear_from_srgb8(),
            opaque: true,
            dropped: Vec::new(),
        };
        for (index, one) in placed.iter().enumerate() {
            let matrix = one.world_from_object;
            let linear = DMat3::from_mat4(matrix);
            let mirrored = linear.determinant() < 0.0;
            for (number, primitive) in one.object.primitives.iter().enumerate() {
                let material = one.object.materials.get(primitive.material as usize);
                let (Some(material), true) = (material, primitive.is_consistent()) else {
                    let what = format!("part {number} of object {index} names what it does not have");
                    return Err(NodeError::from(Error::Mismatch(what)).at("objects"));
                };
                let opaque = material.alpha_mode == AlphaMode::Opaque;
                objects.opaque &= opaque && material.double_sided;
                objects.drop_from(material);
                objects.parts.push(Part {
                    placed: index,
                    primitive: number,
                    first: objects.corners.len() as u32,
                    normals: columns(linear.inverse().transpose()),
                    tangents: columns(linear),
                    mirrored,
                    opaque,
                });
                let place = |i: u32| {
                    let local = DVec3::from_array(primitive.positions[i as usize].map(f64::from));
                    (matrix.transform_point3(local) - origin).as_vec3()
                };
                objects.corners.extend(primitive.triangles.iter().map(|&t| wound(t, mirrored).map(place)));
            }
        }
        objects.bvh = Bvh::build(&objects.corners);
        Ok(objects)
    }

    /// True when no ray can meet them.
    pub fn is_empty(&self) -> bool {
        self.bvh.bounds().is_none()
    }

    fn drop_from(&mut self, material: &Material) {
        let features = [
            (material.transmission > 0.0, "transmission (rendered opaque)"),
            (material.clearcoat > 0.0, "clearcoat"),
        ];
        for (used, name) in features {
            if used && !self.dropped.contains(&name) {
                self.dropped.push(name);
            }
        }
    }

    fn part(&self, triangle: u32) -> (&Part, &Object, &Primitive, &Material) {
        let at = self.parts.partition_point(|part| part.first <= triangle).saturating_sub(1);
        let part = &self.parts[at];
        let object = &*self.placed[part.placed].object;
        let primitive = &object.primitives[part.primitive];
        (part, object, primitive, &object.materials[primitive.material as usize])
    }

    /// Whether a ray of the given random key meets the surface at a hit or passes through its cut-outs.
    /// `camera` rays also pass through the backs of single-sided surfaces.
    pub fn accepts(&self, hit: &Hit, key: u32, camera: bool) -> bool {
        if self.opaque {
            return true;
        }
        let (part, object, primitive, material) = self.part(hit.triangle);
        if camera && hit.back && !material.double_sided {
            return false;
        }
        if part.opaque {
            return true;
        }
        let corner = wound(primitive.triangles[(hit.triangle - part.first) as usize], part.mirrored);
        let at = At { object, primitive, corner, hit, decode: &self.decode };
        let alpha = material.base_colour[3]
            * at.texture(material.base_colour_texture, false)[3]
            * at.vertex_colour()[3];
        match material.alpha_mode {
            AlphaMode::Opaque => true,
            AlphaMode::Mask(cutoff) => alpha >= cutoff,
            AlphaMode::Blend => unit(hash(key, hit.triangle)) < alpha,
        }
    }

    /// The surface at a hit, seen from the unit direction `out`.
    pub fn surface(&self, hit: &Hit, out: Vec3) -> Surface {
        let (part, object, primitive, material) = self.part(hit.triangle);
        let (position, winding, margin) = geometry(&self.corners[hit.triangle as usize], hit);
        let side = if hit.back { -1.0 } else { 1.0 };
        let geometric = winding * side;
        let corner = wound(primitive.triangles[(hit.triangle - part.first) as usize], part.mirrored);
        let at = At { object, primitive, corner, hit, decode: &self.decode };
        // Shading normal on the side of the winding, then of the viewer.
        let smooth = match primitive.normals.is_empty() {
            true => winding,
            false => apply(&part.normals, at.blend(&primitive.normals)).normalize_or(winding),
        };
        let mut normal = if smooth.dot(winding) < 0.0 { -smooth } else { smooth };
        if let Some(texture) = material.normal_texture {
            normal = self.bump(part, &at, material, texture, normal);
        }
        normal *= side;
        // A bent normal may turn away from the viewer; bend it back to just this side of the horizon.
        let facing = normal.dot(out);
        if facing < 0.01 {
            normal = (normal + out * (0.01 - facing)).normalize_or(geometric);
        }
        let base = at.texture(material.base_colour_texture, true);
        let colour = at.vertex_colour();
        let channel = |c: usize| (material.base_colour[c] * base[c] * colour[c]).clamp(0.0, 1.0);
        let [_, green, blue, _] = at.texture(material.metallic_roughness_texture, false);
        let reflectance = (material.ior - 1.0) / (material.ior + 1.0);
        let look = Look {
            base: Vec3::new(channel(0), channel(1), channel(2)),
            metallic: (material.metallic * blue).clamp(0.0, 1.0),
            roughness: (material.roughness * green).clamp(0.0, 1.0),
            f0: reflectance * reflectance,
        };
        let mut emission = Vec3::from_array(material.emissive);
        if emission != Vec3::ZERO {
            let [r, g, b, _] = at.texture(material.emissive_texture, true);
            emission *= Vec3::new(r, g, b);
        }
        Surface {
            position,
            normal: geometric,
            margin,
            bsdf: Bsdf::new(normal, geometric, out, look),
            emission,
        }
    }

    /// The normal of a normal map, by stored tangents or those of the texture coordinates.
    fn bump(&self, part: &Part, at: &At<'_>, material: &Material, texture: TextureRef, normal: Vec3) -> Vec3 {
        let [x, y, z, _] = at.texture(Some(texture), false);
        let bent = Vec3::new(
            (2.0 * x - 1.0) * material.normal_scale,
            (2.0 * y - 1.0) * material.normal_scale,
            2.0 * z - 1.0,
        );
        let (tangent, hand) = match at.primitive.tangents.is_empty() {
            false => {
                let [a, b, c] = at.corner.map(|i| at.primitive.tangents[i as usize]);
                let mix =
                    |k: usize| a[k] * (1.0 - at.hit.b1 - at.hit.b2) + b[k] * at.hit.b1 + c[k] * at.hit.b2;
                let mirror = if part.mirrored { -1.0 } else { 1.0 };
                (apply(&part.tangents, Vec3::new(mix(0), mix(1), mix(2))), a[3].signum() * mirror)
            }
            true => {
                let [a, b, c] = self.corners[at.hit.triangle as usize];
                let [p, q, r] = at.coordinates(texture.uv_set);
                let (e, f, s, t) = (b - a, c - a, q - p, r - p);
                let area = s.x * t.y - t.x * s.y;
                ((e * t.y - f * s.y) * area.signum(), area.signum())
            }
        };
        let tangent = (tangent - normal * normal.dot(tangent)).normalize_or_zero();
        let bitangent = normal.cross(tangent) * hand;
        (tangent * bent.x + bitangent * bent.y + normal * bent.z).normalize_or(normal)
    }
}

/// Corners in the order that keeps the outside in front after a mirroring transform.
fn wound([a, b, c]: [u32; 3], mirrored: bool) -> [u32; 3] {
    if mirrored { [a, c, b] } else { [a, b, c] }
}

/// A point of a primitive, for attribute lookup.
struct At<'a> {
    object: &'a Object,
    primitive: &'a Primitive,
    corner: [u32; 3],
    hit: &'a Hit,
    decode: &'a [f32; 256],
}

impl At<'_> {
    fn blend(&self, values: &[[f32; 3]]) -> Vec3 {
        let [a, b, c] = self.corner.map(|i| Vec3::from_array(values[i as usize]));
        a * (1.0 - self.hit.b1 - self.hit.b2) + b * self.hit.b1 + c * self.hit.b2
    }

    fn vertex_colour(&self) -> [f32; 4] {
        if self.primitive.colours.is_empty() {
            return [1.0; 4];
        }
        let [a, b, c] = self.corner.map(|i| self.primitive.colours[i as usize]);
        std::array::from_fn(|k| {
            a[k] * (1.0 - self.hit.b1 - self.hit.b2) + b[k] * self.hit.b1 + c[k] * self.hit.b2
        })
    }

    fn coordinates(&self, set: u32) -> [Vec2; 3] {
        let uv = if set == 0 { &self.primitive.uv0 } else { &self.primitive.uv1 };
        self.corner.map(|i| uv.get(i as usize).copied().map_or(Vec2::ZERO, Vec2::from_array))
    }

    /// A texture at this point, decoded if `colour`; white where there is none.
    fn texture(&self, texture: Option<TextureRef>, colour: bool) -> [f32; 4] {
        let Some(texture) = texture else { return [1.0; 4] };
        let Some(image) = self.object.textures.get(texture.texture as usize) else { return [1.0; 4] };
        if image.width == 0 || image.height == 0 {
            return [1.0; 4];
        }
        let [a, b, c] = self.coordinates(texture.uv_set);
        let mut uv = a * (1.0 - self.hit.b1 - self.hit.b2) + b * self.hit.b1 + c * self.hit.b2;
        if let Some(t) = texture.transform {
            // KHR_texture_transform: a positive rotation turns the coordinates counter-clockwise with v down.
            let (sin, cos) = crate::num::sin_cos(f64::from(t.rotation));
            let (sin, cos) = (sin as f32, cos as f32);
            let (u, v) = (uv.x * t.scale[0], uv.y * t.scale[1]);
            uv = Vec2::new(cos * u + sin * v + t.offset[0], cos * v - sin * u + t.offset[1]);
        }
        let fetch = |x: i64, y: i64| -> [f32; 4] {
            let x = wrap(x, i64::from(image.width), texture.sampler.wrap_u);
            let y = wrap(y, i64::from(image.height), texture.sampler.wrap_v);
            let first = (y * image.width as usize + x) * 4;
            let texel = [0, 1, 2, 3].map(|k| image.rgba[first + k]);
            std::array::from_fn(|k| {
                if colour && k < 3 { self.decode[texel[k] as usize] } else { f32::from(texel[k]) / 255.0 }
            })
        };
        let (x, y) = (uv.x * image.width as f32, uv.y * image.height as f32);
        if texture.sampler.nearest {
            return fetch(x.floor() as i64, y.floor() as i64);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (i, j) = (x.floor() as i64, y.floor() as i64);
        let (u, v) = (x - x.floor(), y - y.floor());
        let [p, q, r, s] = [fetch(i, j), fetch(i + 1, j), fetch(i, j + 1), fetch(i + 1, j + 1)];
        std::array::from_fn(|k| (p[k] * (1.0 - u) + q[k] * u) * (1.0 - v) + (r[k] * (1.0 - u) + s[k] * u) * v)
    }
}

/// The texel that stands at an index beyond the edge.
fn wrap(index: i64, size: i64, mode: Wrap) -> usize {
    let at = match mode {
        Wrap::Clamp => index.clamp(0, size - 1),
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Mirror => {
            let at = index.rem_euclid(2 * size);
            if at < size { at } else { 2 * size - 1 - at }
        }
    };
    at as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_continue_as_asked() {
        let at = |mode| [-3, -1, 0, 3, 4, 9].map(|i| wrap(i, 4, mode));
        assert_eq!(at(Wrap::Repeat), [1, 3, 0, 3, 0, 1]);
        assert_eq!(at(Wrap::Mirror), [2, 0, 0, 3, 3, 1]);
        assert_eq!(at(Wrap::Clamp), [0, 0, 0, 3, 3, 3]);
    }

    // Row 68: a mirror keeps the outside outside.
    #[test]
    fn mirrored_objects_keep_their_front() {
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
        let surface = objects.surface(&hit, Vec3::Z);
        assert!((surface.normal - Vec3::Z).length() < 1e-6);
        let behind = Ray::new(Vec3::new(-0.2, 0.2, -1.0), Vec3::Z);
        assert!(objects.bvh.closest(behind, |hit| objects.accepts(hit, 0, true)).is_none());
        assert!(objects.bvh.any(behind, |hit| objects.accepts(hit, 0, false)));
    }
}
