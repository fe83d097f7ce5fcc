//! Detection of the format of a file by its content, and of the other files that belong to it.

use std::io::Read;
use std::path::Path;

use engine::{InputFile, NodeError, SourceFile, SourceRoot};

use super::gltf::{self, Document};
use super::sog::Meta;
use super::streamed::{self, Ranges};
use super::{ksplat, splat, spz, usda};
use crate::error::Error;
use crate::io::foreign::{BYTE_ORDER_MARK, JPEG_XL, is_text, json_text, refuse_foreign};
use crate::io::mesh_format;

/// Extensions of files that may contain splats.
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
    /// USD in text.
    Usda,
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
            Self::Usda => "usda",
        }
    }

    /// Detects the format by content.
    pub fn of(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        // A centre of `.splat` may begin with the two bytes that mark JPEG XL.
        if bytes.starts_with(JPEG_XL) && splat::is_splat(bytes) {
            return Ok(Self::Splat);
        }
        refuse_foreign(file, bytes)?;
        let unmarked = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
        let starts = |magic: &[u8]| unmarked.starts_with(magic);
        if starts(b"ply\n") || starts(b"ply\r") || starts(b"ply ") {
            return Ok(Self::Ply);
        }
        if starts(&spz::GZIP) || starts(spz::MAGIC) {
            return Ok(Self::Spz);
        }
        if starts(b"PK\x03\x04") {
            return Ok(Self::SogBundle);
        }
        if starts(usda::MAGIC) {
            return Ok(Self::Usda);
        }
        if starts(usda::BINARY) {
            return Err(Error::unsupported(file, "binary USD; save it as text, `.usda`"));
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
            if streamed::is_streamed(bytes) {
                let what = "the list of the levels of a streamed SOG; `LoadSplats` reads it together with the other files of its folder";
                return Err(Error::unsupported(file, what));
            }
            let peek: Peek = serde_json::from_slice(json_text(bytes))
                .map_err(|e| Error::format(file, format!("the JSON is invalid: {e}")))?;
            return match peek {
                Peek { means: Some(_), .. } => Ok(Self::SogMeta),
                Peek { asset: Some(_), .. } => Ok(Self::Gltf),
                _ => Err(Error::format(file, "the JSON is neither glTF nor the `meta.json` of SOG")),
            };
        }
        if ksplat::is_ksplat(bytes) {
            return Ok(Self::Ksplat);
        }
        // The first bytes of these formats could be numbers of a `.splat` file, too, but have not been seen there.
        if let Some(format) = mesh_format::by_content(bytes) {
            let what = format!("{format}, a format without splats; export a mesh or an object as glTF 2.0");
            return Err(Error::unsupported(file, what));
        }
        if splat::is_splat(bytes) {
            return Ok(Self::Splat);
        }
        let named = ENDINGS.iter().find(|ending| file.to_ascii_lowercase().ends_with(*ending));
        let what = match named {
            _ if bytes.is_empty() => "the file is empty".to_owned(),
            Some(ending) => format!(
                "the file ({} bytes) begins neither like a `{ending}` file nor like a file of another splat format; is it complete?",
                bytes.len()
            ),
            None if is_text(bytes) => {
                "a text file, but not in a known splat format (PLY, `.usda`, glTF, `meta.json` of SOG)"
                    .to_owned()
            }
            None => {
                "not in a known splat format (PLY, compressed PLY, SOG, SPZ, .splat, .ksplat, glTF, .usda)"
                    .to_owned()
            }
        };
        Err(Error::format(file, what))
    }
}

fn is_json(bytes: &[u8]) -> bool {
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    text.iter().find(|b| !b.is_ascii_whitespace()) == Some(&b'{')
}

/// A file of splats that a parameter selects.
pub struct Piece {
    /// The file.
    pub file: InputFile,
    /// Rows to read, ascending; `None` for all of them.
    pub ranges: Option<Ranges>,
}

impl Piece {
    fn whole(file: InputFile) -> Self {
        Self { file, ranges: None }
    }
}

