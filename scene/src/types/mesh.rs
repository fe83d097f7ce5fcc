//! Meshes of the captured scene, which receive the shadows of objects.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use glam::DVec3;

/// A triangle mesh with vertex colours: the proxy of the captured scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Vertex positions in world units.
    pub positions: Vec<[f32; 3]>,
    /// Remainder of each position that f32 cannot hold, to be added in f64; empty if the file stores f32. Needed
    /// for meshes far from the origin, such as those in survey coordinates.
    pub positions_low: Vec<[f32; 3]>,
    /// Linear Rec.709 albedo of each vertex, 0 to 1; empty if the file has no colours.
    pub colours: Vec<[f32; 3]>,
    /// Counter-clockwise triangles of vertex indices, each below the number of vertices.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The position of a vertex, which must exist.
    #[inline]
    pub fn position(&self, index: u32) -> DVec3 {
        let high = DVec3::from(self.positions[index as usize].map(f64::from));
        match self.positions_low.get(index as usize) {
            Some(low) => high + DVec3::from(low.map(f64::from)),
            None => high,
        }
    }
}

impl Artifact for Mesh {
    const TYPE: &'static str = "mesh";
    const FORMAT: u32 = 2;

    fn encode(&self, to: &mut Encoder) {
        to.f32s(self.positions.as_flattened());
        to.f32s(self.positions_low.as_flattened());
        to.f32s(self.colours.as_flattened());
        to.u32s(self.triangles.as_flattened());
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let mesh = Self {
            positions: grouped(from.f32s()?)?,
            positions_low: grouped(from.f32s()?)?,
            colours: grouped(from.f32s()?)?,
            triangles: grouped(from.u32s()?)?,
        };
        let vertices = mesh.positions.len();
        let fit = |len: usize| len == 0 || len == vertices;
        let all_fit = fit(mesh.colours.len()) && fit(mesh.positions_low.len());
        if !all_fit || mesh.triangles.as_flattened().iter().any(|&v| v as usize >= vertices) {
            return Err(Corrupt("a triangle refers to a vertex that does not exist".to_owned()));
        }
        Ok(mesh)
    }

    fn bytes(&self) -> usize {
        let vectors = [&self.positions, &self.positions_low, &self.colours].map(Vec::len);
        (vectors.iter().sum::<usize>() + self.triangles.len()) * 12
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        Difference::of(format!(
            "the meshes differ (vertices and triangles of one: {} and {}; of the other: {} and {})",
            self.positions.len(),
            self.triangles.len(),
            other.positions.len(),
            other.triangles.len()
        ))
    }
}

/// Splits numbers into groups of `N`. Returns an error if their count is not a multiple of `N`.
pub fn grouped<T: Copy, const N: usize>(flat: Vec<T>) -> Result<Vec<[T; N]>, Corrupt> {
    let (whole, rest) = flat.as_chunks::<N>();
    if rest.is_empty() {
        Ok(whole.to_vec())
    } else {
        Err(Corrupt(format!("the number of values in a list is not a multiple of {N}")))
    }
}
