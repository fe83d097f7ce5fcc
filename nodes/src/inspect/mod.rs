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

/// The floor, as far as flat pieces of surface tell.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FloorGuess {
    /// The axis that seems to point up: `+z`.
    pub up: &'static str,
    /// Coordinate of the floor along that axis (so -1.2 along `-y` is y = 1.2), in world units.
    pub height: f64,
    /// Of the area of all surface, the share that lies flat in the floor, 0 to 1.
    pub share: f64,
    /// How far the runner-up is behind, 0 (it may as well be that) to 1.
    pub confidence: f64,
    /// The axis of the runner-up.
    pub second: &'static str,
}

impl FloorGuess {
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
}

/// Looks for the slab, in the lower half along one of the six directions, that holds most of the surface that
/// lies flat in it, and has most of the scene above it.
fn floor_of(patches: impl Iterator<Item = Patch>, core: &Extent) -> Option<FloorGuess> {
    let mut all = [[0.0_f64; SLABS]; 3];
    let mut flat = [[0.0_f64; SLABS]; 3];
    let mut total = 0.0;
    for Patch { middle: mean, normal, weight } in patches {
        if !(0..3).all(|k| (core.min[k]..=core.max[k]).contains(&mean[k])) {
            continue;
        }
        total += weight;
        for axis in 0..3 {
            let width = core.max[axis] - core.min[axis];
            if width > 0.0 {
                let slab = ((mean[axis] - core.min[axis]) / width * SLABS as f64) as usize;
                let slab = slab.min(SLABS - 1);
                all[axis][slab] += weight;
                // Within 18 degrees.
                if normal.is_some_and(|n| n[axis].abs() > 0.95) {
                    flat[axis][slab] += weight;
                }
            }
        }
    }
    if total <= 0.0 {
        return None;
    }
    let mut guesses: Vec<(f64, f64, f64, &'static str)> = Vec::new();
    for axis in 0..3 {
        for positive in [true, false] {
            // Counted from the bottom of this direction.
            let at = |slab: usize| if positive { slab } else { SLABS - 1 - slab };
            let three = |slab: usize, of: &[f64; SLABS]| {
                (slab.saturating_sub(1)..=(slab + 1).min(SLABS - 1)).map(|s| of[at(s)]).sum::<f64>()
            };
            let mut best = (0.0, 0.0, 0);
            for slab in 0..SLABS / 2 {
                let below: f64 = (0..slab.saturating_sub(1)).map(|s| all[axis][at(s)]).sum();
                let share = three(slab, &flat[axis]) / total;
                let score = share * (1.0 - 2.0 * below / total).max(0.0);
                if score > best.0 {
                    best = (score, share, slab);
                }
            }
            let width = core.max[axis] - core.min[axis];
            let along = core.min[axis] + width * (at(best.2) as f64 + 0.5) / SLABS as f64;
            let height = if positive { along } else { -along };
            guesses.push((best.0, best.1, height, AXES[axis][usize::from(positive)]));
        }
    }
    // Ties: the earlier direction.
    guesses.sort_by(|a, b| b.0.total_cmp(&a.0));
    let [first, second, ..] = guesses[..] else { return None };
    (first.0 > 0.0).then(|| FloorGuess {
        up: first.3,
        height: first.2,
        share: first.1,
        confidence: 1.0 - second.0 / first.0,
        second: second.3,
    })
}
