//! `lightharmony`: inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.

mod causes;
mod commands;
mod origin;
mod report;
mod session;
mod svg;
mod trace;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    let command = commands::Command::parse();
    match command.run() {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            report::error(&error.to_string());
            ExitCode::from(2)
        }
    }
}
