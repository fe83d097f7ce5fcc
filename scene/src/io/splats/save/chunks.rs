//! Work on ranges of splats in parallel.

use engine::{Context, NodeError};

/// Number of splats per job.
const CHUNK: usize = 16_384;

/// Runs `f` over ranges of splats in parallel and joins the results.
pub(super) fn chunks<T: Send>(
    count: usize,
    cx: &Context,
    f: impl Fn(std::ops::Range<usize>) -> T + Send + Sync,
) -> Result<Vec<T>, NodeError> {
    cx.for_each_tile(count.div_ceil(CHUNK), |chunk| f(chunk * CHUNK..((chunk + 1) * CHUNK).min(count)))
}
