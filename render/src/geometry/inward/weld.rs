//! Places shared by vertices, and patches of faces that are connected over edges.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::types::Primitive;

/// Largest distance between vertices that count as one place, relative to the diagonal of the object. Exporters
/// round coordinates to single precision or to six digits.
const TOLERANCE: f64 = 1e-6;
/// Width of a cell of the grid in which near vertices are searched, in units of the tolerance.
const CELL: f64 = 16.0;
/// Largest number of vertices of a cell with which a vertex is compared.
const COMPARED: usize = 64;

/// Returns the root of an entry in a union-find forest, and shortens the paths on the way.
fn root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let above = parents[parents[at as usize] as usize];
        parents[at as usize] = above;
        at = above;
    }
    at
}

fn join(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b) as usize] = a.min(b);
}

/// The length of the diagonal of the box around all vertices, and its lower corner.
pub(super) fn extent(primitives: &[Primitive]) -> (f64, DVec3) {
    let all = || primitives.iter().flat_map(|p| &p.positions).map(|p| DVec3::from(p.map(f64::from)));
    let low = all().fold(DVec3::INFINITY, DVec3::min);
    let high = all().fold(DVec3::NEG_INFINITY, DVec3::max);
    if low.cmple(high).all() { ((high - low).length(), low) } else { (0.0, DVec3::ZERO) }
}

/// For each vertex of all primitives, the smallest index of a vertex at the same place.
pub(super) fn places(primitives: &[Primitive], cx: &Context) -> Result<Vec<u32>, NodeError> {
    let positions: Vec<[f32; 3]> = primitives.iter().flat_map(|p| &p.positions).copied().collect();
    let (size, low) = extent(primitives);
    let tolerance = TOLERANCE * size;
    // Any width is right if all vertices are at one place.
    let cell = if size > 0.0 { CELL * tolerance } else { 1.0 };
    let mut entries: Vec<([u32; 3], u32)> = Vec::with_capacity(positions.len());
    for (at, position) in positions.iter().enumerate() {
        let from_low = DVec3::from(position.map(f64::from)) - low;
        // The cells that the cube around the vertex touches.
        let first = ((from_low - tolerance) / cell).floor() + 1.0;
        let last = ((from_low + tolerance) / cell).floor() + 1.0;
        let [first, last] = [first, last].map(|v| [v.x as u32, v.y as u32, v.z as u32]);
        for x in first[0]..=last[0] {
            for y in first[1]..=last[1] {
                entries.extend((first[2]..=last[2]).map(|z| ([x, y, z], at as u32)));
            }
        }
    }
    cx.check()?;
    entries.sort_unstable();
    cx.check()?;
    let mut parents: Vec<u32> = (0..positions.len() as u32).collect();
    for cell in entries.chunk_by_mut(|a, b| a.0 == b.0) {
        let of = |entry: &([u32; 3], u32)| positions[entry.1 as usize];
        cell.sort_unstable_by(|a, b| {
            let order = of(a).iter().zip(of(b)).map(|(a, b)| a.total_cmp(&b)).find(|order| order.is_ne());
            order.unwrap_or(std::cmp::Ordering::Equal).then(a.1.cmp(&b.1))
        });
        for (at, entry) in cell.iter().enumerate() {
            let own = of(entry).map(f64::from);
            for other in cell[..at].iter().rev().take(COMPARED) {
                let apart = DVec3::from(of(other).map(f64::from)) - DVec3::from(own);
                if apart.x.abs() > tolerance {
                    break;
                }
                if apart.length() <= tolerance {
                    join(&mut parents, entry.1, other.1);
                }
            }
        }
    }
    Ok((0..positions.len() as u32).map(|at| root(&mut parents, at)).collect())
}

/// Patches of faces.
pub(super) struct Patches {
    /// Number of the patch of each face, from 0 in order of the first face.
    pub of_face: Vec<u32>,
    /// For each patch, true if it has no boundary.
    pub closed: Vec<bool>,
}

