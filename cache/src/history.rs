//! [`Book`]: many small notes in one entry of the log, such as one about each node of a graph.

use std::collections::{BTreeMap, HashMap};

use crate::digest::Digest;
use crate::entry::MAX_PAYLOAD;
use crate::fold::Fold;

/// The notes of one book: name and value of each, with their lengths before them.
#[derive(Debug, Default)]
pub(crate) struct Book {
    stored: Vec<u8>,
    /// Where a note starts, by a hash of its name.
    places: HashMap<u64, usize, std::hash::BuildHasherDefault<Fold>>,
    /// What is not in `stored` yet.
    written: BTreeMap<String, Vec<u8>>,
}

impl Book {
    /// What a book is stored under.
    pub fn key(name: &str) -> Digest {
        Digest::of(name.as_bytes())
    }

    /// Reads the payload of an entry, as far as it makes sense.
    pub fn open(stored: Vec<u8>) -> Book {
        let mut book = Book { stored, ..Book::default() };
        // A note about a node takes at least this much.
        book.places.reserve(book.stored.len() / 64);
        let mut at = 0;
        while let Some((name, value)) = note(&book.stored, at) {
            let next = at + 8 + name.len() + value.len();
            let hash = hash(name);
            book.places.insert(hash, at);
            at = next;
        }
        book.stored.truncate(at);
        book
    }

    /// What is stored, note by note.
    pub fn notes(&self) -> impl Iterator<Item = (&[u8], &[u8])> {
        let mut at = 0;
        std::iter::from_fn(move || {
            let (name, value) = note(&self.stored, at)?;
            at += 8 + name.len() + value.len();
            Some((name, value))
        })
    }

    /// The note of this name.
    pub fn get(&self, name: &str) -> Option<&[u8]> {
        if let Some(value) = self.written.get(name) {
            return Some(value);
        }
        let (found, value) = note(&self.stored, *self.places.get(&hash(name.as_bytes()))?)?;
        (found == name.as_bytes()).then_some(value)
    }

    /// Writes a note, replacing what was there.
    pub fn put(&mut self, name: &str, value: &[u8]) {
        self.written.insert(name.to_owned(), value.to_vec());
    }

    /// Whether something has to be stored.
    pub fn is_changed(&self) -> bool {
        !self.written.is_empty()
    }

    /// The payload to store: `latest`, which may be another process's, with what was written here. Where that
    /// is too long only the latter, and where that is, too, nothing: notes may be lost.
    pub fn encode(&self, latest: Vec<u8>) -> Vec<u8> {
        let latest = Book::open(latest);
        let mut bytes = Vec::with_capacity(latest.stored.len());
        for (name, value) in latest.notes() {
            if !str::from_utf8(name).is_ok_and(|name| self.written.contains_key(name)) {
                write(&mut bytes, name, value);
            }
        }
        let old = bytes.len();
        self.written.iter().for_each(|(name, value)| write(&mut bytes, name.as_bytes(), value));
        if bytes.len() > MAX_PAYLOAD {
            bytes.drain(..old);
        }
        if bytes.len() <= MAX_PAYLOAD { bytes } else { Vec::new() }
    }
}

fn write(bytes: &mut Vec<u8>, name: &[u8], value: &[u8]) {
    bytes.extend_from_slice(&(name.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&(value.len() as u32).to_le_bytes());
    bytes.extend_from_slice(name);
    bytes.extend_from_slice(value);
}

fn note(bytes: &[u8], at: usize) -> Option<(&[u8], &[u8])> {
    let (lengths, rest) = bytes.get(at..)?.split_first_chunk::<8>()?;
    let [a, b, c, d, e, f, g, h] = *lengths;
    let (name, value) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
    let (name, rest) = rest.split_at_checked(name as usize)?;
    Some((name, rest.get(..value as usize)?))
}

/// FNV-1a: names are short. Two of one hash only hide one of them.
fn hash(name: &[u8]) -> u64 {
    name.iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_are_replaced_merged_and_read_back() {
        let mut book = Book::default();
        assert_eq!((book.get("a"), book.is_changed()), (None, false));
        book.put("a", b"1");
        book.put("b", b"");
        book.put("a", b"22");
        assert_eq!(
            (book.get("a"), book.get("b"), book.is_changed()),
            (Some(&b"22"[..]), Some(&b""[..]), true)
        );
        let stored = book.encode(Vec::new());
        let mut other = Book::open(stored.clone());
        assert_eq!((other.get("a"), other.get("b"), other.get("")), (Some(&b"22"[..]), Some(&b""[..]), None));
        other.put("b", b"new");
        other.put("c", b"more");
        let merged = Book::open(other.encode(stored));
        let found = ["a", "b", "c"].map(|name| merged.get(name).unwrap());
        assert_eq!(found, [&b"22"[..], b"new", b"more"]);
    }

    #[test]
    fn nonsense_ends_a_book_and_too_much_is_given_up() {
        let mut book = Book::default();
        book.put("a", b"1");
        let mut stored = book.encode(Vec::new());
        for cut in 0..stored.len() {
            assert_eq!(Book::open(stored[..cut].to_vec()).get("a"), None);
        }
        stored.extend_from_slice(&[0xff; 20]);
        assert_eq!(Book::open(stored.clone()).get("a"), Some(&b"1"[..]));
        let mut large = Book::default();
        large.put("b", &vec![0; MAX_PAYLOAD - 100]);
        assert!(Book::open(large.encode(stored.clone())).get("a").is_some());
        large.put("c", &[0; 100]);
        assert_eq!(large.encode(stored), []);
    }
}
