//! Accessors of glTF (glTF 2.0, section 3.6.2): typed columns in a buffer.

use serde::Deserialize;

use super::bytes::{f32_at, u8_at, u16_at, u32_at};
use crate::error::Error;

/// An accessor as stored in the file.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    count: usize,
    #[serde(rename = "type")]
    shape: String,
    sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Clone, Copy)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

/// Reads the rows of a column. [`Accessor::reader`] has checked that all of them lie within `bytes`.
pub struct Reader<'a> {
    bytes: &'a [u8],
    count: usize,
    stride: usize,
    width: usize,
    component: Component,
    size: usize,
    normalized: bool,
}

impl Accessor {
    /// Index of the buffer view that the accessor reads.
    pub fn view(&self, file: &str) -> Result<usize, Error> {
        if self.sparse.is_some() {
            return Err(Error::unsupported(file, "sparse accessors"));
        }
        self.buffer_view.ok_or_else(|| Error::unsupported(file, "accessors without a buffer view"))
    }

    /// A reader of the column in the bytes of its buffer view.
    pub fn reader<'a>(&self, file: &str, view: &'a [u8], stride: Option<usize>) -> Result<Reader<'a>, Error> {
        let (component, size) = match self.component_type {
            5120 => (Component::I8, 1),
            5121 => (Component::U8, 1),
            5122 => (Component::I16, 2),
            5123 => (Component::U16, 2),
            5125 => (Component::U32, 4),
            5126 => (Component::F32, 4),
            other => return Err(Error::format(file, format!("the component type {other} is unknown"))),
        };
        let width = match self.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => {
                return Err(Error::format(
                    file,
                    format!("the accessor type `{other}` is not a scalar or a vector"),
                ));
            }
        };
        let stride = stride.unwrap_or(width * size);
        let bytes = view.get(self.byte_offset..).unwrap_or_default();
        let needed = match self.count.checked_sub(1) {
            None => Some(0),
            Some(last) => last.checked_mul(stride).and_then(|n| n.checked_add(width * size)),
        };
        // Rows must not overlap, or a small file could claim many.
        if stride < width * size || needed.is_none_or(|needed| needed > bytes.len()) {
            let (count, held) = (self.count, bytes.len());
            let what = format!(
                "an accessor has {count} rows, {stride} bytes apart, which do not fit into {held} bytes"
            );
            return Err(Error::format(file, what));
        }
        Ok(Reader { bytes, count: self.count, stride, width, component, size, normalized: self.normalized })
    }
}

impl Reader<'_> {
    /// Number of rows.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Components per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Reads one component of a row. Normalised integers are mapped to 0 to 1 or -1 to 1.
    pub fn get(&self, row: usize, component: usize) -> f64 {
        let at = row * self.stride + component * self.size;
        let (value, largest) = match self.component {
            Component::I8 => (f64::from(u8_at(self.bytes, at) as i8), 127.0),
            Component::U8 => (f64::from(u8_at(self.bytes, at)), 255.0),
            Component::I16 => (f64::from(u16_at(self.bytes, at) as i16), 32_767.0),
            Component::U16 => (f64::from(u16_at(self.bytes, at)), 65_535.0),
            Component::U32 => (f64::from(u32_at(self.bytes, at)), 4_294_967_295.0),
            Component::F32 => return f64::from(f32_at(self.bytes, at)),
        };
        if self.normalized { (value / largest).max(-1.0) } else { value }
    }
}
