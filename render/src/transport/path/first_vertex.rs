//! First vertices of paths on the receiver alone, under near light.
//!
//! Without objects, the light samples and the scattered ray of the first vertex of a path depend on the receiver
//! and the sky alone. A path with the objects uses the same random numbers, so the same rays would find the same
//! surfaces, unless an object is hit first. They are therefore traced once for both paths. Light samples that
//! bring no light without objects bring none with them, so the objects are not tested for these.

use glam::Vec3;

use super::near_draws::{MOST, NearSamples};
use super::near_field::ArrivingLight;
use crate::geometry::bvh::Hit;

/// Results of the rays of the first vertex of a path on the receiver alone.
#[derive(Debug, Clone, Copy)]
pub struct FirstVertex {
    /// Light samples.
    pub(crate) arriving: NearSamples,
    /// Light that the vertex reflects from each light sample.
    pub(crate) lit: [Vec3; MOST],
    /// Hit of the scattered ray on the receiver.
    pub(crate) landed: Option<Hit>,
    /// Light along the scattered ray. `None` if the path goes on, or if no ray is scattered.
    pub(crate) found: Option<ArrivingLight>,
    /// Radiance of the whole path. `None` if the path goes on and was not traced to its end.
    pub light: Option<Vec3>,
}
