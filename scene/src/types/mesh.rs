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
    /// The different glosses of the mesh; empty if the whole mesh is matte.
    pub glosses: Vec<Gloss>,
    /// Gloss of each triangle: 0 for a matte triangle, otherwise its position in `glosses`, counted from 1. Empty if
    /// the whole mesh is matte.
    pub gloss_of: Vec<u32>,
}

/// Specular reflection of a part of a mesh, over the matte reflection of its colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gloss {
    /// Perceptual roughness, 0 (mirror) to 1; its square is the alpha of the GGX distribution.
    pub roughness: f32,
    /// Metalness, 0 (dielectric) to 1 (metal, whose colour is its reflectance).
    pub metallic: f32,
    /// Index of refraction of the dielectric, at least 1; 1 reflects nothing.
    pub ior: f32,
    /// Factor of the reflectance of the dielectric, 0 to 1.
    pub specular: f32,
    /// Unit normal of the reflection in world axes, on either side. 0 for the normals of the triangles.
    pub normal: [f32; 3],
}

impl Gloss {
    /// True if it reflects light.
    pub fn reflects(&self) -> bool {
        self.metallic > 0.0 || (self.specular > 0.0 && self.ior > 1.0)
    }

    /// Numbers in the order of the fields.
    fn numbers(&self) -> [f32; 7] {
        let [x, y, z] = self.normal;
        [self.roughness, self.metallic, self.ior, self.specular, x, y, z]
    }

    fn of_numbers([roughness, metallic, ior, specular, x, y, z]: [f32; 7]) -> Self {
        Self { roughness, metallic, ior, specular, normal: [x, y, z] }
    }
}

impl Mesh {
    /// The gloss of a triangle. `None` if the triangle is matte.
    pub fn gloss(&self, triangle: usize) -> Option<&Gloss> {
        let number = *self.gloss_of.get(triangle)?;
        self.glosses.get((number as usize).checked_sub(1)?)
    }

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
        // Matte meshes have the bytes that they had before there was gloss.
        if !self.gloss_of.is_empty() {
            let numbers: Vec<f32> = self.glosses.iter().flat_map(Gloss::numbers).collect();
            to.f32s(&numbers);
            to.u32s(&self.gloss_of);
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let mut mesh = Self {
            positions: grouped(from.f32s()?)?,
            positions_low: grouped(from.f32s()?)?,
            colours: grouped(from.f32s()?)?,
            triangles: grouped(from.u32s()?)?,
            ..Self::default()
        };
        if from.end().is_err() {
            mesh.glosses = grouped(from.f32s()?)?.into_iter().map(Gloss::of_numbers).collect();
            mesh.gloss_of = from.u32s()?;
            let fit = mesh.gloss_of.len() == mesh.triangles.len();
            if !fit || mesh.gloss_of.iter().any(|&number| number as usize > mesh.glosses.len()) {
                return Err(Corrupt("a triangle refers to a gloss that does not exist".to_owned()));
            }
        }
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
        let gloss = self.glosses.len() * size_of::<Gloss>() + self.gloss_of.len() * 4;
        (vectors.iter().sum::<usize>() + self.triangles.len()) * 12 + gloss
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

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet() -> Mesh {
        Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2], [2, 1, 0]],
            ..Mesh::default()
        }
    }

    fn bytes(mesh: &Mesh) -> Vec<u8> {
        let mut to = Encoder::default();
        mesh.encode(&mut to);
        to.finish()
    }

    /// A glossy mesh is stored with its gloss, and a matte one in the bytes of earlier versions. This test fails if
    /// `encode` writes the lists of gloss in any case, or if `decode` does not compare the numbers with `glosses`.
    #[test]
    fn gloss_is_stored_where_there_is_any() {
        let wet = Gloss { roughness: 0.1, metallic: 0.2, ior: 1.33, specular: 0.5, normal: [0.0, 0.6, 0.8] };
        let glossy = Mesh { glosses: vec![wet], gloss_of: vec![0, 1], ..sheet() };
        for mesh in [&sheet(), &glossy] {
            let stored = bytes(mesh);
            let mut from = Decoder::new(&stored);
            assert_eq!(Mesh::decode(&mut from).as_ref().ok(), Some(mesh));
            assert!(from.end().is_ok());
        }
        // Four lengths of eight bytes, three positions and two triangles.
        assert_eq!(bytes(&sheet()).len(), 4 * 8 + 3 * 12 + 2 * 12);
        assert_eq!((glossy.gloss(0), glossy.gloss(1), sheet().gloss(1)), (None, Some(&wet), None));
        let broken = bytes(&Mesh { gloss_of: vec![0, 2], ..glossy });
        assert!(Mesh::decode(&mut Decoder::new(&broken)).is_err());
    }

    /// This test fails if a metal with `specular` 0, or a dielectric of index 1 with `specular` 1, is treated alike.
    #[test]
    fn a_gloss_reflects_by_its_metal_or_its_interface() {
        let none = Gloss { roughness: 0.0, metallic: 0.0, ior: 1.5, specular: 0.0, normal: [0.0; 3] };
        assert!(!none.reflects() && Gloss { metallic: 0.1, ..none }.reflects());
        assert!(Gloss { specular: 0.1, ..none }.reflects());
        assert!(!Gloss { specular: 1.0, ior: 1.0, ..none }.reflects());
    }
}
