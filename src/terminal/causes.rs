//! Describes why nodes run, back to the first cause.

use std::collections::BTreeMap;

use engine::{Change, Engine, Fate, Graph, Planned, Role, Why};

/// The reason why a node runs, in a few words.
pub fn reason(graph: &Graph, index: usize, fate: &Fate) -> String {
    match fate {
        Fate::Unwanted => "not needed by any target".to_owned(),
        Fate::Known => "up to date".to_owned(),
        Fate::Lost => {
            "up to date, but its values were removed from the cache: runs again if they are needed".to_owned()
        }
        Fate::Runs(Why::New) => "runs: no earlier run is known".to_owned(),
        Fate::Runs(Why::Changed(changes)) => match causes(graph, index, changes).as_slice() {
            [] => "runs: the result of the last run is no longer kept".to_owned(),
            [first, rest @ ..] => {
                let more = if rest.is_empty() { String::new() } else { format!(" and {} more", rest.len()) };
                format!("runs: {}{more}", first.text)
            }
        },
        Fate::Follows(above) => format!("may run: depends on the result of `{above}`"),
        Fate::Fails(why) => format!("fails: {why}"),
    }
}

/// A difference between two keys of a node.
pub struct Cause {
    /// Text of the difference, such as `` `pose.yaw_deg` 30.0 -> 35.0 ``.
    pub text: String,
    /// Index of the input node whose result differs, if that is the cause.
    pub above: Option<usize>,
}

/// Converts the changes of a node's key to causes. A wire has several fields in a key. If several of them change,
/// they give only one cause.
pub fn causes(graph: &Graph, index: usize, changes: &[Change]) -> Vec<Cause> {
    let node = &graph.nodes[index];
    let mut causes = Vec::new();
    // Added wires and the number of removed wires, by port.
    let mut counts: BTreeMap<usize, (Vec<usize>, usize)> = BTreeMap::new();
    let (read, dropped) = (files(changes, |change| &change.old), files(changes, |change| &change.new));
    causes.extend(
        other_files(graph, index, &read, &dropped).into_iter().map(|text| Cause { text, above: None }),
    );
    for change in changes {
        if source(change).is_some() && (change.old.is_none() || change.new.is_none()) {
            continue;
        }
        let (name, rest) = change.path.split_once(['[', '.']).unwrap_or((&change.path, ""));
        let port = node.kind.inputs.iter().position(|port| port.name == name);
        let field = rest.split(']').next().and_then(|field| field.parse::<usize>().ok());
        let Some((port, field)) = port.zip(field) else {
            causes.push(Cause { text: plain_cause(graph, index, change), above: None });
            continue;
        };
        // A wire has three fields: type, format, content.
        let (wire, first) = (field / 3, field % 3 == 0);
        match (&change.old, &change.new) {
            (None, _) if first => counts.entry(port).or_default().0.push(wire),
            (_, None) if first => counts.entry(port).or_default().1 += 1,
            (Some(old), Some(new)) => {
                let what = ["type", "format", "content"][field % 3];
                let (from, above) = end(graph, index, port, wire);
                let text = format!(
                    "the {what} of the input `{name}`, which now comes from `{from}`, has changed: {old} -> {new}"
                );
                causes.push(Cause { text, above });
            }
            // Reported with its first field.
            _ => {}
        }
    }
    for (port, (came, went)) in counts {
        let name = format!("`{}.{}`", node.id, node.kind.inputs[port].name);
        let wires = |count: usize| if count == 1 { "wire" } else { "wires" };
        if !came.is_empty() {
            const MOST: usize = 3;
            let ends = came.iter().take(MOST).map(|&wire| format!("`{}`", end(graph, index, port, wire).0));
            let mut ends: Vec<String> = ends.collect();
            if came.len() > MOST {
                ends.push("..".to_owned());
            }
            let text = format!("{name} has {} new {}: {}", came.len(), wires(came.len()), ends.join(", "));
            causes.push(Cause { text, above: None });
        }
        if went > 0 {
            causes.push(Cause { text: format!("{name} has lost {went} {}", wires(went)), above: None });
        }
    }
    causes
}

/// The name of the file, if the change is in `sources`.
fn source(change: &Change) -> Option<&str> {
    let (name, rest) = change.path.split_once(['[', '.'])?;
    (name == "sources").then(|| rest.split_once("].").map_or(rest, |(_, file)| file).trim_matches('"'))
}

/// Names of the files in `sources` for which `side` returns `None`. If `side` returns the old value of a change, these
/// are the added files; if it returns the new value, the removed files.
fn files(changes: &[Change], side: impl Fn(&Change) -> &Option<String>) -> Vec<&str> {
    changes.iter().filter(|change| side(change).is_none()).filter_map(source).collect()
}

