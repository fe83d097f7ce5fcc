//! Attribution of the error to nodes: each set to the reference alone, and the reverse.

use crate::bench::Bench;
use crate::metric::Metric;
use crate::tunables::Assignment;

/// The gain of setting one node to the reference, and the cost of leaving it as it is.
#[derive(Debug)]
pub struct Attribution {
    /// Name of the node.
    pub node: String,
    /// Error with this node alone at the reference.
    pub alone: Option<f64>,
    /// Error with all at the reference but this one: its own error. `None` if it was not measured.
    pub all_but: Option<f64>,
    /// Work with this node alone at the reference.
    pub work_alone: f64,
}

/// The first node, and its blame.
#[derive(Debug, PartialEq)]
pub enum Blame<'a> {
    /// Its own error.
    Makes(&'a str, f64),
    /// Setting it to the reference helps most; its own error was not measured.
    Helps(&'a str),
    /// No node causes an error, or none helps.
    None,
    /// The error was not computed.
    Unknown,
}

impl<'a> Blame<'a> {
    /// The blame of the worst node, which comes first, given the error of the graph as it is.
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

/// For each node with knobs the settings that attribute error to it: with it alone at the reference, and with all other nodes
/// there.
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

/// Every node with a tunable, the worst first: the one with the largest own error, and of equal ones the one whose
/// repair leaves least. `measure` returns the index of a point, or `None` if the time is over, which ends the attribution
/// with the nodes measured so far; its failure ends the attribution.
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
