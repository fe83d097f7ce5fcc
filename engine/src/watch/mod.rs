//! Watching: a graph runs again whenever one of its files changes.

pub(crate) mod files;
pub(crate) mod handle;
pub(crate) mod listener;
pub(crate) mod options;
pub(crate) mod previews;
pub(crate) mod rough;
pub(crate) mod settling;
pub(crate) mod watch;
