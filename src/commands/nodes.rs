//! `nodes`: lists and describes the kinds, from the table that is also used to check graphs.

use clap::Args;
use engine::{Arity, KindEntry, PRESETS, ParamSpec, PortSpec, Registry, Role};
use serde_json::{Value, json};

use crate::session::Error;
use crate::terminal::{self, paragraphs, wrapped};

/// Lists the kinds of nodes, describes one, or searches them.
///
/// Without a word it lists all kinds in the order of a pipeline. With the name of a kind it describes that kind:
/// inputs, parameters with defaults and ranges, outputs. With any other word it lists the kinds that mention it.
#[derive(Debug, Args)]
pub struct Nodes {
    /// Name of a kind, such as `splat-render` or `SplatRender`, or a word to search for
    kind: Option<String>,
    /// Print the whole reference as Markdown
    #[arg(long)]
    markdown: bool,
    /// Print one JSON object per line on standard output: one for each kind, or only the named kind
    #[arg(long, conflicts_with = "markdown")]
    pub json: bool,
}

/// The stages of a pipeline, in order, each with its kinds. Kinds whose names begin with `load-` also belong to the
/// first stage, and those whose names begin with `write-` to the last stage.
const STAGES: [(&str, &[&str]); 7] = [
    ("load", &["demo-scene"]),
    (
        "prepare",
        &[
            "crop-mesh",
            "extract-mesh",
            "override-material",
            "plane",
            "run-colmap",
            "run-program",
            "set-gloss",
            "train-splats",
        ],
    ),
    ("place", &["camera", "cube-rig", "fit-probe", "pick-cameras", "place", "pose", "snap"]),
    (
        "light",
        &[
            "adjust-light",
            "fit-lights",
            "fuse-hdr",
            "lamp",
            "predict-exposure",
            "score-env",
            "splat-panorama",
            "stitch",
        ],
    ),
    (
        "render",
        &[
            "alpha-shadow",
            "average-images",
            "bake-shadow",
            "composite",
            "denoise",
            "object-mattes",
            "path-trace",
            "region-masks",
            "run-ocio",
            "shadow-ratio",
            "splat-render",
        ],
    ),
    ("compare", &["compare", "contact-sheet", "join-reports"]),
    ("write", &[]),
];

impl Nodes {
    /// Prints the list, the description or the search results.
    pub fn run(self) -> Result<u8, Error> {
        let registry = nodes::registry();
        let width = terminal::width();
        if self.json {
            let kinds: Vec<&KindEntry> = match &self.kind {
                Some(name) => vec![registry.get(name).ok_or_else(|| unknown(&registry, name))?],
                None => registry.iter().map(|kind| &**kind).collect(),
            };
            kinds.into_iter().for_each(|kind| terminal::json_line(&kind_json(kind)));
            return Ok(0);
        }
        let text = match &self.kind {
            Some(name) => match registry.get(name) {
                Some(kind) => describe(kind, width),
                None => found(&registry, name, width)?,
            },
            None if self.markdown => {
                let mut text = "# Kinds of nodes\n\nMade by `lightharmony nodes --markdown`.\n".to_owned();
                registry.iter().for_each(|kind| text.push_str(&markdown(kind)));
                text
            }
            None => list(&registry, width),
        };
        terminal::print(&text)?;
        Ok(0)
    }
}

/// The stage of a kind; `other` for kinds that are not in a stage.
fn stage(name: &str) -> &'static str {
    let named = STAGES.iter().find(|(_, kinds)| kinds.contains(&name)).map(|(stage, _)| *stage);
    named.unwrap_or(match name {
        _ if name.starts_with("load-") => "load",
        _ if name.starts_with("write-") => "write",
        _ => "other",
    })
}

fn list(registry: &Registry, width: usize) -> String {
    let mut text = String::new();
    for stage_name in STAGES.iter().map(|(stage, _)| *stage).chain(["other"]) {
        let kinds: Vec<&KindEntry> =
            registry.iter().map(|kind| &**kind).filter(|kind| stage(kind.name) == stage_name).collect();
        if kinds.is_empty() {
            continue;
        }
        text.push_str(&format!("{stage_name}\n"));
        kinds.iter().for_each(|kind| text.push_str(&in_list(kind, width)));
        text.push('\n');
    }
    let more = "`lightharmony nodes KIND` describes a kind; `lightharmony nodes WORD` lists the kinds that mention a word.";
    text.push_str(&wrapped(more, "", 0, width));
    text
}

fn in_list(kind: &KindEntry, width: usize) -> String {
    wrapped(&first_sentence(kind.doc), &format!("  {}", kind.name), 22, width)
}

