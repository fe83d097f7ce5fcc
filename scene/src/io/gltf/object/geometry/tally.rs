//! Counts of dropped and repaired parts of shapes, for notes.

use engine::Notes;

/// Counts of dropped and repaired parts.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) points_and_lines: u64,
    pub(super) not_finite: u64,
    pub(super) without_area: u64,
    pub(super) left_over: u64,
    pub(super) unmapped: u64,
    pub(super) coordinates: u64,
    pub(super) normals: u64,
    pub(super) colours: u64,
    pub(super) tangents_made: u64,
    pub(super) tangents_arbitrary: u64,
    pub(super) morphed: u64,
    pub(super) skinned: u64,
    pub(super) mirrored: u64,
    pub(super) instances: u64,
}

impl Tally {
    /// Adds notes about the counts.
    pub(super) fn report(&self, notes: &mut Notes) {
        for (id, count, what) in [
            (
                "points-and-lines",
                self.points_and_lines,
                "of the primitives contained points or lines instead of triangles, and had to be left out",
            ),
            (
                "vertices-not-finite",
                self.not_finite,
                "of the vertices had coordinates that are not finite; triangles with such vertices were dropped",
            ),
            (
                "triangles-dropped",
                self.without_area,
                "of the triangles had to be dropped because of zero area or coordinates that are not finite",
            ),
            (
                "indices-left-over",
                self.left_over,
                "of the indices did not belong to a complete triangle, and had to be ignored",
            ),
            (
                "no-coordinates",
                self.unmapped,
                "of the primitives had a texture but no texture coordinates, so the colour of the texture at (0, 0) is used",
            ),
            (
                "coordinates-not-finite",
                self.coordinates,
                "of the texture coordinates had a value that is not finite, which was replaced with 0",
            ),
            (
                "normals-repaired",
                self.normals,
                "of the normals had length 0, and had to be computed from the adjacent faces",
            ),
            ("colours-clamped", self.colours, "of the vertex colours had to be clamped to the range 0 to 1"),
            (
                "tangents-made",
                self.tangents_made,
                "of the primitives had no tangents for a normal map or for anisotropy; the tangents were computed",
            ),
            (
                "tangents-arbitrary",
                self.tangents_arbitrary,
                "of the vertices had degenerate texture coordinates and received an arbitrary tangent",
            ),
            (
                "morph-targets",
                self.morphed,
                "of the morph targets had a weight other than 0 in the file, which was applied",
            ),
            (
                "skins",
                self.skinned,
                "of the primitives had a skin, which received the pose of the joints in the file",
            ),
            ("instances", self.instances, "of the mesh copies came from EXT_mesh_gpu_instancing"),
            (
                "mirrored",
                self.mirrored,
                "of the primitives had a mirroring transform, so the winding of their triangles was reversed",
            ),
        ] {
            notes.count(id, count, what);
        }
    }
}
