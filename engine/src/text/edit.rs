//! Settings of the command line (`--set`). Each of them is an overlay of one field.

use crate::text::source::Source;
use crate::text::values::parse_value;

/// A setting of the command line, `--set node.field=value`. A node in a subgraph is written `left.pose`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Name of the node.
    pub node: String,
    /// Name of the field.
    pub field: String,
    /// Value as RON. A plain word or a path that is not valid RON is interpreted as a string.
    pub value: String,
}

/// Errors when parsing a setting.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EditError {
    /// The argument does not have the form `node.field=value`.
    #[error("`{0}` is not a setting; write `node.field=value`")]
    Form(String),
}

impl std::str::FromStr for Setting {
    type Err = EditError;
    fn from_str(text: &str) -> Result<Self, EditError> {
        let form = || EditError::Form(text.to_owned());
        let (place, value) = text.split_once('=').ok_or_else(form)?;
        let (node, field) = place.rsplit_once('.').ok_or_else(form)?;
        let plain = |name: &str| {
            let name = name.trim();
            let word = |part: &str| !part.is_empty() && part.chars().all(|c| c.is_alphanumeric() || c == '_');
            name.split('.').all(word).then(|| name.to_owned())
        };
        match (plain(node), plain(field)) {
            (Some(node), Some(field)) if !value.trim().is_empty() => {
                Ok(Self { node, field, value: value.trim().to_owned() })
            }
            _ => Err(form()),
        }
    }
}

/// Adds the settings to a graph as overlays. Settings of `scene`, `axes` and `parameters` change these blocks.
pub fn apply(source: &Source, settings: &[Setting]) -> Source {
    settings.iter().fold(source.clone(), |source, setting| {
        let Setting { node, field, value } = setting;
        source.set(&format!("{node}.{field}={}", ron_text(value)))
    })
}

/// Converts shell input to RON. Shells remove quotes, so a lower-case word, a path, or any input that is not valid
/// RON is interpreted as a string.
fn ron_text(value: &str) -> String {
    let first = value.chars().next().unwrap_or_default();
    let is_ron = matches!(value, "true" | "false")
        || first.is_ascii_digit()
        || matches!(first, '"' | '(' | '[' | '-' | '+' | '.')
        || (first.is_uppercase() && (!value.contains('/') || value.ends_with(')')));
    if is_ron && parse_value::<&ron::value::RawValue>(value).is_ok() {
        value.to_owned()
    } else {
        format!("{value:?}")
    }
}

/// Returns RON text in which `with` has replaced the content of every string.
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
        // Checked text has no unterminated string.
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

    #[test]
    fn a_setting_is_an_overlay_of_one_field() {
        let set = |setting: &str| {
            let settings: Vec<Setting> = setting.parse().into_iter().collect();
            let text = apply(&Source::new("a.ron", "Graph()"), &settings).text;
            text.rsplit_once('\n').map(|(_, end)| end.to_owned()).unwrap_or_default()
        };
        assert_eq!(set("a.yaw_deg=35"), "a.yaw_deg=35");
        assert_eq!(set("a.path=out/x.png"), "a.path=\"out/x.png\"", "text that is not RON is a string");
        assert_eq!(set("a.m = Hard"), "a.m=Hard");
        assert_eq!(set("left.a.m=Hard"), "left.a.m=Hard");
        assert_eq!(set("a.m=By(file: \"x/y.png\")"), "a.m=By(file: \"x/y.png\")");
        assert_eq!(set("a.path=Out/x.png"), "a.path=\"Out/x.png\"");
        assert_eq!(set("axes.frame=Range(0, 3)"), "axes.frame=Range(0, 3)");
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
    }
}