/// Lists the kinds whose names contain a word or, if no name does, the kinds that mention it in their
/// documentation, ports or parameters.
fn found(registry: &Registry, word: &str, width: usize) -> Result<String, Error> {
    let lower = word.to_lowercase();
    let has = |text: &str| text.to_lowercase().contains(&lower);
    let rank = |kind: &KindEntry| {
        let ports =
            kind.inputs.iter().chain(&kind.outputs).any(|port| has(port.name) || has(port.artifact.name));
        let params = kind.params.iter().any(|param| has(param.name));
        match () {
            () if has(kind.name) => Some(0),
            () if has(&first_sentence(kind.doc)) => Some(1),
            () if ports || params => Some(2),
            () => None,
        }
    };
    let mut kinds: Vec<(usize, &KindEntry)> =
        registry.iter().filter_map(|kind| Some((rank(kind)?, &**kind))).collect();
    kinds.sort_by_key(|(rank, _)| *rank);
    if kinds.is_empty() {
        return Err(unknown(registry, word));
    }
    let mut text = String::new();
    for (title, ranks) in
        [("kinds", 0..2), ("kinds that have a port or a parameter with a matching name", 2..3)]
    {
        let kinds: Vec<_> = kinds.iter().filter(|(rank, _)| ranks.contains(rank)).collect();
        if !kinds.is_empty() {
            text.push_str(&format!("{title}\n"));
            kinds.iter().for_each(|(_, kind)| text.push_str(&in_list(kind, width)));
        }
    }
    Ok(text)
}

/// The error for a word that is neither the name of a kind nor mentioned by one.
fn unknown(registry: &Registry, word: &str) -> Error {
    let near = engine::nearest(word, registry.iter().map(|kind| kind.name));
    let hint = near.map(|near| format!(", did you mean `{near}`?")).unwrap_or_default();
    Error::usage(format!("no kind is named `{word}` or mentions this word{hint}"))
}

/// The description of a kind as JSON.
fn kind_json(kind: &KindEntry) -> Value {
    let ports = |ports: &[PortSpec]| -> Vec<Value> { ports.iter().map(port_json).collect() };
    let outputs = if kind.sink_param().is_some() { &[] } else { kind.outputs.as_slice() };
    json!({
        "event": "kind", "name": kind.name, "graph_name": kind.camel_name(), "version": kind.version,
        "stage": stage(kind.name), "doc": paragraphs(kind.doc).join("\n\n"),
        "parameters": kind.params.iter().map(param_json).collect::<Vec<_>>(),
        "inputs": ports(&kind.inputs), "outputs": ports(outputs),
    })
}

fn port_json(port: &PortSpec) -> Value {
    let wires = match port.arity {
        Arity::One => "one",
        Arity::Optional => "optional",
        Arity::Many => "many",
    };
    json!({"name": port.name, "type": port.artifact.name, "wires": wires, "doc": paragraphs(port.doc).join(" ")})
}

fn param_json(param: &ParamSpec) -> Value {
    let choice = |(word, doc): (&str, &str)| json!({"name": word, "doc": paragraphs(doc).join(" ")});
    let presets = |ladder: &[&str]| -> serde_json::Map<String, Value> {
        let set = PRESETS.iter().zip(ladder).filter(|(_, value)| !value.is_empty());
        set.map(|(preset, value)| ((*preset).to_owned(), json!(value))).collect()
    };
    let file = match param.role {
        Role::Value => None,
        Role::Input => Some("input"),
        Role::Output => Some("output"),
    };
    json!({
        "name": param.name, "type": (param.describe)(), "default": (param.default)(),
        "range": param.range.map(|(low, high)| [low, high]), "unit": param.unit, "file": file,
        "choices": (param.choices)().into_iter().map(choice).collect::<Vec<_>>(),
        "presets": param.knob.as_ref().map(|knob| presets(&knob.ladder)),
        "doc": paragraphs(param.doc).join("\n\n"),
    })
}

/// Column at which descriptions begin, to the right of the names.
const COLUMN: usize = 23;

fn describe(kind: &KindEntry, width: usize) -> String {
    let mut text = format!("{} (in graphs: {}), version {}\n\n", kind.name, kind.camel_name(), kind.version);
    doc(&mut text, kind.doc, 2, width);
    ports(&mut text, "inputs", &kind.inputs, width);
    if !kind.params.is_empty() {
        text.push_str("\nparameters\n");
    }
    for param in &kind.params {
        let mut facts = vec![(param.describe)()];
        match (param.default)() {
            Some(default) => facts.push(format!("default {default}")),
            None => facts.push("required".to_owned()),
        }
        if let Some((low, high)) = param.range {
            facts.push(format!("{low} to {high}"));
        }
        if !param.unit.is_empty() {
            facts.push(param.unit.to_owned());
        }
        text.push_str(&wrapped(&facts.join(", "), &format!("  {:<20} ", param.name), COLUMN, width));
        doc(&mut text, param.doc, COLUMN + 2, width);
        for (word, meaning) in (param.choices)() {
            let meaning = paragraphs(meaning).join(" ");
            let head = " ".repeat(COLUMN + 2);
            text.push_str(&wrapped(&format!("{word}: {meaning}"), &head, COLUMN + 4, width));
        }
        if let Some(knob) = &param.knob {
            let set = PRESETS.iter().zip(knob.ladder).filter(|(_, value)| !value.is_empty());
            let set: Vec<String> = set.map(|(preset, value)| format!("{preset} {value}")).collect();
            let line = format!("presets: {}", set.join(", "));
            text.push_str(&wrapped(&line, "", COLUMN + 2, width));
        }
    }
    if kind.sink_param().is_none() {
        ports(&mut text, "outputs (the first is the default)", &kind.outputs, width);
    }
    text
}

