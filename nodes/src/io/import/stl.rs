//! STL files, read by the crate `stl_io`: only triangles, in text or binary.

use std::collections::HashMap;
use std::io::Cursor;

use engine::{Context, NodeError};

use super::glb::{Builder, Part};
use crate::error::Error;
use crate::io::foreign::refuse_foreign;

/// Number of bytes before the triangles of a binary file.
const HEADER: usize = 84;
/// Number of bytes of each triangle in a binary file.
const TRIANGLE: usize = 50;

/// Reads the triangles; vertices at the same position are merged.
pub(super) fn read(name: &str, bytes: &[u8], builder: &mut Builder, cx: &Context) -> Result<(), NodeError> {
    refuse_foreign(name, bytes)?;
    let wrong = |what: String| Error::format(name, format!("not an STL file: {what}"));
    let binary = bytes.get(80..84).map(|n| u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize);
    let held = bytes.len().saturating_sub(HEADER) / TRIANGLE;
    // Some programs begin binary files with `solid` too: then the length decides.
    let exact = binary.is_some_and(|count| count == held && bytes.len() == HEADER + count * TRIANGLE);
    let text = bytes.trim_ascii_start().starts_with(b"solid") && !exact;
    if !text && binary.is_none_or(|count| count > held) {
        let what = format!("it has {} bytes, fewer than its header claims", bytes.len());
        return Err(wrong(what).into());
    }
    let mut plain = bytes.to_vec();
    if !text && let Some(head) = plain.first_chunk_mut::<5>() {
        // The library distinguishes the two by this word alone.
        *head = [0; 5];
    }
    let mut cursor = Cursor::new(plain);
    let triangles = stl_io::create_stl_reader(&mut cursor).map_err(|e| wrong(e.to_string()))?;
    let (mut part, mut places) = (Part::default(), HashMap::new());
    for (at, triangle) in triangles.enumerate() {
        if at % 65_536 == 0 {
            cx.check()?;
        }
        let triangle = triangle.map_err(|e| wrong(format!("cannot read triangle {at}: {e}")))?;
        for vertex in triangle.vertices {
            let vertex: [f32; 3] = vertex.into();
            let index = *places.entry(vertex.map(f32::to_bits)).or_insert_with(|| {
                part.positions.push(vertex);
                part.positions.len() as u32 - 1
            });
            part.indices.push(index);
        }
    }
    builder.add(&part);
    Ok(())
}
