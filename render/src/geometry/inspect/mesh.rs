//! Summary of a triangle mesh: its size, up axis and floor, and whether it is closed.

use glam::DVec3;
use scene::types::Mesh;
use serde::Serialize;

use super::{Extent, Finding, FloorGuess, Patch, floor_of, percentile};

/// Summary of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles that have an area.
    pub triangles: usize,
    /// True if the vertices have colours.
    pub coloured: bool,
    /// Box around all vertices. `None` if there are no vertices.
    pub bounds: Option<Extent>,
    /// Total area of the triangles, in square world units.
    pub area: f64,
    /// Number of edges that belong to a single triangle, such as the rims of holes. Vertices at the same point
    /// count as one vertex.
    pub open_edges: usize,
    /// Number of edges that belong to three or more triangles, or to two triangles with opposite orientations.
    pub odd_edges: usize,
    /// The estimated floor. `None` if there is no estimate.
    pub floor: Option<FloorGuess>,
    /// Warnings.
    pub findings: Vec<Finding>,
}

impl Inspection {
    /// True if every edge belongs to two triangles with the same orientation.
    pub fn is_closed(&self) -> bool {
        self.triangles > 0 && self.open_edges == 0 && self.odd_edges == 0
    }
}

/// Computes the summary of a mesh.
pub fn inspect(mesh: &Mesh) -> Inspection {
    let bounds = (!mesh.positions.is_empty()).then(|| {
        let axis = |k: usize, of: fn(f32, f32) -> f32| {
            f64::from(mesh.positions.iter().map(|p| p[k]).reduce(of).unwrap_or_default())
        };
        Extent { min: [0, 1, 2].map(|k| axis(k, f32::min)), max: [0, 1, 2].map(|k| axis(k, f32::max)) }
    });
    // The middle 96 % of the vertices, so that a few distant vertices do not extend the search for the floor.
    let core = bounds.map(|_| {
        let at = |share| {
            [0, 1, 2].map(|k| percentile(&mut mesh.positions.iter().map(|p| p[k]).collect::<Vec<_>>(), share))
        };
        // The box is enlarged, because all vertices of a floor may lie at the lowest percentile.
        Extent { min: at(0.02), max: at(0.98) }
    });
    let corners = |of: &[u32; 3]| of.map(|v| mesh.position(v));
    let area: f64 = mesh.triangles.iter().map(|of| cross(corners(of)).length() * 0.5).sum();
    let (open_edges, odd_edges) = edges(mesh);
    let mut found = Inspection {
        vertices: mesh.positions.len(),
        triangles: mesh.triangles.len(),
        coloured: !mesh.colours.is_empty(),
        bounds,
        area,
        open_edges,
        odd_edges,
        floor: core
            .and_then(|core| floor_of(mesh.triangles.iter().map(|of| patch(corners(of), area)), &core)),
        findings: Vec::new(),
    };
    for (id, holds, text) in [
        ("no-triangles", found.triangles == 0, "the mesh has no surface".to_owned()),
        (
            "no-colours",
            found.triangles > 0 && !found.coloured,
            "the mesh has no vertex colours, so reflected light will be grey".to_owned(),
        ),
        (
            "odd-edges",
            found.odd_edges > 0,
            format!(
                "some edges belong to two triangles with opposite orientations, or to more than two triangles (number: {})",
                found.odd_edges
            ),
        ),
        (
            "floor-unclear",
            found.triangles > 0 && found.floor.as_ref().is_none_or(|floor| !floor.is_clear()),
            "the up axis cannot be determined from the mesh".to_owned(),
        ),
    ] {
        if holds {
            found.findings.push(Finding { id, text });
        }
    }
    found
}

