//! A mesh as stored in a file.

/// A mesh as stored in a file, with colours that are not yet linear and faces that are not yet checked.
#[derive(Default)]
pub(super) struct RawMesh {
    pub(super) positions: Vec<[f64; 3]>,
    /// True if the file stores positions as f64.
    pub(super) finer: bool,
    pub(super) colours: Vec<[f64; 3]>,
    /// Linear factors of the colours (`baseColorFactor` of glTF), one per vertex; empty if all are white.
    pub(super) tints: Vec<[f64; 3]>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) fanned: u64,
    /// True if the file was written by trimesh, which stores display colours even in glTF.
    pub(super) by_trimesh: bool,
}

pub(super) const WHITE: [f64; 3] = [1.0; 3];
