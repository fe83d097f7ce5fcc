//! The kinds of lightharmony.
//!
//! One kind is one file (a folder when large) with its doc, parameters, ports, code and unit tests, and
//! one line in [`registry`]. `types` holds what travels along wires, `io` the file formats; `num`,
//! `color`, `equirect`, `sampling` and `bvh` are what several kinds share.

use engine::Registry;

pub mod color;
pub mod equirect;
pub mod error;
pub mod num;
pub mod types;

pub use error::Error;

/// Every kind, by name.
pub fn registry() -> Registry {
    Registry::new(vec![])
}
