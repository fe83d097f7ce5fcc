//! Groups of tiles whose lists are in memory together. For each group: a stable sort of the footprints of each row
//! of tiles, then their lists by tile.

use std::ops::Range;

use engine::{Context, NodeError};

use super::camera_model;
use super::camera_model::TileRange;
use super::project::{Entry, Footprint, Projected};
use super::settings::LIST_BYTES;
use super::{Bounds, Settings};

/// Side of a tile in pixels; that of the INRIA rasterizer, whose bounds depend on it.
pub const TILE: usize = 16;

/// Values listed by slot, such as rows or columns of tiles: those of slot `i` are at `starts[i]..starts[i + 1]`.
pub(super) struct Listed<T> {
    starts: Vec<u32>,
    values: Vec<T>,
}

impl<T: Copy + Default> Listed<T> {
    /// Lists the value of `of` for each entry and its index, in each slot of two ranges, in the order of the
    /// entries.
    #[inline(always)]
    pub(super) fn by<E>(slots: usize, entries: &[E], of: impl Fn(usize, &E) -> (T, [Range<u16>; 2])) -> Self {
        let within =
            |range: Range<u16>, off: usize| usize::from(range.start) + off..usize::from(range.end) + off;
        // Counted two further on, so that the next element holds the position of a slot's next value, and finally
        // its end.
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

    /// The values of a slot.
    pub(super) fn of(&self, slot: usize) -> &[T] {
        &self.values[self.starts[slot] as usize..self.starts[slot + 1] as usize]
    }
}

/// The part of a range within another one, relative to its start.
#[inline(always)]
pub(super) fn clip(range: Range<u16>, within: &Range<usize>) -> Range<u16> {
    let (first, end) = (within.start as u16, within.end as u16);
    let start = range.start.clamp(first, end);
    start - first..range.end.clamp(start, end) - first
}

/// Tiles whose lists are in memory together: a rectangle of rows and columns of tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Group {
    rows: Range<usize>,
    columns: Range<usize>,
}

/// Largest number of bytes of a footprint in the lists of a row of tiles: while sorting, it is held three times.
const ENTRY_BYTES: u64 = 3 * size_of::<Entry>() as u64;
/// Bytes of a footprint in the list of a tile.
const PAIR_BYTES: u64 = size_of::<u32>() as u64;

/// Largest memory for rendering a picture of this size with this number of splats, in addition to the pictures:
/// footprints, keys and ranges, and the lists of one group.
pub(crate) fn most_bytes(splats: u64, (width, height): (u64, u64)) -> u64 {
    let tile = TILE as u64;
    let (columns, rows) = (width.div_ceil(tile), height.div_ceil(tile));
    let held = (size_of::<Footprint>() + size_of::<(u64, TileRange)>()) as u64;
    // A group of one row, or of one tile, may contain each splat once.
    let lists = (rows * (ENTRY_BYTES + columns * PAIR_BYTES)).saturating_mul(splats);
    let bounded = (ENTRY_BYTES + PAIR_BYTES).saturating_mul(splats).saturating_add(LIST_BYTES);
    lists.min(bounded).saturating_add(held.saturating_mul(splats))
}

/// The groups of a picture with this number of columns and rows of tiles: as many rows as the limit of the lists
/// allows, or as many columns of one row, at least one. An ordinary picture is one group.
pub(super) fn groups(
    projected: &Projected,
    (columns, rows): (usize, usize),
    settings: &Settings,
) -> Vec<Group> {
    if !settings.is_bounded() {
        return vec![Group { rows: 0..rows, columns: 0..columns }];
    }
    let most = settings.list_bytes;
    let mut groups: Vec<Group> = Vec::new();
    let mut held = 0;
    for (row, [entries, pairs]) in projected.in_rows(rows).into_iter().enumerate() {
        let bytes = entries * ENTRY_BYTES + pairs * PAIR_BYTES;
        if pairs * PAIR_BYTES > most {
            // As if each of them touched every column: so no part exceeds the limit, wherever they lie.
            let each = (most / (entries * PAIR_BYTES)).max(1) as usize;
            let part = |first: usize| first..(first + each).min(columns);
            let parts = (0..columns).step_by(each).map(part);
            groups.extend(parts.map(|columns| Group { rows: row..row + 1, columns }));
            held = most;
        } else if let Some(last) = groups.last_mut().filter(|_| held + bytes <= most) {
            last.rows.end = row + 1;
            held += bytes;
        } else {
            groups.push(Group { rows: row..row + 1, columns: 0..columns });
            held = bytes;
        }
    }
    groups
}

