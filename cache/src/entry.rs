//! One entry of a log as bytes: encode, decode, and find in a damaged file. The crate's
//! documentation has the layout.

use crate::digest::Digest;

/// Bytes before the payload.
pub(crate) const HEAD: usize = 64;

/// The longest payload in bytes. A length beyond it is damage, so that a flipped bit cannot claim gigabytes.
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
    /// The bytes that an entry with this payload takes.
    pub fn length(payload: usize) -> usize {
        HEAD + payload
    }

    /// Appends the entry to `out`, checksummed under `salt`.
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

/// The entry that starts at the first byte, if a whole and undamaged one does.
pub(crate) fn decode(salt: u32, bytes: &[u8]) -> Option<Entry<'_>> {
    let head = bytes.first_chunk::<HEAD>()?;
    let number = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    if !head.starts_with(MAGIC) || number(4) != checksum(salt, &[&head[8..]]) {
        return None;
    }
    let payload = bytes.get(HEAD..Entry::length(number(12) as usize))?;
    let whole = payload.len() <= MAX_PAYLOAD && number(8) == checksum(!salt, &[payload]);
    let key = Digest::from_bytes(*head.last_chunk()?);
    whole.then_some(Entry { kind: head[16], key, payload })
}

/// What [`scan`] made of some bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scanned {
    /// How far the bytes are understood. What follows may be an entry that is still being written.
    pub end: usize,
    /// How many bytes before `end` belong to no entry.
    pub damaged: usize,
}

/// Reports every whole entry in `bytes` with where it starts. Damage costs only the entries it lies in.
pub(crate) fn scan<'a>(salt: u32, bytes: &'a [u8], mut found: impl FnMut(usize, Entry<'a>)) -> Scanned {
    let (mut at, mut end, mut damaged) = (0, 0, 0);
    while at < bytes.len() {
        if let Some(entry) = decode(salt, &bytes[at..]) {
            found(at, entry);
            damaged += at - end;
            at += Entry::length(entry.payload.len());
            end = at;
        } else {
            let next = bytes[at + 1..].windows(MAGIC.len()).position(|window| window == MAGIC);
            at = next.map_or(bytes.len(), |skip| at + 1 + skip);
        }
    }
    // No entry being written can be longer than the longest, so what lies further back is damage.
    let hopeless = bytes.len().saturating_sub(Entry::length(MAX_PAYLOAD));
    if hopeless > end {
        damaged += hopeless - end;
        end = hopeless;
    }
    Scanned { end, damaged }
}

/// CRC-32 of `parts` one after another.
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
        assert_eq!(found(&bytes), (starts.clone(), Scanned { end: bytes.len(), damaged: 0 }));
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
            let scanned = Scanned { end: starts[whole], damaged: 0 };
            assert_eq!(found(&bytes[..end]), (starts[..whole].to_vec(), scanned), "cut at {end}");
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
