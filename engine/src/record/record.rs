//! Records: the stored data about a result, except its values.

use cache::{Digest, Manifest};

use crate::graph::node::Node;
use crate::value::artifact::ArtifactType;
use crate::value::codec::{Corrupt, Decoder, Encoder};
use crate::value::counts::{Counts, Effort};
use crate::value::note::{Level, Notes};

/// An output of a finished node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Output {
    pub type_name: &'static str,
    pub format: u32,
    pub digest: Digest,
    /// [`crate::Artifact::size`].
    pub size: u64,
    /// True if the value itself was stored, and not only its digest.
    pub stored: bool,
}

/// A file made by a sink.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileRecord {
    pub view: String,
    pub digest: Digest,
}

/// Time and memory that the code of a node used, and the work that it counted (such as rays), for forecasts and for
/// display. None of these are part of a key.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spent {
    /// Wall time in seconds, including the time that cached parts took when they were computed.
    pub seconds: f64,
    /// CPU time in seconds on all threads, including the time that cached parts took when they were computed.
    pub cpu_seconds: f64,
    /// [`crate::Kind::work`].
    pub work: f64,
    /// Memory in bytes, not including the inputs: the estimate, or the size of the outputs if that is larger.
    pub memory: u64,
    /// Counts of work such as rays and blends. Parts from the cache are included, so that the counts do not depend
    /// on the cache.
    pub counts: Counts,
}

/// The stored record of a part: its blob, and the time and counts of its computation.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PartRecord {
    pub blob: Digest,
    pub spent: Effort,
}

impl PartRecord {
    pub fn encode(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        // The record of a node begins with its length, which is never this number.
        to.u64(u64::MAX);
        digest(&mut to, &self.blob);
        to.f64(self.spent.seconds);
        to.f64(self.spent.cpu_seconds);
        counts(&mut to, &self.spent.counts);
        to.finish()
    }

    pub fn decode(bytes: &[u8]) -> Result<Self, Corrupt> {
        let mut from = Decoder::new(bytes);
        if from.u64()? != u64::MAX {
            return Err(Corrupt("this is not the record of a part".to_owned()));
        }
        let (blob, seconds, cpu_seconds) = (read_digest(&mut from)?, from.f64()?, from.f64()?);
        let spent = Effort { seconds, cpu_seconds, counts: read_counts(&mut from)? };
        from.end()?;
        Ok(Self { blob, spent })
    }
}

fn counts(to: &mut Encoder, counts: &Counts) {
    to.u64(counts.len() as u64);
    for (name, n) in counts {
        to.str(name);
        to.u64(*n);
    }
}

fn read_counts(from: &mut Decoder<'_>) -> Result<Counts, Corrupt> {
    (0..from.length(16)?).map(|_| Ok((from.str()?, from.u64()?))).collect()
}

/// The record of a finished node: digests of its outputs, notes and files. In the store, the manifest of its key
/// follows.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    pub outputs: Vec<Output>,
    pub files: Vec<FileRecord>,
    pub notes: Notes,
    pub spent: Spent,
}

impl Record {
    /// Encodes the record and the manifest of its key.
    pub fn encode(&self, manifest: &Manifest) -> Vec<u8> {
        let mut whole = Encoder::default();
        whole.u8s(&self.body());
        whole.u8s(manifest.as_bytes());
        whole.finish()
    }

    /// Encodes the record without the manifest.
    pub fn body(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        to.u64(self.outputs.len() as u64);
        for output in &self.outputs {
            to.str(output.type_name);
            to.u32(output.format);
            digest(&mut to, &output.digest);
            to.u64(output.size);
            to.bool(output.stored);
        }
        to.u64(self.files.len() as u64);
        for file in &self.files {
            to.str(&file.view);
            digest(&mut to, &file.digest);
        }
        write_notes(&mut to, &self.notes);
        to.f64(self.spent.seconds);
        to.f64(self.spent.cpu_seconds);
        to.f64(self.spent.work);
        to.u64(self.spent.memory);
        counts(&mut to, &self.spent.counts);
        to.finish()
    }

    /// Decodes a record of this node. Returns an error if its outputs do not have the types that the node's kind
    /// declares.
    pub fn decode(bytes: &[u8], node: &Node) -> Result<Self, Corrupt> {
        Self::decode_body(Decoder::new(bytes).raw()?, node)
    }

