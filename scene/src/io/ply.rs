//! PLY files: the header, then rows of scalars and lists, ASCII or binary in either byte order. No crate is used,
//! since crates for PLY allocate memory by the counts in the header, which are arbitrary in a hostile file.

use std::borrow::Cow;

use super::foreign::{BYTE_ORDER_MARK, refuse_foreign};
use crate::error::Error;

/// Encoding of the numbers of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// ASCII: words separated by white space.
    Ascii,
    /// Binary, least significant byte first.
    Little,
    /// Binary, most significant byte first.
    Big,
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names state the type and the number of bits")]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Name of the type in a header.
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Appends a number of this type, least significant byte first.
    pub fn put(self, number: f64, out: &mut Vec<u8>) {
        match self {
            Self::I8 => out.extend_from_slice(&(number as i8).to_le_bytes()),
            Self::U8 => out.push(number as u8),
            Self::I16 => out.extend_from_slice(&(number as i16).to_le_bytes()),
            Self::U16 => out.extend_from_slice(&(number as u16).to_le_bytes()),
            Self::I32 => out.extend_from_slice(&(number as i32).to_le_bytes()),
            Self::U32 => out.extend_from_slice(&(number as u32).to_le_bytes()),
            Self::F32 => out.extend_from_slice(&(number as f32).to_le_bytes()),
            Self::F64 => out.extend_from_slice(&number.to_le_bytes()),
        }
    }

    /// Size of a number in a binary file, in bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Smallest and largest value of an integer type; `None` for floats.
    pub fn whole_range(self) -> Option<(f64, f64)> {
        Some(match self {
            Self::I8 => (-128.0, 127.0),
            Self::U8 => (0.0, 255.0),
            Self::I16 => (-32768.0, 32767.0),
            Self::U16 => (0.0, 65535.0),
            Self::I32 => (-2_147_483_648.0, 2_147_483_647.0),
            Self::U32 => (0.0, 4_294_967_295.0),
            Self::F32 | Self::F64 => return None,
        })
    }
}

/// A property of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Property {
    /// Name in the file.
    pub name: String,
    /// Type of its numbers.
    pub scalar: Scalar,
    /// Type of the count before the numbers of a list; `None` for a single number.
    pub count: Option<Scalar>,
}

/// A table of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Element {
    /// Name in the file: `vertex`, `face`.
    pub name: String,
    /// Number of rows according to the header.
    pub rows: u64,
    /// Properties, one per column of the table.
    pub properties: Vec<Property>,
}

impl Element {
    /// Index of the property with this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }

    /// Minimum number of bytes that a row can have in this format.
    fn least_bytes(&self, format: Format) -> u64 {
        let bytes =
            |p: &Property| if format == Format::Ascii { 2 } else { p.count.unwrap_or(p.scalar).size() };
        self.properties.iter().map(|p| bytes(p) as u64).sum()
    }
}

/// Header of a PLY file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Encoding of the body.
    pub format: Format,
    /// Elements in the order of the body.
    pub elements: Vec<Element>,
    /// Text of each comment line of the header, with the leading keyword removed.
    pub comments: Vec<String>,
    /// Offset of the body from the start of the file, in bytes.
    pub body: usize,
}

/// Maximum length of a header, in bytes.
const HEADER_LIMIT: usize = 1 << 20;

/// Last byte of each line of a header, from its first line. Lines end with a line feed, with a carriage return and
/// a line feed, or, as programs of old Macintosh computers write them, with a carriage return only. `None` if the
/// first line has no end.
fn line_end(bytes: &[u8]) -> Option<u8> {
    let first = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r'))?;
    // Text that was converted twice has several carriage returns before a line feed.
    let after = bytes[first..].iter().find(|byte| **byte != b'\r');
    let alone = bytes[first] == b'\r' && after != Some(&b'\n');
    Some(if alone { b'\r' } else { b'\n' })
}

/// The text of a line of a header. Programs write comments and names in UTF-8, or in an encoding of 8 bits, which
/// is read as Latin-1.
fn line_text(line: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(line) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(line.iter().map(|byte| char::from(*byte)).collect()),
    }
}

