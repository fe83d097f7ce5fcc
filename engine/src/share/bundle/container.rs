//! The byte format of a bundle. All numbers are little-endian.
//!
//! ```text
//!  0  8  "LHbundle"
//!  8  4  format: 1
//! 12  8  n, the length of the index, at most 64 MiB
//! 20 32  BLAKE3 of the index
//! 52  n  index
//!        count, then for each blob: 32 bytes BLAKE3, length         ascending by digest
//!        count, then for each file: name, blob                      ascending by name
//!        count, then for each record: 32 bytes key, blob            ascending by key
//!        count, then for each value: blob                           ascending
//! ..  m  the blobs in order, with nothing between, before or after
//! ```
//! Counts and lengths have 8 bytes. A name is stored as its length and its UTF-8 bytes, and a reference to a blob
//! as its 4-byte index in the first list. Nothing is compressed, so nothing can be larger than the bundle itself,
//! and every byte is covered by a digest. Equal parts give equal bytes.

use std::collections::BTreeMap;
use std::io;
use std::io::{Read, Seek, SeekFrom, Write};

use cache::{Digest, DigestWriter};

use crate::record::record::{digest, read_digest};
use crate::share::bundle::names::{clash, wrong_name};
use crate::value::codec::{Corrupt, Decoder, Encoder};

const MAGIC: &[u8; 8] = b"LHbundle";
const FORMAT: u32 = 1;
const HEAD: usize = 52;
const LONGEST_INDEX: u64 = 64 << 20;

/// Errors when reading or writing a bundle.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// The file is not a bundle.
    #[error("the file is not a lightharmony bundle")]
    NoBundle,
    /// The format of the bundle is not the format that this version of lightharmony reads.
    #[error("the bundle has format {0}, but this version of lightharmony reads format {FORMAT}")]
    Format(u32),
    /// The bundle is inconsistent.
    #[error("the bundle is damaged or incomplete: {0}")]
    Damaged(String),
    /// A name in the bundle is not permitted.
    #[error("the bundle contains the file name `{}`, which is not permitted: {why}", name.escape_debug())]
    Name {
        /// The name.
        name: String,
        /// Reason why the name is not permitted.
        why: &'static str,
    },
    /// A file cannot be read or written.
    #[error("{what}: {source}")]
    Io {
        /// The operation that failed, with the path.
        what: String,
        /// Underlying I/O error.
        source: io::Error,
    },
    /// Any other reason why a bundle cannot be packed, unpacked or verified.
    #[error("{0}")]
    Refused(String),
}

impl From<Corrupt> for BundleError {
    fn from(corrupt: Corrupt) -> Self {
        Self::Damaged(corrupt.0)
    }
}

/// The bytes of a blob, or the file that contains them.
pub(crate) enum Bytes {
    Memory(Vec<u8>),
    File(std::path::PathBuf),
}

/// The parts of a bundle that is being written.
#[derive(Default)]
pub(crate) struct BundleParts {
    contents: BTreeMap<[u8; 32], (u64, Bytes)>,
    files: BTreeMap<String, Digest>,
    records: BTreeMap<[u8; 32], Digest>,
    values: BTreeMap<[u8; 32], ()>,
}

impl BundleParts {
    fn add(&mut self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.contents.entry(*digest.as_bytes()).or_insert((bytes.len() as u64, Bytes::Memory(bytes)));
        digest
    }

    /// Adds a file with the given name and content.
    pub fn file(&mut self, name: &str, bytes: Vec<u8>) {
        let digest = self.add(bytes);
        self.files.insert(name.to_owned(), digest);
    }

    /// Adds a file whose content is read when the bundle is written.
    pub fn source(&mut self, name: &str, path: std::path::PathBuf, digest: Digest, length: u64) {
        self.contents.entry(*digest.as_bytes()).or_insert((length, Bytes::File(path)));
        self.files.insert(name.to_owned(), digest);
    }

    /// Adds the record with this key.
    pub fn record(&mut self, key: Digest, bytes: Vec<u8>) {
        let digest = self.add(bytes);
        self.records.insert(*key.as_bytes(), digest);
    }

    /// Adds a value to which a record refers.
    pub fn value(&mut self, bytes: Vec<u8>) {
        let digest = self.add(bytes);
        self.values.insert(*digest.as_bytes(), ());
    }

    /// Names and digests of the files.
    pub fn names(&self) -> impl Iterator<Item = (&str, &Digest)> {
        self.files.iter().map(|(name, digest)| (name.as_str(), digest))
    }

