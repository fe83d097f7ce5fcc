//! Meshes for the place view.

use glam::DVec3;

/// A mesh of triangles, merged from the parts of a value.
#[derive(Default)]
pub struct Surface {
    /// Positions of the vertices.
    pub positions: Vec<DVec3>,
    /// Unit normals; empty if they follow from the triangles.
    pub normals: Vec<DVec3>,
    /// Colours, sRGB.
    pub colours: Vec<[u8; 4]>,
    /// Indices of the corners.
    pub triangles: Vec<[u32; 3]>,
}
