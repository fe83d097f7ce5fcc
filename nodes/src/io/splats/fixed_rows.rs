//! Binary PLY files with rows of fixed length: positions of the fields of each element.

use super::bytes::{f32_at, f64_at, u8_at, u16_at, u32_at};
use crate::error::Error;
use crate::io::ply::{self, Format, Scalar};

/// A field of a row.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Bytes from the start of the row.
    pub at: usize,
    /// How it is stored.
    pub scalar: Scalar,
}

impl Field {
    /// Its value in a row.
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

/// An element: rows that have the same fields.
#[derive(Debug)]
pub struct Element {
    /// Name in the file: `vertex`.
    pub name: String,
    /// Number of rows that the header promises.
    pub count: usize,
    /// Bytes of a row.
    pub stride: usize,
    /// Names and places of the fields, in order.
    pub fields: Vec<(String, Field)>,
    /// Where the rows begin in the file; `None` behind rows of varying length.
    start: Option<usize>,
    varies: bool,
}

impl Element {
    /// The field of a name.
    pub fn find(&self, name: &str) -> Option<Field> {
        self.fields.iter().find(|(known, _)| known == name).map(|(_, field)| *field)
    }

    /// The bytes of the rows, or an error with the number of rows that the file holds.
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

/// The elements of a PLY file with the positions of their rows.
#[derive(Debug)]
pub struct FixedRows {
    /// The elements, in order.
    pub elements: Vec<Element>,
    /// Where the last row ends; `None` behind rows of varying length.
    pub end: Option<usize>,
    format: Format,
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
                .map_err(|_| Error::format(file, format!("{} rows do not fit in memory", element.rows)))?;
            let name = element.name.clone();
            let mut placed = Element { name, count, stride: 0, fields: Vec::new(), start, varies: false };
            for property in &element.properties {
                if property.count.is_some() {
                    placed.varies = true;
                    continue;
                }
                if placed.find(&property.name).is_some() {
                    let what =
                        format!("the element `{}` has two properties `{}`", placed.name, property.name);
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
        Ok(Self { elements, end: start, format: header.format })
    }

    /// An error unless the rows are binary and little-endian, as all programs write splats.
    pub fn check_binary(&self, file: &str) -> Result<(), Error> {
        let format = match self.format {
            Format::Little => return Ok(()),
            Format::Ascii => "ascii",
            Format::Big => "binary_big_endian",
        };
        Err(Error::unsupported(file, format!("PLY format `{format}`; write it as binary_little_endian")))
    }

    /// The element of a name.
    pub fn find(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }
}
