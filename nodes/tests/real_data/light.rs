//! Recovered light on real panoramas.
