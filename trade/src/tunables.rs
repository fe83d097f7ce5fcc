//! The knobs of a graph in the form in which a search uses them: their possible values, and the values that the
//! presets select.

use engine::{Diagnostics, Graph, KnobKind, PRESETS, Registry};

use crate::error::Error;

/// A knob of the graph, or another field that a preset sets, with its possible values. The values of a knob are
/// sorted by increasing work and decreasing error.
pub struct Tunable {
    /// Name of the node.
    pub node: String,
    /// Name of the node's parameter.
    pub parameter: &'static str,
    /// The possible values, as they are written in a graph.
    pub values: Vec<String>,
    /// Number of values by which a search moves along `values` in one step.
    pub step: usize,
    /// The index in `values` of the graph's own value.
    pub now: usize,
    /// The index in `values` of the value in each preset.
    pub presets: [usize; 4],
    /// True if this is a knob. Only the values of knobs are ordered.
    pub knob: bool,
}

impl Tunable {
    /// Returns a remark if the value in the graph or in a preset is finer than the value in the preset `reference`.
    pub fn finer_than_the_reference(&self) -> Option<String> {
        let [draft, preview, finer, reference] = self.presets;
        let all = [(draft, "`draft`"), (preview, "`preview`"), (finer, "`final`"), (self.now, "the graph")];
        let (at, name) =
            all.into_iter().filter(|(at, _)| self.knob && *at > reference).max_by_key(|(at, _)| *at)?;
        let Self { node, parameter, values, .. } = self;
        Some(format!(
            "the preset `reference` sets `{node}.{parameter}` to {}, but {name} has the finer value {}; the difference counts as an error",
            values[reference], values[at]
        ))
    }
}

/// For each tunable, the index of the selected value.
pub type Assignment = Vec<usize>;

/// Returns the graph with each preset applied, in the order of [`PRESETS`].
pub fn presets(graph: &Graph, registry: &Registry) -> Result<[Graph; 4], Error> {
    let preset = |name: &str| {
        let source = graph.source.clone().with_preset(name, registry);
        let setting = format!("`--preset {name}`");
        let wrong = |mistakes: Diagnostics| Error::Setting { setting, why: mistakes.to_string() };
        Graph::parse(source, registry, graph.root.clone()).map_err(wrong)
    };
    let [draft, preview, finer, reference] = PRESETS.map(preset);
    Ok([draft?, preview?, finer?, reference?])
}

/// Checks that `form`, which is `graph` with other settings, has the same nodes as `graph`, so that an index refers
/// to the same node in both graphs. The nodes differ if a preset sets a field that varies along an axis, since this
/// removes the axis from the nodes that depend on the field. The error says why the nodes differ.
pub fn same_nodes(graph: &Graph, form: &Graph) -> Result<(), String> {
    let ids = |graph: &Graph| graph.nodes.iter().map(|node| node.id.clone()).collect::<Vec<_>>();
    let (all, others) = (ids(graph), ids(form));
    match all.iter().zip(&others).find(|(id, other)| id != other) {
        None if all.len() == others.len() => Ok(()),
        found => {
            let (id, other) = found.map_or(("", ""), |(id, other)| (id, other));
            Err(format!(
                "it sets a field that varies along an axis, so the graph has other nodes (`{other}` instead of `{id}`), and the pictures cannot be compared; set only fields that do not vary"
            ))
        }
    }
}

/// The tunables of the nodes `targets` and of all nodes on which they depend. They include the knobs, and other
/// fields that the graph's own presets set, since a preset `reference` may set, for example, another threshold.
/// Fields that vary along an axis are left out.
pub fn tunables(graph: &Graph, targets: &[usize], registry: &Registry) -> Result<Vec<Tunable>, Error> {
    let laid = presets(graph, registry)?;
    for (name, form) in PRESETS.iter().zip(&laid) {
        let setting = || format!("`--preset {name}`");
        same_nodes(graph, form).map_err(|why| Error::Setting { setting: setting(), why })?;
    }
    let knobs = laid.each_ref().map(|graph| graph.knobs(targets));
    let mut tunables: Vec<Tunable> = Vec::new();
    for knob in graph.knobs(targets).into_iter().filter(|knob| !knob.varies) {
        let of = |level: usize| {
            let known = knobs[level].iter().find(|k| k.node == knob.node && k.parameter == knob.parameter);
            known.map_or(knob.value.as_str(), |k| k.value.as_str())
        };
        let mut values = knob.knob.values();
        let order = knob.knob.kind;
        for value in [knob.value.as_str(), of(0), of(1), of(2), of(3)] {
            insert(&mut values, value, order);
        }
        let least = graph.nodes[graph.find_all(&knob.node)[0]].kind.params.iter();
        let least = least.filter(|spec| spec.name == knob.parameter).find_map(|spec| spec.range);
        let step = widen(&mut values, order, least.map_or(1.0, |(least, _)| least));
        let at = |value: &str| values.iter().position(|known| equal(known, value)).unwrap_or(0);
        let (now, presets) = (at(&knob.value), [0, 1, 2, 3].map(|level| at(of(level))));
        tunables.push(Tunable {
            node: knob.node.clone(),
            parameter: knob.parameter,
            now,
            presets,
            step,
            values,
            knob: true,
        });
    }
    for (level, form) in laid.iter().enumerate() {
        for (node, parameter, [here, there]) in graph.fields_otherwise(form, targets) {
            let known =
                tunables.iter().position(|tunable| tunable.node == node && tunable.parameter == parameter);
            let at = known.unwrap_or_else(|| {
                tunables.push(Tunable {
                    node,
                    parameter,
                    now: 0,
                    presets: [0; 4],
                    step: 1,
                    values: vec![here],
                    knob: false,
                });
                tunables.len() - 1
            });
            let tunable = &mut tunables[at];
            if !tunable.values.contains(&there) {
                tunable.values.push(there.clone());
            }
            tunable.presets[level] = tunable.values.iter().position(|known| *known == there).unwrap_or(0);
        }
    }
    Ok(tunables)
}

