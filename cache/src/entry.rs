//! [`Entry`]: one entry of a log. This module encodes and decodes entries, and finds entries in a damaged file. The
//! layout is in the documentation of the crate.

use crate::digest::Digest;

/// The length in bytes of the fields that precede the payload of an entry.
pub(crate) const HEAD: usize = 64;

/// The maximum length of a payload in bytes. An entry that claims a greater length is treated as damaged, so that a
/// flipped bit in the length cannot cause gigabytes to be read.
pub(crate) const MAX_PAYLOAD: usize = 16 << 20;

const MAGIC: &[u8; 4] = b"LHe1";

/// An entry found in a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Entry<'a> {
    pub kind: u8,
    pub key: Digest,
    pub payload: &'a [u8],
}

impl Entry<'_> {
    /// The length in bytes of an entry with a payload of `payload` bytes.
    pub fn length(payload: usize) -> usize {
        HEAD + payload
    }

    /// Appends the entry to `out`, with checksums that start from `salt`.
    pub fn encode(&self, salt: u32, out: &mut Vec<u8>) {
        let mut rest = [0; HEAD - 12];
        rest[..4].copy_from_slice(&(self.payload.len() as u32).to_le_bytes());
        rest[4] = self.kind;
        rest[20..].copy_from_slice(self.key.as_bytes());
        let payload_sum = checksum(!salt, &[self.payload]).to_le_bytes();
        let head_sum = checksum(salt, &[&payload_sum, &rest]).to_le_bytes();
        for part in [MAGIC, &head_sum, &payload_sum, &rest[..], self.payload] {
            out.extend_from_slice(part);
        }
    }
}

/// Decodes the entry at the start of `bytes`. Returns `None` if the entry is incomplete or damaged.
pub(crate) fn decode(salt: u32, bytes: &[u8]) -> Option<Entry<'_>> {
    let head = bytes.first_chunk::<HEAD>()?;
    let payload = bytes.get(HEAD..length_in(salt, head)?)?;
    let whole = payload.len() <= MAX_PAYLOAD && number(head, 8) == checksum(!salt, &[payload]);
    let key = Digest::from_bytes(*head.last_chunk()?);
    whole.then_some(Entry { kind: head[16], key, payload })
}

/// The total length in bytes of the entry with this head; `None` if the head is damaged.
fn length_in(salt: u32, head: &[u8; HEAD]) -> Option<usize> {
    let good = head.starts_with(MAGIC) && number(head, 4) == checksum(salt, &[&head[8..]]);
    good.then(|| Entry::length(number(head, 12) as usize))
}

fn number(head: &[u8; HEAD], at: usize) -> u32 {
    u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]])
}

/// The result of [`scan`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scanned {
    /// Offset of the end of the last complete entry. Bytes after it may belong to an entry that is still being
    /// written.
    pub end: usize,
    /// Number of bytes before `end` that belong to incomplete entries, left by a killed writer or a full disk.
    pub torn: usize,
    /// Number of bytes before `end` that belong to neither complete nor incomplete entries.
    pub damaged: usize,
}

/// Calls `found` for every complete entry in `bytes`, with the entry's offset. Damage to the file affects only the
/// entries that contain the damaged bytes.
pub(crate) fn scan<'a>(salt: u32, bytes: &'a [u8], mut found: impl FnMut(usize, Entry<'a>)) -> Scanned {
    let (mut at, mut end, mut torn, mut damaged) = (0, 0, 0, 0);
    while at < bytes.len() {
        if let Some(entry) = decode(salt, &bytes[at..]) {
            found(at, entry);
            let cut = torn_bytes(salt, &bytes[end..at]);
            torn += cut;
            damaged += at - end - cut;
            at += Entry::length(entry.payload.len());
            end = at;
        } else {
            at = next_magic(bytes, at + 1);
        }
    }
    // An entry that is being written is not longer than the maximum, so bytes further from the end than that are
    // damage.
    let unfinished = bytes.len().saturating_sub(Entry::length(MAX_PAYLOAD));
    if unfinished > end {
        damaged += unfinished - end;
        end = unfinished;
    }
    Scanned { end, torn, damaged }
}

