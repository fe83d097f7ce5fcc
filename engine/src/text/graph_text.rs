//! The text of one graph file, and edits of single values in it that leave every other byte as it is.
//!
//! [`apply`](crate::apply) adds settings to a graph for one run and never changes its file. The edits here are for
//! editors that write the file: the caller replaces [`TextEdit::span`] with [`TextEdit::with`].

use std::ops::Range;

use crate::text::diag::{Diagnostic, shown};
use crate::text::document::{Document, RawField, RawNode};
use crate::text::scan::Scanner;
use crate::text::subgraph::calls;
use crate::text::syntax::{FileKind, parse_part};

/// The text of one graph file, without the files that it includes.
pub struct GraphText<'t> {
    text: &'t str,
    document: Document<'t>,
}

/// A replacement of bytes in a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextEdit {
    /// Byte range that is replaced; empty for an insertion.
    pub span: Range<usize>,
    /// The new text of the range.
    pub with: String,
}

impl TextEdit {
    /// The text after the edit.
    ///
    /// # Panics
    /// If the range is out of bounds or splits a character.
    pub fn apply(&self, text: &str) -> String {
        [&text[..self.span.start], &self.with, &text[self.span.end..]].concat()
    }
}

/// A step from a value to a value inside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// The entry of a list or a group with this index, from 0.
    Index(usize),
    /// The field of a group with this name.
    Name(String),
}

/// The reason why a value cannot be edited in the text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TextEditError {
    /// The file has no such node, for instance because an included file or a subgraph defines it.
    #[error("this file does not define the node `{0}`; edit the file that defines it")]
    NoNode(String),
    /// The node does not set the field, or the value has no such part.
    #[error("`{0}` is not set in the text")]
    NotSet(String),
    /// The text of the new value is not one RON value.
    #[error("`{0}` is not a value in RON")]
    NotAValue(String),
    /// The value follows an axis, keys or a parameter.
    #[error("`{field}` takes its value from `{call}`; edit {how} in the text")]
    Follows {
        /// Name of the field.
        field: String,
        /// The call in the text, such as `Axis("yaw")`.
        call: String,
        /// The part of the text to edit instead.
        how: &'static str,
    },
}

/// The calls through which a field follows another part of the graph, and that part.
const CALLS: [(&str, &str); 3] = [
    ("Axis", "the axis"),
    ("Track", "the keys of `Track`"),
    ("Param", "the parameter in `parameters`, or the call of the subgraph,"),
];

impl<'t> GraphText<'t> {
    /// Reads the structure of a text. Parts with mistakes are left out, so their values cannot be edited.
    pub fn new(text: &'t str) -> Self {
        let mut mistakes: Vec<Diagnostic> = Vec::new();
        let document = parse_part(text, 0..text.len(), FileKind::Graph, &mut mistakes);
        Self { text, document }
    }

    /// Byte range of the value of a field; `None` if the text does not set it. `node` is the name of a node, or
    /// `scene` or `parameters` for these blocks.
    pub fn field(&self, node: &str, field: &str) -> Option<Range<usize>> {
        self.fields(node)?.iter().find(|known| known.name == field).map(|known| known.span.clone())
    }

    /// Byte range of a node from its name to its closing bracket.
    pub fn node(&self, node: &str) -> Option<Range<usize>> {
        self.raw(node).map(|raw| raw.id_span.start..raw.span.end)
    }

