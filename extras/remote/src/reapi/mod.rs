//! A client of the Bazel Remote Execution API, version 2: content-addressable storage, action cache and execution.
//!
//! A result is stored under a *synthetic action*: the action whose command is `["lightharmony-key-1", KEY]` and
//! whose input root is empty. It is never executed; its digest is the key of the result in the action cache. So
//! every build of the program finds the result of a key under the same digest. The files of the action result are
//! `entry`, a [signed entry](crate::signed), and `values/DIGEST` for each value. The server addresses files by its
//! own digest function; the BLAKE3 digests in the signed entry decide whether a file is used.
//!
//! A node that a worker computes is an action of another form: its input root is an action folder of the engine with
//! the program in it, and its outputs are the files of the outputs folder. The server executes it on request, and its
//! action cache is not asked, since the results in it are not signed.

mod address;
mod blobs;
mod call_error;
mod connection;
mod digests;
mod execution;
mod failure;
mod outputs;
mod places;
mod results;
mod retry;
mod sender;
mod server;
mod server_workers;
mod shared_cache;
#[cfg(test)]
mod tests;
mod tree;
mod work_action;
mod worker_options;

pub use address::{Address, AddressError};
pub use call_error::CallError;
pub use retry::Retry;
pub use server_workers::ServerWorkers;
pub use shared_cache::{SharedCache, SharedCacheOptions, Traffic};
pub use worker_options::{WorkerOptions, WorkerProgram};
