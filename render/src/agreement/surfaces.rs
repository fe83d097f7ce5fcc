//! Compares the centres of the splats with points on the mesh, in both directions. This does not depend on the
//! views, and it is accurate where splats are large.

use glam::DVec3;
use scene::types::Splats;
use scene::types::frame::Similarity;

use super::cloud::{Cloud, Placed};
use super::spots::{Spots, kernel, weights};

/// Minimum absolute cosine between the normals of two surfaces that count as the same.
const ALIGNED: f64 = 0.7;

/// Centres of the splats as points and as a tree, and weighted points of the mesh.
pub(super) struct Surfaces<'a> {
    /// Centres of the splats, with tolerances and weights.
    pub spots: Spots,
    /// Points on the mesh.
    pub cloud: &'a Cloud,
    /// Centres of the splats, sorted for searches. The normal is 0 if the splat is not flat.
    tree: Cloud,
    /// Weight of each point of `cloud`. Points whose normals are frequent have smaller weights.
    weights: Vec<f64>,
    /// Distance of a point of the mesh from the splats at which they do not agree, in world units.
    tolerance: f64,
}

/// Agreement of splats and mesh, each 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Both {
    /// Share of the splats that the mesh has.
    pub splats: f64,
    /// Share of the mesh that the splats have.
    pub mesh: f64,
}

impl Both {
    /// Mean of both shares.
    pub fn mean(&self) -> f64 {
        0.5 * (self.splats + self.mesh)
    }
}

impl<'a> Surfaces<'a> {
    /// `None` if there are no opaque splats.
    pub fn of(splats: &Splats, cloud: &'a Cloud) -> Option<Self> {
        let spots = Spots::of_centres(splats)?;
        let tree = Cloud::of_points(Spots::centres(splats, spots.middle, spots.radius))?;
        let tolerance = spots.list.first()?.tolerance;
        let weights = weights(cloud.points.iter().map(|(_, normal)| Some(*normal)));
        Some(Self { spots, cloud, tree, weights, tolerance })
    }

    /// Distance of a point of the mesh from the splats at which they do not agree, in world units.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Agreement of the mesh at its own position.
    pub fn here(&self) -> Both {
        self.agreement(Similarity::IDENTITY, usize::MAX, 1.0)
    }

    /// Agreement of the mesh, transformed by `at`, at about `count` points of each.
    pub fn agreement(&self, at: Similarity, count: usize, slack: f64) -> Both {
        let step = |length: usize| (length / count) | 1;
        let placed = Placed { cloud: self.cloud, at };
        let splats = placed.agreement(&self.spots, step(self.spots.list.len()), slack);
        let tolerance = slack * self.tolerance;
        let (mut sum, mut total) = (0.0, 0.0);
        for i in (0..self.cloud.points.len()).step_by(step(self.cloud.points.len())) {
            let (point, normal) = self.cloud.points[i];
            let (point, normal) = (at.point(point), at.rotation * normal);
            total += self.weights[i];
            let Some(other) = self.tree.nearest(point, 1.5 * tolerance) else { continue };
            let (other, own) = self.tree.points[other];
            if own != DVec3::ZERO && own.dot(normal).abs() < ALIGNED {
                continue;
            }
            sum += self.weights[i] * kernel((point - other).dot(normal) / tolerance);
        }
        Both { splats, mesh: if total > 0.0 { sum / total } else { 0.0 } }
    }
}
