//! Fields of a JSON file. Mistakes are collected, so that all of them are reported together.

use engine::nearest;
use serde_json::{Map, Value};

use crate::error::Mistakes;

/// Names of sets, cases, scenes and views: ASCII letters, digits, `-` and `_`; the first is a letter.
pub(crate) fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

const NAME: &str = "a name consists of ASCII letters, digits, `-` and `_`, and begins with a letter";

/// The fields of an object in a JSON file.
pub(crate) struct Fields<'m> {
    file: String,
    /// Name of the object within the file, with a dot, such as `pose.`; empty for the file.
    prefix: String,
    map: Map<String, Value>,
    known: Vec<&'static str>,
    mistakes: &'m mut Mistakes,
}

impl<'m> Fields<'m> {
    /// Reads a file; `None` if it is not a JSON object, which is reported. `file` is its path in reports.
    pub fn read(path: &std::path::Path, file: &str, mistakes: &'m mut Mistakes) -> Option<Self> {
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) => {
                mistakes.add(file, "", format!("cannot be read: {error}"));
                return None;
            }
        };
        match serde_json::from_slice(&bytes) {
            Ok(Value::Object(map)) => {
                Some(Self { file: file.to_owned(), prefix: String::new(), map, known: Vec::new(), mistakes })
            }
            Ok(_) => {
                mistakes.add(file, "", "is not a JSON object; it must begin with `{`");
                None
            }
            Err(error) => {
                mistakes.add(file, "", format!("is not JSON: {error}"));
                None
            }
        }
    }

    /// Reports a mistake in a field.
    pub fn wrong(&mut self, field: &str, text: impl Into<String>) {
        let field = format!("{}{field}", self.prefix);
        self.mistakes.add(&self.file, &field, text);
    }

    fn take(&mut self, field: &'static str) -> Option<Value> {
        self.known.push(field);
        self.map.get(field).cloned()
    }

    /// The value of a required field, converted by `read`. `what` is what the field takes, such as `a text`.
    pub fn required<T>(
        &mut self,
        field: &'static str,
        what: &str,
        read: impl FnOnce(&Value) -> Option<T>,
    ) -> Option<T> {
        match self.take(field) {
            None => {
                self.wrong(field, format!("is missing; write {what}"));
                None
            }
            Some(value) => {
                let found = read(&value);
                if found.is_none() {
                    self.wrong(field, format!("takes {what}, not {}", short(&value)));
                }
                found
            }
        }
    }

    /// The value of an optional field.
    pub fn optional<T>(
        &mut self,
        field: &'static str,
        what: &str,
        read: impl FnOnce(&Value) -> Option<T>,
    ) -> Option<T> {
        self.known.push(field);
        self.map.contains_key(field).then(|| self.required(field, what, read)).flatten()
    }

    /// A required text.
    pub fn text(&mut self, field: &'static str) -> Option<String> {
        self.required(field, "a text", |value| value.as_str().map(str::to_owned))
    }

    /// A required name.
    pub fn name(&mut self, field: &'static str) -> Option<String> {
        let text = self.text(field)?;
        if !is_name(&text) {
            self.wrong(field, format!("`{text}` is not a name; {NAME}"));
            return None;
        }
        Some(text)
    }

    /// A required list of names without repetitions and with at least one entry.
    pub fn names(&mut self, field: &'static str) -> Vec<String> {
        let list = self.required(field, "a list of names", texts).unwrap_or_default();
        if list.is_empty() && self.map.get(field).is_some_and(Value::is_array) {
            self.wrong(field, "is empty; give at least one name");
        }
        for (at, name) in list.iter().enumerate() {
            if !is_name(name) {
                self.wrong(field, format!("`{name}` is not a name; {NAME}"));
            }
            if list[..at].contains(name) {
                self.wrong(field, format!("`{name}` appears twice; remove one of them"));
            }
        }
        list
    }

    /// The version of the format, which must be 1.
    pub fn version(&mut self, field: &'static str) {
        let version = self.required(field, "the version of the format, 1", Value::as_u64);
        if let Some(version) = version.filter(|version| *version != 1) {
            self.wrong(
                field,
                format!("version {version} is not supported by this program, which reads version 1"),
            );
        }
    }

    /// The fields of an object in a required field.
    pub fn object(&mut self, field: &'static str) -> Option<Fields<'_>> {
        let map = self.required(field, "an object in { }", |value| value.as_object().cloned())?;
        let prefix = format!("{}{field}.", self.prefix);
        Some(Fields { file: self.file.clone(), prefix, map, known: Vec::new(), mistakes: self.mistakes })
    }

    /// Reports fields that were not read.
    pub fn end(mut self) {
        let unknown: Vec<String> =
            self.map.keys().filter(|name| !self.known.contains(&name.as_str())).cloned().collect();
        for name in unknown {
            let near = nearest(&name, self.known.iter().copied());
            let hint = near.map_or_else(
                || format!("the fields are {}", self.known.join(", ")),
                |near| format!("did you mean `{near}`?"),
            );
            self.wrong(&name, format!("is not a field of this file; {hint}"));
        }
    }
}

/// A list of texts.
pub(crate) fn texts(value: &Value) -> Option<Vec<String>> {
    value.as_array()?.iter().map(|entry| entry.as_str().map(str::to_owned)).collect()
}

/// Three finite numbers.
pub(crate) fn three(value: &Value) -> Option<[f64; 3]> {
    let list = value.as_array()?.iter().map(finite).collect::<Option<Vec<f64>>>()?;
    list.try_into().ok()
}

/// A finite number.
pub(crate) fn finite(value: &Value) -> Option<f64> {
    value.as_f64().filter(|number| number.is_finite())
}

/// A value in a message, shortened.
fn short(value: &Value) -> String {
    let text = value.to_string();
    let mut short: String = text.chars().take(40).collect();
    if short.len() < text.len() {
        short.push_str("..");
    }
    format!("`{short}`")
}
