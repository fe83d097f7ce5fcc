//! Defensive sampling of the sky: most light samples are chosen for the lit side of a surface, and a quarter for
//! all directions. It is used for light whose direction differs slightly from its direction in the panorama.

use glam::Vec3;

use super::environment::{Distributions, EnvironmentLight, LightSample, TIERS, TexelFound};
use super::light_draws::PlacedDraw;

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
    aimed: Aim<'a>,
    any: Aim<'a>,
}

impl<'a> Aim<'a> {
    fn new(sky: &'a EnvironmentLight, normal: Option<Vec3>) -> Self {
        let distributions = sky.distributions(normal);
        Self { distributions, numbers: sky.numbers(distributions, None) }
    }

    /// Density, as the expected number of samples per steradian, with which a texel is chosen.
    fn density(&self, texel: &TexelFound) -> f32 {
        let TexelFound { tier, cell: (row, column), pdf, .. } = *texel;
        self.numbers[tier] * self.distributions[tier].probability(row, column) * pdf
    }
}

impl<'a> DefensiveSampling<'a> {
    /// Prepares samples for a surface with the given unit normal. `None` means surfaces that are lit from all
    /// sides.
    pub fn new(sky: &'a EnvironmentLight, normal: Option<Vec3>) -> Self {
        let any = Aim::new(sky, None);
        Self { aimed: if normal.is_some() { Aim::new(sky, normal) } else { any }, any }
    }

    /// Chooses the distribution and the tier of a light sample, by two 32-bit random numbers. `None` if no light
    /// reaches the surface.
    pub fn choose(&self, sky: &EnvironmentLight, [a, b]: [u32; 2]) -> Option<PlacedDraw<'a>> {
        let (aim, a) = match a.checked_sub(QUARTER) {
            Some(rest) => (&self.aimed, (u64::from(rest) * 4 / 3) as u32),
            None => (&self.any, a << 2),
        };
        aim.distributions.iter().any(|distribution| distribution.power > 0.0).then(|| {
            let (tier, point) = sky.tier(aim.numbers, [a, b]);
            let (distribution, number) = (aim.distributions[tier], aim.numbers[tier]);
            PlacedDraw { tier, distribution, number, point }
        })
    }

    /// Light from a unit direction in a texel, with the density with which samples choose the direction.
    pub(crate) fn light(&self, direction: Vec3, texel: &TexelFound) -> LightSample {
        let pdf = 0.75 * self.aimed.density(texel) + 0.25 * self.any.density(texel);
        LightSample { direction, radiance: texel.radiance, pdf }
    }
}
