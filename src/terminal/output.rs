//! Writes to standard output and standard error.

use std::io::{IsTerminal, Write};

use engine::{Diagnostics, Event, Graph};
use serde::Serialize;

/// Prints an error that ends the command to standard error.
pub fn error(message: &str) {
    let styled = message.starts_with("error") || message.starts_with('\u{1b}');
    let _ = writeln!(std::io::stderr(), "{}{message}", if styled { "" } else { "error: " });
}

/// Prints mistakes with their places: as a line of JSON on standard output, or with underlined excerpts of the
/// graph on standard error.
pub fn mistakes(found: &Diagnostics, json: bool) {
    if json {
        return json_line(&Event::Mistakes { list: found.mistakes(), text: String::new() });
    }
    error(&found.render(colours()));
}

/// The warning for a graph without sinks; `None` if the graph has sinks or nodes were selected by name.
pub fn no_file(graph: &Graph, only: &[usize]) -> Option<String> {
    if !only.is_empty() || graph.nodes.iter().any(|node| node.sink_path.is_some()) {
        return None;
    }
    Some(format!(
        "no node writes a file, so results go to the cache only ({}); \
         add `save: WriteImage(image: \"..\", path: \"final.png\")`",
        names(graph, graph.targets().into_iter())
    ))
}

/// The names of some nodes, at most the first 40.
fn names(graph: &Graph, nodes: impl Iterator<Item = usize>) -> String {
    const MOST: usize = 40;
    let mut names: Vec<&str> = nodes.take(MOST + 1).map(|node| graph.nodes[node].id.as_str()).collect();
    if names.len() > MOST {
        names[MOST] = "..";
    }
    names.join(", ")
}

/// Prints one line of JSON to standard output. A closed pipe does not stop the program.
pub fn json_line(value: &impl Serialize) {
    if let Ok(line) = serde_json::to_string(value) {
        let _ = writeln!(std::io::stdout().lock(), "{line}");
    }
}

/// Prints a remark to standard error.
pub fn remark(message: &str) {
    let _ = writeln!(std::io::stderr(), "{message}");
}

/// True if standard error supports colours.
pub fn colours() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
}

/// Prints a text to standard output. A closed pipe is not an error.
pub fn print(text: &str) -> std::io::Result<()> {
    use std::io::ErrorKind;
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}
