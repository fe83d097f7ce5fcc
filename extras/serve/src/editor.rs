//! Edits of the graph file, one at a time. An edit is refused if the file has changed since the client read it.

use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use cache::Digest;
use engine::{Diagnostics, Graph, GraphText, Mistake, Role, Source, Step, TextEditError};
use serde::{Deserialize, Serialize};

use crate::history::History;
use crate::names::{instances, is_block, unshadowed};
use crate::save::{SaveError, replace};
use crate::track;

/// Maximum length of a new value in bytes.
pub const MAX_VALUE: usize = 16 << 10;

/// An edit of one or more values of a node.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Edit {
    /// Digest of the text that the client has seen.
    pub digest: String,
    /// Name of a node, or `scene` or `parameters`.
    pub node: String,
    /// Name of a field.
    pub field: String,
    /// Path to a value inside the value of the field: indices of lists and groups, names of fields.
    #[serde(default)]
    pub at: Vec<At>,
    /// The new value in RON. `null` removes the field from the text, so that the field has its default.
    pub value: Option<String>,
    /// Other values of the same node that are changed at the same time.
    #[serde(default)]
    pub also: Vec<FieldEdit>,
}

/// An edit of one more value of a node.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldEdit {
    /// Name of a field.
    pub field: String,
    /// Path to a value inside the value of the field.
    #[serde(default)]
    pub at: Vec<At>,
    /// The new value in RON; `null` removes the field.
    pub value: Option<String>,
}

/// Maximum number of values that one edit changes.
const MOST_FIELDS: usize = 16;

/// A step of a path.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum At {
    /// Index in a list or group, from 0.
    Index(usize),
    /// Name of a field of a group.
    Name(String),
}

/// The reason why an edit was refused. Nothing was changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "code", rename_all = "lowercase")]
pub enum Refused {
    /// The text of the file is not the text that the client has seen.
    Stale {
        /// Digest of the current text.
        digest: String,
    },
    /// The file was deleted, or cannot be read.
    Gone {
        /// Text for the user.
        why: String,
    },
    /// The graph belongs to an unpacked bundle, whose files are never written.
    Confined,
    /// The value cannot be edited here.
    Fixed {
        /// Text for the user, which includes a remedy.
        why: String,
    },
    /// The edited graph would have mistakes.
    Invalid {
        /// The mistakes, with their positions in the edited text.
        mistakes: Vec<Mistake>,
    },
    /// There is nothing to undo or redo.
    Nothing,
    /// The file cannot be written.
    Unwritten {
        /// Text for the user.
        why: String,
    },
}

impl From<TextEditError> for Refused {
    fn from(error: TextEditError) -> Self {
        Self::Fixed { why: error.to_string() }
    }
}

/// An edited text that passed all checks.
pub struct Edited {
    /// The text before the edit.
    pub old: String,
    /// The text after the edit.
    pub text: String,
    /// The graph of the text.
    pub graph: Graph,
    /// Description of the edit.
    pub label: String,
    /// Each edited field with its new text; `None` if the edit removes the field.
    pub whole: Vec<(String, Option<String>)>,
}

/// Digest of a text, in the form that clients send.
pub fn digest_of(text: &str) -> String {
    Digest::of(text.as_bytes()).to_string()
}

/// The writer of one graph file.
pub struct Editor {
    path: PathBuf,
    history: History,
}

impl Editor {
    /// An editor of the file `path`, whose history has been opened.
    pub fn new(path: PathBuf, history: History) -> Self {
        Self { path, history }
    }

    /// The history of the file.
    pub fn history(&mut self) -> &mut History {
        &mut self.history
    }

    /// The current text of the file, which other programs may have changed.
    ///
    /// # Errors
    /// [`Refused::Gone`] if it cannot be read.
    pub fn text(&self) -> Result<String, Refused> {
        let read = engine::read_text(&self.path, engine::MAX_GRAPH_BYTES);
        read.map_err(|error| Refused::Gone {
            why: match error.kind() {
                io::ErrorKind::NotFound => format!("`{}` was deleted or moved", self.path.display()),
                _ => format!("cannot read `{}`: {error}", self.path.display()),
            },
        })
    }

    /// The graph of the current text, without trial values and without settings of the command line.
    ///
    /// # Errors
    /// [`Refused`] if the text cannot be read or has mistakes.
    pub fn own_graph(&self, graph: &Graph) -> Result<Graph, Refused> {
        parsed(graph, &self.text()?)
    }

