//! `graph`: a picture of a graph with the state of its results.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use clap::{Args, ValueEnum};
use engine::{Fate, Graph, Planned};

use crate::session::{EngineArgs, Error, GraphArgs};

/// Draws a graph with the state of its results.
#[derive(Debug, Args)]
pub struct Draw {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// How to draw
    #[arg(long, value_enum, default_value_t = Format::Dot)]
    format: Format,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Graphviz
    Dot,
    /// A picture for a browser
    Svg,
    /// For Markdown pages
    Mermaid,
}

impl Draw {
    /// Prints the drawing.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let (graph, only) = (&loaded.graph, &loaded.only);
        let plan = self.engine.open()?.plan(graph, only);
        super::print(&match self.format {
            Format::Dot => dot(graph, &plan),
            Format::Mermaid => mermaid(graph, &plan),
            Format::Svg => svg(graph, &plan),
        })?;
        Ok(0)
    }
}

/// (word, fill colour) of a state.
fn state(fate: &Fate) -> (&'static str, &'static str) {
    match fate {
        Fate::Known => ("known", "#cfe8cf"),
        Fate::Lost => ("lost", "#ffe4c0"),
        Fate::Runs(_) => ("runs", "#ffd9a0"),
        Fate::Follows(_) => ("may run", "#fff0cc"),
        Fate::Fails(_) => ("fails", "#f4b6b6"),
        Fate::Unwanted => ("not wanted", "#e6e6e6"),
    }
}

/// Each wire as (from node, output, to node, input).
fn wires(graph: &Graph) -> Vec<(usize, &'static str, usize, &'static str)> {
    let mut all = Vec::new();
    for (below, node) in graph.nodes.iter().enumerate() {
        for (port, wires) in node.kind.inputs.iter().zip(&node.inputs) {
            for wire in wires {
                let output = graph.nodes[wire.node].kind.outputs[wire.port].name;
                all.push((wire.node, output, below, port.name));
            }
        }
    }
    all
}

// Writing to a string cannot fail, so results of writeln! are dropped below.

fn dot(graph: &Graph, plan: &[Planned]) -> String {
    let mut text =
        "digraph {\n  rankdir=LR;\n  node [shape=box, style=filled, fontname=\"sans-serif\"];\n".to_owned();
    for node in plan {
        let (word, fill) = state(&node.fate);
        let _ = writeln!(
            text,
            "  \"{}\" [label=\"{}\\n{}\\n{word}\", fillcolor=\"{fill}\"];",
            node.id, node.id, node.kind
        );
    }
    for (above, output, below, input) in wires(graph) {
        let (above, below) = (&plan[above].id, &plan[below].id);
        let _ = writeln!(
            text,
            "  \"{above}\" -> \"{below}\" [taillabel=\"{output}\", headlabel=\"{input}\", fontsize=9];"
        );
    }
    text + "}\n"
}

fn mermaid(graph: &Graph, plan: &[Planned]) -> String {
    let mut text = "flowchart LR\n".to_owned();
    // The names of instances hold signs that have a meaning there.
    for (index, node) in plan.iter().enumerate() {
        let (word, fill) = state(&node.fate);
        let _ = writeln!(text, "  n{index}[\"{}<br/>{}<br/>{word}\"]", node.id, node.kind);
        let _ = writeln!(text, "  style n{index} fill:{fill}");
    }
    for (above, output, below, _) in wires(graph) {
        let _ = writeln!(text, "  n{above} -- {output} --> n{below}");
    }
    text
}

const BOX: (usize, usize) = (150, 52);
const GAP: (usize, usize) = (70, 22);

fn svg(graph: &Graph, plan: &[Planned]) -> String {
    // A column is the longest way from a node without inputs; rows follow the file.
    let mut column = vec![0; graph.nodes.len()];
    for &index in graph.order() {
        let above = graph.nodes[index].inputs.iter().flatten().map(|wire| column[wire.node] + 1);
        column[index] = above.max().unwrap_or(0);
    }
    let mut rows = vec![0; column.iter().max().map_or(0, |last| last + 1)];
    let place: Vec<(usize, usize)> = column
        .iter()
        .map(|&at| {
            rows[at] += 1;
            (20 + at * (BOX.0 + GAP.0), 20 + (rows[at] - 1) * (BOX.1 + GAP.1))
        })
        .collect();
    let (width, height) = (
        40 + rows.len() * (BOX.0 + GAP.0) - GAP.0.min(rows.len() * GAP.0),
        40 + rows.iter().max().unwrap_or(&0) * (BOX.1 + GAP.1),
    );
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    let lines: BTreeSet<(usize, usize)> = wires(graph).iter().map(|wire| (wire.0, wire.2)).collect();
    for (above, below) in lines {
        let (x0, y0) = (place[above].0 + BOX.0, place[above].1 + BOX.1 / 2);
        let (x1, y1) = (place[below].0, place[below].1 + BOX.1 / 2);
        let bend = (x1.saturating_sub(x0) / 2).max(20);
        let _ = writeln!(
            text,
            "<path d=\"M{x0} {y0} C{} {y0} {} {y1} {x1} {y1}\" fill=\"none\" stroke=\"#888\"/>",
            x0 + bend,
            x1.saturating_sub(bend)
        );
    }
    for (node, (x, y)) in plan.iter().zip(&place) {
        let (word, fill) = state(&node.fate);
        let _ = writeln!(
            text,
            "<g><title>{} {}: {word}</title><rect x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" rx=\"6\" \
             fill=\"{fill}\" stroke=\"#555\"/><text x=\"{}\" y=\"{}\" font-weight=\"bold\">{}</text>\
             <text x=\"{}\" y=\"{}\" fill=\"#333\">{} · {word}</text></g>",
            node.id,
            node.kind,
            BOX.0,
            BOX.1,
            x + 8,
            y + 21,
            node.id,
            x + 8,
            y + 41,
            node.kind
        );
    }
    text + "</svg>\n"
}
