//! What is remembered of earlier runs. None of it changes a result; it only saves work.

pub(crate) mod previous;
pub(crate) mod unchanged;
pub(crate) mod values;
