//! Forecast of the time that measurements take.

use std::collections::BTreeMap;

use engine::{Graph, Planned};

use crate::bench::{Bench, Point};
use crate::tunables::{Assignment, Tunable};

/// Forecast of the time that it takes to measure some settings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outlook {
    /// Number of settings that must still be measured.
    pub settings: usize,
    /// Forecast time in seconds. Nodes without a forecast are not included.
    pub seconds: f64,
    /// Number of node runs without a forecast, because no node of the kind has ever run.
    pub unknown: usize,
}

/// The tunables on which the result of a node depends.
struct Reach {
    /// The tunables of the node and of all nodes on which it depends.
    tunables: Vec<usize>,
    /// The node's tunable, such as `samples`, for which partial results are cached, so that a larger value costs
    /// only the difference. `None` if there is no such tunable.
    refines: Option<usize>,
}

impl Bench<'_> {
    /// Forecasts the time that it takes to measure `settings`. Settings in which a node and all nodes on which it
    /// depends have the same values share one run of the node, whose time counts once. If a measured point has
    /// these values, the time does not count.
    pub fn outlook(&self, settings: &[Assignment]) -> Outlook {
        let graph = self.base();
        let reach = reach(graph, &self.tunables);
        let wanted = graph.above(self.targets());
        let is_new = |setting: &&Assignment| self.points.iter().all(|point| point.assignment != **setting);
        let mut outlook = Outlook::default();
        // The largest cost, by node and by the values on which the node depends, except the value of `refines`.
        let mut costs: BTreeMap<(usize, Vec<usize>), Option<f64>> = BTreeMap::new();
        for setting in settings.iter().filter(is_new) {
            outlook.settings += 1;
            let plan = if self.points.is_empty() { self.plan(setting) } else { None };
            for node in (0..graph.nodes.len()).filter(|node| wanted[*node]) {
                let of = |assignment: &Assignment, with_refines: bool| -> Vec<usize> {
                    let all = reach[node]
                        .tunables
                        .iter()
                        .filter(|t| with_refines || Some(**t) != reach[node].refines);
                    all.map(|&t| assignment[t]).collect()
                };
                if self.points.iter().any(|point| of(&point.assignment, true) == of(setting, true)) {
                    continue;
                }
                let cost = self.cost(node, &reach[node], setting, plan.as_deref());
                let known = costs.entry((node, of(setting, false))).or_insert(cost);
                *known = known.zip(cost).map(|(a, b)| a.max(b)).or(*known).or(cost);
            }
        }
        for cost in costs.values() {
            match cost {
                Some(seconds) => outlook.seconds += seconds,
                None => outlook.unknown += 1,
            }
        }
        outlook
    }

    /// Forecast time in seconds of a node at a setting. It is derived from the node's time at the most similar
    /// measured setting, or from the plan if nothing was measured. `None` if there is no forecast.
    fn cost(
        &self,
        node: usize,
        reach: &Reach,
        setting: &Assignment,
        plan: Option<&[Planned]>,
    ) -> Option<f64> {
        let id = &self.base().nodes[node].id;
        let alike =
            |point: &&Point| reach.tunables.iter().filter(|&&t| point.assignment[t] == setting[t]).count();
        let Some(point) = self.points.iter().max_by_key(alike) else {
            return match plan?.iter().find(|planned| planned.id == *id)? {
                Planned { forecast: Some(seconds), .. } => Some(*seconds),
                Planned { fate: engine::Fate::Known | engine::Fate::Unwanted, .. } => Some(0.0),
                _ => None,
            };
        };
        let seconds = point.nodes.iter().find(|cost| cost.id == *id)?.seconds;
        let amount = |assignment: &Assignment| -> Option<f64> {
            let tunable = reach.refines?;
            self.tunables[tunable].values.get(assignment[tunable])?.parse().ok()
        };
        let ratio = amount(setting).zip(amount(&point.assignment)).filter(|(_, before)| *before > 0.0);
        Some(ratio.map_or(seconds, |(now, before)| seconds * now / before))
    }
}

/// The tunables on which each node of a graph depends.
fn reach(graph: &Graph, tunables: &[Tunable]) -> Vec<Reach> {
    let mut all: Vec<Vec<usize>> = vec![Vec::new(); graph.nodes.len()];
    let mut refines = vec![None; graph.nodes.len()];
    for (at, tunable) in tunables.iter().enumerate() {
        for node in graph.find_all(&tunable.node) {
            all[node].push(at);
            if graph.nodes[node].kind.preview.refines == Some(tunable.parameter) {
                refines[node] = Some(at);
            }
        }
    }
    for &node in graph.order() {
        let above: Vec<usize> = graph.reads(node).iter().flat_map(|&above| all[above].clone()).collect();
        all[node].extend(above);
        all[node].sort_unstable();
        all[node].dedup();
    }
    all.into_iter().zip(refines).map(|(tunables, refines)| Reach { tunables, refines }).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::time::{Duration, Instant};

    use engine::{Engine, Source, SourceRoot, Store};

    use super::*;
    use crate::bench::Miss;

    const GRAPH: &str = r#"Graph(
        version: 1, scene: (up: "+z", seed: 1), nodes: (
            demo: DemoScene(place: Courtyard, splats: 2000, width_px: 16, height_px: 16),
            view: SplatRender(splats: "demo.splats", rig: "demo.rig", alpha_cut: 0.03),
            save: WriteImage(image: "view.colour", path: "a.png"),
        ),
    )"#;

    #[test]
    fn what_is_measured_costs_nothing_and_what_never_ran_is_unknown() {
        let engine = Engine::new(Store::in_memory(), 2, 1 << 30);
        let graph =
            Graph::parse(Source::new("a.ron", GRAPH), &nodes::registry(), SourceRoot::new(".")).unwrap();
        let mut bench = Bench::new(&engine, &graph, &[], Arc::new(AtomicBool::new(false))).unwrap();
        let settings = [bench.preset(3), bench.preset(0), bench.preset(3)];
        let before = bench.outlook(&settings);
        assert!(before.settings == 3 && before.seconds == 0.0, "{before:?}");
        assert!(before.unknown >= 3, "the view at two settings, and the scene: {before:?}");
        assert!(bench.measure(&settings[0]).is_ok());
        let after = bench.outlook(&settings);
        assert!(after.settings == 1 && after.unknown == 0, "{after:?}");
        let view = bench.points[0].nodes.iter().find(|node| node.id == "view").unwrap();
        assert!(after.seconds >= view.seconds, "as the measured setting took: {after:?}");
        bench.end_at(Instant::now() - Duration::from_secs(1));
        assert!(matches!(bench.measure(&settings[1]), Err(Miss::Late)));
        assert!(bench.measure(&settings[0]).is_ok(), "it is known");
        assert_eq!(bench.outlook(&settings[..1]).settings, 0);
    }
}