    /// Decodes the output of [`body`](Self::body).
    pub fn decode_body(body: &[u8], node: &Node) -> Result<Self, Corrupt> {
        let mut from = Decoder::new(body);
        let ports = &node.kind.outputs;
        if from.length(53)? != ports.len() {
            return Err(Corrupt("the record and the kind have different numbers of outputs".to_owned()));
        }
        let mut outputs = Vec::with_capacity(ports.len());
        for ArtifactType { name, format, .. } in ports.iter().map(|port| port.artifact) {
            let StoredOutput { type_name, number, digest, size, stored } = StoredOutput::read(&mut from)?;
            if type_name != name.as_bytes() || number != format {
                return Err(Corrupt(format!("an output is not of type `{name}` in format {format}")));
            }
            outputs.push(Output { type_name: name, format, digest, size, stored });
        }
        let files = (0..from.length(40)?)
            .map(|_| Ok(FileRecord { view: from.str()?, digest: read_digest(&mut from)? }))
            .collect::<Result<_, Corrupt>>()?;
        let notes = read_notes(&mut from)?;
        let (seconds, cpu_seconds, work) = (from.f64()?, from.f64()?, from.f64()?);
        let memory = from.u64()?;
        let counts = read_counts(&mut from)?;
        from.end()?;
        Ok(Self { outputs, files, notes, spent: Spent { seconds, cpu_seconds, work, memory, counts } })
    }

    /// Digests of the stored values that a record names. The record may belong to a node of any kind.
    pub fn stored_blobs(bytes: &[u8]) -> Result<Vec<Digest>, Corrupt> {
        let mut from = Decoder::new(Decoder::new(bytes).raw()?);
        let mut blobs = Vec::new();
        for _ in 0..from.length(53)? {
            let output = StoredOutput::read(&mut from)?;
            if output.stored {
                blobs.push(output.digest);
            }
        }
        Ok(blobs)
    }

    /// A copy of a stored record in which only values accepted by `kept` are marked as stored.
    ///
    /// # Errors
    /// If the bytes are not a record of a node.
    pub fn keeping(bytes: &[u8], kept: impl Fn(&Digest) -> bool) -> Result<Vec<u8>, Corrupt> {
        Self::marking(bytes, |digest, stored| stored && kept(digest))
    }

    /// A copy of a stored record in which those values are marked as stored for which `mark` returns true. Its
    /// arguments are the digest of the value, and whether the value is marked in `bytes`.
    ///
    /// # Errors
    /// If the bytes are not a record of a node.
    pub fn marking(bytes: &[u8], mark: impl Fn(&Digest, bool) -> bool) -> Result<Vec<u8>, Corrupt> {
        let mut from = Decoder::new(bytes);
        let body = from.raw_range(bytes)?;
        let mut outputs = Decoder::new(&bytes[body.clone()]);
        let mut whole = bytes.to_vec();
        for _ in 0..outputs.length(53)? {
            let output = StoredOutput::read(&mut outputs)?;
            // The last byte of an output is the flag `stored`.
            whole[body.end - outputs.left() - 1] = u8::from(mark(&output.digest, output.stored));
        }
        Ok(whole)
    }

    /// The manifest at the end of a stored record. It is decoded separately, since most readers do not need it.
    pub fn manifest(bytes: &[u8]) -> Option<Manifest> {
        let mut from = Decoder::new(bytes);
        from.raw().ok()?;
        Manifest::from_bytes(from.raw().ok()?)
    }
}

/// An output of any type in its stored form.
struct StoredOutput<'a> {
    type_name: &'a [u8],
    number: u32,
    digest: Digest,
    size: u64,
    stored: bool,
}

impl<'a> StoredOutput<'a> {
    fn read(from: &mut Decoder<'a>) -> Result<Self, Corrupt> {
        let (type_name, number, digest) = (from.raw()?, from.u32()?, read_digest(from)?);
        Ok(Self { type_name, number, digest, size: from.u64()?, stored: from.bool()? })
    }
}

/// Digests of the blobs that a stored record names. The record may belong to a node, to a part, or to a compiled
/// graph of an earlier version of lightharmony. Empty for any other bytes.
pub fn blobs_of(payload: &[u8]) -> Vec<Digest> {
    match payload.try_into() {
        Ok(digest) => vec![Digest::from_bytes(digest)],
        Err(_) => match PartRecord::decode(payload) {
            Ok(part) => vec![part.blob],
            Err(_) => Record::stored_blobs(payload).unwrap_or_default(),
        },
    }
}

pub(crate) fn write_notes(to: &mut Encoder, notes: &Notes) {
    to.u64(notes.iter().count() as u64);
    for note in notes.iter() {
        to.u8(LEVELS.iter().position(|level| *level == note.level).unwrap_or_default() as u8);
        to.str(&note.id);
        to.str(&note.text);
    }
}

pub(crate) fn read_notes(from: &mut Decoder<'_>) -> Result<Notes, Corrupt> {
    let mut notes = Notes::none();
    for _ in 0..from.length(17)? {
        let level = from.u8()? as usize;
        let level =
            *LEVELS.get(level).ok_or_else(|| Corrupt(format!("the level {level} of a note is unknown")))?;
        notes.push(level, &from.str()?, from.str()?);
    }
    Ok(notes)
}

const LEVELS: [Level; 4] = [Level::Count, Level::Decision, Level::Warning, Level::Degraded];

pub(crate) fn digest(to: &mut Encoder, digest: &Digest) {
    digest.as_bytes().iter().for_each(|byte| to.u8(*byte));
}

pub(crate) fn read_digest(from: &mut Decoder<'_>) -> Result<Digest, Corrupt> {
    from.array().map(Digest::from_bytes)
}
