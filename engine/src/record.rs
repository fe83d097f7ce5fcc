//! Action records: what is known of a result without reading it.

use cache::{Digest, Manifest};

use crate::artifact::{Corrupt, Decoder, Encoder};
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

/// A finished node: its outputs by digest, its notes, its files, and the manifest of its key.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    pub outputs: Vec<Output>,
    pub files: Vec<FileRecord>,
    pub notes: Notes,
    /// How long the run took, for forecasts; no part of any key.
    pub seconds: f64,
    pub manifest: Manifest,
}

impl Record {
    pub fn encode(&self) -> Vec<u8> {
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
        to.u8s(self.manifest.as_bytes());
        to.finish()
    }

    /// Reads a record of a kind whose outputs are of the given types; a record of other types is no
    /// record of this kind.
    pub fn decode(bytes: &[u8], types: &[(&'static str, u32)]) -> Result<Self, Corrupt> {
        let mut from = Decoder::new(bytes);
        if from.length(45)? != types.len() {
            return Err(Corrupt("another number of outputs".to_owned()));
        }
        let mut outputs = Vec::with_capacity(types.len());
        for &(type_name, format) in types {
            let (name, number) = (from.str()?, from.u32()?);
            if name != type_name || number != format {
                return Err(Corrupt(format!("holds {name} {number}, not {type_name} {format}")));
            }
            outputs.push(Output { type_name, format, digest: read_digest(&mut from)?, stored: from.bool()? });
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
        let manifest = Manifest::from_bytes(&from.u8s()?).ok_or_else(|| Corrupt("no manifest".to_owned()))?;
        from.end()?;
        Ok(Self { outputs, files, notes, seconds, manifest })
    }
}

const LEVELS: [Level; 4] = [Level::Count, Level::Decision, Level::Warning, Level::Degraded];

pub(crate) fn digest(to: &mut Encoder, digest: &Digest) {
    digest.as_bytes().iter().for_each(|byte| to.u8(*byte));
}

pub(crate) fn read_digest(from: &mut Decoder<'_>) -> Result<Digest, Corrupt> {
    let mut bytes = [0; 32];
    for byte in &mut bytes {
        *byte = from.u8()?;
    }
    Ok(Digest::from_bytes(bytes))
}