/// Number of bytes in the gap between two complete entries that belong to incomplete entries. An incomplete entry
/// is either an undamaged head whose payload would extend beyond the next head or beyond the gap, or only the
/// beginning of a head.
fn torn_bytes(salt: u32, gap: &[u8]) -> usize {
    let length_at = |at: usize| gap[at..].first_chunk::<HEAD>().and_then(|head| length_in(salt, head));
    let (mut at, mut torn) = (0, 0);
    while at < gap.len() {
        let mut next = next_magic(gap, at + 1);
        while next < gap.len() && length_at(next).is_none() {
            next = next_magic(gap, next + 1);
        }
        let piece = &gap[at..next];
        let cut = match length_at(at) {
            Some(length) => length > piece.len(),
            None => piece.len() < HEAD && MAGIC.iter().zip(piece).all(|(a, b)| a == b),
        };
        if cut {
            torn += piece.len();
        }
        at = next;
    }
    torn
}

/// Offset of the next occurrence of the magic number, at or after `from`. Returns the length of `bytes` if there is
/// none.
fn next_magic(bytes: &[u8], from: usize) -> usize {
    let next = bytes[from..].windows(MAGIC.len()).position(|window| window == MAGIC);
    next.map_or(bytes.len(), |skip| from + skip)
}

/// CRC-32 of the concatenation of `parts`, started from `start`.
pub(crate) fn checksum(start: u32, parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new_with_initial(start);
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(count: u8) -> (Vec<u8>, Vec<usize>) {
        let (mut bytes, mut starts) = (Vec::new(), Vec::new());
        for n in 0..count {
            starts.push(bytes.len());
            let payload = vec![n; usize::from(n) * 3];
            Entry { kind: 1, key: Digest::of(&[n]), payload: &payload }.encode(7, &mut bytes);
        }
        (bytes, starts)
    }

    fn found(bytes: &[u8]) -> (Vec<usize>, Scanned) {
        let mut starts = Vec::new();
        let scanned = scan(7, bytes, |at, entry| {
            assert_eq!(entry.key, Digest::of(&[entry.payload.first().copied().unwrap_or(0)]));
            starts.push(at);
        });
        (starts, scanned)
    }

    #[test]
    fn damage_costs_only_its_own_entry() {
        let (bytes, starts) = log(6);
        assert_eq!(found(&bytes), (starts.clone(), Scanned { end: bytes.len(), torn: 0, damaged: 0 }));
        for at in 0..bytes.len() {
            for flip in [1, 0x80, 0xff] {
                let mut bad = bytes.clone();
                bad[at] ^= flip;
                let hit = starts.partition_point(|start| *start <= at) - 1;
                let mut kept = starts.clone();
                kept.remove(hit);
                assert_eq!(found(&bad).0, kept, "byte {at}");
            }
        }
    }

    #[test]
    fn a_torn_tail_is_left_for_later() {
        let (bytes, starts) = log(6);
        for end in 0..bytes.len() {
            let whole = starts.partition_point(|start| *start <= end) - 1;
            let scanned = Scanned { end: starts[whole], torn: 0, damaged: 0 };
            assert_eq!(found(&bytes[..end]), (starts[..whole].to_vec(), scanned), "cut at {end}");
        }
    }

    #[test]
    fn what_follows_an_entry_cut_short_is_found_and_the_cut_one_is_no_damage() {
        let (bytes, starts) = log(6);
        let last = &bytes[starts[5]..];
        for cut in starts[4]..starts[5] {
            let torn = cut - starts[4];
            let joined = [&bytes[..cut], last].concat();
            let expected = Scanned { end: joined.len(), torn, damaged: 0 };
            assert_eq!(found(&joined), ([&starts[..4], &[cut]].concat(), expected), "cut at {cut}");
            // Two entries cut short in a row, where the head of each is complete.
            if torn < HEAD {
                continue;
            }
            let twice = [&bytes[..cut], &bytes[starts[4]..cut], last].concat();
            let scanned = found(&twice).1;
            assert_eq!((scanned.torn, scanned.damaged), (2 * torn, 0), "cut at {cut}");
        }
        // A flipped bit is damage, whatever follows.
        for at in starts[4]..starts[5] {
            let mut bad = bytes.clone();
            bad[at] ^= 0x10;
            let scanned = found(&bad).1;
            assert_eq!((scanned.torn, scanned.damaged), (0, starts[5] - starts[4]), "byte {at}");
        }
    }

    #[test]
    fn an_entry_of_another_log_is_not_one_of_ours() {
        let mut inner = Vec::new();
        Entry { kind: 1, key: Digest::of(b"k"), payload: b"lie" }.encode(8, &mut inner);
        let mut bytes = Vec::new();
        Entry { kind: 1, key: Digest::of(&inner[..1]), payload: &inner }.encode(7, &mut bytes);
        bytes[0] ^= 1;
        assert_eq!(found(&bytes).0, []);
    }
}
