//! Draws graphs as SVG. The number of columns is the number of nodes on the longest path. Wires are routed around
//! the nodes between their ends.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use engine::{Graph, Planned};
use trade::escape::escaped;

use super::state::state;
use crate::session::sheet::THUMBNAIL;

/// Height of the texts of a box, in pixels.
const TEXTS: usize = 52;
/// Horizontal and vertical space between boxes, in pixels.
const GAP: (usize, usize) = (60, 18);
const MARGIN: usize = 20;
/// Width in pixels that is reserved for a letter; few letters are wider.
const LETTER: usize = 8;

/// An entry of a column: a node, or the wires of a node that continue to a later column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Entry {
    node: usize,
    passes: bool,
}

/// Maximum number of entries of a drawing. A long chain of nodes, each of which is also wired to the last node,
/// would need millions of entries.
const MOST_ENTRIES: usize = 50_000;

/// Returns the small picture of a node: a PNG file, its width and its height.
pub type Thumbnails<'a> = &'a dyn Fn(usize) -> Option<(Vec<u8>, [usize; 2])>;

/// The SVG text; `None` for a graph that is too large. If any node has a thumbnail, all boxes have room for one.
pub fn svg(graph: &Graph, plan: &[Planned], thumbnail: Thumbnails<'_>) -> Option<String> {
    let columns = columns(graph)?;
    let pictures: Vec<_> = (0..plan.len()).map(thumbnail).collect();
    let any = pictures.iter().any(Option::is_some);
    let box_height = TEXTS + if any { THUMBNAIL[1] + 8 } else { 0 };
    let texts = |node: &Planned| (node.id.clone(), format!("{} · {}", node.kind, state(&node.fate).0));
    let longest = plan.iter().map(|node| {
        let (name, kind) = texts(node);
        name.chars().count().max(kind.chars().count())
    });
    let least = if any { THUMBNAIL[0] } else { 0 };
    let width = (longest.max().unwrap_or(0) * LETTER).max(least) + 16;
    let x = |column: usize| MARGIN + column * (width + GAP.0);
    let y = |row: usize| MARGIN + row * (box_height + GAP.1);
    let (right, bottom) = (x(columns.len()) - GAP.0, y(columns.iter().map(Vec::len).max().unwrap_or(0)));
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        right + MARGIN,
        bottom - GAP.1 + MARGIN
    );
    // Writing to a string cannot fail.
    for (column, from, to) in segments(graph, &columns) {
        let (x0, y0) = (x(column) + width, y(from) + box_height / 2);
        let (x1, y1) = (x(column + 1), y(to) + box_height / 2);
        let bend = GAP.0 / 2;
        let _ = write!(text, "<path d=\"M{x0} {y0} C{} {y0} {} {y1} {x1} {y1}", x0 + bend, x1 - bend);
        let through = columns[column + 1][to].passes.then(|| format!(" H{}", x1 + width));
        let _ = writeln!(text, "{}\" fill=\"none\" stroke=\"#888\"/>", through.unwrap_or_default());
    }
    for (column, entries) in columns.iter().enumerate() {
        for (row, entry) in entries.iter().enumerate().filter(|(_, entry)| !entry.passes) {
            let (x, y, fill) = (x(column), y(row), state(&plan[entry.node].fate).1);
            let (name, kind) = texts(&plan[entry.node]);
            let picture = pictures[entry.node].as_ref().map(|(png, [wide, high])| {
                format!(
                    "<image x=\"{}\" y=\"{}\" width=\"{wide}\" height=\"{high}\" href=\"data:image/png;base64,{}\"/>",
                    x + 8,
                    y + TEXTS,
                    BASE64_STANDARD.encode(png)
                )
            });
            let picture = picture.unwrap_or_default();
            let _ = writeln!(
                text,
                "<g><rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{box_height}\" rx=\"6\" fill=\"{fill}\" \
                 stroke=\"#555\"/>{picture}<text x=\"{}\" y=\"{}\" font-weight=\"bold\">{}</text>\
                 <text x=\"{}\" y=\"{}\" fill=\"#333\">{}</text></g>",
                x + 8,
                y + 21,
                escaped(&name),
                x + 8,
                y + 41,
                escaped(&kind)
            );
        }
    }
    Some(text + "</svg>\n")
}

