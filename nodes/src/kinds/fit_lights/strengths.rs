//! Strength and colour of each emitter from the shading of the place.

use std::collections::BTreeMap;

use engine::{Context, NodeError};
use glam::DVec3;
use render::geometry::support::median;
use render::light::emitters::Emitters;
use render::light::measure::luminance;
use scene::math::equirect::axes;
use scene::math::num;
use scene::types::Environment;

use super::estimate::{Estimate, Observed, Prior, estimate};
use super::incident::{Incident, shown};
use super::pairs::{neighbours, wide};
use super::place::PlaceMesh;
use super::shading::Shading;
use super::sources::Source;

/// Maximum number of emitters that are fitted individually. The others keep their predicted light.
const MOST: usize = 6;
/// Minimum share of the hidden light for an emitter to be fitted.
const LEAST: f64 = 0.01;
/// Maximum number of emitters whose light is computed.
const COMPUTED: usize = 24;
/// Smallest predicted hidden flux, relative to the displayed flux. The logarithm of less would be too far away.
const DIMMEST: f64 = 0.05;
/// Size of the groups of points whose errors are correlated, relative to the size of the surroundings.
const GROUP: f64 = 0.3;
/// Smallest number of pairs.
const FEWEST: usize = 200;
/// Error of every estimate that the spread of the groups does not contain, in stops: errors of the mesh, and of the
/// distribution of the light within an emitter.
const SYSTEMATIC: f64 = 0.15;
/// Number of standard errors by which the estimate must explain the colours better than constant light, and better
/// than the prediction.
const CLEAR: f64 = 2.0;
/// Largest standard error of a fitted emitter, relative to that of the prediction.
const INFORMED: f64 = 0.7;
/// Largest share of the hidden light that may come from directions in which the mesh is dark.
const MISPLACED: f64 = 0.3;
/// Largest factor of the known light with which an estimate is used, in standard deviations up or down. The captured
/// colours contain all light, so the factor is 1 where mesh, colours and panorama belong together.
const CONSISTENT: f64 = 3.0;
/// Largest difference between the colours of the surfaces and those of the panorama in the same directions, relative to
/// the spread of the colours, with which an estimate is used; see [`mismatch`]. It is 0.11 in the room of `demo-scene`,
/// and 0.38 in a room whose mesh is 1.5 times too large.
const MISMATCHED: f64 = 0.25;
/// Number of points per tile.
const TILE: usize = 128;

/// Result for one emitter, or the reason why it keeps its predicted light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    Fitted,
    Uninformed,
    Off,
    Misplaced,
    Mismatched,
    Inconsistent,
    Unexplained,
    Agrees,
    Weak,
    Sun,
    NothingToCompare,
}

impl Verdict {
    /// The verdict as a text for users.
    pub fn text(self) -> &'static str {
        match self {
            Self::Fitted => "fitted",
            Self::Uninformed => {
                "the shading of the place does not show its strength; it changed only so that the sum of all light stays plausible"
            }
            Self::Off => "kept: `strengths` is false",
            Self::Misplaced => {
                "kept: the mesh is dark where the panorama shows this light; it lacks the lamp, or is in another frame"
            }
            Self::Mismatched => {
                "kept: the mesh has other colours than the panorama in the same directions; it may have the wrong scale, or no light in its colours"
            }
            Self::Inconsistent => {
                "kept: the colours of the place and the light that its surfaces reflect do not fit; the mesh may have the wrong scale"
            }
            Self::Unexplained => "kept: the colours of the place do not show the shading of these lights",
            Self::Agrees => "kept: the colours of the place agree with the prediction",
            Self::Weak => "kept: hides less than 1 % of the light, or is not among the six strongest",
            Self::Sun => "fitted by its shadows",
            Self::NothingToCompare => "kept: too few surface points can be compared",
        }
    }
}

/// An emitter with its estimate.
pub(super) struct Fitted {
    /// Index of the emitter.
    pub emitter: usize,
    pub source: Source,
    /// Hidden flux after the fit.
    pub flux: [f64; 3],
    /// Standard error of the luminance of the hidden flux, in stops, and the same before the fit; `None` if it was
    /// not fitted.
    pub error_stops: Option<[f64; 2]>,
    pub verdict: Verdict,
}

/// The estimates of all emitters.
pub(super) struct Strengths {
    pub emitters: Vec<Fitted>,
    /// True if the environment changes.
    pub accepted: bool,
    /// Part of the cost of constant light that the prediction and the estimate explain.
    pub explained: Option<[f64; 2]>,
    /// Factor of the known light.
    pub known: [f64; 3],
    /// Difference between the colours of the surfaces and of the panorama; see [`mismatch`].
    pub mismatch: Option<f64>,
}

