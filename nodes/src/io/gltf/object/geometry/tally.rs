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
                "vertices are not finite numbers; their triangles were dropped",
            ),
            (
                "triangles-dropped",
                self.without_area,
                "triangles without area or with such vertices were dropped",
            ),
            ("indices-left-over", self.left_over, "indices at the end make no whole triangle"),
            (
                "no-coordinates",
                self.unmapped,
                "primitives have a texture but no texture coordinates; they show its corner",
            ),
            (
                "coordinates-not-finite",
                self.coordinates,
                "texture coordinates are not finite and were set to 0",
            ),
            ("normals-repaired", self.normals, "normals of length 0 were computed from the adjacent faces"),
            ("colours-clamped", self.colours, "vertex colours outside of 0 to 1 were clamped"),
            (
                "tangents-made",
                self.tangents_made,
                "primitives with normal maps or anisotropy had no tangents; they were computed",
            ),
            (
                "tangents-arbitrary",
                self.tangents_arbitrary,
                "vertices have texture coordinates without direction",
            ),
            ("morph-targets", self.morphed, "morph targets were applied at the weights of the file"),
            ("skins", self.skinned, "skinned primitives were posed by the joints of the file"),
            ("instances", self.instances, "copies of meshes by EXT_mesh_gpu_instancing"),
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
