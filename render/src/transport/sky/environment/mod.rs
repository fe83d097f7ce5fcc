//! Environment as a light source: radiance by direction, and importance sampling.

use fearless_simd::{Level, dispatch, prelude::*};
use glam::{DMat3, DVec3, Vec3};
use scene::math::equirect::pixel_solid_angle;
use scene::types::Environment;

use crate::geometry::sampling::fraction;
use crate::transport::sky::cone::Cone;
use crate::transport::sky::irradiance_bound::greatest_irradiance;
use crate::transport::sky::light_cells::{LightCells, RowChoice};
use crate::transport::sky::light_distribution::LightDistribution;
use crate::transport::sky::texel_grid::{TexelGrid, approximate_turns};

#[cfg(test)]
mod tests;

/// Sample of environment light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightSample {
    /// Unit direction towards the light, in the world.
    pub direction: Vec3,
    /// Radiance.
    pub radiance: Vec3,
    /// Expected number of light samples per steradian in this direction.
    pub pdf: f32,
}

/// Sampled direction whose radiance is not loaded yet, so that memory accesses can overlap.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DrawnDirection {
    /// Unit direction towards the light, in the world.
    pub direction: Vec3,
    texel: u32,
    /// Expected number of light samples in the cell of the direction.
    expected: f32,
}

/// Texel of a direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TexelFound {
    /// Tier of the texel.
    pub(crate) tier: usize,
    /// Row and column of the cell of this tier that contains the texel.
    pub(crate) cell: (usize, usize),
    /// Radiance.
    pub(crate) radiance: Vec3,
    /// Density of the texel within its cell.
    pub(crate) pdf: f32,
}

/// Number of tiers of a sky: small bright sources, and the rest.
pub const TIERS: usize = 2;
/// Maximum number of columns and rows of cells of each tier.
const CELLS: [[usize; 2]; TIERS] = [[16, 8], [32, 16]];
/// Ratio of a texel's radiance to the mean radiance above which the texel belongs to the bright tier.
const BRIGHT: f64 = 16.0;

/// An environment prepared for lookup and sampling. Radiance is constant over each texel, and texels are
/// weighted by their exact solid angle, so energy is preserved. Suns and lamps form a tier with separate
/// samples, so the number of samples that they receive is not random.
#[derive(Debug)]
pub struct EnvironmentLight {
    pub(crate) texel_grid: TexelGrid,
    /// Radiance of each texel, and the density of the texel within its cell. The sign bit of the density is set for
    /// texels of the bright tier.
    pub(crate) texels: Vec<[f32; 4]>,
    pub(crate) tiers: [LightCells; TIERS],
    /// SIMD level. Every level gives the same bits.
    pub(crate) level: Level,
    /// Number of light samples per tier at vertices that take several, each a power of 2.
    pub lights: [u32; TIERS],
    /// Number of light samples per tier at vertices that take several under near light, in total 3.
    pub near_lights: [u32; TIERS],
    /// Number of channel values that were negative or not finite and were replaced with 0.
    pub broken: u64,
    /// Integral of radiance over the sphere, per channel.
    pub power: [f64; 3],
}

/// Distribution of each tier.
pub type Distributions<'a> = [&'a LightDistribution; TIERS];

impl EnvironmentLight {
    /// Approximate memory use in bytes, for the texels and their probabilities.
    pub fn bytes(&self) -> u64 {
        2 * size_of_val(&*self.texels) as u64
    }

