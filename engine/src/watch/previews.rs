//! The previews that precede a long run.

/// A preview is left out if the preview or run that follows it is forecast to take at most this many seconds.
const SOON: f64 = 0.5;

/// A preview that computes only a subset of the pixels is made only if the preview with the limit 1 is forecast to
/// take more than this many seconds.
const AT_ONCE: f64 = 0.3;

/// The reductions that a preview applies.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Reduction {
    /// Maximum value of the parameter that the preview limits.
    pub level: u64,
    /// Side length in pixels of the blocks in which only one pixel is computed.
    pub coarse: u64,
}

/// The previews that precede a run. `most` is the largest value of the parameter in the run, and `seconds` is the
/// forecast of the run, if known. Previews limit the parameter to 1, 4, 16 and so on, since chunks of cached work
/// end at these values. If even the preview with the limit 1 takes long and a node supports it (`coarse`), an
/// additional first preview computes only a subset of the pixels.
pub(crate) fn levels(most: u64, seconds: Option<f64>, coarse: bool) -> Vec<Reduction> {
    let takes = |level: u64| seconds.map_or(f64::INFINITY, |all| all * level as f64 / most.max(1) as f64);
    let block = match takes(1) {
        ..=AT_ONCE => None,
        // Blocks of 2 by 2 pixels take a quarter of the time.
        time if time <= 4.0 * AT_ONCE => Some(2),
        _ => Some(4),
    };
    let first = block.filter(|_| coarse && most > 0).map(|coarse| Reduction { level: 1, coarse });
    let steps = std::iter::successors(Some(1_u64), |step| step.checked_mul(4));
    // A preview is left out if the next one comes soon.
    let levels = steps
        .take_while(|step| *step < most)
        .filter(|step| takes(step.saturating_mul(4).min(most)) > SOON)
        .map(|level| Reduction { level, coarse: 1 });
    first.into_iter().chain(levels).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(most: u64, seconds: Option<f64>) -> Vec<(u64, u64)> {
        levels(most, seconds, true).into_iter().map(|l| (l.level, l.coarse)).collect()
    }

    #[test]
    fn what_takes_long_comes_roughly_first() {
        assert_eq!(pairs(0, None), [], "nothing is refined");
        assert_eq!(pairs(64, Some(0.4)), [], "soon there");
        assert_eq!(pairs(64, Some(1.0)), [(16, 1)]);
        assert_eq!(pairs(64, Some(64.0)), [(1, 2), (1, 1), (4, 1), (16, 1)]);
        assert_eq!(pairs(64, Some(640.0)), [(1, 4), (1, 1), (4, 1), (16, 1)]);
        assert_eq!(pairs(1, None), [(1, 4)], "one sample of many pixels");
        assert_eq!(pairs(3, None), [(1, 4), (1, 1)]);
        assert_eq!(levels(3, None, false), [Reduction { level: 1, coarse: 1 }], "no node can be coarse");
    }
}
