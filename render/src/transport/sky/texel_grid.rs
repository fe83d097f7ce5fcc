//! The sphere of directions as the texels of an equirectangular panorama.

use std::f64::consts::PI;

use engine::Up;
use glam::Vec3;
use scene::math::equirect::{axes, pixel_solid_angle};
use scene::math::num;

use super::cone::Cone;

/// Geometry of the texels of a panorama.
#[derive(Debug)]
pub struct TexelGrid {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Unit vectors to the right, forward and up in the world.
    pub axes: [Vec3; 3],
    /// Sine and cosine of the azimuth of the left edge of each column. The last pair closes the circle.
    pub edges: Vec<(f64, f64)>,
    /// Cosine of the polar angle of the upper edge of each row, followed by -1 for the lower edge of the last row.
    pub cosines: Vec<f64>,
}

impl TexelGrid {
    /// Creates the grid for a panorama of the given size.
    pub fn new(width: usize, height: usize, up: Up) -> Self {
        let azimuth = |x: usize| 2.0 * PI * (x as f64 / width as f64 - 0.5);
        let mut cosines: Vec<f64> =
            (0..=height).map(|y| num::f64::cos(PI * y as f64 / height as f64)).collect();
        cosines[height] = -1.0;
        Self {
            width,
            height,
            axes: axes(up).map(|axis| axis.as_vec3()),
            edges: (0..=width).map(|x| num::sin_cos(azimuth(x))).collect(),
            cosines,
        }
    }

    /// Direction in the world, from components along right, forward and up.
    pub fn to_world(&self, local: [f64; 3]) -> Vec3 {
        let [x, y, z] = [local[0] as f32, local[1] as f32, local[2] as f32];
        self.axes[0] * x + self.axes[1] * y + self.axes[2] * z
    }

    /// Direction of the upper left corner of the texel in column `x` and row `y`.
    pub fn corner(&self, x: usize, y: usize) -> Vec3 {
        let radius = (1.0 - self.cosines[y] * self.cosines[y]).max(0.0).sqrt();
        self.to_world([self.edges[x].0 * radius, self.edges[x].1 * radius, self.cosines[y]])
    }

    /// Direction in a texel for two numbers in [0, 1), uniform over its solid angle.
    #[inline(always)]
    pub fn within(&self, (x, y): (usize, usize), [u, v]: [f64; 2]) -> Vec3 {
        // Uniform in azimuth and in the cosine of the polar angle.
        let above = self.cosines[y] + v * (self.cosines[y + 1] - self.cosines[y]);
        let (sin, cos) = if self.width >= 64 {
            // Rotated from the column's left edge, by the series for a small angle.
            let a = u * 2.0 * PI / self.width as f64;
            let q = a * a;
            let (s, c) = (a * (1.0 - q / 6.0 * (1.0 - q / 20.0)), 1.0 - q / 2.0 * (1.0 - q / 12.0));
            let (se, ce) = self.edges[x];
            (se * c + ce * s, ce * c - se * s)
        } else {
            num::sin_cos(2.0 * PI * ((x as f64 + u) / self.width as f64 - 0.5))
        };
        let radius = (1.0 - above * above).max(0.0).sqrt();
        self.to_world([sin * radius, cos * radius, above])
    }

    /// Solid angle of a texel of a row.
    pub fn solid_angle(&self, y: usize) -> f64 {
        pixel_solid_angle(self.width, self.height, y)
    }

    /// Upper bound of half the distance between any two directions in the same texel.
    pub fn radius(&self) -> f64 {
        PI * (0.5 / self.height as f64 + 1.0 / self.width as f64)
    }

    /// Calls `each` with the column and row of each texel that overlaps a cone, and of some texels near the cone.
    pub fn each_around(&self, cone: &Cone, mut each: impl FnMut(usize, usize)) {
        let [x, y, z] = self.axes.map(|axis| f64::from(axis.dot(cone.axis)).clamp(-1.0, 1.0));
        let texel = 2.0 * self.radius();
        // Polar angle of the axis, and the angle to the boundary.
        let (polar, wide) = (num::f64::acos(z), num::f64::acos(f64::from(cone.cosine)) + texel);
        let row = |angle: f64| ((angle / PI * self.height as f64) as usize).min(self.height - 1);
        let width = self.width;
        let (first, count) = match wide < polar.min(PI - polar) && wide < 0.5 * PI {
            true => {
                let half = num::f64::asin((num::f64::sin(wide) / num::f64::sin(polar)).min(1.0)) / (2.0 * PI);
                let middle = approximate_turns(x, y) + 0.5;
                let most = (2.0 * half * width as f64) as usize + 3;
                ((((middle - half + 1.0) * width as f64) as usize + width - 1), most.min(width))
            }
            false => (0, width),
        };
        for y in row(polar - wide)..=row(polar + wide) {
            (first..first + count).for_each(|x| each(x % width, y));
        }
    }

