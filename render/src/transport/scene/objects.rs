//! Inserted objects as triangles in one frame, and the intersections of rays with them.
//!
//! Transmission bends and blurs light for camera rays and specular rays. For rays from matte surfaces, including
//! shadow rays, light goes straight on and is only attenuated. Refractive caustics are therefore left out, both for
//! light samples and for scattered rays.

use std::ops::Range;
use std::sync::Arc;

use engine::NodeError;
use glam::{DMat3, DVec3, Vec3};
use scene::error::Error;
use scene::math::color::linear_from_srgb8;
use scene::math::num;
use scene::types::{AlphaMode, Material, Object, Placed, Primitive};

use super::aabb::Aabb;
use super::attributes::SurfacePoint;
use super::emitters::Emitters;
use super::face::margin;
use super::media::Body;
use super::mipmap::Mipmap;
use super::receiver::Receiver;
use super::shades::Shades;
use super::supports::Ground;
use super::surface::Surface;
use super::touching::Touching;
use crate::geometry::bvh::{Bvh, Hit, Ray};

/// One primitive of one placed object.
#[derive(Debug)]
pub struct PlacedPrimitive {
    /// Index of the object.
    pub placed: usize,
    pub(crate) primitive: usize,
    /// Index of the first triangle of the primitive in the BVH.
    pub(crate) first: u32,
    /// Transform of normals to the frame of the scene: columns of the inverse transpose.
    pub(crate) normals: [Vec3; 3],
    /// Transform of tangents to the frame of the scene, by columns.
    pub(crate) tangents: [Vec3; 3],
    pub(crate) mirrored: bool,
    pub(crate) opaque: bool,
    /// True if the primitive lets light pass straight through.
    pub(crate) clear: bool,
    /// Index of the body that the primitive bounds, if light can enter it.
    pub(crate) body: Option<u32>,
}

/// The inserted objects.
#[derive(Debug)]
pub struct Objects {
    /// BVH over all triangles.
    pub bvh: Bvh,
    pub(crate) corners: Vec<[Vec3; 3]>,
    pub(crate) parts: Vec<PlacedPrimitive>,
    placed: Vec<Arc<Placed>>,
    decode: [f32; 256],
    /// Mipmaps of the textures of each placed object.
    mipmaps: Vec<Vec<Mipmap>>,
    pub(crate) opaque: bool,
    /// True if any surface transmits light.
    pub clear: bool,
    /// True if the objects are visible to the camera.
    pub shown: bool,
    /// True if lobes that the materials do not have are evaluated; see [`engine::Context::exhaustive`].
    pub every_lobe: bool,
    /// Bodies of the objects.
    pub(crate) bodies: Vec<Body>,
    /// Bounding box of all bodies. `None` if there are no bodies.
    pub(crate) held: Option<Aabb>,
    /// Emissive surfaces.
    pub emitters: Emitters,
    /// Lampshades around emissive surfaces.
    pub shades: Shades,
    /// Triangles that coincide with the receiver.
    pub touching: Touching,
    /// Supports of the objects.
    pub ground: Ground,
    /// Largest distance by which a flat object was lifted off another; see [`super::sheets`].
    pub(crate) lifted: f32,
    /// Diagonal of the bounding box of an object; the maximum over all objects.
    pub(crate) largest: f32,
}

fn columns(m: DMat3) -> [Vec3; 3] {
    [m.x_axis.as_vec3(), m.y_axis.as_vec3(), m.z_axis.as_vec3()]
}

/// Vertex indices of a triangle. If `mirrored` is true, they are reordered so that the front of the triangle stays
/// on the outside of the object.
fn wound([a, b, c]: [u32; 3], mirrored: bool) -> [u32; 3] {
    if mirrored { [a, c, b] } else { [a, b, c] }
}

