//! Meshes of captured places, as receivers of shadows: reading of PLY files, and removal of unusable parts.

mod of_ply;
mod raw;

use engine::{Context, NodeError, Notes};
use glam::DVec3;

use crate::error::Error;
use crate::io::colour_range::Range;
use crate::math::color::linear_from_srgb;
use crate::types::Mesh;

pub use of_ply::from_ply;
pub use raw::{RawMesh, WHITE};

/// Drops parts that cannot be traced, and makes colours linear.
pub fn clean(
    name: &str,
    raw: RawMesh,
    srgb: bool,
    cx: &Context,
    notes: &mut Notes,
) -> Result<Mesh, NodeError> {
    let n = raw.positions.len();
    let range = Range::of_floats(raw.colours.as_flattened().iter().copied());
    if range.guessed {
        range.warn(notes);
    }
    if let Some(bad) = raw.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= n)) {
        let what = format!("triangle {bad} refers to a vertex that does not exist (number of vertices: {n})");
        return Err(Error::format(name, what).into());
    }
    let (mut mesh, mut renamed) = (Mesh::default(), Vec::with_capacity(n));
    mesh.positions.reserve_exact(n);
    mesh.colours.reserve_exact(raw.colours.len().max(raw.tints.len()));
    mesh.triangles.reserve_exact(raw.triangles.len());
    let (mut clamped, mut lost) = (0, 0);
    for (index, position) in raw.positions.iter().enumerate() {
        let (exact, position) = (*position, position.map(|c| c as f32));
        if !position.iter().all(|c| c.is_finite()) {
            renamed.push(u32::MAX);
            lost += 1;
            continue;
        }
        renamed.push(mesh.positions.len() as u32);
        mesh.positions.push(position);
        if raw.finer {
            mesh.positions_low.push([0, 1, 2].map(|k| (exact[k] - f64::from(position[k])) as f32));
        }
        let (colour, tint) = (raw.colours.get(index), raw.tints.get(index));
        if colour.is_some() || tint.is_some() {
            let colour = colour.map_or(WHITE, |colour| colour.map(|c| c / range.white));
            let (colour, tint) = (&colour, tint.unwrap_or(&WHITE));
            let legal = colour.iter().chain(tint).all(|c| (0.0..=1.0).contains(c));
            clamped += u64::from(!legal);
            // The comparison maps NaN to 0.
            let legal = |c: f64| if c > 0.0 { c.min(1.0) as f32 } else { 0.0 };
            mesh.colours.push([0, 1, 2].map(|k| {
                let c = legal(colour[k]);
                legal(tint[k]) * if srgb { linear_from_srgb(c) } else { c }
            }));
        }
    }
    cx.check()?;
    let (mut dangling, mut flat) = (0, 0);
    for triangle in &raw.triangles {
        let t = triangle.map(|v| renamed[v as usize]);
        if t.contains(&u32::MAX) {
            dangling += 1;
        } else if area_is_zero(t.map(|v| mesh.position(v))) {
            flat += 1;
        } else {
            mesh.triangles.push(t);
        }
    }
    for (id, count, what) in [
        (
            "vertices-not-finite",
            lost,
            "of the vertices had coordinates that are not finite and had to be dropped",
        ),
        (
            "faces-of-dropped-vertices",
            dangling,
            "of the triangles had a dropped vertex and had to be dropped too",
        ),
        ("triangles-without-area", flat, "of the triangles had no area and had to be dropped"),
        ("colours-clamped", clamped, "of the vertex colours had to be clamped to the range 0 to 1"),
        (
            "faces-fanned",
            raw.fanned,
            "of the faces had more than three corners and had to be split into triangles",
        ),
    ] {
        notes.count(id, count, what);
    }
    if clamped as f64 > BRIGHT * mesh.positions.len() as f64 {
        let text = format!(
            "the colours of {clamped} of the {} vertices are outside 0 to 1 (0 to 255 in files with such colours) and were \
             clamped; if the colours are integers of 10 or 16 bits, divide them by their maximum when exporting",
            mesh.positions.len()
        );
        notes.warning("colours-too-bright", text);
    }
    if mesh.triangles.is_empty() {
        return Err(NodeError::from(Error::format(name, "the mesh has no usable triangle")).at("path"));
    }
    if mesh.colours.is_empty() {
        notes.warning(
            "no-vertex-colours",
            "the mesh has no vertex colours, so as a receiver it is grey with an albedo of 0.5",
        );
    }
    Ok(mesh)
}

/// Share of the vertices above which colours outside 0 to 1 are worth a warning.
const BRIGHT: f64 = 0.05;

/// True if a triangle has no area. In f64, products of differences of f32 values are exact enough that the result
/// is 0 only for collinear corners.
fn area_is_zero([a, b, c]: [DVec3; 3]) -> bool {
    (b - a).cross(c - a) == DVec3::ZERO
}
