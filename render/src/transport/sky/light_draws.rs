//! Light samples of many vertices, drawn together: eight at once in SIMD registers, with overlapping memory
//! accesses. Every SIMD level gives the same bits.

use fearless_simd::{dispatch, prelude::*};

use super::environment::{Distributions, DrawnDirection, EnvironmentLight, TIERS};
use super::light_cells::RowChoice;
use super::light_distribution::LightDistribution;
use crate::geometry::sampling::{Points, fraction};

/// Number of samples that are drawn at once.
const LANES: usize = 8;
/// Offset between the pairs of sample dimensions of one tier and of the next.
const TIER: u32 = 1 << 18;

/// Light sample to be drawn.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    tier: usize,
    distribution: &'a LightDistribution,
    /// Number of light samples that the vertex takes in this tier.
    number: f32,
    points: Points,
    pair: u32,
}

/// Light samples to be drawn for a vertex. `lights` contains the number of samples in each tier. A tier without
/// light gets no samples.
pub fn wanted(
    distributions: Distributions<'_>,
    lights: [u32; TIERS],
    points: Points,
    pair: u32,
) -> impl Iterator<Item = Wanted<'_>> {
    let lit = (0..TIERS).filter(move |&tier| distributions[tier].power > 0.0);
    lit.flat_map(move |tier| Wanted::each((tier, distributions[tier]), lights[tier], points, pair))
}

impl<'a> Wanted<'a> {
    /// The `count` light samples that are to be drawn in one tier.
    fn each(
        (tier, distribution): (usize, &'a LightDistribution),
        count: u32,
        points: Points,
        pair: u32,
    ) -> impl Iterator<Item = Self> {
        let pair = pair + TIER * tier as u32;
        let one =
            move |k| Self { tier, distribution, number: count as f32, points: points.twig(k, count), pair };
        (0..count).map(one)
    }
}

/// Light sample to be drawn at a given point of the unit square.
#[derive(Debug, Clone, Copy)]
pub struct PlacedDraw<'a> {
    /// Tier of the sky.
    pub tier: usize,
    /// Distribution of the tier.
    pub distribution: &'a LightDistribution,
    /// Expected number of light samples of the vertex in this tier.
    pub number: f32,
    /// The point, as 32-bit fractions.
    pub point: [u32; 2],
}

impl EnvironmentLight {
    /// Computes [`Points::bits`] of one pair of dimensions for many samples, and appends the results to `found`.
    pub fn bits_each(&self, points: &[Points], pair: u32, found: &mut Vec<[u32; 2]>) {
        dispatch!(self.level, simd => {
            for points in points.chunks(LANES) {
                // Unused lanes repeat the first.
                let mut lanes = [points[0]; LANES];
                lanes[..points.len()].copy_from_slice(points);
                let [v, u] = Points::bits_of_eight(simd, &lanes, &[pair; LANES]);
                for k in 0..points.len() {
                    found.push([v[k], u[k]]);
                }
            }
        });
    }

