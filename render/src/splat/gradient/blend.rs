//! Backward pass of blending: derivatives of a loss with respect to the footprints of a tile.
//!
//! The pass runs front to back like the forward pass, with the same arithmetic, so it blends the same splats. Let
//! `g` be the gradient with respect to the colour of a pixel, and `D` the sum over all splats of weight times
//! `c.g`, plus the final transmittance times its own gradient. `D` follows from the rendered picture. After the
//! splats up to `i` are subtracted, the rest is the part that splat `i` attenuates, and the derivative by its alpha
//! is `T c.g - rest / (1 - alpha)`.

use fearless_simd::{Level, dispatch, f32x8, f32x16, mask32x8, prelude::*};
use scene::math::num;

use super::super::project::{Footprint, Projected};
use super::super::rows::{BATCH, HALVES, LANES, LOG2_SMALLEST, Rows, exp2};
use super::super::settings::{Settings, TILE};
use super::sums::Sums;

/// Input of the backward pass of one tile.
pub(super) struct Task<'a> {
    pub projected: &'a Projected,
    /// Footprints, front to back.
    pub list: &'a [u32],
    /// First column and row, width and height, in pixels.
    pub area: [usize; 4],
    pub settings: &'a Settings,
    /// Width of the picture, in pixels.
    pub width: usize,
    /// Rendered premultiplied RGB and alpha of each pixel.
    pub rgba: &'a [[f32; 4]],
    /// Gradient of the loss with respect to red, green, blue and alpha, one plane each.
    pub gradient: [&'a [f32]; 4],
}

/// Sums of the footprints of a tile, in the order of its list.
pub(super) fn backward(level: Level, task: &Task<'_>) -> Vec<Sums> {
    dispatch!(level, simd => tile(simd, task))
}

/// State and gradient of the pixels of a tile, one array per channel.
struct Pixels {
    /// Transmittance in front of the next splat, negated if the pixel is finished.
    transmittance: [[f32; LANES]; TILE * HALVES],
    /// Part of the sum `D` that later splats contribute.
    rest: [[f32; LANES]; TILE * HALVES],
    red: [[f32; LANES]; TILE * HALVES],
    green: [[f32; LANES]; TILE * HALVES],
    blue: [[f32; LANES]; TILE * HALVES],
}

impl Pixels {
    /// Loads the pixels of a tile. The second result has one bit per vector with unfinished pixels.
    #[inline(always)]
    fn of(task: &Task<'_>) -> (Self, u32) {
        const ZERO: [[f32; LANES]; TILE * HALVES] = [[0.0; LANES]; TILE * HALVES];
        let [x0, y0, width, height] = task.area;
        let mut pixels = Self {
            transmittance: [[-1.0; LANES]; TILE * HALVES],
            rest: ZERO,
            red: ZERO,
            green: ZERO,
            blue: ZERO,
        };
        let mut live = 0;
        for row in 0..height {
            for column in 0..width {
                let (vector, lane) = (column / LANES * TILE + row, column % LANES);
                let at = (y0 + row) * task.width + x0 + column;
                let [r, g, b, a] = task.gradient.map(|plane| plane[at]);
                let [red, green, blue, alpha] = task.rgba[at];
                live |= 1 << vector;
                pixels.transmittance[vector][lane] = 1.0;
                // The derivative by the transmittance is the negative of that by alpha.
                pixels.rest[vector][lane] = red * r + green * g + blue * b - (1.0 - alpha) * a;
                pixels.red[vector][lane] = r;
                pixels.green[vector][lane] = g;
                pixels.blue[vector][lane] = b;
            }
        }
        (pixels, live)
    }
}

/// Sum of eight lanes in a fixed order.
#[inline(always)]
fn total<S: Simd>(lanes: f32x8<S>) -> f32 {
    let mut a = [0.0; LANES];
    lanes.store_slice(&mut a);
    ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
}

