//! Attribution of the error to nodes. For each node, the error is measured twice: with only this node at the
//! reference settings, and with all other nodes at the reference settings.

use crate::bench::Bench;
use crate::metric::Metric;
use crate::tunables::Assignment;

/// Effects of one node on the error: the error that remains if only this node is set to the reference, and the
/// error that the node causes if all other nodes are set to the reference.
#[derive(Debug)]
pub struct Attribution {
    /// Name of the node.
    pub node: String,
    /// Error with only this node at the reference; `None` if it was not computed.
    pub alone: Option<f64>,
    /// Error with all other nodes at the reference. This is the node's own error. `None` if it was not measured.
    pub all_but: Option<f64>,
    /// Work with only this node at the reference.
    pub work_alone: f64,
}

/// The result of the search for the node that causes the most error.
#[derive(Debug, PartialEq)]
pub enum Blame<'a> {
    /// The name of the node with the largest own error, and this error.
    Makes(&'a str, f64),
    /// The node for which the error decreases most if only this node is set to the reference. Own errors were not
    /// measured.
    Helps(&'a str),
    /// No node causes an error. If own errors were not measured, this means that setting a single node to the
    /// reference never decreases the error.
    None,
    /// The error was not computed.
    Unknown,
}

impl<'a> Blame<'a> {
    /// Finds the node that causes the most error. `attributions` must be sorted, with the largest error first.
    /// `error` is the error of the graph with its own settings.
    pub fn of(attributions: &'a [Attribution], error: Option<f64>) -> Self {
        let Some(first) = attributions.first() else { return Self::Unknown };
        match (first.all_but, first.alone, error) {
            (Some(own), ..) if own > 0.0 => Self::Makes(&first.node, own),
            (Some(_), ..) => Self::None,
            (None, Some(alone), Some(error)) if alone >= error => Self::None,
            (None, Some(_), _) => Self::Helps(&first.node),
            _ => Self::Unknown,
        }
    }
}

/// For each node with knobs: its name, the settings with only this node at the reference, and the settings with all
/// other nodes at the reference.
pub fn attribution_settings(bench: &Bench<'_>) -> Vec<(String, Assignment, Assignment)> {
    let (now, reference) = (bench.now(), bench.preset(3));
    let with = |node: &str, of: &Assignment, others: &Assignment| -> Assignment {
        let tunables = bench.tunables.iter().zip(of.iter().zip(others));
        tunables.map(|(tunable, (of, others))| if tunable.node == node { *of } else { *others }).collect()
    };
    let nodes = bench.nodes_with_knobs().into_iter();
    nodes
        .map(|node| {
            let (alone, all_but) = (with(&node, &reference, &now), with(&node, &now, &reference));
            (node, alone, all_but)
        })
        .collect()
}

/// Attributes the error to the nodes with knobs. If `reverse` is true, own errors are measured as well. The result
/// is sorted by own error, largest first. Nodes with equal own errors are sorted by the error that remains with
/// only this node at the reference, smallest first. `measure` returns the index of a point, or `None` when the time
/// is over; the attribution then ends with the nodes measured so far. An error of `measure` is returned.
pub fn attributions<E>(
    bench: &mut Bench<'_>,
    metric: &Metric,
    reverse: bool,
    mut measure: impl FnMut(&mut Bench<'_>, Assignment) -> Result<Option<usize>, E>,
) -> Result<Vec<Attribution>, E> {
    let mut attributions = Vec::new();
    let settings = attribution_settings(bench);
    for (node, alone, _) in &settings {
        let Some(at) = measure(bench, alone.clone())? else { break };
        let point = &bench.points[at];
        let (alone, work_alone) = (metric.error(&point.off), point.work);
        attributions.push(Attribution { node: node.clone(), alone, all_but: None, work_alone });
    }
    // The expensive settings come last, so that each node has a first result if the time is short.
    for ((_, _, all_but), attribution) in settings.iter().zip(&mut attributions).filter(|_| reverse) {
        let Some(at) = measure(bench, all_but.clone())? else { break };
        attribution.all_but = metric.error(&bench.points[at].off);
    }
    let key = |attribution: &Attribution| {
        (attribution.all_but.unwrap_or(0.0), attribution.alone.unwrap_or(f64::INFINITY))
    };
    attributions.sort_by(|a, b| {
        let (a, b) = (key(a), key(b));
        b.0.total_cmp(&a.0).then(a.1.total_cmp(&b.1))
    });
    Ok(attributions)
}

#[cfg(test)]
mod tests;