    /// Writes the bundle.
    pub fn write(self, to: &mut impl Write) -> Result<(), BundleError> {
        for (name, _) in self.names() {
            if let Some(why) = wrong_name(name) {
                return Err(BundleError::Name { name: name.to_owned(), why });
            }
        }
        if let Some(name) = clash(self.files.keys().map(String::as_str)) {
            let what =
                format!("`{name}`, which the graph reads, cannot be part of a bundle: {CLASH}; rename it");
            return Err(BundleError::Refused(what));
        }
        let place: BTreeMap<[u8; 32], u32> = self.contents.keys().copied().zip(0..).collect();
        let mut index = Encoder::default();
        index.u64(self.contents.len() as u64);
        for (key, (length, _)) in &self.contents {
            digest(&mut index, &Digest::from_bytes(*key));
            index.u64(*length);
        }
        index.u64(self.files.len() as u64);
        for (name, content) in &self.files {
            index.str(name);
            index.u32(place[content.as_bytes()]);
        }
        index.u64(self.records.len() as u64);
        for (key, content) in &self.records {
            digest(&mut index, &Digest::from_bytes(*key));
            index.u32(place[content.as_bytes()]);
        }
        index.u64(self.values.len() as u64);
        for content in self.values.keys() {
            index.u32(place[content]);
        }
        let index = index.finish();
        let failed = |what: &str| {
            let what = what.to_owned();
            move |source| BundleError::Io { what, source }
        };
        to.write_all(&head(&index)).and_then(|()| to.write_all(&index)).map_err(failed("cannot write"))?;
        for (key, (length, bytes)) in self.contents {
            match bytes {
                Bytes::Memory(bytes) => to.write_all(&bytes).map_err(failed("cannot write"))?,
                Bytes::File(path) => {
                    let name = path.display().to_string();
                    let file =
                        std::fs::File::open(&path).map_err(failed(&format!("cannot read `{name}`")))?;
                    let found = copy(&mut file.take(length), to, length).map_err(failed(&name))?;
                    if *found.as_bytes() != key {
                        return Err(BundleError::Refused(format!(
                            "`{name}` changed while it was packed; pack again"
                        )));
                    }
                }
            }
        }
        Ok(())
    }
}

const CLASH: &str = "on systems that ignore case, another file or folder has the same name";

fn head(index: &[u8]) -> Vec<u8> {
    let mut head = MAGIC.to_vec();
    head.extend(FORMAT.to_le_bytes());
    head.extend((index.len() as u64).to_le_bytes());
    head.extend(Digest::of(index).as_bytes());
    head
}

/// Copies `length` bytes and returns their digest. Returns an error if there are fewer.
fn copy(from: &mut impl Read, to: &mut impl Write, length: u64) -> io::Result<Digest> {
    let (mut digest, mut left, mut buffer) = (DigestWriter::new(), length, vec![0; 1 << 16]);
    while left > 0 {
        let most = usize::try_from(left).unwrap_or(usize::MAX).min(buffer.len());
        let count = from.read(&mut buffer[..most])?;
        if count == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        digest.write_all(&buffer[..count])?;
        to.write_all(&buffer[..count])?;
        left -= count as u64;
    }
    Ok(digest.finish())
}

/// A bundle open for reading. Its index is valid; its blobs are verified when they are read.
pub struct Bundle<R> {
    from: R,
    /// Digest of the index. It covers the whole bundle, since the index contains the digests of all blobs.
    digest: Digest,
    /// (offset, length, digest) of each blob.
    contents: Vec<(u64, u64, Digest)>,
    files: Vec<(String, usize)>,
    records: Vec<(Digest, usize)>,
    values: Vec<usize>,
}

impl<R: Read + Seek> Bundle<R> {
    /// Reads and validates the index of a bundle.
    ///
    /// # Errors
    /// If the file is not a bundle, or if its index is invalid.
    pub fn open(mut from: R) -> Result<Self, BundleError> {
        let failed = |source| BundleError::Io { what: "cannot read the bundle".to_owned(), source };
        let whole = from.seek(SeekFrom::End(0)).map_err(failed)?;
        from.seek(SeekFrom::Start(0)).map_err(failed)?;
        let mut head = [0; HEAD];
        if whole < HEAD as u64 {
            return Err(BundleError::NoBundle);
        }
        from.read_exact(&mut head).map_err(failed)?;
        let mut fields = Decoder::new(&head);
        if fields.array::<8>()? != *MAGIC {
            return Err(BundleError::NoBundle);
        }
        let format = fields.u32()?;
        if format != FORMAT {
            return Err(BundleError::Format(format));
        }
        let (length, digest) = (fields.u64()?, read_digest(&mut fields)?);
        let damaged = |what: &str| BundleError::Damaged(what.to_owned());
        if length > LONGEST_INDEX || length > whole - HEAD as u64 {
            return Err(damaged("the index is too long"));
        }
        let mut index = vec![0; usize::try_from(length).map_err(|_| damaged("the index is too long"))?];
        from.read_exact(&mut index).map_err(failed)?;
        if Digest::of(&index) != digest {
            return Err(damaged("the index does not match its digest"));
        }
        let mut bundle = Self {
            from,
            digest,
            contents: Vec::new(),
            files: Vec::new(),
            records: Vec::new(),
            values: Vec::new(),
        };
        bundle.read_index(&index, HEAD as u64 + length, whole)?;
        Ok(bundle)
    }

