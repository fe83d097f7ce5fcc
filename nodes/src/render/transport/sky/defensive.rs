//! Defensive sampling of the sky: most light samples are chosen for the lit side of a surface, and a quarter for all
//! directions. It is used for light whose direction differs slightly from its direction in the panorama.

use fearless_simd::dispatch;
use glam::Vec3;

use super::environment::{Distributions, EnvironmentLight, LightSample, TIERS};
use super::light_cells::RowChoice;
use crate::geometry::sampling::{Points, fraction};

/// Maximum number of samples that are drawn at once.
pub const MOST: usize = 4;
/// Share of the samples that are chosen for all directions, as a fraction of all 32-bit numbers.
const QUARTER: u32 = 1 << 30;

/// Light distributions, and the expected number of samples per tier.
#[derive(Debug, Clone, Copy)]
struct Aim<'a> {
    distributions: Distributions<'a>,
    numbers: [f32; TIERS],
}

/// Defensive sampling for the points of a surface that is lit from one side, or from all directions.
#[derive(Debug, Clone, Copy)]
pub struct DefensiveSampling<'a> {
    sky: &'a EnvironmentLight,
    aimed: Aim<'a>,
    any: Aim<'a>,
}

impl<'a> Aim<'a> {
    fn new(sky: &'a EnvironmentLight, normal: Option<Vec3>) -> Self {
        let distributions = sky.distributions(normal);
        Self { distributions, numbers: sky.numbers(distributions, None) }
    }

    /// True if any light reaches the surface.
    fn has_light(&self) -> bool {
        self.distributions.iter().any(|distribution| distribution.power > 0.0)
    }
}

/// A sample to be drawn: the distribution, the tier, and the random numbers.
type Choice<'a> = (Aim<'a>, usize, [u32; 2]);

impl<'a> DefensiveSampling<'a> {
    /// Prepares samples for a surface with the given unit normal. `None` means surfaces that are lit from all
    /// sides.
    pub fn new(sky: &'a EnvironmentLight, normal: Option<Vec3>) -> Self {
        let any = Aim::new(sky, None);
        Self { sky, aimed: if normal.is_some() { Aim::new(sky, normal) } else { any }, any }
    }

    /// Takes light samples from a pair of sample dimensions, one for each of `count` sub-samples of `points`.
    /// `count` must be at most [`MOST`]. An entry is `None` if no light reaches the surface, or for entries from
    /// `count`.
    pub fn sample(&self, points: Points, count: u32, pair: u32) -> [Option<LightSample>; MOST] {
        let sky = self.sky;
        let mut choices: [Option<Choice<'a>>; MOST] = [None; MOST];
        for (number, choice) in (0..count).zip(&mut choices) {
            *choice = self.choose(points.twig(number, count).bits(pair));
        }
        let mut directions = [Vec3::ZERO; MOST];
        // All rows are chosen before the texels, so that memory accesses overlap.
        dispatch!(sky.level, simd => {
            let mut rows = [RowChoice::default(); MOST];
            for (row, choice) in rows.iter_mut().zip(&choices) {
                if let Some((aim, tier, point)) = choice {
                    let point = [fraction(point[0]), fraction(point[1])];
                    *row = sky.tiers[*tier].row(simd, aim.distributions[*tier], point);
                }
            }
            for ((row, choice), direction) in rows.iter().zip(&choices).zip(&mut directions) {
                if let Some((_, tier, _)) = choice {
                    *direction = sky.found(simd, *tier, row, 1.0).direction;
                }
            }
        });
        let mut lights = [None; MOST];
        for ((light, choice), direction) in lights.iter_mut().zip(&choices).zip(directions) {
            if choice.is_some() {
                *light = Some(self.eval(direction));
            }
        }
        lights
    }

    /// Light from a unit direction, with the density with which [`sample`](Self::sample) chooses the direction.
    pub fn eval(&self, direction: Vec3) -> LightSample {
        let texel = self.sky.texel(direction);
        let (tier, (row, column)) = (texel.tier, texel.cell);
        let density =
            |aim: &Aim<'_>| aim.numbers[tier] * aim.distributions[tier].probability(row, column) * texel.pdf;
        let pdf = 0.75 * density(&self.aimed) + 0.25 * density(&self.any);
        LightSample { direction, radiance: texel.radiance, pdf }
    }

    /// Chooses whether a sample is aimed at the lit side, and its tier. `None` if no light reaches the surface.
    fn choose(&self, [a, b]: [u32; 2]) -> Option<Choice<'a>> {
        let (aim, a) = match a.checked_sub(QUARTER) {
            Some(rest) => (&self.aimed, (u64::from(rest) * 4 / 3) as u32),
            None => (&self.any, a << 2),
        };
        aim.has_light().then(|| {
            let (tier, point) = self.sky.tier(aim.numbers, [a, b]);
            (*aim, tier, point)
        })
    }
}
