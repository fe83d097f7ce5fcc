//! Bundles: a graph with everything it needs and what came of it, as one file for somebody else.
//!
//! [`Engine::pack`](crate::Engine::pack) writes one, [`Bundle::open`](crate::Bundle::open) reads it, [`Bundle::unpack`](crate::Bundle::unpack) makes a folder
//! of it and [`verify`](crate::verify()) computes some of it anew. The format is told in `container`. A stranger's bundle is
//! taken for hostile: names that lead elsewhere are refused before anything is written, nothing is written that
//! is not whole, and a graph that came out of one runs confined ([`SourceRoot::confined`](crate::SourceRoot)).

pub(crate) mod container;
pub(crate) mod names;
pub(crate) mod pack;
pub(crate) mod unpack;
pub(crate) mod verify;
