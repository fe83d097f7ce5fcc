//! Points of the splats' surface in the views, and how well the depths of a mesh agree with them.

use glam::{DMat4, DVec3};

use super::raster;
use super::sight::Sight;
use crate::geometry::support::median;
use crate::types::Mesh;

/// Distance of a plane from the splats' surface at which the agreement is 0, as a share of the distance from the eye
/// or, if that is smaller, of the median distance. The mesh of a capture lies several hundredths off its splats.
const TOLERANCE: f64 = 0.07;
/// Farther points are backdrop, which meshes leave out: multiple of the distance that a quarter of the points are
/// nearer than.
const BACKDROP: f64 = 10.0;
/// Minimum number of points.
const LEAST: usize = 200;
/// Weight of points at edges, whose normal is not known.
const AT_EDGE: f64 = 0.3;
/// Near plane of the mesh, as a share of the median distance.
const NEAR: f64 = 0.005;

/// A point of the splats' surface in a view.
pub(super) struct Spot {
    /// Position in the world.
    pub point: DVec3,
    /// Unit normal of the surface; `None` at edges.
    pub normal: Option<DVec3>,
    /// Distance from the surface at which a mesh does not agree any more, in world units.
    pub tolerance: f64,
    /// Weight: large surfaces, such as the ground, do not outweigh the directions in which fewer points face.
    pub weight: f64,
    /// View and pixel.
    pub sight: usize,
    pub pixel: usize,
}

/// Points of the splats' surface in all views.
pub(super) struct Spots {
    pub list: Vec<Spot>,
    /// Median distance of the points from the eye, in world units.
    pub distance: f64,
    /// Median of the points along each axis, and the median distance from it.
    pub middle: DVec3,
    pub radius: f64,
}

/// One of 13 axes that a normal is nearest to.
fn facing(normal: DVec3) -> usize {
    let mut best = (0, -1.0);
    let mut index = 0;
    for x in -1_i32..=1 {
        for y in -1_i32..=1 {
            for z in -1_i32..=1 {
                // One of each pair of opposite directions.
                if (x, y, z) > (0, 0, 0) {
                    let axis = DVec3::new(x.into(), y.into(), z.into()).normalize();
                    let cosine = axis.dot(normal).abs();
                    if cosine > best.1 {
                        best = (index, cosine);
                    }
                    index += 1;
                }
            }
        }
    }
    best.0
}

impl Spots {
    /// The points of all views; `None` if the splats show too few surfaces to compare anything with.
    pub fn of(sights: &[Sight]) -> Option<Self> {
        let mut list = Vec::new();
        for (index, sight) in sights.iter().enumerate() {
            for pixel in (0..sight.depth.len()).filter(|&pixel| sight.clear[pixel]) {
                let (point, normal) = (sight.point(pixel, sight.depth[pixel]), sight.normal(pixel));
                let distance = (point - sight.camera.eye()).length();
                list.push(Spot { point, normal, tolerance: distance, weight: AT_EDGE, sight: index, pixel });
            }
        }
        let mut far: Vec<f64> = list.iter().map(|spot| spot.tolerance).collect();
        far.sort_unstable_by(f64::total_cmp);
        let limit = BACKDROP * far.get(far.len() / 4)?;
        list.retain(|spot| spot.tolerance <= limit);
        if list.len() < LEAST {
            return None;
        }
        let distance = median(list.iter().map(|spot| spot.tolerance).collect())?;
        let mut counts = [0.0; 13];
        let known = |spot: &Spot| spot.normal.map(facing);
        list.iter().filter_map(known).for_each(|axis| counts[axis] += 1.0);
        let all: f64 = counts.iter().sum();
        for spot in &mut list {
            spot.tolerance = TOLERANCE * spot.tolerance.max(distance);
            if let Some(axis) = spot.normal.map(facing) {
                spot.weight = (all / (13.0 * counts[axis])).sqrt().min(3.0);
            }
        }
        let along = |axis: usize| median(list.iter().map(|spot| spot.point[axis]).collect());
        let middle = DVec3::new(along(0)?, along(1)?, along(2)?);
        let radius = median(list.iter().map(|spot| (spot.point - middle).length()).collect())?;
        Some(Self { list, distance, middle, radius })
    }

    /// Near plane of the mesh, in world units.
    pub fn near(&self) -> f64 {
        NEAR * self.distance
    }

    /// Depths of a placed mesh in each of the views.
    pub fn depths(&self, sights: &[Sight], mesh: &Mesh, world_from_mesh: &DMat4) -> Vec<Vec<f64>> {
        sights.iter().map(|sight| raster::depths(mesh, world_from_mesh, &sight.camera, self.near())).collect()
    }

    /// Mean agreement of the depths of a mesh with the points, by their weights: 1 where both are the same, 0 where
    /// they are farther apart than the tolerance or there is not any mesh.
    pub fn agreement(&self, sights: &[Sight], depths: &[Vec<f64>]) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for spot in &self.list {
            let sight = &sights[spot.sight];
            let (splats, mesh) = (sight.depth[spot.pixel], depths[spot.sight][spot.pixel]);
            total += spot.weight;
            if mesh.is_finite() {
                let along = sight.ray(spot.pixel) * (mesh - splats);
                let off = spot.normal.map_or(0.5 * along.length(), |normal| along.dot(normal).abs());
                sum += spot.weight * kernel(off / spot.tolerance);
            }
        }
        sum / total
    }
}

/// Agreement at a distance in tolerances.
pub(super) fn kernel(off: f64) -> f64 {
    if off < 1.0 { (1.0 - off * off) * (1.0 - off * off) } else { 0.0 }
}
