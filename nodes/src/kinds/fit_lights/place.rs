//! Receiver mesh for ray casting: its triangles in a tree, and their colours.

use glam::{DVec3, Vec3};
use render::geometry::bvh::{Bvh, Hit, Ray};
use scene::types::Mesh;

/// Channel value above which a colour counts as clipped. Such colours belong to windows, lamps and glints.
pub(super) const CLIPPED: f32 = 0.93;

/// Offset of ray origins from a surface, as a fraction of the diagonal of the mesh, since splats lie slightly below
/// or above it.
const OFFSET: f64 = 0.002;

/// Mesh of a place for ray casting. Positions are relative to the middle of the mesh, in f32.
pub(super) struct PlaceMesh {
    bvh: Bvh,
    /// Corners of each triangle.
    pub corners: Vec<[Vec3; 3]>,
    /// Linear colours of the corners of each triangle; empty if the mesh has no colours.
    colours: Vec<[Vec3; 3]>,
    /// Middle of the mesh in world units.
    middle: DVec3,
    /// Offset of ray origins from a surface, in world units.
    pub offset: f64,
}

/// The result of a ray.
pub(super) enum Seen {
    /// No surface: the sky.
    Sky,
    /// A surface of this linear colour.
    Surface(Vec3),
}

impl PlaceMesh {
    pub fn new(mesh: &Mesh) -> Self {
        let (low, high) = (0..mesh.positions.len() as u32).map(|v| mesh.position(v)).fold(
            (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |(low, high), p| {
                if p.is_finite() { (low.min(p), high.max(p)) } else { (low, high) }
            },
        );
        let middle = if low.is_finite() && high.is_finite() { (low + high) * 0.5 } else { DVec3::ZERO };
        let corners: Vec<[Vec3; 3]> =
            mesh.triangles.iter().map(|t| t.map(|v| (mesh.position(v) - middle).as_vec3())).collect();
        let colours = if mesh.colours.is_empty() {
            Vec::new()
        } else {
            mesh.triangles.iter().map(|t| t.map(|v| Vec3::from(mesh.colours[v as usize]))).collect()
        };
        let bvh = Bvh::build(&corners);
        let diagonal = bvh.bounds().map_or(0.0, |(low, high)| f64::from((high - low).length()));
        Self { bvh, corners, colours, middle, offset: OFFSET * diagonal }
    }

    /// Converts a world position to the frame of the tree.
    pub fn local(&self, position: DVec3) -> DVec3 {
        position - self.middle
    }

    fn hit(&self, from: DVec3, direction: DVec3) -> Option<Hit> {
        self.bvh.closest(Ray::new(from.as_vec3(), direction.as_vec3()), |_| true)
    }

    /// Distance from a local point to the first surface in a direction.
    pub fn distance(&self, from: DVec3, direction: DVec3) -> f64 {
        self.hit(from, direction).map_or(f64::INFINITY, |hit| f64::from(hit.t))
    }

    /// The first hit of a ray from a local point.
    pub fn seen(&self, from: DVec3, direction: DVec3) -> Seen {
        self.hit(from, direction).map_or(Seen::Sky, |hit| Seen::Surface(self.colour(&hit)))
    }

    /// Linear colour at a hit; black if the mesh has no colours.
    fn colour(&self, hit: &Hit) -> Vec3 {
        let Some([a, b, c]) = self.colours.get(hit.triangle as usize) else { return Vec3::ZERO };
        *a * (1.0 - hit.b1 - hit.b2) + *b * hit.b1 + *c * hit.b2
    }

    /// True if distant light from a direction reaches a local point: nothing blocks it, or only surfaces
    /// whose colours are clipped, such as a window.
    pub fn lets_in(&self, from: DVec3, direction: DVec3) -> bool {
        let ray = Ray::new(from.as_vec3(), direction.as_vec3());
        !self.bvh.any(ray, |hit| self.colour(hit).max_element() <= CLIPPED)
    }

    /// Same as [`Self::lets_in`], for light from a distance of `reach`.
    pub fn lets_in_from(&self, from: DVec3, direction: DVec3, reach: f64) -> bool {
        let ray = Ray { t_max: reach as f32, ..Ray::new(from.as_vec3(), direction.as_vec3()) };
        !self.bvh.any(ray, |hit| self.colour(hit).max_element() <= CLIPPED)
    }

    /// Position and unit normal of the first surface in a direction from a local point. The normal is on the side
    /// of the point. `None` if there is no surface.
    pub fn surface(&self, from: DVec3, direction: DVec3) -> Option<(DVec3, DVec3)> {
        let hit = self.hit(from, direction)?;
        let [a, b, c] = self.corners[hit.triangle as usize].map(Vec3::as_dvec3);
        let normal = (b - a).cross(c - a).try_normalize()?;
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        Some((from + direction * f64::from(hit.t), normal))
    }

    /// Same as [`Self::lets_in`], for a world position.
    pub fn is_open(&self, position: DVec3, direction: DVec3) -> bool {
        self.lets_in(self.local(position), direction)
    }

    /// The linear colour at the middle of a triangle; `None` if the mesh has no colours.
    pub fn middle_colour(&self, triangle: usize) -> Option<Vec3> {
        self.colours.get(triangle).map(|[a, b, c]| (*a + *b + *c) / 3.0)
    }
}
