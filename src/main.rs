//! `lightharmony`: inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.

mod commands;
mod session;
mod terminal;

use std::process::ExitCode;

fn main() -> ExitCode {
    report_file_size_limit();
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

/// Makes a write beyond the file size limit of the process (`ulimit -f`) an error, as on a full disk, in place of a
/// signal that kills the process without a message.
fn report_file_size_limit() {
    #[cfg(unix)]
    {
        // Any handler will do: the write then returns an error. Without one, the limit kills as before.
        let flag = std::sync::Arc::<std::sync::atomic::AtomicBool>::default();
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, flag);
    }
}
