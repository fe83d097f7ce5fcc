//! Running a graph: scheduling, memory, threads, output files, events.

pub(crate) mod action;
pub(crate) mod away;
pub(crate) mod claims;
pub(crate) mod code;
pub(crate) mod engine;
pub(crate) mod event;
pub(crate) mod job;
pub(crate) mod known;
pub(crate) mod line;
pub(crate) mod memory;
pub(crate) mod message;
pub(crate) mod options;
pub(crate) mod parts;
pub(crate) mod previous;
pub(crate) mod queue;
pub(crate) mod scheduler;
pub(crate) mod sink;
pub(crate) mod slot;
pub(crate) mod time_estimate;
pub(crate) mod trace;
pub(crate) mod unchanged;
pub(crate) mod value_cache;
pub(crate) mod warm;
pub(crate) mod workers;
