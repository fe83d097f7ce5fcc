//! Geometry: rays against triangles, what objects rest on, sampling of directions, and summaries of scenes.

pub mod bvh;
pub mod inspect;
pub mod level;
pub mod resting;
pub mod sampling;
pub mod support;
