//! First vertices of paths on the receiver alone, under near light.
//!
//! Without objects, the light samples and the scattered ray of the first vertex of a path depend on the receiver
//! and the sky alone. A path with the objects uses the same random numbers, so the same rays would find the same
//! surfaces, unless an object is hit first. They are therefore traced once for both paths.

use glam::Vec3;

use super::near_draws::NearSamples;
use super::near_field::ArrivingLight;
use crate::geometry::bvh::Hit;

/// What the rays of the first vertex of a path on the receiver alone find.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FirstVertex {
    /// Light samples.
    pub(crate) arriving: NearSamples,
    /// Hit of the scattered ray on the receiver.
    pub(crate) landed: Option<Hit>,
    /// Light along the scattered ray. `None` if the path goes on, or if no ray is scattered.
    pub(crate) found: Option<ArrivingLight>,
    /// Radiance of the whole path. `None` if it was not traced.
    pub(crate) light: Option<Vec3>,
}
