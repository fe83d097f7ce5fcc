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
pub(super) fn order(mut from: Vec<(u64, u32)>) -> Vec<u32> {
    let mask = (1_u64 << DIGIT_BITS) - 1;
    let first = from.first().map_or(0, |item| item.0);
    let varying = from.iter().fold(0, |bits, (key, _)| bits | (key ^ first));
    let mut to = vec![(0, 0); from.len()];
    let mut shift = 0;
    while shift < u64::BITS && varying >> shift != 0 {
        if (varying >> shift) & mask != 0 {
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
    from.into_iter().map(|(_, index)| index).collect()
}

/// The tiles of one view; its rows come after those of the views before it.
struct Grid {
    first_row: usize,
    columns: usize,
    rows: usize,
}

/// The footprints of every tile of every view, front to back.
pub(super) struct Lists {
    grids: Vec<Grid>,
    of: ListsOf,
}

enum ListsOf {
    /// Every tile of a view has all of its footprints; one list a view.
    Views(Vec<Vec<u32>>),
    /// One entry a row of tiles.
    Bands(Vec<Band>),
}

/// The lists of one row of tiles.
struct Band {
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl Lists {
    /// Number of tiles of a view.
    pub(super) fn tiles(&self, view: usize) -> usize {
        self.grids[view].columns * self.grids[view].rows
    }

    /// The list of a tile, and the pixel at its top left.
    pub(super) fn tile(&self, view: usize, tile: usize) -> (&[u32], usize, usize) {
        let grid = &self.grids[view];
        let (row, column) = (tile / grid.columns, tile % grid.columns);
        let list = match &self.of {
            ListsOf::Views(views) => &views[view],
            ListsOf::Bands(bands) => {
                let band = &bands[grid.first_row + row];
                &band.list[band.starts[column] as usize..band.starts[column + 1] as usize]
            }
        };
        (list, column * TILE, row * TILE)
    }

    /// Pairs of a splat and a tile of a view.
    pub(super) fn pairs(&self, view: usize) -> u64 {
        let grid = &self.grids[view];
        match &self.of {
            ListsOf::Views(views) => (views[view].len() * grid.columns * grid.rows) as u64,
            ListsOf::Bands(bands) => {
                let bands = &bands[grid.first_row..grid.first_row + grid.rows];
                bands.iter().map(|band| band.list.len() as u64).sum()
            }
        }
    }
}

/// Lists the footprints by tile, each list in the given order, for views of these widths and heights in pixels.
pub(super) fn bin(
    projected: &Projected,
    order: Vec<u32>,
    sizes: &[(usize, usize)],
    settings: &Settings,
    cx: &Context,
) -> Result<Lists, NodeError> {
    let mut grids: Vec<Grid> = Vec::with_capacity(sizes.len());
    let mut all_rows = 0;
    for (width, height) in sizes {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        grids.push(Grid { first_row: all_rows, columns, rows });
        all_rows += rows;
    }
    if settings.bounds == Bounds::None || settings.alpha_cut == 0.0 {
        let mut views = vec![Vec::new(); grids.len()];
        for index in order {
            views[projected.reach(index).0].push(index);
        }
        return Ok(Lists { grids, of: ListsOf::Views(views) });
    }
    // (footprint, first column, end of columns) of every row, so that a footprint is looked up once.
    let mut by_row: Vec<Vec<(u32, u16, u16)>> = vec![Vec::new(); all_rows];
    for index in order {
        let (view, reach) = projected.reach(index);
        let first = grids[view].first_row;
        for list in &mut by_row[first + usize::from(reach.y0)..first + usize::from(reach.y1)] {
            list.push((index, reach.x0, reach.x1));
        }
    }
    let exact = settings.bounds == Bounds::Exact;
    let bands = cx.for_each_tile(all_rows, |row| {
        let grid = &grids[grids.partition_point(|grid| grid.first_row <= row) - 1];
        let columns = grid.columns;
        let top = (row - grid.first_row) * TILE;
        let mut starts = vec![0_u32; columns + 2];
        let entries: Vec<(u32, u16, u16)> = by_row[row]
            .iter()
            .map(|&(index, mut first, mut end)| {
                // Below four columns the blend's own row test is as cheap as this one.
                if exact && end - first > 3 {
                    let footprint = projected.footprint(index);
                    let (left, right) = footprint.extent_in(top, projected.log2_cut);
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
    Ok(Lists { grids, of: ListsOf::Bands(bands) })
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
            assert_eq!(order(keys.iter().copied().zip(0..).collect()), expected, "{bits} bits");
        }
        assert!(order(Vec::new()).is_empty());
    }
}
