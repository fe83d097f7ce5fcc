//! The settings that a report measures.

use std::collections::BTreeSet;

use engine::PRESETS;

use crate::attribution::{Attribution, attribution_settings, attributions};
use crate::bench::{Bench, Miss};
use crate::error::Error;
use crate::metric::Metric;
use crate::tunables::Assignment;

/// Reasons why no report could be made.
#[derive(Debug)]
pub enum Stop {
    /// The user interrupted measuring.
    Asked,
    /// The time ran out before the reference and the graph's own settings were measured.
    Late,
    /// A setting could not be measured.
    Wrong(Error),
}

/// Indices of the measured points that a report shows, and the attribution of the error to the nodes.
pub struct Measured {
    /// The points of the presets, in the order of [`PRESETS`]; `None` for a preset that was not reached in time.
    pub presets: [Option<usize>; 4],
    /// The point of the preset `reference`.
    pub reference: usize,
    /// The point of the graph with its own settings.
    pub now: usize,
    /// The attribution of the error to each node with knobs, the largest own error first.
    pub attributions: Vec<Attribution>,
    /// True if the time ran out before everything was measured.
    pub late: bool,
}

/// All settings that a report measures, in the order of measurement. If `reverse` is true, these include, for each
/// node with knobs, the setting in which all other nodes are at the reference.
pub fn settings(bench: &Bench<'_>, reverse: bool) -> Vec<Assignment> {
    // The first setting is the reference, with which the others are compared.
    let mut all = vec![bench.preset(REFERENCE), bench.now()];
    all.extend((0..REFERENCE).rev().map(|level| bench.preset(level)));
    let nodes = attribution_settings(bench);
    all.extend(nodes.iter().map(|(_, alone, _)| alone.clone()));
    all.extend(nodes.into_iter().filter(|_| reverse).map(|(_, _, all_but)| all_but));
    let mut seen = BTreeSet::new();
    all.retain(|setting| seen.insert(setting.clone()));
    all
}

/// The index of `reference` in [`PRESETS`].
const REFERENCE: usize = PRESETS.len() - 1;

/// Measures the settings that a report shows, until the time is over. After every newly measured setting, calls
/// `each` with the index of its point.
pub fn measure_all(
    bench: &mut Bench<'_>,
    metric: &Metric,
    reverse: bool,
    mut each: impl FnMut(&mut Bench<'_>, usize),
) -> Result<Measured, Stop> {
    let mut late = false;
    let mut measure = |bench: &mut Bench<'_>, assignment: Assignment| -> Result<Option<usize>, Stop> {
        let name = bench.name(&assignment);
        let known = bench.points.len();
        match bench.measure(&assignment) {
            Ok(at) => {
                if at == known {
                    each(bench, at);
                }
                Ok(Some(at))
            }
            Err(Miss::Late) => {
                late = true;
                Ok(None)
            }
            Err(Miss::Stopped) => Err(Stop::Asked),
            Err(Miss::Failed(why)) => Err(Stop::Wrong(Error::Setting { setting: name, why })),
        }
    };
    let reference = bench.preset(REFERENCE);
    let reference = measure(bench, reference)?.ok_or(Stop::Late)?;
    let now = bench.now();
    let now = measure(bench, now)?.ok_or(Stop::Late)?;
    let mut presets = [None; 4];
    presets[REFERENCE] = Some(reference);
    for level in (0..REFERENCE).rev() {
        let preset = bench.preset(level);
        presets[level] = measure(bench, preset)?;
    }
    let attributions = attributions(bench, metric, reverse, measure)?;
    Ok(Measured { presets, reference, now, attributions, late })
}
