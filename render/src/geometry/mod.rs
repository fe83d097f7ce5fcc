//! Geometry: ray casting, objects resting on surfaces, sampling, and summaries of scenes.

pub mod before_object;
pub mod bvh;
pub mod inspect;
pub mod inward;
pub mod level;
pub mod resting;
pub mod sampling;
pub mod support;
