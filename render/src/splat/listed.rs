//! Lists of values, one for each of several slots (such as rows or columns of tiles), built by a counting sort.

use std::ops::Range;

/// Values listed by slot. The values of slot `i` are at `starts[i]..starts[i + 1]`.
pub(super) struct Listed<T> {
    starts: Vec<u32>,
    values: Vec<T>,
}

impl<T: Copy + Default> Listed<T> {
    /// Builds the lists. `of` receives the index of an entry and the entry, and returns a value and two ranges of
    /// slots. The value is listed in each slot of both ranges. The values of a slot are in the order of the
    /// entries.
    #[inline(always)]
    pub(super) fn by<E>(slots: usize, entries: &[E], of: impl Fn(usize, &E) -> (T, [Range<u16>; 2])) -> Self {
        let within =
            |range: Range<u16>, off: usize| usize::from(range.start) + off..usize::from(range.end) + off;
        // The values of slot `i` are counted in `starts[i + 2]`. Then `starts[i + 1]` holds the position of the
        // next value of the slot, and finally the end of the slot.
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

    /// Total number of values in all slots.
    pub(super) fn len(&self) -> usize {
        self.values.len()
    }

    /// The values of a slot.
    pub(super) fn of(&self, slot: usize) -> &[T] {
        &self.values[self.starts[slot] as usize..self.starts[slot + 1] as usize]
    }
}

/// Intersection of two ranges, relative to the start of `within`.
#[inline(always)]
pub(super) fn clip(range: Range<u16>, within: &Range<usize>) -> Range<u16> {
    let (first, end) = (within.start as u16, within.end as u16);
    let start = range.start.clamp(first, end);
    start - first..range.end.clamp(start, end) - first
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slots list their entries in order, including for empty ranges, for ranges that reach the last slot, and for
    /// entries with two ranges.
    #[test]
    fn every_slot_lists_its_entries_in_order() {
        let entries = [(0..3, 0..0), (2..2, 0..0), (4..5, 0..2), (1..2, 0..0)];
        let listed = Listed::by(5, &entries, |number, (a, b)| (number as u32 + 1, [a.clone(), b.clone()]));
        let expected: [&[u32]; 5] = [&[1, 3], &[1, 3, 4], &[1], &[], &[3]];
        assert!((0..5).all(|slot| listed.of(slot) == expected[slot]));
    }
}
