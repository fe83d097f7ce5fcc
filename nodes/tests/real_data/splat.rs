//! Splat rendering against the float64 references.
