//! Counts of rays.

use crate::geometry::bvh::Steps;

/// Triangles tested at once, of which some may be missing.
pub(crate) const LANES: u64 = 4;

/// Rays that were cast, by what for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rays {
    /// To see what the camera sees: each asks the receiver or the objects.
    pub camera: u64,
    /// To see what lies between a point and light.
    pub shadow: u64,
    /// To see where scattered light comes from.
    pub scattered: u64,
    /// Those of them that were followed: all of one tile in 16.
    pub followed: u64,
    /// What it took to follow them through the trees.
    pub steps: Steps,
}

impl Rays {
    /// All of them.
    pub fn all(&self) -> u64 {
        self.camera + self.shadow + self.scattered
    }

    /// Nodes and triangles that one of them meets on the average, by those that were followed.
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
