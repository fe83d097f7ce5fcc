//! Blending in f32, eight pixels of a row at once. Every instruction set gives the same bits: every lane does the
//! same IEEE operations for any vector width, and a row is skipped only if none of its pixels can reach
//! `alpha_cut`.

use fearless_simd::{Level, dispatch, f32x8, f32x16, mask32x8, prelude::*};
use scene::math::num;

use super::peak::{COUNTS_DOWN_TO, HELD_COUNTS, Peak, SHEET};
use super::project::Footprint;
use super::rows::{BATCH, HALVES, LANES, LOG2_SMALLEST, Rows, exp2};
use super::settings::{DepthMode, Sort, TILE};
use super::tile::{Blended, Pixel, Task};

/// Indices of the variants of [`DepthMode`] as constants, so that one loop is compiled for each variant.
const EXPECTED: u8 = 0;
const MEDIAN: u8 = 1;
const TRANSMITTANCE: u8 = 2;
const RAY_MEDIAN: u8 = 3;

/// Blends the footprints of a tile, front to back.
pub(super) fn blend(level: Level, task: &Task<'_, '_>) -> Blended {
    match task.settings.depth {
        DepthMode::Expected => dispatch!(level, simd => tile::<_, EXPECTED>(simd, task)),
        DepthMode::Median => dispatch!(level, simd => tile::<_, MEDIAN>(simd, task)),
        DepthMode::Transmittance => dispatch!(level, simd => tile::<_, TRANSMITTANCE>(simd, task)),
        DepthMode::RayMedian => dispatch!(level, simd => tile::<_, RAY_MEDIAN>(simd, task)),
    }
}

/// Sums for the pixels of a tile, one array per channel. If a pixel is finished, its transmittance is negated.
#[derive(Clone, Copy)]
struct Pixels {
    transmittance: [[f32; LANES]; TILE * HALVES],
    red: [[f32; LANES]; TILE * HALVES],
    green: [[f32; LANES]; TILE * HALVES],
    blue: [[f32; LANES]; TILE * HALVES],
    depth: [[f32; LANES]; TILE * HALVES],
    /// For `Transmittance`: the divisor of `depth`. For `RayMedian`: the weighted sum of inverse depths.
    depth_weight: [[f32; LANES]; TILE * HALVES],
    /// Weighted sum of inverse depths over the front sheet (see [`SHEET`]), for `RayMedian`.
    sheet: [[f32; LANES]; TILE * HALVES],
    sheet_weight: [[f32; LANES]; TILE * HALVES],
    /// Number of blends, if they are counted.
    count: [[f32; LANES]; TILE * HALVES],
    /// Depth at which blending ends, if there is a limit.
    limit: [[f32; LANES]; TILE * HALVES],
}

/// A pixel is finished when the depth of a splat exceeds this multiple of the limit. It is above 1 because splats
/// with equal sort keys stay in file order although their depths may differ by a factor of 1 + 2^-32.
const BEHIND: f32 = 1.000_001;

