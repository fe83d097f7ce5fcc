//! One stable sort of the footprints, then their lists by tile.

use engine::{Context, NodeError};

use super::lens;
use super::project::Projected;
use super::{Bounds, Settings};

/// Side of a tile, in pixels; the INRIA rasterizer's, whose bounds depend on it.
pub const TILE: usize = 16;

const DIGIT_BITS: u32 = 11;

/// The order of ascending keys; equal keys stay in their order, which is that of the file. A radix
/// sort from the lowest digit, leaving out digits that all keys share.
pub(super) fn order(mut from: Vec<(u64, u32)>, cx: &Context) -> Result<Vec<u32>, NodeError> {
    let mask = (1_u64 << DIGIT_BITS) - 1;
    let first = from.first().map_or(0, |item| item.0);
    let varying = from.iter().fold(0, |bits, (key, _)| bits | (key ^ first));
    let mut to = vec![(0, 0); from.len()];
    let mut shift = 0;
    while shift < u64::BITS && varying >> shift != 0 {
        if (varying >> shift) & mask != 0 {
            cx.check()?;
            let mut starts = vec![0_u32; 1 << DIGIT_BITS];
            for (key, _) in &from {
                starts[((key >> shift) & mask) as usize] += 1;
            }
            let mut sum = 0;
            for start in &mut starts {
                sum += std::mem::replace(start, sum);
            }
            for item in &from {
                let at = &mut starts[((item.0 >> shift) & mask) as usize];
                to[*at as usize] = *item;
                *at += 1;
            }
            std::mem::swap(&mut from, &mut to);
        }
        shift += DIGIT_BITS;
    }
    Ok(from.into_iter().map(|(_, index)| index).collect())
}

/// The footprints of every tile, front to back.
pub(super) struct Lists {
    columns: usize,
    rows: usize,
    of: ListsOf,
}

enum ListsOf {
    /// Every tile has all footprints.
    All(Vec<u32>),
    /// One entry a row of tiles.
    Bands(Vec<Band>),
}

/// The lists of one row of tiles.
struct Band {
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl Lists {
    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.columns * self.rows
    }

    /// The list of a tile, and the pixel at its top left.
    pub(super) fn tile(&self, tile: usize) -> (&[u32], usize, usize) {
        let (row, column) = (tile / self.columns, tile % self.columns);
        let list = match &self.of {
            ListsOf::All(list) => list.as_slice(),
            ListsOf::Bands(bands) => {
                let Band { starts, list } = &bands[row];
                &list[starts[column] as usize..starts[column + 1] as usize]
            }
        };
        (list, column * TILE, row * TILE)
    }

    /// Pairs of a splat and a tile.
    pub(super) fn pairs(&self) -> u64 {
        match &self.of {
            ListsOf::All(list) => (list.len() * self.tiles()) as u64,
            ListsOf::Bands(bands) => bands.iter().map(|band| band.list.len() as u64).sum(),
        }
    }
}

/// Lists the footprints by tile, each list in the given order, of a picture of this width and height in pixels.
pub(super) fn bin(
    projected: &Projected,
    order: Vec<u32>,
    (width, height): (usize, usize),
    settings: &Settings,
    cx: &Context,
) -> Result<Lists, NodeError> {
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    if settings.bounds == Bounds::None || settings.alpha_cut == 0.0 {
        return Ok(Lists { columns, rows, of: ListsOf::All(order) });
    }
    // (footprint, first column, end of columns) of every row, so that a footprint is looked up once.
    let mut by_row: Vec<Vec<(u32, u16, u16)>> = vec![Vec::new(); rows];
    for (done, index) in order.into_iter().enumerate() {
        if done % (1 << 16) == 0 {
            cx.check()?;
        }
        let reach = projected.reach(index);
        for list in &mut by_row[usize::from(reach.y0)..usize::from(reach.y1)] {
            list.push((index, reach.x0, reach.x1));
        }
    }
    let exact = settings.bounds == Bounds::Exact;
    let bands = cx.for_each_tile(rows, |row| {
        let mut starts = vec![0_u32; columns + 2];
        let entries: Vec<(u32, u16, u16)> = by_row[row]
            .iter()
            .map(|&(index, mut first, mut end)| {
                // Below four columns the blend's own row test is as cheap as this one.
                if exact && end - first > 3 {
                    let footprint = projected.footprint(index);
                    let (left, right) = footprint.extent_in(row * TILE, projected.log2_cut);
                    (first, end) = lens::columns(left, right, (first, end), projected.period);
                }
                for part in around(first, end, columns) {
                    for start in &mut starts[part.start + 2..part.end + 2] {
                        *start += 1;
                    }
                }
                (index, first, end)
            })
            .collect();
        for column in 2..starts.len() {
            starts[column] += starts[column - 1];
        }
        let mut list = vec![0_u32; starts.last().map_or(0, |n| *n as usize)];
        for (index, first, end) in entries {
            for part in around(first, end, columns) {
                for at in &mut starts[part.start + 1..part.end + 1] {
                    list[*at as usize] = index;
                    *at += 1;
                }
            }
        }
        starts.pop();
        Band { starts, list }
    })?;
    Ok(Lists { columns, rows, of: ListsOf::Bands(bands) })
}

/// The columns `first..end`, of which those beyond the last are the first ones again.
#[inline(always)]
fn around(first: u16, end: u16, columns: usize) -> [std::ops::Range<usize>; 2] {
    let (first, end) = (usize::from(first), usize::from(end));
    [first..end.min(columns), 0..end.saturating_sub(columns)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;

    #[test]
    fn order_is_stable_for_keys_of_any_size() {
        let mut state = 7_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state >> 20
        };
        for bits in [0, 3, 12, 31, 44] {
            let keys: Vec<u64> = (0..5000).map(|_| (next() & ((1 << bits) - 1)) | (5 << 50)).collect();
            let mut expected: Vec<u32> = (0..5000).collect();
            expected.sort_by_key(|index| keys[*index as usize]);
            let sorted = order(keys.iter().copied().zip(0..).collect(), &context());
            assert_eq!(sorted.expect("goes on"), expected, "{bits} bits");
        }
        assert!(order(Vec::new(), &context()).expect("goes on").is_empty());
    }
}
