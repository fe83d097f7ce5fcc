//! Programs that are installed on this machine: finding them, and running them in a folder of their own.
//!
//! A program gets its arguments as a list, without a shell, and its standard input is empty. It runs in a process
//! group of its own, which is killed as a whole when the program has ended, or when the run is cancelled.

mod error;
mod find;
mod folder;
mod group;
mod log;
mod python;

pub use error::ProgramError;
pub use find::find;
pub use folder::{WorkFolder, stays_inside};
pub use group::{Call, run};
pub use log::{Log, fraction_in};
pub use python::library_of;

#[cfg(all(test, unix))]
mod tests;