    /// Prepares an environment for lookup and sampling.
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
        // Each channel is weighted by its share of that channel's total light, so that a yellow sun does not leave
        // the blue of the sky noisy. The mean over the sphere is 1 for each channel that has light.
        let scales = power.map(|power| if power > 0.0 { 4.0 * std::f64::consts::PI / power } else { 0.0 });
        let black = power == [0.0; 3];
        let weight = |t: &[f32; 4]| (0..3).map(|k| f64::from(t[k]) * scales[k]).sum::<f64>();
        let weights: Vec<f32> = texels.iter().map(|t| if black { 1.0 } else { weight(t) as f32 }).collect();
        let bright: Vec<bool> = weights.iter().map(|&w| f64::from(w) > 3.0 * BRIGHT).collect();
        // A panorama may have 100 million texels. To save memory, there is only one list of weights per tier, and
        // the densities are stored in the texels.
        let of_bright =
            weights.iter().zip(&bright).map(|(weight, bright)| if *bright { *weight } else { 0.0 });
        let high: Vec<f32> = of_bright.collect();
        let mut low = weights;
        low.iter_mut().zip(&bright).filter(|(_, bright)| **bright).for_each(|(weight, _)| *weight = 0.0);
        let mut tier = |k: usize, weights: Vec<f32>| {
            LightCells::new(&texel_grid, weights, CELLS[k], &mut |texel, pdf| {
                if bright[texel] == (k == 0) {
                    texels[texel][3] = if k == 0 { -pdf } else { pdf };
                }
            })
        };
        let tiers = [tier(0, high), tier(1, low)];
        let [high, low] = [0, 1].map(|k| tiers[k].grid.power());
        let share = (high / (high + low)) as f32;
        let lights = match share {
            0.0 => [0, 4],
            ..0.7 => [1, 4],
            _ => [2, 2],
        };
        // Three in every case, so that the cost does not depend on the sky.
        let near_lights = match share {
            0.0 => [0, 3],
            1.0.. => [3, 0],
            ..0.7 => [1, 2],
            _ => [2, 1],
        };
        Self { texel_grid, texels, tiers, level: Level::new(), lights, near_lights, broken, power }
    }

    /// Maximum radiance, and an upper bound of the irradiance of any surface, per channel.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let mut brightest = [0.0_f32; 4];
        let (mut towards, mut squares) = ([DVec3::ZERO; 3], [DMat3::ZERO; 3]);
        // For each column 1, sine and cosine of the azimuth, and their products.
        let columns: Vec<_> =
            self.texel_grid.edges.iter().map(|(s, c)| [1.0, *s, *c, s * s, s * c]).collect();
        for (y, row) in self.texels.chunks_exact(self.texel_grid.width).enumerate() {
            // Sums over the row of radiance times these, for all channels at once; the fourth is unused.
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
        // Each texel counts as if all of its light came from one of its points.
        let irradiance = std::array::from_fn(|k| {
            greatest_irradiance(self.power[k], towards[k], squares[k])
                + 2.0 * self.texel_grid.radius() * self.power[k]
        });
        let brightest = [0, 1, 2].map(|k| f64::from(brightest[k]));
        (brightest, irradiance)
    }

    /// Calls `each` for the texels that overlap a cone, and perhaps for some texels near it. The arguments are a
    /// direction in the texel, the maximum distance from it to other directions in the texel, and the solid angle
    /// and the radiance of the texel.
    pub fn each_around(&self, cone: &Cone, mut each: impl FnMut(DVec3, f64, f64, [f64; 3])) {
        let radius = 2.0 * self.texel_grid.radius();
        self.texel_grid.each_around(cone, |x, y| {
            let direction = self.texel_grid.within((x, y), [0.5; 2]).as_dvec3();
            let [r, g, b, _] = self.texels[y * self.texel_grid.width + x];
            each(direction, radius, self.texel_grid.solid_angle(y), [r, g, b].map(f64::from));
        });
    }

    /// Distributions for a surface with the given unit normal. `None` means surfaces that are lit from all sides.
    #[inline]
    pub fn distributions(&self, normal: Option<Vec3>) -> Distributions<'_> {
        [self.tiers[0].distribution(normal), self.tiers[1].distribution(normal)]
    }

    /// Distributions for surfaces whose normals lie in the cone `normals`, restricted to light from the cone of
    /// directions `to`. `None` means surfaces that are lit from all sides.
    pub fn distributions_within(&self, normals: Option<Cone>, to: &Cone) -> [LightDistribution; TIERS] {
        [0, 1].map(|k| LightDistribution::new(&self.tiers[k].grid, normals, to))
    }

    /// Expected number of light samples per tier. `several` contains the numbers of samples of a vertex that takes
    /// several; `None` means a single sample.
    #[inline]
    pub fn numbers(&self, distributions: Distributions<'_>, several: Option<[u32; TIERS]>) -> [f32; TIERS] {
        let [high, low] = distributions.map(|distribution| distribution.power);
        match (several, high + low > 0.0) {
            (Some(lights), _) => lights.map(|n| n as f32),
            (None, true) => [high, low].map(|power| (power / (high + low)) as f32),
            (None, false) => [0.0; TIERS],
        }
    }

    /// Chooses the tier of a single light sample, given the expected number of samples per tier. Also returns
    /// random numbers for the choice within the tier.
    #[inline]
    pub fn tier(&self, numbers: [f32; TIERS], [v, u]: [u32; 2]) -> (usize, [u32; 2]) {
        let share = f64::from(numbers[0]);
        let at = fraction(v);
        let (tier, at) = if at < share { (0, at / share) } else { (1, (at - share) / (1.0 - share)) };
        // The conversion saturates.
        (tier, [(at / SCALE) as u32, u])
    }

    /// Samples a direction of a tier from two 32-bit random numbers, as one of `number` samples; see
    /// [`draw_each`](Self::draw_each).
    pub fn draw_one(
        &self,
        tier: usize,
        distribution: &LightDistribution,
        number: f32,
        point: [u32; 2],
    ) -> DrawnDirection {
        dispatch!(self.level, simd => {
            let row = self.tiers[tier].row(simd, distribution, [fraction(point[0]), fraction(point[1])]);
            self.found(simd, tier, &row, number)
        })
    }

    /// Samples a direction of one cell of a tier, in proportion to light, from two 32-bit random numbers. The cell is
    /// given by its row and column.
    pub fn direction_in(&self, tier: usize, cell: (usize, usize), point: [u32; 2]) -> Vec3 {
        dispatch!(self.level, simd => {
            let place = [fraction(point[0]), fraction(point[1])];
            let row = self.tiers[tier].row_of_cell(simd, cell, place, 1.0);
            self.found(simd, tier, &row, 1.0).direction
        })
    }

    /// Completes the choice of a texel that [`LightCells::row`] began. The tier takes `number` light samples.
    #[inline(always)]
    pub(crate) fn found<S: Simd>(
        &self,
        simd: S,
        tier: usize,
        row: &RowChoice,
        number: f32,
    ) -> DrawnDirection {
        let (texel, place) = self.tiers[tier].texel(simd, row);
        let direction = self.texel_grid.within(texel, place);
        let texel = (texel.1 * self.texel_grid.width + texel.0) as u32;
        DrawnDirection { direction, texel, expected: number * row.probability }
    }

    /// Column and row of the texel of a sampled direction.
    #[inline]
    pub(crate) fn texel_of(&self, drawn: &DrawnDirection) -> (usize, usize) {
        let (texel, width) = (drawn.texel, self.texel_grid.width as u32);
        ((texel % width) as usize, (texel / width) as usize)
    }

    /// Light of a sampled direction.
    #[inline]
    pub fn light(&self, &DrawnDirection { direction, texel, expected }: &DrawnDirection) -> LightSample {
        let [r, g, b, pdf] = self.texels[texel as usize];
        LightSample { direction, radiance: Vec3::new(r, g, b), pdf: expected * pdf.abs() }
    }

    /// Takes a single light sample for a surface with the given unit normal, or, for `None`, a surface that is lit
    /// from all sides. Returns `None` if no light reaches the surface.
    pub fn sample_one(&self, normal: Option<Vec3>, point: [u32; 2]) -> Option<LightSample> {
        let distributions = self.distributions(normal);
        distributions.iter().any(|distribution| distribution.power > 0.0).then(|| {
            let numbers = self.numbers(distributions, None);
            let (tier, point) = self.tier(numbers, point);
            self.light(&self.draw_one(tier, distributions[tier], numbers[tier], point))
        })
    }

    /// Light from a unit direction, with the density with which [`sample_one`](Self::sample_one) samples it.
    pub fn eval_one(&self, normal: Option<Vec3>, direction: Vec3) -> LightSample {
        let distributions = self.distributions(normal);
        self.eval(distributions, self.numbers(distributions, None), direction)
    }

    /// Radiance from a unit direction.
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (x, y) = self.texel_grid.texel(direction);
        let [r, g, b, _] = self.texels[y * self.texel_grid.width + x];
        Vec3::new(r, g, b)
    }

    /// True if a glossy lobe with this density is narrower than a texel, as for mirrors and clear glass, so
    /// that the edges of texels would be visible. The light of such a lobe is found only by scattered rays;
    /// see [`seen`](Self::seen).
    #[inline]
    pub fn is_narrow(&self, pdf: f32) -> bool {
        let texels = (self.texel_grid.width * self.texel_grid.height) as f32;
        // Compared with the solid angle of a texel at the horizon, two pi squared over their number.
        pdf * 2.0 * std::f32::consts::PI * std::f32::consts::PI > texels
    }

    /// Light along a glossy ray with this density: `light` itself, or, if the lobe is
    /// [narrow](Self::is_narrow), the interpolated [`background`](Self::background) without light samples.
    pub fn seen(&self, light: LightSample, pdf: f32) -> LightSample {
        if self.is_narrow(pdf) {
            LightSample { radiance: self.background(light.direction), pdf: 0.0, ..light }
        } else {
            light
        }
    }

    /// Radiance of the environment as a background image, interpolated bilinearly between the centres of texels.
    /// Light samples use [`EnvironmentLight::radiance`], whose integral is exact.
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

    /// Light from a unit direction, with the density with which light samples choose it.
    #[inline]
    pub fn eval(
        &self,
        distributions: Distributions<'_>,
        numbers: [f32; TIERS],
        direction: Vec3,
    ) -> LightSample {
        let TexelFound { tier, cell, radiance, pdf } = self.texel(direction);
        let pdf = numbers[tier] * distributions[tier].probability(cell.0, cell.1) * pdf;
        LightSample { direction, radiance, pdf }
    }

    /// The texel that contains a unit direction.
    #[inline]
    pub(crate) fn texel(&self, direction: Vec3) -> TexelFound {
        self.texel_at(self.texel_grid.texel(direction))
    }

    /// The texel in a column and row.
    #[inline]
    pub(crate) fn texel_at(&self, texel: (usize, usize)) -> TexelFound {
        let at = texel.1 * self.texel_grid.width + texel.0;
        let [r, g, b, pdf] = self.texels[at];
        let (tier, pdf) = (usize::from(pdf.is_sign_positive()), pdf.abs());
        TexelFound { tier, cell: self.tiers[tier].cell(texel), radiance: Vec3::new(r, g, b), pdf }
    }
}

/// Factor that scales 32-bit integers to the range [0, 1).
const SCALE: f64 = 1.0 / 4_294_967_296.0;
