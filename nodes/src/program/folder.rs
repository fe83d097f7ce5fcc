//! The folder in which a program runs.

use std::path::{Component, Path, PathBuf};

use engine::TempFolder;

use super::error::ProgramError;

/// Name of the folder of outputs.
const OUTPUTS: &str = "out";

/// A temporary folder with the inputs and outputs of a program, which is removed when the node ends.
pub struct WorkFolder {
    _whole: TempFolder,
    path: PathBuf,
}

impl WorkFolder {
    /// Creates an empty folder with a folder of outputs, which only the user can read.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn new() -> Result<Self, ProgramError> {
        let whole = TempFolder::private()?;
        let path = whole.path().canonicalize().map_err(io("find", whole.path()))?.join("run");
        let out = path.join(OUTPUTS);
        std::fs::create_dir_all(&out).map_err(io("create", &out))?;
        Ok(Self { _whole: whole, path })
    }

    /// The folder in which the program runs.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder of outputs.
    pub fn out(&self) -> PathBuf {
        self.path.join(OUTPUTS)
    }

    /// The file that receives standard output or standard error, outside the folder of the program.
    pub(super) fn log(&self, name: &str) -> PathBuf {
        self.path.with_file_name(name)
    }

    /// Writes a file of inputs, and creates its folders. `name` is relative to the folder of the program.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, ProgramError> {
        let path = self.path.join(name);
        let folder = path.parent().unwrap_or(&self.path);
        std::fs::create_dir_all(folder).map_err(io("create", folder))?;
        std::fs::write(&path, bytes).map_err(io("write", &path))?;
        Ok(path)
    }

    /// Creates a folder. `name` is relative to the folder of the program.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn create(&self, name: &str) -> Result<PathBuf, ProgramError> {
        let path = self.path.join(name);
        std::fs::create_dir_all(&path).map_err(io("create", &path))?;
        Ok(path)
    }

    /// The content of an output file. `file` is relative to the folder of outputs. `program` and `last` are the name
    /// of the program and the last lines of its output, for error messages.
    ///
    /// # Errors
    /// If there is no such file, if it is a link out of the folder of the program, or if it cannot be read.
    pub fn output(&self, file: &str, program: &str, last: &str) -> Result<Vec<u8>, ProgramError> {
        let path = self.out().join(file);
        let (program, file) = (program.to_owned(), file.to_owned());
        let Ok(real) = path.canonicalize() else {
            return Err(ProgramError::NoOutput { program, file, output: last.to_owned() });
        };
        if !real.starts_with(&self.path) {
            return Err(ProgramError::Outside { program, file, target: real });
        }
        if !real.is_file() {
            return Err(ProgramError::NoOutput { program, file, output: last.to_owned() });
        }
        std::fs::read(&real).map_err(io("read", &real))
    }
}

/// True if a path of an output stays in its folder: it is relative, not empty, and has no `.` or `..`.
pub fn stays_inside(file: &str) -> bool {
    let mut parts = Path::new(file).components().peekable();
    parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
}

fn io<'p>(what: &'static str, path: &'p Path) -> impl FnOnce(std::io::Error) -> ProgramError + 'p {
    move |source| ProgramError::Io { what, path: path.to_owned(), source }
}
