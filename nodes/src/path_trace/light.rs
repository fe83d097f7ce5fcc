//! The environment as a light: its radiance in a direction, and directions in proportion to it.

use std::f64::consts::PI;
use std::ops::Range;

use glam::Vec3;

use super::aim::{Aim, Cell, accumulate, invert};
use crate::color::luminance;
use crate::equirect::{axes, pixel_solid_angle};
use crate::num;
use crate::types::Environment;

/// Light from a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FromSky {
    /// Unit direction towards the light, in the world.
    pub direction: Vec3,
    /// Radiance.
    pub radiance: Vec3,
    /// Density of [`Sky::sample`] for the surface at this direction, per steradian.
    pub pdf: f32,
}

/// Most cells of the grid that light samples first choose from, across and down.
const CELLS: [usize; 2] = [32, 16];

/// An environment ready for lookup and sampling. Radiance is constant over each texel. A sample chooses a
/// cell by the surface's normal (see `aim`), then a texel of it by luminance, then a point of the texel
/// by solid angle; texels are weighed by their exact solid angle, so no light is lost or won.
#[derive(Debug)]
pub struct Sky {
    width: usize,
    height: usize,
    axes: [Vec3; 3],
    /// Radiance of each texel, and density at it where its cell is given.
    texels: Vec<[f32; 4]>,
    aim: Aim,
    /// First column of texels of each column of cells, and first row of each row; one more closes each.
    columns: Vec<usize>,
    rows: Vec<usize>,
    /// Cumulative probability of the rows of each cell, for each column of cells all rows.
    down: Vec<f32>,
    /// Cumulative probability of the texels of each row within its cell.
    across: Vec<f32>,
    /// (sine, cosine) of the azimuth of each column's left edge; the last closes the circle.
    edges: Vec<(f64, f64)>,
    /// Cosine of the polar angle of each row's upper edge; the last is -1.
    cosines: Vec<f64>,
    /// Samples that were negative or not finite and count as black.
    pub broken: u64,
    /// Integral of radiance over the sphere, for each channel.
    pub power: [f64; 3],
}

/// Where to cut `texels` into at most `cells` pieces.
fn cut(texels: usize, cells: usize) -> Vec<usize> {
    let cells = texels.min(cells);
    (0..=cells).map(|cell| cell * texels / cells.max(1)).collect()
}

