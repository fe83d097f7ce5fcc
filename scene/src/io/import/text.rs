//! Lines of the text formats OBJ and MTL.

use std::borrow::Cow;
use std::io::{BufRead, BufReader, Read};

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

/// Maximum length of a line that [`lines_with`] keeps, in bytes. The rest of a longer line is left out.
const LINE_LIMIT: usize = 1 << 16;
/// Maximum length of all lines that [`lines_with`] keeps, in bytes.
const KEPT_LIMIT: usize = 16 << 20;

/// The lines of a file that begin with `keyword`, in any case, with the lines in which they continue. The file is not kept in
/// memory.
///
/// # Errors
/// If the file cannot be read, or has an absurd number of such lines.
pub(super) fn lines_with(file: impl Read, keyword: &str) -> std::io::Result<Vec<u8>> {
    let mut reader = BufReader::with_capacity(LINE_LIMIT, file);
    let (mut kept, mut line) = (Vec::new(), Vec::new());
    let mut continues = false;
    let mut end_line = |line: &mut Vec<u8>| -> std::io::Result<()> {
        let text = line.strip_prefix(BYTE_ORDER_MARK).unwrap_or(line).trim_ascii();
        let begins =
            text.get(..keyword.len()).is_some_and(|start| start.eq_ignore_ascii_case(keyword.as_bytes()));
        if continues || begins {
            if kept.len() + text.len() > KEPT_LIMIT {
                let what =
                    format!("the file has more than {} MiB of lines with `{keyword}`", KEPT_LIMIT >> 20);
                return Err(std::io::Error::new(std::io::ErrorKind::FileTooLarge, what));
            }
            kept.extend_from_slice(text);
            kept.push(b'\n');
            continues = text.ends_with(b"\\");
        }
        line.clear();
        Ok(())
    };
    loop {
        let part = reader.fill_buf()?;
        if part.is_empty() {
            end_line(&mut line)?;
            return Ok(kept);
        }
        let end = part.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let text = &part[..end.unwrap_or(part.len())];
        line.extend_from_slice(&text[..text.len().min(LINE_LIMIT - line.len())]);
        let used = text.len() + usize::from(end.is_some());
        if end.is_some() {
            end_line(&mut line)?;
        }
        reader.consume(used);
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

    /// The lines with a keyword are those that [`Lines`] finds, at any length of the reads, and nothing else is kept.
    #[test]
    fn lines_with_a_keyword_are_kept() {
        let text =
            b"\xef\xbb\xbfmtllib a.mtl\r\nv 0 0 0\n  MTLLIB b c\\\n d.mtl\rf 1 2 3\nmtllib  e.mtl".as_slice();
        let kept = lines_with(text, "mtllib").expect("reads");
        let statements = |bytes: &[u8]| -> Vec<String> {
            let all = Lines::of(bytes).map(|(_, line)| line.into_owned());
            all.filter(|line| word(line).0.eq_ignore_ascii_case("mtllib")).collect()
        };
        assert_eq!(statements(&kept), statements(text));
        assert_eq!(statements(&kept).len(), 3);
        // A line of any length takes bounded memory.
        let long = std::io::repeat(0).take(1 << 26).chain(b"\nmtllib x.mtl\n".as_slice());
        assert_eq!(lines_with(long, "mtllib").expect("reads"), b"mtllib x.mtl\n");
        let endless = b"mtllib a ".repeat(100).into_iter().chain([b'\n']).collect::<Vec<u8>>().repeat(40_000);
        assert!(lines_with(endless.as_slice(), "mtllib").is_err());
    }
}
