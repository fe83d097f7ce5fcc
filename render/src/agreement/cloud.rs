//! Points distributed evenly over the area of a mesh, and a search for the point nearest to a position.

use glam::DVec3;
use scene::types::Mesh;
use scene::types::frame::Similarity;

use crate::geometry::sampling::{fraction, hash};

/// Number of points that are sampled on a mesh.
const POINTS: usize = 24_000;
/// Maximum number of points in a leaf of the tree.
const LEAF: usize = 8;

/// Points on a mesh with their normals, sorted as a k-d tree.
pub(super) struct Cloud {
    /// Points and unit normals. Each range of more than [`LEAF`] points is divided at its middle index, so that no
    /// point of the first half has a larger coordinate along the widest axis of the range than a point of the
    /// second half.
    pub points: Vec<(DVec3, DVec3)>,
    /// Axis and coordinate of the plane that divides each range. The index of an entry is the middle index of its
    /// range.
    planes: Vec<(u8, f64)>,
    /// Bounding box of the points.
    bounds: [DVec3; 2],
    /// Mean distance between neighbouring points, in the units of the mesh.
    pub spacing: f64,
    /// Median of the coordinates of the points along each axis.
    pub middle: DVec3,
    /// Median distance of the points from `middle`.
    pub radius: f64,
}

/// A cloud that is placed in the world.
pub(super) struct Placed<'a> {
    pub cloud: &'a Cloud,
    /// Transform from the mesh to the world.
    pub at: Similarity,
}

impl Cloud {
    /// Samples points on a mesh. Returns `None` if the mesh has no area.
    pub fn of(mesh: &Mesh) -> Option<Self> {
        Self::with(mesh, POINTS)
    }

    /// Samples about `count` points. `None` if the mesh has no area.
    pub fn with(mesh: &Mesh, count: usize) -> Option<Self> {
        let corners = |triangle: &[u32; 3]| triangle.map(|i| mesh.position(i));
        let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let mut sums = Vec::with_capacity(mesh.triangles.len());
        let mut area = 0.0;
        for triangle in &mesh.triangles {
            let own = 0.5 * cross(corners(triangle)).length();
            area += if own.is_finite() { own } else { 0.0 };
            sums.push(area);
        }
        if !(area > 0.0 && area.is_finite()) {
            return None;
        }
        let mut points = Vec::with_capacity(count);
        let mut at = 0;
        for i in 0..count {
            let wanted = (i as f64 + 0.5) / count as f64 * area;
            while at + 1 < sums.len() && sums[at] < wanted {
                at += 1;
            }
            let triangle = corners(&mesh.triangles[at]);
            let normal = cross(triangle).normalize_or_zero();
            let (mut u, mut v) = (fraction(hash(i as u32, 0)), fraction(hash(i as u32, 1)));
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = triangle;
            let point = a + (b - a) * u + (c - a) * v;
            if point.is_finite() && normal != DVec3::ZERO {
                points.push((point, normal));
            }
        }
        let spacing = (area / points.len().max(1) as f64).sqrt();
        Some(Self { spacing, ..Self::of_points(points)? })
    }

    /// Sorts points with their normals. The spacing is 0. Returns `None` if there are no points.
    pub fn of_points(mut points: Vec<(DVec3, DVec3)>) -> Option<Self> {
        if points.is_empty() {
            return None;
        }
        let middle =
            DVec3::from_array([0, 1, 2].map(|axis| upper_median(points.iter().map(|(p, _)| p[axis]))));
        let radius = upper_median(points.iter().map(|(p, _)| (*p - middle).length()));
        let mut planes = vec![(0, 0.0); points.len()];
        let bounds = bounds(&points);
        divide(&mut points, &mut planes);
        Some(Self { spacing: 0.0, points, planes, bounds, middle, radius })
    }

    /// Lower and upper corner of a box that contains nearly all points. About one point in 2000 lies beyond each
    /// side.
    pub fn extents(&self) -> [DVec3; 2] {
        extents(self.points.iter().map(|(p, _)| *p))
    }

    /// Like [`extents`](Self::extents), for the points transformed by `by`.
    pub fn extents_after(&self, by: &Similarity) -> [DVec3; 2] {
        extents(self.points.iter().map(|(p, _)| by.point(*p)))
    }

