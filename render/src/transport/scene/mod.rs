//! The receiver mesh and the objects: geometry, textures, materials, media, and the surfaces that objects rest on.

pub mod aabb;
pub mod attributes;
pub mod block;
pub(crate) mod bodies;
pub(crate) mod coincident;
pub(crate) mod coverage;
pub(crate) mod emission;
pub mod emitters;
pub mod face;
pub mod frame;
pub mod media;
pub mod mipmap;
pub(crate) mod object_surface;
pub mod objects;
pub mod receiver;
pub(crate) mod shades;
pub(crate) mod sheets;
pub(crate) mod subdivide;
pub mod supports;
pub mod surface;
pub mod touching;