impl Objects {
    /// Collects the triangles of the objects relative to `origin`, and lifts flat objects off other objects; see
    /// `super::sheets`.
    pub fn new(
        receiver: Option<&Receiver>,
        placed: &[Arc<Placed>],
        origin: DVec3,
    ) -> Result<Self, NodeError> {
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
            largest: 0.0,
        };
        for (index, one) in placed.iter().enumerate() {
            let first = objects.corners.len();
            objects.add(index, one, origin)?;
            let added = objects.corners[first..].iter().flatten().filter(|p| p.is_finite());
            objects.largest = objects.largest.max(Aabb::around(added).size());
        }
        objects.bvh = Bvh::build(&objects.corners);
        objects.lift_sheets(receiver);
        let shining = objects.placed.iter().flat_map(|one| &one.object.materials).any(Material::shines);
        if shining {
            objects.emitters = objects.find_emitters();
            let around = |triangles: Range<usize>| {
                Aabb::around(objects.corners[triangles].iter().flatten().filter(|p| p.is_finite()))
            };
            let parts = objects.parts_with_triangles();
            objects.shades =
                Shades::of(parts.map(|(part, triangles)| (around(triangles), objects.part(part.first).3)));
        }
        Ok(objects)
    }

    /// Adds the primitives of the placed object `index`.
    fn add(&mut self, index: usize, one: &Placed, origin: DVec3) -> Result<(), NodeError> {
        let matrix = one.world_from_object;
        let linear = DMat3::from_mat4(matrix);
        let mirrored = linear.determinant() < 0.0;
        let size = num::pow(linear.determinant().abs(), 1.0 / 3.0);
        for (number, primitive) in one.object.primitives.iter().enumerate() {
            let material = one.object.materials.get(primitive.material as usize);
            let (Some(material), true) = (material, primitive.is_consistent()) else {
                let what = format!(
                    "primitive {number} of object {index} refers to a material or vertex that does not exist"
                );
                return Err(NodeError::from(Error::Mismatch(what)).at("objects"));
            };
            let opaque = material.alpha_mode == AlphaMode::Opaque;
            self.opaque &= opaque && material.double_sided;
            let clear = material.transmission.factor > 0.0;
            self.clear |= clear;
            let lets_in = clear || material.diffuse_transmission.strength.factor > 0.0;
            let body = material.volume.filter(|_| lets_in).map(|volume| {
                // A scaled object keeps its appearance.
                let absorption = Vec3::from_array(volume) / size as f32;
                let absorption = if absorption.is_finite() { absorption } else { Vec3::ZERO };
                self.body(Body { placed: index, absorption, ior: material.ior })
            });
            let first = self.corners.len();
            self.parts.push(PlacedPrimitive {
                placed: index,
                primitive: number,
                first: first as u32,
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
            self.corners.extend(primitive.triangles.iter().map(|&t| wound(t, mirrored).map(place)));
            if body.is_some() {
                let held = self.corners[first..].iter().flatten().filter(|p| p.is_finite());
                let held = Aabb::around(held).joined(self.held.unwrap_or(Aabb::EMPTY));
                self.held = Some(held).filter(|held| !held.is_empty());
            }
        }
        Ok(())
    }

    /// Returns the index of a body, and adds the body if it is new. Surfaces of one object with the same medium
    /// share a body.
    fn body(&mut self, body: Body) -> u32 {
        let at = self.bodies.iter().position(|known| *known == body).unwrap_or(self.bodies.len());
        if at == self.bodies.len() {
            self.bodies.push(body);
        }
        at as u32
    }

    /// Bounding box of the finite corners of each placed object.
    pub fn boxes(&self) -> Vec<Aabb> {
        let mut boxes = vec![Aabb::EMPTY; self.placed.len()];
        for (part, triangles) in self.parts_with_triangles() {
            let own = Aabb::around(self.corners[triangles].iter().flatten().filter(|p| p.is_finite()));
            boxes[part.placed] = boxes[part.placed].joined(own);
        }
        boxes
    }

    /// Primitives with the ranges of their triangles in the BVH.
    pub(crate) fn parts_with_triangles(&self) -> impl Iterator<Item = (&PlacedPrimitive, Range<usize>)> {
        let ends = self.parts.iter().skip(1).map(|next| next.first as usize).chain([self.corners.len()]);
        self.parts.iter().zip(ends).map(|(part, end)| (part, part.first as usize..end))
    }

    /// Indices of the triangles of a placed object.
    pub(crate) fn triangles_of(&self, placed: usize) -> impl Iterator<Item = u32> {
        let parts = self.parts_with_triangles().filter(move |(part, _)| part.placed == placed);
        parts.flat_map(|(_, triangles)| triangles.start as u32..triangles.end as u32)
    }

    /// The placed objects.
    pub fn placed(&self) -> &[Arc<Placed>] {
        &self.placed
    }

    /// True if no ray can hit an object.
    pub fn is_empty(&self) -> bool {
        self.bvh.bounds().is_none()
    }

    /// The part to which a triangle of the BVH belongs, with its object, primitive and material.
    pub fn part(&self, triangle: u32) -> (&PlacedPrimitive, &Object, &Primitive, &Material) {
        let at = self.parts.partition_point(|part| part.first <= triangle).saturating_sub(1);
        let part = &self.parts[at];
        let object = &*self.placed[part.placed].object;
        let primitive = &object.primitives[part.primitive];
        (part, object, primitive, &object.materials[primitive.material as usize])
    }

    pub(crate) fn point<'a>(&'a self, hit: &'a Hit) -> (&'a PlacedPrimitive, &'a Material, SurfacePoint<'a>) {
        let (part, object, primitive, material) = self.part(hit.triangle);
        let corner = wound(primitive.triangles[(hit.triangle - part.first) as usize], part.mirrored);
        let mipmaps = &self.mipmaps[part.placed];
        (
            part,
            material,
            SurfacePoint { object, primitive, corner, hit, decode: &self.decode, mipmaps, width: 0.0 },
        )
    }

    /// Distance along a ray up to which a hit on the receiver counts as in front of a hit on an object. Where glass
    /// stands on the receiver, the two hits coincide and the receiver counts as in front. Where a flat object lies
    /// on the receiver, the object counts as in front.
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

    /// Hit on another primitive at the same position as `hit`, which a transmitted ray would otherwise miss. The
    /// other primitive may be the table on which a glass stands, or the content of the glass.
    pub fn touching(&self, hit: &Hit, surface: &Surface, direction: Vec3, key: u32) -> Option<Hit> {
        let slant = direction.dot(surface.normal).abs().max(0.01);
        let start = surface.position + surface.normal * surface.margin;
        let ray = Ray { t_max: 2.0 * surface.margin / slant, ..Ray::new(start, direction) };
        let own = self.part(hit.triangle).0.first;
        self.bvh.closest(ray, |hit| self.part(hit.triangle).0.first != own && self.accepts(hit, key, false))
    }

    /// Unit normal of a triangle, by its winding.
    pub fn normal(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners[triangle as usize];
        (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3()
    }
}

#[cfg(test)]
mod tests {
    use super::super::media::Media;
    use super::*;

    /// Front faces stay on the outside under a mirroring transform.
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
        let objects = Objects::new(None, &[placed], DVec3::ZERO).expect("consistent");
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
