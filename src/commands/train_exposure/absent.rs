//! `train-exposure` in a build without the feature `learned`.

use std::ffi::OsString;

use clap::Args;

use crate::session::Error;
use crate::terminal;

const MISSING: &str = "This build lacks the feature `learned`. Build with `cargo build --release --features learned`; the help of that build lists the options. See docs/light.md and docs/kontext.md.";

/// Prints that the feature `learned` is missing; arguments are ignored.
#[derive(Debug, Args)]
#[command(after_help = MISSING)]
pub struct TrainExposure {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

impl TrainExposure {
    /// Prints the error and returns exit code 2.
    #[expect(clippy::unnecessary_wraps, reason = "all commands have this signature")]
    pub fn run(self) -> Result<u8, Error> {
        terminal::error(
            "`train-exposure` is not in this build, which lacks the feature `learned`\n  \
             help: build with `cargo build --release --features learned`; see docs/light.md and docs/kontext.md",
        );
        Ok(2)
    }
}
