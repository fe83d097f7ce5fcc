//! The expressions of a script for Nuke, evaluated on the layers of an OpenEXR file: a chain of one `Read` and of
//! `Expression` nodes, as in `graphs/composite.nk`.

use std::collections::BTreeMap;

use scene::io::exr::Planes;

/// The expressions of the nodes `Expression` of a script, in the order of the chain: those for red, green, blue, alpha.
pub struct Script(Vec<[String; 4]>);

impl Script {
    /// Reads the text of a script.
    pub fn new(text: &str) -> Self {
        let mut nodes = Vec::new();
        for line in text.lines() {
            if line == "Expression {" {
                nodes.push(["r", "g", "b", "a"].map(str::to_owned));
            }
            if let Some(rest) = line.strip_prefix(" expr") {
                let (index, expression) = rest.split_once(' ').unwrap();
                nodes.last_mut().unwrap()[index.parse::<usize>().unwrap()] =
                    expression.trim_matches('"').to_owned();
            }
        }
        assert!(!nodes.is_empty(), "the script has no expressions");
        Self(nodes)
    }

    /// A channel of the result for each pixel: 0 for red, 1 for green, 2 for blue.
    pub fn channel(&self, index: usize, layers: &Planes) -> Vec<f64> {
        let pixel = |at: usize| {
            let mut names: BTreeMap<String, f64> = layers
                .channels
                .iter()
                .map(|channel| (name(&channel.name), f64::from(channel.samples[at])))
                .collect();
            let mut rgba = [0.0; 4];
            for node in &self.0 {
                rgba = std::array::from_fn(|k| Parser::value(&node[k], &names));
                names.extend(["r", "g", "b", "a"].map(str::to_owned).into_iter().zip(rgba));
            }
            rgba[index]
        };
        (0..layers.width * layers.height).map(pixel).collect()
    }
}

/// The name that Nuke gives to a channel of an OpenEXR file.
fn name(channel: &str) -> String {
    let (layer, letter) = channel.split_once('.').unwrap_or(("", channel));
    let letter = match letter {
        "R" => "red",
        "G" => "green",
        "B" => "blue",
        "A" => "alpha",
        other => other,
    };
    match (layer, letter) {
        ("", letter) => letter.chars().take(1).collect(),
        (layer, letter) => format!("{layer}.{letter}"),
    }
}

/// A parser of sums, products, parentheses, `min` and `max`.
struct Parser<'a> {
    text: &'a [u8],
    at: usize,
    names: &'a BTreeMap<String, f64>,
}

impl<'a> Parser<'a> {
    fn value(text: &'a str, names: &'a BTreeMap<String, f64>) -> f64 {
        let mut parser = Self { text: text.as_bytes(), at: 0, names };
        let value = parser.sum();
        assert_eq!(parser.peek(), None, "`{text}` has a rest at {}", parser.at);
        value
    }

    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.at) == Some(&b' ') {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn expect(&mut self, wanted: u8) {
        assert_eq!(self.peek(), Some(wanted), "at {} of {}", self.at, String::from_utf8_lossy(self.text));
        self.at += 1;
    }

    fn sum(&mut self) -> f64 {
        let mut value = self.product();
        while let Some(sign @ (b'+' | b'-')) = self.peek() {
            self.at += 1;
            let next = self.product();
            value += if sign == b'+' { next } else { -next };
        }
        value
    }

    fn product(&mut self) -> f64 {
        let mut value = self.factor();
        while self.peek() == Some(b'*') {
            self.at += 1;
            value *= self.factor();
        }
        value
    }

    fn factor(&mut self) -> f64 {
        if self.peek() == Some(b'(') {
            self.at += 1;
            let value = self.sum();
            self.expect(b')');
            return value;
        }
        let rest = &self.text[self.at..];
        let length = rest.iter().take_while(|c| c.is_ascii_alphanumeric() || **c == b'.').count();
        let word = String::from_utf8_lossy(&rest[..length]).into_owned();
        self.at += length;
        match word.as_str() {
            "min" | "max" => {
                self.expect(b'(');
                let first = self.sum();
                self.expect(b',');
                let second = self.sum();
                self.expect(b')');
                if word == "min" { first.min(second) } else { first.max(second) }
            }
            word => match word.parse() {
                Ok(number) => number,
                // A layer that the file does not have counts as 0.
                Err(_) => self.names.get(word).copied().unwrap_or_else(|| {
                    let known = word.starts_with("added.") || word.starts_with("front.");
                    assert!(known, "the layers have no `{word}`");
                    0.0
                }),
            },
        }
    }
}
