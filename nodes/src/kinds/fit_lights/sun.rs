//! Search for the direction of the sun.

use engine::{Context, NodeError};
use glam::DVec3;
use render::light::emitters::WHITE;
use render::light::measure::spiral;
use render::light::regions;
use scene::math::color::luminance;
use scene::math::equirect::axes;
use scene::math::num;
use scene::types::Environment;

use super::incident::Incident;
use super::pairs::{Pair, neighbours};
use super::place::PlaceMesh;
use super::shading::Shading;

/// Scale of the robust comparison, as a natural logarithm. Larger deviations of the ratio of neighbouring colours
/// count as changes of albedo.
const SPREAD: f64 = 0.25;
/// Minimum number of pairs.
const FEWEST: usize = 50;
/// Number of directions over the whole sphere for the coarse search: one per square degree.
const COARSE: usize = 41_253;
/// Maximum number of coarse directions that are tried. If there are more, they are thinned out evenly.
const MOST: usize = 2500;
/// Angle by which the clipped regions are enlarged, in degrees, since the sun may be at the edge of a region.
const MARGIN_DEG: f64 = 2.0;
/// Sine of the lowest elevation of a sun.
const LOWEST: f64 = 0.02;
/// Angle around the best direction, in degrees, within which other directions do not count as rivals.
pub(super) const RIVAL_DEG: f64 = 8.0;
/// Number of coarse directions that are refined.
const REFINED: usize = 4;
/// Step sizes of the refinement, in degrees.
const STEPS_DEG: [f64; 3] = [0.4, 0.15, 0.05];
/// Radiances of clipped surfaces and sky that the search tries, relative to their displayed value.
const GLOWS: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// Irradiances of a candidate sun that the coarse search tries, relative to the median of all other light.
const FEW: [f64; 3] = [0.5, 2.0, 8.0];
/// Irradiances of a candidate sun that the fine search tries, relative to the median of all other light.
const MANY: [f64; 8] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// The best candidate for the sun: the direction that explains the colours of the place best, with its light.
#[derive(Debug, Clone)]
pub(super) struct Sun {
    /// Unit direction to the sun.
    pub direction: DVec3,
    /// Linear irradiance on a surface that faces the sun.
    pub irradiance: [f64; 3],
    /// Standard error of the irradiance, in stops, from four disjoint sets of pairs. Errors that all sets share,
    /// such as errors of the mesh, are not included.
    pub error_stops: f64,
    /// Radiance of clipped sky without the sun, relative to its displayed value.
    pub glow: f64,
    /// Relative reduction of the cost by adding the sun, compared with the best fit without a sun.
    pub gain: f64,
    /// Gain of the best direction that is more than [`RIVAL_DEG`] away from `direction`.
    pub rival: f64,
}

impl Sun {
    /// Luminance of the irradiance.
    pub fn luminance(&self) -> f64 {
        render::light::measure::luminance(self.irradiance)
    }
}

/// Whether the best candidate is accepted as the sun, and if not, the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    Accepted,
    NothingToCompare,
    Unexplained,
    Ambiguous,
    Hidden,
}

impl Verdict {
    /// The reason for the verdict, as a text for users.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::NothingToCompare => {
                "nothing above the horizon is clipped, or too few surface points can be compared"
            }
            Self::Unexplained => {
                "adding a sun, in any direction, does not clearly improve the fit to the colours of the place (see `min_gain`)"
            }
            Self::Ambiguous => "several directions explain the colours of the place about equally well",
            Self::Hidden => "the sun found from the shadows does not light the point of capture",
        }
    }
}

