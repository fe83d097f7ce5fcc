//! Geometry: ray casting, objects resting on surfaces, sampling of directions, and summaries of scenes.

pub mod bvh;
pub mod inspect;
pub mod resting;
pub mod sampling;
pub mod support;