/// Connects faces, given by their places, over edges of exactly two faces that run through the edge in opposite
/// directions. Edges of one face, of more than two faces (where parts touch), or of faces with different
/// orientations are boundaries.
pub(super) fn patches(faces: &[[u32; 3]], cx: &Context) -> Result<Patches, NodeError> {
    let mut edges: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * faces.len());
    for (at, face) in faces.iter().enumerate() {
        let [a, b, c] = *face;
        if a == b || b == c || c == a {
            continue;
        }
        for [from, to] in [[a, b], [b, c], [c, a]] {
            edges.push(([from.min(to), from.max(to)], (at as u32) << 1 | u32::from(from > to)));
        }
    }
    cx.check()?;
    edges.sort_unstable();
    cx.check()?;
    let mut parents: Vec<u32> = (0..faces.len() as u32).collect();
    let mut open = vec![false; faces.len()];
    for edge in edges.chunk_by(|a, b| a.0 == b.0) {
        match edge {
            [(_, a), (_, b)] if (a ^ b) & 1 == 1 => join(&mut parents, a >> 1, b >> 1),
            _ => edge.iter().for_each(|(_, half)| open[(half >> 1) as usize] = true),
        }
    }
    drop(edges);
    let mut number = vec![u32::MAX; faces.len()];
    let (mut of_face, mut closed) = (Vec::with_capacity(faces.len()), Vec::new());
    for at in 0..faces.len() as u32 {
        let root = root(&mut parents, at) as usize;
        if number[root] == u32::MAX {
            number[root] = closed.len() as u32;
            closed.push(true);
        }
        closed[number[root] as usize] &= !open[at as usize];
        of_face.push(number[root]);
    }
    Ok(Patches { of_face, closed })
}

/// For each face, true if another face has the same corners in the opposite orientation. Such pairs are how some
/// programs make both sides of a single-sided material visible.
pub(super) fn has_reverse(faces: &[[u32; 3]]) -> Vec<bool> {
    let mut sorted: Vec<([u32; 3], bool, u32)> = faces
        .iter()
        .enumerate()
        .map(|(at, &[a, b, c])| {
            // The smallest corner first keeps the orientation.
            let [a, b, c] = if a <= b && a <= c {
                [a, b, c]
            } else if b <= c {
                [b, c, a]
            } else {
                [c, a, b]
            };
            ([a, b.min(c), b.max(c)], b > c, at as u32)
        })
        .collect();
    sorted.sort_unstable();
    let mut found = vec![false; faces.len()];
    for group in sorted.chunk_by(|a, b| a.0 == b.0) {
        if group.iter().any(|face| face.1 != group[0].1) {
            group.iter().for_each(|face| found[face.2 as usize] = true);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    #[test]
    fn near_vertices_are_one_place() {
        let p = |positions: &[[f32; 3]]| Primitive { positions: positions.to_vec(), ..Primitive::default() };
        let list = [
            p(&[[0.0; 3], [1.0, 1.0, 1.0], [0.5, 0.5, 0.5]]),
            p(&[[1e-6, 0.0, 0.0], [-0.0, 0.0, 0.0], [0.500_000_5, 0.5, 0.5], [0.500_01, 0.5, 0.5]]),
        ];
        assert_eq!(places(&list, &context()).unwrap_or_default(), [0, 1, 2, 0, 0, 2, 6]);
        assert_eq!(places(&[p(&[[3.0; 3], [3.0; 3]])], &context()).unwrap_or_default(), [0, 0]);
    }

    #[test]
    fn faces_connect_over_consistent_edges_of_two() {
        let of = |faces: &[[u32; 3]]| {
            let found = patches(faces, &context()).unwrap_or_else(|e| panic!("{e}"));
            (found.of_face, found.closed)
        };
        let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert_eq!(of(&tetrahedron), (vec![0; 4], vec![true]));
        assert_eq!(of(&tetrahedron[..3]), (vec![0; 3], vec![false]));
        // One face is reversed.
        let mut odd = tetrahedron;
        odd[0] = [0, 1, 2];
        assert_eq!(of(&odd), (vec![0, 1, 1, 1], vec![false, false]));
        // Two that share an edge.
        let both = [tetrahedron, tetrahedron.map(|t| t.map(|v| if v < 2 { v } else { v + 2 }))].concat();
        assert_eq!(of(&both).1, [false; 2]);
        assert_eq!(has_reverse(&[[0, 1, 2], [2, 1, 0], [3, 4, 5], [4, 5, 3]]), [true, true, false, false]);
    }
}