/// Reads the header. `file` names the file in errors.
pub fn header(file: &str, bytes: &[u8]) -> Result<Header, Error> {
    let bad = |what: String| Error::format(file, what);
    let mark = if bytes.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 };
    let first = bytes.get(mark..).unwrap_or_default();
    refuse_foreign(file, bytes)?;
    let line_end = line_end(first).filter(|line_end| {
        first.split(|byte| byte == line_end).next().is_some_and(|first| first.trim_ascii_end() == b"ply")
    });
    let Some(line_end) = line_end else {
        return Err(bad("not a PLY file: it does not start with the line `ply`".to_owned()));
    };
    let (mut format, mut elements, mut comments) = (None, Vec::<Element>::new(), Vec::new());
    let mut at = mark;
    for number in 1.. {
        let rest = bytes.get(at..).unwrap_or_default();
        let end = rest.iter().take(HEADER_LIMIT).position(|&b| b == line_end);
        let Some(end) = end else {
            return Err(bad(format!("the header ends in line {number} without `end_header`")));
        };
        at += end + 1;
        let line = line_text(&rest[..end]);
        let line = line.trim_end();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let odd = || bad(format!("line {number} of the header, `{line}`, is not understood"));
        let named = |word: &str| {
            Scalar::named(word).ok_or_else(|| bad(format!("`{word}` is not a property type of PLY")))
        };
        match words.as_slice() {
            ["ply"] if number == 1 => {}
            [] => {}
            ["comment" | "obj_info", ..] => {
                comments.push(line.split_once(char::is_whitespace).map_or("", |(_, text)| text).to_owned());
            }
            ["format", kind, _version] => {
                format = Some(match *kind {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::Little,
                    "binary_big_endian" => Format::Big,
                    _ => return Err(odd()),
                });
            }
            ["element", name, rows] => {
                let rows = rows.parse().map_err(|_| odd())?;
                elements.push(Element { name: (*name).to_owned(), rows, properties: Vec::new() });
            }
            ["property", "list", count, item, name] => {
                let count = Scalar::named(count).filter(|c| c.whole_range().is_some()).ok_or_else(odd)?;
                let scalar = named(item)?;
                let property = Property { name: (*name).to_owned(), scalar, count: Some(count) };
                elements.last_mut().ok_or_else(odd)?.properties.push(property);
            }
            ["property", scalar, name] => {
                let scalar = named(scalar)?;
                let property = Property { name: (*name).to_owned(), scalar, count: None };
                elements.last_mut().ok_or_else(odd)?.properties.push(property);
            }
            ["end_header"] => break,
            _ => return Err(odd()),
        }
        if at > HEADER_LIMIT {
            return Err(bad(format!("no `end_header` in the first {HEADER_LIMIT} bytes")));
        }
    }
    let format = format.ok_or_else(|| bad("the header has no `format` line".to_owned()))?;
    Ok(Header { format, elements, comments, body: at })
}

/// Parses NaN and infinities as C libraries print them: `-nan(ind)`, `1.#INF`, `-1.#IND`.
fn odd_float(text: &str) -> Option<f64> {
    let lower = text.to_ascii_lowercase();
    let size = lower.trim_start_matches(['+', '-']);
    if size == "1.#inf" || size.starts_with("1.#inf0") {
        return Some(if lower.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY });
    }
    (size.starts_with("nan(") || size.starts_with("1.#ind") || size.starts_with("1.#qnan"))
        .then_some(f64::NAN)
}

/// Reads the body of a PLY file row by row.
pub struct Rows<'a> {
    file: &'a str,
    format: Format,
    rest: &'a [u8],
    length: usize,
    list: Vec<f64>,
}

impl<'a> Rows<'a> {
    /// A reader at the start of the body.
    pub fn new(file: &'a str, header: &Header, bytes: &'a [u8]) -> Self {
        let rest = bytes.get(header.body..).unwrap_or_default();
        Self { file, format: header.format, rest, length: bytes.len(), list: Vec::new() }
    }

