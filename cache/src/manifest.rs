//! [`Manifest`]: the fields of a key in readable form.

use std::collections::BTreeMap;
use std::fmt;

use crate::digest::Digest;

/// The version of the encoding. Changing it changes every key.
pub(crate) const FORMAT: &str = "lightharmony-key-1";

/// The type tags of the encoding that [`KeyWriter`](crate::KeyWriter) writes.
pub(crate) mod tag {
    pub const STR: u8 = b's';
    pub const U64: u8 = b'u';
    pub const I64: u8 = b'i';
    pub const F64: u8 = b'd';
    pub const F32: u8 = b'f';
    pub const BOOL: u8 = b'b';
    pub const BYTES: u8 = b'x';
    pub const DIGEST: u8 = b'h';
    pub const GROUP: u8 = b'(';
    pub const LIST: u8 = b'[';
    pub const END: u8 = b')';
}

/// Appends a length in LEB128: seven bits per byte, lowest first.
pub(crate) fn write_length(out: &mut Vec<u8>, length: usize) {
    let mut rest = length as u64;
    while rest >= 0x80 {
        out.push((rest & 0x7f) as u8 | 0x80);
        rest >>= 7;
    }
    out.push(rest as u8);
}

/// The fields of a key in the order written, stored in the encoding of [`KeyWriter`](crate::KeyWriter) and decoded
/// on demand. [`Display`](fmt::Display) prints one line `path = value` per field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    encoding: Vec<u8>,
}

/// A field of a [`Manifest`].
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// The path of the field: names joined by dots, and indices of list items in brackets, such as `[0]`.
    pub path: String,
    /// The value.
    pub value: Value,
}

/// The value of a field. Values are printed as in a graph file, and digests as their first 12 digits.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "each variant has the name of its type")]
pub enum Value {
    Str(String),
    U64(u64),
    I64(i64),
    F64(f64),
    F32(f32),
    Bool(bool),
    Bytes(Vec<u8>),
    Digest(Digest),
}

/// A difference between two manifests: a field that was changed, added (`old` is `None`) or removed (`new` is
/// `None`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The path of the field, in the format of [`Line::path`].
    pub path: String,
    /// The value in the old manifest.
    pub old: Option<String>,
    /// The value in the new manifest.
    pub new: Option<String>,
}

impl Manifest {
    /// Wraps an encoding as a manifest, without checking it.
    pub(crate) fn from_encoding(encoding: Vec<u8>) -> Manifest {
        Manifest { encoding }
    }

    /// Reads a manifest stored as [`as_bytes`](Self::as_bytes); `None` if these bytes are not a manifest.
    pub fn from_bytes(bytes: &[u8]) -> Option<Manifest> {
        let manifest = Manifest { encoding: bytes.to_vec() };
        manifest.decode(|_, _| true)?;
        Some(manifest)
    }

    /// The encoding. The digest of these bytes is the digest of the key.
    pub fn as_bytes(&self) -> &[u8] {
        &self.encoding
    }

    /// Returns the encoding. Its memory can be reused by
    /// [`KeyWriter::in_memory_of`](crate::KeyWriter::in_memory_of).
    pub fn into_bytes(self) -> Vec<u8> {
        self.encoding
    }

    /// The type of the key, as given to [`KeyWriter::new`](crate::KeyWriter::new).
    pub fn tag(&self) -> String {
        let mut reader = Reader { rest: &self.encoding };
        reader.text().and_then(|_| reader.text()).unwrap_or_default().to_owned()
    }

    /// Every field, in the order written.
    pub fn lines(&self) -> Vec<Line> {
        let mut lines = Vec::new();
        self.decode(|path, value| {
            lines.push(Line { path: path.to_owned(), value });
            true
        });
        lines
    }

    /// The differences between two manifests, in the field order of `new`, followed by the fields that only `old`
    /// has.
    pub fn difference(old: &Manifest, new: &Manifest) -> Vec<Change> {
        let mut changes = Vec::new();
        if old.tag() != new.tag() {
            changes.push(Change { path: "key".to_owned(), old: Some(old.tag()), new: Some(new.tag()) });
        }
        let (old, new) = (numbered(old.lines()), numbered(new.lines()));
        let old_values: BTreeMap<_, _> = old.iter().map(|(place, value)| (place, value)).collect();
        let new_values: BTreeMap<_, _> = new.iter().map(|(place, value)| (place, value)).collect();
        for (place, value) in &new {
            match old_values.get(place) {
                Some(before) if *before == value => {}
                before => changes.push(change(&place.0, before.copied(), Some(value))),
            }
        }
        for (place, value) in &old {
            if !new_values.contains_key(place) {
                changes.push(change(&place.0, Some(value), None));
            }
        }
        changes
    }

