//! Bundles: a graph with everything it needs and what came of it, as one file for somebody else.
//!
//! [`Engine::pack`](crate::Engine::pack) writes one, [`Bundle::open`] reads it, [`Bundle::unpack`] makes a folder
//! of it and [`verify()`] computes some of it anew. The format is told in `container`. A stranger's bundle is
//! taken for hostile: names that lead elsewhere are refused before anything is written, nothing is written that
//! is not whole, and a graph that came out of one runs confined ([`SourceRoot::confined`](crate::SourceRoot)).

mod container;
mod names;
mod pack;
mod unpack;
mod verify;

pub use container::{Bundle, BundleError};
pub use pack::{Packed, Results};
pub use unpack::bundle_around;
pub use verify::{Verdict, Verified, VerifyOptions, verify};

/// The graph file in a bundle.
const GRAPH: &str = "graph.ron";
/// Its lock.
const LOCK: &str = "graph.lock";
/// In an unpacked folder: tells that the graph is somebody else's.
const MARK: &str = ".lightharmony-bundle";
