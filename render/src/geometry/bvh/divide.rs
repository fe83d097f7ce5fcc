//! Divides the triangles of a large tree into pieces, by the surface area heuristic with bins.
//!
//! The pieces depend on the triangles alone, so a tree is the same for any number of threads.

use engine::{Context, NodeError};
use glam::Vec3;

use super::collapse::Branch;

/// Number of bins along each axis.
const BINS: usize = 32;
/// Approximate number of pieces into which all triangles are divided.
const PIECES: usize = 32;
/// Reciprocal of the minimum share of the items on each side of a division: with 5, each side has at least a fifth
/// of the items. This limits the number of levels.
const LEAST: usize = 5;
/// Maximum number of levels of divisions. It is sufficient, since `0.8^16 < 1 / PIECES`.
const MOST_LEVELS: usize = 16;

/// The pieces of a large tree, and the binary tree above them.
pub(super) struct Division {
    /// Indices of the boxes of each piece, ascending.
    pub pieces: Vec<Vec<u32>>,
    /// The tree. Its leaves are the indices of the pieces, and its root is the first branch.
    pub tree: Vec<Branch>,
}

type Box3 = (Vec3, Vec3);

const EMPTY: Box3 = (Vec3::INFINITY, Vec3::NEG_INFINITY);

fn joined((a, b): Box3, (c, d): Box3) -> Box3 {
    (a.min(c), b.max(d))
}

fn surface((low, high): Box3) -> f32 {
    let size = high - low;
    if size.min_element() < 0.0 { 0.0 } else { size.x * size.y + size.y * size.z + size.z * size.x }
}

/// Calls `f` for every index below `n` and returns the results in the order of the indices. With a context, the
/// calls are distributed over the threads of the node.
pub(crate) fn each<T: Send>(
    cx: Option<&Context>,
    n: usize,
    f: impl Fn(usize) -> T + Send + Sync,
) -> Result<Vec<T>, NodeError> {
    match cx {
        Some(cx) => cx.for_each_tile(n, f),
        None => Ok((0..n).map(f).collect()),
    }
}

/// Divides boxes into pieces, level by level. The parts of a level are divided in parallel.
///
/// # Errors
/// If the run is cancelled.
pub(super) fn divide(cx: Option<&Context>, boxes: &[Box3]) -> Result<Division, NodeError> {
    let most = boxes.len().div_ceil(PIECES);
    let mut tree = vec![Branch::Leaf { first: 0, count: 1 }];
    let mut pieces = Vec::new();
    // Indices of the branches of the current level, and their items.
    let mut open = vec![(0_usize, (0..boxes.len() as u32).collect::<Vec<u32>>())];
    for _ in 0..MOST_LEVELS {
        let (large, small): (Vec<_>, Vec<_>) = open.into_iter().partition(|(_, items)| items.len() > most);
        for (branch, items) in small {
            close(branch, items, &mut tree, &mut pieces);
        }
        let halves = each(cx, large.len(), |index| halved(boxes, &large[index].1))?;
        open = Vec::with_capacity(2 * halves.len());
        for ((branch, _), [left, right]) in large.into_iter().zip(halves) {
            let first = tree.len();
            tree[branch] = Branch::Inner(first as u32, first as u32 + 1);
            tree.extend([Branch::Leaf { first: 0, count: 1 }; 2]);
            open.extend([(first, left), (first + 1, right)]);
        }
    }
    for (branch, items) in open {
        close(branch, items, &mut tree, &mut pieces);
    }
    Ok(Division { pieces, tree })
}

/// Turns a branch into a leaf that refers to a new piece with these items.
fn close(branch: usize, items: Vec<u32>, tree: &mut [Branch], pieces: &mut Vec<Vec<u32>>) {
    tree[branch] = Branch::Leaf { first: pieces.len() as u32, count: 1 };
    pieces.push(items);
}

/// Divides items into two sides, each with at least a fifth of the items. Of all borders between bins, the one with
/// the lowest cost is used: the sum over both sides of surface area times number of items. If no border is
/// possible, the items are halved along the widest axis.
fn halved(boxes: &[Box3], items: &[u32]) -> [Vec<u32>; 2] {
    let centre = |item: u32| boxes[item as usize].0 + boxes[item as usize].1;
    let (low, high) = items.iter().fold(EMPTY, |all, &item| joined(all, (centre(item), centre(item))));
    let size = high - low;
    let bin = |item: u32, axis: usize| {
        // The conversion saturates.
        (((centre(item)[axis] - low[axis]) / size[axis] * BINS as f32) as usize).min(BINS - 1)
    };
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| size[axis] > 0.0 && size[axis].is_finite()) {
        let mut bins = [(EMPTY, 0_usize); BINS];
        for &item in items {
            let (around, count) = &mut bins[bin(item, axis)];
            (*around, *count) = (joined(*around, boxes[item as usize]), *count + 1);
        }
        let mut right = [(EMPTY, 0_usize); BINS + 1];
        for (at, (around, count)) in bins.iter().enumerate().rev() {
            let (beyond, more) = right[at + 1];
            right[at] = (joined(beyond, *around), more + count);
        }
        let mut left = (EMPTY, 0);
        for (at, (around, count)) in bins.iter().enumerate().take(BINS - 1) {
            left = (joined(left.0, *around), left.1 + count);
            let (beyond, more) = right[at + 1];
            let cost = surface(left.0) * left.1 as f32 + surface(beyond) * more as f32;
            // Of equal costs, the first one counts.
            if left.1.min(more) * LEAST >= items.len() && best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, at + 1));
            }
        }
    }
    if let Some((_, axis, at)) = best {
        let (left, right) = items.iter().partition(|&&item| bin(item, axis) < at);
        return [left, right];
    }
    let axis = size.max_position();
    let mut order = items.to_vec();
    order.sort_by(|&a, &b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b)));
    let right = order.split_off(order.len() / 2);
    [order, right].map(|mut side| {
        side.sort_unstable();
        side
    })
}