#[inline(always)]
fn tile<S: Simd, const DEPTH: u8>(simd: S, task: &Task<'_, '_>) -> Blended {
    const ZERO: [[f32; LANES]; TILE * HALVES] = [[0.0; LANES]; TILE * HALVES];
    let &Task { projected, list, area: [x0, y0, width, height], settings, cx, .. } = task;
    let mut pixels = Pixels {
        transmittance: ZERO,
        red: ZERO,
        green: ZERO,
        blue: ZERO,
        depth: ZERO,
        depth_weight: ZERO,
        sheet: ZERO,
        sheet_weight: ZERO,
        count: ZERO,
        limit: ZERO,
    };
    let limits = task.limits();
    if let Some(limits) = &limits {
        for (at, limit) in limits.iter().enumerate() {
            pixels.limit[at % TILE / LANES * TILE + at / TILE][at % LANES] = *limit;
        }
    }
    // One bit per vector: the left half of the tile, row by row, then the right half.
    let mut live = 0_u32;
    for row in 0..TILE {
        for half in 0..HALVES {
            let vector = half * TILE + row;
            for lane in 0..LANES {
                let inside = row < height && half * LANES + lane < width;
                pixels.transmittance[vector][lane] = if inside { 1.0 } else { -1.0 };
                live |= u32::from(inside) << vector;
            }
        }
    }

    let log2_cut = (num::f64::log2(settings.alpha_cut) as f32).max(LOG2_SMALLEST);
    let cap = f32x8::splat(simd, settings.alpha_cap as f32);
    let cut = f32x8::splat(simd, log2_cut);
    let stop = f32x8::splat(simd, settings.stop as f32);
    let zero = f32x8::splat(simd, 0.0);
    let half_seen = f32x8::splat(simd, 0.5);
    let all = f32x8::splat(simd, 1.0).simd_gt(0.0);
    let lanes = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let period = projected.period.map(f64::from);
    let row_numbers: [f32; TILE] = std::array::from_fn(|row| row as f32);
    let rows = f32x16::from_slice(simd, &row_numbers);
    let (left, top) = (x0 as f64 + 0.5, y0 as f64 + 0.5);
    let (mut evaluations, mut blends) = (0_u64, 0_u64);

    let mut batch = [Footprint::NONE; BATCH];
    // Below 0 if only the centre of the splat must lie in front of the limit.
    let mut margins = [-1.0_f32; BATCH];
    let mut peaks = [Peak::NONE; BATCH];
    for indices in list.chunks(BATCH) {
        if live == 0 || cx.cancelled() {
            break;
        }
        for (to, index) in batch.iter_mut().zip(indices) {
            *to = *projected.footprint(*index);
        }
        if limits.is_some() {
            for (to, index) in margins.iter_mut().zip(indices) {
                *to = projected.margin(*index).unwrap_or(-1.0);
            }
        }
        if DEPTH == RAY_MEDIAN || limits.is_some() {
            for (to, index) in peaks.iter_mut().zip(indices) {
                *to = *projected.peak(*index);
            }
        }
        for ((f, margin), peak) in batch[..indices.len()].iter().zip(&margins).zip(&peaks) {
            // Offsets from the tile's first pixel, computed in f64 so that f32 has small numbers only.
            let (mut dx, dy) = (left - f.u, top - f.v);
            let mut along = [lanes * f.l11 as f32; HALVES];
            let mut columns = [lanes, lanes + LANES as f32];
            // In a panorama, the copy of the splat nearest to the pixel is used.
            let mut split = false;
            if let Some(period) = period {
                let centre = dx + 0.5 * (TILE - 1) as f64;
                dx += period
                    * (f64::from(u8::from(centre < -0.5 * period))
                        - f64::from(u8::from(centre > 0.5 * period)));
                split = 0.5 * period - (dx + 0.5 * (TILE - 1) as f64).abs() < TILE as f64;
                if split {
                    for (half, along) in along.iter_mut().enumerate() {
                        let offset: [f32; LANES] = std::array::from_fn(|lane| {
                            let here = dx + (half * LANES + lane) as f64;
                            let turns = f64::from(u8::from(here < -0.5 * period))
                                - f64::from(u8::from(here > 0.5 * period));
                            (f.l11 * (lane as f64 + turns * period)) as f32
                        });
                        *along = f32x8::from_slice(simd, &offset);
                        if DEPTH == RAY_MEDIAN || limits.is_some() {
                            let column: [f32; LANES] = std::array::from_fn(|lane| {
                                let here = dx + (half * LANES + lane) as f64;
                                let turns = f64::from(u8::from(here < -0.5 * period))
                                    - f64::from(u8::from(here > 0.5 * period));
                                ((half * LANES + lane) as f64 + turns * period) as f32
                            });
                            columns[half] = f32x8::from_slice(simd, &column);
                        }
                    }
                }
            }
            let exponents = Rows::of(simd, rows, f, (dx, dy), log2_cut);
            let hit = if split { exponents.in_any_column } else { exponents.reached };
            let mut todo = hit & live;
            if todo == 0 {
                continue;
            }
            let (t_of, peak_of) = exponents.store();
            // One over the depth of the splat's peak, in the first column; to first order, see [`Peak`].
            let mut inverse_of = [0.0_f32; TILE];
            let inverse_step = (peak.inverse * peak.across) as f32;
            if DEPTH == RAY_MEDIAN || *margin >= 0.0 {
                let first = peak.inverse * (1.0 + peak.across * dx + peak.down * dy);
                let inverses = rows * (peak.inverse * peak.down) as f32 + first as f32;
                inverses.store_slice(&mut inverse_of);
            }
            while todo != 0 {
                let vector = todo.trailing_zeros() as usize % (TILE * HALVES);
                todo &= todo - 1;
                let t = along[vector / TILE] + t_of[vector];
                let exponent = f32x8::splat(simd, peak_of[vector % TILE]) - t * t;
                let mut drawn: mask32x8<S> = exponent.simd_ge(cut);
                let mut in_front = all;
                if limits.is_some() {
                    let limit = f32x8::from_slice(simd, &pixels.limit[vector]);
                    drawn &= limit.simd_gt(f.z);
                    if *margin >= 0.0 {
                        let inverse = columns[vector / TILE] * inverse_step + inverse_of[vector % TILE];
                        let (least, most) = (peak.least as f32, peak.most as f32);
                        // See `last_inverse_at` of [`Peak`].
                        let inverse =
                            inverse.simd_ge(most).select(f32x8::splat(simd, least), inverse.max(least));
                        drawn &= ((limit - *margin) * inverse).simd_gt(1.0);
                    }
                    if settings.sort == Sort::Depth {
                        in_front = (limit * BEHIND).simd_ge(f.z);
                    }
                }
                let alpha = drawn.select(exp2(simd, exponent.max(cut)).min(cap), zero);
                let before = f32x8::from_slice(simd, &pixels.transmittance[vector]);
                let weight = before * alpha;
                let after = before - weight;
                let going = after.simd_ge(stop) & in_front;
                let weight = going.select(weight, zero);
                going.select(after, -before.abs()).store_slice(&mut pixels.transmittance[vector]);
                for (sum, value) in [
                    (&mut pixels.red[vector], f.rgb[0]),
                    (&mut pixels.green[vector], f.rgb[1]),
                    (&mut pixels.blue[vector], f.rgb[2]),
                ] {
                    (f32x8::from_slice(simd, sum) + weight * value).store_slice(sum);
                }
                let depth = f32x8::from_slice(simd, &pixels.depth[vector]);
                let depth = match DEPTH {
                    EXPECTED => depth + weight * f.z,
                    MEDIAN => {
                        let crossing = going & before.simd_gt(half_seen) & after.simd_le(half_seen);
                        crossing.select(f32x8::splat(simd, f.z), depth)
                    }
                    RAY_MEDIAN => {
                        let inverse = columns[vector / TILE] * inverse_step + inverse_of[vector % TILE];
                        let (least, most) = (peak.least as f32, peak.most as f32);
                        let held = inverse.simd_lt(least) | inverse.simd_gt(most);
                        let inverse = inverse.max(least).min(most);
                        let sum = &mut pixels.depth_weight[vector];
                        (f32x8::from_slice(simd, sum) + weight * inverse).store_slice(sum);
                        // A sheet that hides less than half is replaced with the next one.
                        let open = before.simd_gt(half_seen);
                        let counted = (before * (1.0 / COUNTS_DOWN_TO) as f32).min(1.0) * alpha;
                        let counted = held.select(counted * HELD_COUNTS as f32, counted);
                        let counted = going.select(counted, zero);
                        let sum = f32x8::from_slice(simd, &pixels.sheet[vector]);
                        let all = f32x8::from_slice(simd, &pixels.sheet_weight[vector]);
                        let near = (sum * SHEET as f32).simd_ge((inverse * all - sum).abs());
                        let begun = going & drawn & open & !near;
                        let (old_sum, old_all) = (begun.select(zero, sum), begun.select(zero, all));
                        let counted = (near | begun).select(counted, zero);
                        (old_sum + counted * inverse).store_slice(&mut pixels.sheet[vector]);
                        (old_all + counted).store_slice(&mut pixels.sheet_weight[vector]);
                        let crossing = going & open & after.simd_le(half_seen);
                        if !crossing.any_true() {
                            depth
                        } else {
                            crossing.select(f32x8::splat(simd, 1.0) / inverse, depth)
                        }
                    }
                    _ => {
                        let weight = going.select(weight * before, zero);
                        let sum = &mut pixels.depth_weight[vector];
                        (f32x8::from_slice(simd, sum) + weight).store_slice(sum);
                        depth + weight * f.z
                    }
                };
                depth.store_slice(&mut pixels.depth[vector]);
                if settings.count_blends {
                    let count = &mut pixels.count[vector];
                    let one = (drawn & going).select(f32x8::splat(simd, 1.0), zero);
                    (f32x8::from_slice(simd, count) + one).store_slice(count);
                }
                evaluations += LANES as u64;
                blends += u64::from((drawn & going).to_bitmask().count_ones());
                if !going.any_true() {
                    live &= !(1 << vector);
                }
            }
        }
    }
    task.show(|row, column| {
        let (vector, lane) = (column / LANES * TILE + row, column % LANES);
        let alpha = 1.0 - pixels.transmittance[vector][lane].abs();
        let [r, g, b] = [&pixels.red, &pixels.green, &pixels.blue].map(|sums| sums[vector][lane]);
        let sum = pixels.depth[vector][lane];
        let depth = match DEPTH {
            _ if sum <= 0.0 || alpha <= 0.0 => f32::INFINITY,
            EXPECTED => sum / alpha,
            MEDIAN | RAY_MEDIAN => sum,
            _ => sum / pixels.depth_weight[vector][lane],
        };
        let inverse = pixels.depth_weight[vector][lane] / alpha;
        let spread = if depth.is_finite() { (inverse * depth - 1.0).abs() } else { 0.0 };
        let mean = pixels.sheet_weight[vector][lane] / pixels.sheet[vector][lane];
        let front = if depth.is_finite() { mean } else { depth };
        Pixel { rgba: [r, g, b, alpha], depth, blends: pixels.count[vector][lane], front, spread }
    });
    Blended { evaluations, blends }
}
