//! Groups of tiles whose lists are in memory at the same time. For each group, the footprints of each row of tiles
//! are sorted by a stable sort and then listed by tile.

use std::ops::Range;

use engine::{Context, NodeError};

use super::camera_model;
use super::camera_model::TileRange;
use super::listed::{Listed, clip};
use super::project::{Entry, Footprint, Projected};
use super::settings::{Bounds, LIST_BYTES, Settings, TILE};

/// A rectangle of tiles whose lists are in memory at the same time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Group {
    rows: Range<usize>,
    columns: Range<usize>,
}

/// Maximum memory for each footprint in the list of a row of tiles, in bytes. There are three copies of each entry
/// during sorting.
const ENTRY_BYTES: u64 = 3 * size_of::<Entry>() as u64;
/// Memory for each footprint in the list of a tile, in bytes.
const PAIR_BYTES: u64 = size_of::<u32>() as u64;

/// Maximum memory for rendering a picture of this size with this number of splats, in bytes: footprints, keys and
/// ranges, and the lists of one group. The picture itself is not included.
pub fn most_bytes(splats: u64, (width, height): (u64, u64)) -> u64 {
    let tile = TILE as u64;
    let (columns, rows) = (width.div_ceil(tile), height.div_ceil(tile));
    let held = (size_of::<Footprint>() + size_of::<(u64, TileRange)>()) as u64;
    // A group of one row or one tile contains each splat at most once.
    let lists = (rows * (ENTRY_BYTES + columns * PAIR_BYTES)).saturating_mul(splats);
    let bounded = (ENTRY_BYTES + PAIR_BYTES).saturating_mul(splats).saturating_add(LIST_BYTES);
    lists.min(bounded).saturating_add(held.saturating_mul(splats))
}

/// Divides a picture of `columns` by `rows` tiles into groups. A group has as many rows as the memory limit of the
/// lists allows. If a single row exceeds the limit, the row is divided into groups of as many columns as the limit
/// allows, but at least one. An ordinary picture is one group.
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
            // Computed as if each footprint touched every column, so that no part exceeds the limit.
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

/// Sorts by ascending keys; entries with equal keys stay in file order. This is a radix sort from the lowest digit,
/// and it stops early if the run is cancelled.
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

/// For each row of tiles of a group, the footprints that touch it, front to back. If the settings have no bounds,
/// there is a single row that contains all footprints.
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

/// Footprints of every tile of a group, front to back.
pub(super) struct Lists<'a> {
    group: &'a Group,
    of: ListsOf,
}

enum ListsOf {
    /// A single list of all footprints, which all tiles share.
    All(Vec<u32>),
    /// For each row of tiles, one list per column.
    Rows(Vec<Listed<u32>>),
}

impl Lists<'_> {
    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.group.columns.len() * self.group.rows.len()
    }

    /// List of a tile, and its column and row in the picture.
    pub(super) fn tile(&self, tile: usize) -> (&[u32], usize, usize) {
        let Group { rows, columns } = self.group;
        let (row, column) = (tile / columns.len(), tile % columns.len());
        let list = match &self.of {
            ListsOf::All(list) => list.as_slice(),
            ListsOf::Rows(lists) => lists[row].of(column),
        };
        (list, columns.start + column, rows.start + row)
    }

    /// Number of pairs of a tile and a splat in its list.
    pub(super) fn pairs(&self) -> u64 {
        match &self.of {
            ListsOf::All(list) => (list.len() * self.tiles()) as u64,
            ListsOf::Rows(rows) => rows.iter().map(|row| row.len() as u64).sum(),
        }
    }
}

/// Lists the footprints of a group by tile, in the order of `sorted`.
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
            // For fewer than four columns, the test per row in the blend stage is as cheap as this one.
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
    use testing::context;

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
}
