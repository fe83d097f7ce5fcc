//! Parts of a node's work, which have keys and results of their own.

use cache::Lease;

use crate::value::artifact::AnyArtifact;
use crate::value::counts::Effort;
use crate::value::error::NodeError;

/// The identity of a part of a node's work. Each part has its own key.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// Name in events, such as `r0`.
    pub name: &'a str,
    /// Version of the part's code. It is raised whenever the value of the part changes.
    pub version: u32,
    /// The input ports whose content the part depends on.
    pub inputs: &'a [&'static str],
}

/// Storage of parts, which the engine provides for `Context::part`.
pub(crate) trait PartStore: Send + Sync {
    /// The stored bytes of a part, and the time and counts of its computation.
    fn load(&self, part: Part<'_>, extra: &str) -> Option<(Vec<u8>, Effort)>;
    /// Acquires the lease of a part. Returns `None` if the part cannot have a key. If another node or process holds
    /// the lease, returns an error that makes the engine try the node again once the lease is free. Never waits,
    /// since a caller on the same thread may hold the lease.
    fn claim(&self, part: Part<'_>, extra: &str) -> Result<Option<Lease>, NodeError>;
    fn save(&self, part: Part<'_>, extra: &str, encoded: &[u8], spent: Effort) -> Result<(), NodeError>;
    /// Returns the value of a part if it is still in memory.
    fn recall(&self, part: Part<'_>, extra: &str) -> Option<AnyArtifact>;
    /// Keeps the value of a part in memory. `bytes` is its size.
    fn keep(&self, part: Part<'_>, extra: &str, value: AnyArtifact, bytes: u64);
}
