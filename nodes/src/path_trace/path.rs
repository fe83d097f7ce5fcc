//! Where a path is and how it came there.

use glam::Vec3;

use super::media::Media;
use crate::bvh::Hit;

/// Where a path is.
#[derive(Debug, Clone, Copy)]
pub enum Vertex {
    /// On the receiver.
    Receiver(Hit),
    /// On an object, met by a camera ray or a specular one.
    Object(Hit),
    /// On an object, met by a ray of a matte surface, which goes straight on where anything passes it.
    Straight(Hit),
}

impl Vertex {
    /// Length of the ray that found it.
    pub(super) fn distance(&self) -> f32 {
        match self {
            Self::Receiver(hit) | Self::Object(hit) | Self::Straight(hit) => hit.t,
        }
    }

    /// Where it is on an object.
    pub(super) fn on_object(&self) -> Option<&Hit> {
        match self {
            Self::Receiver(_) => None,
            Self::Object(hit) | Self::Straight(hit) => Some(hit),
        }
    }
}

/// How a path came to a vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathState {
    /// Unit direction of the ray that found the vertex.
    pub direction: Vec3,
    /// How often light was scattered before.
    pub bounce: u32,
    /// Throughput (beta): what of the light from the vertex comes to the eye.
    pub throughput: Vec3,
    /// The share of the throughput that it has beside rays which find the same, so that it does not end the path.
    pub share: f32,
    /// Weight of what the vertex emits, beside light samples of the one before.
    pub mis_weight: f32,
    /// What the ray was in at the vertex.
    pub media: Media,
}
