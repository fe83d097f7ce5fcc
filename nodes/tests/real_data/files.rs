//! Loaders on real files.
