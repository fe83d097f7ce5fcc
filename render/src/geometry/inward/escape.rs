//! Shares of rays that leave an object from the two sides of a patch of faces.

use glam::Vec3;

use crate::geometry::bvh::{Bvh, Ray};
use crate::geometry::sampling::{Points, circle, hash};

/// Smallest and largest number of rays from each side of a patch.
const RAYS: [usize; 2] = [16, 64];
/// Number of rays from each side of a face, in patches of few faces.
const PER_FACE: usize = 8;
/// Distance of the start of a ray from its face, relative to the diagonal of the object.
const LIFT: f64 = 1e-5;

/// Shares of rays that leave the object without a hit, from the front and from the back of a patch. The rays start
/// at points that are spread over the area of its `faces`, in directions of a cosine distribution.
pub(super) fn shares(
    bvh: &Bvh,
    corners: &[[Vec3; 3]],
    faces: &[u32],
    (number, size): (u32, f64),
) -> [f64; 2] {
    let area = |[a, b, c]: [Vec3; 3]| f64::from((b - a).cross(c - a).length());
    let mut sum = 0.0;
    let ends: Vec<f64> = faces
        .iter()
        .map(|face| {
            sum += area(corners[*face as usize]);
            sum
        })
        .collect();
    let count = (PER_FACE * faces.len()).clamp(RAYS[0], RAYS[1]);
    let lift = (LIFT * size) as f32;
    let mut left = [0_u32; 2];
    for ray in 0..count {
        let wanted = sum * (ray as f64 + 0.5) / count as f64;
        let at = ends.partition_point(|end| *end < wanted).min(faces.len().saturating_sub(1));
        let Some(face) = faces.get(at) else { break };
        let [a, b, c] = corners[*face as usize];
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        let points = Points::new(hash(0x1a2d, number), ray as u32);
        let ([u, v], [r, turns]) = (points.pair(0), points.pair(1));
        let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
        let point = a + (b - a) * u + (c - a) * v;
        let (sin, cos) = circle(turns);
        let (across, along) = normal.any_orthonormal_pair();
        let flat = (across * cos + along * sin) * r.sqrt();
        for (side, left) in [normal, -normal].into_iter().zip(&mut left) {
            let direction = flat + side * (1.0 - r).max(0.0).sqrt();
            *left += u32::from(!bvh.any(Ray::new(point + side * lift, direction), |_| true));
        }
    }
    left.map(|left| f64::from(left) / count as f64)
}
