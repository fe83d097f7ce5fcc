//! Counters of rays.

use crate::geometry::bvh::Steps;

/// Number of triangle slots per intersection test. Some of the slots may be empty.
pub(crate) const LANES: u64 = 4;

/// Numbers of rays cast, by purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rays {
    /// Number of camera rays, traced against the receiver or the objects.
    pub camera: u64,
    /// Number of shadow rays.
    pub shadow: u64,
    /// Number of scattered rays.
    pub scattered: u64,
    /// Number of rays whose BVH steps are counted. These are all rays of one tile in 16.
    pub followed: u64,
    /// BVH steps of the rays in `followed`.
    pub steps: Steps,
}

impl Rays {
    /// Total number of rays.
    pub fn all(&self) -> u64 {
        self.camera + self.shadow + self.scattered
    }

    /// Average numbers of nodes visited and of triangles tested per ray, over the rays with counted steps.
    pub fn steps_each(&self) -> [f64; 2] {
        let Steps { nodes, packets } = self.steps;
        [nodes, LANES * packets].map(|n| n as f64 / self.followed.max(1) as f64)
    }
}

impl std::ops::AddAssign for Rays {
    fn add_assign(&mut self, other: Self) {
        self.camera += other.camera;
        self.shadow += other.shadow;
        self.scattered += other.scattered;
        self.followed += other.followed;
        self.steps += other.steps;
    }
}