    /// The path of the first field whose value is NaN.
    pub(crate) fn first_nan(&self) -> Option<String> {
        let mut found = None;
        self.decode(|path, value| {
            let nan =
                matches!(value, Value::F64(v) if v.is_nan()) || matches!(value, Value::F32(v) if v.is_nan());
            if nan {
                found = Some(path.to_owned());
            }
            !nan
        });
        found
    }

    /// Calls `each` with every field until it returns false. Returns `None` if the encoding is damaged.
    fn decode(&self, mut each: impl FnMut(&str, Value) -> bool) -> Option<()> {
        let mut reader = Reader { rest: &self.encoding };
        if reader.text()? != FORMAT {
            return None;
        }
        reader.text()?;
        // One item per open group or list: the length of the path before it, and for a list its next index.
        let mut open: Vec<(usize, Option<usize>)> = Vec::new();
        let mut path = String::new();
        while let Some(tag) = reader.byte() {
            if tag == tag::END {
                let (outer, _) = open.pop()?;
                path.truncate(outer);
                continue;
            }
            let name = reader.text()?;
            let outer = path.len();
            match open.last_mut() {
                Some((_, Some(index))) => {
                    path.push_str(&format!("[{index}]"));
                    *index += 1;
                    if !name.is_empty() {
                        push_name(&mut path, name);
                    }
                }
                _ => push_name(&mut path, name),
            }
            let value = match tag {
                tag::GROUP => {
                    open.push((outer, None));
                    continue;
                }
                tag::LIST => {
                    open.push((outer, Some(0)));
                    continue;
                }
                tag => reader.value(tag)?,
            };
            if !each(&path, value) {
                return Some(());
            }
            path.truncate(outer);
        }
        open.is_empty().then_some(())
    }
}

impl fmt::Display for Manifest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "key {}", self.tag())?;
        self.lines().iter().try_for_each(|line| writeln!(f, "{} = {}", line.path, line.value))
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Str(text) => write!(f, "{text:?}"),
            Value::U64(number) => write!(f, "{number}"),
            Value::I64(number) => write!(f, "{number}"),
            Value::F64(number) => write!(f, "{number:?}"),
            Value::F32(number) => write!(f, "{number:?}"),
            Value::Bool(truth) => write!(f, "{truth}"),
            Value::Bytes(bytes) => write!(f, "{} bytes {}", bytes.len(), Digest::of(bytes).short()),
            Value::Digest(digest) => f.write_str(&digest.short()),
        }
    }
}

/// Appends a name to a path. The name is quoted if it contains characters that have a special meaning in paths.
fn push_name(path: &mut String, name: &str) {
    if !path.is_empty() {
        path.push('.');
    }
    if name.contains(|c: char| matches!(c, '.' | '[' | '"' | '=') || c.is_control()) {
        path.push_str(&format!("{name:?}"));
    } else {
        path.push_str(name);
    }
}

/// Pairs each line's path with a number that distinguishes lines with the same path.
fn numbered(lines: Vec<Line>) -> Vec<((String, usize), Value)> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let place = |line: Line| {
        let count = seen.entry(line.path.clone()).or_insert(0);
        *count += 1;
        ((line.path, *count), line.value)
    };
    lines.into_iter().map(place).collect()
}

fn change(path: &str, old: Option<&Value>, new: Option<&Value>) -> Change {
    Change { path: path.to_owned(), old: old.map(Value::to_string), new: new.map(Value::to_string) }
}

/// Reads fields from the front of an encoding. Every method returns `None` if the bytes are malformed.
struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(*first)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        Some(*first)
    }

    fn sized(&mut self) -> Option<&'a [u8]> {
        let mut length = 0_u64;
        for shift in (0..63).step_by(7) {
            let byte = self.byte()?;
            length |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                let (first, rest) = self.rest.split_at_checked(usize::try_from(length).ok()?)?;
                self.rest = rest;
                return Some(first);
            }
        }
        None
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.sized()?).ok()
    }

    fn value(&mut self, tag: u8) -> Option<Value> {
        Some(match tag {
            tag::STR => Value::Str(self.text()?.to_owned()),
            tag::U64 => Value::U64(u64::from_le_bytes(self.array()?)),
            tag::I64 => Value::I64(i64::from_le_bytes(self.array()?)),
            tag::F64 => Value::F64(f64::from_bits(u64::from_le_bytes(self.array()?))),
            tag::F32 => Value::F32(f32::from_bits(u32::from_le_bytes(self.array()?))),
            tag::BOOL => Value::Bool(self.byte()? != 0),
            tag::BYTES => Value::Bytes(self.sized()?.to_vec()),
            tag::DIGEST => Value::Digest(Digest::from_bytes(self.array()?)),
            _ => return None,
        })
    }
}
