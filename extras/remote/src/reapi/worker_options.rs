//! Settings for the workers of a server.

use std::path::PathBuf;
use std::time::Duration;

use engine::Canary;

/// The program that workers run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WorkerProgram {
    /// A file on this machine, which is sent to the server once.
    Sent(PathBuf),
    /// A program that is installed on the workers: a path, or a name that is looked for in their `PATH`.
    Installed(String),
}

/// Options for the execution of nodes by a server.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkerOptions {
    /// The program.
    pub program: WorkerProgram,
    /// Arguments of the program. It runs in the action folder and writes the outputs folder `out`.
    pub arguments: Vec<String>,
    /// Platform properties that a worker must have, by name.
    pub properties: Vec<(String, String)>,
    /// Name of the platform property for memory, and the amounts in GiB that workers offer, in increasing order.
    pub memory: Option<(String, Vec<u32>)>,
    /// Maximum number of nodes in progress at once.
    pub in_flight: usize,
    /// Priority; nodes with a smaller number are computed earlier. 0 is the default of servers.
    pub priority: i32,
    /// Time limit for a node. If `None`, it is ten times the forecast, and at least an hour.
    pub timeout: Option<Duration>,
    /// The fraction of the nodes, from 0 to 1, that are computed here as well to check the workers.
    pub checked: f64,
    /// A node that is computed before all others, once per day, to prove that the workers compute the right values.
    pub canary: Option<Canary>,
}