    /// Applies an edit to the current text, without writing it. `graph` is the graph that the client has seen; `tried`
    /// lists the fields of the node for which this graph has a trial value.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn edited(&self, graph: &Graph, edit: &Edit, tried: &[String]) -> Result<Edited, Refused> {
        let old = self.text_seen(graph, &edit.digest)?;
        if edit.also.len() >= MOST_FIELDS {
            return Err(fixed(format!("one edit changes at most {MOST_FIELDS} values")));
        }
        let first = FieldEdit { field: edit.field.clone(), at: edit.at.clone(), value: edit.value.clone() };
        let all: Vec<&FieldEdit> = std::iter::once(&first).chain(&edit.also).collect();
        let (mut text, mut label) = (old.clone(), String::new());
        for one in &all {
            text = changed(graph, &edit.node, one, &text)?;
            let shadowed = GraphText::new(&old).field(&edit.node, &one.field);
            let is_free = tried.contains(&one.field) || is_block(graph, &edit.node, &one.field);
            if let Some(span) = shadowed.filter(|_| !is_free) {
                refuse_hidden(graph, &edit.node, &one.field, &span, old.len())?;
            }
            let dot = if label.is_empty() { "" } else { ", " };
            label = label + dot + &one.label(&edit.node);
        }
        let graph = checked(graph, &text)?;
        let whole = |one: &&FieldEdit| {
            let shown = unshadowed(&graph, &edit.node, &one.field, &text);
            let document = GraphText::new(&shown);
            let span = one.value.as_ref().and_then(|_| document.field(&edit.node, &one.field));
            (one.field.clone(), span.map(|span| text[span].to_owned()))
        };
        let whole = all.iter().map(whole).collect();
        Ok(Edited { whole, old, graph, label: label.chars().take(200).collect(), text: text.clone() })
    }

    /// Applies an edit and writes the file; see [`edited`](Self::edited).
    ///
    /// # Errors
    /// [`Refused`]; the file then has its old content.
    pub fn set(&mut self, graph: &Graph, edit: &Edit, tried: &[String]) -> Result<(), Refused> {
        let Edited { old, text, label, .. } = self.edited(graph, edit, tried)?;
        self.write(&old, &text)?;
        self.history.saved(&text, &label);
        Ok(())
    }

    /// Sets fields of several nodes, each given as node, field and value in RON, and writes the file once.
    ///
    /// # Errors
    /// [`Refused`]; the file then has its old content.
    pub fn set_all(
        &mut self,
        graph: &Graph,
        digest: &str,
        fields: &[(String, String, String)],
        label: &str,
    ) -> Result<(), Refused> {
        let old = self.text_seen(graph, digest)?;
        let mut text = old.clone();
        for (node, field, value) in fields {
            let edit = FieldEdit { field: field.clone(), at: Vec::new(), value: Some(value.clone()) };
            if let Some(span) = GraphText::new(&old).field(node, field) {
                refuse_hidden(graph, node, field, &span, old.len())?;
            }
            text = changed(graph, node, &edit, &text)?;
        }
        if text == old {
            return Err(Refused::Nothing);
        }
        checked(graph, &text)?;
        self.write(&old, &text)?;
        self.history.saved(&text, label);
        Ok(())
    }

    /// Replaces the whole text with a text that this program has made.
    ///
    /// # Errors
    /// [`Refused`]; the file then has its old content.
    pub fn replace(&mut self, graph: &Graph, digest: &str, text: &str, label: &str) -> Result<(), Refused> {
        let old = self.text_seen(graph, digest)?;
        parsed(graph, text)?;
        self.write(&old, text)?;
        self.history.saved(text, label);
        Ok(())
    }

    /// Undoes the last change, whether the page or another program made it.
    ///
    /// # Errors
    /// [`Refused`]; the file then has its old content.
    pub fn undo(&mut self, graph: &Graph, digest: &str) -> Result<(), Refused> {
        let old = self.text_seen(graph, digest)?;
        self.history.saved(&old, OTHER);
        let text = self.history.undone().ok_or(Refused::Nothing)?;
        self.write(&old, &text)?;
        self.history.undo();
        Ok(())
    }

    /// Repeats the change that was undone last.
    ///
    /// # Errors
    /// [`Refused`]; the file then has its old content.
    pub fn redo(&mut self, graph: &Graph, digest: &str) -> Result<(), Refused> {
        let old = self.text_seen(graph, digest)?;
        self.history.saved(&old, OTHER);
        let text = self.history.redone().ok_or(Refused::Nothing)?;
        self.write(&old, &text)?;
        self.history.redo();
        Ok(())
    }

    fn text_seen(&self, graph: &Graph, digest: &str) -> Result<String, Refused> {
        if graph.root.is_confined() {
            return Err(Refused::Confined);
        }
        let text = self.text()?;
        match digest_of(&text) {
            now if now == digest => Ok(text),
            now => Err(Refused::Stale { digest: now }),
        }
    }

    fn write(&self, old: &str, text: &str) -> Result<(), Refused> {
        replace(&self.path, old, text).map_err(|error| {
            let path = self.path.display();
            match error {
                SaveError::Changed => match self.text() {
                    Ok(text) => Refused::Stale { digest: digest_of(&text) },
                    Err(gone) => gone,
                },
                SaveError::Gone => Refused::Gone { why: format!("`{path}` was deleted or moved") },
                other => Refused::Unwritten { why: format!("cannot write `{path}`: {other}") },
            }
        })
    }
}

