//! Where a path is and how it came there.

use glam::Vec3;

use crate::geometry::bvh::Hit;
use crate::geometry::sampling::hash;
use crate::render::transport::scene::media::Media;
use crate::render::transport::scene::surface::Surface;

/// Pairs of dimensions used by one vertex of a path: light, direction, choice of lobe, survival.
const PAIRS: u32 = 4;

/// First of the pairs of dimensions of a vertex, after some bounces; those before belong to the camera.
pub(crate) const fn first_pair(bounce: u32) -> u32 {
    1 + bounce * PAIRS
}

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
    pub(crate) fn distance(&self) -> f32 {
        match self {
            Self::Receiver(hit) | Self::Object(hit) | Self::Straight(hit) => hit.t,
        }
    }

    /// Where it is on an object.
    pub(crate) fn on_object(&self) -> Option<&Hit> {
        match self {
            Self::Receiver(_) => None,
            Self::Object(hit) | Self::Straight(hit) => Some(hit),
        }
    }
}

/// How a path came to a vertex.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathState {
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

/// A path on its way, and the light that it has found.
#[derive(Debug)]
pub(crate) struct Path {
    /// Where it is.
    pub vertex: Vertex,
    /// How it came there.
    pub state: PathState,
    /// Width of the ray at the vertex.
    pub width: f32,
    /// How fast that grows, for each unit of length.
    pub spread: f32,
    /// Whether the vertex is in the place of the one before.
    pub touches: bool,
    /// Radiance so far.
    pub light: Vec3,
}

/// A vertex of a path as light is gathered at it.
#[derive(Debug)]
pub(crate) struct ShadingPoint {
    /// Its surface.
    pub surface: Surface,
    /// How often light was scattered before.
    pub bounce: u32,
    /// First of its pairs of dimensions.
    pub pair: u32,
    /// What its chances go by.
    pub key: u32,
}

impl ShadingPoint {
    /// A surface after some bounces of the path of a key.
    pub fn new(surface: Surface, bounce: u32, path: u32) -> Self {
        let pair = first_pair(bounce);
        Self { surface, bounce, pair, key: hash(path, pair) }
    }

    /// Whether it is what the camera sees.
    pub fn is_first(&self) -> bool {
        self.bounce == 0
    }
}
