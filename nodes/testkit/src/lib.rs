//! Code shared by the benchmarks of the kinds and their tests on real data. It loads data and reference renders,
//! computes scores of pictures, and reads clocks. It is a separate crate, so that programs and unit tests are built
//! without it.
#![allow(clippy::unwrap_used, reason = "tests and benchmarks may panic")]

mod data;
mod render_refs;
mod score;
mod splat_refs;

use rustix::time::{ClockId, clock_gettime};

pub use data::Data;
pub use render_refs::{Case, Traced, denoised};
pub use score::{block_scores, mean, psnr, relative_mse, rgb};
pub use splat_refs::Reference;

fn clock(id: ClockId) -> f64 {
    let time = clock_gettime(id);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// CPU seconds used by all threads of this process, by a clock of the kernel that does not count other processes.
pub fn process_seconds() -> f64 {
    clock(ClockId::ProcessCPUTime)
}

/// CPU seconds used by this thread.
pub fn thread_seconds() -> f64 {
    clock(ClockId::ThreadCPUTime)
}