/// Input of the fit.
pub(super) struct Given<'a> {
    pub place: &'a PlaceMesh,
    pub shading: &'a Shading,
    /// Light that the points receive, without emitters.
    pub incident: &'a [Incident],
    pub env: &'a Environment,
    pub emitters: &'a Emitters,
    /// Point of capture, in world units.
    pub origin: DVec3,
    /// Direction of a sun that was already fitted.
    pub sun: Option<DVec3>,
}

/// Fits the emitters of an environment. Without a prior, all emitters keep their light.
pub(super) fn fit(given: &Given<'_>, prior: Option<&Prior>, cx: &Context) -> Result<Strengths, NodeError> {
    let Given { place, shading, env, emitters, .. } = *given;
    let origin = place.local(given.origin);
    let sun = given.sun.and_then(|direction| emitters.at(env.up, direction));
    let mut all: Vec<Fitted> = emitters
        .list
        .iter()
        .enumerate()
        .take(COMPUTED)
        .map(|(index, emitter)| {
            let source = Source::new(env, emitter, place, origin);
            let verdict = if sun == Some(index) { Verdict::Sun } else { Verdict::Weak };
            Fitted { emitter: index, flux: source.hidden, source, error_stops: None, verdict }
        })
        .collect();
    cx.check()?;
    let mismatch = mismatch(given);
    let kept = |all| Strengths { emitters: all, accepted: false, explained: None, known: [1.0; 3], mismatch };
    let Some(prior) = prior else {
        all.iter_mut().for_each(|one| one.verdict = Verdict::Off);
        return Ok(kept(all));
    };
    let hidden: f64 = all.iter().map(|one| luminance(one.source.hidden)).sum();
    let strong = |one: &&mut Fitted| {
        let flux = luminance(one.source.hidden);
        one.verdict == Verdict::Weak && flux > 0.0 && flux >= LEAST * hidden
    };
    let mut tried: Vec<usize> = Vec::new();
    for one in all.iter_mut().filter(strong).take(MOST) {
        one.verdict = if one.source.is_bright { Verdict::NothingToCompare } else { Verdict::Misplaced };
        tried.push(one.emitter);
    }
    // In a mesh of another frame or place, or in one without colours, all light would be wrong.
    let misplaced: f64 = tried
        .iter()
        .map(|&index| &all[index].source)
        .filter(|source| !source.is_bright)
        .map(|source| luminance(source.hidden))
        .sum();
    if misplaced > MISPLACED * hidden {
        tried.iter().for_each(|&index| all[index].verdict = Verdict::Misplaced);
        return Ok(kept(all));
    }
    if mismatch.is_some_and(|mismatch| mismatch > MISMATCHED) {
        tried.iter().for_each(|&index| all[index].verdict = Verdict::Mismatched);
        return Ok(kept(all));
    }
    let pairs: Vec<_> = if tried.is_empty() || shading.points.is_empty() {
        Vec::new()
    } else {
        neighbours(shading).into_iter().chain(wide(shading)).collect()
    };
    if pairs.len() < FEWEST {
        return Ok(kept(all));
    }
    let observed = observe(given, &all, &tried, pairs, cx)?;
    let predicted: Vec<[f64; 3]> = tried
        .iter()
        .map(|&index| {
            let source = &all[index].source;
            [0, 1, 2].map(|c| source.hidden[c].max(DIMMEST * source.shown[c]).max(1e-9))
        })
        .collect();
    let found = estimate(observed, &predicted, prior);
    cx.check()?;
    let consistent =
        found.known.iter().all(|factor| num::f64::log2(*factor).abs() <= CONSISTENT * prior.known);
    let verdict = if consistent { judge(&found) } else { Verdict::Inconsistent };
    let [constant, before, after] = [0, 1, 2].map(|index| found.costs[index].iter().sum::<f64>());
    for (place, &index) in tried.iter().enumerate() {
        let one = &mut all[index];
        let spread = found.error_stops[place];
        let error = (spread * spread + SYSTEMATIC * SYSTEMATIC).sqrt();
        let informed = error < INFORMED * found.prior_stops[place];
        // An emitter whose place is wrong only absorbs the light that the others do not explain.
        if one.verdict != Verdict::Misplaced {
            one.error_stops = Some([error, found.prior_stops[place]]);
            one.verdict = match verdict {
                Verdict::Fitted if !informed => Verdict::Uninformed,
                verdict => verdict,
            };
            if verdict == Verdict::Fitted {
                one.flux = found.fluxes[place];
            }
        }
    }
    let accepted = all.iter().any(|one| one.verdict == Verdict::Fitted);
    if !accepted {
        all.iter_mut().for_each(|one| one.flux = one.source.hidden);
    }
    let explained = (constant > 0.0).then(|| [before, after].map(|cost| 1.0 - cost / constant));
    Ok(Strengths { emitters: all, accepted, explained, known: found.known, mismatch })
}

