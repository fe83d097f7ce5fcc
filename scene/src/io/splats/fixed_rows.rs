//! PLY files with rows of fixed length, and the positions of the fields in the rows of each element. Files in ASCII,
//! big-endian files, and files with lists in or before the rows of splats are first converted.

use std::borrow::Cow;
use std::fmt::Write as _;

use engine::{Context, NodeError};

use super::bytes::{f32_at, f64_at, u8_at, u16_at, u32_at};
use crate::error::Error;
use crate::io::ply::{self, Format, Scalar};

/// A field of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Offset from the start of the row in bytes.
    pub at: usize,
    /// Type of the stored number.
    pub scalar: Scalar,
}

impl Field {
    /// Reads the value of the field in a row.
    #[inline]
    pub fn get(self, row: &[u8]) -> f64 {
        match self.scalar {
            Scalar::F32 => f64::from(f32_at(row, self.at)),
            Scalar::F64 => f64_at(row, self.at),
            Scalar::U8 => f64::from(u8_at(row, self.at)),
            Scalar::U16 => f64::from(u16_at(row, self.at)),
            Scalar::U32 => f64::from(u32_at(row, self.at)),
            Scalar::I8 => f64::from(u8_at(row, self.at) as i8),
            Scalar::I16 => f64::from(u16_at(row, self.at) as i16),
            Scalar::I32 => f64::from(u32_at(row, self.at) as i32),
        }
    }
}

/// An element of a PLY file: rows that have the same fields.
#[derive(Debug)]
pub struct Element {
    /// Name in the file: `vertex`.
    pub name: String,
    /// Number of rows according to the header.
    pub count: usize,
    /// Length of a row in bytes.
    pub stride: usize,
    /// Names and positions of the fields, in order.
    pub fields: Vec<(String, Field)>,
    /// Start of the rows in the file; `None` if an earlier element has rows of varying length.
    start: Option<usize>,
    varies: bool,
}

impl Element {
    /// The field with a name; `None` if it does not exist.
    pub fn find(&self, name: &str) -> Option<Field> {
        self.fields.iter().find(|(known, _)| known == name).map(|(_, field)| *field)
    }

    /// The bytes of the rows of this element. If the file is too short, the error states how many rows the file
    /// holds.
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
                "the header promises {count} rows of `{}` with {stride} bytes each, but the file holds only {held} (file size: {total} bytes)",
                self.name
            );
            Error::format(file, what)
        })
    }
}

/// The elements of a PLY file with the positions of their rows.
#[derive(Debug)]
pub struct FixedRows {
    /// The elements, in order.
    pub elements: Vec<Element>,
    /// End of the last row; `None` if an element has rows of varying length.
    pub end: Option<usize>,
    /// Text of each comment line of the header, with the leading keyword removed.
    pub comments: Vec<String>,
}

impl FixedRows {
    /// Reads the header; rows are not read.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let header = ply::header(file, bytes)?;
        let mut elements = Vec::<Element>::new();
        let mut start = Some(header.body);
        for element in &header.elements {
            if elements.iter().any(|known| known.name == element.name) {
                return Err(Error::format(file, format!("there are two elements `{}`", element.name)));
            }
            let count = usize::try_from(element.rows)
                .map_err(|_| Error::format(file, format!("{} rows do not fit into memory", element.rows)))?;
            let name = element.name.clone();
            let mut placed = Element { name, count, stride: 0, fields: Vec::new(), start, varies: false };
            for property in &element.properties {
                if property.count.is_some() {
                    placed.varies = true;
                    continue;
                }
                if placed.find(&property.name).is_some() {
                    let what =
                        format!("the element `{}` has two properties named `{}`", placed.name, property.name);
                    return Err(Error::format(file, what));
                }
                let field = Field { at: placed.stride, scalar: property.scalar };
                placed.fields.push((property.name.clone(), field));
                placed.stride += property.scalar.size();
            }
            let length = placed.count.checked_mul(placed.stride).filter(|_| !placed.varies);
            start = start.and_then(|start| length.and_then(|length| start.checked_add(length)));
            elements.push(placed);
        }
        Ok(Self { elements, end: start, comments: header.comments })
    }

    /// The element with a name; `None` if it does not exist.
    pub fn find(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }
}

/// Number of rows between two checks for cancellation.
const CHECK_ROWS: usize = 65_536;

/// Elements whose rows are splats, or belong to them.
const USED: [&str; 3] = ["chunk", "vertex", "sh"];

/// True if an element of splats has lists or follows an element with lists, so that the positions of its rows are
/// not known from the header.
fn has_lists_before_splats(header: &ply::Header) -> bool {
    let last = header.elements.iter().rposition(|element| USED.contains(&element.name.as_str()));
    let upto = header.elements.iter().take(last.map_or(0, |last| last + 1));
    upto.flat_map(|element| &element.properties).any(|property| property.count.is_some())
}

/// True if [`little_endian`] makes a converted copy of the file.
pub fn is_converted(header: &ply::Header) -> bool {
    header.format != Format::Little || has_lists_before_splats(header)
}

/// The file as binary little-endian with rows of fixed length. A file in another encoding, or with lists in or before
/// the rows of splats, is converted: list properties are dropped, and all other properties keep their types.
pub fn little_endian<'a>(file: &str, bytes: &'a [u8], cx: &Context) -> Result<Cow<'a, [u8]>, NodeError> {
    let header = ply::header(file, bytes)?;
    if !is_converted(&header) {
        return Ok(Cow::Borrowed(bytes));
    }
    let mut text = "ply\nformat binary_little_endian 1.0\n".to_owned();
    for comment in &header.comments {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "comment {comment}");
    }
    for element in &header.elements {
        let _ = writeln!(text, "element {} {}", element.name, element.rows);
        for property in element.properties.iter().filter(|property| property.count.is_none()) {
            let _ = writeln!(text, "property {} {}", property.scalar.name(), property.name);
        }
    }
    text.push_str("end_header\n");
    let mut out = text.into_bytes();
    let mut rows = ply::Rows::new(file, &header, bytes);
    for element in &header.elements {
        let count = rows.believable(element)?;
        let kept: Vec<Option<Scalar>> =
            element.properties.iter().map(|p| p.count.is_none().then_some(p.scalar)).collect();
        let stride: usize = kept.iter().flatten().map(|scalar| scalar.size()).sum();
        out.reserve(count.saturating_mul(stride));
        for row in 0..count {
            if row % CHECK_ROWS == 0 {
                cx.check()?;
            }
            rows.row(element, |index, numbers| {
                if let (Some(Some(scalar)), [number]) = (kept.get(index), numbers) {
                    scalar.put(*number, &mut out);
                }
            })?;
        }
    }
    let rest = rows.rest();
    out.extend_from_slice(if header.format == Format::Ascii { rest.trim_ascii() } else { rest });
    Ok(Cow::Owned(out))
}
