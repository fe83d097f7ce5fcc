//! Blocks of splats that are consecutive in the file, with bounds. Most captures are stored along a space-filling
//! curve, so their blocks are small. In other orders the blocks are large and save no time.

use std::ops::Range;

use engine::{Context, NodeError};
use glam::DVec3;
use scene::types::Splats;

/// Number of splats per block.
pub(super) const BLOCK: usize = 64;

/// Number of blocks per job.
const CHUNK: usize = 256;

/// Blocks of a scene in file order, for rendering several pictures. For a single picture, computing the blocks
/// takes as much time as they save.
pub struct Blocks(Vec<Block>);

impl Blocks {
    /// Computes the blocks of all splats.
    pub fn of(splats: &Splats, cx: &Context) -> Result<Self, NodeError> {
        let count = splats.len().div_ceil(BLOCK);
        let block = |index: usize| Block::of(splats, index * BLOCK..((index + 1) * BLOCK).min(splats.len()));
        let chunks = cx.for_each_tile(count.div_ceil(CHUNK), |chunk| {
            (chunk * CHUNK..((chunk + 1) * CHUNK).min(count)).map(block).collect::<Vec<_>>()
        })?;
        Ok(Self(chunks.concat()))
    }

    /// Returns the block that contains a splat, relative to an eye.
    #[inline(always)]
    pub(super) fn around(&self, splat: usize, eye: DVec3) -> Block {
        self.0[splat / BLOCK].seen_from(eye)
    }
}

/// Bounding box of the centres of some splats, and the longest axis among these splats.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block {
    /// Middle of the box.
    middle: DVec3,
    /// Half the lengths of the sides of the box.
    half: DVec3,
    /// Largest standard deviation of any of the splats along any axis, in world units.
    pub longest: f64,
}

/// Relative margin of bounds. It is far larger than the rounding error of a dozen f64 operations, and far too small
/// to reduce the benefit of blocks.
const SLACK: f64 = 1e-12;

impl Block {
    /// Computes the block of the splats in `range`, which must not be empty.
    pub(super) fn of(splats: &Splats, range: Range<usize>) -> Self {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut longest = 0.0_f32;
        for (index, scale) in range.clone().zip(&splats.scales[range]) {
            let mean = splats.mean(index);
            (low, high) = (low.min(mean), high.max(mean));
            longest = longest.max(scale[0]).max(scale[1]).max(scale[2]);
        }
        let farthest = low.abs().max(high.abs());
        Self {
            middle: 0.5 * (low + high),
            half: 0.5 * (high - low) + farthest * SLACK,
            longest: f64::from(longest),
        }
    }

    /// Returns the block relative to an eye.
    #[inline(always)]
    pub(super) fn seen_from(&self, eye: DVec3) -> Self {
        Self { middle: self.middle - eye, half: self.half + eye.abs() * SLACK, ..*self }
    }

    /// Upper bound of `along . d + constant` over all centres, where `d` is the vector from the eye to the centre.
    /// The bound allows for rounding.
    #[inline(always)]
    pub(super) fn most(&self, along: DVec3, constant: f64) -> f64 {
        let (size, slack) = (along.abs(), DVec3::splat(SLACK));
        let half = self.half + self.middle.abs() * slack;
        along.dot(self.middle) + size.dot(half) * (1.0 + SLACK) + constant + constant.abs() * SLACK
    }
}
