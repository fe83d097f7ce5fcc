//! The environment as a light: its radiance in a direction, and directions in proportion to it.

use glam::{DMat3, DVec3, Vec3};

use super::crop::greatest_irradiance;
use super::light_cells::{LightCells, RowChoice};
use super::light_distribution::{Cone, LightDistribution};
use super::texel_grid::{TexelGrid, approximate_turns};
use crate::equirect::pixel_solid_angle;
use crate::types::Environment;

/// Light from a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightSample {
    /// Unit direction towards the light, in the world.
    pub direction: Vec3,
    /// Radiance.
    pub radiance: Vec3,
    /// Light samples to be expected a steradian at this direction.
    pub pdf: f32,
}

/// A direction towards light that is not looked up yet, which may wait for memory.
#[derive(Debug, Clone, Copy)]
pub struct DrawnDirection {
    /// Unit direction towards the light, in the world.
    pub direction: Vec3,
    texel: u32,
    /// Light samples to be expected in its cell.
    expected: f32,
}

/// The tiers of a sky: what is bright and small, and the rest.
pub const TIERS: usize = 2;
/// Most columns and rows of the cells of each tier.
const CELLS: [[usize; 2]; TIERS] = [[16, 8], [32, 16]];
/// A texel is bright that outshines the mean of the sky so many times.
const BRIGHT: f64 = 16.0;

/// An environment ready for lookup and sampling. Radiance is constant over each texel, and texels are weighed
/// by their exact solid angle, so no light is lost or won. Suns and lamps are a tier of their own with
/// samples of its own, so that how many fall on them is not left to chance.
#[derive(Debug)]
pub struct EnvironmentLight {
    texel_grid: TexelGrid,
    /// Radiance of each texel, and density at it where its cell is given.
    texels: Vec<[f32; 4]>,
    bright: Vec<bool>,
    tiers: [LightCells; TIERS],
    /// Light samples of each tier where several are taken, powers of 2.
    pub lights: [u32; TIERS],
    /// Samples that were negative or not finite and count as black.
    pub broken: u64,
    /// Integral of radiance over the sphere, for each channel.
    pub power: [f64; 3],
}

/// For each tier where to look for its light.
pub type Distributions<'a> = [&'a LightDistribution; TIERS];

impl EnvironmentLight {
    /// Prepares an environment.
    pub fn new(environment: &Environment) -> Self {
        let image = &environment.image;
        let texel_grid = TexelGrid::new(image.width, image.height, environment.up);
        let TexelGrid { width, height, .. } = texel_grid;
        let (mut broken, mut power) = (0, [0.0; 3]);
        let mut texels = Vec::with_capacity(width * height);
        for y in 0..height {
            let solid_angle = pixel_solid_angle(width, height, y);
            for x in 0..width {
                let rgb = image.rgb(x, y).map(|v| {
                    let good = v.is_finite() && v >= 0.0;
                    broken += u64::from(!good);
                    if good { v } else { 0.0 }
                });
                for (sum, v) in power.iter_mut().zip(rgb) {
                    *sum += f64::from(v) * solid_angle;
                }
                texels.push([rgb[0], rgb[1], rgb[2], 0.0]);
            }
        }
        // Each channel counts by its share of all its light, so that a yellow sun does not leave the blue of the
        // sky to chance. The mean over the sphere is 1 for each channel that has light.
        let scales = power.map(|power| if power > 0.0 { 4.0 * std::f64::consts::PI / power } else { 0.0 });
        let black = power == [0.0; 3];
        let weight = |t: &[f32; 4]| (0..3).map(|k| f64::from(t[k]) * scales[k]).sum::<f64>();
        let weights: Vec<f32> = texels.iter().map(|t| if black { 1.0 } else { weight(t) as f32 }).collect();
        let bright: Vec<bool> = weights.iter().map(|&w| f64::from(w) > 3.0 * BRIGHT).collect();
        let mut pdf = vec![0.0; weights.len()];
        let mut tier = |k: usize| {
            let mine = |(w, bright): (&f32, &bool)| if *bright == (k == 0) { *w } else { 0.0 };
            let weights: Vec<f32> = weights.iter().zip(&bright).map(mine).collect();
            let mut of_tier = vec![0.0; weights.len()];
            let cells = LightCells::new(&texel_grid, weights, CELLS[k], &mut of_tier);
            for ((to, from), bright) in pdf.iter_mut().zip(of_tier).zip(&bright) {
                *to = if *bright == (k == 0) { from } else { *to };
            }
            cells
        };
        let tiers = [tier(0), tier(1)];
        for (texel, pdf) in texels.iter_mut().zip(pdf) {
            texel[3] = pdf;
        }
        let [high, low] = [0, 1].map(|k| tiers[k].grid.cells.iter().map(|cell| cell.power).sum::<f64>());
        let share = (high / (high + low)) as f32;
        let lights = match share {
            0.0 => [0, 4],
            ..0.7 => [1, 4],
            _ => [2, 2],
        };
        Self { texel_grid, texels, bright, tiers, lights, broken, power }
    }