/// The entries of each column, from top to bottom. A node is in the column after the rightmost of its inputs.
/// Within a column, entries are sorted by the average row of their inputs in the previous column, then by the
/// position of their node in the file. `None` if there are more than [`MOST_ENTRIES`].
fn columns(graph: &Graph) -> Option<Vec<Vec<Entry>>> {
    let mut column = vec![0; graph.nodes.len()];
    let mut last = vec![0; graph.nodes.len()];
    for &index in graph.order() {
        column[index] = graph.reads(index).iter().map(|&above| column[above] + 1).max().unwrap_or(0);
        for &above in graph.reads(index) {
            last[above] = last[above].max(column[index]);
        }
    }
    let count = column.iter().max().map_or(0, |last| last + 1);
    let entries: usize =
        (0..graph.nodes.len()).map(|node| last[node].max(column[node] + 1) - column[node]).sum();
    if entries > MOST_ENTRIES {
        return None;
    }
    let mut starting: Vec<Vec<usize>> = vec![Vec::new(); count];
    (0..graph.nodes.len()).for_each(|node| starting[column[node]].push(node));
    let mut columns: Vec<Vec<Entry>> = Vec::with_capacity(count);
    let mut rows = Rows::new(graph);
    let mut passing: BTreeSet<usize> = BTreeSet::new();
    for (at, nodes) in starting.iter().enumerate() {
        passing.retain(|&node| last[node] > at);
        let own = nodes.iter().map(|&node| Entry { node, passes: false });
        let mut entries: Vec<Entry> =
            own.chain(passing.iter().map(|&node| Entry { node, passes: true })).collect();
        if let Some(before) = columns.last() {
            rows.set(before);
            entries.sort_by_cached_key(|entry| {
                let above = above(graph, entry);
                let rows: Vec<usize> = above.iter().filter_map(|&node| rows.of(node)).collect();
                // Not negative, so that the order of the bits is that of the numbers.
                let height = rows.iter().sum::<usize>() as f64 / rows.len().max(1) as f64;
                (height.to_bits(), entry.node)
            });
        }
        columns.push(entries);
        passing.extend(nodes);
    }
    Some(columns)
}

/// The nodes whose entries in the previous column are wired to `entry`.
fn above<'g>(graph: &'g Graph, entry: &'g Entry) -> &'g [usize] {
    if entry.passes { std::slice::from_ref(&entry.node) } else { graph.reads(entry.node) }
}

/// Rows of the nodes in one column.
struct Rows {
    /// For each node, the index of the last column that contained it, and its row in that column.
    of: Vec<(usize, usize)>,
    column: usize,
}

impl Rows {
    fn new(graph: &Graph) -> Self {
        Self { of: vec![(0, 0); graph.nodes.len()], column: 0 }
    }

    /// Replaces the column, in time proportional to the length of the new column.
    fn set(&mut self, column: &[Entry]) {
        self.column += 1;
        column.iter().enumerate().for_each(|(row, entry)| self.of[entry.node] = (self.column, row));
    }

    fn of(&self, node: usize) -> Option<usize> {
        let (column, row) = self.of[node];
        (column == self.column).then_some(row)
    }
}

/// The line segments between adjacent columns, each as (column, row in it, row in the next column). Wires from the
/// same node share segments.
fn segments(graph: &Graph, columns: &[Vec<Entry>]) -> BTreeSet<(usize, usize, usize)> {
    let mut segments = BTreeSet::new();
    let mut rows = Rows::new(graph);
    for (column, pair) in columns.windows(2).enumerate() {
        rows.set(&pair[0]);
        for (to, entry) in pair[1].iter().enumerate() {
            let from = above(graph, entry).iter().filter_map(|&node| rows.of(node));
            segments.extend(from.map(|from| (column, from, to)));
        }
    }
    segments
}
