//! Lines of the text formats OBJ and MTL.

use std::borrow::Cow;

use crate::io::foreign::BYTE_ORDER_MARK;

/// Statements of a text, each with the number of its first line, from 1. Empty lines and comments are left out. A
/// line that ends with a backslash continues in the next line. Lines may end as on any system. Bytes that are not
/// UTF-8 are read as Latin-1, in which older programs write names and comments.
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    /// The statements of a file, with or without a byte-order mark.
    pub fn of(bytes: &'a [u8]) -> Self {
        Self { rest: bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes), number: 0 }
    }

    fn line(&mut self) -> &'a [u8] {
        let end = self.rest.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(self.rest.len());
        let (line, after) = self.rest.split_at(end);
        let skipped = if after.starts_with(b"\r\n") { 2 } else { 1 };
        self.rest = after.get(skipped..).unwrap_or_default();
        self.number += 1;
        line.trim_ascii()
    }
}

fn decoded(line: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(line) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(line.iter().map(|b| char::from(*b)).collect()),
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, Cow<'a, str>);

    fn next(&mut self) -> Option<Self::Item> {
        while !self.rest.is_empty() {
            let line = self.line();
            let number = self.number;
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            let mut text = decoded(line);
            while text.ends_with('\\') {
                let mut joined = text.into_owned();
                joined.pop();
                joined.push(' ');
                joined.push_str(&decoded(self.line()));
                text = Cow::Owned(joined);
            }
            return Some((number, text));
        }
        None
    }
}

/// The first word of a text, and the rest without white space before it.
pub(super) fn word(text: &str) -> (&str, &str) {
    let end = text.find(|c: char| c.is_ascii_whitespace()).unwrap_or(text.len());
    (&text[..end], text[end..].trim_ascii())
}

/// The words of a text up to a comment.
pub(super) fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split_ascii_whitespace().take_while(|word| !word.starts_with('#'))
}

/// A finite number.
pub(super) fn number(word: &str) -> Option<f32> {
    word.parse().ok().filter(|number: &f32| number.is_finite())
}

/// The path at which a file is looked for: relative, with slashes instead of the backslashes that exporters on
/// Windows write. An absolute path is one of another machine, so only its file name is used. `None` if there is no
/// file name.
pub(super) fn relative(path: &str) -> Option<String> {
    let path = path.trim().trim_matches('"').replace('\\', "/");
    let absolute = path.starts_with('/') || path.as_bytes().get(1) == Some(&b':') || path.contains("://");
    let path = if absolute { path.rsplit(['/', ':']).next().unwrap_or_default().to_owned() } else { path };
    (!path.is_empty() && !path.contains('\0')).then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_joined_decoded_and_numbered() {
        let all = |bytes: &[u8]| Lines::of(bytes).map(|(n, text)| (n, text.into_owned())).collect::<Vec<_>>();
        let of = |n: usize, text: &str| (n, text.to_owned());
        assert_eq!(
            all(b"\xef\xbb\xbfa 1\r\n\r\n# c \\\nb \\\n  2\rc"),
            [of(1, "a 1"), of(4, "b  2"), of(6, "c")]
        );
        assert_eq!(all(b"usemtl gr\xfcn\nx \\"), [of(1, "usemtl gr\u{fc}n"), of(2, "x  ")]);
        assert_eq!(all(b""), []);
    }

    #[test]
    fn paths_of_other_machines_become_file_names() {
        for (path, found) in [
            ("sub\\a b.mtl", Some("sub/a b.mtl")),
            ("\"a.mtl\"", Some("a.mtl")),
            ("C:\\x\\a.mtl", Some("a.mtl")),
            ("C:a.mtl", Some("a.mtl")),
            ("/home/me/a.mtl", Some("a.mtl")),
            ("file:///x/a.mtl", Some("a.mtl")),
            ("/x/", None),
            ("  ", None),
        ] {
            assert_eq!(relative(path).as_deref(), found, "{path}");
        }
    }
}
