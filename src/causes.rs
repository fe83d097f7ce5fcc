//! Why nodes run, in words, back to where it begins.

use engine::{Change, Engine, Fate, Graph, Planned, Why};

/// Why a node runs, in a few words.
pub fn reason(graph: &Graph, index: usize, fate: &Fate) -> String {
    match fate {
        Fate::Unwanted => "not wanted".to_owned(),
        Fate::Known => "its result is known".to_owned(),
        Fate::Lost => "known, but gone from the cache: runs again if its values are needed".to_owned(),
        Fate::Runs(Why::New) => "runs: no earlier run of it is known".to_owned(),
        Fate::Runs(Why::Changed(changes)) => match changes.as_slice() {
            [] => "runs: the result of the last run is no longer kept".to_owned(),
            [first, rest @ ..] => {
                let more = if rest.is_empty() { String::new() } else { format!(" and {} more", rest.len()) };
                format!("runs: {}{more}", cause(graph, index, first).text)
            }
        },
        Fate::Follows(above) => format!("may run: depends on what `{above}` gives"),
        Fate::Fails(why) => format!("fails: {why}"),
    }
}

/// One difference between two keys of a node.
pub struct Cause {
    /// `` `pose.yaw_deg` 30.0 -> 35.0 ``.
    pub text: String,
    /// The node above that gives something else, where that is what it is.
    pub above: Option<usize>,
}

/// What a change of a node's key means.
pub fn cause(graph: &Graph, index: usize, change: &Change) -> Cause {
    let node = &graph.nodes[index];
    let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".to_owned());
    let (old, new) = (value(&change.old), value(&change.new));
    let (name, rest) = change.path.split_once(['[', '.']).unwrap_or((&change.path, ""));
    let port = node.kind.inputs.iter().position(|port| port.name == name);
    // A wire is three fields of its list: type, format, content.
    let wire = rest.split(']').next().and_then(|field| field.parse::<usize>().ok()).map(|field| field / 3);
    let wires = port.map_or(&[][..], |port| node.inputs[port].as_slice());
    if let Some(wire) = wire.and_then(|wire| wires.get(wire)) {
        let (above, output) = (&graph.nodes[wire.node], wire.port);
        let output = above.kind.outputs.get(output).map_or("", |port| port.name);
        let text = format!("`{name}` from `{}.{output}` has other content: {old} -> {new}", above.id);
        return Cause { text, above: Some(wire.node) };
    }
    let text = match name {
        "kind" | "version" | "profile" => format!("`{}` is another {name}: {old} -> {new}", node.kind.name),
        "sources" => {
            let file = rest.split_once("].").map_or(rest, |(_, file)| file).trim_matches('"');
            format!("`{file}`, which `{}` reads, has other content: {old} -> {new}", node.id)
        }
        "recipe" => "the recipe that is written into the file is another".to_owned(),
        "scene" => format!("`{}` {old} -> {new}", change.path),
        _ if port.is_some() => format!("`{}.{name}` is wired otherwise: {old} -> {new}", node.id),
        _ => format!("`{}.{}` {old} -> {new}", node.id, change.path),
    };
    Cause { text, above: None }
}

/// Where the way from a node back to the causes begins and leads through.
pub struct Trail {
    /// One line a node on the way, indented, each with what changed there.
    pub lines: Vec<String>,
    /// What it all comes from.
    pub roots: Vec<String>,
}

/// Walks from a node up to what made it run, or made it run when it last did.
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
        let mut tell = |changes: &[Change], lines: &mut Vec<String>| {
            let mut recipe = false;
            for change in changes {
                let cause = cause(graph, index, change);
                // The recipe differs whenever anything above does, which is told anyway.
                recipe |= change.path == "recipe";
                if change.path != "recipe" || changes.len() == 1 {
                    lines.push(format!("{indent}    {}", cause.text));
                }
                match cause.above {
                    Some(node) => above.push(node),
                    None if change.path != "recipe" => trail.roots.push(cause.text),
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
                tell(changes, &mut trail.lines);
            }
            Fate::Known if !past.is_empty() => {
                let word =
                    if depth == 0 { " is known; it was made anew when:" } else { " is known; before:" };
                trail.lines.push(format!("{head}{word}"));
                tell(&past, &mut trail.lines);
            }
            Fate::Follows(_) => {
                trail.lines.push(format!("{head} may run, after"));
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