    fn raw(&self, node: &str) -> Option<&RawNode<'t>> {
        self.document.nodes.iter().find(|raw| raw.id == node)
    }

    fn fields(&self, node: &str) -> Option<&[RawField<'t>]> {
        match (self.raw(node), node) {
            (Some(raw), _) => Some(&raw.fields),
            (None, "scene") => self.document.scene.as_ref().map(|scene| scene.fields.as_slice()),
            (None, "parameters") => Some(&self.document.parameters),
            _ => None,
        }
    }

    /// The edit that gives a field, or the part of its value at `path`, the value `value` in RON. A field that the
    /// text does not set is added after the last field of the node, laid out like it.
    ///
    /// # Errors
    /// [`TextEditError`]; the text need not be valid elsewhere.
    pub fn set(
        &self,
        node: &str,
        field: &str,
        path: &[Step],
        value: &str,
    ) -> Result<TextEdit, TextEditError> {
        if !is_one_value(value) {
            return Err(TextEditError::NotAValue(shown(value).into_owned()));
        }
        let fields = self.fields(node).ok_or_else(|| TextEditError::NoNode(node.to_owned()))?;
        match fields.iter().find(|known| known.name == field) {
            Some(known) => {
                let span = self.inside(field, known.span.clone(), path)?;
                self.refuse_calls(field, &span)?;
                Ok(TextEdit { span, with: value.to_owned() })
            }
            None if path.is_empty() && is_name(field) => {
                self.added(node, fields, &format!("{field}: {value}"))
            }
            None => Err(TextEditError::NotSet(field.to_owned())),
        }
    }

    /// The edit that removes a field, so that it has its default.
    ///
    /// # Errors
    /// [`TextEditError`], for instance if the text does not set the field.
    pub fn unset(&self, node: &str, field: &str) -> Result<TextEdit, TextEditError> {
        let fields = self.fields(node).ok_or_else(|| TextEditError::NoNode(node.to_owned()))?;
        let index = fields.iter().position(|known| known.name == field);
        let index = index.ok_or_else(|| TextEditError::NotSet(field.to_owned()))?;
        let known = &fields[index];
        self.refuse_calls(field, &known.span)?;
        let (text, mut start, mut end) = (self.text, known.name_span.start, known.span.end);
        let comma = after_space(text, end).filter(|at| text[*at..].starts_with(','));
        if let Some(comma) = comma {
            end = comma + 1;
        }
        let line = text[..start].rfind('\n').map_or(0, |at| at + 1);
        let rest = text[end..].find('\n').map(|length| end + length);
        match rest {
            Some(next)
                if comma.is_some()
                    && text[line..start].trim().is_empty()
                    && text[end..next].trim().is_empty() =>
            {
                // The field has the line for itself.
                (start, end) = (line, next + 1);
            }
            _ if comma.is_some() => {
                end += text[end..].len() - text[end..].trim_start_matches([' ', '\t']).len();
            }
            _ => {
                let before = index.checked_sub(1).map(|before| fields[before].span.end);
                if let Some(before) = before
                    && text[before..start].trim_matches([' ', '\t', '\r', '\n']) == ","
                {
                    start = before;
                }
            }
        }
        Ok(TextEdit { span: start..end, with: String::new() })
    }

    /// The insertion of a field after the last of `fields`.
    fn added(&self, node: &str, fields: &[RawField<'t>], field: &str) -> Result<TextEdit, TextEditError> {
        let text = self.text;
        let insert = |at: usize, with: String| Ok(TextEdit { span: at..at, with });
        let Some(last) = fields.last() else {
            let raw = self.raw(node).ok_or_else(|| TextEditError::NotSet(node.to_owned()))?;
            return match after_space(text, raw.kind_span.end).filter(|at| text[*at..].starts_with('(')) {
                Some(open) if open < raw.span.end => insert(open + 1, field.to_owned()),
                _ => insert(raw.kind_span.end, format!("({field})")),
            };
        };
        // The white space before the last field separates it from the field before, or from the bracket.
        let lead = &text[..last.name_span.start];
        let space = &lead[lead.trim_end_matches([' ', '\t', '\r', '\n']).len()..];
        let new_line = space.rfind('\n').map(|at| {
            let break_at = if space[..at].ends_with('\r') { at - 1 } else { at };
            &space[break_at..]
        });
        let comma = after_space(text, last.span.end).filter(|at| text[*at..].starts_with(','));
        match (new_line, comma) {
            (Some(new_line), Some(comma)) => {
                // A comment behind the last field stays on its line.
                let line = &text[comma + 1..];
                let line = &line[..line.find('\n').unwrap_or(line.len())];
                let ends_here = line.trim_start().is_empty() || line.trim_start().starts_with("//");
                let length = if ends_here { line.trim_end_matches('\r').len() } else { 0 };
                insert(comma + 1 + length, format!("{new_line}{field},"))
            }
            (Some(new_line), None) => insert(last.span.end, format!(",{new_line}{field}")),
            (None, _) => insert(last.span.end, format!(", {field}")),
        }
    }

    fn refuse_calls(&self, field: &str, span: &Range<usize>) -> Result<(), TextEditError> {
        let text = &self.text[span.clone()];
        for (name, how) in CALLS {
            if let Some(call) = calls(text, &[name]).into_iter().next() {
                let call = shown(&text[call]).into_owned();
                return Err(TextEditError::Follows { field: field.to_owned(), call, how });
            }
        }
        Ok(())
    }

    /// Byte range of the part at `path` of the value in `span`.
    fn inside(&self, field: &str, span: Range<usize>, path: &[Step]) -> Result<Range<usize>, TextEditError> {
        path.iter().try_fold(span, |span, step| {
            // A group that is computed as a whole has no parts to edit.
            if calls(&self.text[span.clone()], &CALLS.map(|(name, _)| name)).first() == Some(&(0..span.len()))
            {
                self.refuse_calls(field, &span)?;
            }
            let parts = parts(&self.text[..span.end], span);
            let found = match step {
                Step::Index(index) => parts.get(*index),
                Step::Name(name) => parts.iter().find(|(known, _)| *known == Some(name.as_str())),
            };
            let place = match step {
                Step::Index(index) => format!("{field}[{index}]"),
                Step::Name(name) => format!("{field}.{name}"),
            };
            found.map(|(_, span)| span.clone()).ok_or(TextEditError::NotSet(place))
        })
    }
}

