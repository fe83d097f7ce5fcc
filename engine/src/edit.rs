//! Edits of a graph file by place, never by writing it anew: comments and layout survive.

use std::ops::Range;

use crate::check::SCENE_FIELDS;
use crate::diag::{Diagnostics, Source, nearest};
use crate::syntax::{RawNode, parse, parse_value};

/// One `--set node.field=value`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Name of the node.
    pub node: String,
    /// Name of the field.
    pub field: String,
    /// RON text of the value. A plain word or path is taken as text where it is no RON.
    pub value: String,
}

/// Why a setting cannot be applied.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EditError {
    /// It is not written `node.field=value`.
    #[error("`{0}` is not a setting; write node.field=value")]
    Form(String),
    /// The graph has no such node.
    #[error("`{setting}`: no node is named `{node}`{hint}")]
    Node {
        /// The setting as given.
        setting: String,
        /// The name that was looked for.
        node: String,
        /// "did you mean", or nothing.
        hint: String,
    },
    /// The graph file itself cannot be read.
    #[error(transparent)]
    Graph(#[from] Diagnostics),
}

impl std::str::FromStr for Setting {
    type Err = EditError;
    fn from_str(text: &str) -> Result<Self, EditError> {
        let form = || EditError::Form(text.to_owned());
        let (place, value) = text.split_once('=').ok_or_else(form)?;
        let (node, field) = place.split_once('.').ok_or_else(form)?;
        let plain = |name: &str| {
            let name = name.trim();
            (!name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_'))
                .then(|| name.to_owned())
        };
        match (plain(node), plain(field)) {
            (Some(node), Some(field)) if !value.trim().is_empty() => {
                Ok(Self { node, field, value: value.trim().to_owned() })
            }
            _ => Err(form()),
        }
    }
}

/// The text of a graph with the settings in place. `scene.up=..` and its like set the scene block.
pub fn apply(source: &Source, settings: &[Setting]) -> Result<Source, EditError> {
    let mut text = source.text.to_string();
    for setting in settings {
        let shown = format!("{}.{}", setting.node, setting.field);
        let mut diagnostics = Vec::new();
        let document = parse(&text, &mut diagnostics);
        if !diagnostics.is_empty() {
            return Err(Diagnostics::new(Source::new(source.name.clone(), text.as_str()), diagnostics).into());
        }
        let value = ron_text(&setting.value);
        let node = document.nodes.iter().find(|node| node.id == setting.node);
        let scene = document.scene.as_ref().filter(|_| setting.node == "scene");
        let own = |node: &RawNode<'_>| node.fields.iter().any(|field| field.name == setting.field);
        let edit = match node {
            // A node may be called `scene`, too; what only the block has is the block's.
            _ if let Some(scene) = scene.filter(|_| {
                node.is_none_or(|node| SCENE_FIELDS.contains(&setting.field.as_str()) && !own(node))
            }) =>
            {
                match scene.fields.iter().find(|field| field.name == setting.field) {
                    Some(field) => (field.span.clone(), value),
                    None => insertion(scene.inside, !scene.fields.is_empty(), &setting.field, &value),
                }
            }
            Some(node) => node_edit(node, &setting.field, &value),
            None => {
                let near = nearest(&setting.node, document.nodes.iter().map(|node| node.id));
                let hint = near.map(|near| format!(", did you mean `{near}`?")).unwrap_or_default();
                return Err(EditError::Node { setting: shown, node: setting.node.clone(), hint });
            }
        };
        let (span, with) = edit;
        text.replace_range(span, &with);
    }
    Ok(Source::new(source.name.clone(), text))
}

fn node_edit(node: &RawNode<'_>, field: &str, value: &str) -> (Range<usize>, String) {
    match (node.fields.iter().find(|known| known.name == field), node.inside) {
        (Some(known), _) => (known.span.clone(), value.to_owned()),
        (None, Some(inside)) => insertion(inside, !node.fields.is_empty(), field, value),
        (None, None) => (node.span.end..node.span.end, format!("({field}: {value})")),
    }
}

/// Puts a field right behind the opening parenthesis, where no comment can swallow it.
fn insertion(inside: usize, others: bool, field: &str, value: &str) -> (Range<usize>, String) {
    (inside..inside, format!("{field}: {value}{}", if others { ", " } else { "" }))
}

/// What was typed in a shell as RON: quotes are easily lost there, so what is no RON value, and a lower
/// case word or a path, is taken as text.
fn ron_text(value: &str) -> String {
    let first = value.chars().next().unwrap_or_default();
    let is_ron = matches!(value, "true" | "false")
        || first.is_ascii_digit()
        || matches!(first, '"' | '(' | '[' | '-' | '+' | '.')
        || (first.is_uppercase() && !value.contains('/'));
    if is_ron && parse_value::<&ron::value::RawValue>(value).is_ok() {
        value.to_owned()
    } else {
        format!("{value:?}")
    }
}

/// RON text with the content of each string replaced.
pub(crate) fn replace_strings(text: &str, mut with: impl FnMut(&str) -> String) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find('"') {
        let (before, quoted) = rest.split_at(start);
        let mut escaped = false;
        let end = quoted[1..].find(|c| {
            let ends = c == '"' && !escaped;
            escaped = c == '\\' && !escaped;
            ends
        });
        // Text that was checked has no string without an end.
        let (string, after) = quoted.split_at(end.map_or(quoted.len(), |end| end + 2));
        let plain = parse_value::<String>(string).unwrap_or_default();
        out.push_str(before);
        out.push_str(&format!("{:?}", with(&plain)));
        rest = after;
    }
    out + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(text: &str, settings: &[&str]) -> Result<String, EditError> {
        let settings: Vec<Setting> = settings.iter().map(|s| s.parse()).collect::<Result<_, _>>()?;
        apply(&Source::new("a.ron", text), &settings).map(|source| source.text.to_string())
    }

    #[test]
    fn values_are_replaced_or_added_and_comments_survive() {
        let text = "Graph(version: 1, scene: (up: \"+z\"), nodes: (\n  a: Pose(yaw_deg: 1.0), // keep\n  b: Demo,\n))";
        let edited =
            set(text, &["a.yaw_deg=35", "a.scale=2", "b.path=out/x.png", "scene.seed=9", "b.m=Hard"]);
        assert_eq!(
            edited,
            Ok("Graph(version: 1, scene: (seed: 9, up: \"+z\"), nodes: (\n  a: Pose(scale: 2, yaw_deg: 35), // keep\n  b: Demo(m: Hard, path: \"out/x.png\"),\n))".to_owned())
        );
    }

    #[test]
    fn strings_are_replaced_wherever_they_stand() {
        let replaced = replace_strings(r#"[Some("a/b.ply"), "c\"d", 3, "é"]"#, |text| format!("<{text}>"));
        assert_eq!(replaced, r#"[Some("<a/b.ply>"), "<c\"d>", 3, "<é>"]"#);
        assert_eq!(replace_strings("no string", |_| String::new()), "no string");
    }

    #[test]
    fn what_is_no_setting_says_so() {
        assert!(matches!("yaw=3".parse::<Setting>(), Err(EditError::Form(_))));
        let wrong = set("Graph(version: 1, scene: (up: \"+z\"), nodes: (pose: Pose()))", &["pos.x=1"]);
        assert!(wrong.is_err_and(|e| e.to_string().contains("did you mean `pose`?")));
    }
}
