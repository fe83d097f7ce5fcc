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
    pub(super) fn tell(&self, notes: &mut Notes) {
        for (id, count, what) in [
            ("points-and-lines", self.points_and_lines, "primitives of points or lines were left out"),
            (
                "vertices-not-finite",
                self.not_finite,
                "vertices have coordinates that are not finite; their triangles were dropped",
            ),
            (
                "triangles-dropped",
                self.without_area,
                "triangles without area, or with coordinates that are not finite, were dropped",
            ),
            (
                "indices-left-over",
                self.left_over,
                "indices at the end of a list do not make a whole triangle and were ignored",
            ),
            (
                "no-coordinates",
                self.unmapped,
                "primitives have a texture but no texture coordinates; they show the corner of the texture",
            ),
            (
                "coordinates-not-finite",
                self.coordinates,
                "texture coordinates are not finite and were set to 0",
            ),
            (
                "normals-repaired",
                self.normals,
                "normals of length 0 were replaced with normals computed from the adjacent faces",
            ),
            ("colours-clamped", self.colours, "vertex colours outside 0 to 1 were clamped"),
            (
                "tangents-made",
                self.tangents_made,
                "primitives with normal maps or anisotropy had no tangents; they were computed",
            ),
            (
                "tangents-arbitrary",
                self.tangents_arbitrary,
                "vertices have degenerate texture coordinates; their tangents are arbitrary",
            ),
            ("morph-targets", self.morphed, "morph targets were applied with the weights in the file"),
            ("skins", self.skinned, "skinned primitives were posed by the joints in the file"),
            ("instances", self.instances, "copies of meshes were made for EXT_mesh_gpu_instancing"),
            (
                "mirrored",
                self.mirrored,
                "primitives are mirrored by their nodes; the winding of their triangles was reversed",
            ),
        ] {
            notes.count(id, count, what);
        }
    }
}
