//! Declarative dataflow: graph files, typed ports, content keys, a caching scheduler.
//!
//! The engine knows graphs, ports, keys and schedules and never an image. A crate of kinds implements
//! [`Kind`] for each of its nodes and hands a [`Registry`] over.

extern crate self as engine;

mod artifact;
mod context;
mod diag;
mod error;
mod files;
mod kind;
mod note;
mod param;
mod port;
mod syntax;

pub use artifact::{
    AnyArtifact, Artifact, ArtifactType, Corrupt, Decoder, Difference, Encoder, decode_all, encode_to_vec,
};
pub use cache::Digest;
pub use context::{Context, ContextField, Part, Scene, SourceFile, SourceRoot, Up};
pub use diag::Diagnostic;
pub use error::NodeError;
pub use files::{FileBytes, Files};
pub use kind::{Cost, Keep, Kind, KindEntry, Registry};
pub use note::{Level, Note, Notes};
pub use param::{InputFile, NotCanonical, OutputFile, ParamSpec, ParamType, Params, Role, canonical};
pub use port::{Arity, InPort, Inputs, Outputs, PortSpec};
pub use serde;
pub use syntax::Fields;