/// Adds values for a search: half and a quarter of the first value, if these are at least `least`. For numbers of
/// samples, which determine most of the work, also adds a value between each pair of neighbours. Returns the number
/// of values by which a search moves along `values` in one step.
fn widen(values: &mut Vec<String>, kind: KnobKind, least: f64) -> usize {
    let whole = |text: &String| text.parse::<u64>().ok();
    if values.len() < 2 || !matches!(kind, KnobKind::Samples | KnobKind::Resolution | KnobKind::Depth) {
        return 1;
    }
    if let Some(first) = values.first().and_then(whole) {
        let below = [first / 2, first / 4].into_iter().filter(|n| *n < first && *n as f64 >= least);
        below.for_each(|n| insert(values, &n.to_string(), kind));
    }
    if kind != KnobKind::Samples {
        return 1;
    }
    let between: Vec<u64> =
        values.windows(2).filter_map(|two| Some(whole(&two[0])?.midpoint(whole(&two[1])?))).collect();
    between.iter().for_each(|n| insert(values, &n.to_string(), kind));
    2
}

/// True if two texts are equal, or are the same number in different formats.
fn equal(a: &str, b: &str) -> bool {
    a == b || a.parse::<f64>().is_ok_and(|a| b.parse() == Ok(a))
}

/// Inserts a value into a list of increasing or decreasing values, so that the order is kept. A value that is not a
/// number is inserted at the front.
fn insert(values: &mut Vec<String>, value: &str, kind: KnobKind) {
    if values.iter().any(|known| equal(known, value)) {
        return;
    }
    let number = |text: &str| {
        let text = text.strip_prefix("Some(").and_then(|text| text.strip_suffix(')')).unwrap_or(text);
        match (text.parse::<f64>(), kind) {
            // `None` means that no error is tolerated, and a limit of 0 that there is no limit.
            _ if text == "None" => Some(0.0),
            (Ok(0.0), KnobKind::Limit) => Some(f64::INFINITY),
            (number, _) => number.ok(),
        }
    };
    let ends = values.first().and_then(|v| number(v)).zip(values.last().and_then(|v| number(v)));
    let place = match (number(value), ends) {
        (Some(new), Some((first, last))) if first != last => {
            let before = |known: f64| if first < last { known < new } else { known > new };
            values.iter().take_while(|known| number(known).is_some_and(before)).count()
        }
        _ => 0,
    };
    values.insert(place, value.to_owned());
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Source, SourceRoot};

    /// A graph in which `fit-probe` chooses the size of the light. A coarse panorama is rendered first for this
    /// purpose.
    const FITTED: &str = r#"Graph(
        version: 1, scene: (up: "+z", seed: 1), nodes: (
            demo:   DemoScene(splats: 4000, width_px: 36, height_px: 26),
            pose:   Pose(),
            placed: Place(object: "demo.object", pose: "pose"),
            small:  CubeRig(at: "pose", size_px: 64),
            seen:   SplatRender(splats: "demo.splats", rig: "small"),
            look:   Stitch(views: "seen", width_px: 128),
            lamps:  PredictExposure(pano: "look", evs: [-6.0], method: Region),
            dim:    FuseHdr(base: "look", brackets: "lamps"),
            broad:  CubeRig(at: "pose", size_px: 200),
            probe:  FitProbe(rig: "broad", objects: ["placed"], look: "dim"),
            faces:  SplatRender(splats: "demo.splats", rig: "probe"),
            pano:   Stitch(views: "faces", width_px: 300, as_views: true),
            save:   WriteImage(image: "pano", path: "pano.png"),
        ),
    )"#;

    // Presets change the nodes that compute the light. They do not change a coarse panorama that only `fit-probe`
    // reads, to choose sizes, unless the panorama is also an output or a preset of the graph sets it. This test
    // fails if `LOOKS` of `fit-probe` is empty, if `shown_by` equals `above`, or if `looked_at` is always false.
    #[test]
    fn what_only_looks_is_turned_by_no_preset() {
        let registry = nodes::registry();
        let parse = |text: &str| {
            let graph = Graph::parse(Source::new("graph.ron", text), &registry, SourceRoot::new("."));
            graph.unwrap_or_else(|mistakes| panic!("{mistakes}"))
        };
        let turned = |text: &str| -> Vec<String> {
            let graph = parse(text);
            let all = tunables(&graph, &graph.targets(), &registry).expect("are found");
            let fine = |tunable: &Tunable| tunable.presets.iter().any(|at| *at != tunable.now);
            all.iter().filter(|t| fine(t)).map(|t| format!("{}.{}", t.node, t.parameter)).collect()
        };
        let names = turned(FITTED);
        assert!(names.contains(&"broad.size_px".to_owned()) && names.contains(&"pano.width_px".to_owned()));
        let looks =
            |name: &String| ["small.", "seen.", "look.", "lamps."].iter().any(|of| name.starts_with(of));
        assert!(!names.iter().any(looks), "{names:?}");
        let seen = FITTED.replace("save:", "two: WriteImage(image: \"look\", path: \"look.png\"), save:");
        assert!(turned(&seen).contains(&"look.width_px".to_owned()));
        let own = FITTED.replace("nodes: (", "presets: (draft: (look: (width_px: 64))), nodes: (");
        assert!(turned(&own).contains(&"look.width_px".to_owned()));
    }

    #[test]
    fn values_are_put_where_they_belong_on_rising_and_falling_ladders() {
        let with = |ladder: &[&str], value: &str| {
            let mut values: Vec<String> = ladder.iter().map(|v| (*v).to_owned()).collect();
            value.split(' ').for_each(|value| insert(&mut values, value, KnobKind::Cutoff));
            values.join(" ")
        };
        let errors = "Some(0.1) Some(0.2) None Some(0.05)";
        assert_eq!(with(&["None"], errors), "Some(0.2) Some(0.1) Some(0.05) None", "none may be left");
        let mut limits = vec!["0.0".to_owned()];
        ["4.0", "2.0", "16.0"].iter().for_each(|value| insert(&mut limits, value, KnobKind::Limit));
        assert_eq!(limits, ["2.0", "4.0", "16.0", "0.0"], "0 means unlimited");
        assert_eq!(with(&["4", "16", "64"], "32"), "4 16 32 64");
        assert_eq!(with(&["4", "16", "64"], "16.0"), "4 16 64");
        assert_eq!(with(&["4", "16", "64"], "100"), "4 16 64 100");
        assert_eq!(with(&["0.03", "0.01", "0.0"], "0.02"), "0.03 0.02 0.01 0.0");
        assert_eq!(with(&["0.0"], "1.0"), "1.0 0.0", "a filter that only the reference turns off");
        assert_eq!(with(&["F32", "F64"], "F16"), "F16 F32 F64");
    }

    #[test]
    fn a_reference_that_is_coarser_than_what_it_judges_is_reported() {
        let values: Vec<String> = ["64", "128", "256"].map(str::to_owned).to_vec();
        let of = |now, presets, knob| Tunable {
            node: "pano".to_owned(),
            parameter: "width_px",
            values: values.clone(),
            step: 1,
            now,
            presets,
            knob,
        };
        assert_eq!(of(1, [0, 1, 2, 2], true).finer_than_the_reference(), None);
        let reported = of(0, [0, 0, 2, 1], true).finer_than_the_reference();
        assert!(
            reported
                .is_some_and(|t| t.contains("`pano.width_px` to 128, but `final` has the finer value 256"))
        );
        assert!(
            of(2, [0, 0, 0, 1], true)
                .finer_than_the_reference()
                .is_some_and(|t| t.contains("the graph has the finer value 256"))
        );
        assert_eq!(of(2, [0, 0, 0, 1], false).finer_than_the_reference(), None, "its values have no order");
    }

    #[test]
    fn a_search_may_go_below_the_presets_and_between_samples() {
        let widened = |ladder: &[&str], kind, least| {
            let mut values: Vec<String> = ladder.iter().map(|v| (*v).to_owned()).collect();
            let step = widen(&mut values, kind, least);
            format!("{} by {step}", values.join(" "))
        };
        assert_eq!(widened(&["4", "8", "16"], KnobKind::Samples, 1.0), "1 2 3 4 6 8 12 16 by 2");
        assert_eq!(widened(&["1", "2", "4"], KnobKind::Samples, 1.0), "1 2 3 4 by 2");
        assert_eq!(widened(&["3", "7"], KnobKind::Depth, 1.0), "1 3 7 by 1");
        assert_eq!(widened(&["2", "4"], KnobKind::Depth, 0.0), "0 1 2 4 by 1");
        assert_eq!(widened(&["4"], KnobKind::Depth, 0.0), "4 by 1", "no preset turns it");
        assert_eq!(widened(&["0.1", "0.01"], KnobKind::Cutoff, 0.0), "0.1 0.01 by 1");
    }
}
