//! Accessors: numbers of any type in the buffers, as f64.

use gltf::Accessor;
use gltf::accessor::{DataType, Dimensions};

use super::file::File;
use crate::error::Error;

/// The numbers of an accessor, converted to f64.
pub struct Numbers {
    /// Number of components per element.
    pub width: usize,
    /// All numbers in order. Integers are normalised if the accessor specifies it.
    pub values: Vec<f64>,
}

impl Numbers {
    /// The elements as arrays of `N` numbers; `None` unless `width` is `N`.
    pub fn arrays<const N: usize>(&self) -> Option<&[[f64; N]]> {
        if self.width == N { Some(self.values.as_chunks::<N>().0) } else { None }
    }
}

impl File {
    /// Reads the numbers of an accessor from `buffers`.
    pub fn numbers(&self, accessor: &Accessor<'_>, buffers: &[Vec<u8>]) -> Result<Numbers, Error> {
        let width = match accessor.dimensions() {
            Dimensions::Scalar => 1,
            Dimensions::Vec2 => 2,
            Dimensions::Vec3 => 3,
            Dimensions::Vec4 | Dimensions::Mat2 => 4,
            Dimensions::Mat3 => 9,
            Dimensions::Mat4 => 16,
        };
        let (count, data) = (accessor.count(), accessor.data_type());
        let outside = || self.bad(format!("accessor {} lies outside its buffer view", accessor.index()));
        let mut values;
        if let Some(view) = accessor.view() {
            let raw = self.view(&view, buffers)?;
            let size = data.size() * width;
            let stride = view.stride().unwrap_or(size);
            if stride < size {
                return Err(self.bad(format!("accessor {} has overlapping elements", accessor.index())));
            }
            let end = count
                .saturating_sub(1)
                .checked_mul(stride)
                .and_then(|n| n.checked_add(size + accessor.offset()));
            if count > 0 && end.is_none_or(|end| end > raw.len()) {
                return Err(outside());
            }
            values = Vec::with_capacity(count * width);
            for element in 0..count {
                let at = accessor.offset() + element * stride;
                let element = raw.get(at..at + size).ok_or_else(outside)?;
                values.extend(
                    element.chunks_exact(data.size()).map(|raw| number(raw, data, accessor.normalized())),
                );
            }
        } else {
            // All elements are 0, except those that a sparse part changes. A valid file has at least a byte per
            // element.
            if count > buffers.iter().map(Vec::len).sum() {
                let text = format!("accessor {} has more elements than the file has bytes", accessor.index());
                return Err(self.bad(text));
            }
            values = vec![0.0; count * width];
        }
        if let Some(sparse) = accessor.sparse() {
            let indices = self.view(&sparse.indices().view(), buffers)?;
            let index_type = match sparse.indices().index_type() {
                gltf::accessor::sparse::IndexType::U8 => DataType::U8,
                gltf::accessor::sparse::IndexType::U16 => DataType::U16,
                gltf::accessor::sparse::IndexType::U32 => DataType::U32,
            };
            let changes = self.view(&sparse.values().view(), buffers)?;
            let indices =
                indices.get(sparse.indices().offset()..).unwrap_or_default().chunks_exact(index_type.size());
            let changes =
                changes.get(sparse.values().offset()..).unwrap_or_default().chunks_exact(data.size() * width);
            let wrong = |what| self.bad(format!("the sparse part of accessor {} {what}", accessor.index()));
            if indices.len() < sparse.count() || changes.len() < sparse.count() {
                return Err(wrong("lies outside its buffer view"));
            }
            for (index, change) in indices.zip(changes).take(sparse.count()) {
                let at = number(index, index_type, false) as usize * width;
                let slot = values
                    .get_mut(at..at + width)
                    .ok_or_else(|| wrong("changes an element that does not exist"))?;
                for (value, raw) in slot.iter_mut().zip(change.chunks_exact(data.size())) {
                    *value = number(raw, data, accessor.normalized());
                }
            }
        }
        Ok(Numbers { width, values })
    }
}

/// Reads one number, normalised as in section 3.11 of the glTF specification.
fn number(raw: &[u8], data: DataType, normalized: bool) -> f64 {
    let (value, largest) = match (data, raw) {
        (DataType::I8, &[a]) => (f64::from(a as i8), 127.0),
        (DataType::U8, &[a]) => (f64::from(a), 255.0),
        (DataType::I16, &[a, b]) => (f64::from(i16::from_le_bytes([a, b])), 32_767.0),
        (DataType::U16, &[a, b]) => (f64::from(u16::from_le_bytes([a, b])), 65_535.0),
        (DataType::U32, &[a, b, c, d]) => (f64::from(u32::from_le_bytes([a, b, c, d])), 4_294_967_295.0),
        (DataType::F32, &[a, b, c, d]) => return f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => return f64::NAN,
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_normalise_as_the_specification_says() {
        assert_eq!(number(&[255], DataType::U8, true), 1.0);
        assert_eq!(number(&[0x80], DataType::I8, true), -1.0);
        assert_eq!(number(&[0x81], DataType::I8, true), -1.0);
        assert_eq!(number(&[0x80], DataType::I8, false), -128.0);
        assert_eq!(number(&[0xff, 0x7f], DataType::I16, true), 1.0);
        assert_eq!(number(&1.5_f32.to_le_bytes(), DataType::F32, true), 1.5);
    }
}
