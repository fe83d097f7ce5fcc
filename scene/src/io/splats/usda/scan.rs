//! Tokens of USD in text: white space and comments, strings, asset paths, groups in brackets, and lists of numbers.

use std::str::FromStr;

use crate::error::Error;

/// Reader of tokens.
pub(super) struct Scan<'a> {
    /// Name of the file, for errors.
    pub(super) file: &'a str,
    text: &'a str,
    at: usize,
}

/// Characters that end a word.
const PUNCTUATION: &str = "=(){}\"'@<>#/;,";

impl<'a> Scan<'a> {
    /// A reader that begins after the first line of `text`, which holds the version.
    pub(super) fn after_first_line(file: &'a str, text: &'a str) -> Self {
        Self { file, text, at: text.find('\n').unwrap_or(text.len()) }
    }

    /// An error at the current line.
    pub(super) fn bad(&self, what: &str) -> Error {
        let line = self.text.as_bytes().iter().take(self.at).filter(|b| **b == b'\n').count() + 1;
        Error::format(self.file, format!("{what} in line {line}"))
    }

    /// The text that has not been read yet.
    pub(super) fn rest(&self) -> &'a str {
        self.text.get(self.at..).unwrap_or_default()
    }

    /// Skips white space, separators and comments, which are `# ..`, `// ..` and `/* .. */`.
    pub(super) fn blanks(&mut self) -> Result<(), Error> {
        loop {
            let rest = self.rest();
            let trimmed = rest.trim_start_matches(|c: char| c.is_whitespace() || c == ';');
            self.at += rest.len() - trimmed.len();
            if trimmed.starts_with('#') || trimmed.starts_with("//") {
                self.at += trimmed.find('\n').unwrap_or(trimmed.len());
            } else if trimmed.starts_with("/*") {
                let end = trimmed.find("*/").ok_or_else(|| self.bad("a comment is not closed"))?;
                self.at += end + 2;
            } else {
                return Ok(());
            }
        }
    }

    /// Skips spaces and tabs, but not the end of the line.
    pub(super) fn spaces(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start_matches([' ', '\t']).len();
    }

    /// Reads `text` if it follows.
    pub(super) fn take(&mut self, text: &str) -> bool {
        let found = self.rest().starts_with(text);
        self.at += if found { text.len() } else { 0 };
        found
    }

    /// True if one of `characters` follows.
    pub(super) fn next_is<const N: usize>(&self, characters: [char; N]) -> bool {
        self.rest().starts_with(characters)
    }

    /// Reads a word, up to white space or punctuation. Words include the brackets of types (`float3[]`).
    pub(super) fn word(&mut self) -> &'a str {
        let rest = self.rest();
        let end = rest.find(|c: char| c.is_whitespace() || PUNCTUATION.contains(c)).unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }

    /// Reads the text between two occurrences of `fence`. The first has been read already. If `escapes` is true, a
    /// backslash hides the next character.
    fn until(&mut self, fence: &str, escapes: bool, what: &str) -> Result<&'a str, Error> {
        let rest = self.rest();
        let mut from = 0;
        loop {
            let left = rest.get(from..).unwrap_or_default();
            let end = left.find(fence).ok_or_else(|| self.bad(what))?;
            match left.find('\\').filter(|slash| escapes && *slash < end) {
                Some(slash) => {
                    let hidden = left[slash + 1..].chars().next().map_or(0, char::len_utf8);
                    from += slash + 1 + hidden;
                }
                None => {
                    self.at += from + end + fence.len();
                    return Ok(&rest[..from + end]);
                }
            }
        }
    }

    /// Reads a string: the text between single or double quotes, or three of them.
    pub(super) fn quoted(&mut self) -> Result<&'a str, Error> {
        for fence in ["\"\"\"", "'''", "\"", "'"] {
            if self.take(fence) {
                return self.until(fence, true, "a string is not closed");
            }
        }
        Err(self.bad("quotes are missing around a name"))
    }

    /// Skips a value: a string, an asset with the path of a prim, a group in brackets, or a word. Returns its text.
    pub(super) fn value(&mut self) -> Result<&'a str, Error> {
        let start = self.at;
        if self.next_is(['"', '\'']) {
            self.quoted()?;
        } else if self.next_is(['@', '<']) {
            self.asset()?;
        } else if self.next_is(['(', '[', '{']) {
            self.balanced()?;
        } else {
            self.word();
        }
        Ok(&self.text[start..self.at])
    }

    /// Skips an asset `@..@`, the path of a prim `<..>`, or both.
    fn asset(&mut self) -> Result<(), Error> {
        const WHAT: &str = "the path of an asset is not closed";
        for fence in ["@@@", "@"] {
            if self.take(fence) {
                self.until(fence, false, WHAT)?;
                break;
            }
        }
        if self.take("<") {
            self.until(">", false, "the path of a prim is not closed")?;
        }
        Ok(())
    }

    /// Skips a group in brackets, with the strings, assets and comments in it. The current position is the first
    /// bracket.
    pub(super) fn balanced(&mut self) -> Result<&'a str, Error> {
        let (start, mut depth) = (self.at, 0_usize);
        loop {
            let rest = self.rest();
            let found = rest.find(|c: char| "()[]{}\"'#/@<".contains(c));
            self.at += found.ok_or_else(|| self.bad("a bracket is not closed"))?;
            match self.text.as_bytes().get(self.at) {
                Some(b'"' | b'\'') => {
                    self.quoted()?;
                    continue;
                }
                Some(b'@' | b'<') => {
                    self.asset()?;
                    continue;
                }
                Some(b'#' | b'/') => {
                    let before = self.at;
                    self.blanks()?;
                    self.at += usize::from(self.at == before);
                    continue;
                }
                Some(b'(' | b'[' | b'{') => depth += 1,
                _ => depth = depth.saturating_sub(1),
            }
            self.at += 1;
            if depth == 0 {
                return Ok(&self.text[start..self.at]);
            }
        }
    }

    /// Reads the strings in a list, such as `["a", "b"]`. Empty if the value is not a list.
    pub(super) fn strings(&mut self) -> Result<Vec<String>, Error> {
        if !self.next_is(['[']) {
            self.value()?;
            return Ok(Vec::new());
        }
        self.at += 1;
        let mut strings = Vec::new();
        loop {
            self.blanks()?;
            if self.take("]") {
                return Ok(strings);
            }
            if !self.take(",") {
                strings.push(self.quoted()?.to_owned());
            }
        }
    }

    /// Reads the numbers in brackets, or a single number. `None` for the value `None`, which USD treats like a
    /// missing value.
    pub(super) fn numbers<T: FromStr>(&mut self) -> Result<Option<Vec<T>>, Error> {
        let mut numbers = Vec::new();
        let mut depth = 0_usize;
        loop {
            self.blanks()?;
            let rest = self.rest();
            match rest.as_bytes().first() {
                None => return Err(self.bad("a bracket is not closed")),
                Some(b'[' | b'(') => (depth, self.at) = (depth + 1, self.at + 1),
                Some(b']' | b')') if depth > 0 => (depth, self.at) = (depth - 1, self.at + 1),
                Some(b',') if depth > 0 => self.at += 1,
                Some(_) => {
                    let end = rest.find(|c: char| c.is_whitespace() || "()[]{},;#/".contains(c));
                    let word = &rest[..end.unwrap_or(rest.len())];
                    if word == "None" && depth == 0 {
                        self.at += word.len();
                        return Ok(None);
                    }
                    let number = word.parse();
                    numbers.push(number.map_err(|_| self.bad(&format!("`{word}` is not a number")))?);
                    self.at += word.len();
                }
            }
            if depth == 0 {
                return Ok(Some(numbers));
            }
        }
    }

    /// Reads the settings in parentheses if they follow: each has its words before `=`, and the text of its value.
    pub(super) fn settings(&mut self) -> Result<Vec<Setting<'a>>, Error> {
        let mut settings = Vec::new();
        if !self.take("(") {
            return Ok(settings);
        }
        loop {
            self.blanks()?;
            if self.take(")") {
                return Ok(settings);
            }
            if self.next_is(['"', '\'']) {
                self.quoted()?;
                continue;
            }
            let mut words = Vec::new();
            loop {
                self.blanks()?;
                if self.take("=") {
                    break;
                }
                let word = self.word();
                if word.is_empty() {
                    return Err(self.bad("a setting has no value"));
                }
                words.push(word);
            }
            self.blanks()?;
            let value = self.value()?;
            if value.is_empty() {
                return Err(self.bad("a setting has no value"));
            }
            settings.push(Setting { words, value });
            self.blanks()?;
            // The offset in time of a reference.
            if self.next_is(['(']) {
                self.balanced()?;
            }
        }
    }
}

