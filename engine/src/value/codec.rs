//! The canonical bytes of values: writing and reading them.

use std::io::Write;

use cache::{Digest, DigestWriter};

/// Error for bytes that cannot be decoded as a value of the stored type.
#[derive(Debug, Clone, thiserror::Error)]
#[error("the stored value cannot be decoded: {0}")]
pub struct Corrupt(pub String);

/// Appends primitive values in little-endian order. Slices are preceded by their length.
///
/// A list of elements that are not numbers is a `u64` with their count, and then the elements.
///
/// ```
/// use engine::{Corrupt, Decoder, Encoder};
///
/// let names = [("left", 0.5_f32), ("right", 2.0)];
/// let mut to = Encoder::default();
/// to.u64(names.len() as u64);
/// for (name, weight) in names {
///     to.str(name);
///     to.f32(weight);
/// }
/// let bytes = to.finish();
///
/// let mut from = Decoder::new(&bytes);
/// // An element takes at least 12 bytes: the length of its name, and its weight.
/// let count = from.length(12)?;
/// let read: Vec<(String, f32)> = (0..count).map(|_| Ok((from.str()?, from.f32()?))).collect::<Result<_, Corrupt>>()?;
/// from.end()?;
/// assert_eq!(read, [("left".to_owned(), 0.5), ("right".to_owned(), 2.0)]);
/// # Ok::<(), Corrupt>(())
/// ```
#[derive(Debug, Default)]
pub struct Encoder {
    bytes: Vec<u8>,
    /// Receives the bytes in chunks if only their digest is needed.
    digest: Option<DigestWriter>,
}

macro_rules! scalar_codec {
    ($($name:ident: $type:ty),*) => {
        impl Encoder { $(
            #[doc = concat!("Appends one `", stringify!($type), "`.")]
            pub fn $name(&mut self, value: $type) { self.raw(&value.to_le_bytes()); }
        )* }
        impl Decoder<'_> { $(
            #[doc = concat!("Reads one `", stringify!($type), "`.")]
            pub fn $name(&mut self) -> Result<$type, Corrupt> {
                let mut raw = [0; size_of::<$type>()];
                raw.copy_from_slice(self.take(size_of::<$type>())?);
                Ok(<$type>::from_le_bytes(raw))
            }
        )* }
    };
}
scalar_codec!(u8: u8, u32: u32, u64: u64, f32: f32, f64: f64);

macro_rules! slice_codec {
    ($($name:ident: $type:ty),*) => {
        impl Encoder { $(
            #[doc = concat!("Appends a length and that many `", stringify!($type), "`.")]
            pub fn $name(&mut self, values: &[$type]) {
                self.u64(values.len() as u64);
                if cfg!(target_endian = "little") {
                    self.raw(bytemuck::cast_slice(values));
                } else {
                    for value in values { self.raw(&value.to_le_bytes()); }
                }
            }
        )* }
        impl Decoder<'_> { $(
            #[doc = concat!("Reads what the encoder's `", stringify!($name), "` wrote.")]
            pub fn $name(&mut self) -> Result<Vec<$type>, Corrupt> {
                let count = self.length(size_of::<$type>())?;
                let raw = self.take(count * size_of::<$type>())?;
                Ok(raw.chunks_exact(size_of::<$type>())
                    .map(|chunk| { let mut one = [0; size_of::<$type>()]; one.copy_from_slice(chunk); <$type>::from_le_bytes(one) })
                    .collect())
            }
        )* }
    };
}
slice_codec!(u8s: u8, u32s: u32, f32s: f32, f64s: f64);

impl Encoder {
    /// An encoder with memory for `bytes` bytes.
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        Self { bytes: Vec::with_capacity(bytes), digest: None }
    }

    /// An encoder that digests the bytes and does not hold all of them. [`Encoder::into_digest`] ends it.
    pub(crate) fn digesting() -> Self {
        Self { bytes: Vec::with_capacity(DIGESTED), digest: Some(DigestWriter::new()) }
    }

    /// The digest of all bytes of an encoder from [`Encoder::digesting`].
    pub(crate) fn into_digest(self) -> Digest {
        let mut digest = self.digest.unwrap_or_default();
        take(&mut digest, &self.bytes);
        digest.finish()
    }

    /// Appends one `bool` as a byte.
    pub fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    /// Appends a length and UTF-8 text.
    pub fn str(&mut self, value: &str) {
        self.u8s(value.as_bytes());
    }

    /// Appends bytes without their length.
    pub(crate) fn raw(&mut self, bytes: &[u8]) {
        if let Some(digest) = &mut self.digest
            && self.bytes.len() + bytes.len() > DIGESTED
        {
            take(digest, &self.bytes);
            take(digest, bytes);
            self.bytes.clear();
        } else {
            self.bytes.extend_from_slice(bytes);
        }
    }

    /// The bytes written so far.
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// Length in bytes of the chunks in which bytes are digested.
const DIGESTED: usize = 1 << 16;

