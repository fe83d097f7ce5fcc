//! Path tracing against the renders of independent programs.