    fn read_index(&mut self, index: &[u8], mut offset: u64, whole: u64) -> Result<(), BundleError> {
        let damaged = |what: &str| BundleError::Damaged(what.to_owned());
        let mut from = Decoder::new(index);
        let count = from.length(40)?;
        for _ in 0..count {
            let (digest, length) = (read_digest(&mut from)?, from.u64()?);
            self.contents.push((offset, length, digest));
            offset = offset
                .checked_add(length)
                .ok_or_else(|| damaged("a blob extends past the end of the bundle"))?;
        }
        if offset != whole {
            return Err(damaged("there are additional bytes after the last blob"));
        }
        let place = |from: &mut Decoder<'_>| -> Result<usize, BundleError> {
            let place = from.u32()? as usize;
            if place < count { Ok(place) } else { Err(damaged("the index refers to a blob that is missing")) }
        };
        for _ in 0..from.length(12)? {
            let (name, content) = (from.str()?, place(&mut from)?);
            if let Some(why) = wrong_name(&name) {
                return Err(BundleError::Name { name, why });
            }
            self.files.push((name, content));
        }
        for _ in 0..from.length(36)? {
            let (key, content) = (read_digest(&mut from)?, place(&mut from)?);
            self.records.push((key, content));
        }
        for _ in 0..from.length(4)? {
            self.values.push(place(&mut from)?);
        }
        from.end()?;
        let bytes = |digest: &Digest| *digest.as_bytes();
        let ordered = self.contents.is_sorted_by(|a, b| bytes(&a.2) < bytes(&b.2))
            && self.files.is_sorted_by(|a, b| a.0 < b.0)
            && self.records.is_sorted_by(|a, b| bytes(&a.0) < bytes(&b.0))
            && self.values.is_sorted_by(|a, b| a < b);
        if !ordered {
            return Err(damaged("the lists in the index are not sorted, or have duplicates"));
        }
        match clash(self.files.iter().map(|(name, _)| name.as_str())) {
            Some(name) => Err(BundleError::Name { name, why: CLASH }),
            None => Ok(()),
        }
    }

    /// Digest of the whole bundle.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// Name, length and digest of each file, in order of name.
    pub fn files(&self) -> impl Iterator<Item = (&str, u64, Digest)> {
        self.files.iter().map(|(name, content)| {
            let (_, length, digest) = self.contents[*content];
            (name.as_str(), length, digest)
        })
    }

    /// Number of records, and number of values.
    pub fn results(&self) -> (usize, usize) {
        (self.records.len(), self.values.len())
    }

    pub(crate) fn records(&self) -> Vec<(Digest, usize)> {
        self.records.clone()
    }

    pub(crate) fn values(&self) -> Vec<(Digest, usize)> {
        self.values.iter().map(|content| (self.contents[*content].2, *content)).collect()
    }

    pub(crate) fn content_of(&self, file: &str) -> Option<usize> {
        self.files.iter().find(|(name, _)| name == file).map(|(_, content)| *content)
    }

    /// Writes a blob to `to`. Returns an error if the blob does not match its digest.
    pub(crate) fn copy(&mut self, content: usize, to: &mut impl Write) -> Result<(), BundleError> {
        let (offset, length, digest) = self.contents[content];
        let failed = |source| BundleError::Io { what: "cannot copy from the bundle".to_owned(), source };
        self.from.seek(SeekFrom::Start(offset)).map_err(failed)?;
        if copy(&mut self.from, to, length).map_err(failed)? != digest {
            let what = format!("the blob {} does not match its digest", digest.short());
            return Err(BundleError::Damaged(what));
        }
        Ok(())
    }

    /// Reads a blob into memory. A blob is never longer than the bundle, so that a small bundle cannot exhaust
    /// memory.
    pub(crate) fn read(&mut self, content: usize) -> Result<Vec<u8>, BundleError> {
        let mut bytes = Vec::new();
        self.copy(content, &mut bytes)?;
        Ok(bytes)
    }

    /// Verifies all blobs.
    ///
    /// # Errors
    /// The first blob that does not match its digest.
    pub fn check(&mut self) -> Result<(), BundleError> {
        (0..self.contents.len()).try_for_each(|content| self.copy(content, &mut io::sink()))
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
