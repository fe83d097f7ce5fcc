//! Tests on real captures, objects and reference renders, which are in `../shared/data` next to the checkout. A
//! missing file is a failure and never skips a test. `cargo test` leaves out all of these tests without the feature
//! `real-data`, and `.ci/run` reports this.
#![allow(clippy::unwrap_used, reason = "a test may panic")]
#![allow(clippy::print_stdout, reason = "figures are for those who run with --nocapture")]

mod agreement;
mod files;
mod formats;
mod level;
mod light;
mod looks;
mod mesh;
mod metrics;
mod peaks;
mod splat;
mod trace;
mod trials;

/// The shared data, with z up and seed 7.
fn data() -> testkit::Data {
    testkit::Data::shared(engine::Up::PlusZ, 7)
}
