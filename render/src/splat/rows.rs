//! The exponent of a splat in the rows of a tile, in f32. Blending and its backward pass share this arithmetic, so they
//! draw the same splats at the same pixels.

use fearless_simd::{f32x8, f32x16, prelude::*, u32x8};

use super::project::Footprint;
use super::settings::TILE;

pub(super) const LANES: usize = 8;
/// Number of vectors per row of a tile.
pub(super) const HALVES: usize = TILE / LANES;
/// Number of footprints copied ahead of their use, so that their cache misses overlap.
pub(super) const BATCH: usize = 32;

/// Coefficients of the polynomial of degree 5 with the smallest relative error for 2^f with f in [-1/2, 1/2]
/// (Remez). The relative error is 7.5e-8 in exact arithmetic. In f32, an error of 2e-7 was measured.
const EXP2: [f32; 6] = [1.000_000_1, 0.693_146_97, 0.240_221_2, 0.055_507_13, 0.009_675_541, 0.001_327_647_2];
/// 1.5 * 2^23. After this is added to a number, the low bits of the mantissa hold the nearest integer.
const ROUND: f32 = 12_582_912.0;
/// Base-2 logarithm of the smallest normal f32. Smaller alphas are not blended.
pub(super) const LOG2_SMALLEST: f32 = -126.0;

/// 2^x for x in [-126, 1].
#[inline(always)]
pub(super) fn exp2<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    let rounded = x + ROUND;
    let f = x - (rounded - ROUND);
    let mut p = f32x8::splat(simd, EXP2[5]);
    p = p * f + EXP2[4];
    p = p * f + EXP2[3];
    p = p * f + EXP2[2];
    p = p * f + EXP2[1];
    p = p * f + EXP2[0];
    let whole: u32x8<S> = rounded.bitcast();
    let bits: u32x8<S> = p.bitcast();
    (bits + (whole << 23)).bitcast()
}

/// The exponent of a splat in the rows of a tile. At the pixel in column `x` of a half of the tile, the base-2 logarithm
/// of alpha is `largest - (t + l11 x)^2`, with the values of the row and the half.
#[derive(Clone, Copy)]
pub(super) struct Rows<S: Simd> {
    /// `t` in the first column of the left half, for each row.
    left: f32x16<S>,
    /// `t` in the first column of the right half.
    right: f32x16<S>,
    /// `s` of each row.
    pub s: f32x16<S>,
    /// Exponent at `t = 0`, for each row.
    largest: f32x16<S>,
    /// One bit per vector that the splat may reach: the left half of the tile, row by row, then the right half.
    pub reached: u32,
    /// The same for a splat that may lie in any column.
    pub in_any_column: u32,
}

impl<S: Simd> Rows<S> {
    /// Computes the rows of a splat. `rows` holds the numbers of the rows, and `(dx, dy)` is the offset of the first
    /// pixel of the tile from the centre of the splat.
    #[inline(always)]
    pub fn of(simd: S, rows: f32x16<S>, f: &Footprint, (dx, dy): (f64, f64), log2_cut: f32) -> Self {
        let (l11, l21, l22) = (f.l11 as f32, f.l21 as f32, f.l22 as f32);
        let left = rows * l21 + (f.l11 * dx + f.l21 * dy) as f32;
        let s = (rows + dy as f32) * l22;
        let largest = f32x16::splat(simd, f.log2_opacity) - s * s;
        // Largest |t|, with a margin so that rounding loses no pixel.
        let reach = (largest - (log2_cut - 1e-4)).max(0.0).sqrt();
        let seen = largest.simd_ge(log2_cut - 1e-4);
        let in_left = seen & left.simd_le(reach) & (left + 7.0 * l11).simd_ge(-reach);
        let right = left + 8.0 * l11;
        let in_right = seen & right.simd_le(reach) & (left + 15.0 * l11).simd_ge(-reach);
        let both = |left: u64, right: u64| left as u32 | (right as u32) << TILE;
        Self {
            left,
            right,
            s,
            largest,
            reached: both(in_left.to_bitmask(), in_right.to_bitmask()),
            in_any_column: both(seen.to_bitmask(), seen.to_bitmask()),
        }
    }

    /// `t` in the first column of each vector, and the exponent at `t = 0` of each row.
    #[inline(always)]
    pub fn store(&self) -> ([f32; TILE * HALVES], [f32; TILE]) {
        let (mut t, mut largest) = ([0.0; TILE * HALVES], [0.0; TILE]);
        self.left.store_slice(&mut t[..TILE]);
        self.right.store_slice(&mut t[TILE..]);
        self.largest.store_slice(&mut largest);
        (t, largest)
    }
}
