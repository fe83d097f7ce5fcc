//! Artifacts: the typed values that travel along wires, and their canonical bytes.

use std::any::Any;
use std::io::Write;
use std::sync::Arc;

use cache::{Digest, DigestWriter};

use crate::value::error::guarded;

/// A value that a port can carry.
///
/// The encoding is canonical: equal values give equal bytes on every machine, since the content digest of a value
/// is the digest of its encoded bytes. Keys contain the type name and the format as well.
pub trait Artifact: Send + Sync + Sized + 'static {
    /// Name of the type in kebab-case. An output can be connected to an input if their types have the same name.
    const TYPE: &'static str;
    /// Version of the byte layout. It is raised whenever the bytes that `encode` writes change.
    const FORMAT: u32;

    /// Writes the canonical bytes.
    fn encode(&self, to: &mut Encoder);
    /// Reads what [`Artifact::encode`] wrote. Never panics, whatever the bytes are.
    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt>;
    /// Memory of the value in bytes, which counts against the memory budget. An estimate is enough.
    fn bytes(&self) -> usize;
    /// Size of the value, in units such that the work of the nodes that read it is proportional to the size:
    /// pixels, splats or triangles.
    fn size(&self) -> u64 {
        self.bytes() as u64
    }
    /// Difference from another value, in terms that suit this type (decibels, metres, rows).
    fn difference(&self, other: &Self) -> Difference;
}

/// The difference between two artifacts of the same type.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// True if both artifacts are encoded as the same bytes.
    pub equal: bool,
    /// Description in one line: `PSNR 41.2 dB, largest 0.031 at (12, 80) of view_0`.
    pub summary: String,
}

impl Difference {
    /// The difference between equal values.
    pub fn none() -> Self {
        Self { equal: true, summary: "equal".to_owned() }
    }

    /// A difference described by one line.
    pub fn of(summary: impl Into<String>) -> Self {
        Self { equal: false, summary: summary.into() }
    }
}

/// Error for bytes that cannot be decoded as a value of the stored type.
#[derive(Debug, Clone, thiserror::Error)]
#[error("the stored value cannot be decoded: {0}")]
pub struct Corrupt(pub String);

/// Appends primitive values in little-endian order. Slices are preceded by their length.
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

    /// Appends another artifact.
    pub fn artifact<A: Artifact>(&mut self, value: &A) {
        value.encode(self);
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

    /// Reads an artifact.
    pub fn artifact<A: Artifact>(&mut self) -> Result<A, Corrupt> {
        A::decode(self)
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

/// An artifact whose type is known only at run time.
pub type AnyArtifact = Arc<dyn Any + Send + Sync>;

/// The operations on an artifact type that the engine needs.
#[derive(Debug, Clone, Copy)]
pub struct ArtifactType {
    /// [`Artifact::TYPE`].
    pub name: &'static str,
    /// [`Artifact::FORMAT`].
    pub format: u32,
    pub(crate) encode: fn(&AnyArtifact) -> Vec<u8>,
    pub(crate) digest: fn(&AnyArtifact) -> Digest,
    pub(crate) decode: fn(&[u8]) -> Result<AnyArtifact, Corrupt>,
    pub(crate) bytes: fn(&AnyArtifact) -> usize,
    pub(crate) size: fn(&AnyArtifact) -> u64,
    pub(crate) difference: fn(&AnyArtifact, &AnyArtifact) -> Difference,
}

impl ArtifactType {
    /// The operations on artifacts of type `A`.
    pub fn of<A: Artifact>() -> Self {
        Self {
            name: A::TYPE,
            format: A::FORMAT,
            encode: |value| encode_to_vec(typed::<A>(value)),
            digest: |value| digest_of(typed::<A>(value)),
            decode: |bytes| {
                let value: AnyArtifact = Arc::new(decode_all::<A>(bytes)?);
                Ok(value)
            },
            bytes: |value| typed::<A>(value).bytes(),
            size: |value| typed::<A>(value).size(),
            difference: |a, b| typed::<A>(a).difference(typed::<A>(b)),
        }
    }

    /// Decodes stored bytes and encodes the value again. The result equals `encoded` if `encode` wrote those bytes.
    pub fn round_trip(&self, encoded: &[u8]) -> Result<Vec<u8>, Corrupt> {
        (self.decode)(encoded).map(|value| (self.encode)(&value))
    }

    /// Difference between two values of this type.
    pub fn difference(&self, a: &AnyArtifact, b: &AnyArtifact) -> Difference {
        guarded(|| Ok((self.difference)(a, b)))
            .unwrap_or_else(|error| Difference::of(format!("the values cannot be compared: {error}")))
    }
}

/// The canonical bytes of a value.
pub fn encode_to_vec<A: Artifact>(value: &A) -> Vec<u8> {
    let mut to = Encoder { bytes: Vec::with_capacity(value.bytes() + 64), digest: None };
    value.encode(&mut to);
    to.finish()
}

/// The digest of the canonical bytes of a value, without holding all of them in memory.
pub(crate) fn digest_of<A: Artifact>(value: &A) -> Digest {
    let mut to = Encoder { bytes: Vec::with_capacity(DIGESTED), digest: Some(DigestWriter::new()) };
    value.encode(&mut to);
    let mut digest = to.digest.unwrap_or_default();
    take(&mut digest, &to.bytes);
    digest.finish()
}

fn take(digest: &mut DigestWriter, bytes: &[u8]) {
    digest.write_all(bytes).expect("hashing does not fail");
}

/// Decodes bytes that hold exactly one value.
pub fn decode_all<A: Artifact>(bytes: &[u8]) -> Result<A, Corrupt> {
    let mut from = Decoder::new(bytes);
    let value = A::decode(&mut from)?;
    from.end()?;
    Ok(value)
}

// The graph check matched the type names before any value existed, so a mismatch is our bug.
fn typed<A: Artifact>(value: &AnyArtifact) -> &A {
    value.downcast_ref().expect("the graph check matched port types")
}
