//! Summaries of the content of a file, for `lightharmony inspect`.

pub mod mesh;
pub mod splats;

use serde::Serialize;

/// A box along the axes, in world units.
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

/// The estimated floor. There is no estimate if the distribution of flat pieces of surface can be explained by
/// chance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FloorGuess {
    /// The axis that seems to point up: `+z`.
    pub up: &'static str,
    /// Coordinate of the floor along that axis (so -1.2 along `-y` is y = 1.2), in world units.
    pub height: f64,
    /// Fraction of the surface area that lies flat in the floor, 0 to 1.
    pub share: f64,
    /// Number of standard deviations by which the flat area exceeds chance.
    pub significance: f64,
    /// Margin to the runner-up, from 0 (equally likely) to 1.
    pub confidence: f64,
    /// The axis of the runner-up.
    pub second: &'static str,
}

impl FloorGuess {
    const NONE: Self =
        Self { up: "", height: 0.0, share: 0.0, significance: 0.0, confidence: 0.0, second: "" };

    /// True if the margin to the runner-up is large enough to rely on the estimate.
    pub fn is_clear(&self) -> bool {
        self.confidence >= 0.25
    }
}

/// A warning for the user.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Stable name in kebab-case.
    pub id: &'static str,
    /// Text in one line.
    pub text: String,
}

/// The percentile of `values` at `share`, a fraction from 0 to 1.
fn percentile(values: &mut [f32], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share).round() as usize;
    if values.is_empty() {
        return 0.0;
    }
    f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// Number of slabs of the core along an axis.
const SLABS: usize = 128;
const AXES: [[&str; 2]; 3] = [["-x", "+x"], ["-y", "+y"], ["-z", "+z"]];

/// A piece of surface.
struct Patch {
    middle: [f64; 3],
    /// Unit normal, if the piece is flat.
    normal: Option<[f64; 3]>,
    weight: f64,
    /// Contribution to the variance of a sum of weights: the square of the weight, for one observation.
    variance: f64,
}

/// Number of standard deviations by which the flat area in a slab must exceed chance. The threshold applies to the
/// maximum over 384 slabs, and weights differ strongly: for noise, the maximum reached 4 in 200 tries.
const SIGNIFICANT: f64 = 8.0;

/// Sums over the patches in a slab, or over all patches.
#[derive(Clone, Copy, Default)]
struct Slab {
    /// Weight of all patches.
    all: f64,
    /// Weight of the patches that lie flat in the slab.
    flat: f64,
    /// Variance of the weights of all patches, and of the weights of the flat ones.
    variance: f64,
    flat_variance: f64,
}

impl Slab {
    fn add(&mut self, other: Self) {
        self.all += other.all;
        self.flat += other.flat;
        self.variance += other.variance;
        self.flat_variance += other.flat_variance;
    }

    /// Flat area in excess of what the flat fraction elsewhere predicts, and this excess in standard deviations.
    /// The null hypothesis is that a patch is flat with the same probability everywhere. The larger of its deviation
    /// and that of the observed flat area is used; the latter is larger if few patches are flat.
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

/// Searches the slab, in the lower half along one of the six directions, whose flat area exceeds chance by the
/// most, weighted by the part of the scene above it.
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
    // Ties: the earlier direction.
    guesses.sort_by(|a, b| b.0.total_cmp(&a.0));
    let [first, second, ..] = &guesses[..] else { return None };
    let confidence = 1.0 - second.0 / first.0;
    (first.1.significance >= SIGNIFICANT).then_some(FloorGuess { confidence, second: second.1.up, ..first.1 })
}
