//! [`Table`]: a table of many small values that is stored as one entry of the log. A table can contain, for
//! example, one value per node of a graph.

use std::collections::{BTreeMap, HashMap};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::digest::Digest;
use crate::digest_hasher::DigestHasher;
use crate::entry::MAX_PAYLOAD;

/// Name of the table that contains the time of the last use of every other table. Each row has the key of a table
/// as its name, and the time in seconds since 1970, in 8 bytes, as its value.
pub(crate) const USED: &str = "used";

/// Rows that each consist of a name and a value. A row is stored as the length of the name, the length of the
/// value, the name, and the value.
#[derive(Debug, Default)]
pub(crate) struct Table {
    stored: Vec<u8>,
    /// Offset of each row in `stored`, by a hash of the row's name.
    offsets: HashMap<u64, usize, std::hash::BuildHasherDefault<DigestHasher>>,
    /// New rows, which are not in `stored` yet.
    written: BTreeMap<String, Vec<u8>>,
    /// True if rows were removed from `stored`.
    trimmed: bool,
}

impl Table {
    /// The key under which the table called `name` is stored.
    pub fn key(name: &str) -> Digest {
        Digest::of(name.as_bytes())
    }

    /// Reads the payload of an entry, up to the first malformed row.
    pub fn open(stored: Vec<u8>) -> Table {
        let mut table = Table { stored, ..Table::default() };
        // A row about a node has at least this many bytes.
        table.offsets.reserve(table.stored.len() / 64);
        let mut at = 0;
        while let Some((name, value)) = row(&table.stored, at) {
            let next = at + row_length(name, value);
            let hash = hash(name);
            table.offsets.insert(hash, at);
            at = next;
        }
        table.stored.truncate(at);
        table
    }

    /// The names and values of the stored rows, in the order in which they were written.
    pub fn rows(&self) -> impl Iterator<Item = (&[u8], &[u8])> {
        let mut at = 0;
        std::iter::from_fn(move || {
            let (name, value) = row(&self.stored, at)?;
            at += row_length(name, value);
            Some((name, value))
        })
    }

    /// The value of the row called `name`.
    pub fn get(&self, name: &str) -> Option<&[u8]> {
        if let Some(value) = self.written.get(name) {
            return Some(value);
        }
        let (found, value) = row(&self.stored, *self.offsets.get(&hash(name.as_bytes()))?)?;
        (found == name.as_bytes()).then_some(value)
    }

    /// Sets the value of the row called `name`, replacing any previous value.
    pub fn put(&mut self, name: &str, value: &[u8]) {
        self.written.insert(name.to_owned(), value.to_vec());
    }

    /// If there are more than `limit` rows in total, removes every row for whose name `keep` returns false.
    pub fn trim(&mut self, limit: usize, keep: impl Fn(&str) -> bool) {
        let new = self.written.keys().filter(|name| self.get_stored(name).is_none()).count();
        if self.offsets.len() + new <= limit {
            return;
        }
        let mut bytes = Vec::new();
        for (name, value) in self.rows().filter(|(name, _)| str::from_utf8(name).is_ok_and(&keep)) {
            write(&mut bytes, name, value);
        }
        let mut written = std::mem::take(&mut self.written);
        written.retain(|name, _| keep(name));
        *self = Table { written, trimmed: true, ..Table::open(bytes) };
    }

    fn get_stored(&self, name: &str) -> Option<usize> {
        self.offsets.get(&hash(name.as_bytes())).copied()
    }

    /// True if there are changes to store.
    pub fn is_changed(&self) -> bool {
        self.trimmed || !self.written.is_empty()
    }

    /// The payload to store. It contains the rows of `latest` and the new rows of this table. A new row replaces a
    /// row of the same name. `latest` is the payload that is stored now, and may have been written by another
    /// process. If this table was trimmed, its own stored rows are used instead of `latest`. If the payload would
    /// be too long, the oldest rows are left out.
    pub fn encode(&self, latest: Vec<u8>) -> Vec<u8> {
        let latest = Table::open(if self.trimmed { self.stored.clone() } else { latest });
        let kept = |(name, _): &(&[u8], &[u8])| {
            !str::from_utf8(name).is_ok_and(|name| self.written.contains_key(name))
        };
        let old = latest.rows().filter(kept);
        let new = self.written.iter().map(|(name, value)| (name.as_bytes(), value.as_slice()));
        let rows: Vec<_> = old.chain(new).collect();
        let mut excess = rows.iter().map(|(name, value)| row_length(name, value)).sum::<usize>();
        let mut bytes = Vec::with_capacity(excess.min(MAX_PAYLOAD));
        for (name, value) in rows {
            if excess > MAX_PAYLOAD {
                excess -= row_length(name, value);
            } else {
                write(&mut bytes, name, value);
            }
        }
        bytes
    }
}

