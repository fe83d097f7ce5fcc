//! The scanner of RON text: it finds where names, values and brackets begin and end.
//!
//! Values are skipped here and parsed later by `ron`. So one pass finds the byte ranges of all names and values,
//! and a mistake affects only the field that contains it. The scanner does not recurse, however deeply brackets are
//! nested.

use std::ops::Range;

use crate::text::diag::Diagnostic;

/// A position in a text, from which names and values are read.
pub(crate) struct Scanner<'t> {
    pub text: &'t str,
    pub at: usize,
    pub diagnostics: Vec<Diagnostic>,
    /// True after an unterminated string, comment or bracket was reported. Brackets that seem unclosed because of
    /// that mistake are not reported.
    endless: bool,
}

impl<'t> Scanner<'t> {
    pub fn new(text: &'t str) -> Self {
        Self { text, at: 0, diagnostics: Vec::new(), endless: false }
    }

    /// The byte at the current position; 0 at the end.
    pub fn peek(&self) -> u8 {
        self.text.as_bytes().get(self.at).copied().unwrap_or_default()
    }

    fn rest(&self) -> &'t str {
        &self.text[self.at..]
    }

    pub fn is_at_end(&self) -> bool {
        self.at >= self.text.len()
    }

    /// Skips `byte`, which must be ASCII. Returns false if `byte` is not at the current position.
    pub fn eat(&mut self, byte: u8) -> bool {
        let found = self.peek() == byte && !self.is_at_end();
        self.at += usize::from(found);
        found
    }

    /// Skips one character.
    pub fn step(&mut self) {
        self.at += self.rest().chars().next().map_or(0, char::len_utf8);
    }

    pub fn report(&mut self, diagnostic: Diagnostic) {
        self.diagnostics.push(diagnostic);
    }

    /// Reports that the bracket `open` at the byte offset `place` is never closed.
    pub fn unclosed(&mut self, place: usize, open: u8) {
        if !std::mem::replace(&mut self.endless, true) {
            let what = format!("`{}` has no matching `{}`", open as char, closing(open) as char);
            self.report(
                Diagnostic::new(place..place + 1, what)
                    .hint("the closing bracket is missing somewhere below"),
            );
        }
    }

    /// The byte range of the current character.
    pub fn here(&self) -> Range<usize> {
        self.at..self.at + self.rest().chars().next().map_or(0, char::len_utf8)
    }

    /// Skips white space and comments.
    pub fn skip_space(&mut self) {
        loop {
            match self.peek() {
                b' ' | b'\n' | b'\t' | b'\r' => self.at += 1,
                b'/' if self.rest().starts_with("//") => {
                    self.at += self.rest().find('\n').unwrap_or(self.rest().len());
                }
                b'/' if self.rest().starts_with("/*") => self.skip_block_comment(),
                0xc2..=0xf4 if self.rest().starts_with(is_space) => self.step(),
                _ => return,
            }
        }
    }

    fn skip_block_comment(&mut self) {
        let start = self.at;
        let mut depth = 0_usize;
        while !self.is_at_end() {
            if self.rest().as_bytes().starts_with(b"/*") {
                (depth, self.at) = (depth + 1, self.at + 2);
            } else if self.rest().as_bytes().starts_with(b"*/") {
                (depth, self.at) = (depth - 1, self.at + 2);
                if depth == 0 {
                    return;
                }
            } else {
                self.step();
            }
        }
        self.endless = true;
        self.report(Diagnostic::new(start..start + 2, "unterminated comment").hint("end it with `*/`"));
    }

    /// Reads an identifier: letters, digits and `_`, not beginning with a digit.
    pub fn word(&mut self) -> Option<&'t str> {
        let start = self.at;
        if self.peek().is_ascii_digit() {
            return None;
        }
        let length = self.rest().find(|c: char| !c.is_alphanumeric() && c != '_');
        self.at += length.unwrap_or(self.rest().len());
        (self.at > start).then(|| &self.text[start..self.at])
    }

    /// Skips one value and returns its range; `None` if there is no value.
    pub fn value(&mut self) -> Option<Range<usize>> {
        let start = self.at;
        match self.peek() {
            b'"' => self.string(),
            b'\'' => self.character(),
            b'(' | b'[' | b'{' => self.group(),
            b'+' | b'-' | b'.' | b'0'..=b'9' => self.number(),
            _ if self.rest().starts_with(CURLY) => self.curly(),
            _ => {
                self.word()?;
                let prefix = &self.text[start..self.at];
                if matches!(self.peek(), b'"' | b'#') && matches!(prefix, "r" | "b" | "br") {
                    self.raw_string(prefix.ends_with('r'));
                } else if self.peek() == b'\'' && prefix == "b" {
                    self.character();
                } else {
                    let end = self.at;
                    self.skip_space();
                    if self.peek() == b'(' { self.group() } else { self.at = end }
                }
            }
        }
        Some(start..self.at)
    }

    fn number(&mut self) {
        let part = |c: char| c.is_alphanumeric() || matches!(c, '+' | '-' | '.' | '_');
        self.at += self.rest().find(|c| !part(c)).unwrap_or(self.rest().len());
    }

    /// Skips a string in double quotes. It must end on the line where it begins, so that a forgotten quote affects
    /// only that line.
    fn string(&mut self) {
        let start = self.at;
        self.at += 1;
        loop {
            match self.peek() {
                b'"' => return self.at += 1,
                b'\\' => {
                    self.at += 1;
                    self.step();
                }
                b'\n' | 0 if self.peek() == b'\n' || self.is_at_end() => break,
                _ => self.step(),
            }
        }
        // The string was most likely meant to end before the next punctuation.
        let line = &self.text[start + 1..self.at];
        let end = line.find([',', ')', ']']).unwrap_or(line.len());
        self.at = start + 1 + line[..end].trim_end().len();
        self.report(
            Diagnostic::new(start..self.at, "unterminated string")
                .label("a `\"` is missing at the end or the start of the string"),
        );
    }

    fn raw_string(&mut self, raw: bool) {
        let start = self.at;
        let hashes = self.rest().bytes().take_while(|byte| *byte == b'#').count();
        if !raw || !self.rest()[hashes..].starts_with('"') {
            if self.peek() == b'"' {
                self.string();
            }
            return;
        }
        let close = format!("\"{}", "#".repeat(hashes));
        self.at += hashes + 1;
        match self.rest().find(&close) {
            Some(length) => self.at += length + close.len(),
            None => {
                self.at = self.text.len();
                self.endless = true;
                let opening = start..start + hashes + 1;
                self.report(
                    Diagnostic::new(opening, "unterminated string")
                        .label(format!("the string must end with `{close}`")),
                );
            }
        }
    }

    /// Skips a character in single quotes. A longer string in single quotes is skipped and reported as a mistake.
    fn character(&mut self) {
        let start = self.at;
        let line = self.rest().find('\n').map_or(self.rest(), |end| &self.rest()[..end]);
        let mut escaped = false;
        let close = line.char_indices().skip(1).find(|(_, c)| {
            let found = *c == '\'' && !escaped;
            escaped = *c == '\\' && !escaped;
            found
        });
        let Some((length, _)) = close else {
            self.at += 1;
            return self.report(quotes(start..start + 1, None));
        };
        self.at += length + 1;
        let inside = &line[1..length];
        if inside.chars().count() != 1 && !inside.starts_with('\\') {
            self.report(quotes(start..self.at, Some(inside)));
        }
    }

    /// Skips a string in typographic quotes and reports it as a mistake.
    fn curly(&mut self) {
        let start = self.at;
        self.step();
        let line = self.rest().find('\n').map_or(self.rest(), |end| &self.rest()[..end]);
        let inside = match line.find(CURLY) {
            Some(end) => {
                self.at += end;
                self.step();
                Some(&line[..end])
            }
            None => {
                let inside = line.find(['"', ',', ')', ']']).map_or(line, |end| &line[..end]).trim_end();
                self.at += inside.len();
                Some(inside).filter(|inside| !inside.is_empty())
            }
        };
        self.report(quotes(start..self.at, inside));
    }

    /// Skips everything from an opening bracket to the matching closing bracket.
    fn group(&mut self) {
        let mut open: Vec<(u8, usize)> = Vec::new();
        loop {
            self.skip_space();
            let byte = self.peek();
            match byte {
                b'(' | b'[' | b'{' => {
                    open.push((byte, self.at));
                    self.at += 1;
                }
                b')' | b']' | b'}' => {
                    let Some(&(opened, place)) = open.last() else { return };
                    if closing(opened) != byte {
                        // The bracket may close an outer group, which continues from here.
                        return self.report(
                            Diagnostic::new(
                                self.here(),
                                format!("`{}` is missing here", closing(opened) as char),
                            )
                            .related(place..place + 1, "opened here"),
                        );
                    }
                    open.pop();
                    self.at += 1;
                    if open.is_empty() {
                        return;
                    }
                }
                b'"' => self.string(),
                b'\'' => self.character(),
                0 if self.is_at_end() => {
                    let Some(&(opened, place)) = open.last() else { return };
                    return self.unclosed(place, opened);
                }
                _ if self.rest().starts_with(CURLY) => self.curly(),
                _ => {
                    let start = self.at;
                    if let Some(prefix) = self.word() {
                        if matches!(self.peek(), b'"' | b'#') && matches!(prefix, "r" | "b" | "br") {
                            self.raw_string(prefix.ends_with('r'));
                        }
                    } else {
                        self.step();
                    }
                    debug_assert!(self.at > start, "the scanner must advance");
                }
            }
        }
    }

    /// Skips a value or, if there is none, one character; for recovery after a mistake.
    pub fn step_over(&mut self) {
        let before = self.at;
        if self.value().is_none() || self.at == before {
            self.step();
        }
    }
}

const CURLY: [char; 4] = ['\u{201c}', '\u{201d}', '\u{2018}', '\u{2019}'];

fn closing(open: u8) -> u8 {
    match open {
        b'(' => b')',
        b'[' => b']',
        _ => b'}',
    }
}

fn quotes(span: Range<usize>, inside: Option<&str>) -> Diagnostic {
    let plain = Diagnostic::new(span, "strings are written in straight double quotes");
    match inside {
        Some(inside) => plain.label(format!("write \"{inside}\"")),
        None => plain.label("write \"..\""),
    }
}

/// True for the white space of RON that is not ASCII, and for the byte order mark.
fn is_space(c: char) -> bool {
    matches!(c, '\u{85}' | '\u{200e}' | '\u{200f}' | '\u{2028}' | '\u{2029}' | '\u{feff}')
}
