//! The compared place, and the limits that several steps of the comparison use.

use glam::{DMat4, DVec3};
use scene::types::frame::Similarity;
use scene::types::{Camera, Mesh, Splats};

/// Maximum number of objects whose surroundings are rendered and compared.
pub(super) const AROUND: usize = 2;
/// Minimum agreement at which the mesh counts as being in the frame of the splats, so that no better transform is
/// searched for.
pub(super) const AGREES: f64 = 0.8;
/// Minimum agreement of the surfaces (see [`surfaces`](super::surfaces)) at which the mesh counts as being in the
/// frame of the splats.
pub(super) const IN_PLACE: f64 = 0.85;
/// Minimum agreement of the surfaces with a transformed mesh for the transform to be reported.
pub(super) const FOUND: f64 = 0.8;
/// Minimum agreement of the depths with a transformed mesh for the transform to be reported, if the agreement of
/// the surfaces gives no transform.
pub(super) const FOUND_BY_VIEWS: f64 = 0.75;
/// Minimum share of the points at which the mesh must be visible for the agreement at these points alone to be
/// considered.
pub(super) const PART: f64 = 0.02;
/// Minimum agreement, at the points where the mesh is visible, at which a mesh that covers only a part of the place
/// counts as being in the frame of the splats.
pub(super) const PART_AGREES: f64 = 0.9;
/// Minimum cosine of the angle between the up direction of the scene and the up direction estimated from the splats
/// or from the mesh, for these splats or this mesh to count as upright.
pub(super) const UPRIGHT: f64 = 0.94;
/// Minimum share of the pixels of a view that debris must cover to be reported. In captures whose meshes are right, it
/// covers less than 0.0005.
pub(super) const DEBRIS: f64 = 0.0025;
/// Minimum share of the pixels of a view that missing surfaces must cover to be reported.
pub(super) const MISSING: f64 = 0.03;
/// Half of the minimum distance between splats and mesh for a part of the mesh to count as debris, or for a surface
/// of the splats to count as missing. It is a share of the distance from the eye.
pub(super) const TOLERANCE: f64 = 0.05;

/// Place whose splats and mesh are compared.
#[derive(Debug, Clone, Copy)]
pub struct CapturedPlace<'a> {
    /// The splats, in the world.
    pub splats: &'a Splats,
    /// The mesh, in the world.
    pub mesh: &'a Mesh,
    /// Cameras of the wanted views; the views of the first, the middle and the last one are compared.
    pub cameras: &'a [Camera],
    /// Middles of the inserted objects. The first two are used.
    pub around: &'a [DVec3],
    /// Unit vectors to the right, forward and up.
    pub axes: [DVec3; 3],
    /// World units per metre.
    pub metre: f64,
}

/// A similarity as a matrix.
pub(super) fn matrix(by: &Similarity) -> DMat4 {
    DMat4::from_cols_array(&by.rows()).transpose()
}
