//! Running a graph: scheduling, memory, threads, the files of sinks, events.

pub(crate) mod begin;
pub(crate) mod engine;
pub(crate) mod event;
pub(crate) mod failure;
pub(crate) mod job;
pub(crate) mod launch;
pub(crate) mod message;
pub(crate) mod options;
pub(crate) mod placing;
pub(crate) mod queue;
pub(crate) mod remembered;
pub(crate) mod scheduler;
pub(crate) mod sink;
pub(crate) mod slot;
pub(crate) mod supply;
pub(crate) mod trace;
pub(crate) mod workers;
