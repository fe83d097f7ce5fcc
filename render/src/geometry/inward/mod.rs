//! Detection of shapes whose faces look inwards, which exporters and mirrored copies produce. If their material is
//! single-sided, they are black from outside; programs that draw both sides show them correctly.
//!
//! Vertices at one place are welded, and faces that touch over edges form patches. Where parts touch each other, or
//! faces have different orientations, patches end. A closed patch with a positive volume looks outwards. For other
//! patches that may look inwards, rays decide (after Takayama, Jacobson, Kavan, Sorkine-Hornung: A Simple Method
//! for Correcting Facet Orientations in Polygon Meshes Based on Ray-Casting, 2014): rays from the front of a patch
//! that is inside out do not leave the object, and rays from its back do. The faces of a cavity are left, since no
//! rays leave from their back.

mod escape;
#[cfg(test)]
mod tests;
mod weld;

use engine::{Context, NodeError, Notes};
use glam::{DVec3, Vec3};
use scene::types::{Material, Primitive};

use crate::geometry::bvh::Bvh;

/// A patch, and the shares of rays that leave from its front and from its back.
type Shares = (u32, [f64; 2]);

/// Score below which an open patch may look inwards.
const DOUBTFUL: f64 = 0.1;
/// Largest share of rays from the front, and smallest share of rays from the back, that leave the object from a
/// patch that is inside out. Rays may slip through cracks.
const TURNED: [f64; 2] = [0.02, 0.1];
/// An open patch that is not turned is reported if the share of rays that leave from its back is larger than from
/// its front by more than this.
const REPORTED: f64 = 0.3;
/// An open patch is reported only if the length of the sum of its area vectors is less than this fraction of its
/// area. For a flat sheet, which has no inside, it is 1.
const OPEN: f64 = 0.75;
/// An open patch is reported only if its share of the area of the object is larger than this.
const VISIBLE: f64 = 0.01;
/// Maximum number of patches that are tested with rays. If there are more, as in foliage, an even selection is
/// tested, and no face is turned.
const TESTED: usize = 1 << 15;

/// A patch of faces.
#[derive(Debug, Clone, Copy)]
struct Patch {
    area: f64,
    middle: DVec3,
    /// Sum of the area vectors of the triangles.
    vector: DVec3,
    /// Sum over triangles of area times the signed distance of the triangle's plane from the middle of the patch,
    /// positive if the triangle faces away from the middle. For a closed patch, three times its volume.
    height: f64,
    /// Sum over triangles of area times distance from the middle of the patch.
    distance: f64,
    single_sided: bool,
    closed: bool,
    /// True if a face of the patch exists in both orientations.
    doubled: bool,
}

impl Patch {
    fn new(closed: bool) -> Self {
        Self {
            area: 0.0,
            middle: DVec3::ZERO,
            vector: DVec3::ZERO,
            height: 0.0,
            distance: 0.0,
            single_sided: true,
            closed,
            doubled: false,
        }
    }

    /// Mean cosine between face normals and the directions from the middle of the patch, weighted by area and
    /// distance. For a sphere it is 1, and for a sphere that is inside out -1.
    fn score(&self) -> f64 {
        if self.distance > 0.0 { self.height / self.distance } else { 0.0 }
    }

    fn balance(&self) -> f64 {
        self.vector.length() / self.area.max(f64::MIN_POSITIVE)
    }

    /// True if rays must decide whether the patch looks inwards.
    fn is_doubtful(&self) -> bool {
        let shape = if self.closed { self.height < 0.0 } else { self.score() < DOUBTFUL };
        shape && self.single_sided && !self.doubled && self.area > 0.0
    }
}

/// The faces of an object, in order of its primitives.
struct Faces {
    corners: Vec<[Vec3; 3]>,
    /// Number of the patch of each face.
    patch: Vec<u32>,
    patches: Vec<Patch>,
}

fn face([a, b, c]: [Vec3; 3]) -> (DVec3, DVec3) {
    let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
    ((b - a).cross(c - a) * 0.5, (a + b + c) / 3.0)
}

impl Faces {
    fn of(primitives: &[Primitive], materials: &[Material], cx: &Context) -> Result<Self, NodeError> {
        let places = weld::places(primitives, cx)?;
        let count = primitives.iter().map(|p| p.triangles.len()).sum();
        let (mut welded, mut corners) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut two_sided = Vec::with_capacity(count);
        let mut start = 0;
        for primitive in primitives {
            let double = materials.get(primitive.material as usize).is_some_and(|m| m.double_sided);
            for triangle in &primitive.triangles {
                welded.push(triangle.map(|v| places[start + v as usize]));
                corners.push(triangle.map(|v| Vec3::from(primitive.positions[v as usize])));
                two_sided.push(double);
            }
            start += primitive.positions.len();
        }
        drop(places);
        let found = weld::patches(&welded, cx)?;
        let mut patches: Vec<Patch> = found.closed.iter().map(|closed| Patch::new(*closed)).collect();
        for ((at, corners), two_sided) in found.of_face.iter().zip(&corners).zip(&two_sided) {
            let (vector, centre) = face(*corners);
            let patch = &mut patches[*at as usize];
            patch.area += vector.length();
            patch.middle += centre * vector.length();
            patch.vector += vector;
            patch.single_sided &= !two_sided;
        }
        patches.iter_mut().for_each(|patch| patch.middle /= patch.area.max(f64::MIN_POSITIVE));
        for (at, corners) in found.of_face.iter().zip(&corners) {
            let (vector, centre) = face(*corners);
            let patch = &mut patches[*at as usize];
            patch.height += vector.dot(centre - patch.middle);
            patch.distance += vector.length() * (centre - patch.middle).length();
        }
        if patches.iter().any(|patch| !patch.closed && patch.is_doubtful()) {
            for (at, _) in
                found.of_face.iter().zip(weld::has_reverse(&welded)).filter(|(_, doubled)| *doubled)
            {
                patches[*at as usize].doubled = true;
            }
        }
        Ok(Self { corners, patch: found.of_face, patches })
    }