    /// Draws light samples at given points; see [`draw_one`](Self::draw_one).
    pub fn draw_placed(&self, wanted: &[PlacedDraw<'_>], mut found: impl FnMut(DrawnDirection)) {
        dispatch!(self.level, simd => {
            for wanted in wanted.chunks(LANES) {
                let mut rows = [RowChoice::default(); LANES];
                for (row, wanted) in rows.iter_mut().zip(wanted) {
                    let point = [fraction(wanted.point[0]), fraction(wanted.point[1])];
                    *row = self.tiers[wanted.tier].row(simd, wanted.distribution, point);
                }
                let mut ahead = 0.0;
                for (row, wanted) in rows.iter().zip(wanted) {
                    ahead += self.tiers[wanted.tier].look_ahead(row);
                }
                std::hint::black_box(ahead);
                for (row, wanted) in rows.iter().zip(wanted) {
                    found(self.found(simd, wanted.tier, row, wanted.number));
                }
            }
        });
    }

    /// Samples directions approximately in proportion to light times cosine. They may lie slightly below the
    /// horizon, so that no light above it is missed.
    pub fn draw_each(&self, wanted: &[Wanted<'_>], found: impl FnMut(DrawnDirection)) {
        dispatch!(self.level, simd => self.draw_each_at(simd, wanted, found));
    }

    #[inline(always)]
    fn draw_each_at<S: Simd>(&self, simd: S, wanted: &[Wanted<'_>], mut found: impl FnMut(DrawnDirection)) {
        for wanted in wanted.chunks(LANES) {
            // Unused lanes repeat the first.
            let (mut points, mut pairs) = ([wanted[0].points; LANES], [wanted[0].pair; LANES]);
            for (k, wanted) in wanted.iter().enumerate() {
                (points[k], pairs[k]) = (wanted.points, wanted.pair);
            }
            let [v, u] = Points::bits_of_eight(simd, &points, &pairs);
            let mut rows = [RowChoice::default(); LANES];
            for (k, (row, wanted)) in rows.iter_mut().zip(wanted).enumerate() {
                let point = [fraction(v[k]), fraction(u[k])];
                *row = self.tiers[wanted.tier].row(simd, wanted.distribution, point);
            }
            let ahead = rows.iter().zip(wanted).map(|(row, wanted)| self.tiers[wanted.tier].look_ahead(row));
            std::hint::black_box(ahead.sum::<f32>());
            for (row, wanted) in rows.iter().zip(wanted) {
                found(self.found(simd, wanted.tier, row, wanted.number));
            }
        }
    }
}

/// Numbers of light samples of a vertex.
#[derive(Debug, Clone, Copy)]
enum Lights {
    /// A fixed number in each tier.
    Tiers([u32; TIERS]),
    /// A fixed number, each in a tier that is chosen in proportion to the power of the tier's distribution.
    Mixed(u32),
}

/// Light samples of successive vertices, drawn in batches.
pub struct LightDraws<'a, V> {
    sky: &'a EnvironmentLight,
    lights: Lights,
    pair: u32,
    vertices: V,
    /// Samples to be drawn for the batch, if the number of samples in each tier is fixed.
    wanted: Vec<Wanted<'a>>,
    /// Samples to be drawn for the batch, if the tier of each is chosen.
    placed: Vec<PlacedDraw<'a>>,
    /// Drawn samples of the batch.
    draws: Vec<DrawnDirection>,
    /// For each vertex of the batch, the end of its samples in `draws`.
    ends: Vec<usize>,
    /// Number of vertices of the batch whose samples were returned.
    asked: usize,
}

/// Number of vertices per batch: enough to fill registers, few enough to stay in cache.
const TOGETHER: usize = 32;

impl<'a, V: Iterator<Item = Option<(Points, Distributions<'a>)>>> LightDraws<'a, V> {
    /// Creates the light samples of `vertices`. `lights` contains the number of samples in each tier. The samples
    /// use the pair of sample dimensions with index `pair`, offset for each tier.
    pub fn new(sky: &'a EnvironmentLight, lights: [u32; TIERS], pair: u32, vertices: V) -> Self {
        Self::of(sky, Lights::Tiers(lights), pair, vertices)
    }

    /// Creates `count` light samples of each vertex, a power of 2. The tier of each sample is chosen in proportion to
    /// the power of the tier's distribution.
    pub fn mixed(sky: &'a EnvironmentLight, count: u32, pair: u32, vertices: V) -> Self {
        Self::of(sky, Lights::Mixed(count), pair, vertices)
    }

    fn of(sky: &'a EnvironmentLight, lights: Lights, pair: u32, vertices: V) -> Self {
        let (wanted, placed, draws, ends) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { sky, lights, pair, vertices, wanted, placed, draws, ends, asked: 0 }
    }

    /// Samples of the next vertex, tier after tier; empty if there is no further vertex.
    pub fn next_vertex(&mut self) -> &[DrawnDirection] {
        if self.asked == self.ends.len() {
            self.draw();
        }
        let start = if self.asked > 0 { self.ends[self.asked - 1] } else { 0 };
        let Some(&end) = self.ends.get(self.asked) else { return &[] };
        self.asked += 1;
        &self.draws[start..end]
    }

    fn draw(&mut self) {
        self.asked = 0;
        self.draws.clear();
        self.ends.clear();
        match self.lights {
            Lights::Tiers(lights) => self.draw_tiers(lights),
            Lights::Mixed(count) => self.draw_mixed(count),
        }
    }

