//! `lightharmony`: inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.

mod budget;
mod causes;
mod commands;
mod origin;
mod report;
mod session;
mod svg;
mod trace;

use std::process::ExitCode;

fn main() -> ExitCode {
    let command = commands::Command::read();
    let json = command.tells_json();
    match command.run() {
        Ok(code) => return ExitCode::from(code),
        Err(session::Error::Graph(mistakes)) => report::mistakes(&mistakes, json),
        Err(error) if json => {
            report::json_line(&serde_json::json!({"event": "error", "message": error.to_string()}));
        }
        Err(error) => report::error(&error.to_string()),
    }
    ExitCode::from(2)
}
