//! Which node the error comes from: each set to the reference alone, and the reverse.

use super::Metric;
use super::bench::Bench;
use super::tunables::Assignment;

/// What setting one node to the reference gains, and what leaving it as it is costs.
#[derive(Debug)]
pub struct Attribution {
    pub node: String,
    /// Error with this node alone at the reference.
    pub alone: Option<f64>,
    /// Error with all at the reference but this one: what it does by itself. `None` where it was not measured.
    pub all_but: Option<f64>,
    /// Work with this node alone at the reference.
    pub work_alone: f64,
}

/// Every node that has something to turn, the worst first: the one whose own error is largest, and of equal ones
/// the one whose repair leaves least. `measure` gives the index of a point; its failure ends it all.
pub fn attributions<E>(
    bench: &mut Bench<'_>,
    metric: &Metric,
    reverse: bool,
    mut measure: impl FnMut(&mut Bench<'_>, Assignment) -> Result<usize, E>,
) -> Result<Vec<Attribution>, E> {
    let (now, reference) = (bench.now(), bench.preset(3));
    let mut attributions = Vec::new();
    for node in bench.nodes_with_knobs() {
        let with = |bench: &Bench<'_>, of: &Assignment, others: &Assignment| -> Assignment {
            let tunables = bench.tunables.iter().zip(of.iter().zip(others));
            tunables.map(|(tunable, (of, others))| if tunable.node == node { *of } else { *others }).collect()
        };
        let assignment = with(bench, &reference, &now);
        let alone = measure(bench, assignment)?;
        let mut all_but = None;
        if reverse {
            let assignment = with(bench, &now, &reference);
            let at = measure(bench, assignment)?;
            all_but = metric.error(&bench.points[at].off);
        }
        let point = &bench.points[alone];
        let (alone, work_alone) = (metric.error(&point.off), point.work);
        attributions.push(Attribution { node, alone, all_but, work_alone });
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
