//! Reads a scene of splats from a file, outside a graph, for `convert` and `inspect`.

use std::path::Path;
use std::sync::Arc;

use clap::ValueEnum;
use engine::{Context, InputFile, Kind, Level, NodeError, Notes, Scene, Up};
use nodes::kinds::load_splats::{self, Frame, LoadSplats};
use nodes::types::Splats;

use crate::terminal;

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

/// Refuses a path that is neither a file nor a folder: a device or a pipe may never end.
pub fn check(path: &Path) -> Result<(), NodeError> {
    let name = path.display();
    let found = std::fs::metadata(path).map_err(|e| NodeError::new(format!("cannot read `{name}`: {e}")))?;
    let usable = found.is_file() || found.is_dir();
    usable
        .then_some(())
        .ok_or_else(|| NodeError::new(format!("`{name}` is neither a regular file nor a folder")))
}

/// Reads a scene of any format.
pub fn load(path: &Path, frame: Frame, cx: &Context) -> Result<(Arc<Splats>, Notes), NodeError> {
    let path = InputFile(path.display().to_string());
    let params = LoadSplats { path, more: Vec::new(), strict: false, max_extent: 1e6, frame };
    let (out, notes) = LoadSplats::run(&params, load_splats::In {}, cx)?;
    Ok((out.splats, notes))
}

/// Prints why a file cannot be used; returns the exit code.
pub fn failed(error: &NodeError) -> u8 {
    let hint = error.advice().map(|hint| format!("\n  hint: {hint}")).unwrap_or_default();
    terminal::error(&format!("{error}{hint}"));
    1
}

/// Notes as lines of text.
pub fn lines(notes: &Notes) -> String {
    let word = |level: Level| match level {
        Level::Count | Level::Decision => "note",
        Level::Warning => "warning",
        Level::Degraded => "degraded",
    };
    notes.iter().map(|note| format!("{:>9} {} [{}]\n", word(note.level), note.text, note.id)).collect()
}
