//! Receiver: the mesh of the captured place.

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use scene::types::{Gloss, Mesh};

use super::face::Face;
use super::subdivide::{Corner, Extent, Subdivision};
use super::surface::Surface;
use crate::geometry::bvh::{Bvh, Hit, each};
use crate::transport::bsdf::{Bsdf, BsdfParams};

/// Albedo of a receiver without vertex colours.
pub const GREY: f32 = 0.5;
/// Minimum albedo of a receiver, per channel. No surface of a real scene is darker, and on a black surface the
/// ratio S is undefined. Captured meshes have black vertices where no photograph shows the surface, and saturated
/// colours with a channel of 0. With such an albedo, the shadow or one of its channels would be lost.
pub const DARKEST: f32 = 0.01;

/// Number of triangles that one job prepares.
const PIECE: usize = 1 << 16;

/// Triangles after subdivision.
#[derive(Default)]
struct Cut {
    corners: Vec<[Vec3; 3]>,
    colours: Vec<[Vec3; 3]>,
    /// Gloss of each piece, as in [`Mesh::gloss_of`].
    gloss_of: Vec<u32>,
    /// Number of cuts that are left until the limit is reached.
    left: usize,
}

/// The mesh of the captured place.
#[derive(Debug, Default)]
pub struct Receiver {
    /// BVH over its triangles.
    pub bvh: Bvh,
    faces: Vec<Face>,
    colours: Vec<[Vec3; 3]>,
    glosses: Vec<Gloss>,
    /// Gloss of each triangle, as in [`Mesh::gloss_of`]; empty if the whole receiver is matte.
    gloss_of: Vec<u32>,
    /// Number of vertex colours outside [0, 1] or not finite, which were clamped.
    pub clamped: u64,
    /// Number of vertex colours with a channel below [`DARKEST`]. Such channels were raised to this value.
    pub raised: u64,
}

impl Receiver {
    /// Collects the triangles of a mesh relative to `origin`. Large triangles near the origin are subdivided;
    /// see `subdivide`.
    pub fn new(mesh: &Mesh, origin: DVec3) -> Self {
        // Without a context nothing can fail.
        Self::made(mesh, origin, None).unwrap_or_default()
    }

    /// Makes the same receiver as [`new`](Self::new), on the threads of a node.
    ///
    /// # Errors
    /// If the run is cancelled.
    pub fn new_in(mesh: &Mesh, origin: DVec3, cx: &Context) -> Result<Self, NodeError> {
        Self::made(mesh, origin, Some(cx))
    }

    fn made(mesh: &Mesh, origin: DVec3, cx: Option<&Context>) -> Result<Self, NodeError> {
        let place = |i: u32| mesh.position(i) - origin;
        let (mut clamped, mut raised) = (0, 0);
        let albedos: Vec<Vec3> = mesh
            .colours
            .iter()
            .map(|colour| {
                // An albedo above 1 would create light; NaN fails the comparison and becomes 0.
                let good = colour.map(|v| if v > 0.0 { v.min(1.0) } else { 0.0 });
                clamped += u64::from(good != *colour);
                raised += u64::from(good.iter().any(|&v| v < DARKEST));
                Vec3::from_array(good).max(Vec3::splat(DARKEST))
            })
            .collect();
        let pieces: Vec<&[[u32; 3]]> = mesh.triangles.chunks(PIECE).collect();
        let extents =
            each(cx, pieces.len(), |i| Extent::of(pieces[i].iter().map(|triangle| triangle.map(place))))?;
        let none = Extent::of(std::iter::empty());
        let mut rule = Subdivision::of(extents.into_iter().fold(none, Extent::with));
        let cut = |rule: &mut Subdivision, first: usize, triangles: &[[u32; 3]]| {
            let mut cut = Cut { corners: Vec::with_capacity(triangles.len()), ..Cut::default() };
            for (number, triangle) in (first..).zip(triangles) {
                let gloss = mesh.gloss_of.get(number);
                let albedo = |i: u32| albedos.get(i as usize).copied().unwrap_or_default();
                rule.cut(triangle.map(|i| (place(i), albedo(i))), |piece: [Corner; 3]| {
                    cut.corners.push(piece.map(|(p, _)| p.as_vec3()));
                    cut.gloss_of.extend(gloss);
                    if !albedos.is_empty() {
                        cut.colours.push(piece.map(|(_, colour)| colour));
                    }
                });
            }
            Cut { left: rule.room(), ..cut }
        };
        let mut parts = each(cx, pieces.len(), |i| cut(&mut rule.clone(), i * PIECE, pieces[i]))?;
        let cuts = parts.iter().fold(0, |sum: usize, part| sum.saturating_add(rule.room() - part.left));
        if cuts >= rule.room() {
            // The limit is reached. It applies to the triangles in their order, so they are subdivided one after
            // the other.
            parts = vec![cut(&mut rule, 0, &mesh.triangles)];
        }
        let (mut corners, mut colours, mut gloss_of) = (Vec::new(), Vec::new(), Vec::new());
        corners.reserve_exact(parts.iter().map(|part| part.corners.len()).sum());
        colours.reserve_exact(parts.iter().map(|part| part.colours.len()).sum());
        for part in parts {
            corners.extend(part.corners);
            colours.extend(part.colours);
            gloss_of.extend(part.gloss_of);
        }
        // A mesh of which no triangle is glossy is traced as a matte one.
        if gloss_of.iter().all(|&number| number == 0) {
            gloss_of.clear();
        }
        let bvh = match cx {
            Some(cx) => Bvh::build_in(&corners, cx)?,
            None => Bvh::build(&corners),
        };
        let pieces: Vec<&[[Vec3; 3]]> = corners.chunks(PIECE).collect();
        let faces = each(cx, pieces.len(), |i| pieces[i].iter().copied().map(Face::new).collect::<Vec<_>>())?
            .concat();
        Ok(Self { bvh, faces, colours, glosses: mesh.glosses.clone(), gloss_of, clamped, raised })
    }

