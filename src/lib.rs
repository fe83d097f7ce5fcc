//! The program `lightharmony` as a library, for programs with kinds of their own.
//!
//! A kind of node is a type that implements [`engine::Kind`]. A crate of yours that adds kinds becomes a program with
//! every command of `lightharmony`: `run`, `watch` with the live page, `check`, `plan`, `nodes` and all others. The
//! graphs of this program may use your kinds and the kinds of [`nodes`] together.
//!
//! ```no_run
//! use std::process::ExitCode;
//! use std::sync::Arc;
//! use lightharmony::engine::{self, Context, Kind, NodeError, Notes};
//! use lightharmony::scene::types::Images;
//!
//! engine::params! {
//!     /// Returns a picture as it is.
//!     pub struct Same {}
//! }
//! engine::inputs! { pub struct In { /** A picture. */ image: Arc<Images>, } }
//! engine::outputs! { pub struct Out { /** The same picture. */ image: Arc<Images>, } }
//! impl Kind for Same {
//!     const NAME: &'static str = "same";
//!     const VERSION: u32 = 1;
//!     type Params = Self;
//!     type In = In;
//!     type Out = Out;
//!     fn run(_: &Self, inputs: In, _: &Context) -> Result<(Out, Notes), NodeError> {
//!         Ok((Out { image: inputs.image }, Notes::none()))
//!     }
//! }
//!
//! fn main() -> ExitCode {
//!     lightharmony::Program::new().with::<Same>().run()
//! }
//! ```
//! `docs/own-kinds.md` of the repository describes a whole crate, with a type of value and tests, and states which
//! interfaces are stable. The documentation of [`engine::Kind`], [`engine::Artifact`], [`engine::OutputFile`] and
//! [`engine::Notes`] has more examples.

mod commands;
mod program;
mod session;
mod terminal;

pub use engine;
pub use nodes;
pub use program::Program;
pub use render;
pub use scene;

// The programs of the page, as tests of the documentation.
#[cfg(doctest)]
#[doc = include_str!("../docs/own-kinds.md")]
mod own_kinds_page {}
