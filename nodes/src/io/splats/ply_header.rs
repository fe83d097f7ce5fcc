//! Headers of PLY files: which elements there are and where their fields lie.

use super::bytes::{f32_at, f64_at, u8_at, u16_at, u32_at};
use crate::error::Error;

/// How a field is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    /// Signed integer of so many bytes.
    Signed(u8),
    /// Unsigned integer of so many bytes.
    Unsigned(u8),
    /// IEEE single.
    Single,
    /// IEEE double.
    Double,
}

impl Number {
    fn parse(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::Signed(1),
            "uchar" | "uint8" => Self::Unsigned(1),
            "short" | "int16" => Self::Signed(2),
            "ushort" | "uint16" => Self::Unsigned(2),
            "int" | "int32" => Self::Signed(4),
            "uint" | "uint32" => Self::Unsigned(4),
            "float" | "float32" => Self::Single,
            "double" | "float64" => Self::Double,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::Signed(size) | Self::Unsigned(size) => size.into(),
            Self::Single => 4,
            Self::Double => 8,
        }
    }

    /// True for single and double.
    pub fn is_real(self) -> bool {
        matches!(self, Self::Single | Self::Double)
    }
}

/// A field of a row.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Bytes from the start of the row.
    pub at: usize,
    /// How it is stored.
    pub number: Number,
}

impl Field {
    /// Its value in a row.
    #[inline]
    pub fn get(self, row: &[u8]) -> f64 {
        match self.number {
            Number::Single => f64::from(f32_at(row, self.at)),
            Number::Double => f64_at(row, self.at),
            Number::Unsigned(1) => f64::from(u8_at(row, self.at)),
            Number::Unsigned(2) => f64::from(u16_at(row, self.at)),
            Number::Unsigned(_) => f64::from(u32_at(row, self.at)),
            Number::Signed(1) => f64::from(u8_at(row, self.at) as i8),
            Number::Signed(2) => f64::from(u16_at(row, self.at) as i16),
            Number::Signed(_) => f64::from(u32_at(row, self.at) as i32),
        }
    }
}

/// Rows of one sort.
#[derive(Debug)]
pub struct Element {
    /// Its name: `vertex`.
    pub name: String,
    /// Rows that the header promises.
    pub count: usize,
    /// Bytes of a row.
    pub stride: usize,
    /// Names and places of its fields, in order.
    pub fields: Vec<(String, Field)>,
    /// Where its rows begin in the file; `None` behind rows of varying length.
    start: Option<usize>,
    varies: bool,
}

impl Element {
    /// The field of a name.
    pub fn find(&self, name: &str) -> Option<Field> {
        self.fields.iter().find(|(known, _)| known == name).map(|(_, field)| *field)
    }

    /// The rows, or an error with what the file holds of them.
    pub fn rows<'a>(&self, file: &str, bytes: &'a [u8]) -> Result<&'a [u8], Error> {
        let Some(start) = self.start.filter(|_| !self.varies) else {
            let feature = format!("a list property in or before the element `{}`", self.name);
            return Err(Error::unsupported(file, feature));
        };
        let end = self.count.checked_mul(self.stride).and_then(|n| n.checked_add(start));
        end.and_then(|end| bytes.get(start..end)).ok_or_else(|| {
            let (count, stride, total) = (self.count, self.stride, bytes.len());
            let held = total.saturating_sub(start) / stride.max(1);
            let what = format!(
                "the header promises {count} rows `{}` of {stride} bytes, the file holds {held} ({total} bytes)",
                self.name
            );
            Error::format(file, what)
        })
    }
}

/// What a PLY file holds.
#[derive(Debug)]
pub struct Header {
    /// Its elements, in order.
    pub elements: Vec<Element>,
    /// Where its last row ends, unless an element before that has rows of varying length.
    pub end: Option<usize>,
    /// How its rows are written, where it is another way than ours.
    foreign: Option<String>,
}

/// Bytes of a header beyond which a file is refused: 128 KiB hold thousands of fields.
const LONGEST_HEADER: usize = 128 * 1024;

impl Header {
    /// Reads the header. Rows are not looked at.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let wrong = |what: String| Error::format(file, what);
        let mut at = 0;
        let mut next_line = || -> Result<&str, Error> {
            let rest = bytes.get(at..bytes.len().min(LONGEST_HEADER)).unwrap_or_default();
            let end = rest.iter().position(|b| *b == b'\n');
            let end = end.ok_or_else(|| wrong("the PLY header has no `end_header`".to_owned()))?;
            at += end + 1;
            let line = std::str::from_utf8(&rest[..end]);
            Ok(line.map_err(|_| wrong("the PLY header is not text".to_owned()))?.trim_end_matches('\r'))
        };
        if next_line()?.trim() != "ply" {
            return Err(wrong("not a PLY file".to_owned()));
        }
        let (mut elements, mut foreign) = (Vec::<Element>::new(), None);
        loop {
            let line = next_line()?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["end_header"] => break,
                ["format", "binary_little_endian", _] | ["comment" | "obj_info", ..] | [] => {}
                ["format", other, ..] => foreign = Some(other.to_owned()),
                ["element", name, _] if elements.iter().any(|known| known.name == name) => {
                    return Err(wrong(format!("there are two elements `{name}`")));
                }
                ["element", name, count] => {
                    let count: u64 =
                        count.parse().map_err(|_| wrong(format!("`{line}` has no number of rows")))?;
                    let count = usize::try_from(count)
                        .map_err(|_| wrong(format!("{count} rows do not fit in memory")))?;
                    elements.push(Element {
                        name: name.to_owned(),
                        count,
                        stride: 0,
                        fields: Vec::new(),
                        start: None,
                        varies: false,
                    });
                }
                ["property", "list", ..] if !elements.is_empty() => {
                    elements.iter_mut().next_back().into_iter().for_each(|last| last.varies = true);
                }
                ["property", kind, name] => {
                    let Some(last) = elements.last_mut() else {
                        return Err(wrong(format!("`{line}` belongs to no element")));
                    };
                    let number = Number::parse(kind)
                        .ok_or_else(|| wrong(format!("property type `{kind}` is none")))?;
                    if last.find(name).is_some() {
                        return Err(wrong(format!(
                            "the element `{}` has two properties `{name}`",
                            last.name
                        )));
                    }
                    last.fields.push((name.to_owned(), Field { at: last.stride, number }));
                    last.stride += number.size();
                }
                _ => return Err(wrong(format!("PLY header line `{line}`"))),
            }
        }
        let mut start = Some(at);
        for element in &mut elements {
            element.start = start;
            let length = element.count.checked_mul(element.stride).filter(|_| !element.varies);
            start = start.and_then(|start| length.and_then(|length| start.checked_add(length)));
        }
        Ok(Self { elements, end: start, foreign })
    }

    /// An error where the rows are not binary and little-endian, as every program writes splats.
    pub fn check_binary(&self, file: &str) -> Result<(), Error> {
        let Some(format) = &self.foreign else { return Ok(()) };
        Err(Error::unsupported(file, format!("PLY format `{format}`; write it as binary_little_endian")))
    }

    /// The element of a name.
    pub fn find(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }
}
