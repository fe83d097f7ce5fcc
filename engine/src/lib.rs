//! Declarative dataflow: graph files, typed ports, content keys, a caching scheduler.
//!
//! The engine knows graphs, ports, keys and schedules and never an image. A crate of kinds implements
//! [`Kind`] for each of its nodes and hands a [`Registry`] over.

extern crate self as engine;

mod action;
mod artifact;
mod check;
mod context;
mod diag;
mod edit;
mod error;
mod event;
mod failure;
mod files;
mod graph;
mod job;
mod key;
mod kind;
mod launch;
mod note;
mod order;
mod param;
mod plan;
mod port;
mod recipe;
mod record;
mod run;
mod scan;
mod schedule;
mod sink;
mod slot;
mod supply;
mod syntax;

pub use artifact::{
    AnyArtifact, Artifact, ArtifactType, Corrupt, Decoder, Difference, Encoder, decode_all, encode_to_vec,
};
pub use cache::{Change, Digest, Manifest, Store};
pub use context::{Context, ContextField, Part, Scene, SourceFile, SourceRoot, Up};
pub use diag::{Diagnostic, Diagnostics, Source, nearest};
pub use edit::{EditError, Setting, apply};
pub use error::NodeError;
pub use event::{Counts, Event, State, Totals};
pub use files::{FileBytes, Files};
pub use graph::{Graph, Node, Wire};
pub use kind::{Cost, Keep, Kind, KindEntry, Registry};
pub use note::{Level, Note, Notes};
pub use param::{
    InputFile, NotCanonical, OutputFile, ParamSpec, ParamType, ParamValue, Params, Role, canonical,
};
pub use plan::{Fate, Planned, Why};
pub use port::{Arity, InPort, Inputs, Outputs, PortSpec};
pub use schedule::{Engine, EngineError, Outcome, RunOptions};
pub use serde;
pub use syntax::Fields;
