//! Video: the kind `write-video`, which writes frames as AV1 in an MP4 file. This crate is not part of a default build;
//! the feature `video` of `lightharmony` adds it.
//!
//! [`write_video`] is the kind. A film is encoded in segments that begin with a key frame and do not depend on each
//! other ([`av1`]), so that all threads work and the bytes do not depend on their number. [`planes`] converts display
//! codes to luma and chroma, [`mp4`] writes the container.

pub mod av1;
pub mod mp4;
pub mod planes;
pub mod rate;
pub mod write_video;

pub use write_video::WriteVideo;

/// Errors of encoding a film.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VideoError {
    /// The run was cancelled.
    #[error("stopped")]
    Stopped,
    /// The encoder refuses the settings.
    #[error("the AV1 encoder refuses these settings: {0}")]
    Settings(String),
    /// The encoder failed.
    #[error("the AV1 encoder failed: {0}")]
    Encoder(String),
    /// The container cannot be written.
    #[error("the MP4 container cannot be written: {0}")]
    Container(String),
}