/// The entries of a list or group, each with its name if it has one; empty for any other value.
fn parts(text: &str, span: Range<usize>) -> Vec<(Option<&str>, Range<usize>)> {
    let mut scan = Scanner::new(text);
    scan.at = span.start;
    let mut found = Vec::new();
    scan.word();
    scan.skip_space();
    if !matches!(scan.peek(), b'(' | b'[') {
        return found;
    }
    scan.at += 1;
    loop {
        scan.skip_space();
        let start = scan.at;
        let mut name = scan.word();
        let end = scan.at;
        scan.skip_space();
        if name.is_none() || !scan.eat(b':') {
            (name, scan.at) = (None, start);
        }
        scan.skip_space();
        let Some(value) = scan.value().filter(|_| name.is_none() || end > start) else { return found };
        found.push((name, value));
        scan.skip_space();
        if !scan.eat(b',') {
            return found;
        }
    }
}

/// True if a text is exactly one RON value without space around it.
fn is_one_value(text: &str) -> bool {
    let mut scan = Scanner::new(text);
    let whole = scan.value().is_some_and(|span| span == (0..text.len()));
    // A bracket in a comment, or a comment that does not end, would change the text after the value.
    whole
        && scan.diagnostics.is_empty()
        && crate::text::values::parse_value::<&ron::value::RawValue>(text).is_ok()
}

fn is_name(text: &str) -> bool {
    let mut scan = Scanner::new(text);
    scan.word() == Some(text)
}