/// Causes for files that a node now reads or no longer reads.
fn other_files(graph: &Graph, index: usize, read: &[&str], dropped: &[&str]) -> Vec<String> {
    let node = &graph.nodes[index];
    let mut inputs = node.kind.params.iter().filter(|param| param.role == Role::Input);
    match (read, dropped) {
        ([new], [old]) => {
            let field = inputs.next().filter(|_| inputs.next().is_none());
            let field = field.map_or_else(|| "a file".to_owned(), |field| field.name.to_owned());
            vec![format!("`{}.{field}` {old:?} -> {new:?}", node.id)]
        }
        _ => {
            let now = read.iter().map(|file| format!("`{}` now reads `{file}`", node.id));
            let then = dropped.iter().map(|file| format!("`{}` no longer reads `{file}`", node.id));
            now.chain(then).collect()
        }
    }
}

/// The origin of wire `wire` of an input, as text and as the index of a node.
fn end(graph: &Graph, index: usize, port: usize, wire: usize) -> (String, Option<usize>) {
    let Some(wire) = graph.nodes[index].inputs[port].get(wire) else { return ("nothing".to_owned(), None) };
    let above = &graph.nodes[wire.node];
    let output = above.kind.outputs.get(wire.port).map_or("", |port| port.name);
    (format!("{}.{output}", above.id), Some(wire.node))
}

/// The cause for a change that is not in a wire.
fn plain_cause(graph: &Graph, index: usize, change: &Change) -> String {
    let node = &graph.nodes[index];
    let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".to_owned());
    let (old, new) = (value(&change.old), value(&change.new));
    let (name, rest) = change.path.split_once(['[', '.']).unwrap_or((&change.path, ""));
    match name {
        "kind" | "version" | "profile" => {
            format!("`{}` has a different {name}: {old} -> {new}", node.kind.name)
        }
        "sources" => {
            let file = source(change).unwrap_or(rest);
            format!("`{file}`, which `{}` reads, has different content: {old} -> {new}", node.id)
        }
        "recipe" => "the recipe that the node writes into its file has changed".to_owned(),
        "scene" => format!("`{}` {old} -> {new}", change.path),
        _ => format!("`{}.{}` {old} -> {new}", node.id, change.path),
    }
}

/// The path from a node back to the first causes.
pub struct Trail {
    /// Indented lines for each node on the path, with its changes.
    pub lines: Vec<String>,
    /// The first causes, as texts.
    pub roots: Vec<String>,
}

/// Follows the causes of a node's next or last run upstream to the first causes.
pub fn trail(engine: &Engine, graph: &Graph, plan: &[Planned], node: usize) -> Trail {
    let mut trail = Trail { lines: Vec::new(), roots: Vec::new() };
    let mut seen = vec![false; plan.len()];
    let mut open = vec![(node, 0)];
    while let Some((index, depth)) = open.pop() {
        if std::mem::replace(&mut seen[index], true) {
            continue;
        }
        let planned = &plan[index];
        let indent = "  ".repeat(depth.min(40));
        let past = engine.past(graph, index, planned).changes;
        let head = format!("{indent}{} ({})", planned.id, planned.kind);
        let mut above: Vec<usize> = Vec::new();
        let mut report = |changes: &[Change], lines: &mut Vec<String>| {
            // The recipe differs whenever an input does, which is reported anyway.
            let direct: Vec<Change> =
                changes.iter().filter(|change| change.path != "recipe").cloned().collect();
            let recipe = direct.len() < changes.len();
            for cause in causes(graph, index, if direct.is_empty() { changes } else { &direct }) {
                lines.push(format!("{indent}    {}", cause.text));
                match cause.above {
                    Some(node) => above.push(node),
                    None if !direct.is_empty() => trail.roots.push(cause.text),
                    None => {}
                }
            }
            if recipe && above.is_empty() {
                above.extend(graph.reads(index));
            }
        };
        match &planned.fate {
            Fate::Runs(Why::Changed(changes)) if !changes.is_empty() => {
                trail.lines.push(format!("{head} runs:"));
                report(changes, &mut trail.lines);
            }
            Fate::Known if !past.is_empty() => {
                trail.lines.push(format!("{head} is up to date; it last ran after these changes:"));
                report(&past, &mut trail.lines);
            }
            Fate::Follows(_) => {
                trail.lines.push(format!("{head} may run, depending on:"));
                let open = |above: &&usize| !matches!(plan[**above].fate, Fate::Known | Fate::Unwanted);
                above.extend(graph.reads(index).iter().filter(open));
            }
            fate => {
                let text = reason(graph, index, fate);
                if *fate != Fate::Known {
                    trail.roots.push(format!("`{}` {text}", planned.id));
                }
                trail.lines.push(format!("{head}: {text}"));
            }
        }
        open.extend(above.into_iter().rev().map(|node| (node, depth + 1)));
    }
    trail
}
