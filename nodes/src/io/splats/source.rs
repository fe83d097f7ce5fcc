//! Detection of the format of a file by its content, and of the other files that belong to it.

use std::io::Read;
use std::path::Path;

use engine::{InputFile, NodeError, SourceFile, SourceRoot, Up};

use super::gltf::{self, Document};
use super::sog::Meta;
use super::{ksplat, splat, spz};
use crate::error::Error;

/// File extensions of splats.
const ENDINGS: [&str; 8] = [".ply", ".spz", ".sog", ".json", ".glb", ".gltf", ".ksplat", ".splat"];

/// A format of splats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// INRIA or compressed PLY, depending on the header.
    Ply,
    /// SPZ of any version.
    Spz,
    /// `meta.json` of SOG.
    SogMeta,
    /// A ZIP archive of SOG.
    SogBundle,
    /// Binary glTF.
    Glb,
    /// glTF as JSON.
    Gltf,
    /// `.ksplat`.
    Ksplat,
    /// `.splat`.
    Splat,
}

impl Format {
    /// Name of the format, for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Spz => "spz",
            Self::SogMeta | Self::SogBundle => "sog",
            Self::Glb | Self::Gltf => "gltf",
            Self::Ksplat => "ksplat",
            Self::Splat => "splat",
        }
    }

    /// The axis that the format defines as up.
    pub fn declared_up(self) -> Option<Up> {
        matches!(self, Self::Spz | Self::Glb | Self::Gltf).then_some(Up::PlusY)
    }

    /// Detects the format by content.
    pub fn of(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let starts = |magic: &[u8]| bytes.starts_with(magic);
        if starts(b"ply\n") || starts(b"ply\r\n") || starts(b"ply ") {
            return Ok(Self::Ply);
        }
        if starts(&spz::GZIP) || starts(spz::MAGIC) {
            return Ok(Self::Spz);
        }
        if starts(b"PK\x03\x04") {
            return Ok(Self::SogBundle);
        }
        if starts(gltf::MAGIC) {
            return Ok(Self::Glb);
        }
        if is_json(bytes) {
            #[derive(serde::Deserialize)]
            struct Peek {
                asset: Option<serde::de::IgnoredAny>,
                means: Option<serde::de::IgnoredAny>,
            }
            let peek: Peek = serde_json::from_slice(bytes)
                .map_err(|e| Error::format(file, format!("broken JSON: {e}")))?;
            return match peek {
                Peek { means: Some(_), .. } => Ok(Self::SogMeta),
                Peek { asset: Some(_), .. } => Ok(Self::Gltf),
                _ => Err(Error::format(file, "JSON that is neither glTF nor the `meta.json` of SOG")),
            };
        }
        if ksplat::is_ksplat(bytes) {
            return Ok(Self::Ksplat);
        }
        if splat::is_splat(bytes) {
            return Ok(Self::Splat);
        }
        let named = ENDINGS.iter().find(|ending| file.to_ascii_lowercase().ends_with(*ending));
        let what = match named {
            _ if bytes.is_empty() => "the file is empty".to_owned(),
            Some(ending) => format!(
                "{} bytes that do not begin as a `{ending}` does, nor as splats of any format; is the file whole?",
                bytes.len()
            ),
            None => "not a known format of splats (PLY, compressed PLY, SOG, SPZ, .splat, .ksplat, glTF)"
                .to_owned(),
        };
        Err(Error::format(file, what))
    }
}

fn is_json(bytes: &[u8]) -> bool {
    bytes.iter().find(|b| !b.is_ascii_whitespace()) == Some(&b'{')
}

/// The files of a parameter: the file itself, or the files in the folder. A folder is a SOG scene with its
/// `meta.json`, or holds such folders and bundles (`.sog`), joined in the order of their names.
pub fn expand(file: &InputFile, path: &Path) -> Result<Vec<InputFile>, NodeError> {
    if !path.is_dir() {
        return Ok(vec![file.clone()]);
    }
    let inside = |name: &str| InputFile(format!("{}/{name}", file.0.trim_end_matches('/')));
    if path.join("meta.json").is_file() {
        return Ok(vec![inside("meta.json")]);
    }
    let failed = |e| NodeError::new(format!("cannot list `{}`: {e}", path.display()));
    let mut chunks = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let Ok(name) = entry.file_name().into_string() else { continue };
        if entry.path().join("meta.json").is_file() {
            chunks.push(format!("{name}/meta.json"));
        } else if name.ends_with(".sog") && entry.path().is_file() {
            chunks.push(name);
        }
    }
    if chunks.is_empty() {
        let what = format!("the folder `{}` holds no SOG scene", file.0);
        return Err(NodeError::new(what).hint("name a file, or a folder with `meta.json` or with chunks"));
    }
    chunks.sort();
    Ok(chunks.iter().map(|name| inside(name)).collect())
}

/// A file and the files that it refers to, found by reading JSON only.
pub fn with_companions(file: &InputFile, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
    let source = root.file(file);
    let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", source.path.display()));
    if !std::fs::metadata(&source.path).map_err(failed)?.is_file() {
        return Err(NodeError::new(format!("`{}` is not a regular file", source.path.display())));
    }
    let mut head = Vec::new();
    std::fs::File::open(&source.path).map_err(failed)?.take(64).read_to_end(&mut head).map_err(failed)?;
    let mut sources = vec![source.clone()];
    if is_json(&head) {
        let bytes = std::fs::read(&source.path).map_err(failed)?;
        let names: Vec<String> = match Format::of(&file.0, &bytes)? {
            Format::SogMeta => Meta::read(&file.0, &bytes)?.files().map(str::to_owned).collect(),
            Format::Gltf => Document::read(&file.0, &bytes)?.files().map(str::to_owned).collect(),
            _ => Vec::new(),
        };
        sources.extend(names.iter().map(|name| root.beside(&source, name)));
    }
    Ok(sources)
}