    /// The bytes of the file after the rows that have been read.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The number of rows of an element. It is an error if the rest of the file cannot hold them. Call this before
    /// allocating memory for them.
    pub fn believable(&self, element: &Element) -> Result<usize, Error> {
        // The last word of an ASCII file may lack its separator.
        let left = self.rest.len() as u64 + u64::from(self.format == Format::Ascii);
        match element.rows.checked_mul(element.least_bytes(self.format)) {
            Some(needed) if needed <= left => Ok(element.rows as usize),
            _ => Err(Error::format(
                self.file,
                format!(
                    "the header claims {} rows of `{}`, but only {} bytes follow",
                    element.rows,
                    element.name,
                    self.rest.len()
                ),
            )),
        }
    }

    /// Reads one row. `visit` is called for each property with its index in the element and its numbers: one
    /// number, or all numbers of a list.
    pub fn row(&mut self, element: &Element, mut visit: impl FnMut(usize, &[f64])) -> Result<(), Error> {
        for (index, property) in element.properties.iter().enumerate() {
            match property.count {
                None => visit(index, &[self.number(property.scalar)?]),
                Some(count) => {
                    let count = self.number(count)?;
                    let least = if self.format == Format::Ascii { 2 } else { property.scalar.size() };
                    if count < 0.0 || count * least as f64 > self.rest.len() as f64 + 1.0 {
                        return Err(self.fail(&format!("a list has the impossible length {count}")));
                    }
                    let mut list = std::mem::take(&mut self.list);
                    list.clear();
                    for _ in 0..count as usize {
                        list.push(self.number(property.scalar)?);
                    }
                    visit(index, &list);
                    self.list = list;
                }
            }
        }
        Ok(())
    }

    fn fail(&self, what: &str) -> Error {
        Error::format(self.file, format!("{what} at byte {}", self.length - self.rest.len()))
    }

    fn number(&mut self, scalar: Scalar) -> Result<f64, Error> {
        if self.format == Format::Ascii { self.word(scalar) } else { self.packed(scalar) }
    }

    fn word(&mut self, scalar: Scalar) -> Result<f64, Error> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(self.rest.len());
        let rest = &self.rest[start..];
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let text = std::str::from_utf8(&rest[..end]).unwrap_or_default();
        // A word of a float is rounded once, directly to its type.
        let value = match scalar {
            Scalar::F32 => text.parse::<f32>().map(f64::from).ok(),
            _ => text.parse::<f64>().ok(),
        };
        let value = value.or_else(|| odd_float(text).filter(|_| scalar.whole_range().is_none()));
        let whole =
            |v: f64| scalar.whole_range().is_none_or(|(low, high)| low <= v && v <= high && v.trunc() == v);
        match value {
            Some(value) if whole(value) => {
                self.rest = &rest[end..];
                Ok(value)
            }
            _ if text.is_empty() => Err(self.fail("the file ends early,")),
            _ => Err(self.fail(&format!("`{text}` is not a number of the type `{}`,", scalar.name()))),
        }
    }

    fn packed(&mut self, scalar: Scalar) -> Result<f64, Error> {
        let Some((raw, rest)) = self.rest.split_at_checked(scalar.size()) else {
            return Err(self.fail("the file ends early,"));
        };
        self.rest = rest;
        let mut word = [0_u8; 8];
        let word = &mut word[..raw.len()];
        word.copy_from_slice(raw);
        if self.format == Format::Big {
            word.reverse();
        }
        Ok(match (scalar, &*word) {
            (Scalar::I8, &[a]) => f64::from(a as i8),
            (Scalar::U8, &[a]) => f64::from(a),
            (Scalar::I16, &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
            (Scalar::U16, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (Scalar::I32, &[a, b, c, d]) => f64::from(i32::from_le_bytes([a, b, c, d])),
            (Scalar::U32, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (Scalar::F32, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (_, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => return Err(self.fail("a number has the wrong size,")),
        })
    }
}