/// Normal of a triangle. Its length is twice the area of the triangle.
fn cross([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// Converts a triangle to a patch of surface with the same area. `whole` is the area of the mesh. A triangle is not
/// a random sample, so each ten-thousandth of `whole` counts as one observation.
fn patch(corners: [DVec3; 3], whole: f64) -> Patch {
    let cross = cross(corners);
    let length = cross.length();
    let weight = 0.5 * length;
    Patch {
        middle: [0, 1, 2].map(|k| corners.iter().map(|corner| corner[k]).sum::<f64>() / 3.0),
        normal: (length > 0.0).then(|| (cross / length).to_array()),
        weight,
        variance: weight * weight.min(whole / 10_000.0),
    }
}

/// Number of open edges, and number of odd edges (see [`Inspection`]).
fn edges(mesh: &Mesh) -> (usize, usize) {
    // Exporters repeat a vertex wherever its normal or colour changes, so equal points count as one vertex.
    let mut order: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    // -0 is 0.
    let point = |v: u32| mesh.position(v).to_array().map(|c| (c + 0.0).to_bits());
    order.sort_unstable_by_key(|v| (point(*v), *v));
    let mut first = vec![0_u32; order.len()];
    for same in order.chunk_by(|a, b| point(*a) == point(*b)) {
        same.iter().for_each(|v| first[*v as usize] = same[0]);
    }
    let mut edges = Vec::with_capacity(mesh.triangles.len() * 3);
    for corners in &mesh.triangles {
        let corners = corners.map(|v| first[v as usize]);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), a < b));
        }
    }
    edges.sort_unstable();
    let (mut open, mut odd) = (0, 0);
    for same in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        match same {
            [_] => open += 1,
            [(.., one), (.., other)] if one != other => {}
            _ => odd += 1,
        }
    }
    (open, odd)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box of 8 by 8 by 2. Its faces share no vertices.
    fn slab() -> Mesh {
        let mut mesh = Mesh::default();
        for axis in 0..3 {
            for side in [false, true] {
                let first = mesh.positions.len() as u32;
                for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                    let mut p = [0.0_f32; 3];
                    p[axis] = f32::from(u8::from(side));
                    (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (u, v);
                    mesh.positions.push([p[0] * 8.0, p[1] * 8.0, p[2] * 2.0]);
                }
                let quad = if side { [0, 1, 2, 3] } else { [0, 3, 2, 1] };
                mesh.triangles.push([quad[0], quad[1], quad[2]].map(|v| first + v));
                mesh.triangles.push([quad[0], quad[2], quad[3]].map(|v| first + v));
            }
        }
        mesh
    }

    #[test]
    fn a_box_is_closed_whatever_its_vertices() {
        let found = inspect(&slab());
        assert!(found.is_closed() && found.vertices == 24 && found.triangles == 12);
        assert!((found.area - (2.0 * 64.0 + 4.0 * 16.0)).abs() < 1e-9);
        assert_eq!(found.bounds.map(|b| b.max), Some([8.0, 8.0, 2.0]));
        assert_eq!(found.findings.iter().map(|f| f.id).collect::<Vec<_>>(), ["no-colours", "floor-unclear"]);
    }

    #[test]
    fn holes_and_turned_faces_are_counted() {
        let mut open = slab();
        open.triangles.pop();
        assert_eq!((inspect(&open).open_edges, inspect(&open).is_closed()), (3, false));
        let mut turned = slab();
        turned.triangles[3].reverse();
        assert_eq!((inspect(&turned).open_edges, inspect(&turned).odd_edges), (0, 3));
        let none = inspect(&Mesh::default());
        assert!(!none.is_closed() && none.bounds.is_none() && none.findings[0].id == "no-triangles");
    }

    // The box without its lid and with taller walls. The floor is the remaining horizontal face.
    #[test]
    fn the_floor_of_a_tray_is_found() {
        let mut tray = slab();
        tray.triangles.truncate(10);
        let floor = inspect(&tray).floor.map(|floor| (floor.up, floor.height.abs() < 0.05));
        assert_eq!(floor, Some(("+z", true)));
    }
}