/// A setting of a file or of a prim.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Setting<'a> {
    /// The words before `=`: the name, after a type or a word such as `prepend`.
    pub(super) words: Vec<&'a str>,
    /// The text of the value, with its quotes.
    pub(super) value: &'a str,
}

impl<'a> Setting<'a> {
    /// The name.
    pub(super) fn name(&self) -> &'a str {
        self.words.last().copied().unwrap_or_default()
    }

    /// The value without quotes.
    pub(super) fn plain(&self) -> &'a str {
        self.value.trim_matches(['"', '\''])
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn scan(text: &str) -> Scan<'_> {
        Scan { file: "a.usda", text, at: 0 }
    }

    #[test]
    fn comments_of_all_kinds_are_skipped() {
        let mut text = scan("# a {\n // b }\n /* c\n { */ ; word");
        text.blanks().unwrap();
        assert_eq!(text.word(), "word");
        assert!(scan("/* open").blanks().is_err());
    }

    #[test]
    fn strings_have_four_kinds_of_quotes_and_escapes() {
        for (text, wanted) in [
            (r#""a b" x"#, "a b"),
            ("'a \" b' x", "a \" b"),
            (r#""a \" { b" x"#, r#"a \" { b"#),
            (r#""ends \\" x"#, r"ends \\"),
            ("\"\"\"two\n\"lines\" \"\"\" x", "two\n\"lines\" "),
            ("'''a 'b' ''' x", "a 'b' "),
            ("\"\" x", ""),
        ] {
            let mut scan = scan(text);
            assert_eq!(scan.quoted().unwrap(), wanted);
            assert_eq!(scan.rest(), " x");
        }
        for text in ["\"open", "'open\"", "\"open\\", "name"] {
            assert!(scan(text).quoted().is_err(), "{text}");
        }
    }

    #[test]
    fn values_end_where_they_end() {
        for value in [
            "\"a } b\"",
            "'single { quoted'",
            "@foo [bar].png@",
            "@@@a@b(.usd@@@",
            "@./ok.usda@</S>",
            "</World/Mat>",
            "[</a>, @b]@, \"]\", (1, 2) // ]\n]",
            "{ string x = '}' /* } */ }",
            "None",
            "-1.5e3",
        ] {
            let text = format!("{value} rest");
            assert_eq!(scan(&text).value().unwrap(), value);
        }
    }

    #[test]
    fn numbers_are_read_from_lists_with_comments() {
        let read = |text: &str| scan(text).numbers::<f64>().unwrap();
        assert_eq!(read("[(1, 2), # three\n (3.5, -4) // )\n, ]"), Some(vec![1.0, 2.0, 3.5, -4.0]));
        assert_eq!(read("7\n8"), Some(vec![7.0]));
        assert_eq!(read("[]"), Some(vec![]));
        assert_eq!(read("None\n"), None);
        for text in ["[1, x]", "[1", "", ")", "[None]"] {
            assert!(scan(text).numbers::<f64>().is_err(), "{text}");
        }
    }

    #[test]
    fn settings_are_read_outside_of_strings_only() {
        let text = "(\n \"a note\"\n doc = \"\"\"\n upAxis = \"Y\"\n\"\"\"\n metersPerUnit = 1 # metre\n\
            upAxis = 'Z'; prepend references = @./a.usda@</S> (offset = 2)\n customData = { int upAxis = 3 }\n) rest";
        let mut reader = scan(text);
        let found = reader.settings().unwrap();
        let found: Vec<_> = found.iter().map(|one| (one.words.join(" "), one.plain())).collect();
        let wanted = [
            ("doc", "\n upAxis = \"Y\"\n"),
            ("metersPerUnit", "1"),
            ("upAxis", "Z"),
            ("prepend references", "@./a.usda@</S>"),
            ("customData", "{ int upAxis = 3 }"),
        ];
        assert_eq!(found, wanted.map(|(words, value)| (words.to_owned(), value)));
        assert_eq!(reader.rest(), " rest");
        assert_eq!(scan("{").settings().unwrap(), []);
        assert!(scan("(a = )").settings().is_err());
        assert!(scan("(a").settings().is_err());
    }

    #[test]
    fn strings_of_a_list() {
        assert_eq!(scan("[\"a\", 'b' /* c */,]").strings().unwrap(), ["a", "b"]);
        assert!(scan("None").strings().unwrap().is_empty());
    }
}
