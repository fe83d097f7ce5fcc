//! [`KeyWriter`]: encodes everything on which a result depends.
//!
//! The encoding is unambiguous. Its BLAKE3 hash is the key, and the encoding itself is the manifest. Since both
//! come from the same bytes, they always agree, and a manifest costs no time until it is read.

use crate::digest::Digest;
use crate::manifest::{FORMAT, Manifest, tag, write_length};

/// A finished key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    /// The key under which the result is stored.
    pub digest: Digest,
    /// The fields of the key in readable form.
    pub manifest: Manifest,
}

/// Errors that prevent a key from being made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// A number is NaN. NaN does not equal itself, so it cannot be part of a key.
    #[error("`{path}` is not a number (NaN)")]
    NotANumber {
        /// The dotted path of the first such number.
        path: String,
    },
}

/// Collects the fields on which a result depends, in the order written.
///
/// Two sequences of fields that differ in any name, type, value, order or nesting have different digests. For this,
/// every field is encoded as a type tag, a length-prefixed name and a fixed-size or length-prefixed value, and
/// groups and lists end with a mark.
/// Negative zero is written as zero; NaN makes [`finish`](Self::finish) fail.
///
/// ```
/// let mut walk = cache::KeyWriter::new("blur");
/// walk.f64("radius", 2.0);
/// walk.list("inputs", |walk| walk.digest("", cache::Digest::of(b"pixels")));
/// let key = walk.finish()?;
/// assert_eq!(key.manifest.to_string(), "key blur\nradius = 2.0\ninputs[0] = de6a7900b92a\n");
/// # Ok::<(), cache::KeyError>(())
/// ```
#[derive(Clone, Debug)]
pub struct KeyWriter {
    encoding: Vec<u8>,
    refused: bool,
}

impl KeyWriter {
    /// Starts a key. `tag` is the type of the key; keys with different tags are never equal.
    pub fn new(tag: &str) -> KeyWriter {
        KeyWriter::in_memory_of(Vec::with_capacity(512), tag)
    }

    /// Like [`new`](Self::new), but reuses the memory of `encoding`, which comes from [`Manifest::into_bytes`].
    pub fn in_memory_of(mut encoding: Vec<u8>, tag: &str) -> KeyWriter {
        encoding.clear();
        let mut writer = KeyWriter { encoding, refused: false };
        writer.text(FORMAT);
        writer.text(tag);
        writer
    }

    /// Returns the encoding of the fields that `write` writes, to be passed to [`append`](Self::append).
    pub fn fields(write: impl FnOnce(&mut KeyWriter)) -> Vec<u8> {
        let mut writer = KeyWriter { encoding: Vec::new(), refused: false };
        write(&mut writer);
        writer.encoding
    }

    /// Appends fields encoded by [`fields`](Self::fields). NaN in these fields is not detected.
    pub fn append(&mut self, fields: &[u8]) {
        self.encoding.extend_from_slice(fields);
    }

    /// Writes a string.
    pub fn str(&mut self, name: &str, value: &str) {
        self.field(tag::STR, name);
        self.text(value);
    }

    /// Writes an unsigned number.
    pub fn u64(&mut self, name: &str, value: u64) {
        self.field(tag::U64, name);
        self.encoding.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a signed number.
    pub fn i64(&mut self, name: &str, value: i64) {
        self.field(tag::I64, name);
        self.encoding.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes the bits of a 64-bit float; -0 is written as 0. After NaN, `finish` returns an error.
    pub fn f64(&mut self, name: &str, value: f64) {
        self.field(tag::F64, name);
        self.refused |= value.is_nan();
        // IEEE: -0 + 0 = +0, and every other value is unchanged.
        self.encoding.extend_from_slice(&(value + 0.0).to_bits().to_le_bytes());
    }

    /// Writes the bits of a 32-bit float; -0 is written as 0. After NaN, `finish` returns an error.
    pub fn f32(&mut self, name: &str, value: f32) {
        self.field(tag::F32, name);
        self.refused |= value.is_nan();
        self.encoding.extend_from_slice(&(value + 0.0).to_bits().to_le_bytes());
    }

    /// Writes a boolean.
    pub fn bool(&mut self, name: &str, value: bool) {
        self.field(tag::BOOL, name);
        self.encoding.push(u8::from(value));
    }

    /// Writes a short sequence of bytes. For long content, write its digest instead, since the manifest contains
    /// every byte that is written here.
    pub fn bytes(&mut self, name: &str, value: &[u8]) {
        self.field(tag::BYTES, name);
        write_length(&mut self.encoding, value.len());
        self.encoding.extend_from_slice(value);
    }

    /// Writes a digest, for example of file content.
    pub fn digest(&mut self, name: &str, value: Digest) {
        self.field(tag::DIGEST, name);
        self.encoding.extend_from_slice(value.as_bytes());
    }

    /// Writes fields under a common name: the paths of the fields that `inside` writes are `name.field`.
    pub fn group(&mut self, name: &str, inside: impl FnOnce(&mut KeyWriter)) {
        self.field(tag::GROUP, name);
        inside(self);
        self.encoding.push(tag::END);
    }

    /// Writes a list: the paths of the items that `items` writes are `name[0]`, `name[1]` and so on. Items usually
    /// have empty names.
    pub fn list(&mut self, name: &str, items: impl FnOnce(&mut KeyWriter)) {
        self.field(tag::LIST, name);
        items(self);
        self.encoding.push(tag::END);
    }

    /// The key of all fields written.
    ///
    /// # Errors
    /// [`KeyError::NotANumber`] with the path of the first float that was NaN.
    pub fn finish(self) -> Result<Key, KeyError> {
        let digest = Digest::of(&self.encoding);
        let manifest = Manifest::from_encoding(self.encoding);
        if self.refused {
            return Err(KeyError::NotANumber { path: manifest.first_nan().unwrap_or_default() });
        }
        Ok(Key { digest, manifest })
    }

    fn field(&mut self, tag: u8, name: &str) {
        self.encoding.push(tag);
        self.text(name);
    }

    fn text(&mut self, text: &str) {
        write_length(&mut self.encoding, text.len());
        self.encoding.extend_from_slice(text.as_bytes());
    }
}
