//! Values, errors, notes and paths: the basis of all other modules.

pub(crate) mod artifact;
pub(crate) mod codec;
pub(crate) mod counts;
pub(crate) mod cpu;
pub(crate) mod error;
pub(crate) mod files;
pub(crate) mod note;
pub(crate) mod root;
pub(crate) mod text_file;
pub(crate) mod units;
