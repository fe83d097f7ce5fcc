//! Defensive sampling of the sky: most light samples are chosen for the lit side of a surface, and a quarter for
//! all directions. It is used for light whose direction differs slightly from its direction in the panorama.

use glam::Vec3;

use super::environment::{Distributions, EnvironmentLight, LightSample, TIERS, TexelFound};
use super::light_draws::PlacedDraw;
use crate::geometry::sampling::Points;

/// Share of the samples that are chosen for all directions, as a fraction of all 32-bit numbers.
const QUARTER: u32 = 1 << 30;
/// Number of the branch of random numbers from which the samples of the bright tier are drawn.
const BRANCH: u32 = 0x7469_6572;

/// Light distributions, and the expected share of the samples in each tier.
#[derive(Debug, Clone, Copy)]
struct Aim<'a> {
    distributions: Distributions<'a>,
    numbers: [f32; TIERS],
}

/// Numbers of light samples that a vertex takes in the tiers of the sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NearLights {
    /// A single sample, in a tier that is chosen in proportion to the power of the tier's distribution.
    One,
    /// A fixed number in each tier. Where a distribution has no light in one tier, all samples are in the other.
    Tiers([u32; TIERS]),
}

/// Defensive sampling for the points of a surface that is lit from one side, or from all directions.
#[derive(Debug, Clone, Copy)]
pub struct DefensiveSampling<'a> {
    aimed: Aim<'a>,
    any: Aim<'a>,
    lights: NearLights,
}

impl NearLights {
    /// Number of light samples of a vertex.
    #[inline]
    pub fn count(self) -> u32 {
        match self {
            Self::One => 1,
            Self::Tiers(lights) => lights.iter().sum(),
        }
    }

    /// Random numbers for the choice of the light sample `number` of a vertex, given those of the vertex. The samples
    /// of each tier are stratified among themselves.
    #[inline]
    pub fn points(self, points: &Points, number: u32) -> Points {
        match self {
            Self::One => *points,
            Self::Tiers([bright, _]) if number < bright => points.branch(BRANCH).twig(number, bright),
            Self::Tiers([bright, rest]) => points.twig(number - bright, rest),
        }
    }
}

impl<'a> Aim<'a> {
    fn new(sky: &'a EnvironmentLight, normal: Option<Vec3>, lights: NearLights) -> Self {
        let distributions = sky.distributions(normal);
        let numbers = match lights {
            NearLights::One => sky.numbers(distributions, None),
            NearLights::Tiers([bright, rest]) => match distributions.map(|tier| tier.power > 0.0) {
                [true, true] => [bright, rest].map(|number| number as f32 / (bright + rest) as f32),
                lit => lit.map(|lit| f32::from(u8::from(lit))),
            },
        };
        Self { distributions, numbers }
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
    pub fn new(sky: &'a EnvironmentLight, normal: Option<Vec3>, lights: NearLights) -> Self {
        let any = Aim::new(sky, None, lights);
        Self { aimed: if normal.is_some() { Aim::new(sky, normal, lights) } else { any }, any, lights }
    }

    /// Chooses the distribution and the tier of the light sample `number` of a vertex, by two 32-bit random numbers.
    /// `None` if no light reaches the surface.
    pub fn choose(&self, sky: &EnvironmentLight, number: u32, [a, b]: [u32; 2]) -> Option<PlacedDraw<'a>> {
        let (aim, a) = match a.checked_sub(QUARTER) {
            Some(rest) => (&self.aimed, (u64::from(rest) * 4 / 3) as u32),
            None => (&self.any, a << 2),
        };
        aim.distributions.iter().any(|distribution| distribution.power > 0.0).then(|| {
            let (tier, point) = match self.lights {
                NearLights::One => sky.tier(aim.numbers, [a, b]),
                NearLights::Tiers([bright, _]) => {
                    let in_bright = aim.numbers[1] == 0.0 || (aim.numbers[0] > 0.0 && number < bright);
                    (usize::from(!in_bright), [a, b])
                }
            };
            let (distribution, number) = (aim.distributions[tier], aim.numbers[tier]);
            PlacedDraw { tier, distribution, number, point }
        })
    }

    /// Light from a unit direction in a texel, with the density with which samples choose the direction, on average
    /// over the samples of a vertex.
    pub(crate) fn light(&self, direction: Vec3, texel: &TexelFound) -> LightSample {
        let pdf = 0.75 * self.aimed.density(texel) + 0.25 * self.any.density(texel);
        LightSample { direction, radiance: texel.radiance, pdf }
    }
}
