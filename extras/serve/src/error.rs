//! Errors that prevent the server from starting.

use std::io;
use std::path::PathBuf;

/// The reason why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The port is in use.
    #[error(
        "the port {0} is in use by another program; choose a different port with `--port`, or leave `--port` out"
    )]
    PortInUse(u16),
    /// No port can be opened.
    #[error("cannot listen on 127.0.0.1: {0}")]
    Listen(io::Error),
    /// The system does not provide random numbers for the token.
    #[error("the system does not provide random numbers for the token of the page")]
    Random,
    /// The graph cannot be read.
    #[error("cannot read the graph `{}`: {error}", path.display())]
    Graph {
        /// Path of the graph.
        path: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// The thread of the server cannot be started.
    #[error("cannot start the thread of the server: {0}")]
    Thread(io::Error),
}
