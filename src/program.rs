//! The program: the kinds it knows, and its command line.

use std::process::ExitCode;

use engine::{Kind, KindEntry};

use crate::{commands, session, terminal};

/// A program with the command line of `lightharmony`, the kinds of [`nodes`], and more kinds.
///
/// The documentation of the crate has an example. The type is used once, in `main`:
/// `Program::new().with::<MyKind>().run()`.
#[derive(Debug, Default)]
pub struct Program {
    kinds: Vec<fn() -> KindEntry>,
}

impl Program {
    /// A program with the kinds of [`nodes`].
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a kind.
    #[must_use]
    pub fn with<K: Kind>(mut self) -> Self {
        self.kinds.push(KindEntry::of::<K>);
        self
    }

    /// Parses the command line of the process, runs the command and returns the exit code. Call it once, from
    /// `main`. Errors are printed; the exit code is then 2. If two kinds have the same name, this is such an error.
    pub fn run(self) -> ExitCode {
        report_file_size_limit();
        #[cfg(feature = "learned")]
        learned::diffusion::install();
        #[cfg(feature = "video")]
        let kinds = [self.kinds, vec![KindEntry::of::<video::WriteVideo>]].concat();
        #[cfg(not(feature = "video"))]
        let kinds = self.kinds;
        if !kinds.is_empty()
            && let Err(error) = nodes::add_kinds(kinds)
        {
            terminal::error(&error.to_string());
            return ExitCode::from(2);
        }
        let command = commands::Command::read();
        let json = command.prints_json();
        match command.run() {
            Ok(code) => return ExitCode::from(code),
            Err(session::Error::Graph(mistakes)) => terminal::mistakes(&mistakes, json),
            Err(error) if json => {
                terminal::json_line(&serde_json::json!({"event": "error", "message": error.to_string()}));
            }
            Err(error) => terminal::error(&error.to_string()),
        }
        ExitCode::from(2)
    }
}

/// Makes a write beyond the file size limit of the process (`ulimit -f`) return an error, as on a full disk. By
/// default, a signal kills the process without a message.
fn report_file_size_limit() {
    #[cfg(unix)]
    {
        // With any handler, the write returns an error. If no handler can be set, the signal still kills the
        // process.
        let flag = std::sync::Arc::<std::sync::atomic::AtomicBool>::default();
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, flag);
    }
}
