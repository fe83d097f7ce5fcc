//! `graph`: a drawing of a graph with the state of its results.

mod state;
mod svg;

use std::fmt::Write as _;

use clap::{Args, ValueEnum};
use engine::{Fate, Graph, Planned};
use state::state;
use svg::svg;

use crate::session::{EngineArgs, Error, GraphArgs, sheet};
use crate::terminal;

/// Draws a graph with the state of its results.
#[derive(Debug, Args)]
pub struct Draw {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Dot)]
    format: Format,
    /// In an SVG, draw small pictures of the results that are in the cache
    #[arg(long)]
    thumbnails: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Graphviz
    Dot,
    /// An image for a browser
    Svg,
    /// Mermaid, for Markdown pages
    Mermaid,
}

impl Draw {
    /// Prints the drawing.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let (graph, only) = (&loaded.graph, &loaded.only);
        let engine = self.engine.open()?;
        let plan = engine.plan(graph, only);
        if self.thumbnails && !matches!(self.format, Format::Svg) {
            return Err(Error::usage("`--thumbnails` requires `--format svg`"));
        }
        let thumbnail = |node: usize| {
            let known = self.thumbnails && matches!(plan[node].fate, Fate::Known);
            known.then(|| sheet::thumbnail(&engine, graph, node)).flatten()
        };
        terminal::print(&match self.format {
            Format::Dot => dot(graph, &plan),
            Format::Mermaid => mermaid(graph, &plan),
            Format::Svg => svg(graph, &plan, &thumbnail).ok_or_else(too_large)?,
        })?;
        Ok(0)
    }
}

fn too_large() -> Error {
    Error::usage("this graph is too large to draw as SVG; draw it with `--format dot` and Graphviz")
}

/// The wires of a graph, each as (index of the source node, name of its output, index of the target node, name of
/// its input).
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
    // Names of instances contain characters that Mermaid interprets.
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