#[inline(always)]
fn tile<S: Simd>(simd: S, task: &Task<'_>) -> Vec<Sums> {
    let &Task { projected, list, area: [x0, y0, ..], settings, .. } = task;
    let (mut pixels, mut live) = Pixels::of(task);
    let log2_cut = (num::f64::log2(settings.alpha_cut) as f32).max(LOG2_SMALLEST);
    let cap = f32x8::splat(simd, settings.alpha_cap as f32);
    let cut = f32x8::splat(simd, log2_cut);
    let stop = f32x8::splat(simd, settings.stop as f32);
    let zero = f32x8::splat(simd, 0.0);
    let one = f32x8::splat(simd, 1.0);
    let lanes = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let row_numbers: [f32; TILE] = std::array::from_fn(|row| row as f32);
    let rows = f32x16::from_slice(simd, &row_numbers);
    let (left, top) = (x0 as f64 + 0.5, y0 as f64 + 0.5);

    let mut out = vec![Sums::ZERO; list.len()];
    let mut batch = [Footprint::NONE; BATCH];
    for (indices, out) in list.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        if live == 0 {
            break;
        }
        for (to, index) in batch.iter_mut().zip(indices) {
            *to = *projected.footprint(*index);
        }
        for (f, out) in batch.iter().zip(out) {
            let along = lanes * f.l11 as f32;
            let exponents = Rows::of(simd, rows, f, (left - f.u, top - f.v), log2_cut);
            let mut todo = exponents.reached & live;
            if todo == 0 {
                continue;
            }
            let (t_of, peak_of) = exponents.store();
            let mut s_of = [0.0_f32; TILE];
            exponents.s.store_slice(&mut s_of);
            let (mut q_sum, mut t_sum, mut tt_sum) = (zero, zero, zero);
            let (mut s_sum, mut ts_sum, mut ss_sum) = (zero, zero, zero);
            let (mut red_sum, mut green_sum, mut blue_sum, mut weights) = (zero, zero, zero, zero);
            while todo != 0 {
                let vector = todo.trailing_zeros() as usize % (TILE * HALVES);
                todo &= todo - 1;
                let (row_s, row_peak) = (s_of[vector % TILE], peak_of[vector % TILE]);
                let t = along + t_of[vector];
                let exponent = f32x8::splat(simd, row_peak) - t * t;
                let drawn: mask32x8<S> = exponent.simd_ge(cut);
                let raw = exp2(simd, exponent.max(cut));
                let alpha = drawn.select(raw.min(cap), zero);
                let before = f32x8::from_slice(simd, &pixels.transmittance[vector]);
                let weight = before * alpha;
                let after = before - weight;
                let going = after.simd_ge(stop);
                let weight = going.select(weight, zero);
                going.select(after, -before.abs()).store_slice(&mut pixels.transmittance[vector]);

                let red = f32x8::from_slice(simd, &pixels.red[vector]);
                let green = f32x8::from_slice(simd, &pixels.green[vector]);
                let blue = f32x8::from_slice(simd, &pixels.blue[vector]);
                red_sum += weight * red;
                green_sum += weight * green;
                blue_sum += weight * blue;
                weights += weight;
                let along_gradient = red * f.rgb[0] + green * f.rgb[1] + blue * f.rgb[2];
                let rest = f32x8::from_slice(simd, &pixels.rest[vector]) - weight * along_gradient;
                rest.store_slice(&mut pixels.rest[vector]);
                // Derivative by the exponent, divided by ln 2. It is 0 where alpha is capped.
                let by_alpha = before * along_gradient - rest / (one - alpha);
                let q = (going & drawn & raw.simd_le(cap)).select(by_alpha * alpha, zero);
                let (qt, qs) = (q * t, q * row_s);
                q_sum += q;
                t_sum += qt;
                tt_sum += qt * t;
                s_sum += qs;
                ts_sum += qt * row_s;
                ss_sum += qs * row_s;
                if !going.any_true() {
                    live &= !(1 << vector);
                }
            }
            *out = Sums {
                q: total(q_sum),
                t: total(t_sum),
                tt: total(tt_sum),
                s: total(s_sum),
                ts: total(ts_sum),
                ss: total(ss_sum),
                rgb: [red_sum, green_sum, blue_sum].map(total),
                weight: total(weights),
            };
        }
    }
    out
}