/// Compares the luminance of the surfaces with that of the environment in the directions in which the point of capture
/// sees them, where it is not clipped. The result is the spread of the differences of the logarithms, relative to the
/// spread of the logarithms themselves: 0 if they agree up to a common factor, and 1 or more if the mesh shows another
/// place, or is seen from another point. Spreads are median absolute deviations. `None` if there is no spread.
fn mismatch(given: &Given<'_>) -> Option<f64> {
    let origin = given.place.local(given.origin);
    let pairs: Vec<[f64; 2]> = given
        .shading
        .points
        .iter()
        .filter_map(|point| {
            let (shown, clipped) = shown(given.env, (point.position - origin).normalize());
            let logs = [point.radiance, shown]
                .map(|rgb| num::f64::ln(luminance(rgb.to_array().map(f64::from)).max(1e-4)));
            (!clipped).then_some(logs)
        })
        .collect();
    let spread = |of: fn(&[f64; 2]) -> f64| {
        let middle = median(pairs.iter().map(of).collect())?;
        median(pairs.iter().map(|pair| (of(pair) - middle).abs()).collect())
    };
    let most = spread(|[surface, _]| *surface)?.max(spread(|[_, shown]| *shown)?);
    let differences = spread(|[surface, shown]| surface - shown)?;
    (most > 0.0).then(|| differences / most)
}

/// Compares the costs of constant light, of the prediction and of the estimate, group by group.
fn judge(found: &Estimate) -> Verdict {
    let [constant, before, after] = &found.costs;
    let clear = |worse: &[f64], better: &[f64]| {
        let count = worse.len() as f64;
        let differences: Vec<f64> = worse.iter().zip(better).map(|(a, b)| a - b).collect();
        let sum: f64 = differences.iter().sum();
        let mean = sum / count;
        let squares: f64 = differences.iter().map(|d| (d - mean) * (d - mean)).sum();
        sum > CLEAR * squares.sqrt()
    };
    if !clear(constant, after) {
        Verdict::Unexplained
    } else if !clear(before, after) {
        Verdict::Agrees
    } else {
        Verdict::Fitted
    }
}

/// Computes the light of all emitters at all points.
fn observe(
    given: &Given<'_>,
    all: &[Fitted],
    tried: &[usize],
    pairs: Vec<super::pairs::Pair>,
    cx: &Context,
) -> Result<Observed, NodeError> {
    let Given { place, shading, incident, .. } = *given;
    let points = &shading.points;
    let tiles = cx.for_each_tile(points.len().div_ceil(TILE), |tile| {
        let light = |point: &super::shading::Point| {
            let from = point.position + point.normal * place.offset;
            let mut shown = [0.0; 3];
            let mut by_emitter = vec![0.0; tried.len()];
            for one in all {
                let (displayed, hidden) = one.source.light(from, point.normal, place);
                let fitted = tried.iter().position(|&index| index == one.emitter);
                let fixed = if fitted.is_none() { hidden } else { 0.0 };
                let light = displayed.into_iter().zip(one.source.hidden).map(|(d, flux)| d + fixed * flux);
                shown.iter_mut().zip(light).for_each(|(sum, value)| *sum += value);
                if let Some(fitted) = fitted {
                    by_emitter[fitted] = hidden;
                }
            }
            (shown, by_emitter)
        };
        points[tile * TILE..].iter().take(TILE).map(light).collect::<Vec<_>>()
    })?;
    let mut observed = Observed {
        logs: points
            .iter()
            .map(|point| point.radiance.to_array().map(|v| num::f64::ln(f64::from(v).max(1e-4))))
            .collect(),
        known: incident.iter().map(|light| light.known.to_array().map(f64::from)).collect(),
        shown: Vec::with_capacity(points.len()),
        by_emitter: vec![Vec::with_capacity(points.len()); tried.len()],
        pairs,
        groups: Vec::with_capacity(points.len()),
        group_count: 0,
        parts: Vec::with_capacity(points.len()),
    };
    for (shown, by_emitter) in tiles.into_iter().flatten() {
        observed.shown.push(shown);
        observed.by_emitter.iter_mut().zip(by_emitter).for_each(|(list, value)| list.push(value));
    }
    let mut numbers = BTreeMap::new();
    for point in points {
        let cell = (point.position / (GROUP * shading.size)).floor().to_array().map(|v| v as i64);
        let side = point.normal.abs().max_position();
        let next = numbers.len() as u32;
        observed.groups.push(*numbers.entry((cell, side)).or_insert(next));
    }
    observed.group_count = numbers.len();
    // Quarters around the point of capture.
    let origin = place.local(given.origin);
    let [right, forward, _] = axes(given.env.up);
    for point in points {
        let away = point.position - origin;
        let [x, y] = [right, forward].map(|axis| u32::from(away.dot(axis) > 0.0));
        observed.parts.push(2 * x + y);
    }
    Ok(observed)
}
