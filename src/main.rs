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
