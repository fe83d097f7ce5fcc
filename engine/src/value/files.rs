//! The output of a sink: bytes of files that have no path yet.

use crate::value::artifact::{Artifact, Difference};
use crate::value::codec::{Corrupt, Decoder, Encoder};

/// A file of a sink.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileBytes {
    /// Name of the view that the file shows, which replaces `{view}` in the path. Empty for a file that does not
    /// belong to one view.
    pub view: String,
    /// Content of the file.
    pub bytes: Vec<u8>,
}

/// The output of a sink: one file per view. The engine writes the files to the sink's output path.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Files(pub Vec<FileBytes>);

impl Artifact for Files {
    const TYPE: &'static str = "files";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.u64(self.0.len() as u64);
        for file in &self.0 {
            to.str(&file.view);
            to.u8s(&file.bytes);
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let count = from.length(16)?;
        (0..count)
            .map(|_| Ok(FileBytes { view: from.str()?, bytes: from.u8s()? }))
            .collect::<Result<_, _>>()
            .map(Files)
    }

    fn bytes(&self) -> usize {
        self.0.iter().map(|file| file.bytes.len() + file.view.len() + 32).sum()
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let unequal = self.0.iter().zip(&other.0).filter(|(a, b)| a != b).count();
        let (count, others) = (self.0.len(), other.0.len());
        Difference::of(if count == others {
            format!("files that differ: {unequal} of {count}")
        } else {
            format!(
                "the numbers of files differ: {count} and {others}; files that differ among the first {}: {unequal}",
                count.min(others)
            )
        })
    }
}

/// The name of a view as part of a file name: characters that could lead to another folder become `_`.
pub(crate) fn plain_name(view: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '_' };
    let name: String = view.chars().map(plain).collect();
    // A name of dots alone would name a folder.
    if name.chars().all(|c| c == '.') { "_".repeat(name.len()) } else { name }
}