/// Largest number of bits per digit of the sort.
const DIGIT_BITS: u32 = 12;

/// Sorts by ascending keys; equal keys keep the order of the file. A radix sort from the lowest digit, which ends
/// early when the run is cancelled.
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

/// The footprints that touch each row of a group, front to back; without bounds, the single row has all.
pub(super) fn sort(
    projected: &Projected,
    group: &Group,
    settings: &Settings,
    cx: &Context,
) -> Result<Vec<Vec<Entry>>, NodeError> {
    let rows = if settings.is_bounded() { group.rows.clone() } else { 0..1 };
    let listed = projected.listed(&rows, cx)?;
    let rows = cx.for_each_tile(rows.len(), |row| {
        let parts: Vec<&[Entry]> = listed.iter().map(|chunk| chunk.of(row)).collect();
        sorted(parts.concat(), cx)
    })?;
    cx.check()?;
    Ok(rows)
}

/// The footprints of every tile of a group, front to back.
pub(super) struct Lists<'a> {
    group: &'a Group,
    of: ListsOf,
}

enum ListsOf {
    /// All footprints, for every tile.
    All(Vec<u32>),
    /// By column, one list per row of tiles.
    Rows(Vec<Listed<u32>>),
}

impl Lists<'_> {
    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.group.columns.len() * self.group.rows.len()
    }

    /// The list of a tile, and its column and row in the picture.
    pub(super) fn tile(&self, tile: usize) -> (&[u32], usize, usize) {
        let Group { rows, columns } = self.group;
        let (row, column) = (tile / columns.len(), tile % columns.len());
        let list = match &self.of {
            ListsOf::All(list) => list.as_slice(),
            ListsOf::Rows(lists) => lists[row].of(column),
        };
        (list, columns.start + column, rows.start + row)
    }

    /// Number of pairs of a splat and a tile.
    pub(super) fn pairs(&self) -> u64 {
        match &self.of {
            ListsOf::All(list) => (list.len() * self.tiles()) as u64,
            ListsOf::Rows(rows) => rows.iter().map(|row| row.values.len() as u64).sum(),
        }
    }
}

/// Lists the footprints of a group by tile, in their order in each row.
pub(super) fn bin<'a>(
    projected: &Projected,
    sorted: &[Vec<Entry>],
    group: &'a Group,
    columns: usize,
    settings: &Settings,
    cx: &Context,
) -> Result<Lists<'a>, NodeError> {
    if !settings.is_bounded() {
        let all = sorted.iter().flatten().map(|entry| entry.index).collect();
        return Ok(Lists { group, of: ListsOf::All(all) });
    }
    let exact = settings.bounds == Bounds::Exact;
    let lists = cx.for_each_tile(group.rows.len(), |row| {
        let mut entries = Vec::with_capacity(sorted[row].len());
        for &Entry { index, x0, x1, .. } in &sorted[row] {
            let mut span = (x0, x1);
            // Below four columns, the row test of the blend is as cheap as this one.
            if exact && x1 - x0 > 3 {
                let (left, right) =
                    projected.footprint(index).extent_in((group.rows.start + row) * TILE, projected.log2_cut);
                span = camera_model::columns(left, right, span, projected.period);
            }
            entries.push((index, span));
        }
        let last = columns as u16;
        // Columns beyond the last wrap around.
        Listed::by(group.columns.len(), &entries, |_, &(index, (first, end))| {
            let ranges = [first..end.min(last), 0..end.saturating_sub(last)];
            (index, ranges.map(|range| clip(range, &group.columns)))
        })
    })?;
    Ok(Lists { group, of: ListsOf::Rows(lists) })
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