    /// The greatest radiance, and the greatest irradiance of any surface, for each channel; neither is more.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let mut brightest = [0.0_f32; 4];
        let (mut towards, mut squares) = ([DVec3::ZERO; 3], [DMat3::ZERO; 3]);
        // For each column 1, its sine and cosine, and products of these.
        let columns: Vec<_> =
            self.texel_grid.edges.iter().map(|(s, c)| [1.0, *s, *c, s * s, s * c]).collect();
        for (y, row) in self.texels.chunks_exact(self.texel_grid.width).enumerate() {
            // Sums over the row of the light times these: of all channels at once, the fourth is none.
            let mut sums = [[0.0_f64; 4]; 5];
            for (texel, column) in row.iter().zip(&columns) {
                let light = texel.map(f64::from);
                for (sums, factor) in sums.iter_mut().zip(column) {
                    (0..4).for_each(|k| sums[k] += light[k] * factor);
                }
                (0..4).for_each(|k| brightest[k] = brightest[k].max(texel[k]));
            }
            let above = 0.5 * (self.texel_grid.cosines[y] + self.texel_grid.cosines[y + 1]);
            let (radius, solid_angle) = ((1.0 - above * above).sqrt(), self.texel_grid.solid_angle(y));
            let square = radius * radius;
            for k in 0..3 {
                let [light, x, y, xx, xy] = sums.map(|sum| sum[k] * solid_angle);
                let (xz, yz) = (x * radius * above, y * radius * above);
                towards[k] += DVec3::new(x * radius, y * radius, light * above);
                squares[k] += DMat3::from_cols(
                    DVec3::new(xx * square, xy * square, xz),
                    DVec3::new(xy * square, (light - xx) * square, yz),
                    DVec3::new(xz, yz, light * above * above),
                );
            }
        }
        // Each texel counts as if all of its light came from one point of it.
        let irradiance = std::array::from_fn(|k| {
            greatest_irradiance(self.power[k], towards[k], squares[k])
                + 2.0 * self.texel_grid.radius() * self.power[k]
        });
        let brightest = [0, 1, 2].map(|k| f64::from(brightest[k]));
        (brightest, irradiance)
    }

    /// Visits the texels that reach into a cone, and perhaps some around it: the direction of a point of each, how far
    /// others of it may lie from that, its solid angle and its radiance.
    pub fn each_around(&self, cone: &Cone, mut each: impl FnMut(DVec3, f64, f64, [f64; 3])) {
        let radius = 2.0 * self.texel_grid.radius();
        self.texel_grid.each_around(cone, |x, y| {
            let direction = self.texel_grid.within((x, y), [0.5; 2]).as_dvec3();
            let [r, g, b, _] = self.texels[y * self.texel_grid.width + x];
            each(direction, radius, self.texel_grid.solid_angle(y), [r, g, b].map(f64::from));
        });
    }

    /// Where to look for a surface of the given unit normal, if light from one side is all it takes.
    #[inline]
    pub fn distributions(&self, normal: Option<Vec3>) -> Distributions<'_> {
        [self.tiers[0].distribution(normal), self.tiers[1].distribution(normal)]
    }

    /// Where to look for surfaces whose normals lie in a cone, for light from a cone of directions.
    pub fn distributions_within(&self, normals: Option<Cone>, to: &Cone) -> [LightDistribution; TIERS] {
        [0, 1].map(|k| LightDistribution::new(&self.tiers[k].grid, normals, to))
    }

    /// Light samples to be expected of each tier: where several are taken, or of one alone.
    #[inline]
    pub fn numbers(&self, distributions: Distributions<'_>, several: Option<[u32; TIERS]>) -> [f32; TIERS] {
        let [high, low] = distributions.map(|distribution| distribution.power);
        match (several, high + low > 0.0) {
            (Some(lights), _) => lights.map(|n| n as f32),
            (None, true) => [high, low].map(|power| (power / (high + low)) as f32),
            (None, false) => [0.0; TIERS],
        }
    }

    /// The tier of a light sample that is alone, and its point.
    #[inline]
    pub fn tier(&self, distributions: Distributions<'_>, [v, u]: [u32; 2]) -> (usize, [u32; 2]) {
        let share = f64::from(self.numbers(distributions, None)[0]);
        let at = f64::from(v) * SCALE;
        let (tier, at) = if at < share { (0, at / share) } else { (1, (at - share) / (1.0 - share)) };
        // The conversion keeps to the range of the type.
        (tier, [(at / SCALE) as u32, u])
    }

    /// Directions of tiers, each from two 32-bit fractions: about in proportion to light times cosine. They may
    /// lie a little below the horizon, never so much that light above it is left out. `numbers` are those
    /// of light samples in each tier.
    #[inline]
    pub fn draw<const N: usize>(
        &self,
        distributions: Distributions<'_>,
        numbers: [f32; TIERS],
        draws: &[(usize, [u32; 2])],
    ) -> [Option<DrawnDirection>; N] {
        // In halves, so that all wait for memory together.
        let mut rows = [RowChoice::default(); N];
        for (row, (tier, point)) in rows.iter_mut().zip(draws) {
            *row = self.tiers[*tier].row(distributions[*tier], point.map(|p| f64::from(p) * SCALE));
        }
        let mut found = [None; N];
        for (slot, (row, (tier, _))) in found.iter_mut().zip(rows.iter().zip(draws)) {
            let (texel, place) = self.tiers[*tier].texel(row);
            let direction = self.texel_grid.within(texel, place);
            let texel = (texel.1 * self.texel_grid.width + texel.0) as u32;
            *slot = Some(DrawnDirection { direction, texel, expected: numbers[*tier] * row.probability });
        }
        found
    }

    /// The light of a direction that was drawn.
    #[inline]
    pub fn light(&self, &DrawnDirection { direction, texel, expected }: &DrawnDirection) -> LightSample {
        let [r, g, b, pdf] = self.texels[texel as usize];
        LightSample { direction, radiance: Vec3::new(r, g, b), pdf: expected * pdf }
    }

    /// [`draw`](Self::draw), looked up.
    #[inline]
    pub fn sample<const N: usize>(
        &self,
        distributions: Distributions<'_>,
        numbers: [f32; TIERS],
        draws: &[(usize, [u32; 2])],
    ) -> [Option<LightSample>; N] {
        self.draw(distributions, numbers, draws).map(|drawn| drawn.map(|drawn| self.light(&drawn)))
    }

    /// A light sample that is alone, for a surface whose light comes from one side, or from all; none where no
    /// light comes from there.
    pub fn sample_one(&self, normal: Option<Vec3>, point: [u32; 2]) -> Option<LightSample> {
        let distributions = self.distributions(normal);
        let [found] = match distributions.iter().any(|distribution| distribution.power > 0.0) {
            true => self.sample(
                distributions,
                self.numbers(distributions, None),
                &[self.tier(distributions, point)],
            ),
            false => [None],
        };
        found
    }

    /// As [`sample_one`](Self::sample_one), but a quarter of the samples takes no regard of the normal: for light whose direction
    /// is not quite that of the panorama.
    pub fn sample_defensive(&self, normal: Option<Vec3>, [a, b]: [u32; 2]) -> Option<LightSample> {
        const QUARTER: u32 = 1 << 30;
        let (aimed, a) = match a.checked_sub(QUARTER) {
            Some(rest) => (normal, (u64::from(rest) * 4 / 3) as u32),
            None => (None, a << 2),
        };
        Some(self.eval_defensive(normal, self.sample_one(aimed, [a, b])?.direction))
    }

    /// The light from a unit direction, and the density of [`sample_defensive`](Self::sample_defensive).
    pub fn eval_defensive(&self, normal: Option<Vec3>, direction: Vec3) -> LightSample {
        let (aimed, any) = (self.eval_one(normal, direction), self.eval_one(None, direction));
        LightSample { pdf: 0.75 * aimed.pdf + 0.25 * any.pdf, ..aimed }
    }

    /// The light from a unit direction, and the density of [`sample_one`](Self::sample_one).
    pub fn eval_one(&self, normal: Option<Vec3>, direction: Vec3) -> LightSample {
        let distributions = self.distributions(normal);
        self.eval(distributions, self.numbers(distributions, None), direction)
    }

    /// The light from a unit direction.
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (x, y) = self.texel_grid.texel(direction);
        let [r, g, b, _] = self.texels[y * self.texel_grid.width + x];
        Vec3::new(r, g, b)
    }

    /// The sky as a picture behind the scene: between the middles of texels radiance changes linearly. Light
    /// transport takes [`EnvironmentLight::radiance`], whose sum is exact.
    pub fn background(&self, direction: Vec3) -> Vec3 {
        let [x, y, z] = self.texel_grid.axes.map(|axis| f64::from(direction.dot(axis)));
        let u = (approximate_turns(x, y) + 0.5) * self.texel_grid.width as f64 - 0.5;
        let v = approximate_turns((x * x + y * y).sqrt(), z) * 2.0 * self.texel_grid.height as f64 - 0.5;
        let v = v.clamp(0.0, (self.texel_grid.height - 1) as f64);
        let (left, top) = (u.floor(), v.floor());
        let (du, dv) = ((u - left) as f32, (v - top) as f32);
        let at = |dx: i64, dy: usize| {
            let column = (left as i64 + dx).rem_euclid(self.texel_grid.width as i64) as usize;
            let row = (top as usize + dy).min(self.texel_grid.height - 1);
            let [r, g, b, _] = self.texels[row * self.texel_grid.width + column];
            Vec3::new(r, g, b)
        };
        let (upper, lower) = (at(0, 0) * (1.0 - du) + at(1, 0) * du, at(0, 1) * (1.0 - du) + at(1, 1) * du);
        upper * (1.0 - dv) + lower * dv
    }

    /// The light from a unit direction, and the density of sampling it.
    #[inline]
    pub fn eval(
        &self,
        distributions: Distributions<'_>,
        numbers: [f32; TIERS],
        direction: Vec3,
    ) -> LightSample {
        let texel = self.texel_grid.texel(direction);
        let at = texel.1 * self.texel_grid.width + texel.0;
        let [r, g, b, pdf] = self.texels[at];
        let tier = usize::from(!self.bright[at]);
        let pdf = numbers[tier] * self.tiers[tier].probability(distributions[tier], texel) * pdf;
        LightSample { direction, radiance: Vec3::new(r, g, b), pdf }
    }
}