/// Finds the direction in or near the clipped regions that explains the colours of the place best. `None` if
/// there is nothing to compare.
pub(super) fn find(
    place: &PlaceMesh,
    shading: &Shading,
    incident: &[Incident],
    env: &Environment,
    cx: &Context,
) -> Result<Option<Sun>, NodeError> {
    let candidates = candidates(env);
    let pairs = neighbours(shading);
    if pairs.len() < FEWEST || candidates.is_empty() {
        return Ok(None);
    }
    let scene = Scene { place, shading, incident };
    let fit = Fit::new(&scene, &pairs, |rgb| f64::from(luminance(rgb)));
    let (without, glow) = least((0..GLOWS.len()).map(|glow| (fit.without(glow), glow)));
    let coarse = cx.for_each_tile(candidates.len(), |index| {
        let lit = scene.lit(candidates[index]);
        least(FEW.iter().map(|&sun| (fit.cost(glow, &lit, sun * fit.median), sun))).0
    })?;
    cx.count("directions", candidates.len() as u64);
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|&a, &b| coarse[a].total_cmp(&coarse[b]).then(a.cmp(&b)));
    let mut best = (f64::INFINITY, candidates[order[0]], glow, 0.0);
    for &start in order.iter().take(REFINED) {
        let mut at = (coarse[start], candidates[start], glow, 0.0);
        for step in STEPS_DEG {
            let around = around(at.1, step);
            let costs = cx.for_each_tile(around.len(), |index| {
                let lit = scene.lit(around[index]);
                let settings = (0..GLOWS.len()).flat_map(|glow| MANY.map(|sun| (glow, sun * fit.median)));
                least(settings.map(|(glow, sun)| (fit.cost(glow, &lit, sun), (glow, sun))))
            })?;
            let (cost, index) = least(costs.iter().enumerate().map(|(index, cost)| (cost.0, index)));
            let (glow, sun) = costs[index].1;
            at = (cost, around[index], glow, sun);
        }
        if at.0 < best.0 {
            best = at;
        }
    }
    let (cost, direction, glow, start) = best;
    let apart = num::f64::cos(RIVAL_DEG.to_radians());
    let others = order.iter().filter(|&&index| candidates[index].dot(direction) < apart);
    let rival = others.map(|&index| coarse[index]).fold(without, f64::min);
    let lit = scene.lit(direction);
    let irradiance = [0, 1, 2].map(|channel| {
        let fit = Fit::new(&scene, &pairs, |rgb| f64::from(rgb[channel]));
        fit.irradiance(glow, &lit, start)
    });
    let parts = [0, 1, 2, 3].map(|part| {
        let some: Vec<Pair> = pairs.iter().copied().skip(part).step_by(4).collect();
        let fit = Fit::new(&scene, &some, |rgb| f64::from(luminance(rgb)));
        num::f64::ln(fit.irradiance(glow, &lit, start)) / std::f64::consts::LN_2
    });
    let mean = parts.iter().sum::<f64>() / 4.0;
    let variance = parts.iter().map(|part| (part - mean) * (part - mean)).sum::<f64>() / 3.0;
    Ok(Some(Sun {
        direction,
        irradiance,
        error_stops: (variance / 4.0).sqrt(),
        glow: GLOWS[glow],
        gain: 1.0 - cost / without,
        rival: 1.0 - rival / without,
    }))
}

/// The number and the item of the pair with the smallest number. Of pairs with equal numbers, the first is
/// returned.
fn least<T: Copy>(of: impl IntoIterator<Item = (f64, T)>) -> (f64, T) {
    let mut of = of.into_iter();
    let first = of.next().expect("the lists of settings and directions are not empty");
    of.fold(first, |best, next| if next.0 < best.0 { next } else { best })
}

/// Directions in the clipped regions of the environment, and in a margin around them, above the horizon.
fn candidates(env: &Environment) -> Vec<DVec3> {
    let above = axes(env.up)[2];
    let (width, height) = (env.image.width, env.image.height);
    let mask: Vec<bool> =
        env.image.samples.chunks_exact(3).map(|c| luminance([c[0], c[1], c[2]]) >= WHITE).collect();
    let steps = (MARGIN_DEG * width as f64 / 360.0).ceil() as usize;
    let mask = regions::grow(&mask, width, steps);
    let is_near = |direction: &DVec3| {
        let (u, v) = scene::math::equirect::uv(env.up, *direction);
        let at = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
        mask[at(v, height) * width + at(u, width)]
    };
    let all: Vec<DVec3> =
        spiral(COARSE).into_iter().filter(|d| d.dot(above) > LOWEST && is_near(d)).collect();
    let every = all.len().div_ceil(MOST).max(1);
    all.into_iter().step_by(every).collect()
}

/// A grid of five by five directions around a direction, `step` degrees apart.
fn around(direction: DVec3, step: f64) -> Vec<DVec3> {
    let (right, up) = direction.any_orthonormal_pair();
    let tangent = step.to_radians();
    (0..25)
        .map(|index| {
            let [x, y] = [f64::from(index % 5) - 2.0, f64::from(index / 5) - 2.0];
            (direction + right * (x * tangent) + up * (y * tangent)).normalize()
        })
        .collect()
}

