//! Surface of a scene from its splats. Depth images from many views are fused into distances to the surface at the
//! corners of cells, and the surface where these distances are 0 is converted to triangles.

pub mod cubes;
pub mod depth_view;
pub mod field;
pub mod fit;
mod flatten;
pub mod levels;
pub mod pieces;
pub mod places;
pub mod simplify;
pub mod surface;
pub mod tint;
