//! Bundles: single files that contain a graph with its source files and results, to pass on to others.
//!
//! [`Engine::pack`](crate::Engine::pack) writes a bundle, [`Bundle::open`](crate::Bundle::open) reads it,
//! [`Bundle::unpack`](crate::Bundle::unpack) turns it into a folder, and [`verify`](crate::verify()) recomputes
//! some of its results. The byte format is documented in `container`. Bundles are untrusted: names that lead
//! outside the target folder are rejected before anything is written, incomplete data is never written, and a graph
//! from a bundle runs confined ([`SourceRoot::confined`](crate::SourceRoot)).

pub(crate) mod container;
pub(crate) mod names;
pub(crate) mod pack;
pub(crate) mod unpack;
pub(crate) mod verify;
