//! Tests against a real server, `buildbox-casd`, and against a small server for answers that it never gives.
//!
//! The environment variable `LIGHTHARMONY_BUILDBOX` names the folder of `buildbox-casd`; `tests/remote/install.sh`
//! of the repository downloads it. Without the variable, the tests of the real server print that they were left
//! out.

mod answers;
mod casd;
mod casd_workers;
mod client;
mod encrypted;
mod executing;
mod fake;
mod fake_workers;
mod faults;
mod sharing;
mod worker_failures;
