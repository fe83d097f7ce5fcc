//! The error of programs.

use std::path::PathBuf;
use std::process::ExitStatus;

/// Errors of programs.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// There is no such program.
    #[error("the program `{program}` was not found {place}")]
    Missing {
        /// Name or path of the program, as the graph states it.
        program: String,
        /// The places that were searched.
        place: String,
    },
    /// The program cannot be started.
    #[error("the program `{program}` cannot be started: {source}")]
    NotStarted {
        /// Name or path of the program.
        program: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The program ended with another exit status than 0.
    #[error("`{program}` failed with {status}; {output}")]
    Failed {
        /// Name of the program, with the step if it has several.
        program: String,
        /// The exit status.
        status: ExitStatus,
        /// The last lines of its output.
        output: String,
    },
    /// The program ended without an error, but did not write its output.
    #[error("`{program}` ended without an error, but did not write `{file}`; {output}")]
    NoOutput {
        /// Name of the program.
        program: String,
        /// The missing file, relative to the folder of outputs.
        file: String,
        /// The last lines of its output.
        output: String,
    },
    /// The output is a link that leads out of the folder of the program.
    #[error("`{program}` wrote `{file}` as a link out of its folder, to `{}`", target.display())]
    Outside {
        /// Name of the program.
        program: String,
        /// The file, relative to the folder of outputs.
        file: String,
        /// The target of the link.
        target: PathBuf,
    },
    /// A file or folder of the program cannot be read or written.
    #[error("cannot {what} `{}`: {source}", path.display())]
    Io {
        /// The operation, such as `write`.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The folder of the program cannot be made.
    #[error(transparent)]
    Folder(#[from] engine::CacheError),
    /// The run was cancelled.
    #[error("stopped")]
    Stopped,
}
