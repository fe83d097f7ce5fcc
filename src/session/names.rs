//! Resolution of the names of nodes and inputs.

use std::collections::BTreeSet;

use engine::{Graph, Wire, nearest};

use super::error::Error;
use crate::terminal;

/// The wires of an input with this name; empty if the node has no such input or nothing is wired to it.
pub fn wires<'a>(graph: &'a Graph, node: usize, input: &str) -> &'a [Wire] {
    let node = &graph.nodes[node];
    let at = node.kind.inputs.iter().position(|port| port.name == input);
    at.and_then(|at| node.inputs.get(at)).map_or(&[], Vec::as_slice)
}

/// Name of the axis whose values `--frames` selects.
const FRAME: &str = "frame";
/// Maximum number of names in a message.
const MOST: usize = 40;

/// Indices of the nodes that `--only` and `--frames` select; an empty list if neither is given.
pub fn wanted(graph: &Graph, only: &[String], frames: Option<&str>) -> Result<Vec<usize>, Error> {
    if only.iter().any(|name| name.trim().is_empty()) {
        return Err(Error::usage("`--only` takes names of nodes separated by single commas"));
    }
    let named = only.iter().map(|name| find_all(graph, name.trim())).collect::<Result<Vec<_>, _>>()?.concat();
    match frames {
        None => Ok(named),
        Some(frames) => at_frames(graph, if only.is_empty() { graph.targets() } else { named }, frames),
    }
}

/// The nodes among `nodes` whose value of the axis `frame` is in the range `frames`.
fn at_frames(graph: &Graph, nodes: Vec<usize>, frames: &str) -> Result<Vec<usize>, Error> {
    let wrong = || {
        let how = "write the first and the last frame, such as 1001-1050, or one frame, such as 7";
        Error::usage(format!("`--frames {frames}` is not a range of frames; {how}"))
    };
    let (first, last) = frames.split_once('-').unwrap_or((frames, frames));
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let (first, last) = (number(first)?, number(last)?);
    if first > last {
        return Err(wrong());
    }
    let frame = |node: usize| -> Option<f64> {
        let (_, value) = graph.nodes[node].point.iter().find(|(axis, _)| axis == FRAME)?;
        value.parse().ok()
    };
    let all: Vec<f64> = nodes.iter().filter_map(|&node| frame(node)).collect();
    if all.is_empty() {
        let how = "`--frames` needs an axis `frame` of numbers, and a node that varies along it";
        return Err(Error::usage(format!("none of the nodes has frames: {how}")));
    }
    let within = |&node: &usize| {
        frame(node).is_some_and(|frame| (f64::from(first)..=f64::from(last)).contains(&frame))
    };
    let found: Vec<usize> = nodes.into_iter().filter(within).collect();
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if found.is_empty() {
        return Err(Error::usage(format!("the graph has the frames {least} to {most}, not {frames}")));
    }
    if f64::from(first) < least || f64::from(last) > most {
        let text = format!(
            "the selected nodes have the frames {least} to {most}; the others of {frames} do not exist"
        );
        terminal::remark(&text);
    }
    Ok(found)
}

/// The node with this name. The error lists the nodes of the graph.
pub fn find(graph: &Graph, name: &str) -> Result<usize, Error> {
    match find_all(graph, name)?.as_slice() {
        [node] => Ok(*node),
        nodes => {
            let names = nodes.iter().map(|&node| graph.nodes[node].id.clone());
            Err(Error::usage(format!("`{name}` names several nodes; choose one of {}", list(names))))
        }
    }
}

/// Every instance of the node with this name. A node that varies along an axis has several.
fn find_all(graph: &Graph, name: &str) -> Result<Vec<usize>, Error> {
    let found = graph.find_all(name);
    if !found.is_empty() {
        return Ok(found);
    }
    if let Some(of) = graph.source.gathered(name) {
        return Err(Error::usage(format!(
            "`{name}` is a `Gather`, not a node; use `{of}`, or a node that reads `{name}`"
        )));
    }
    let (plain, values) = name.split_once('/').map_or((name, None), |(plain, values)| (plain, Some(values)));
    // The node exists, but not at these values.
    let instances = graph.find_all(plain);
    if let (Some(values), [first, ..]) = (values, instances.as_slice()) {
        let axes = graph.nodes[*first].point.iter().map(|(axis, _)| axis);
        let known: Vec<String> =
            axes.map(|axis| format!("`{axis}` {}", values_of(graph, &instances, axis))).collect();
        return Err(Error::usage(match known.as_slice() {
            [] => format!("`{plain}` does not vary along an axis, so it has no instance `{values}`"),
            known => {
                format!("`{plain}` has no instance `{values}`; it has instances at {}", known.join(" and "))
            }
        }));
    }
    let plain_names: BTreeSet<&str> =
        graph.nodes.iter().map(|node| node.id.split('/').next().unwrap_or_default()).collect();
    let near = nearest(plain, plain_names.iter().copied());
    let hint = near.map(|near| match values {
        Some(values) => format!(" (did you mean `{near}/{values}`?)"),
        None => format!(" (did you mean `{near}`?)"),
    });
    // In the order of the file, each once.
    let mut seen = BTreeSet::new();
    let in_order = graph.nodes.iter().map(|node| node.id.split('/').next().unwrap_or_default().to_owned());
    let known = list(in_order.filter(|name| seen.insert(name.clone())));
    Err(Error::usage(format!(
        "the graph has no node `{name}`{}; its nodes are {known}",
        hint.unwrap_or_default()
    )))
}

/// The values of an axis at some nodes, as text. All values are listed if there are few, otherwise only the first
/// and the last.
fn values_of(graph: &Graph, nodes: &[usize], axis: &str) -> String {
    const FEW: usize = 6;
    let value = |&node: &usize| {
        graph.nodes[node].point.iter().find(|(known, _)| known == axis).map(|(_, value)| value.as_str())
    };
    let mut values: Vec<&str> = Vec::new();
    for value in nodes.iter().filter_map(value) {
        if values.len() > FEW {
            values[FEW] = value;
        } else if !values.contains(&value) {
            values.push(value);
        }
    }
    match values.as_slice() {
        [first, .., last] if values.len() > FEW => format!("{first} to {last}"),
        values => values.join(", "),
    }
}

/// The first few names, separated by commas.
fn list(names: impl Iterator<Item = String>) -> String {
    let mut names: Vec<String> = names.take(MOST + 1).collect();
    if names.len() > MOST {
        names[MOST] = "..".to_owned();
    }
    names.join(", ")
}