impl Sky {
    /// Prepares an environment.
    pub fn new(environment: &Environment) -> Self {
        let image = &environment.image;
        let (width, height) = (image.width, image.height);
        let mut sky = Self {
            width,
            height,
            axes: axes(environment.up).map(|axis| axis.as_vec3()),
            texels: Vec::with_capacity(width * height),
            aim: Aim::new(&[], 0, 0),
            columns: cut(width, CELLS[0]),
            rows: cut(height, CELLS[1]),
            down: vec![0.0; width.min(CELLS[0]) * height],
            across: vec![0.0; width * height],
            edges: Vec::with_capacity(width + 1),
            cosines: (0..=height).map(|y| num::f64::cos(PI * y as f64 / height as f64)).collect(),
            broken: 0,
            power: [0.0; 3],
        };
        sky.cosines[height] = -1.0;
        sky.edges.extend((0..=width).map(|x| num::sin_cos(2.0 * PI * (x as f64 / width as f64 - 0.5))));
        for y in 0..height {
            let solid_angle = pixel_solid_angle(width, height, y);
            for x in 0..width {
                let rgb = image.rgb(x, y).map(|v| {
                    let good = v.is_finite() && v >= 0.0;
                    sky.broken += u64::from(!good);
                    if good { v } else { 0.0 }
                });
                for (sum, v) in sky.power.iter_mut().zip(rgb) {
                    *sum += f64::from(v) * solid_angle;
                }
                sky.texels.push([rgb[0], rgb[1], rgb[2], 0.0]);
            }
        }
        let black = sky.power == [0.0; 3];
        let (columns, rows) = (sky.columns.len() - 1, sky.rows.len() - 1);
        let mut grid = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                grid.push(sky.divide(row, column, black));
            }
        }
        sky.aim = Aim::new(&grid, columns, rows);
        sky
    }

    /// The rows and columns of texels of a cell.
    #[inline]
    fn texels_of(&self, row: usize, column: usize) -> (Range<usize>, Range<usize>) {
        (self.rows[row]..self.rows[row + 1], self.columns[column]..self.columns[column + 1])
    }

    /// Sets the probabilities within a cell.
    fn divide(&mut self, row: usize, column: usize, black: bool) -> Cell {
        let (rows, columns) = self.texels_of(row, column);
        let mut of_rows = Vec::with_capacity(rows.len());
        let mut cumulative = vec![0.0; rows.len().max(columns.len())];
        let share = |c: &[f32], i: usize| f64::from(c[i]) - if i > 0 { f64::from(c[i - 1]) } else { 0.0 };
        for y in rows.clone() {
            let texels = &self.texels[y * self.width..][columns.clone()];
            let weight = |t: &[f32; 4]| if black { 1.0 } else { f64::from(luminance([t[0], t[1], t[2]])) };
            let weights: Vec<f64> = texels.iter().map(weight).collect();
            let sum = accumulate(&weights, &mut cumulative[..columns.len()]);
            for (to, from) in self.across[y * self.width..][columns.clone()].iter_mut().zip(&cumulative) {
                *to = *from as f32;
            }
            of_rows.push(sum * pixel_solid_angle(self.width, self.height, y));
        }
        let power = accumulate(&of_rows, &mut cumulative[..rows.len()]);
        for (to, from) in self.down[column * self.height..][rows.clone()].iter_mut().zip(&cumulative) {
            *to = *from as f32;
        }
        for y in rows.clone() {
            let of_row = share(&self.down[column * self.height..][rows.clone()], y - rows.start);
            let of_row = of_row / pixel_solid_angle(self.width, self.height, y);
            for x in columns.clone() {
                let of_texel = share(&self.across[y * self.width..][columns.clone()], x - columns.start);
                self.texels[y * self.width + x][3] = (of_row * of_texel) as f32;
            }
        }
        let corner = |x: usize, y: usize| {
            let radius = (1.0 - self.cosines[y] * self.cosines[y]).max(0.0).sqrt();
            self.world([self.edges[x].0 * radius, self.edges[x].1 * radius, self.cosines[y]])
        };
        let [left, right, top, bottom] = [columns.start, columns.end, rows.start, rows.end];
        let corners = [corner(left, top), corner(right, top), corner(left, bottom), corner(right, bottom)];
        let axis = match (columns.len(), rows.len()) {
            (1, _) | (_, 1) => corners.into_iter().sum::<Vec3>().normalize_or(self.axes[2]),
            _ => corner((left + right) / 2, (top + bottom) / 2),
        };
        // Along its edges the angle from a point of a cell is greatest at corners, unless the cell is wide.
        let farthest = corners.iter().map(|corner| corner.dot(axis)).fold(1.0, f32::min) - 1e-5;
        let spread = if columns.len() * 4 > self.width { -1.0 } else { farthest };
        Cell { axis, spread, power }
    }

    /// A direction in the world from one along right, forward and up.
    fn world(&self, local: [f64; 3]) -> Vec3 {
        let [x, y, z] = local.map(|v| v as f32);
        self.axes[0] * x + self.axes[1] * y + self.axes[2] * z
    }

    /// A direction for a surface of the given unit normal, about in proportion to luminance times cosine,
    /// from two 32-bit fractions. It may lie a little below the horizon, never so much that light above it
    /// is left out. Without a normal the
    /// whole sky is sampled by luminance.
    #[inline]
    pub fn sample(&self, normal: Option<Vec3>, point: [u32; 2]) -> FromSky {
        let (direction, texel, cell) = self.pick(normal, point);
        self.from(direction, texel, self.aim.odds(normal, cell.0, cell.1))
    }

    /// As [`sample`](Self::sample), but a quarter of the samples takes no regard of the normal: for light whose
    /// direction is not quite that of the panorama.
    pub fn sample_about(&self, normal: Option<Vec3>, [a, b]: [u32; 2]) -> FromSky {
        const QUARTER: u32 = 1 << 30;
        let (aimed, a) = match a.checked_sub(QUARTER) {
            Some(rest) => (normal, (u64::from(rest) * 4 / 3) as u32),
            None => (None, a << 2),
        };
        let (direction, texel, cell) = self.pick(aimed, [a, b]);
        self.from(direction, texel, self.odds_about(normal, cell))
    }

    fn odds_about(&self, normal: Option<Vec3>, (row, column): (usize, usize)) -> f32 {
        0.75 * self.aim.odds(normal, row, column) + 0.25 * self.aim.odds(None, row, column)
    }

    fn from(&self, direction: Vec3, (x, y): (usize, usize), odds: f32) -> FromSky {
        let [r, g, b, pdf] = self.texels[y * self.width + x];
        FromSky { direction, radiance: Vec3::new(r, g, b), pdf: pdf * odds }
    }

    /// A direction, the column and row of its texel, and the row and column of its cell.
    #[inline]
    fn pick(&self, normal: Option<Vec3>, point: [u32; 2]) -> (Vec3, (usize, usize), (usize, usize)) {
        const SCALE: f64 = 1.0 / 4_294_967_296.0;
        let (row, column, [v, u]) = self.aim.choose(normal, point.map(|p| f64::from(p) * SCALE));
        let (rows, columns) = self.texels_of(row, column);
        let (y, v) = invert(&self.down[column * self.height..][rows.clone()], v);
        let y = rows.start + y;
        let (x, u) = invert(&self.across[y * self.width..][columns.clone()], u);
        let x = columns.start + x;
        // Uniform over the texel's solid angle: uniform in azimuth and in the cosine of the polar angle.
        let above = self.cosines[y] + v * (self.cosines[y + 1] - self.cosines[y]);
        let (sin, cos) = if self.width >= 64 {
            // From the column's left edge by the series of a small angle.
            let a = u * 2.0 * PI / self.width as f64;
            let q = a * a;
            let (s, c) = (a * (1.0 - q / 6.0 * (1.0 - q / 20.0)), 1.0 - q / 2.0 * (1.0 - q / 12.0));
            let (se, ce) = self.edges[x];
            (se * c + ce * s, ce * c - se * s)
        } else {
            num::sin_cos(2.0 * PI * ((x as f64 + u) / self.width as f64 - 0.5))
        };
        let radius = (1.0 - above * above).max(0.0).sqrt();
        (self.world([sin * radius, cos * radius, above]), (x, y), (row, column))
    }

    /// The light from a unit direction.
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (x, y) = self.texel(direction);
        let [r, g, b, _] = self.texels[y * self.width + x];
        Vec3::new(r, g, b)
    }

    /// The sky as a picture behind the scene: between the middles of texels radiance changes linearly. Light
    /// transport takes [`Sky::radiance`], whose sum is exact.
    pub fn seen(&self, direction: Vec3) -> Vec3 {
        let [x, y, z] = self.axes.map(|axis| f64::from(direction.dot(axis)));
        let u = (approximate_turns(x, y) + 0.5) * self.width as f64 - 0.5;
        let v = approximate_turns((x * x + y * y).sqrt(), z) * 2.0 * self.height as f64 - 0.5;
        let v = v.clamp(0.0, (self.height - 1) as f64);
        let (left, top) = (u.floor(), v.floor());
        let (du, dv) = ((u - left) as f32, (v - top) as f32);
        let at = |dx: i64, dy: usize| {
            let column = (left as i64 + dx).rem_euclid(self.width as i64) as usize;
            let row = (top as usize + dy).min(self.height - 1);
            let [r, g, b, _] = self.texels[row * self.width + column];
            Vec3::new(r, g, b)
        };
        let (upper, lower) = (at(0, 0) * (1.0 - du) + at(1, 0) * du, at(0, 1) * (1.0 - du) + at(1, 1) * du);
        upper * (1.0 - dv) + lower * dv
    }

    /// The light from a unit direction, and the density of sampling it for a surface.
    #[inline]
    pub fn lookup(&self, normal: Option<Vec3>, direction: Vec3) -> FromSky {
        let (texel, cell) = self.find(direction);
        self.from(direction, texel, self.aim.odds(normal, cell.0, cell.1))
    }

    /// The light from a unit direction, and the density of [`sample_about`](Self::sample_about).
    pub fn lookup_about(&self, normal: Option<Vec3>, direction: Vec3) -> FromSky {
        let (texel, cell) = self.find(direction);
        self.from(direction, texel, self.odds_about(normal, cell))
    }

    /// The column and row of the texel that a unit direction shows, and the row and column of its cell.
    #[inline]
    fn find(&self, direction: Vec3) -> ((usize, usize), (usize, usize)) {
        let (x, y) = self.texel(direction);
        let cell = |starts: &[usize], texel: usize| starts.partition_point(|&first| first <= texel) - 1;
        ((x, y), (cell(&self.rows, y), cell(&self.columns, x)))
    }

    /// Column and row of the texel that a unit direction shows.
    fn texel(&self, direction: Vec3) -> (usize, usize) {
        let [x, y, z] = self.axes.map(|axis| f64::from(direction.dot(axis)));
        (self.column(x, y), self.row(z, (x * x + y * y).sqrt()))
    }

    /// The row of a direction: a guess by an approximate angle, settled by the exact edges.
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

    /// The column of a direction, likewise.
    fn column(&self, x: f64, y: f64) -> usize {
        let turns = approximate_turns(x, y) + 0.5;
        let column = ((turns * self.width as f64) as usize).min(self.width - 1);
        if self.width < 8 {
            return column;
        }
        // The sine of the angle past an edge tells the side.
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

/// atan2(x, y) / (2 pi) in [-0.5, 0.5], to about 2e-6 turns: an odd polynomial in the smaller ratio, the
/// least-squares fit of atan on [0, 1] at Chebyshev points.
fn approximate_turns(x: f64, y: f64) -> f64 {
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

/// An environment of one colour.
#[cfg(test)]
pub(crate) fn constant(up: engine::Up, radiance: [f32; 3], width: usize) -> Environment {
    let height = (width / 2).max(1);
    let samples = (0..width * height).flat_map(|_| radiance).collect();
    Environment { image: crate::types::Image::from_samples(width, height, 3, samples), up, origin: None }
}

#[cfg(test)]
mod tests {
    use engine::Up;

    use super::*;
    use crate::equirect;
    use crate::sampling::{Points, stream};

    fn noisy(width: usize, height: usize) -> Environment {
        let mut environment = constant(Up::PlusY, [0.0; 3], 2);
        let samples = (0..width * height * 3)
            .map(|i| crate::sampling::unit(crate::sampling::mix(i as u32)).powi_exact())
            .collect();
        environment.image = crate::types::Image::from_samples(width, height, 3, samples);
        environment
    }

    trait PowiExact {
        fn powi_exact(self) -> f32;
    }
    impl PowiExact for f32 {
        // A spiky spectrum without a banned power function.
        fn powi_exact(self) -> f32 {
            let s = self * self;
            s * s * s * 20.0
        }
    }

    #[test]
    fn lookup_agrees_with_the_layout() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            for (width, height) in [(64, 32), (200, 77), (8, 3), (1, 1), (5, 4)] {
                let mut environment = noisy(width, height);
                environment.up = up;
                let sky = Sky::new(&environment);
                for i in 0..4_000_u32 {
                    let [u, v] = Points::new(1, i).pair(0).map(f64::from);
                    let direction = equirect::direction(up, u, v).as_vec3();
                    let (u, v) = equirect::uv(up, direction.as_dvec3());
                    let x = ((u * width as f64) as usize).min(width - 1);
                    let y = ((v * height as f64) as usize).min(height - 1);
                    let found = sky.radiance(direction);
                    let near_edge = |a: f64| (a - a.round()).abs() < 1e-3;
                    if !near_edge(u * width as f64) && !near_edge(v * height as f64) {
                        assert_eq!(found.to_array(), environment.image.rgb(x, y), "{u} {v}");
                    }
                }
            }
        }
    }

    #[test]
    fn samples_lie_in_the_texel_they_claim() {
        let sky = Sky::new(&noisy(128, 64));
        let mut elsewhere = 0;
        for i in 0..20_000 {
            let s = sky.sample(Some(Vec3::Y), Points::new(stream(3, 0, 0), i).bits(0));
            assert!((s.direction.length() - 1.0).abs() < 1e-5);
            elsewhere += u32::from(sky.lookup(Some(Vec3::Y), s.direction) != s);
        }
        assert!(elsewhere < 40, "{elsewhere} of 20000 fall across an edge by rounding");
    }

    // Exact irradiance: radiance times cosine over density, averaged over one net, against the sum over texels
    // cut finely.
    #[test]
    fn sampling_integrates_the_picture() {
        for (width, height) in [(64, 32), (128, 40), (7, 3), (1, 1)] {
            let environment = noisy(width, height);
            let sky = Sky::new(&environment);
            for normal in [Vec3::Y, Vec3::new(0.6, -0.48, 0.64), Vec3::NEG_Z] {
                let (mut exact, sub) = (0.0, 512 / width);
                for y in 0..height * sub {
                    let area = pixel_solid_angle(width * sub, height * sub, y);
                    for x in 0..width * sub {
                        let (u, v) = (
                            (x as f64 + 0.5) / (width * sub) as f64,
                            (y as f64 + 0.5) / (height * sub) as f64,
                        );
                        let cosine = equirect::direction(Up::PlusY, u, v).dot(normal.as_dvec3()).max(0.0);
                        exact +=
                            f64::from(luminance(environment.image.rgb(x / sub, y / sub))) * cosine * area;
                    }
                }
                let n = 1 << 16;
                let mut sum = 0.0;
                for i in 0..n {
                    let s = sky.sample(Some(normal), Points::new(stream(3, 1, 0), i).bits(0));
                    sum += f64::from(
                        luminance(s.radiance.to_array()) / s.pdf * s.direction.dot(normal).max(0.0),
                    );
                }
                let ratio = sum / f64::from(n) / exact;
                let tolerance = if width < 8 { 2e-3 } else { 3e-4 };
                assert!((ratio - 1.0).abs() < tolerance, "{width} {height} {normal}: {ratio}");
            }
        }
    }

    // At the middle of a texel the picture behind the scene is the texel, between two it is their mean.
    #[test]
    fn the_picture_behind_is_smooth() {
        let environment = noisy(64, 32);
        let sky = Sky::new(&environment);
        for (x, y) in [(3, 4), (63, 16), (0, 31)] {
            let seen = |dx: f64| {
                let (u, v) = ((x as f64 + 0.5 + dx) / 64.0, (f64::from(y) + 0.5) / 32.0);
                sky.seen(equirect::direction(Up::PlusY, u, v).as_vec3())
            };
            let texel = |x: usize| Vec3::from_array(environment.image.rgb(x % 64, y as usize));
            assert!((seen(0.0) - texel(x)).length() < 1e-2, "{x} {y}");
            assert!((seen(0.5) - (texel(x) + texel(x + 1)) * 0.5).length() < 1e-2, "{x} {y}");
        }
    }

    // Rows 36 and 37: black, and one texel that outshines all others.
    #[test]
    fn black_and_one_hot_skies_are_sampled() {
        let black = Sky::new(&constant(Up::PlusZ, [0.0; 3], 16));
        let s = black.sample(Some(Vec3::X), [1 << 31, 1 << 30]);
        assert!(s.pdf > 0.0 && s.radiance == Vec3::ZERO);
        let mut environment = constant(Up::PlusZ, [1e-9; 3], 32);
        environment.image.pixel_mut(7, 5).fill(1e9);
        environment.image.pixel_mut(3, 3)[0] = f32::NAN;
        let sky = Sky::new(&environment);
        assert_eq!(sky.broken, 1);
        // Towards the hot texel it is chosen, from behind it never is, and density integrates to 1 anyway.
        let hot = equirect::direction(Up::PlusZ, 7.5 / 32.0, 5.5 / 16.0).as_vec3();
        for normal in [hot, -hot] {
            let density = |x: usize, y: usize| sky.texels[y * 32 + x][3] * sky.aim.odds(Some(normal), y, x);
            let total: f64 = (0..16)
                .flat_map(|y| (0..32).map(move |x| (x, y)))
                .map(|(x, y)| f64::from(density(x, y)) * pixel_solid_angle(32, 16, y))
                .sum();
            assert!((total - 1.0).abs() < 1e-6, "{total}");
        }
        let hottest = |normal| sky.sample(Some(normal), [1 << 31, 1 << 31]).radiance == Vec3::splat(1e9);
        assert!(hottest(hot) && !hottest(-hot));
    }

    // Chi-square of the sampler against its density, by texel, with several texels a cell.
    #[test]
    fn sampler_follows_its_density() {
        let sky = Sky::new(&noisy(80, 40));
        let normal = Vec3::new(0.48, 0.64, -0.6);
        let n = 200_000;
        let mut counts = vec![0.0_f64; 80 * 40];
        for i in 0..n {
            // Scrambled anew for each sample: independent points, as the test assumes.
            let s = sky.sample(Some(normal), Points::new(stream(5, i, 1), 0).bits(0));
            let (x, y) = sky.texel(s.direction);
            counts[y * 80 + x] += 1.0;
        }
        let (mut chi2, mut bins, mut total) = (0.0, 0.0, 0.0);
        for (i, count) in counts.iter().enumerate() {
            let direction =
                equirect::direction(Up::PlusY, (i % 80) as f64 / 80.0 + 1e-3, (i / 80) as f64 / 40.0 + 1e-3);
            let density = f64::from(sky.lookup(Some(normal), direction.as_vec3()).pdf);
            let expected = f64::from(n) * density * pixel_solid_angle(80, 40, i / 80);
            total += expected;
            if expected > 10.0 {
                chi2 += (count - expected) * (count - expected) / expected;
                bins += 1.0;
            }
        }
        assert!((total / f64::from(n) - 1.0).abs() < 1e-4, "{total}");
        assert!(bins > 300.0 && chi2 < bins + 4.5 * f64::sqrt(2.0 * bins), "{chi2} over {bins}");
    }
}
