//! Summaries of the content of a file, for `lightharmony inspect`.

pub mod mesh;
pub mod splats;

use serde::Serialize;

/// An axis-aligned box, in world units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Extent {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

impl Extent {
    /// Length of the diagonal.
    pub fn diagonal(&self) -> f64 {
        let squares = [0, 1, 2].map(|i| (self.max[i] - self.min[i]) * (self.max[i] - self.min[i]));
        squares.iter().sum::<f64>().sqrt()
    }
}

/// The estimated floor. There is no estimate if the distribution of the flat patches of surface can be explained by
/// chance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FloorGuess {
    /// The axis that probably points up, such as `+z`.
    pub up: &'static str,
    /// Height of the floor along `up`, in world units. For example, a height of -1.2 along `-y` means y = 1.2.
    pub height: f64,
    /// Fraction of the surface area that lies flat in the floor layer, 0 to 1.
    pub share: f64,
    /// Number of standard deviations by which the flat area in the floor exceeds the area expected by chance.
    pub significance: f64,
    /// Margin by which `up` is more likely than the second-best axis, from 0 (equally likely) to 1.
    pub confidence: f64,
    /// The axis that is second most likely to point up.
    pub second: &'static str,
}

impl FloorGuess {
    const NONE: Self =
        Self { up: "", height: 0.0, share: 0.0, significance: 0.0, confidence: 0.0, second: "" };

    /// True if the margin to the second-best axis is large enough to rely on the estimate.
    pub fn is_clear(&self) -> bool {
        self.confidence >= 0.25
    }
}

/// A warning for the user.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Id of the warning in kebab-case. It does not change between versions.
    pub id: &'static str,
    /// Text of the warning, on a single line.
    pub text: String,
}

/// Returns the value that a fraction `share` (0 to 1) of `values` does not exceed.
fn percentile(values: &mut [f32], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share).round() as usize;
    if values.is_empty() {
        return 0.0;
    }
    f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// Number of slabs into which the core of a scene is divided along an axis.
const SLABS: usize = 128;
const AXES: [[&str; 2]; 3] = [["-x", "+x"], ["-y", "+y"], ["-z", "+z"]];

/// A piece of surface.
struct Patch {
    middle: [f64; 3],
    /// Unit normal. `None` if the piece is not flat.
    normal: Option<[f64; 3]>,
    weight: f64,
    /// Contribution of the piece to the variance of a sum of weights. For a piece that counts as one observation,
    /// this is the square of its weight.
    variance: f64,
}

/// Number of standard deviations by which the flat area in a slab must exceed chance. The threshold is high because
/// it applies to the maximum over 384 slabs with very different weights. In 200 trials with noise, the largest
/// value was 4.
const SIGNIFICANT: f64 = 8.0;

/// Sums over the patches in a slab, or over all patches.
#[derive(Clone, Copy, Default)]
struct Slab {
    /// Weight of all patches.
    all: f64,
    /// Weight of the patches that lie flat in the slab.
    flat: f64,
    /// Variance of `all`.
    variance: f64,
    /// Variance of `flat`.
    flat_variance: f64,
}

impl Slab {
    fn add(&mut self, other: Self) {
        self.all += other.all;
        self.flat += other.flat;
        self.variance += other.variance;
        self.flat_variance += other.flat_variance;
    }

    /// Returns the excess of flat area in the slab over the area that the flat fraction elsewhere predicts, first
    /// in units of area and then in standard deviations. The null hypothesis is that a patch is flat with the same
    /// probability everywhere. Two standard deviations are computed, one under the null hypothesis and one from the
    /// observed flat area, and the larger one is used. The second is larger if few patches are flat.
    fn excess(&self, total: &Self) -> (f64, f64) {
        let elsewhere = total.all - self.all;
        if elsewhere <= 0.0 {
            return (0.0, 0.0);
        }
        let ratio = self.all / elsewhere;
        let excess = self.flat - (total.flat - self.flat) * ratio;
        let chance = total.flat / total.all;
        let variance = self.variance + (total.variance - self.variance) * ratio * ratio;
        let deviation = (chance * (1.0 - chance) * variance).max(self.flat_variance).sqrt();
        (excess, if deviation > 0.0 { excess / deviation } else { 0.0 })
    }
}

/// Finds the floor. Of the slabs in the lower half of the scene along each of the six directions, it is the one
/// whose flat area exceeds chance by the most. The excess is multiplied by a factor that decreases with the share
/// of the scene below the slab.
fn floor_of(patches: impl Iterator<Item = Patch>, core: &Extent) -> Option<FloorGuess> {
    let mut slabs = [[Slab::default(); SLABS]; 3];
    for Patch { middle, normal, weight, variance } in patches {
        if !(0..3).all(|k| (core.min[k]..=core.max[k]).contains(&middle[k])) {
            continue;
        }
        for axis in 0..3 {
            let width = core.max[axis] - core.min[axis];
            if width > 0.0 {
                let slab = ((middle[axis] - core.min[axis]) / width * SLABS as f64) as usize;
                // Within 18 degrees.
                let flat = f64::from(u8::from(normal.is_some_and(|n| n[axis].abs() > 0.95)));
                let (flat, flat_variance) = (flat * weight, flat * variance);
                slabs[axis][slab.min(SLABS - 1)].add(Slab { all: weight, flat, variance, flat_variance });
            }
        }
    }
    let sum = |slabs: &mut dyn Iterator<Item = Slab>| {
        slabs.fold(Slab::default(), |mut sum, slab| {
            sum.add(slab);
            sum
        })
    };
    let mut guesses = Vec::with_capacity(6);
    for axis in 0..3 {
        let total = sum(&mut slabs[axis].iter().copied());
        for positive in [true, false] {
            // Counted from the bottom in this direction.
            let at = |slab: usize| if positive { slab } else { SLABS - 1 - slab };
            let mut best = (0.0, FloorGuess { up: AXES[axis][usize::from(positive)], ..FloorGuess::NONE });
            for slab in 0..SLABS / 2 {
                let below = sum(&mut (0..slab.saturating_sub(1)).map(|s| slabs[axis][at(s)]));
                let three = sum(&mut (slab.saturating_sub(1)..=slab + 1).map(|s| slabs[axis][at(s)]));
                let (excess, significance) = three.excess(&total);
                let score = excess / total.all * (1.0 - 2.0 * below.all / total.all).max(0.0);
                if score > best.0 {
                    let width = core.max[axis] - core.min[axis];
                    let along = core.min[axis] + width * (at(slab) as f64 + 0.5) / SLABS as f64;
                    let height = if positive { along } else { -along };
                    best =
                        (score, FloorGuess { height, share: three.flat / total.all, significance, ..best.1 });
                }
            }
            guesses.push(best);
        }
    }
    // If scores are equal, the earlier direction is used.
    guesses.sort_by(|a, b| b.0.total_cmp(&a.0));
    let [first, second, ..] = &guesses[..] else { return None };
    let confidence = 1.0 - second.0 / first.0;
    (first.1.significance >= SIGNIFICANT).then_some(FloorGuess { confidence, second: second.1.up, ..first.1 })
}