/// Appends the paragraphs of a documentation text, with an empty line between them, except between items of a list.
fn doc(text: &mut String, doc: &str, indent: usize, width: usize) {
    for (at, paragraph) in paragraphs(doc).iter().enumerate() {
        match paragraph.strip_prefix("- ").or_else(|| paragraph.strip_prefix("* ")) {
            Some(item) => {
                text.push_str(&wrapped(item, &format!("{}- ", " ".repeat(indent)), indent + 2, width));
            }
            None => {
                text.push_str(if at > 0 { "\n" } else { "" });
                text.push_str(&wrapped(paragraph, "", indent, width));
            }
        }
    }
}

fn ports(text: &mut String, title: &str, ports: &[PortSpec], width: usize) {
    if ports.is_empty() {
        return;
    }
    text.push_str(&format!("\n{title}\n"));
    for port in ports {
        let many = match port.arity {
            Arity::One => "",
            Arity::Optional => ", optional",
            Arity::Many => ", one wire or a list of wires",
        };
        let line = format!("{}{many}: {}", port.artifact.name, paragraphs(port.doc).join(" "));
        text.push_str(&wrapped(&line, &format!("  {:<20} ", port.name), COLUMN, width));
    }
}

fn markdown(kind: &KindEntry) -> String {
    let mut text = format!("\n## `{}`\n\n", kind.name);
    kind.doc.trim().lines().for_each(|line| text.push_str(&format!("{}\n", line.trim())));
    let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
    if !kind.params.is_empty() {
        text.push_str("\n| parameter | value | default | range | meaning |\n|---|---|---|---|---|\n");
    }
    for param in &kind.params {
        let range = param.range.map(|(low, high)| format!("{low} to {high}")).unwrap_or_default();
        let unit = if param.unit.is_empty() { String::new() } else { format!(" {}", param.unit) };
        let default = match ((param.default)(), param.role) {
            (Some(default), _) => format!("`{}`", cell(&default)),
            (None, Role::Value) => "required".to_owned(),
            (None, _) => "required path".to_owned(),
        };
        let mut doc = paragraphs(param.doc).join(" ");
        for (word, meaning) in (param.choices)() {
            doc.push_str(&format!(" `{word}`: {}", paragraphs(meaning).join(" ")));
        }
        text.push_str(&format!(
            "| `{}` | {} | {default} | {range}{unit} | {} |\n",
            param.name,
            cell(&(param.describe)()),
            cell(&doc)
        ));
    }
    let outputs = if kind.sink_param().is_some() { &[] } else { kind.outputs.as_slice() };
    if !kind.inputs.is_empty() || !outputs.is_empty() {
        text.push_str("\n| port | type | carries |\n|---|---|---|\n");
    }
    for (way, port) in kind.inputs.iter().map(|p| ("in", p)).chain(outputs.iter().map(|p| ("out", p))) {
        let many = match port.arity {
            Arity::One => "",
            Arity::Optional => " (optional)",
            Arity::Many => "(one wire or a list of wires)",
        };
        let doc = paragraphs(port.doc).join(" ");
        text.push_str(&format!(
            "| {way} `{}` | {}{many} | {} |\n",
            port.name,
            port.artifact.name,
            cell(&doc)
        ));
    }
    text
}

/// The first sentence of a documentation text, in one line.
fn first_sentence(doc: &str) -> String {
    let text = paragraphs(doc).into_iter().next().unwrap_or_default();
    // A sentence ends before a capital.
    let end = text.match_indices(". ").find(|(at, _)| text[at + 2..].starts_with(char::is_uppercase));
    end.map_or(text.clone(), |(at, _)| text[..=at].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_a_stage() {
        let registry = nodes::registry();
        let other: Vec<&str> =
            registry.iter().map(|kind| kind.name).filter(|name| stage(name) == "other").collect();
        assert_eq!(other, [""; 0], "add them to `STAGES`");
        let listed = list(&registry, 100);
        assert!(
            registry.iter().all(|kind| listed.matches(&format!("\n  {} ", kind.name)).count() == 1),
            "{listed}"
        );
    }

    // This test fails if `wrapped` ignores `width`.
    #[test]
    fn descriptions_fit_the_terminal() {
        for kind in nodes::registry().iter() {
            for width in [60, 100] {
                let text = describe(kind, width);
                // A value may be one long word.
                let words = |line: &str| line.split_whitespace().count();
                let long = text.lines().skip(1).find(|line| line.chars().count() > width && words(line) > 2);
                assert_eq!(long, None, "{}", kind.name);
            }
        }
    }

    #[test]
    fn words_are_searched_in_names_summaries_and_ports() {
        let registry = nodes::registry();
        let of = |word: &str| found(&registry, word, 100).unwrap_or_else(|error| error.to_string());
        assert!(of("shadow").contains("shadow-ratio") && of("shadow").contains("composite"));
        assert!(of("stich").contains("did you mean `stitch`?"), "{}", of("stich"));
    }
}
