//! What a file holds, told before any graph uses it: for `lightharmony inspect`, no kinds.

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

/// The floor, as far as flat pieces of surface tell; there is none where no more lies flat than chance explains.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FloorGuess {
    /// The axis that seems to point up: `+z`.
    pub up: &'static str,
    /// Coordinate of the floor along that axis (so -1.2 along `-y` is y = 1.2), in world units.
    pub height: f64,
    /// Of the area of all surface, the share that lies flat in the floor, 0 to 1.
    pub share: f64,
    /// By how many standard deviations more lies flat there than chance puts there.
    pub significance: f64,
    /// How far the runner-up is behind, 0 (it may as well be that) to 1.
    pub confidence: f64,
    /// The axis of the runner-up.
    pub second: &'static str,
}

impl FloorGuess {
    const NONE: Self =
        Self { up: "", height: 0.0, share: 0.0, significance: 0.0, confidence: 0.0, second: "" };

    /// True where the runner-up is far enough behind for the guess to be relied on.
    pub fn is_clear(&self) -> bool {
        self.confidence >= 0.25
    }
}

/// Something a person should look at.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Stable name in kebab-case.
    pub id: &'static str,
    /// One line.
    pub text: String,
}

/// The value that a share of the values lies below.
fn percentile(values: &mut [f32], share: f64) -> f64 {
    let at = ((values.len().saturating_sub(1)) as f64 * share).round() as usize;
    if values.is_empty() {
        return 0.0;
    }
    f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// Slabs of the core along an axis.
const SLABS: usize = 128;
const AXES: [[&str; 2]; 3] = [["-x", "+x"], ["-y", "+y"], ["-z", "+z"]];

/// A piece of surface.
struct Patch {
    middle: [f64; 3],
    /// Of length 1, where it is flat.
    normal: Option<[f64; 3]>,
    weight: f64,
    /// What it adds to the variance of a sum of weights: the square of a weight that is one observation.
    variance: f64,
}

/// Standard deviations by which more must lie flat in a slab than chance puts there. The best of 384 slabs counts, and
/// weights are far from equal: of noise, the best reached 4 in 200 tries.
const SIGNIFICANT: f64 = 8.0;

/// What lies in a slab, or in all.
#[derive(Clone, Copy, Default)]
struct Slab {
    /// Weight of all patches.
    all: f64,
    /// Weight of those that lie flat in it.
    flat: f64,
    /// Of all patches, and of those that lie flat.
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

    /// How much more lies flat here than if it were as much of the surface as elsewhere, and by how many standard
    /// deviations: a patch here or elsewhere is flat by one chance. Where that is small, what was found is itself
    /// a count of few, and its own deviation is the larger one.
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

/// Looks for the slab, in the lower half along one of the six directions, in which the most surface lies flat beyond
/// what chance puts there, and which has most of the scene above it.
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
            // Counted from the bottom of this direction.
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
