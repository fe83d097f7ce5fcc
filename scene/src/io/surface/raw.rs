//! A mesh as stored in a file.

/// A mesh as stored in a file, with colours that are not yet linear and faces that are not yet checked.
#[derive(Default)]
pub struct RawMesh {
    /// Positions of the vertices, in units of the file.
    pub positions: Vec<[f64; 3]>,
    /// True if the file stores positions as f64.
    pub finer: bool,
    /// Colours of the vertices as stored, from 0 to 1; empty if the file has no colours.
    pub colours: Vec<[f64; 3]>,
    /// Linear factors of the colours (`baseColorFactor` of glTF), one per vertex; empty if all are white.
    pub tints: Vec<[f64; 3]>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Number of faces with more than three corners, which were divided into triangles.
    pub fanned: u64,
    /// True if the file was written by trimesh, which stores display colours even in glTF.
    pub by_trimesh: bool,
}

/// The factor of a colour that is not tinted.
pub const WHITE: [f64; 3] = [1.0; 3];
