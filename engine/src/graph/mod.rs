//! The checked graph: nodes, wires, axes, and all checks before a run.

pub(crate) mod axis;
pub(crate) mod axis_names;
pub(crate) mod cameras;
pub(crate) mod check;
pub(crate) mod check_values;
pub(crate) mod checker;
pub(crate) mod columns;
pub(crate) mod expand;
pub(crate) mod graph;
pub(crate) mod knobs;
pub(crate) mod node;
pub(crate) mod order;
pub(crate) mod reads;
pub(crate) mod reparse;
pub(crate) mod surroundings;
pub(crate) mod wires;
