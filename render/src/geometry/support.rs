//! Feet of objects, and planes through the points of the ground below a foot.

use glam::{DMat3, DVec3};
use scene::types::{Placed, Primitive};

/// Bounding box of an object, and the position and size of its foot, which is the part of the object near the
/// ground. All lengths are in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Smallest coordinates of the object.
    pub low: DVec3,
    /// Largest coordinates of the object.
    pub high: DVec3,
    /// Height of the lowest point of the object, along the up direction.
    pub base: f64,
    /// Middle of the foot.
    pub middle: DVec3,
    /// Half the size of the region in which the ground is examined, which consists of the foot and a margin around
    /// it.
    pub half: DVec3,
}

/// Corners of the triangles of an object, in the world. Those that are not finite are left out.
pub fn corners(placed: &Placed) -> impl Iterator<Item = DVec3> {
    let used = placed.object.primitives.iter().flat_map(|primitive| {
        primitive.triangles.iter().flatten().filter_map(|&i| primitive.positions.get(i as usize))
    });
    let place = |p: &[f32; 3]| placed.world_from_object.transform_point3(DVec3::from_array(p.map(f64::from)));
    used.map(place).filter(|p| p.is_finite())
}

/// Triangles of an object, in the world. Those with a corner that is not finite are left out.
pub fn triangles(placed: &Placed) -> Vec<[DVec3; 3]> {
    let of = |primitive: &Primitive| {
        let place = |i: u32| {
            let local = DVec3::from_array(primitive.positions.get(i as usize)?.map(f64::from));
            Some(placed.world_from_object.transform_point3(local)).filter(|p| p.is_finite())
        };
        let whole = |[a, b, c]: &[u32; 3]| Some([place(*a)?, place(*b)?, place(*c)?]);
        primitive.triangles.iter().filter_map(whole).collect::<Vec<_>>()
    };
    placed.object.primitives.iter().flat_map(of).collect()
}

/// Smallest and largest coordinates of the points. `None` if there are no points.
fn around(points: impl Iterator<Item = DVec3>) -> Option<(DVec3, DVec3)> {
    points.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))
}

impl Foot {
    /// Finds the foot of an object, which is the part in the lowest fiftieth of its height. If this part is small,
    /// the region in which the ground is examined has a quarter of the size of the object. `None` if the object has
    /// no triangles.
    pub fn of(placed: &Placed, up: DVec3) -> Option<Self> {
        let (low, high) = around(corners(placed))?;
        let (base, top) = (low.dot(up).min(high.dot(up)), low.dot(up).max(high.dot(up)));
        let slice = base + 0.02 * (top - base);
        let (a, b) = around(corners(placed).filter(|p| p.dot(up) <= slice)).unwrap_or((low, high));
        let half = ((b - a) * 0.75).max((high - low) * 0.125);
        Some(Self { low, high, base, middle: (a + b) * 0.5, half })
    }

    /// Two horizontal unit vectors at a right angle to each other. `up` must be parallel to an axis of the world.
    pub fn axes(up: DVec3) -> [DVec3; 2] {
        let across = if up.x.abs() > 0.5 { DVec3::Y } else { DVec3::X };
        [across, up.cross(across)]
    }
}

/// A plane fitted to points of the ground, and the roughness of the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPlane {
    /// Height of the plane at (0, 0). It is chosen so that half of the points lie above the plane.
    pub height: f64,
    /// Slope of the plane along both axes, fitted by least squares; 0 if the points do not determine it.
    pub slope: [f64; 2],
    /// Standard deviation of the heights of the points above the plane, estimated from the median absolute
    /// deviation.
    pub roughness: f64,
}

impl GroundPlane {
    /// Returns the height of the plane at a position.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.height + self.slope[0] * x + self.slope[1] * y
    }

    /// Fits a plane to points, given by two horizontal coordinates and a height. `None` if there are no points.
    pub fn of(points: &[[f64; 3]]) -> Option<Self> {
        let first = points.first()?[2];
        let (mut moments, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for &[x, y, z] in points {
            let row = DVec3::new(x, y, 1.0);
            moments += DMat3::from_cols(row * x, row * y, row);
            right += row * (z - first);
        }
        let plane = moments.inverse() * right;
        // Points on a line do not determine a plane.
        let slope =
            if moments.determinant() > 0.0 && plane.is_finite() { [plane.x, plane.y] } else { [0.0; 2] };
        let over = |&[x, y, z]: &[f64; 3]| z - slope[0] * x - slope[1] * y;
        let height = median(points.iter().map(over).collect())?;
        // 1.4826 converts the median deviation of a normal distribution to its standard deviation.
        let roughness = 1.4826 * median(points.iter().map(|point| (over(point) - height).abs()).collect())?;
        Some(Self { height, slope, roughness })
    }
}

/// Median of the values. If their number is even, this is the larger of the two middle numbers, not their mean.
/// `None` if there are no values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_no_roughness() {
        let grid = (0..100).map(|i| [f64::from(i % 10) - 4.5, f64::from(i / 10) - 4.5]);
        let sloping: Vec<_> = grid.clone().map(|[x, y]| [x, y, 3.0 + 0.1 * x - 0.2 * y]).collect();
        let level = GroundPlane::of(&sloping).expect("points");
        assert!((level.slope[0] - 0.1).abs() < 1e-12 && (level.slope[1] + 0.2).abs() < 1e-12);
        assert!(level.roughness < 1e-12 && (level.height - 3.0).abs() < 1e-12);
        let rough: Vec<_> = grid.enumerate().map(|(i, [x, y])| [x, y, f64::from((i % 3) as u8)]).collect();
        assert!((0.5..1.5).contains(&GroundPlane::of(&rough).expect("points").roughness));
        assert_eq!(GroundPlane::of(&[]), None);
        assert_eq!(GroundPlane::of(&[[1.0, 2.0, 5.0]; 3]).expect("one point").slope, [0.0; 2]);
    }
}
