//! The graph as JSON for the page: nodes, wires, layout, parameters, and the text.

use std::collections::BTreeMap;

use engine::{Columns, Graph, GraphText, KindEntry, PortSpec, Role};
use serde_json::{Map, Value, json};

use crate::state::State;

/// Maximum length in bytes of a text that the page shows.
const MOST_TEXT: usize = 1 << 20;

/// Describes the graph of a state.
pub fn view(state: &State) -> Value {
    let mut view = json!({
        "digest": state.digest,
        "text": if state.text.len() <= MOST_TEXT { state.text.as_str().into() } else { Value::Null },
        "mistakes": state.mistakes,
        "problem": state.problem,
    });
    if let Some(graph) = &state.graph {
        let document = GraphText::new(&state.text);
        let mut kinds = BTreeMap::new();
        for node in &graph.nodes {
            kinds.entry(node.kind.camel_name()).or_insert_with(|| kind(&node.kind));
        }
        let (columns, segments) = layout(graph);
        view["name"] = graph.source.name.as_str().into();
        view["confined"] = graph.root.is_confined().into();
        view["kinds"] = json!(kinds);
        view["nodes"] =
            (0..graph.nodes.len()).map(|index| node(graph, &document, &state.text, index)).collect();
        view["wires"] = wires(graph);
        view["columns"] = columns;
        view["segments"] = segments;
        let targets = if state.only.is_empty() { graph.targets() } else { state.only.clone() };
        view["targets"] = targets.into_iter().map(|index| graph.nodes[index].id.as_str()).collect();
    }
    view
}

fn ports(ports: &[PortSpec]) -> Value {
    ports.iter().map(|port| json!({"name": port.name, "type": port.artifact.name, "doc": port.doc})).collect()
}

fn kind(kind: &KindEntry) -> Value {
    let params = kind.params.iter().map(|param| {
        let choices = (param.choices)().into_iter().map(|(name, doc)| json!({"name": name, "doc": doc}));
        json!({
            "name": param.name,
            "doc": param.doc,
            "type": (param.describe)(),
            "choices": choices.collect::<Value>(),
            "default": (param.default)(),
            "range": param.range.map(|(low, high)| [low, high]),
            "unit": param.unit,
            "is_path": param.role != Role::Value,
            "knob": param.knob.map(|knob| json!({"kind": knob.kind, "ladder": knob.ladder})),
        })
    });
    json!({
        "name": kind.name,
        "doc": kind.doc,
        "params": params.collect::<Value>(),
        "inputs": ports(&kind.inputs),
        "outputs": ports(&kind.outputs),
    })
}

fn node(graph: &Graph, document: &GraphText<'_>, text: &str, index: usize) -> Value {
    let node = &graph.nodes[index];
    // An instance along axes is defined by the node of the file that has the name of the instance without the axis
    // values.
    let name =
        if node.point.is_empty() { node.id.as_str() } else { node.id.split('/').next().unwrap_or(&node.id) };
    let values = node.values().into_iter().map(|(field, value)| {
        let place = document.field(name, field);
        let raw = place.clone().and_then(|place| text.get(place));
        (
            field.to_owned(),
            json!({"value": value, "text": raw, "span": place.map(|place| [place.start, place.end])}),
        )
    });
    let values: Map<String, Value> = values.collect();
    let span = document.node(name);
    let line = span.as_ref().map(|span| text[..span.start].matches('\n').count() + 1);
    json!({
        "id": node.id,
        "in_file": name,
        "kind": node.kind.camel_name(),
        "point": node.point,
        "values": values,
        "span": span.map(|span| [span.start, span.end]),
        "line": line,
        "sink": node.sink_path,
    })
}

/// The wires, each as (from node, output, to node, input).
fn wires(graph: &Graph) -> Value {
    let mut all = Vec::new();
    for (below, node) in graph.nodes.iter().enumerate() {
        for (port, wires) in node.kind.inputs.iter().zip(&node.inputs) {
            for wire in wires {
                let output = graph.nodes[wire.node].kind.outputs[wire.port].name;
                all.push(json!([wire.node, output, below, port.name]));
            }
        }
    }
    all.into()
}

/// The layout: for each column, its entries, each as (node, true if only wires pass through the entry), and the
/// segments between columns. `null` if the graph is too large to draw.
fn layout(graph: &Graph) -> (Value, Value) {
    let Some(columns) = Columns::of(graph) else { return (Value::Null, Value::Null) };
    let entries = columns
        .0
        .iter()
        .map(|column| column.iter().map(|entry| json!([entry.node, entry.passes])).collect::<Value>());
    (entries.collect(), json!(columns.segments(graph)))
}
