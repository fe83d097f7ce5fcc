//! Receiver meshes.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};

/// A triangle mesh with vertex colours: the stand-in for the captured place.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Vertex positions in world units.
    pub positions: Vec<[f32; 3]>,
    /// Linear Rec.709 albedo of each vertex, 0 to 1; empty where the file has no colours.
    pub colours: Vec<[f32; 3]>,
    /// Counter-clockwise triangles of vertex indices, each below the number of vertices.
    pub triangles: Vec<[u32; 3]>,
}

impl Artifact for Mesh {
    const TYPE: &'static str = "mesh";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.f32s(self.positions.as_flattened());
        to.f32s(self.colours.as_flattened());
        to.u32s(self.triangles.as_flattened());
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let mesh = Self {
            positions: triples(from.f32s()?)?,
            colours: triples(from.f32s()?)?,
            triangles: triples(from.u32s()?)?,
        };
        let vertices = mesh.positions.len();
        let colours_fit = mesh.colours.is_empty() || mesh.colours.len() == vertices;
        if !colours_fit || mesh.triangles.as_flattened().iter().any(|&v| v as usize >= vertices) {
            return Err(Corrupt("a mesh that names vertices it does not have".to_owned()));
        }
        Ok(mesh)
    }

    fn bytes(&self) -> usize {
        (self.positions.len() + self.colours.len() + self.triangles.len()) * 12
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        Difference::of(format!(
            "{} vertices and {} triangles against {} and {}",
            self.positions.len(),
            self.triangles.len(),
            other.positions.len(),
            other.triangles.len()
        ))
    }
}

pub(crate) fn triples<T: Copy>(flat: Vec<T>) -> Result<Vec<[T; 3]>, Corrupt> {
    let (whole, rest) = flat.as_chunks::<3>();
    if rest.is_empty() {
        Ok(whole.to_vec())
    } else {
        Err(Corrupt("a count that is no multiple of 3".to_owned()))
    }
}
