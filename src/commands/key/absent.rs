//! `key` in a build without the feature `remote`.

use std::ffi::OsString;

use clap::Args;

use crate::session::Error;
use crate::terminal;

const MISSING: &str = "This build lacks the feature `remote`. Build with `cargo build --release --features remote`; the help of that build lists the options. See docs/remote.md.";

/// Prints that the feature `remote` is missing; arguments are ignored.
#[derive(Debug, Args)]
#[command(after_help = MISSING)]
pub struct Key {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

impl Key {
    /// Prints the error and returns exit code 2.
    #[expect(clippy::unnecessary_wraps, reason = "all commands have this signature")]
    pub fn run(self) -> Result<u8, Error> {
        terminal::error(
            "`key` is not in this build, which lacks the feature `remote`\n  \
             help: build with `cargo build --release --features remote`; see docs/remote.md",
        );
        Ok(2)
    }
}
