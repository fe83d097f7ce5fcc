//! Computing nodes in another process, on this machine or elsewhere.
//!
//! An *action* is one node whose inputs are identified by digests. An *action folder* contains everything that the
//! code of the node reads:
//! ```text
//! action.ron       kind, version, parameters, context fields, and the digests of all inputs; see `action_file`
//! blobs/abcd…      stored values of the inputs, each named by its digest
//! files/NAME       source files, under names that lead to no other folder; see `staged_name`
//! ```
//! [`Engine::run_action`](crate::Engine::run_action) computes the node and writes the *outputs folder*:
//! ```text
//! entry            the record and the lengths of the values; see `entry`
//! values/PORT      the stored value of each output
//! ```
//! Neither side trusts the other. The worker verifies the digests of all inputs and computes the key itself. The
//! process that takes the outputs verifies their names, lengths, digests and types, and the key.
//!
//! Results that other machines have already computed come from [`SharedResults`](crate::SharedResults).
//! [`Workers`](crate::Workers) compute nodes on request: each request contains the files of an action folder, and the
//! answer is the entry of the outputs folder.

pub(crate) mod action_file;
pub(crate) mod action_node;
pub(crate) mod entry;
pub(crate) mod error;
pub(crate) mod outputs;
pub(crate) mod placement;
pub(crate) mod shared;
pub(crate) mod workers;
