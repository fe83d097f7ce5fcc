//! Action records: what is known of a result without reading it.

use cache::{Digest, Manifest};

use crate::artifact::{ArtifactType, Corrupt, Decoder, Encoder};
use crate::graph::Node;
use crate::note::{Level, Notes};

/// One output of a finished node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Output {
    pub type_name: &'static str,
    pub format: u32,
    pub digest: Digest,
    /// False where only the digest was kept.
    pub stored: bool,
}

/// One file that a sink made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileRecord {
    pub view: String,
    pub digest: Digest,
}

/// A finished node: its outputs by digest, its notes and its files. Stored, the manifest of its key follows.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    pub outputs: Vec<Output>,
    pub files: Vec<FileRecord>,
    pub notes: Notes,
    /// How long the run took, for forecasts; no part of any key.
    pub seconds: f64,
}

impl Record {
    /// The bytes to store: the record, then the manifest of its key.
    pub fn encode(&self, manifest: &Manifest) -> Vec<u8> {
        let mut whole = Encoder::default();
        whole.u8s(&self.body());
        whole.u8s(manifest.as_bytes());
        whole.finish()
    }

    fn body(&self) -> Vec<u8> {
        let mut to = Encoder::default();
        to.u64(self.outputs.len() as u64);
        for output in &self.outputs {
            to.str(output.type_name);
            to.u32(output.format);
            digest(&mut to, &output.digest);
            to.bool(output.stored);
        }
        to.u64(self.files.len() as u64);
        for file in &self.files {
            to.str(&file.view);
            digest(&mut to, &file.digest);
        }
        let notes: Vec<_> = self.notes.iter().collect();
        to.u64(notes.len() as u64);
        for note in notes {
            to.u8(LEVELS.iter().position(|level| *level == note.level).unwrap_or_default() as u8);
            to.str(&note.id);
            to.str(&note.text);
        }
        to.f64(self.seconds);
        to.finish()
    }

    /// Reads a record of a node's kind; a record of other outputs is none of this kind.
    pub fn decode(bytes: &[u8], node: &Node) -> Result<Self, Corrupt> {
        let mut from = Decoder::new(Decoder::new(bytes).raw()?);
        let ports = &node.kind.outputs;
        if from.length(45)? != ports.len() {
            return Err(Corrupt("another number of outputs".to_owned()));
        }
        let mut outputs = Vec::with_capacity(ports.len());
        for ArtifactType { name, format, .. } in ports.iter().map(|port| port.artifact) {
            let (found, number) = (from.raw()?, from.u32()?);
            if found != name.as_bytes() || number != format {
                return Err(Corrupt(format!("holds another type than {name} {format}")));
            }
            let digest = read_digest(&mut from)?;
            outputs.push(Output { type_name: name, format, digest, stored: from.bool()? });
        }
        let files = (0..from.length(40)?)
            .map(|_| Ok(FileRecord { view: from.str()?, digest: read_digest(&mut from)? }))
            .collect::<Result<_, Corrupt>>()?;
        let mut notes = Notes::none();
        for _ in 0..from.length(17)? {
            let level = from.u8()? as usize;
            let level = *LEVELS.get(level).ok_or_else(|| Corrupt(format!("level {level}")))?;
            notes.push(level, &from.str()?, from.str()?);
        }
        let seconds = from.f64()?;
        from.end()?;
        Ok(Self { outputs, files, notes, seconds })
    }

    /// What the key of a stored record was made of. Most readers have no use for it, so it is read apart.
    pub fn manifest(bytes: &[u8]) -> Option<Manifest> {
        let mut from = Decoder::new(bytes);
        from.raw().ok()?;
        Manifest::from_bytes(from.raw().ok()?)
    }
}

const LEVELS: [Level; 4] = [Level::Count, Level::Decision, Level::Warning, Level::Degraded];

pub(crate) fn digest(to: &mut Encoder, digest: &Digest) {
    digest.as_bytes().iter().for_each(|byte| to.u8(*byte));
}

pub(crate) fn read_digest(from: &mut Decoder<'_>) -> Result<Digest, Corrupt> {
    from.array().map(Digest::from_bytes)
}
