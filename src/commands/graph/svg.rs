//! Draws graphs as SVG. The number of columns is the number of nodes on the longest path. Wires are routed around
//! the nodes between their ends.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use engine::{Columns, Graph, Planned};
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

/// Returns the small picture of a node: a PNG file, its width and its height.
pub type Thumbnails<'a> = &'a dyn Fn(usize) -> Option<(Vec<u8>, [usize; 2])>;

/// The SVG text; `None` for a graph that is too large. If any node has a thumbnail, all boxes have room for one.
pub fn svg(graph: &Graph, plan: &[Planned], thumbnail: Thumbnails<'_>) -> Option<String> {
    let columns = Columns::of(graph)?;
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
    let (right, bottom) = (x(columns.0.len()) - GAP.0, y(columns.0.iter().map(Vec::len).max().unwrap_or(0)));
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        right + MARGIN,
        bottom - GAP.1 + MARGIN
    );
    // Writing to a string cannot fail.
    for (column, from, to) in columns.segments(graph) {
        let (x0, y0) = (x(column) + width, y(from) + box_height / 2);
        let (x1, y1) = (x(column + 1), y(to) + box_height / 2);
        let bend = GAP.0 / 2;
        let _ = write!(text, "<path d=\"M{x0} {y0} C{} {y0} {} {y1} {x1} {y1}", x0 + bend, x1 - bend);
        let through = columns.0[column + 1][to].passes.then(|| format!(" H{}", x1 + width));
        let _ = writeln!(text, "{}\" fill=\"none\" stroke=\"#888\"/>", through.unwrap_or_default());
    }
    for (column, entries) in columns.0.iter().enumerate() {
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