    /// The shares of rays that leave from the front and the back of each doubtful patch, and whether all doubtful
    /// patches were tested.
    fn tested(&self, size: f64, cx: &Context) -> Result<(Vec<Shares>, bool), NodeError> {
        let patches = self.patches.iter().enumerate().filter(|(_, patch)| patch.is_doubtful());
        let doubtful: Vec<u32> = patches.map(|(number, _)| number as u32).collect();
        if doubtful.is_empty() {
            return Ok((Vec::new(), true));
        }
        let step = doubtful.len().div_ceil(TESTED);
        let chosen: Vec<u32> = doubtful.iter().step_by(step).copied().collect();
        let bvh = Bvh::build_in(&self.corners, cx)?;
        let mut order: Vec<u32> = (0..self.corners.len() as u32).collect();
        // Stable: faces of a patch stay in order.
        order.sort_by_key(|face| self.patch[*face as usize]);
        let shares = cx.for_each_tile(chosen.len(), |index| {
            let number = chosen[index];
            let first = order.partition_point(|face| self.patch[*face as usize] < number);
            let end = order.partition_point(|face| self.patch[*face as usize] <= number);
            escape::shares(&bvh, &self.corners, &order[first..end], (number, size))
        })?;
        Ok((chosen.into_iter().zip(shares).collect(), step == 1))
    }
}

/// Reverses the faces of single-sided patches that look inwards, and reports patches that may look inwards.
pub fn turn(
    primitives: &mut [Primitive],
    materials: &[Material],
    cx: &Context,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    let faces = Faces::of(primitives, materials, cx)?;
    let (tested, complete) = faces.tested(weld::extent(primitives).0, cx)?;
    let inside_out = |[front, back]: [f64; 2]| front <= TURNED[0] && back >= TURNED[1];
    let all: f64 = faces.patches.iter().map(|patch| patch.area).sum();
    let seems = |number: u32, [front, back]: [f64; 2]| {
        let patch = &faces.patches[number as usize];
        back - front > REPORTED && patch.balance() < OPEN && patch.area > VISIBLE * all
    };
    let mut turned = vec![false; faces.patches.len()];
    let (mut found, mut doubtful) = (0_usize, 0_usize);
    for (number, shares) in &tested {
        if inside_out(*shares) {
            found += 1;
            turned[*number as usize] = complete;
        } else if seems(*number, *shares) {
            doubtful += 1;
        }
    }
    if !complete {
        // Single leaves may look inwards; most of the faces do not.
        doubtful += if 2 * found > tested.len() { found } else { 0 };
        found = 0;
    }
    if doubtful > 0 {
        let text = format!(
            "the faces of parts that are not closed surfaces seem to point inwards (parts: {doubtful}): their material is \
             single-sided, so the faces are invisible from behind, and the object may look black or hollow; reverse the \
             faces in the program that made them, or make the material double-sided"
        );
        notes.warning("faces-inwards", text);
    }
    if found == 0 {
        return Ok(());
    }
    let text = format!("faces that pointed into the object were reversed (parts: {found})");
    notes.decision("faces-turned", text);
    let mut first = 0;
    for primitive in primitives {
        let count = primitive.triangles.len();
        let of_patches = &faces.patch[first..first + count];
        reverse(primitive, |at| turned[of_patches[at] as usize]);
        first += count;
    }
    Ok(())
}

/// Reverses some faces of a primitive, and the normals that agreed with them.
fn reverse(primitive: &mut Primitive, turned: impl Fn(usize) -> bool) {
    let mut facing = vec![0.0_f64; primitive.positions.len()];
    for at in 0..primitive.triangles.len() {
        let triangle = primitive.triangles[at];
        if !turned(at) {
            continue;
        }
        primitive.triangles[at] = [triangle[0], triangle[2], triangle[1]];
        let corners = primitive.triangles[at].map(|v| Vec3::from(primitive.positions[v as usize]));
        let (vector, _) = face(corners);
        for vertex in triangle.map(|v| v as usize) {
            let normal = primitive.normals.get(vertex).map_or(DVec3::ZERO, |n| DVec3::from(n.map(f64::from)));
            facing[vertex] += vector.dot(normal);
        }
    }
    // Normals that agreed with the faces are turned with them; others looked outwards already.
    for (vertex, _) in facing.iter().enumerate().filter(|(_, facing)| **facing < 0.0) {
        if let Some(normal) = primitive.normals.get_mut(vertex) {
            *normal = normal.map(|v| -v);
        }
        if let Some([.., sign]) = primitive.tangents.get_mut(vertex) {
            *sign = -*sign;
        }
    }
}
