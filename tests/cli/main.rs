//! Tests that run the program as a user does: the real binary, with real files and small pictures.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test may stop at the first surprise")]

mod action;
mod agreement;
mod bytes;
mod cache;
mod export;
mod incremental;
mod init;
mod kill;
mod layers;
mod messages;
mod names;
mod nuke;
mod other_tools;
mod photos;
#[cfg(unix)]
mod programs;
mod reference;
mod share;
mod show;
mod special_files;
mod splats;
mod stop;
mod structure;
mod trade;
mod turntable;
mod watch;

#[path = "../support/program.rs"]
mod program;

pub use program::{INSERT, Place, RunLog, files};
