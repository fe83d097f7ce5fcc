//! `nodes`: the kinds, from the same table that checks graphs.

use std::fmt::Write as _;

use clap::Args;
use engine::{Arity, KindEntry, PortSpec, Role};

use crate::session::Error;
use crate::terminal;

/// Lists the kinds of nodes, or describes one.
#[derive(Debug, Args)]
pub struct Nodes {
    /// A kind, as `splat-render` or `SplatRender`
    kind: Option<String>,
    /// The whole reference as Markdown
    #[arg(long)]
    markdown: bool,
}

impl Nodes {
    /// Prints the list or the description.
    pub fn run(self) -> Result<u8, Error> {
        let registry = nodes::registry();
        let text = match &self.kind {
            Some(name) => match registry.get(name) {
                Some(kind) => describe(kind),
                None => {
                    let hint = engine::nearest(name, registry.iter().map(|kind| kind.name));
                    let hint = hint.map(|near| format!(", did you mean `{near}`?")).unwrap_or_default();
                    return Err(Error::usage(format!("no kind is named `{name}`{hint}")));
                }
            },
            None if self.markdown => {
                let mut text = "# Kinds of nodes\n\nMade by `lightharmony nodes --markdown`.\n".to_owned();
                registry.iter().for_each(|kind| text.push_str(&markdown(kind)));
                text
            }
            None => registry
                .iter()
                .map(|kind| {
                    let summary = first_sentence(kind.doc);
                    format!("{:<20} {summary}\n", kind.name)
                })
                .collect(),
        };
        terminal::print(&text)?;
        Ok(0)
    }
}

fn lines(doc: &str) -> impl Iterator<Item = &str> {
    doc.trim().lines().map(str::trim)
}

fn describe(kind: &KindEntry) -> String {
    let mut text = format!("{} (in graphs: {}), version {}\n\n", kind.name, kind.camel_name(), kind.version);
    lines(kind.doc).for_each(|line| text.push_str(&format!("  {line}\n")));
    ports(&mut text, "inputs", &kind.inputs);
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
        if let Some(knob) = &param.knob {
            // Where a preset leaves it as it is, a dot, as in `knobs`.
            let values = knob.ladder.map(|value| if value.is_empty() { "." } else { value });
            facts.push(format!("knob ({}) {}", knob.kind.name(), values.join(" ")));
        }
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {:<20} {}", param.name, facts.join(", "));
        lines(param.doc).for_each(|line| text.push_str(&format!("  {:<20}   {line}\n", "")));
        for (word, meaning) in (param.choices)() {
            let meaning = lines(meaning).collect::<Vec<_>>().join(" ");
            let _ = writeln!(text, "  {:<20}   {word}: {meaning}", "");
        }
    }
    if kind.sink_param().is_none() {
        ports(&mut text, "outputs (the first is the default)", &kind.outputs);
    }
    text
}

fn ports(text: &mut String, title: &str, ports: &[PortSpec]) {
    if ports.is_empty() {
        return;
    }
    text.push_str(&format!("\n{title}\n"));
    for port in ports {
        let many = match port.arity {
            Arity::One => "",
            Arity::Optional => ", optional",
            Arity::Many => ", one or a list",
        };
        let doc = lines(port.doc).collect::<Vec<_>>().join(" ");
        text.push_str(&format!("  {:<20} {}{many}: {doc}\n", port.name, port.artifact.name));
    }
}

fn markdown(kind: &KindEntry) -> String {
    let mut text = format!("\n## `{}`\n\n", kind.name);
    lines(kind.doc).for_each(|line| text.push_str(&format!("{line}\n")));
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
        let mut doc = lines(param.doc).collect::<Vec<_>>().join(" ");
        for (word, meaning) in (param.choices)() {
            let _ = write!(doc, " `{word}`: {}", lines(meaning).collect::<Vec<_>>().join(" "));
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
            Arity::Many => " (one or a list)",
        };
        let doc = lines(port.doc).collect::<Vec<_>>().join(" ");
        text.push_str(&format!(
            "| {way} `{}` | {}{many} | {} |\n",
            port.name,
            port.artifact.name,
            cell(&doc)
        ));
    }
    text
}

/// The first sentence of a doc, on one line.
fn first_sentence(doc: &str) -> String {
    let lines: Vec<&str> = doc.trim().lines().map(str::trim).take_while(|line| !line.is_empty()).collect();
    let text = lines.join(" ");
    // A sentence ends before a capital.
    let end = text.match_indices(". ").find(|(at, _)| text[at + 2..].starts_with(char::is_uppercase));
    end.map_or(text.clone(), |(at, _)| text[..=at].to_owned())
}
