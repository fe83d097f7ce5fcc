//! A mesh as stored in a file.

/// A mesh as stored in a file, with colours that are not yet linear and faces that are not yet checked.
#[derive(Default)]
pub struct RawMesh {
    pub positions: Vec<[f64; 3]>,
    /// True if the file stores positions as f64.
    pub finer: bool,
    pub colours: Vec<[f64; 3]>,
    /// Linear factors of the colours (`baseColorFactor` of glTF), one per vertex; empty if all are white.
    pub tints: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub fanned: u64,
    /// True if the file was written by trimesh, which stores display colours even in glTF.
    pub by_trimesh: bool,
}

pub const WHITE: [f64; 3] = [1.0; 3];
