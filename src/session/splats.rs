//! Reads scenes of splats from files, outside a graph, for `convert` and `inspect`.

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use engine::{Context, FileHead, InputFile, Kind, Level, NodeError, Notes, Scene, SourceRoot, Up};
use nodes::kinds::load_splats::{self, Frame, LoadSplats};
use scene::io::picture::floats_of;
use scene::io::splats::StatedUp;
use scene::types::Splats;

use super::error::Error;
use super::mesh;
use crate::terminal;

/// The memory limit.
#[derive(Debug, Clone, Args)]
pub struct MemoryArgs {
    /// Maximum memory for the scene, such as 4G; 0 (the default) means three quarters of the free memory. A file
    /// whose header requires more is not read
    #[arg(long, value_name = "SIZE")]
    memory: Option<String>,
}

impl MemoryArgs {
    /// The limit in bytes.
    pub fn bytes(&self) -> Result<u64, Error> {
        let bytes = self.memory.as_deref().map_or(Ok(0), super::size)?;
        Ok(if bytes > 0 { bytes } else { engine::default_memory() })
    }
}

/// Returns an error if reading a file or folder requires more than `memory` bytes according to its headers, since a
/// file of a few megabytes may claim any number of splats, triangles or pixels.
pub fn check_memory(path: &Path, memory: u64) -> Result<(), NodeError> {
    let file = InputFile(path.display().to_string());
    let root = SourceRoot::new("");
    let splats = params(file.clone(), Frame::AsStored);
    let (sources, is_splats) = match LoadSplats::sources(&splats, &root) {
        Ok(sources) => (sources, true),
        // Not splats; what is wrong with the file is found by reading it.
        Err(_) => (vec![root.file(&file)], false),
    };
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |found| found.len());
    let heads: Vec<_> = sources.iter().map(|source| FileHead::new(source, length(&source.path))).collect();
    let of_splats = if is_splats { LoadSplats::estimate_files(&splats, &heads).bytes } else { 0 };
    let of_mesh = if mesh::is_mesh(path) { mesh::estimate(file, &heads) } else { 0 };
    let of_picture = heads.iter().map(|head| floats_of(head)[0]).max().unwrap_or(0);
    let bytes = of_splats.max(of_mesh).max(of_picture);
    if bytes <= memory {
        return Ok(());
    }
    let (needs, budget) = (engine::bytes_text(bytes), engine::bytes_text(memory));
    let what = format!("`{}` needs about {needs} of memory, but the budget is {budget}", path.display());
    Err(NodeError::new(what).hint("raise `--memory`"))
}

fn params(path: InputFile, frame: Frame) -> LoadSplats {
    LoadSplats { path, more: Vec::new(), strict: false, max_extent: 1e6, level: 0, frame, matrix: None }
}

/// The axis of the world that points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UpArg {
    /// +y
    #[value(name = "+y")]
    PlusY,
    /// -y, as in most INRIA PLY files
    #[value(name = "-y")]
    MinusY,
    /// +z
    #[value(name = "+z")]
    PlusZ,
}

impl From<UpArg> for Up {
    fn from(up: UpArg) -> Self {
        match up {
            UpArg::PlusY => Up::PlusY,
            UpArg::MinusY => Up::MinusY,
            UpArg::PlusZ => Up::PlusZ,
        }
    }
}

/// A context for work outside a graph.
pub fn context(up: Up) -> Context {
    Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, "")
}

/// Rejects a path that is neither a file nor a folder, since devices and pipes may never end.
pub fn check(path: &Path) -> Result<(), NodeError> {
    let name = path.display();
    let found = std::fs::metadata(path).map_err(|e| NodeError::new(format!("cannot read `{name}`: {e}")))?;
    let usable = found.is_file() || found.is_dir();
    usable
        .then_some(())
        .ok_or_else(|| NodeError::new(format!("`{name}` is neither a regular file nor a folder")))
}

/// Number of bytes at the start of a file that are read for the comments of its header.
const HEAD: u64 = 1 << 16;

/// The up axis that a comment of a PLY file states; `None` for other files.
pub fn commented_up(path: &Path) -> Option<Up> {
    let mut head = Vec::new();
    let file = path.is_file().then(|| std::fs::File::open(path).ok()).flatten()?;
    file.take(HEAD).read_to_end(&mut head).ok()?;
    StatedUp::of(&head).filter(|up| !up.by_format).map(|up| up.axis)
}

/// Reads a scene of any format without the harmonics above degree 0, for statistics that do not use them. Also
/// returns the degree of the harmonics in the file.
pub fn load_plain(path: &Path, cx: &Context) -> Result<(Splats, u32, Notes), NodeError> {
    params(InputFile(path.display().to_string()), Frame::AsStored).plain(cx)
}

/// Reads a scene of any format.
pub fn load(path: &Path, frame: Frame, cx: &Context) -> Result<(Arc<Splats>, Notes), NodeError> {
    let params = params(InputFile(path.display().to_string()), frame);
    let (out, notes) = LoadSplats::run(&params, load_splats::In {}, cx)?;
    // Outside a graph, the up axis has no other axis to differ from.
    let notes = notes.iter().filter(|note| note.id != "up-differs").cloned().collect();
    Ok((out.splats, notes))
}

/// Prints why a file cannot be used, and returns the exit code.
pub fn failed(error: &NodeError) -> u8 {
    let hint = error.advice().map(|hint| format!("\n  hint: {hint}")).unwrap_or_default();
    terminal::error(&format!("{error}{hint}"));
    1
}

/// Formats notes as lines of text.
pub fn lines(notes: &Notes) -> String {
    let word = |level: Level| match level {
        Level::Count | Level::Decision => "note",
        Level::Warning => "warning",
        Level::Degraded => "degraded",
    };
    notes.iter().map(|note| format!("{:>9} {} [{}]\n", word(note.level), note.text, note.id)).collect()
}
