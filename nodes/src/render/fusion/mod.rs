//! The surface of a scene from its splats: depths that many views see, fused into distances in cells, and their zero as
//! triangles.

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
