//! The knobs of a graph, with their values in each preset.

use engine::{Graph, GraphKnob, Registry};

use crate::error::Error;
use crate::tunables::presets;

/// A knob of the graph and its values in the presets.
pub struct KnobRow {
    /// The knob.
    pub knob: GraphKnob,
    /// Value of the knob in each preset; `None` for a preset in which the value varies along an axis.
    pub levels: [Option<String>; 4],
    /// Minimum and maximum of the parameter, if it is a number.
    pub range: Option<(f64, f64)>,
}

/// The knobs that affect the nodes `only`. If `only` is empty, the knobs that affect any sink.
pub fn knob_rows(graph: &Graph, only: &[usize], registry: &Registry) -> Result<Vec<KnobRow>, Error> {
    // A graph's own preset may set fields that the built-in preset of the same name does not set.
    let laid = presets(graph, registry)?.map(|laid| {
        // Nodes are identified by name, since a preset may remove an axis.
        let asked = only.iter().filter_map(|&index| laid.find(&graph.nodes[index].id));
        laid.knobs(&asked.collect::<Vec<_>>())
    });
    let row = |knob: GraphKnob| {
        let same = |other: &&GraphKnob| other.node == knob.node && other.parameter == knob.parameter;
        let levels = laid.each_ref().map(|laid| {
            let knob = laid.iter().find(same).filter(|knob| !knob.varies);
            knob.map(|knob| knob.value.clone())
        });
        let params = graph.find_all(&knob.node).first().map(|&node| &graph.nodes[node].kind.params);
        let range = params.and_then(|params| params.iter().find(|spec| spec.name == knob.parameter)?.range);
        KnobRow { levels, range, knob }
    };
    Ok(graph.knobs(only).into_iter().map(row).collect())
}
