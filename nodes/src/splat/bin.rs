//! A stable sort of the footprints of each row of tiles, then their lists by tile.

use std::ops::Range;

use engine::{Context, NodeError};

use super::lens;
use super::project::{Entry, Projected};
use super::{Bounds, Settings};

/// Side of a tile, in pixels; the INRIA rasterizer's, whose bounds depend on it.
pub const TILE: usize = 16;

/// Values listed by slot, such as rows or columns of tiles: those of slot `i` at `starts[i]..starts[i + 1]`.
#[derive(Default)]
pub(super) struct Listed<T> {
    starts: Vec<u32>,
    values: Vec<T>,
}

impl<T: Copy + Default> Listed<T> {
    /// Lists what `of` makes of each entry and its number, in each slot of two ranges, in the order of the entries.
    #[inline(always)]
    pub(super) fn by<E>(slots: usize, entries: &[E], of: impl Fn(usize, &E) -> (T, [Range<u16>; 2])) -> Self {
        let within =
            |range: Range<u16>, off: usize| usize::from(range.start) + off..usize::from(range.end) + off;
        // Counted two further on, so that the next one holds where a slot's next value goes, and in the end its end.
        let mut starts = vec![0_u32; slots + 2];
        for (number, entry) in entries.iter().enumerate() {
            for range in of(number, entry).1 {
                for count in &mut starts[within(range, 2)] {
                    *count += 1;
                }
            }
        }
        for slot in 2..starts.len() {
            starts[slot] += starts[slot - 1];
        }
        let mut values = vec![T::default(); starts.last().map_or(0, |n| *n as usize)];
        for (number, entry) in entries.iter().enumerate() {
            let (value, ranges) = of(number, entry);
            for range in ranges {
                for start in &mut starts[within(range, 1)] {
                    values[*start as usize] = value;
                    *start += 1;
                }
            }
        }
        starts.pop();
        Self { starts, values }
    }

    /// What is listed in a slot.
    pub(super) fn of(&self, slot: usize) -> &[T] {
        &self.values[self.starts[slot] as usize..self.starts[slot + 1] as usize]
    }
}

/// Bits of a digit of the sort, at most.
const DIGIT_BITS: u32 = 12;

/// Sorts by ascending keys; equal keys stay in their order, which is that of the file. A radix sort from the lowest
/// digit on, which ends early once the run is stopped.
fn sorted(mut from: Vec<Entry>, cx: &Context) -> Vec<Entry> {
    let least = from.iter().fold(u64::MAX, |least, entry| least.min(entry.key));
    let most = from.iter().fold(least, |most, entry| most.max(entry.key));
    let bits = u64::BITS - (most - least).leading_zeros();
    let digit_bits = bits.div_ceil(bits.div_ceil(DIGIT_BITS).max(1)).max(1);
    let mut to = vec![Entry::default(); from.len()];
    let mut starts = vec![0_u32; 1 << digit_bits];
    for low in (0..bits).step_by(digit_bits as usize) {
        if cx.cancelled() {
            break;
        }
        let digit = |entry: &Entry| ((entry.key - least) >> low) as usize & ((1 << digit_bits) - 1);
        starts.fill(0);
        for entry in &from {
            starts[digit(entry)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for entry in &from {
            let at = &mut starts[digit(entry)];
            to[*at as usize] = *entry;
            *at += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
    from
}

/// What touches each of so many rows of tiles, front to back.
pub(super) fn sort(projected: &Projected, rows: usize, cx: &Context) -> Result<Vec<Vec<Entry>>, NodeError> {
    let rows = cx.for_each_tile(rows, |row| sorted(projected.row(row), cx))?;
    cx.check()?;
    Ok(rows)
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
    /// By column, one a row of tiles.
    Rows(Vec<Listed<u32>>),
}

impl Lists {
    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.columns * self.rows
    }

    /// The list of a tile, and its column and row.
    pub(super) fn tile(&self, tile: usize) -> (&[u32], usize, usize) {
        let (row, column) = (tile / self.columns, tile % self.columns);
        let list = match &self.of {
            ListsOf::All(list) => list.as_slice(),
            ListsOf::Rows(rows) => rows[row].of(column),
        };
        (list, column, row)
    }

    /// Pairs of a splat and a tile.
    pub(super) fn pairs(&self) -> u64 {
        match &self.of {
            ListsOf::All(list) => (list.len() * self.tiles()) as u64,
            ListsOf::Rows(rows) => rows.iter().map(|row| row.values.len() as u64).sum(),
        }
    }
}

/// Lists the footprints by tile, in the order in which they are given for each row, of a picture of this width and
/// height in pixels.
pub(super) fn bin(
    projected: &Projected,
    sorted: &[Vec<Entry>],
    (width, height): (usize, usize),
    settings: &Settings,
    cx: &Context,
) -> Result<Lists, NodeError> {
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    if !settings.is_bounded() {
        let all = sorted.iter().flatten().map(|entry| entry.index).collect();
        return Ok(Lists { columns, rows, of: ListsOf::All(all) });
    }
    let exact = settings.bounds == Bounds::Exact;
    let lists = cx.for_each_tile(rows, |row| {
        let mut entries = Vec::with_capacity(sorted[row].len());
        for &Entry { index, x0, x1, .. } in &sorted[row] {
            let mut span = (x0, x1);
            // Below four columns the blend's own row test is as cheap as this one.
            if exact && x1 - x0 > 3 {
                let (left, right) = projected.footprint(index).extent_in(row * TILE, projected.log2_cut);
                span = lens::columns(left, right, span, projected.period);
            }
            entries.push((index, span));
        }
        let last = columns as u16;
        // Columns beyond the last are the first ones again.
        Listed::by(columns, &entries, |_, &(index, (first, end))| {
            (index, [first..end.min(last), 0..end.saturating_sub(last)])
        })
    })?;
    Ok(Lists { columns, rows, of: ListsOf::Rows(lists) })
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
            state >> 1
        };
        for bits in [0, 1, 3, 12, 31, 44, 63] {
            for least in [0, 5 << 50] {
                let entry = |index| Entry { key: (next() >> (63 - bits)) + least, index, x0: 1, x1: 2 };
                let entries: Vec<Entry> = (0..5000).map(entry).collect();
                let mut expected = entries.clone();
                expected.sort_by_key(|entry| entry.key);
                assert_eq!(sorted(entries, &context()), expected, "{bits} bits");
            }
        }
        assert!(sorted(Vec::new(), &context()).is_empty());
    }

    /// Ranges that are empty, that touch the last slot, and two of one entry.
    #[test]
    fn every_slot_lists_its_entries_in_order() {
        let entries = [(0..3, 0..0), (2..2, 0..0), (4..5, 0..2), (1..2, 0..0)];
        let listed = Listed::by(5, &entries, |number, (a, b)| (number as u32 + 1, [a.clone(), b.clone()]));
        let expected: [&[u32]; 5] = [&[1, 3], &[1, 3, 4], &[1], &[], &[3]];
        assert!((0..5).all(|slot| listed.of(slot) == expected[slot]));
    }
}
