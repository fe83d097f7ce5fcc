//! Artifacts: the typed values that travel along wires, and their canonical bytes.

use std::any::Any;
use std::sync::Arc;

use cache::Digest;

use crate::value::codec::{Corrupt, Decoder, Encoder};
use crate::value::error::{NodeError, guarded};

/// A value that a port can carry.
///
/// The encoding is canonical: equal values give equal bytes on every machine, since the content digest of a value
/// is the digest of its encoded bytes. Keys contain the type name and the format as well.
///
/// ```
/// use engine::{Artifact, Corrupt, Decoder, Difference, Encoder, decode_all, encode_to_vec};
///
/// /// Numbers with a unit.
/// #[derive(Debug, PartialEq)]
/// struct Series {
///     unit: String,
///     values: Vec<f64>,
/// }
///
/// impl Artifact for Series {
///     const TYPE: &'static str = "series";
///     const FORMAT: u32 = 1;
///     fn encode(&self, to: &mut Encoder) {
///         to.str(&self.unit);
///         to.f64s(&self.values);
///     }
///     // The same fields in the same order. Bytes that `encode` never writes are an error.
///     fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
///         let series = Self { unit: from.str()?, values: from.f64s()? };
///         if series.unit.is_empty() {
///             return Err(Corrupt("the unit is empty".to_owned()));
///         }
///         Ok(series)
///     }
///     fn bytes(&self) -> usize {
///         self.unit.len() + 8 * self.values.len() + 64
///     }
///     fn difference(&self, other: &Self) -> Difference {
///         if self == other {
///             return Difference::none();
///         }
///         Difference::of(format!("numbers: {} and {}", self.values.len(), other.values.len()))
///     }
/// }
///
/// let series = Series { unit: "lux".to_owned(), values: vec![1.0, 2.5] };
/// let bytes = encode_to_vec(&series);
/// assert_eq!(decode_all::<Series>(&bytes)?, series);
/// assert!(decode_all::<Series>(&bytes[1..]).is_err());
/// # Ok::<(), Corrupt>(())
/// ```
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

impl Encoder {
    /// Appends another artifact.
    pub fn artifact<A: Artifact>(&mut self, value: &A) {
        value.encode(self);
    }
}

impl Decoder<'_> {
    /// Reads an artifact.
    pub fn artifact<A: Artifact>(&mut self) -> Result<A, Corrupt> {
        A::decode(self)
    }
}

/// The canonical bytes of a value.
pub fn encode_to_vec<A: Artifact>(value: &A) -> Vec<u8> {
    let mut to = Encoder::with_capacity(value.bytes() + 64);
    value.encode(&mut to);
    to.finish()
}

/// The digest of the canonical bytes of a value, without holding all of them in memory.
pub(crate) fn digest_of<A: Artifact>(value: &A) -> Digest {
    let mut to = Encoder::digesting();
    value.encode(&mut to);
    to.into_digest()
}

/// Decodes bytes that hold exactly one value.
pub fn decode_all<A: Artifact>(bytes: &[u8]) -> Result<A, Corrupt> {
    let mut from = Decoder::new(bytes);
    let value = A::decode(&mut from)?;
    from.end()?;
    Ok(value)
}

/// Decodes bytes that hold exactly one value. The code of the type may panic, which is an error here.
///
/// # Errors
/// If the bytes are not a value of the type.
pub(crate) fn decode_with(artifact: &ArtifactType, bytes: &[u8]) -> Result<AnyArtifact, NodeError> {
    guarded(|| {
        let value = (artifact.decode)(bytes)?;
        // This, too, is code of a kind, and the scheduler calls it without a guard.
        (artifact.bytes)(&value);
        Ok(value)
    })
}

// The graph check matched the type names before any value existed, so a mismatch is our bug.
fn typed<A: Artifact>(value: &AnyArtifact) -> &A {
    value.downcast_ref().expect("the graph check matched port types")
}
