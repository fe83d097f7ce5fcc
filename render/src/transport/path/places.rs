//! Division of a scene into places.

use glam::Vec3;

/// Maximum number of cubes along the longest side of the grid.
const FINEST: usize = 24;
/// Index of a cube without points.
const EMPTY: u32 = u32::MAX;

/// Grid of cubes over a set of points. A cube that contains a point is a place.
#[derive(Debug)]
pub(crate) struct Places {
    /// Lowest corner of the grid.
    low: Vec3,
    /// Number of cubes per unit of length.
    per_unit: f32,
    /// Number of cubes along each axis.
    counts: [usize; 3],
    /// For each cube, the number of its place, or [`EMPTY`].
    numbers: Vec<u32>,
    /// Number of places.
    pub(crate) count: usize,
}

impl Places {
    /// Divides the surroundings of finite points into the smallest cubes that give at most `most` places, which must be
    /// at least 8.
    pub(crate) fn new(points: &[Vec3], most: usize) -> Self {
        let mut best = Self::divided(points, 1);
        for cubes in 2..=FINEST {
            let finer = Self::divided(points, cubes);
            if finer.count > most {
                break;
            }
            best = finer;
        }
        best
    }

    /// Divides the longest side of the bounding box of the points into `cubes` cubes.
    fn divided(points: &[Vec3], cubes: usize) -> Self {
        let low = points.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = points.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let longest = (high - low).max_element();
        // A box without points, of no size or of a size beyond single precision has one cube.
        let usual = longest > 1e-30 && longest < 1e30;
        let side = if usual { longest / cubes as f32 } else { 1.0 };
        // The grid starts a third of a cube below the points, so that a wall does not lie between two cubes.
        let low = low - side / 3.0;
        let cubes_to = |k: usize| ((high[k] - low[k]) / side) as usize + 1;
        let counts = if usual { [0, 1, 2].map(cubes_to) } else { [1; 3] };
        let numbers = vec![EMPTY; counts.into_iter().product()];
        let mut places = Self { low, per_unit: 1.0 / side, counts, numbers, count: 0 };
        for &point in points {
            if let Some(cube) = places.cube(point)
                && places.numbers[cube] == EMPTY
            {
                places.numbers[cube] = places.count as u32;
                places.count += 1;
            }
        }
        places
    }

    fn cube(&self, point: Vec3) -> Option<usize> {
        let at = (point - self.low) * self.per_unit;
        // Also false for NaN.
        if !at.cmpge(Vec3::ZERO).all() {
            return None;
        }
        let [x, y, z] = at.to_array().map(|v| v as usize);
        let [nx, ny, nz] = self.counts;
        (x < nx && y < ny && z < nz).then(|| (z * ny + y) * nx + x)
    }

    /// Number of the place that contains a point. `None` if no place contains it.
    #[inline]
    pub(crate) fn of(&self, point: Vec3) -> Option<usize> {
        let number = self.numbers[self.cube(point)?];
        (number != EMPTY).then_some(number as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::Points;

    /// Each point lies in a place, there are no more places than asked for, and points elsewhere have none.
    #[test]
    fn each_point_has_a_place() {
        let point = |i: u32| {
            let [[x, y], [z, _]] = [0, 1].map(|pair| Points::new(3, i).pair(pair));
            Vec3::new(7.0 * x - 2.0, 3.0 * y, 9.0 * z + 100.0)
        };
        let points: Vec<Vec3> = (0..2_000).map(point).collect();
        for most in [20, 100, 300] {
            let places = Places::new(&points, most);
            assert!(places.count <= most && 3 * places.count >= most, "{} of {most}", places.count);
            let mut members = vec![0; places.count];
            for &point in &points {
                members[places.of(point).expect("a place")] += 1;
            }
            assert!(members.iter().all(|&count| count > 0));
            for outside in [Vec3::ZERO, Vec3::splat(f32::NAN), Vec3::splat(1e30), Vec3::NEG_INFINITY] {
                assert_eq!(places.of(outside), None);
            }
        }
    }

    /// Points at one position, far apart or missing give a grid of one cube, or none of its places.
    #[test]
    fn unusual_points_give_one_cube() {
        assert_eq!(Places::new(&[], 10).count, 0);
        assert_eq!(Places::new(&[Vec3::ONE; 3], 10).of(Vec3::ONE), Some(0));
        let far = Places::new(&[Vec3::splat(-3e38), Vec3::splat(3e38)], 10);
        assert!(far.count <= 1 && far.numbers.len() == 1);
    }
}
