//! Prose in the files of the project: comments and string literals of Rust, comments of graphs, pages of the docs.

/// The origin of a passage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A doc comment, `///` or `//!`.
    Doc,
    /// Any other comment, a string literal, or a page.
    Other,
}

/// A unit of prose: the lines of a comment, of a string literal, or of a page.
#[derive(Debug)]
pub struct Passage {
    /// The origin of the text.
    pub origin: Origin,
    /// Lines of text with their numbers in the file, from 1.
    pub lines: Vec<(usize, String)>,
}

/// A word or a mark of punctuation, in lower case, with its line.
pub type Token = (String, usize);

/// Comments and string literals of a Rust file. Consecutive lines of comments of one kind are one passage.
pub fn of_rust(source: &str) -> Vec<Passage> {
    let mut reader = Reader { chars: source.chars().collect(), at: 0, line: 1, passages: Vec::new() };
    reader.read();
    reader.passages
}

/// The comments of a graph file, as passages.
pub fn of_graph(source: &str) -> Vec<Passage> {
    let lines = source.lines().enumerate().filter_map(|(index, line)| {
        let outside = |at: &usize| line[..*at].matches('"').count() % 2 == 0;
        let comment = line.match_indices("//").map(|(at, _)| at).find(outside)?;
        Some((index + 1, line[comment + 2..].to_owned()))
    });
    vec![Passage { origin: Origin::Other, lines: lines.collect() }]
}

/// The prose of a page of the docs.
pub fn of_page(source: &str) -> Vec<Passage> {
    let lines = source.lines().enumerate().map(|(index, line)| (index + 1, line.to_owned()));
    vec![Passage { origin: Origin::Other, lines: lines.collect() }]
}

impl Passage {
    /// The words and punctuation of a passage. Code (fenced or between backticks), names in braces, and addresses
    /// of links are left out.
    pub fn tokens(&self) -> Vec<Token> {
        let mut tokens = Vec::new();
        let (mut fenced, mut quoted) = (false, false);
        for (line, text) in &self.lines {
            if text.trim_start().starts_with("```") {
                fenced = !fenced;
                continue;
            }
            if fenced {
                continue;
            }
            if text.trim().is_empty() {
                quoted = false;
                tokens.push((".".to_owned(), *line));
            }
            let mut word = String::new();
            let (mut address, mut held) = (false, false);
            let mut before = ' ';
            for c in text.chars().chain([' ']) {
                let letter = c.is_alphanumeric() || c == '_' || ("'-".contains(c) && !word.is_empty());
                if letter && !quoted && !address && !held {
                    word.extend(c.to_lowercase());
                    before = c;
                    continue;
                }
                if !word.is_empty() {
                    tokens.push((std::mem::take(&mut word), *line));
                }
                match c {
                    '`' => quoted = !quoted,
                    '(' if before == ']' => address = true,
                    ')' if address => address = false,
                    '{' => held = true,
                    '}' => held = false,
                    _ => {}
                }
                if "`,.;:!?()|{}".contains(c) && !address {
                    tokens.push((c.to_string(), *line));
                }
                before = c;
            }
        }
        tokens
    }
}

/// Reader of a Rust file that recognises comments and literals.
struct Reader {
    chars: Vec<char>,
    at: usize,
    line: usize,
    passages: Vec<Passage>,
}

impl Reader {
    fn peek(&self, ahead: usize) -> char {
        self.chars.get(self.at + ahead).copied().unwrap_or('\0')
    }

    fn next(&mut self) -> char {
        let c = self.peek(0);
        self.at += 1;
        self.line += usize::from(c == '\n');
        c
    }

    fn read(&mut self) {
        let mut before = ' ';
        while self.at < self.chars.len() {
            let word_before = before.is_alphanumeric() || before == '_';
            match (self.peek(0), self.peek(1)) {
                ('/', '/') => self.line_comment(),
                ('/', '*') => self.block_comment(),
                ('"', _) => self.string(),
                ('r', '"' | '#') if !word_before || before == 'b' => self.raw_string(),
                ('\'', '\\') => self.escaped_character(),
                ('\'', _) if self.peek(2) == '\'' => self.at += 2,
                _ => {}
            }
            before = self.next();
        }
    }

    /// Reads a line comment, up to but not including the end of the line.
    fn line_comment(&mut self) {
        let line = self.line;
        let mut text = String::new();
        while self.at < self.chars.len() && self.peek(0) != '\n' {
            text.push(self.next());
        }
        let marks = text.chars().take_while(|c| *c == '/').count();
        let doc = marks == 3 || text.starts_with("//!");
        let origin = if doc { Origin::Doc } else { Origin::Other };
        let text = text.trim_start_matches(['/', '!']).to_owned();
        match self.passages.last_mut() {
            Some(last)
                if last.origin == origin
                    && last.lines.last().is_some_and(|(number, _)| number + 1 == line) =>
            {
                last.lines.push((line, text));
            }
            _ => self.passages.push(Passage { origin, lines: vec![(line, text)] }),
        }
    }

    /// Reads a block comment, up to but not including its last character.
    fn block_comment(&mut self) {
        let mut lines = vec![(self.line, String::new())];
        while self.at < self.chars.len() && (self.peek(0), self.peek(1)) != ('*', '/') {
            match self.next() {
                '\n' => lines.push((self.line, String::new())),
                c => lines.last_mut().expect("never empty").1.push(c),
            }
        }
        self.at += 1;
        self.passages.push(Passage { origin: Origin::Other, lines });
    }

    /// Reads a string, up to but not including its closing quote.
    fn string(&mut self) {
        self.next();
        let mut lines = vec![(self.line, String::new())];
        while self.at < self.chars.len() && self.peek(0) != '"' {
            match self.next() {
                '\\' if self.peek(0) == '\n' => {
                    while self.peek(0).is_whitespace() {
                        self.next();
                    }
                    lines.push((self.line, String::new()));
                }
                '\\' => {
                    self.next();
                    lines.last_mut().expect("never empty").1.push(' ');
                }
                '\n' => lines.push((self.line, String::new())),
                c => lines.last_mut().expect("never empty").1.push(c),
            }
        }
        self.passages.push(Passage { origin: Origin::Other, lines });
    }

    /// Reads a raw string, up to but not including its last character.
    fn raw_string(&mut self) {
        let hashes = self.chars[self.at + 1..].iter().take_while(|c| **c == '#').count();
        if self.peek(1 + hashes) != '"' {
            return;
        }
        self.at += 2 + hashes;
        let end: String = format!("\"{}", "#".repeat(hashes));
        let closes = |reader: &Self| end.chars().enumerate().all(|(ahead, c)| reader.peek(ahead) == c);
        let mut lines = vec![(self.line, String::new())];
        while self.at < self.chars.len() && !closes(self) {
            match self.next() {
                '\n' => lines.push((self.line, String::new())),
                c => lines.last_mut().expect("never empty").1.push(c),
            }
        }
        self.at += hashes;
        self.passages.push(Passage { origin: Origin::Other, lines });
    }

    /// Reads an escaped character, such as `' '` or `'\''`, up to but not including its closing quote.
    fn escaped_character(&mut self) {
        self.at += 3;
        while self.at < self.chars.len() && self.peek(0) != '\'' {
            self.next();
        }
    }
}
