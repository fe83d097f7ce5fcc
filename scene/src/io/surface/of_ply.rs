//! Reading of meshes from PLY files.

use std::collections::HashMap;

use engine::{Context, NodeError, Notes};

use super::raw::{RawMesh, WHITE};
use crate::error::Error;
use crate::io::colour_range::Range;
use crate::io::ply;

/// Reads the mesh of a PLY file.
pub fn from_ply(name: &str, bytes: &[u8], cx: &Context, notes: &mut Notes) -> Result<RawMesh, NodeError> {
    let header = ply::header(name, bytes)?;
    let mut rows = ply::Rows::new(name, &header, bytes);
    let mut raw = RawMesh::default();
    if !header.elements.iter().any(|e| e.name == "face" && e.rows > 0) {
        let what =
            if header.elements.iter().any(|e| e.name == "tristrips") { "triangle strips" } else { "points" };
        return Err(NodeError::from(Error::format(name, format!("holds {what}, not faces")))
            .at("path")
            .hint("export the mesh with its faces"));
    }
    let mut of_faces = Vec::new();
    for element in &header.elements {
        let count = rows.believable(element)?;
        match element.name.as_str() {
            "vertex" => {
                vertices(name, element, count, &mut rows, &mut raw, cx)?;
                to_unit(element, &mut raw.colours, notes);
            }
            "face" => of_faces = faces(name, element, count, &mut rows, &mut raw, cx)?,
            _ => {
                for _ in 0..count {
                    rows.row(element, |_, _| {})?;
                }
            }
        }
    }
    // A vertex that does not exist is reported later.
    let exist = raw.triangles.iter().flatten().all(|&vertex| (vertex as usize) < raw.positions.len());
    if raw.colours.is_empty() && !of_faces.is_empty() && exist {
        let text = "only faces have colours, so each corner of a face gets the colour of the face";
        notes.decision("face-colours", text);
        header.elements.iter().filter(|e| e.name == "face").for_each(|e| to_unit(e, &mut of_faces, notes));
        colour_corners(&mut raw, &of_faces);
    }
    Ok(raw)
}

/// Gives the colour of each triangle to its corners. A vertex that triangles of several colours share is duplicated
/// for each colour.
fn colour_corners(raw: &mut RawMesh, of_triangles: &[[f64; 3]]) {
    let mut first: Vec<Option<[f64; 3]>> = vec![None; raw.positions.len()];
    let (mut others, mut more) = (HashMap::new(), Vec::new());
    for (triangle, &colour) in raw.triangles.iter_mut().zip(of_triangles) {
        for corner in triangle {
            let vertex = *corner as usize;
            if *first[vertex].get_or_insert(colour) != colour {
                *corner = *others.entry((vertex, colour.map(f64::to_bits))).or_insert_with(|| {
                    raw.positions.push(raw.positions[vertex]);
                    more.push(colour);
                    raw.positions.len() as u32 - 1
                });
            }
        }
    }
    raw.colours = first.into_iter().map(|colour| colour.unwrap_or(WHITE)).chain(more).collect();
}

/// Indices of the colour properties of an element; `None` if the element has no colours.
fn colours(element: &ply::Element) -> Option<[usize; 3]> {
    let names = [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
    names.iter().find_map(|names| {
        let found: Vec<usize> = names.iter().filter_map(|n| element.find(n)).collect();
        <[usize; 3]>::try_from(found).ok()
    })
}

/// Scales colours that are stored as integers so that white is 1, with a warning if white was inferred from their
/// values. The range of floats is inferred later, when all vertices are known.
fn to_unit(element: &ply::Element, list: &mut [[f64; 3]], notes: &mut Notes) {
    let Some([red, ..]) = colours(element) else { return };
    let scalar = element.properties[red].scalar;
    if scalar.whole_range().is_none() {
        return;
    }
    let range = Range::of(scalar, || list.as_flattened().iter().copied());
    if range.guessed {
        range.warn(notes);
    }
    let scale = 1.0 / range.white;
    list.as_flattened_mut().iter_mut().for_each(|number| *number *= scale);
}

fn vertices(
    name: &str,
    element: &ply::Element,
    count: usize,
    rows: &mut ply::Rows<'_>,
    raw: &mut RawMesh,
    cx: &Context,
) -> Result<(), NodeError> {
    let missing = |axis: &str| Error::format(name, format!("the vertices have no property `{axis}`"));
    let mut slots = [usize::MAX; 6];
    for (slot, axis) in slots.iter_mut().zip(["x", "y", "z"]) {
        *slot = element.find(axis).ok_or_else(|| missing(axis))?;
        raw.finer |= element.properties[*slot].scalar == ply::Scalar::F64;
    }
    let colours = colours(element);
    if let Some(colours) = colours {
        slots[3..].copy_from_slice(&colours);
        raw.colours.reserve(count);
    }
    raw.positions.reserve(count);
    for row in 0..count {
        if row % 65_536 == 0 {
            cx.check()?;
        }
        let mut v = [0.0; 6];
        rows.row(element, |index, numbers| {
            if let ([number], Some(slot)) = (numbers, slots.iter().position(|s| *s == index)) {
                v[slot] = *number;
            }
        })?;
        raw.positions.push([v[0], v[1], v[2]]);
        if colours.is_some() {
            raw.colours.push([v[3], v[4], v[5]]);
        }
    }
    Ok(())
}

/// Reads the faces. Returns the colour of each resulting triangle, as stored, if faces have colours.
fn faces(
    name: &str,
    element: &ply::Element,
    count: usize,
    rows: &mut ply::Rows<'_>,
    raw: &mut RawMesh,
    cx: &Context,
) -> Result<Vec<[f64; 3]>, NodeError> {
    let list = element
        .find("vertex_indices")
        .or_else(|| element.find("vertex_index"))
        .filter(|&i| element.properties[i].count.is_some())
        .ok_or_else(|| Error::format(name, "the faces have no list `vertex_indices`"))?;
    let (colours, mut of_triangles) = (colours(element), Vec::new());
    raw.triangles.reserve(count);
    for row in 0..count {
        if row % 65_536 == 0 {
            cx.check()?;
        }
        let (mut whole, mut colour) = (true, WHITE);
        let (triangles, fanned) = (&mut raw.triangles, &mut raw.fanned);
        rows.row(element, |index, corners| {
            if let (Some(at), [number]) = (colours, corners)
                && let Some(channel) = at.iter().position(|at| *at == index)
            {
                colour[channel] = *number;
            }
            if index != list {
                return;
            }
            let vertex = |c: f64| {
                if (0.0..4_294_967_295.0).contains(&c) && c.trunc() == c { Some(c as u32) } else { None }
            };
            *fanned += u64::from(corners.len() > 3);
            for pair in corners.windows(2).skip(1) {
                match (vertex(corners[0]), vertex(pair[0]), vertex(pair[1])) {
                    (Some(a), Some(b), Some(c)) => triangles.push([a, b, c]),
                    _ => whole = false,
                }
            }
        })?;
        if !whole {
            return Err(Error::format(
                name,
                format!("face {row} refers to a vertex index that is not valid"),
            )
            .into());
        }
        if colours.is_some() {
            of_triangles.resize(raw.triangles.len(), colour);
        }
    }
    Ok(of_triangles)
}
