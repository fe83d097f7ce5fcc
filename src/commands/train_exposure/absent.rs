//! `train-exposure` in a build without a tensor library.

use std::ffi::OsString;

use clap::Args;

use crate::session::Error;
use crate::terminal;

const LACKS: &str = "This build lacks the feature `learned`: `cargo build --release --features learned` makes one that has it, whose `--help` lists the options; docs/light.md and docs/kontext.md tell more.";

/// Says what is missing, whatever else is asked.
#[derive(Debug, Args)]
#[command(after_help = LACKS)]
pub struct TrainExposure {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

impl TrainExposure {
    /// Exit code 2.
    #[expect(clippy::unnecessary_wraps, reason = "as that of every verb")]
    pub fn run(self) -> Result<u8, Error> {
        terminal::error(
            "`train-exposure` is not in this build, which lacks the feature `learned`\n  \
             help: `cargo build --release --features learned` makes one that has it; docs/light.md and docs/kontext.md tell more",
        );
        Ok(2)
    }
}
