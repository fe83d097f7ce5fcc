//! Applies a small edit of the text to a checked graph without parsing the whole text again.
//!
//! The edit may change parameters of one node, or comments and white space between nodes. For any other edit, and
//! for any mistake, the caller uses [`Graph::parse`](crate::Graph::parse), which gives the same graph. The scanner
//! reads forwards, and the extent of a value that ends in `)` does not depend on the text after it. So if the text
//! of a node is still one node, or the text between nodes differs only in comments and white space, the rest of the
//! file is unaffected.

use std::ops::Range;
use std::sync::Arc;

use crate::graph::checker::Check;
use crate::graph::graph::Graph;
use crate::graph::node::Node;
use crate::kind::registry::{KindEntry, Registry};
use crate::text::document::{Document, RawNode, Scope};
use crate::text::scan::Scanner;
use crate::text::source::Source;
use crate::text::syntax::parse_node;

impl Graph {
    /// The graph of the edited text `text`; `None` if the whole text must be parsed. `registry` is called only if a
    /// node changed.
    pub fn reparse(self: &Arc<Self>, text: String, registry: impl Fn() -> Registry) -> Option<Arc<Self>> {
        if !self.plain || *self.source.text == *text {
            return self.plain.then(|| self.clone());
        }
        let source = Source::new(self.source.name.clone(), text);
        if source.pieces().len() > 1 {
            return None;
        }
        let (old, new) = (&*self.source.text, &*source.text);
        let (was, is) = difference(old, new);
        // The node before the edit or around it.
        let before = self.begun_before(was.start);
        let around = before.checked_sub(1).map(|node| (node, self.place(node, None)));
        let moved = |at: usize| at - was.end + is.end;
        let mut graph = Self::clone(self);
        graph.source = source.clone();
        match around {
            Some((node, place)) if was.end < place.end => {
                let part = place.start..moved(place.end);
                graph.nodes[node] = Arc::new(self.node_edited(node, &source, part, &registry())?);
            }
            _ => {
                let from = around.map_or(0, |(_, place)| place.end);
                let to = if before < self.nodes.len() { self.start(before) } else { old.len() };
                if was.start < from
                    || was.end > to
                    || !same_but_for_space(&old[from..to], &new[from..moved(to)])
                {
                    return None;
                }
            }
        }
        graph.move_starts(before, &moved);
        Some(Arc::new(graph))
    }

    /// The node with index `index` after an edit of its text. `None` unless the edit changed only parameters and
    /// all of them are valid.
    fn node_edited(
        &self,
        index: usize,
        source: &Source,
        part: Range<usize>,
        registry: &Registry,
    ) -> Option<Node> {
        let node = &self.nodes[index];
        let raw = parse_node(&source.text, part)?;
        let kind = registry.get(raw.kind).filter(|kind| kind.name == node.kind.name)?;
        let named = |name: &str| raw.fields.iter().filter(|field| field.name == name).count() == 1;
        let known = raw.fields.iter().all(|field| is_field(kind, field.name) && named(field.name));
        let wired = |name: &str| -> Option<&str> {
            let place = node.field_place(name)?;
            let start = self.start(index);
            self.source.text.get(place.start - node.span.start + start..place.end - node.span.start + start)
        };
        let alike = kind.inputs.iter().all(|port| {
            wired(port.name)
                == raw.fields.iter().find(|field| field.name == port.name).map(|field| field.text)
        });
        if raw.id != node.id || !known || !alike {
            return None;
        }
        let document = Document { scopes: vec![Scope::default()], nodes: vec![raw], ..Document::default() };
        let mut mistakes = Vec::new();
        let mut check = Check::new(source, registry, &self.root, &document, &mut mistakes);
        let (step, sink_path, places) = check.alone(&document.nodes[0], kind)?;
        let agrees = mistakes.is_empty()
            && sink_path == node.sink_path
            && step.check_wires(&self.wired(index)).is_ok()
            && matches!(
                (step.views(&self.root), node.step.views(&self.root)),
                (Ok(now), Ok(then)) if now == then
            );
        let RawNode { id_span, span, .. } = &document.nodes[0];
        let span = id_span.start..span.end;
        agrees.then(|| Node { step, places, span, ..(**node).clone() })
    }
}