/// The files to which a parameter refers.
pub struct Expanded {
    /// Files of splats, in order.
    pub pieces: Vec<Piece>,
    /// The description of a streamed scene, which names the pieces.
    pub listing: Option<InputFile>,
    /// Decisions and warnings, each as (id, text, true for a warning).
    pub notes: Vec<(&'static str, String, bool)>,
}

impl Expanded {
    fn of(files: Vec<InputFile>) -> Self {
        Self { pieces: files.into_iter().map(Piece::whole).collect(), listing: None, notes: Vec::new() }
    }
}

/// Maximum length in bytes of a JSON file that is read to find the other files of a scene.
const JSON_LIMIT: u64 = 256 << 20;

/// Returns the files to which a parameter refers: the file itself, or the files in the folder. A folder with a
/// `meta.json` is a SOG scene. A folder with a `lod-meta.json` is a streamed scene, whose files of one level are
/// used. In any other folder, the SOG folders and bundles (`.sog`) that it contains are joined in the order of
/// their names.
pub fn expand(file: &InputFile, path: &Path, level: u32) -> Result<Expanded, NodeError> {
    if !path.is_dir() {
        let named = path.is_file() && file.0.to_ascii_lowercase().ends_with(".json");
        let read =
            || engine::read_at_most(path, JSON_LIMIT).ok().filter(|bytes| streamed::is_streamed(bytes));
        return match named.then(read).flatten() {
            Some(bytes) => streamed_level(file, &bytes, level),
            None => Ok(Expanded::of(vec![file.clone()])),
        };
    }
    let inside = |name: &str| InputFile(format!("{}/{name}", file.0.trim_end_matches('/')));
    let failed = |e| NodeError::new(format!("cannot list `{}`: {e}", path.display()));
    if path.join(streamed::NAME).is_file() {
        let bytes = engine::read_at_most(&path.join(streamed::NAME), JSON_LIMIT).map_err(failed)?;
        return streamed_level(&inside(streamed::NAME), &bytes, level);
    }
    if path.join("meta.json").is_file() {
        return Ok(Expanded::of(vec![inside("meta.json")]));
    }
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
        let what = format!("the folder `{}` contains no SOG scene", file.0);
        return Err(NodeError::new(what)
            .hint("give the path of a file, or of a folder that contains `meta.json` or chunks"));
    }
    chunks.sort();
    let mut all = Expanded::of(chunks.iter().map(|name| inside(name)).collect());
    if looks_like_levels(&chunks) {
        let text = format!(
            "the folder `{}` contains chunks whose names are those of the levels of a streamed SOG, but not its `{}`. All chunks are \
             joined; if they are levels of the same scene, give the path of one chunk instead of the folder",
            file.0,
            streamed::NAME
        );
        all.notes.push(("levels-joined", text, true));
    }
    Ok(all)
}

/// True if the names of all chunks have the form `LEVEL_NUMBER`, as splat-transform names the chunks of a streamed
/// scene, and there is more than one level.
fn looks_like_levels(chunks: &[String]) -> bool {
    let level = |chunk: &String| -> Option<u32> {
        let name = chunk.split(['/', '.']).next()?;
        let (level, number) = name.split_once('_')?;
        number.parse::<u32>().ok()?;
        level.parse().ok()
    };
    let levels: Option<std::collections::BTreeSet<u32>> = chunks.iter().map(level).collect();
    levels.is_some_and(|levels| levels.len() > 1)
}

/// The files of one level of a streamed scene.
fn streamed_level(listing: &InputFile, bytes: &[u8], level: u32) -> Result<Expanded, NodeError> {
    let found = streamed::level(&listing.0, bytes, level)?;
    let folder = listing.0.rsplit_once('/').map_or(String::new(), |(folder, _)| format!("{folder}/"));
    let text = format!("level {level} of `{}` is read (number of levels: {})", listing.0, found.levels);
    let pieces = found
        .files
        .into_iter()
        .map(|(name, ranges)| Piece { file: InputFile(format!("{folder}{name}")), ranges })
        .collect();
    Ok(Expanded { pieces, listing: Some(listing.clone()), notes: vec![("streamed-level", text, false)] })
}

/// A file and the files that it refers to, found by reading JSON only.
pub fn with_companions(file: &InputFile, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
    let source = root.file(file);
    let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", source.path.display()));
    let mut head = Vec::new();
    let opened = engine::open_regular(&source.path).map_err(failed)?;
    opened.take(64).read_to_end(&mut head).map_err(failed)?;
    let mut sources = vec![source.clone()];
    if is_json(&head) {
        let bytes = engine::read_at_most(&source.path, JSON_LIMIT).map_err(failed)?;
        let names: Vec<String> = match Format::of(&file.0, &bytes)? {
            Format::SogMeta => Meta::read(&file.0, &bytes)?.files().map(str::to_owned).collect(),
            Format::Gltf => Document::read(&file.0, &bytes)?.files(&file.0)?,
            _ => Vec::new(),
        };
        sources.extend(names.iter().map(|name| root.sibling(&source, name)));
    }
    Ok(sources)
}