    /// Memory use in bytes.
    pub fn bytes(&self) -> u64 {
        let gloss = size_of_val(&*self.gloss_of);
        self.bvh.bytes() + (size_of_val(&*self.faces) + size_of_val(&*self.colours) + gloss) as u64
    }

    /// True if a part of the receiver is glossy. Estimates that hold for matte surfaces only are then not used.
    #[inline]
    pub fn is_glossy(&self) -> bool {
        !self.gloss_of.is_empty()
    }

    /// Gloss of a triangle. `None` if it is matte.
    #[inline]
    pub(crate) fn gloss(&self, triangle: u32) -> Option<&Gloss> {
        let number = *self.gloss_of.get(triangle as usize)?;
        self.glosses.get((number as usize).checked_sub(1)?)
    }

    /// Largest albedo of any point, per channel.
    pub fn albedo(&self) -> Vec3 {
        let most = self.colours.iter().flatten().copied().reduce(Vec3::max);
        most.unwrap_or(if self.faces.is_empty() { Vec3::ZERO } else { Vec3::splat(GREY) })
    }

    /// Largest ray offset of all triangles that overlap a box.
    pub fn margin_within(&self, low: Vec3, high: Vec3) -> f32 {
        let reaches = |face: &&Face| {
            let [a, b, c] = face.corners;
            a.min(b).min(c).cmple(high).all() && a.max(b).max(c).cmpge(low).all()
        };
        self.faces.iter().filter(reaches).map(|face| face.margin).fold(0.0, f32::max)
    }

    /// Unit normal of a triangle, by its winding.
    #[inline]
    pub fn normal(&self, triangle: u32) -> Vec3 {
        self.faces[triangle as usize].normal
    }

    /// Unit normal at a hit, on the side of the ray.
    #[inline]
    pub fn facing(&self, hit: &Hit) -> Vec3 {
        let normal = self.normal(hit.triangle);
        if hit.back { -normal } else { normal }
    }

    /// Albedo at a hit.
    #[inline]
    pub fn albedo_at(&self, hit: &Hit) -> Vec3 {
        match self.colours.get(hit.triangle as usize) {
            Some([a, b, c]) => *a * (1.0 - hit.b1 - hit.b2) + *b * hit.b1 + *c * hit.b2,
            None => Vec3::splat(GREY),
        }
    }

    /// Origin of rays that leave a hit, on the visible side.
    #[inline]
    pub fn start(&self, hit: &Hit) -> Vec3 {
        let face = &self.faces[hit.triangle as usize];
        face.at(hit) + self.facing(hit) * face.margin
    }

    /// Position, unit normal on the side of the ray, and offset of rays, at a hit.
    #[inline]
    pub fn geometry(&self, hit: &Hit) -> (Vec3, Vec3, f32) {
        let face = &self.faces[hit.triangle as usize];
        (face.at(hit), self.facing(hit), face.margin)
    }

    /// Parameters of the BSDF of a glossy point.
    fn params(&self, gloss: &Gloss, hit: &Hit) -> BsdfParams {
        BsdfParams {
            base: self.albedo_at(hit),
            metallic: gloss.metallic,
            roughness: gloss.roughness,
            ior: gloss.ior,
            specular: (gloss.specular, Vec3::ONE),
            ..BsdfParams::default()
        }
    }

    /// Surface at a hit, on the side of the ray, outside all bodies. `out` is the unit direction to the viewer.
    #[inline]
    pub fn surface(&self, hit: &Hit, out: Vec3) -> Surface {
        let face = &self.faces[hit.triangle as usize];
        let normal = self.facing(hit);
        let bsdf = match self.gloss(hit.triangle) {
            None => Bsdf::matte(normal, self.albedo_at(hit)),
            Some(gloss) => Bsdf::glossy(normal, &self.params(gloss, hit), (gloss.normal.into(), out)),
        };
        Surface {
            position: face.at(hit),
            normal,
            margin: face.margin,
            bsdf,
            emission: Vec3::ZERO,
            media: Default::default(),
            cover: None,
            bed: None,
            lift: Vec3::ZERO,
        }
    }
}
