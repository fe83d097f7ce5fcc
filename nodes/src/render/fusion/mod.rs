//! Surface of a scene from its splats: depth images from many views are fused into distances in cells, and
//! the zero of these distances becomes triangles.

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
