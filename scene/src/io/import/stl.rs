//! STL files, in text or binary. No crate is used: the crate `stl_io` reads only the first solid of a text, without
//! a note, and only in lower case.

use std::collections::HashMap;

use engine::{Context, NodeError, Notes};

use super::glb::{Builder, GlbMesh};
use crate::error::Error;
use crate::io::foreign::{BYTE_ORDER_MARK, refuse_foreign};
use crate::io::mesh_format;

/// Number of bytes before the triangles of a binary file.
const HEADER: usize = 84;
/// Number of bytes of each triangle in a binary file.
const TRIANGLE: usize = 50;
/// Number of bytes that are searched for a NUL byte, which a text does not contain.
const START: usize = 1024;

/// Collects triangles; vertices at the same position are merged.
#[derive(Default)]
struct Triangles {
    part: GlbMesh,
    places: HashMap<[u32; 3], u32>,
}

impl Triangles {
    fn add(&mut self, vertex: [f32; 3]) {
        let next = self.part.positions.len() as u32;
        let index = *self.places.entry(vertex.map(f32::to_bits)).or_insert(next);
        if index == next {
            self.part.positions.push(vertex);
        }
        self.part.indices.push(index);
    }
}

/// True if a text begins with the word `solid` in upper or lower case, after white space.
fn begins_as_text(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    start.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// Reads the triangles of all solids.
pub(super) fn read(
    name: &str,
    bytes: &[u8],
    builder: &mut Builder,
    cx: &Context,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    refuse_foreign(name, bytes)?;
    if let Some(format) = mesh_format::by_content(bytes).filter(|format| *format != "STL") {
        return Err(mesh_format::refused(name, format, "STL").into());
    }
    let plain = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let count = bytes.get(80..84).map(|n| u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize);
    // Some programs begin binary files with `solid` too: then the length or a NUL byte decides.
    let exact =
        count.is_some_and(|count| bytes.len() == count.saturating_mul(TRIANGLE).saturating_add(HEADER));
    let text = begins_as_text(plain) && !exact && !plain.iter().take(START).any(|b| *b == 0);
    let mut triangles = Triangles::default();
    if text {
        let solids = of_text(name, plain, &mut triangles, cx)?;
        if solids > 1 {
            notes.decision("solids", format!("the file has {solids} solids, which are read as one shape"));
        }
    } else {
        of_binary(name, bytes, count, &mut triangles, cx, notes)?;
    }
    builder.add(&triangles.part);
    Ok(())
}

fn wrong(name: &str, what: impl std::fmt::Display) -> Error {
    Error::format(name, format!("not an STL file: {what}"))
}

fn of_binary(
    name: &str,
    bytes: &[u8],
    count: Option<usize>,
    triangles: &mut Triangles,
    cx: &Context,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    let held = bytes.len().saturating_sub(HEADER) / TRIANGLE;
    let Some(count) = count.filter(|count| *count <= held) else {
        let what = match count {
            Some(count) => format!(
                "it does not begin with `solid`, and its {} bytes are too few for a binary file with {count} triangles, the number in its header",
                bytes.len()
            ),
            None => format!(
                "it does not begin with `solid`, and its {} bytes are too few for a binary file",
                bytes.len()
            ),
        };
        return Err(wrong(name, what).into());
    };
    if count < held {
        let what = format!(
            "the number of triangles in the header of the file is {count}; the bytes after these triangles, enough for {} more, are ignored",
            held - count
        );
        notes.warning("bytes-left-over", what);
    }
    let body = bytes.get(HEADER..).unwrap_or_default();
    let coloured = body.chunks_exact(TRIANGLE).take(count).filter(|row| row[48..] != [0, 0]).count();
    if coloured > 0 {
        let what = format!(
            "`{name}` has a value after {coloured} of its triangles, where some programs store colours; STL does not define it, so the shape gets one colour: save it as PLY or GLB to keep its colours"
        );
        notes.warning("colours-ignored", what);
    }
    for (at, row) in body.chunks_exact(TRIANGLE).take(count).enumerate() {
        if at % 65_536 == 0 {
            cx.check()?;
        }
        // A normal, three corners, and two bytes of attributes.
        for corner in row[12..48].chunks_exact(12) {
            let number = |k: usize| {
                f32::from_le_bytes([corner[4 * k], corner[4 * k + 1], corner[4 * k + 2], corner[4 * k + 3]])
            };
            triangles.add([number(0), number(1), number(2)]);
        }
    }
    Ok(())
}

/// Reads the triangles of a text, and returns the number of its solids.
fn of_text(name: &str, bytes: &[u8], triangles: &mut Triangles, cx: &Context) -> Result<u64, NodeError> {
    let (mut solids, mut open, mut corners) = (0, false, None);
    for (at, line) in bytes.split(|b| matches!(b, b'\n' | b'\r')).enumerate() {
        if at % 65_536 == 0 {
            cx.check()?;
        }
        let line = String::from_utf8_lossy(line);
        let mut words = line.split_ascii_whitespace();
        let mut is_first = true;
        let unknown = || {
            let text: String = line.trim().chars().take(80).collect();
            wrong(name, format!("it contains the line `{text}`"))
        };
        while let Some(word) = words.next() {
            let word = word.to_ascii_lowercase();
            match word.as_str() {
                // The rest of the line is a name.
                "solid" if is_first && corners.is_none() => {
                    (solids, open) = (solids + 1, true);
                    break;
                }
                "endsolid" if is_first && corners.is_none() => {
                    open = false;
                    break;
                }
                "facet" if corners.is_none() => corners = Some(0),
                // Computed from the corners.
                "normal" => drop(words.by_ref().take(3).count()),
                "outer" | "loop" | "endloop" => {}
                "vertex" => {
                    let mut number = || words.next().and_then(|word| word.parse::<f32>().ok());
                    let (Some(x), Some(y), Some(z), Some(held)) =
                        (number(), number(), number(), &mut corners)
                    else {
                        return Err(unknown().into());
                    };
                    *held += 1;
                    triangles.add([x, y, z]);
                }
                "endfacet" if corners == Some(3) => corners = None,
                _ => return Err(unknown().into()),
            }
            is_first = false;
        }
    }
    if open || corners.is_some() {
        return Err(wrong(name, "the text ends before `endsolid`").into());
    }
    Ok(solids)
}
