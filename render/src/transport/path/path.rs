//! State of a path.

use glam::Vec3;

use crate::geometry::bvh::Hit;
use crate::geometry::sampling::hash;
use crate::transport::scene::media::Media;
use crate::transport::scene::surface::Surface;

/// Number of pairs of sample dimensions per vertex: one each for light samples, the scattered direction, the choice
/// of lobe, and Russian roulette.
const PAIRS: u32 = 4;

/// Index of the first pair of sample dimensions of the vertex after `bounce` scatterings. Pair 0 belongs to the
/// camera ray.
pub const fn first_pair(bounce: u32) -> u32 {
    1 + bounce * PAIRS
}

/// A vertex of a path.
#[derive(Debug, Clone, Copy)]
pub enum Vertex {
    /// A vertex on the receiver.
    Receiver(Hit),
    /// A vertex on an object, hit by a camera ray or a specular ray.
    Object(Hit),
    /// A vertex on an object, hit by a ray from a matte surface. Such a ray continues straight through transmissive
    /// surfaces.
    Straight(Hit),
}

impl Vertex {
    /// Length of the ray that hit the vertex.
    pub(crate) fn distance(&self) -> f32 {
        match self {
            Self::Receiver(hit) | Self::Object(hit) | Self::Straight(hit) => hit.t,
        }
    }

    /// The hit, if it is on an object.
    pub(crate) fn on_object(&self) -> Option<&Hit> {
        match self {
            Self::Receiver(_) => None,
            Self::Object(hit) | Self::Straight(hit) => Some(hit),
        }
    }
}

/// Data about how a path reached a vertex.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathState {
    /// Unit direction of the ray to the vertex.
    pub direction: Vec3,
    /// Number of scatterings before the vertex.
    pub bounce: u32,
    /// Throughput (beta).
    pub throughput: Vec3,
    /// Factor of the throughput that is due to MIS weights against other rays. Russian roulette divides it out, so
    /// that a small MIS weight does not make the path more likely to end.
    pub share: f32,
    /// MIS weight of the emission at the vertex against light samples of the previous vertex.
    pub mis_weight: f32,
    /// Media at the end of the ray.
    pub media: Media,
}

/// A path that is being traced, and the light found so far.
#[derive(Debug)]
pub(crate) struct Path {
    /// The current vertex.
    pub vertex: Vertex,
    /// Data about how the path reached the vertex.
    pub state: PathState,
    /// Footprint width at the vertex.
    pub width: f32,
    /// Footprint growth per unit of length.
    pub spread: f32,
    /// True if the vertex coincides with the previous vertex.
    pub touches: bool,
    /// Radiance of the path so far.
    pub light: Vec3,
}

/// A vertex and its surface, at which light is gathered.
#[derive(Debug)]
pub(crate) struct ShadingPoint {
    /// The surface.
    pub surface: Surface,
    /// Number of scatterings before the vertex.
    pub bounce: u32,
    /// Index of the first pair of sample dimensions of the vertex.
    pub pair: u32,
    /// Hash key of random decisions.
    pub key: u32,
}

impl ShadingPoint {
    /// Creates a shading point for a surface that the path with hash key `path` hits after `bounce` scatterings.
    pub fn new(surface: Surface, bounce: u32, path: u32) -> Self {
        let pair = first_pair(bounce);
        Self { surface, bounce, pair, key: hash(path, pair) }
    }

    /// True if the point is the first vertex.
    pub fn is_first(&self) -> bool {
        self.bounce == 0
    }
}