/// Description of a change that the page did not make.
pub const OTHER: &str = "change by another program";

/// A refusal with a text for the user.
pub fn fixed(why: String) -> Refused {
    Refused::Fixed { why }
}

/// Applies the edit of one value to a text.
fn changed(graph: &Graph, node: &str, edit: &FieldEdit, text: &str) -> Result<String, Refused> {
    let FieldEdit { field, at, value } = edit;
    may_edit(graph, node, field)?;
    let shown = unshadowed(graph, node, field, text);
    let document = GraphText::new(&shown);
    let steps: Vec<Step> = at.iter().map(At::step).collect();
    let change = match value {
        Some(value) if value.len() > MAX_VALUE => {
            return Err(fixed(format!("the value is longer than {MAX_VALUE} bytes; edit it in the text")));
        }
        Some(value) => {
            // The keys of a track are replaced as a whole.
            let span = document.field(node, field).filter(|_| steps.is_empty());
            let axis = span.clone().and_then(|span| track::axis(&text[span]));
            if let (Some(span), Some(axis)) = (span, axis)
                && track::axis(value) == Some(axis)
            {
                return Ok([&text[..span.start], value, &text[span.end..]].concat());
            }
            document.set(node, field, &steps, value)?
        }
        None if steps.is_empty() => document.unset(node, field)?,
        None => return Err(fixed(format!("only the whole field `{field}` can be removed"))),
    };
    Ok(change.apply(text))
}

impl FieldEdit {
    /// Description of the edit for the history.
    fn label(&self, node: &str) -> String {
        let Self { field, at, value } = self;
        let at: String = at.iter().map(At::text).collect();
        match value {
            Some(value) => format!("{node}.{field}{at} = {}", value.chars().take(80).collect::<String>()),
            None => format!("{node}.{field} removed"),
        }
    }
}

impl At {
    fn step(&self) -> Step {
        match self {
            Self::Index(index) => Step::Index(*index),
            Self::Name(name) => Step::Name(name.clone()),
        }
    }

    fn text(&self) -> String {
        match self {
            Self::Index(index) => format!("[{index}]"),
            Self::Name(name) => format!(".{name}"),
        }
    }
}

/// Refuses fields that are wires or paths.
fn may_edit(graph: &Graph, name: &str, field: &str) -> Result<(), Refused> {
    if is_block(graph, name, field) {
        return Ok(());
    }
    let Some(index) = instances(graph, name).next() else {
        return Err(TextEditError::NoNode(name.to_owned()).into());
    };
    let kind = &graph.nodes[index].kind;
    match kind.params.iter().find(|param| param.name == field) {
        Some(param) if param.role == Role::Value => Ok(()),
        Some(_) => Err(fixed(format!("`{field}` names a file; edit paths in the text"))),
        None if kind.inputs.iter().any(|port| port.name == field) => {
            Err(fixed(format!("`{field}` is a wire; edit wires in the text")))
        }
        None => Err(fixed(format!("`{}` has no parameter `{field}`", kind.camel_name()))),
    }
}

/// Refuses a field whose value in the file is overridden by a preset, an overlay or `--set`.
fn refuse_hidden(
    graph: &Graph,
    name: &str,
    field: &str,
    span: &std::ops::Range<usize>,
    length: usize,
) -> Result<(), Refused> {
    let Some(index) = instances(graph, name).next() else { return Ok(()) };
    let place = graph.place(index, Some(field));
    if place != *span && place.start >= length {
        return Err(fixed(format!(
            "a preset, an overlay or `--set` on the command line overrides `{name}.{field}`"
        )));
    }
    Ok(())
}

fn parsed(graph: &Graph, text: &str) -> Result<Graph, Refused> {
    let (source, _) = Source::new(graph.source.name.clone(), text).including(&graph.root);
    Graph::parse(source, &nodes::registry(), graph.root.clone())
        .map_err(|mistakes: Diagnostics| Refused::Invalid { mistakes: mistakes.mistakes() })
}

/// Parses the edited text. The edit may not change which files are read or written.
fn checked(graph: &Graph, text: &str) -> Result<Graph, Refused> {
    let edited = parsed(graph, text)?;
    let read = |graph: &Graph| graph.files().into_iter().collect::<BTreeSet<_>>();
    let written =
        |graph: &Graph| graph.nodes.iter().filter_map(|node| node.sink_path.clone()).collect::<BTreeSet<_>>();
    if !read(&edited).is_subset(&read(graph)) || !written(&edited).is_subset(&written(graph)) {
        return Err(fixed(
            "this would change which files the graph reads or writes; edit paths in the text".to_owned(),
        ));
    }
    Ok(edited)
}

/// A graph that handlers share.
pub type SharedGraph = Arc<Graph>;

#[cfg(test)]
mod tests;
