//! Tests against a real server, `buildbox-casd`, and against a small server for answers that it never gives.
//!
//! The environment variable `LIGHTHARMONY_BUILDBOX` names the folder of `buildbox-casd`; `tests/remote/install.sh`
//! of the repository downloads it. Without the variable, the tests of the real server print that they were left
//! out.

mod answers;
mod casd;
mod client;
mod encrypted;
mod fake;
mod faults;
mod sharing;