    /// Column and row of the texel that contains a unit direction.
    pub fn texel(&self, direction: Vec3) -> (usize, usize) {
        let [x, y, z] = self.axes.map(|axis| f64::from(direction.dot(axis)));
        (self.column(x, y), self.row(z, (x * x + y * y).sqrt()))
    }

    /// Row of the texel that contains a direction. It is estimated from an approximate angle and corrected with the
    /// exact edges.
    fn row(&self, above: f64, radius: f64) -> usize {
        let turns = approximate_turns(radius, above) * 2.0;
        let mut row = ((turns * self.height as f64) as usize).min(self.height - 1);
        while row > 0 && above > self.cosines[row] {
            row -= 1;
        }
        while row + 1 < self.height && above <= self.cosines[row + 1] {
            row += 1;
        }
        row
    }

    /// Column of the texel that contains a direction. It is estimated from an approximate angle and corrected with
    /// the exact edges.
    fn column(&self, x: f64, y: f64) -> usize {
        let turns = approximate_turns(x, y) + 0.5;
        let column = ((turns * self.width as f64) as usize).min(self.width - 1);
        if self.width < 8 {
            return column;
        }
        // The sine of the angle past an edge gives the side.
        let past = |edge: usize| x * self.edges[edge].1 - y * self.edges[edge].0 >= 0.0;
        if !past(column) {
            (column + self.width - 1) % self.width
        } else if past(column + 1) {
            (column + 1) % self.width
        } else {
            column
        }
    }
}

/// Approximation of atan2(x, y) / (2 pi) in [-0.5, 0.5], with an error of about 2e-6 turns: an odd polynomial
/// in the smaller of the two ratios, fitted to atan on [0, 1] by least squares at Chebyshev points.
pub fn approximate_turns(x: f64, y: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let r = if large > 0.0 { small / large } else { 0.0 };
    let q = r * r;
    let atan = r
        * (0.999_977_26
            + q * (-0.332_623_47
                + q * (0.193_543_46 + q * (-0.116_432_87 + q * (0.052_653_32 - q * 0.011_721_20)))));
    let eighth = atan / (2.0 * PI);
    let quarter = if ax < ay { eighth } else { 0.25 - eighth };
    let half = if y < 0.0 { 0.5 - quarter } else { quarter };
    if x < 0.0 { -half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::Points;
    use testing::direction;

    /// Every texel that contains a direction of the cone is visited once, and few others are.
    #[test]
    fn texels_of_a_cone_are_all_visited() {
        for (width, height) in [(64, 32), (200, 77), (8, 3), (1, 1)] {
            let texel_grid = TexelGrid::new(width, height, Up::PlusY);
            for i in 0..60 {
                let [[a, b], [c, _]] = [0, 1].map(|k| Points::new(7, i).pair(k));
                let cone = Cone { axis: direction([a, b]), cosine: 0.4 + (0.9999 - 0.4) * c };
                let mut visits = vec![0; width * height];
                texel_grid.each_around(&cone, |x, y| visits[y * width + x] += 1);
                assert!(visits.iter().all(|&n| n <= 1));
                for k in 0..3_000 {
                    let way = direction(Points::new(8, k).pair(0));
                    let (x, y) = texel_grid.texel(way);
                    assert!(
                        way.dot(cone.axis) < cone.cosine || visits[y * width + x] == 1,
                        "{x} {y} {cone:?}"
                    );
                }
                let share = f64::from(visits.iter().sum::<u32>()) / (width * height) as f64;
                assert!(width < 64 || share < 0.1 + 8.0 * f64::from(1.0 - cone.cosine), "{share} {cone:?}");
            }
        }
    }
}