/// Points, and the light that they receive.
struct Scene<'a> {
    place: &'a PlaceMesh,
    shading: &'a Shading,
    incident: &'a [Incident],
}

impl Scene<'_> {
    /// Cosine of the angle between the normal of each point and the direction to a distant light; 0 where the
    /// light is blocked.
    fn lit(&self, direction: DVec3) -> Vec<f64> {
        let cosine = |point: &super::shading::Point| {
            let cosine = point.normal.dot(direction);
            let from = point.position + point.normal * self.place.offset;
            if cosine > 0.0 && self.place.lets_in(from, direction) { cosine } else { 0.0 }
        };
        self.shading.points.iter().map(cosine).collect()
    }
}

/// Comparison of pairs in one channel or in luminance.
struct Fit<'a> {
    pairs: &'a [Pair],
    /// Logarithm of the ratio of the captured colours of each pair.
    ratios: Vec<f64>,
    /// Irradiance of each point without a sun, and its logarithm, for each of [`GLOWS`].
    base: Vec<Vec<[f64; 2]>>,
    /// Median irradiance of all points, with clipped light at its displayed value.
    median: f64,
}

impl<'a> Fit<'a> {
    fn new(scene: &Scene<'_>, pairs: &'a [Pair], of: impl Fn([f32; 3]) -> f64) -> Self {
        let logs: Vec<f64> = scene
            .shading
            .points
            .iter()
            .map(|point| num::f64::ln(of(point.radiance.to_array()).max(1e-4)))
            .collect();
        let known: Vec<f64> = scene.incident.iter().map(|light| of(light.known.to_array())).collect();
        let clipped: Vec<f64> = scene.incident.iter().map(|light| of(light.clipped.to_array())).collect();
        let mut sums: Vec<f64> = known.iter().zip(&clipped).map(|(a, b)| a + b).collect();
        let middle = sums.len() / 2;
        let median = sums.select_nth_unstable_by(middle, f64::total_cmp).1.max(1e-6);
        let ratios = pairs.iter().map(|[a, b]| logs[*a as usize] - logs[*b as usize]).collect();
        // The last term prevents infinite logarithms at points that receive almost no light.
        let base = GLOWS.map(|glow| {
            let lights =
                known.iter().zip(&clipped).map(|(known, clipped)| known + glow * clipped + 0.01 * median);
            lights.map(|light| [light, num::f64::ln(light)]).collect()
        });
        Self { pairs, ratios, base: base.into(), median }
    }

    /// The cost of explaining the colours without a sun, with the glow of index `glow` in [`GLOWS`].
    fn without(&self, glow: usize) -> f64 {
        self.cost(glow, &vec![0.0; self.base[glow].len()], 0.0)
    }

    /// The cost of explaining the ratios by the light: the sum over pairs of r^2 / (r^2 + SPREAD^2), where r is the
    /// logarithm of the ratio of colours minus the logarithm of the ratio of light (Geman and McClure's robust
    /// error). A change of albedo costs at most 1.
    fn cost(&self, glow: usize, lit: &[f64], sun: f64) -> f64 {
        let light = self.base[glow].iter().zip(lit);
        let log = |([light, log], lit): (&[f64; 2], &f64)| {
            if *lit > 0.0 { num::f64::ln(light + sun * lit) } else { *log }
        };
        let logs: Vec<f64> = light.map(log).collect();
        let errors = self.pairs.iter().zip(&self.ratios).map(|([a, b], ratio)| {
            let r = ratio - logs[*a as usize] + logs[*b as usize];
            let square = r * r;
            square / (square + SPREAD * SPREAD)
        });
        errors.sum()
    }

    /// Irradiance of the sun with the lowest cost, within a factor of 16 of `start`. It is found by a scan in steps
    /// of half a stop, followed by a golden-section search.
    fn irradiance(&self, glow: usize, lit: &[f64], start: f64) -> f64 {
        let at = |stops: f64| self.cost(glow, lit, start * num::f64::exp2(stops));
        let (_, middle) = least((-8..=8).map(|half| (at(0.5 * f64::from(half)), 0.5 * f64::from(half))));
        let section = 0.5 * (5.0_f64.sqrt() - 1.0);
        let (mut low, mut high) = (middle - 0.5, middle + 0.5);
        for _ in 0..14 {
            let [a, b] = [high - section * (high - low), low + section * (high - low)];
            if at(a) < at(b) { high = b } else { low = a }
        }
        start * num::f64::exp2(0.5 * (low + high))
    }
}