    /// Index of the point nearest to `to`; `None` if no point is within the distance `within`.
    pub fn nearest(&self, to: DVec3, within: f64) -> Option<usize> {
        let (mut best, mut square) = (None, within * within);
        let [low, high] = self.bounds;
        // Ranges that are still to be searched, with their minimum distance along each axis. There are never more
        // than the depth of the tree.
        let mut waiting = [(0_usize, 0_usize, DVec3::ZERO); 40];
        let mut count = 1;
        waiting[0] = (0, self.points.len(), (low - to).max(to - high).max(DVec3::ZERO));
        while count > 0 {
            count -= 1;
            let (mut first, mut last, least) = waiting[count];
            if least.length_squared() >= square {
                continue;
            }
            while last - first > LEAF {
                let half = usize::midpoint(first, last);
                let (axis, plane) = self.planes[half];
                let axis = axis as usize;
                let off = to[axis] - plane;
                let far;
                if off < 0.0 {
                    (far, last) = ((half, last), half);
                } else {
                    (far, first) = ((first, half), half);
                }
                let mut apart = least;
                apart[axis] = apart[axis].max(off.abs());
                if apart.length_squared() < square {
                    waiting[count] = (far.0, far.1, apart);
                    count += 1;
                }
            }
            for i in first..last {
                let own = (self.points[i].0 - to).length_squared();
                if own < square {
                    (best, square) = (Some(i), own);
                }
            }
        }
        best
    }
}

/// Box that contains nearly all of the points; see [`Cloud::extents`].
fn extents(points: impl Iterator<Item = DVec3> + Clone) -> [DVec3; 2] {
    let bounds = [0, 1, 2].map(|axis| {
        let mut along: Vec<f64> = points.clone().map(|p| p[axis]).collect();
        along.sort_unstable_by(f64::total_cmp);
        let beyond = along.len() / 2000;
        [along[beyond], along[along.len() - 1 - beyond]]
    });
    [0, 1].map(|side| DVec3::from_array(bounds.map(|bound| bound[side])))
}

/// Upper median of the values. There must be at least one value.
fn upper_median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let half = values.len() / 2;
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}

/// Box around the points. There must be at least one point.
fn bounds(points: &[(DVec3, DVec3)]) -> [DVec3; 2] {
    let first = points[0].0;
    points.iter().fold([first, first], |[low, high], (p, _)| [low.min(*p), high.max(*p)])
}

/// Sorts the points as a k-d tree, and stores the dividing planes in `planes`.
fn divide(points: &mut [(DVec3, DVec3)], planes: &mut [(u8, f64)]) {
    let mut waiting = vec![(0, points.len())];
    while let Some((first, last)) = waiting.pop() {
        if last - first <= LEAF {
            continue;
        }
        let part = &mut points[first..last];
        let [low, high] = bounds(part);
        let size = high - low;
        let axis = if size.x >= size.y && size.x >= size.z { 0 } else { usize::from(size.y < size.z) + 1 };
        let half = usize::midpoint(first, last);
        part.select_nth_unstable_by(half - first, |(a, _), (b, _)| a[axis].total_cmp(&b[axis]));
        planes[half] = (axis as u8, points[half].0[axis]);
        waiting.extend([(first, half), (half, last)]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The nearest point is the same as in a search through all points. This test fails if `max(off.abs())` is
    /// replaced with `max(2.0 * off.abs())`.
    #[test]
    fn the_nearest_point_is_found() {
        let random = |i: u32, k: u32| (fraction(hash(i, k)) * 3.0) as f32;
        let positions: Vec<[f32; 3]> = (0..90).map(|i| [random(i, 0), random(i, 1), random(i, 2)]).collect();
        let triangles = (0..30).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let cloud = Cloud::of(&Mesh { positions, triangles, ..Mesh::default() }).expect("area");
        for i in 0..300 {
            let to = DVec3::from_array([2, 3, 4].map(|k| fraction(hash(i, k)) * 4.0 - 0.5));
            let least = cloud.points.iter().map(|(p, _)| (*p - to).length()).fold(f64::INFINITY, f64::min);
            for within in [10.0, 0.1] {
                let found = cloud.nearest(to, within).map(|i| (cloud.points[i].0 - to).length());
                assert_eq!(found, (least < within).then_some(least), "{i}");
            }
        }
        assert!(Cloud::of(&Mesh::default()).is_none());
    }
}