    fn draw_mixed(&mut self, count: u32) {
        self.placed.clear();
        let (sky, pair) = (self.sky, self.pair);
        let mut bits = Vec::with_capacity(count as usize);
        for vertex in self.vertices.by_ref().take(TOGETHER) {
            if let Some((points, distributions)) = vertex
                && distributions.iter().any(|distribution| distribution.power > 0.0)
            {
                let numbers = sky.numbers(distributions, None);
                let twigs: Vec<Points> = (0..count).map(|k| points.twig(k, count)).collect();
                bits.clear();
                sky.bits_each(&twigs, pair, &mut bits);
                self.placed.extend(bits.iter().map(|bits| {
                    let (tier, point) = sky.tier(numbers, *bits);
                    let number = numbers[tier] * count as f32;
                    PlacedDraw { tier, distribution: distributions[tier], number, point }
                }));
            }
            self.ends.push(self.placed.len());
        }
        let draws = &mut self.draws;
        sky.draw_placed(&self.placed, |drawn| draws.push(drawn));
    }

    fn draw_tiers(&mut self, lights: [u32; TIERS]) {
        self.wanted.clear();
        for vertex in self.vertices.by_ref().take(TOGETHER) {
            if let Some((points, distributions)) = vertex {
                // The same as `wanted`, but one tier at a time, so that the number of samples is known.
                for (tier, distribution) in distributions.into_iter().enumerate() {
                    if distribution.power > 0.0 {
                        let number = lights[tier];
                        self.wanted.extend(Wanted::each((tier, distribution), number, points, self.pair));
                    }
                }
            }
            self.ends.push(self.wanted.len());
        }
        let draws = &mut self.draws;
        self.sky.draw_each(&self.wanted, |drawn| draws.push(drawn));
    }
}

#[cfg(test)]
mod tests {
    use engine::Up;
    use glam::Vec3;

    use super::*;
    use crate::geometry::sampling::{mix, stream, unit};
    use scene::types::{Environment, Image};

    /// Sky of random radiance with a few lamps.
    fn sky() -> EnvironmentLight {
        let (width, height) = (256, 96);
        let lamp = |i: usize| if mix(i as u32 / 3).is_multiple_of(997) { 3e3 } else { unit(mix(i as u32)) };
        let samples = (0..width * height * 3).map(lamp).collect();
        let image = Image::from_samples(width, height, 3, samples);
        EnvironmentLight::new(&Environment { image: image.into(), up: Up::PlusY, origin: None })
    }

    /// A batch gives the same samples of each vertex as if the vertex were alone, and every SIMD level gives the
    /// same bits. This test fails if `draw_each_at` draws the first sample in every lane, or if `self.draws.clear()`
    /// is left out.
    #[test]
    fn drawn_together_is_drawn_alone() {
        let sky = sky();
        assert!(sky.lights.iter().all(|&n| n > 0));
        let normals = [Vec3::Y, Vec3::new(0.6, -0.48, 0.64), Vec3::NEG_X];
        let vertex = |i: u32| {
            let points = Points::new(stream(2, i, 5), i % 7);
            (!i.is_multiple_of(5)).then(|| (points, sky.distributions(Some(normals[i as usize % 3]))))
        };
        let mut together = LightDraws::new(&sky, sky.lights, 9, (0..301).map(vertex));
        for i in 0..301 {
            let together = together.next_vertex();
            let Some((points, distributions)) = vertex(i) else {
                assert!(together.is_empty());
                continue;
            };
            let lit = (0..TIERS).filter(|&tier| distributions[tier].power > 0.0);
            let alone = lit.flat_map(|tier| {
                let count = sky.lights[tier];
                (0..count).map(move |k| (tier, points.twig(k, count).bits(9 + TIER * tier as u32)))
            });
            let alone: Vec<_> = alone
                .map(|(tier, point)| sky.draw_one(tier, distributions[tier], sky.lights[tier] as f32, point))
                .collect();
            assert_eq!(together, alone);
            let all: Vec<Wanted<'_>> = wanted(distributions, sky.lights, points, 9).collect();
            for level in testing::levels() {
                let mut found = Vec::new();
                let keep = |drawn| found.push(drawn);
                dispatch!(level, simd => sky.draw_each_at(simd, &all, keep));
                assert_eq!(together, found, "{level:?}");
            }
        }
    }
}