/// Reads what an [`Encoder`] wrote. Every length is checked against the remaining bytes before anything is
/// allocated.
///
/// ```
/// use engine::Decoder;
///
/// // A text that claims to have 200 bytes, and ends after two.
/// let bytes = [200, 0, 0, 0, 0, 0, 0, 0, b'a', b'b'];
/// let error = Decoder::new(&bytes).str().expect_err("too short");
/// assert!(error.to_string().contains("elements: 200, remaining bytes: 2"));
/// ```
#[derive(Debug)]
pub struct Decoder<'a> {
    rest: &'a [u8],
}

impl<'a> Decoder<'a> {
    /// A decoder at the start of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], Corrupt> {
        let (head, rest) = self.rest.split_at_checked(count).ok_or_else(|| {
            Corrupt(format!(
                "the data ends too early (bytes needed: {count}, remaining: {})",
                self.rest.len()
            ))
        })?;
        self.rest = rest;
        Ok(head)
    }

    /// Reads the number of elements of a list. Returns an error if the remaining bytes cannot hold that many
    /// elements of `size` bytes each.
    pub fn length(&mut self, size: usize) -> Result<usize, Corrupt> {
        let count = self.u64()?;
        match usize::try_from(count) {
            Ok(n) if n.checked_mul(size.max(1)).is_some_and(|b| b <= self.rest.len()) => Ok(n),
            _ => Err(Corrupt(format!(
                "a list claims to hold more elements than the data can contain (elements: {count}, remaining bytes: {})",
                self.rest.len()
            ))),
        }
    }

    /// Reads the number of elements of a list, stored in 32 bits. Returns an error if the remaining bytes cannot
    /// hold that many elements of at least `size` bytes each.
    pub(crate) fn count(&mut self, size: usize) -> Result<usize, Corrupt> {
        let count = self.u32()? as usize;
        match count.checked_mul(size) {
            Some(bytes) if bytes <= self.rest.len() => Ok(count),
            _ => Err(Corrupt(format!(
                "a list claims to hold more elements than the data can contain (elements: {count}, remaining bytes: {})",
                self.rest.len()
            ))),
        }
    }

    /// Number of remaining bytes.
    pub(crate) fn left(&self) -> usize {
        self.rest.len()
    }

    /// Reads a slice or a text and returns its byte range within `whole`, which must be the bytes with which this
    /// decoder was created.
    pub(crate) fn raw_range(&mut self, whole: &[u8]) -> Result<std::ops::Range<usize>, Corrupt> {
        let length = self.raw()?.len();
        let end = whole.len() - self.rest.len();
        Ok(end - length..end)
    }

    /// Reads a slice or a text without copying it.
    pub(crate) fn raw(&mut self) -> Result<&'a [u8], Corrupt> {
        let count = self.length(1)?;
        self.take(count)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Corrupt> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// Reads one `bool`.
    pub fn bool(&mut self) -> Result<bool, Corrupt> {
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(Corrupt(format!("a boolean is stored as {other}; it must be 0 or 1"))),
        }
    }

    /// Reads a text.
    pub fn str(&mut self) -> Result<String, Corrupt> {
        String::from_utf8(self.u8s()?).map_err(|_| Corrupt("a text is not valid UTF-8".to_owned()))
    }

    /// Returns an error if bytes remain.
    pub fn end(&self) -> Result<(), Corrupt> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(Corrupt(format!(
                "unexpected data after the end of the value (length in bytes: {})",
                self.rest.len()
            )))
        }
    }
}

fn take(digest: &mut DigestWriter, bytes: &[u8]) {
    digest.write_all(bytes).expect("hashing does not fail");
}
