//! Connected pieces of a surface, and removal of pieces that are too small.

use super::surface::Surface;

/// Counts of kept and removed pieces.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pieces {
    /// Number of pieces that are kept.
    pub kept: usize,
    /// Number of pieces that were removed.
    pub dropped: usize,
    /// Total area of the removed pieces, in square world units.
    pub dropped_area: f64,
}

fn root(parents: &mut [u32], mut of: u32) -> u32 {
    while parents[of as usize] != of {
        let above = parents[parents[of as usize] as usize];
        parents[of as usize] = above;
        of = above;
    }
    of
}

/// Removes pieces that are smaller than a minimum area. `least` returns this area for a level of cells, in square
/// world units.
pub fn without_small(surface: &mut Surface, least: &dyn Fn(u8) -> f64) -> Pieces {
    let mut parents: Vec<u32> = (0..surface.points.len() as u32).collect();
    for [a, b, c] in &surface.triangles {
        for other in [b, c] {
            let (x, y) = (root(&mut parents, *a), root(&mut parents, *other));
            // The lower number is the root, whatever the order.
            parents[x.max(y) as usize] = x.min(y);
        }
    }
    let (mut areas, mut levels) = (vec![0.0_f64; parents.len()], vec![u8::MAX; parents.len()]);
    for triangle in &surface.triangles {
        let piece = root(&mut parents, triangle[0]) as usize;
        areas[piece] += 0.5 * f64::from(surface.normal(*triangle).length());
        levels[piece] = levels[piece].min(surface.levels[triangle[0] as usize]);
    }
    let mut pieces = Pieces::default();
    let mut kept = vec![true; parents.len()];
    for (piece, area) in areas.iter().enumerate().filter(|(piece, _)| levels[*piece] != u8::MAX) {
        kept[piece] = *area >= least(levels[piece]);
        if kept[piece] {
            pieces.kept += 1;
        } else {
            pieces.dropped += 1;
            pieces.dropped_area += area;
        }
    }
    surface.triangles.retain(|triangle| kept[root(&mut parents, triangle[0]) as usize]);
    surface.compact();
    pieces
}
