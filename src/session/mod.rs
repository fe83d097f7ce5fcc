//! Preparations that most commands share: a checked graph, a store, threads.

pub mod agreement;
pub mod budget;
mod compute;
mod engine;
mod error;
pub mod first_graph;
mod graph;
pub mod locked;
pub mod look;
pub mod mesh;
mod names;
#[cfg(feature = "serve")]
pub mod orientation;
pub mod origin;
#[cfg(feature = "remote")]
mod remote;
#[cfg(not(feature = "remote"))]
#[path = "remote/absent.rs"]
mod remote;
pub mod sheet;
pub mod splats;
pub mod standing;

pub use compute::compute;
pub use engine::{EngineArgs, at_end_of_input, cache_folder, on_interrupt, size, time};
pub use error::Error;
pub use graph::{GraphArgs, Loaded};
pub use names::{find, wires};
pub use remote::RemoteArgs;
#[cfg(feature = "remote")]
pub use remote::{config_file, secret_key_file};