/// From 32-bit fractions.
const SCALE: f64 = 1.0 / 4_294_967_296.0;

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
    use crate::testing::{chi_square, row};

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
                let sky = EnvironmentLight::new(&environment);
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
        let sky = EnvironmentLight::new(&noisy(128, 64));
        let mut elsewhere = 0;
        for i in 0..20_000 {
            let s = sky.sample_one(Some(Vec3::Y), Points::new(stream(3, 0, 0), i).bits(0)).expect("light");
            assert!((s.direction.length() - 1.0).abs() < 1e-5);
            elsewhere += u32::from(sky.eval_one(Some(Vec3::Y), s.direction) != s);
        }
        assert!(elsewhere < 40, "{elsewhere} of 20000 fall across an edge by rounding");
    }

    // Exact irradiance: radiance times cosine over density, averaged over one net, against the sum over texels
    // cut finely.
    #[test]
    fn sampling_integrates_the_picture() {
        for (width, height) in [(64, 32), (128, 40), (7, 3), (1, 1)] {
            let environment = noisy(width, height);
            let sky = EnvironmentLight::new(&environment);
            // Each channel by its share, as samples follow it.
            let weight =
                |rgb: [f32; 3]| (0..3).map(|k| f64::from(rgb[k]) / sky.power[k].max(1e-30)).sum::<f64>();
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
                        exact += weight(environment.image.rgb(x / sub, y / sub)) * cosine * area;
                    }
                }
                let (n, distributions) = (1 << 14, sky.distributions(Some(normal)));
                let mut sum = 0.0;
                for i in 0..n {
                    // As the first vertex of a path does: of each tier a net of its own.
                    let points = Points::new(stream(3, 1, 0), i);
                    let lit = (0..TIERS).filter(|&tier| distributions[tier].power > 0.0);
                    let draws = lit.flat_map(|tier| {
                        let count = sky.lights[tier];
                        (0..count).map(move |k| (tier, points.twig(k, count).bits(tier as u32)))
                    });
                    let draws: Vec<_> = draws.collect();
                    for s in sky
                        .sample::<8>(distributions, sky.numbers(distributions, Some(sky.lights)), &draws)
                        .into_iter()
                        .flatten()
                    {
                        let cosine = s.direction.dot(normal).max(0.0);
                        sum += weight(s.radiance.to_array()) * f64::from(cosine / s.pdf);
                    }
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
        let sky = EnvironmentLight::new(&environment);
        for (x, y) in [(3, 4), (63, 16), (0, 31)] {
            let seen = |dx: f64| {
                let (u, v) = ((x as f64 + 0.5 + dx) / 64.0, (f64::from(y) + 0.5) / 32.0);
                sky.background(equirect::direction(Up::PlusY, u, v).as_vec3())
            };
            let texel = |x: usize| Vec3::from_array(environment.image.rgb(x % 64, y as usize));
            assert!((seen(0.0) - texel(x)).length() < 1e-2, "{x} {y}");
            assert!((seen(0.5) - (texel(x) + texel(x + 1)) * 0.5).length() < 1e-2, "{x} {y}");
        }
    }

    #[test]
    fn row_36_a_black_sky_is_sampled_evenly() {
        let black = EnvironmentLight::new(&constant(Up::PlusZ, [0.0; 3], 16));
        assert_eq!(black.power, [0.0; 3]);
        for normal in [None, Some(Vec3::X), Some(Vec3::NEG_Z)] {
            for i in 0..64 {
                let s = black.sample_one(normal, Points::new(3, i).bits(0)).expect("a direction");
                assert!(s.pdf > 0.0 && s.pdf.is_finite() && s.radiance == Vec3::ZERO, "{s:?}");
                assert!((s.direction.length() - 1.0).abs() < 1e-5);
            }
        }
    }

    /// Towards the hot texel it is chosen, from behind it never is; its light is found in full either way.
    #[test]
    fn row_37_one_texel_may_outshine_all_others() {
        let mut environment = constant(Up::PlusZ, [1e-9; 3], 32);
        environment.image.pixel_mut(7, 5).fill(1e9);
        environment.image.pixel_mut(3, 3)[0] = f32::NAN;
        let sky = EnvironmentLight::new(&environment);
        assert_eq!(sky.broken, 1);
        let at = |x: f64, y: f64| equirect::direction(Up::PlusZ, x / 32.0, y / 16.0);
        let hot = at(7.5, 5.5).as_vec3();
        let mut off = 0.0_f64;
        for normal in [hot, -hot] {
            let pdf = |x: usize, y: usize| {
                sky.eval_one(Some(normal), at(x as f64 + 0.5, y as f64 + 0.5).as_vec3()).pdf
            };
            let total: f64 = (0..16)
                .flat_map(|y| (0..32).map(move |x| (x, y)))
                .map(|(x, y)| f64::from(pdf(x, y)) * pixel_solid_angle(32, 16, y))
                .sum();
            off = off.max((total - 1.0).abs());
        }
        row(37, "integral of the density over the sphere, less 1", off, 1e-6);
        let hottest =
            |normal| sky.sample_one(Some(normal), [1 << 31, 1 << 31]).expect("light").radiance.x == 1e9;
        assert!(hottest(hot) && !hottest(-hot));
        // Irradiance of a surface that faces it: its texel cut finely, against samples as a first vertex has them.
        let fine = 64;
        let cosines = (0..fine * fine).map(|i| {
            let [u, v] = [i % fine, i / fine].map(|k| (f64::from(k) + 0.5) / f64::from(fine));
            at(7.0 + u, 5.0 + v).dot(hot.as_dvec3())
        });
        let mean = cosines.sum::<f64>() / f64::from(fine * fine);
        let (distributions, n) = (sky.distributions(Some(hot)), 1 << 12);
        let arrived = |i| {
            let draws: Vec<_> =
                (0..sky.lights[0]).map(|k| Points::new(5, i).twig(k, sky.lights[0])).collect();
            let draws: Vec<_> = draws.iter().map(|points| (0, points.bits(0))).collect();
            let found = sky
                .sample::<8>(distributions, sky.numbers(distributions, Some(sky.lights)), &draws)
                .into_iter()
                .flatten();
            found.map(|s| f64::from(s.radiance.x * s.direction.dot(hot) / s.pdf)).sum::<f64>()
        };
        let got = (0..n).map(arrived).sum::<f64>() / f64::from(n);
        let exact = 1e9 * pixel_solid_angle(32, 16, 5) * mean;
        row(37, "relative error of the irradiance of 4096 points", (got / exact - 1.0).abs(), 1e-4);
    }

    /// Chi-square of samples against the density that they claim, by quarters of texels.
    fn follows(
        what: &str,
        sky: &EnvironmentLight,
        draw: impl Fn(u32) -> Vec<LightSample>,
        pdf: impl Fn(Vec3) -> f32,
    ) {
        let (n, [width, height]) = (100_000, [sky.texel_grid.width, sky.texel_grid.height].map(|k| 2 * k));
        let place = |bin: usize| [(bin % width) as f64 + 0.5, (bin / width) as f64 + 0.5];
        let towards = |bin: usize| {
            let [x, y] = place(bin);
            equirect::direction(Up::PlusY, x / width as f64, y / height as f64).as_vec3()
        };
        let mut counts = vec![0.0; width * height];
        for sample in (0..n).flat_map(draw) {
            let (u, v) = equirect::uv(Up::PlusY, sample.direction.as_dvec3());
            let [x, y] =
                [(u, width), (v, height)].map(|(at, size)| ((at * size as f64) as usize).min(size - 1));
            counts[y * width + x] += 1.0;
            let told = pdf(sample.direction);
            // Rounding may move a direction across an edge.
            let same = (sample.pdf - told).abs() <= 1e-3 * told;
            assert!(
                same || sky.radiance(sample.direction) != sample.radiance,
                "{what}: {sample:?} for {told}"
            );
        }
        let density = |bin| f64::from(n) * f64::from(pdf(towards(bin)));
        let expected: Vec<f64> = (0..counts.len())
            .map(|bin| density(bin) * pixel_solid_angle(width, height, bin / width))
            .collect();
        let all = expected.iter().sum::<f64>() / counts.iter().sum::<f64>();
        assert!((all - 1.0).abs() < 1e-3, "{what}: the density integrates to {all}");
        let z = chi_square(&counts, &expected);
        assert!(z < 4.0, "{what}: {z}");
    }

    /// Every way to draw directions: tiers, cells, texels and places in them.
    /// Mutation: `numbers[tier]` left out of `EnvironmentLight::eval`, `share(rows, row)` of `LightDistribution::probability`
    /// squared, `of_row` left out of `LightCells::divide`, `v` squared in `TexelGrid::within`, `0.75` and `0.25` of
    /// `eval_defensive` swapped (each seen red).
    #[test]
    fn samples_follow_their_densities() {
        let mut lamps = noisy(24, 12);
        for (x, y) in [(3, 2), (4, 2), (17, 9)] {
            lamps.image.pixel_mut(x, y).copy_from_slice(&[900.0, 300.0, 700.0]);
        }
        let point = |i: u32, pair: u32| Points::new(stream(5, i, 1), 0).bits(pair);
        let normal = Vec3::new(0.48, 0.64, -0.6);
        for (name, environment) in [("noise", noisy(80, 20)), ("lamps", lamps), ("one texel", noisy(1, 1))] {
            let sky = &EnvironmentLight::new(&environment);
            for side in [None, Some(normal)] {
                let what = format!("{name}, {side:?}");
                let one = |i| sky.sample_one(side, point(i, 0)).into_iter().collect();
                follows(&what, sky, one, |d| sky.eval_one(side, d).pdf);
                let defensive = |i| sky.sample_defensive(side, point(i, 0)).into_iter().collect();
                follows(&format!("{what}, defensive"), sky, defensive, |d| sky.eval_defensive(side, d).pdf);
            }
            // As the first vertex of a path draws them: several of each tier, for the normals of a tile, and from where
            // the objects are seen.
            let normals = Cone { axis: normal, cosine: 0.995 };
            for to in [Cone::ALL, Cone { axis: normal, cosine: 0.3 }] {
                let distributions = sky.distributions_within(Some(normals), &to);
                let distributions = distributions.each_ref();
                // A tier without light there is not drawn from.
                let lights = [0, 1].map(|k| if distributions[k].power > 0.0 { sky.lights[k] } else { 0 });
                let numbers = sky.numbers(distributions, Some(lights));
                let several = |i| -> Vec<LightSample> {
                    let tier =
                        |tier: usize| (0..lights[tier]).map(move |k| (tier, point(i, 2 * k + tier as u32)));
                    let draws: Vec<_> = (0..TIERS).flat_map(tier).collect();
                    sky.sample::<8>(distributions, numbers, &draws).into_iter().flatten().collect()
                };
                let what = format!("{name}, several within {}", to.cosine);
                follows(&what, sky, several, |d| sky.eval(distributions, numbers, d).pdf);
            }
        }
    }
}
