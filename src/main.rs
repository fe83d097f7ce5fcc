//! `lightharmony`: inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.

mod commands;
mod session;
mod terminal;

use std::process::ExitCode;

fn main() -> ExitCode {
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
