//! The measurements of `report`: the graph at its presets and as it is, and with one node at the reference at a
//! time.

mod json;
mod page;

use engine::PRESETS;

pub use json::as_json;
pub use page::page;

use crate::attribution::{Attribution, attributions};
use crate::bench::{Bench, Miss};
use crate::error::Error;
use crate::metric::Metric;
use crate::tunables::Assignment;

/// The reason why measuring ended early.
#[derive(Debug)]
pub enum Stop {
    /// The user interrupted it.
    Asked,
    /// A setting failed.
    Wrong(Error),
}

/// Indices of the points that a report shows, and the error that each node causes in the graph as it is.
pub struct Measured {
    /// The points of the presets, in the order of [`PRESETS`].
    pub presets: Vec<usize>,
    /// The point of the graph as it is.
    pub now: usize,
    /// The error of each node that has knobs, largest first.
    pub attributions: Vec<Attribution>,
}

/// Measures all that a report shows; with `reverse` also the settings in which all nodes but one are at the reference.
/// Calls `each` after every setting that is new, with the index of its point.
pub fn measure_all(
    bench: &mut Bench<'_>,
    metric: &Metric,
    reverse: bool,
    mut each: impl FnMut(&mut Bench<'_>, usize),
) -> Result<Measured, Stop> {
    let mut measure = |bench: &mut Bench<'_>, assignment: Assignment| -> Result<usize, Stop> {
        let name = bench.name(&assignment);
        let known = bench.points.len();
        let at = bench.measure(&assignment).map_err(|miss| match miss {
            Miss::Stopped => Stop::Asked,
            Miss::Failed(why) => Stop::Wrong(Error::Setting { setting: name.clone(), why }),
        })?;
        if at == known {
            each(bench, at);
        }
        Ok(at)
    };
    let mut presets = Vec::new();
    // The first one is what others are compared with.
    for level in (0..PRESETS.len()).rev() {
        let preset = bench.preset(level);
        presets.insert(0, measure(bench, preset)?);
    }
    let now = bench.now();
    let now = measure(bench, now)?;
    let attributions = attributions(bench, metric, reverse, measure)?;
    Ok(Measured { presets, now, attributions })
}