fn row_length(name: &[u8], value: &[u8]) -> usize {
    8 + name.len() + value.len()
}

fn write(bytes: &mut Vec<u8>, name: &[u8], value: &[u8]) {
    bytes.extend_from_slice(&(name.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&(value.len() as u32).to_le_bytes());
    bytes.extend_from_slice(name);
    bytes.extend_from_slice(value);
}

fn row(bytes: &[u8], at: usize) -> Option<(&[u8], &[u8])> {
    let (lengths, rest) = bytes.get(at..)?.split_first_chunk::<8>()?;
    let [a, b, c, d, e, f, g, h] = *lengths;
    let (name, value) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
    let (name, rest) = rest.split_at_checked(name as usize)?;
    Some((name, rest.get(..value as usize)?))
}

/// The FNV-1a hash of a name, which is fast for short names. If the names of two rows have the same hash, only the
/// later row is found.
fn hash(name: &[u8]) -> u64 {
    name.iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3))
}

/// Seconds from 1970 to `time`; 0 for earlier times. A time in the future is replaced with the current time, so
/// that a wrong clock does not cause results to be kept longer.
pub(crate) fn seconds(time: SystemTime) -> u64 {
    let now = SystemTime::now();
    time.min(now).duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_replaced_merged_and_read_back() {
        let mut table = Table::default();
        assert_eq!((table.get("a"), table.is_changed()), (None, false));
        table.put("a", b"1");
        table.put("b", b"");
        table.put("a", b"22");
        assert_eq!(
            (table.get("a"), table.get("b"), table.is_changed()),
            (Some(&b"22"[..]), Some(&b""[..]), true)
        );
        let stored = table.encode(Vec::new());
        let mut other = Table::open(stored.clone());
        assert_eq!((other.get("a"), other.get("b"), other.get("")), (Some(&b"22"[..]), Some(&b""[..]), None));
        other.put("b", b"new");
        other.put("c", b"more");
        let merged = Table::open(other.encode(stored));
        let found = ["a", "b", "c"].map(|name| merged.get(name).unwrap());
        assert_eq!(found, [&b"22"[..], b"new", b"more"]);
    }

    #[test]
    fn nonsense_ends_a_table() {
        let mut table = Table::default();
        table.put("a", b"1");
        let mut stored = table.encode(Vec::new());
        for cut in 0..stored.len() {
            assert_eq!(Table::open(stored[..cut].to_vec()).get("a"), None);
        }
        stored.extend_from_slice(&[0xff; 20]);
        assert_eq!(Table::open(stored).get("a"), Some(&b"1"[..]));
    }

    #[test]
    fn too_long_a_table_loses_the_rows_written_longest_ago_and_no_more() {
        let mut stored = Vec::new();
        for name in ["a", "b", "c"] {
            let mut table = Table::open(stored.clone());
            table.put(name, &vec![0; MAX_PAYLOAD / 4]);
            stored = table.encode(stored);
        }
        let mut table = Table::open(stored.clone());
        table.put("d", &vec![1; MAX_PAYLOAD / 4]);
        let stored = table.encode(stored);
        assert!(stored.len() <= MAX_PAYLOAD);
        let found = Table::open(stored);
        assert_eq!(["a", "b", "c", "d"].map(|name| found.get(name).is_some()), [false, true, true, true]);
        let mut large = Table::default();
        large.put("e", &vec![0; MAX_PAYLOAD]);
        assert_eq!(large.encode(Vec::new()), []);
    }

    #[test]
    fn a_table_that_is_trimmed_holds_what_is_kept() {
        let mut table = Table::default();
        ["a", "b", "c"].iter().for_each(|name| table.put(name, b"old"));
        let mut table = Table::open(table.encode(Vec::new()));
        table.put("c", b"new");
        table.put("d", b"new");
        table.trim(4, |_| false);
        assert_eq!(table.get("a"), Some(&b"old"[..]), "not beyond the limit");
        table.trim(3, |name| matches!(name, "b" | "c"));
        assert_eq!(["a", "d"].map(|name| table.get(name)), [None; 2]);
        let stored = table.encode(Table::default().encode(Vec::new()));
        let found: Vec<_> = Table::open(stored).rows().map(|(name, value)| [name, value].concat()).collect();
        assert_eq!(found, [b"bold".to_vec(), b"cnew".to_vec()]);
    }
}
