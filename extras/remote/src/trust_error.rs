//! Errors in keys, and in files that contain keys.

use std::io;
use std::path::{Path, PathBuf};

/// An error in a key, or in a file that contains keys.
#[derive(Debug, thiserror::Error)]
pub enum TrustError {
    /// A file cannot be read or written.
    #[error("cannot {what} `{}`: {source}", .path.display())]
    Io {
        /// The operation, such as `read`.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] cache::Error),
    /// A file already exists, and a key is never overwritten.
    #[error("`{}` already exists; a key is never overwritten", .0.display())]
    Exists(PathBuf),
    /// Other users of the machine can read a secret.
    #[error("other users can read the secret in `{0}`, or write to the file; run `chmod 600 {0}`", .path.display())]
    Permissions {
        /// The file.
        path: PathBuf,
    },
    /// The settings name a certificate without its private key, or the reverse.
    #[error("`certificate` and `private_key` are used together, but `{0}` is missing in `remote.ron`")]
    Incomplete(&'static str),
    /// A token is empty or has characters that cannot be sent.
    #[error("the token for the server must be one word of printable ASCII characters")]
    Token,
    /// A line of a file is not valid.
    #[error("`{}`, line {line}: {why}", .path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// The reason.
        why: String,
    },
    /// A text is not a public key.
    #[error("`{0}` is not a public key; write NAME:KEY, as printed by `lightharmony key new`")]
    NoPublicKey(String),
    /// A name of a key is not valid.
    #[error(
        "`{0}` is not a valid name for a key; use up to 64 letters, digits, `.`, `-` and `_`, such as `farm-1`"
    )]
    Name(String),
    /// The key was revoked.
    #[error(
        "`{0}` was revoked, and a revoked key cannot be trusted again; make a new key with `lightharmony key new`"
    )]
    Revoked(String),
    /// The operating system does not provide random bytes.
    #[error("cannot get random bytes from the operating system: {0}")]
    Random(String),
}

impl TrustError {
    /// Returns a function that adds the operation and the path to an error of the operating system.
    pub(crate) fn io(what: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { what, path: path.to_owned(), source }
    }
}
