//! Action records: what is known of a result without reading it.

use cache::{Digest, Manifest};

use crate::graph::node::Node;
use crate::value::artifact::{ArtifactType, Corrupt, Decoder, Encoder};
use crate::value::counts::{Counts, Effort};
use crate::value::note::{Level, Notes};

/// One output of a finished node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Output {
    pub type_name: &'static str,
    pub format: u32,
    pub digest: Digest,
    /// What the work of its readers grows with.
    pub size: u64,
    /// False where only the digest was kept.
    pub stored: bool,
}

/// One file that a sink made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileRecord {
    pub view: String,
    pub digest: Digest,
}

/// What a node's code took. No part of any key: it is for forecasts and for people.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spent {
    /// Wall time, that of parts that were known included.
    pub seconds: f64,
    /// CPU time of all threads, likewise.
    pub cpu_seconds: f64,
    /// [`crate::Kind::work`].
    pub work: f64,
    /// Bytes: what it was admitted with, or its outputs where they were more. Its inputs come on top.
    pub memory: u64,
    /// Work by name: rays, blends; that of parts that were known included, so that it does not depend on what
    /// was in the cache.
    pub counts: Counts,
}

/// What the store keeps of a part: where its bytes are, and what it took.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PartRecord {
    pub blob: Digest,
    pub spent: Effort,
}

impl PartRecord {
    pub fn encode(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        // No node's record begins so, since it begins with its length.
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
            return Err(Corrupt("no part".to_owned()));
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

/// A finished node: its outputs by digest, its notes and its files. Stored, the manifest of its key follows.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    pub outputs: Vec<Output>,
    pub files: Vec<FileRecord>,
    pub notes: Notes,
    pub spent: Spent,
}

impl Record {
    /// The bytes to store: the record, then the manifest of its key.
    pub fn encode(&self, manifest: &Manifest) -> Vec<u8> {
        let mut whole = Encoder::default();
        whole.u8s(&self.body());
        whole.u8s(manifest.as_bytes());
        whole.finish()
    }

    /// The bytes without the manifest.
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

    /// Reads a record of a node's kind; a record of other outputs is none of this kind.
    pub fn decode(bytes: &[u8], node: &Node) -> Result<Self, Corrupt> {
        Self::decode_body(Decoder::new(bytes).raw()?, node)
    }

    /// Reads what [`body`](Self::body) wrote.
    pub fn decode_body(body: &[u8], node: &Node) -> Result<Self, Corrupt> {
        let mut from = Decoder::new(body);
        let ports = &node.kind.outputs;
        if from.length(53)? != ports.len() {
            return Err(Corrupt("another number of outputs".to_owned()));
        }
        let mut outputs = Vec::with_capacity(ports.len());
        for ArtifactType { name, format, .. } in ports.iter().map(|port| port.artifact) {
            let StoredOutput { type_name, number, digest, size, stored } = StoredOutput::read(&mut from)?;
            if type_name != name.as_bytes() || number != format {
                return Err(Corrupt(format!("holds another type than {name} {format}")));
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

    /// The stored blobs that a record of any kind of node names.
    fn stored_blobs(bytes: &[u8]) -> Result<Vec<Digest>, Corrupt> {
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

    /// The bytes of a stored record where only the values that `kept` knows lie beside it.
    ///
    /// # Errors
    /// For what is no record of a node.
    pub fn keeping(bytes: &[u8], kept: impl Fn(&Digest) -> bool) -> Result<Vec<u8>, Corrupt> {
        let mut from = Decoder::new(bytes);
        let body = from.raw_range(bytes)?;
        let mut outputs = Decoder::new(&bytes[body.clone()]);
        let mut whole = bytes.to_vec();
        for _ in 0..outputs.length(53)? {
            let output = StoredOutput::read(&mut outputs)?;
            // The last byte of an output says whether its value was stored.
            whole[body.end - outputs.left() - 1] = u8::from(output.stored && kept(&output.digest));
        }
        Ok(whole)
    }

    /// What the key of a stored record was made of. Most readers have no use for it, so it is read apart.
    pub fn manifest(bytes: &[u8]) -> Option<Manifest> {
        let mut from = Decoder::new(bytes);
        from.raw().ok()?;
        Manifest::from_bytes(from.raw().ok()?)
    }
}

/// One output as it is stored, of whatever type.
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

/// The blobs that a record in the store names: those of a node, of a part, or of a compiled graph. What is
/// no record of ours names none.
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
        let level = *LEVELS.get(level).ok_or_else(|| Corrupt(format!("level {level}")))?;
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
