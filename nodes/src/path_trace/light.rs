//! The environment as a light: its radiance in a direction, and directions in proportion to it.

use std::f64::consts::PI;

use glam::Vec3;

use crate::color::luminance;
use crate::equirect::{axes, pixel_solid_angle};
use crate::num;
use crate::sampling::Discrete;
use crate::types::Environment;

/// Light from a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FromSky {
    /// Unit direction towards the light, in the world.
    pub direction: Vec3,
    /// Radiance.
    pub radiance: Vec3,
    /// Density of [`Sky::sample`] at this direction, per steradian.
    pub pdf: f32,
}

/// An environment ready for lookup and sampling. Radiance is constant over each texel, and the density
/// is the texel's luminance over the exact total, so sampling integrates the picture without error.
#[derive(Debug)]
pub struct Sky {
    width: usize,
    height: usize,
    axes: [Vec3; 3],
    /// Radiance and density of each texel.
    texels: Vec<[f32; 4]>,
    rows: Discrete,
    columns: Vec<Discrete>,
    /// (sine, cosine) of the azimuth of each column's left edge; the last closes the circle.
    edges: Vec<(f64, f64)>,
    /// Cosine of the polar angle of each row's upper edge; the last is -1.
    cosines: Vec<f64>,
    /// Samples that were negative or not finite and count as black.
    pub broken: u64,
    /// Integral of radiance over the sphere, for each channel.
    pub power: [f64; 3],
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
            rows: Discrete::new(&[]).0,
            columns: Vec::with_capacity(height),
            edges: Vec::with_capacity(width + 1),
            cosines: (0..=height).map(|y| num::f64::cos(PI * y as f64 / height as f64)).collect(),
            broken: 0,
            power: [0.0; 3],
        };
        sky.cosines[height] = -1.0;
        sky.edges.extend((0..=width).map(|x| num::sin_cos(2.0 * PI * (x as f64 / width as f64 - 0.5))));
        let mut row_weights = Vec::with_capacity(height);
        for y in 0..height {
            let solid_angle = pixel_solid_angle(width, height, y);
            let mut weights = Vec::with_capacity(width);
            for x in 0..width {
                let rgb = image.rgb(x, y).map(|v| {
                    let good = v.is_finite() && v >= 0.0;
                    sky.broken += u64::from(!good);
                    if good { v } else { 0.0 }
                });
                for (sum, v) in sky.power.iter_mut().zip(rgb) {
                    *sum += f64::from(v) * solid_angle;
                }
                weights.push(f64::from(luminance(rgb)));
                sky.texels.push([rgb[0], rgb[1], rgb[2], 0.0]);
            }
            let (columns, sum) = Discrete::new(&weights);
            sky.columns.push(columns);
            row_weights.push(sum * solid_angle);
        }
        let black = row_weights.iter().all(|&w| w == 0.0);
        if black {
            row_weights = (0..height).map(|y| pixel_solid_angle(width, height, y)).collect();
        }
        sky.rows = Discrete::new(&row_weights).0;
        for y in 0..height {
            let solid_angle = pixel_solid_angle(width, height, y);
            for x in 0..width {
                let probability = sky.rows.probability(y) * sky.columns[y].probability(x);
                sky.texels[y * width + x][3] = (probability / solid_angle) as f32;
            }
        }
        sky
    }

    fn at(&self, direction: Vec3, index: usize) -> FromSky {
        let [r, g, b, pdf] = self.texels[index];
        FromSky { direction, radiance: Vec3::new(r, g, b), pdf }
    }

    /// A direction in proportion to luminance, from two 32-bit fractions.
    #[inline]
    pub fn sample(&self, point: [u32; 2]) -> FromSky {
        const SCALE: f64 = 1.0 / 4_294_967_296.0;
        let (y, v) = self.rows.sample(f64::from(point[0]) * SCALE);
        let (x, u) = self.columns[y].sample(f64::from(point[1]) * SCALE);
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
        let local = [(sin * radius) as f32, (cos * radius) as f32, above as f32];
        let direction = self.axes[0] * local[0] + self.axes[1] * local[1] + self.axes[2] * local[2];
        self.at(direction, y * self.width + x)
    }

    /// The light from a unit direction.
    #[inline]
    pub fn lookup(&self, direction: Vec3) -> FromSky {
        let [x, y, z] = self.axes.map(|axis| f64::from(direction.dot(axis)));
        self.at(direction, self.row(z, (x * x + y * y).sqrt()) * self.width + self.column(x, y))
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
                    let found = sky.lookup(direction);
                    let near_edge = |a: f64| (a - a.round()).abs() < 1e-3;
                    if !near_edge(u * width as f64) && !near_edge(v * height as f64) {
                        assert_eq!(found.radiance.to_array(), environment.image.rgb(x, y), "{u} {v}");
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
            let s = sky.sample(Points::new(stream(3, 0, 0), i).bits(0));
            assert!((s.direction.length() - 1.0).abs() < 1e-5);
            elsewhere += u32::from(sky.lookup(s.direction) != s);
        }
        assert!(elsewhere < 40, "{elsewhere} of 20000 fall across an edge by rounding");
    }

    // Exact texel sum: radiance over density, averaged over one net, is the power to sampling error of the
    // colour alone; for a grey picture it is exact.
    #[test]
    fn sampling_integrates_the_picture() {
        let mut environment = noisy(64, 32);
        for pixel in environment.image.samples.chunks_exact_mut(3) {
            pixel[1] = pixel[0];
            pixel[2] = pixel[0];
        }
        let sky = Sky::new(&environment);
        for i in 0..64 {
            let s = sky.sample(Points::new(stream(3, 1, 0), i).bits(0));
            let estimate = f64::from(s.radiance.x / s.pdf);
            assert!((estimate / sky.power[0] - 1.0).abs() < 1e-5, "{estimate} {}", sky.power[0]);
        }
        let total: f64 = (0..32)
            .map(|y| {
                let row: f64 = (0..64).map(|x| f64::from(environment.image.rgb(x, y)[0])).sum();
                row * pixel_solid_angle(64, 32, y)
            })
            .sum();
        assert!((sky.power[0] / total - 1.0).abs() < 1e-12);
    }

    // Rows 36 and 37: black, and one texel that outshines all others.
    #[test]
    fn black_and_one_hot_skies_are_sampled() {
        let black = Sky::new(&constant(Up::PlusZ, [0.0; 3], 16));
        let s = black.sample([1 << 31, 1 << 30]);
        assert!((s.pdf - 0.25 / std::f32::consts::PI).abs() < 1e-6 && s.radiance == Vec3::ZERO);
        let mut environment = constant(Up::PlusZ, [1e-9; 3], 32);
        environment.image.pixel_mut(7, 5).fill(1e9);
        environment.image.pixel_mut(3, 3)[0] = f32::NAN;
        let sky = Sky::new(&environment);
        assert_eq!(sky.broken, 1);
        let total: f64 = (0..16)
            .flat_map(|y| (0..32).map(move |x| (x, y)))
            .map(|(x, y)| f64::from(sky.texels[y * 32 + x][3]) * pixel_solid_angle(32, 16, y))
            .sum();
        assert!((total - 1.0).abs() < 1e-6, "{total}");
        let s = sky.sample([1 << 31, 1 << 31]);
        assert_eq!(s.radiance, Vec3::splat(1e9));
    }

    // Chi-square of the sampler against its density, by texel.
    #[test]
    fn sampler_follows_its_density() {
        let sky = Sky::new(&noisy(16, 8));
        let n = 200_000;
        let mut counts = vec![0.0_f64; 128];
        for i in 0..n {
            // Scrambled anew for each sample: independent points, as the test assumes.
            let s = sky.sample(Points::new(stream(5, i, 1), 0).bits(0));
            let (u, v) = equirect::uv(Up::PlusY, s.direction.as_dvec3());
            counts[((v * 8.0) as usize).min(7) * 16 + ((u * 16.0) as usize).min(15)] += 1.0;
        }
        let mut chi2 = 0.0;
        for (i, count) in counts.iter().enumerate() {
            let expected = f64::from(n) * f64::from(sky.texels[i][3]) * pixel_solid_angle(16, 8, i / 16);
            if expected > 5.0 {
                chi2 += (count - expected) * (count - expected) / expected;
            }
        }
        // 127 degrees of freedom: mean 127, standard deviation 16.
        assert!(chi2 < 127.0 + 4.0 * 16.0, "{chi2}");
    }
}
