//! Errors in calls to a server.

use tonic::{Code, Status};

/// The reason why a call to a server gave no answer.
#[derive(Debug, Clone, thiserror::Error)]
pub enum CallError {
    /// The run was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The server does not have the requested data.
    #[error("not found")]
    NotFound,
    /// The server does not allow the call.
    #[error("{what} was refused: {why}")]
    Refused {
        /// The call.
        what: &'static str,
        /// The reason.
        why: String,
    },
    /// The server cannot be reached, or repeatedly gave no answer.
    #[error("{what} failed: {why}")]
    Failed {
        /// The call.
        what: &'static str,
        /// The reason.
        why: String,
    },
    /// The answer violates the protocol.
    #[error("{what} failed, because the answer of the server violates the protocol: {why}")]
    Wrong {
        /// The call.
        what: &'static str,
        /// The reason.
        why: String,
    },
    /// The thread that waits for the network cannot be started, or the address is not valid.
    #[error("cannot connect: {0}")]
    Connect(String),
}

impl CallError {
    pub(crate) fn wrong(what: &'static str, why: impl Into<String>) -> Self {
        Self::Wrong { what, why: why.into() }
    }

    pub(crate) fn of(what: &'static str, status: &Status) -> Self {
        let message =
            if status.message().is_empty() { status.code().description() } else { status.message() };
        // The first cause, such as a certificate that is not valid, is the most useful part of a failed connection.
        let mut cause = std::error::Error::source(status);
        while let Some(next) = cause.and_then(std::error::Error::source) {
            cause = Some(next);
        }
        let why = match cause.map(ToString::to_string).filter(|cause| cause != message) {
            Some(cause) => format!("{message} ({cause})"),
            None => message.to_owned(),
        };
        match status.code() {
            Code::NotFound => Self::NotFound,
            Code::PermissionDenied | Code::Unauthenticated | Code::Unimplemented => {
                Self::Refused { what, why }
            }
            _ => Self::Failed { what, why },
        }
    }
}

/// True if a call that failed with this code may succeed when it is repeated.
pub(crate) fn is_passing(code: Code) -> bool {
    matches!(
        code,
        Code::Unavailable
            | Code::Aborted
            | Code::Internal
            | Code::Unknown
            | Code::Cancelled
            | Code::DeadlineExceeded
            | Code::ResourceExhausted
    )
}
