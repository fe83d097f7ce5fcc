//! Blocks of splats that lie one after the other in the file, and what none of them can reach. Captures are mostly
//! stored along a space-filling curve, so that a block is small; of another order the blocks are large and save nothing.

use std::ops::Range;

use glam::DVec3;

use crate::types::Splats;

/// Splats of a block.
pub(super) const BLOCK: usize = 64;

/// The box around the centres of some splats, and the longest of their axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block {
    /// Middle, seen from the eye, and half the sides.
    middle: DVec3,
    half: DVec3,
    /// Longest standard deviation, in world units.
    pub longest: f64,
}

/// A share by which bounds are widened: far more than an f64 loses over a dozen operations, far less than what a
/// block would gain.
const SLACK: f64 = 1e-12;

impl Block {
    /// The block of these splats, at least one, seen from an eye.
    #[inline(always)]
    pub(super) fn of(splats: &Splats, range: Range<usize>, eye: DVec3) -> Self {
        // Four triples at once: the compiler turns a comparison each into one of vectors.
        let (means, single_means) = splats.means[range.clone()].as_flattened().as_chunks::<12>();
        let (scales, single_scales) = splats.scales[range].as_flattened().as_chunks::<12>();
        let (mut low, mut high, mut longest) = ([f32::INFINITY; 12], [f32::NEG_INFINITY; 12], [0.0_f32; 12]);
        for four in means {
            for k in 0..12 {
                low[k] = if four[k] < low[k] { four[k] } else { low[k] };
                high[k] = if four[k] > high[k] { four[k] } else { high[k] };
            }
        }
        for (k, value) in single_means.iter().enumerate() {
            (low[k], high[k]) = (low[k].min(*value), high[k].max(*value));
        }
        for four in scales {
            for k in 0..12 {
                longest[k] = if four[k] > longest[k] { four[k] } else { longest[k] };
            }
        }
        for (k, value) in single_scales.iter().enumerate() {
            longest[k] = longest[k].max(*value);
        }
        let along = |all: &[f32; 12], of: fn(f32, f32) -> f32| {
            DVec3::from([0, 1, 2].map(|k| f64::from(of(of(all[k], all[k + 3]), of(all[k + 6], all[k + 9])))))
        };
        let (low, high) = (along(&low, f32::min), along(&high, f32::max));
        // What f32 loses of a centre is half of its last digit, 2^-24 of it, or of the least f32.
        let farthest = low.abs().max(high.abs());
        let lost = match splats.means_low.is_empty() {
            true => DVec3::ZERO,
            false => farthest * f64::from(f32::EPSILON) + f64::from(f32::MIN_POSITIVE),
        };
        Self {
            middle: 0.5 * (low + high) - eye,
            half: 0.5 * (high - low) + lost + (farthest + eye.abs()) * SLACK,
            longest: f64::from(longest.into_iter().fold(0.0, f32::max)),
        }
    }

    /// No less than `along . d + constant` for any centre at `d` from the eye, however that is rounded.
    #[inline(always)]
    pub(super) fn most(&self, along: DVec3, constant: f64) -> f64 {
        let (size, slack) = (along.abs(), DVec3::splat(SLACK));
        let half = self.half + self.middle.abs() * slack;
        along.dot(self.middle) + size.dot(half) * (1.0 + SLACK) + constant + constant.abs() * SLACK
    }
}
