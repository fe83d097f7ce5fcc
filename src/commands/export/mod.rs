//! `export`: writes a graph as a job of another scheduler.

mod openjd;
mod template;

use clap::{Args, Subcommand};

use crate::session::Error;

/// Writes a graph as a job of another scheduler.
#[derive(Debug, Args)]
pub struct Export {
    #[command(subcommand)]
    format: Format,
}

#[derive(Debug, Subcommand)]
enum Format {
    /// Write a job for Open Job Description (2023-09): a template and the bundle that its tasks run
    Openjd(openjd::OpenJd),
}

impl Export {
    /// Writes the job.
    pub fn run(self) -> Result<u8, Error> {
        match self.format {
            Format::Openjd(format) => format.run(),
        }
    }
}
