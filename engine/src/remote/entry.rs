//! Entries: the form in which results are sent to other machines.

use cache::{Digest, Store};

use crate::record::record::{Record, digest, read_digest};
use crate::value::codec::{Corrupt, Decoder, Encoder};

/// First bytes of every entry. They change whenever the encoding changes.
const MAGIC: &str = "lightharmony entry 1";

/// The result of a key: the record with its manifest, and the lengths of the stored values.
///
/// The encoding is `MAGIC`, the key, the lengths, the record. The digest of the encoding covers everything, since
/// the record contains the digests of the values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// The key of the result.
    pub key: Digest,
    /// The lengths in bytes of the stored values, in the order in which [`blobs_of`](crate::blobs_of) returns their
    /// digests.
    pub lengths: Vec<u64>,
    /// The record, as in the store.
    pub record: Vec<u8>,
}

impl Entry {
    /// The entry of a result in the store; `None` if the record or one of the values is missing or damaged.
    pub fn stored(store: &Store, key: &Digest) -> Option<Self> {
        let record = store.get_record(key)?;
        let length = |digest: &Digest| Some(store.get_blob(digest).ok()??.len() as u64);
        let lengths = Record::stored_blobs(&record).ok()?.iter().map(length).collect::<Option<_>>()?;
        Some(Self { key: *key, lengths, record })
    }

    /// The bytes of the entry.
    pub fn encode(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        to.str(MAGIC);
        digest(&mut to, &self.key);
        to.u64(self.lengths.len() as u64);
        self.lengths.iter().for_each(|length| to.u64(*length));
        to.u8s(&self.record);
        to.finish()
    }

    /// Decodes the entry of a node or of a part, and checks that it belongs to `key`, which is the digest of the
    /// manifest in the record.
    ///
    /// # Errors
    /// If the bytes are not an entry of this key.
    pub fn decode(bytes: &[u8], key: &Digest) -> Result<Self, Corrupt> {
        let wrong = |what: &str| Corrupt(what.to_owned());
        let mut from = Decoder::new(bytes);
        if from.raw()? != MAGIC.as_bytes() {
            return Err(wrong("the data is not an entry of this version of lightharmony"));
        }
        let entry = Self {
            key: read_digest(&mut from)?,
            lengths: (0..from.length(8)?).map(|_| from.u64()).collect::<Result<_, _>>()?,
            record: from.u8s()?,
        };
        from.end()?;
        if entry.key != *key {
            return Err(wrong("the entry belongs to another key"));
        }
        let manifest = Record::manifest(&entry.record)
            .ok_or_else(|| wrong("the record in the entry has no manifest"))?;
        if Digest::of(manifest.as_bytes()) != *key {
            return Err(wrong("the record in the entry belongs to another key"));
        }
        if entry.lengths.len() != entry.blobs()?.len() {
            return Err(wrong("the number of lengths differs from the number of values"));
        }
        Ok(entry)
    }

    /// The digests of the stored values.
    ///
    /// # Errors
    /// If the record cannot be decoded.
    pub fn blobs(&self) -> Result<Vec<Digest>, Corrupt> {
        Record::stored_blobs(&self.record)
    }
}

#[cfg(test)]
mod tests {
    use cache::KeyWriter;

    use super::*;
    use crate::record::record::{Output, Spent};
    use crate::value::note::Notes;

    fn entry() -> Entry {
        let mut to = KeyWriter::new("test");
        to.u64("n", 7);
        let key = to.finish().expect("a key");
        let output = |text: &str, stored| Output {
            type_name: "number",
            format: 1,
            digest: Digest::of(text.as_bytes()),
            size: 1,
            stored,
        };
        let outputs = vec![output("a", true), output("b", false), output("c", true)];
        let record = Record { outputs, files: Vec::new(), notes: Notes::none(), spent: Spent::default() };
        Entry { key: key.digest, lengths: vec![8, 9], record: record.encode(&key.manifest) }
    }

    #[test]
    fn an_entry_is_read_back_and_no_other_bytes_are() {
        let entry = entry();
        let bytes = entry.encode();
        assert_eq!(Entry::decode(&bytes, &entry.key).expect("it is good"), entry);
        assert_eq!(entry.blobs().expect("a record"), [Digest::of(b"a"), Digest::of(b"c")]);
        for length in 0..bytes.len() {
            assert!(Entry::decode(&bytes[..length], &entry.key).is_err(), "cut to {length} bytes");
        }
        let longer = [bytes.as_slice(), &[0]].concat();
        assert!(Entry::decode(&longer, &entry.key).is_err());
        assert!(Entry::decode(&bytes, &Digest::of(b"other")).is_err());
        let relabelled = Entry { key: Digest::of(b"other"), ..entry.clone() };
        assert!(Entry::decode(&relabelled.encode(), &relabelled.key).is_err(), "the record has another key");
        let shorter = Entry { lengths: vec![8], ..entry.clone() };
        assert!(Entry::decode(&shorter.encode(), &entry.key).is_err(), "one length is missing");
    }
}