/// The first offset from `at` on that is neither white space nor in a comment; `None` at the end.
fn after_space(text: &str, at: usize) -> Option<usize> {
    let mut scan = Scanner::new(text);
    scan.at = at;
    scan.skip_space();
    (!scan.is_at_end()).then_some(scan.at)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    const TEXT: &str = "\u{feff}Graph(\r\n  version: 1, scene: (up: \"+z\"),\r\n  nodes: (\r\n    a: Pose(translation: ( 0.5 ,/*y*/ 1.0,2 ), yaw_deg : 3.0 ),\r\n    b: Trace(\r\n      samples: 4, // few\r\n      within: Within(metres: 1.5),\r\n    ), // )\r\n    c: Demo, d: Demo(), e: Pose(yaw_deg: Axis(\"y\"), at: (Track(\"f\", [(0, 1)]), 2.0)),\r\n  ),\r\n)";

    fn edited(node: &str, field: &str, path: &[Step], value: &str) -> Result<String, TextEditError> {
        GraphText::new(TEXT).set(node, field, path, value).map(|edit| edit.apply(TEXT))
    }

    fn replaced(was: &str, is: &str) -> Result<String, TextEditError> {
        assert_eq!(TEXT.matches(was).count(), 1, "{was}");
        Ok(TEXT.replacen(was, is, 1))
    }

    #[test]
    fn only_the_bytes_of_the_value_change() {
        assert_eq!(edited("a", "yaw_deg", &[], "-7.5"), replaced("yaw_deg : 3.0", "yaw_deg : -7.5"));
        let second = [Step::Index(1)];
        assert_eq!(edited("a", "translation", &second, "9.0"), replaced("/*y*/ 1.0", "/*y*/ 9.0"));
        let metres = [Step::Name("metres".to_owned())];
        assert_eq!(edited("b", "within", &metres, "2"), replaced("metres: 1.5", "metres: 2"));
        assert_eq!(edited("scene", "up", &[], "\"+y\""), replaced("\"+z\"", "\"+y\""));
        assert_eq!(edited("e", "at", &second, "3.0"), replaced("]), 2.0", "]), 3.0"));
    }

    #[test]
    fn a_new_field_is_laid_out_like_the_last_one() {
        assert_eq!(edited("a", "scale", &[], "2.0"), replaced("3.0 )", "3.0, scale: 2.0 )"));
        assert_eq!(edited("b", "k", &[], "1"), replaced("1.5),\r\n", "1.5),\r\n      k: 1,\r\n"));
        assert_eq!(edited("c", "k", &[], "1"), replaced("Demo,", "Demo(k: 1),"));
        assert_eq!(edited("d", "k", &[], "1"), replaced("Demo()", "Demo(k: 1)"));
        assert_eq!(edited("scene", "seed", &[], "1"), replaced("\"+z\"", "\"+z\", seed: 1"));
    }

    #[test]
    fn a_field_is_removed_with_its_comma_or_line() {
        let unset =
            |node: &str, field: &str| GraphText::new(TEXT).unset(node, field).map(|edit| edit.apply(TEXT));
        assert_eq!(unset("a", "yaw_deg"), replaced(", yaw_deg : 3.0", ""));
        assert_eq!(unset("a", "translation"), replaced("translation: ( 0.5 ,/*y*/ 1.0,2 ), ", ""));
        assert_eq!(unset("b", "within"), replaced("      within: Within(metres: 1.5),\r\n", ""));
        assert_eq!(unset("b", "samples"), replaced("samples: 4, ", ""));
        assert_eq!(unset("a", "scale"), Err(TextEditError::NotSet("scale".to_owned())));
    }

    #[test]
    fn what_cannot_be_edited_is_refused_with_the_reason() {
        let follows = edited("e", "yaw_deg", &[], "1.0").unwrap_err().to_string();
        assert_eq!(follows, "`yaw_deg` takes its value from `Axis(\"y\")`; edit the axis in the text");
        for path in [vec![], vec![Step::Index(0)], vec![Step::Index(0), Step::Index(1)]] {
            let error = edited("e", "at", &path, "1.0").unwrap_err();
            assert!(
                matches!(&error, TextEditError::Follows { call, .. } if call.starts_with("Track(")),
                "{error}"
            );
        }
        assert_eq!(edited("x", "y", &[], "1"), Err(TextEditError::NoNode("x".to_owned())));
        for value in
            ["", "1, b: 2", "1)", "(1", "1 // x", "\"a", "/* */ 1", " 1", "1\n", "\"a\nb", "a b", "r#\"x"]
        {
            assert!(
                matches!(edited("a", "yaw_deg", &[], value), Err(TextEditError::NotAValue(_))),
                "{value}"
            );
        }
        for field in ["no name", "x: 1, y", ""] {
            assert!(matches!(edited("a", field, &[], "1"), Err(TextEditError::NotSet(_))), "{field}");
        }
    }
}