fn is_field(kind: &KindEntry, name: &str) -> bool {
    kind.params.iter().any(|param| param.name == name) || kind.inputs.iter().any(|port| port.name == name)
}

/// The parts in which two texts differ: a byte range of `old`, and the byte range of `new` that replaces it.
fn difference(old: &str, new: &str) -> (Range<usize>, Range<usize>) {
    const AT_ONCE: usize = 64;
    let (a, b) = (old.as_bytes(), new.as_bytes());
    let chunks =
        a.chunks_exact(AT_ONCE).zip(b.chunks_exact(AT_ONCE)).take_while(|(a, b)| a == b).count() * AT_ONCE;
    let start = chunks + a[chunks..].iter().zip(&b[chunks..]).take_while(|(a, b)| a == b).count();
    let start = old.floor_char_boundary(start);
    let (a, b) = (&a[start..], &b[start..]);
    let chunks =
        a.rchunks_exact(AT_ONCE).zip(b.rchunks_exact(AT_ONCE)).take_while(|(a, b)| a == b).count() * AT_ONCE;
    let (a, b) = (&a[..a.len() - chunks], &b[..b.len() - chunks]);
    let end = chunks + a.iter().rev().zip(b.iter().rev()).take_while(|(a, b)| a == b).count();
    let old_end = old.ceil_char_boundary(old.len() - end);
    (start..old_end, start..new.len() - (old.len() - old_end))
}

/// True if two texts between nodes differ only in comments and white space.
fn same_but_for_space(old: &str, new: &str) -> bool {
    let words = |text: &str| -> Option<Vec<String>> {
        let mut scan = Scanner::new(text);
        let mut words = vec![String::new()];
        loop {
            let start = scan.at;
            scan.skip_space();
            if scan.at > start {
                // A comment at the end would continue into the text that follows.
                let last = text[start..scan.at].rfind('\n').map_or(start, |line| start + line);
                let in_comment = scan.is_at_end() && text[last..].contains("//");
                if in_comment {
                    return None;
                }
                words.push(String::new());
            }
            if scan.is_at_end() {
                return scan.diagnostics.is_empty().then_some(words);
            }
            let start = scan.at;
            if scan.peek() == b'"' {
                scan.value()?;
            } else {
                scan.step();
            }
            words.last_mut()?.push_str(&text[start..scan.at]);
        }
    };
    let (old, new) = (words(old), words(new));
    old.is_some() && old == new
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_all_that_differs_and_between_characters() {
        let long = "x".repeat(300);
        for (old, new, was, is) in [
            ("abcdef", "abXdef", 2..3, 2..3),
            ("abcdef", "abdef", 2..3, 2..2),
            ("aaaa", "aaa", 3..4, 3..3),
            ("", "a", 0..0, 0..1),
            ("same", "same", 4..4, 4..4),
            ("aäb", "aöb", 1..3, 1..3),
            ("a\u{e4}\u{24}b", "a\u{e5}\u{e4}b", 1..4, 1..5),
        ] {
            assert_eq!(difference(old, new), (was.clone(), is.clone()), "{old} {new}");
            let (old, new) = (format!("{long}{old}{long}"), format!("{long}{new}{long}"));
            let (was, is) = difference(&old, &new);
            assert_eq!(format!("{}{}{}", &old[..was.start], &new[is.clone()], &old[was.end..]), new);
            assert!(was.len() <= 4 && is.len() <= 4);
        }
    }

    #[test]
    fn space_is_what_no_reader_sees() {
        for (old, new, same) in [
            (",\n  ", ", // why\n  ", true),
            (",\n  ", ", /* why */  ", true),
            (",\n  ", ", // why", false),
            (", // a\n", ", // b\n", true),
            (",\n", ",\n//@@ set x\n", true),
            ("up: \"+z\", ", "up: \"+y\", ", false),
            ("up: \"+ z\", ", "up: \"+  z\", ", false),
            ("a b ", "ab ", false),
            (", ", ",, ", false),
            (", ", ", /* ", false),
        ] {
            assert_eq!(same_but_for_space(old, new), same, "{old:?} {new:?}");
        }
    }
}
