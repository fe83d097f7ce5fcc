//! Contents of scenes: the values on the wires of graphs, the file formats they are read from and written to, and
//! portable mathematics.
//!
//! A file imports only from its own module and from those after it in this list: [`io`], [`types`], [`math`],
//! [`error`].

pub mod error;
pub mod io;
pub mod math;
pub mod types;

pub use error::Error;
