//! Blending in f64, one pixel after another. This is the reference for the fast version.

use scene::math::num;

use super::peak::{COUNTS_DOWN_TO, HELD_COUNTS, SHEET};
use super::settings::{DepthMode, TILE};
use super::tile::{Blended, Pixel, Task};

/// Blends the footprints of a tile, front to back.
pub(super) fn blend(task: &Task<'_, '_>) -> Blended {
    let &Task { projected, list, area: [x0, y0, width, height], settings, cx, .. } = task;
    let limits = task.limits();
    let period = projected.period.map(f64::from);
    let mut rgb = vec![[0.0_f64; 3]; TILE * TILE];
    let mut depth = vec![0.0_f64; TILE * TILE];
    let mut depth_weight = vec![0.0_f64; TILE * TILE];
    // Of `RayMedian`: sum of inverse depths of the front sheet by weight, and of weights.
    let mut sheet = vec![[0.0_f64; 2]; TILE * TILE];
    let mut counts = vec![0.0_f32; if settings.count_blends { TILE * TILE } else { 0 }];
    let mut transmittance = vec![1.0_f64; TILE * TILE];
    let mut live = vec![true; TILE * TILE];
    let mut left = width * height;
    let (mut evaluations, mut blends) = (0, 0);
    for index in list {
        if left == 0 || cx.cancelled() {
            break;
        }
        let f = projected.footprint(*index);
        let margin = projected.margin(*index);
        let peak = projected.peak(*index);
        let opacity = f64::from(f.opacity);
        // Weaker than the test on alpha below by far more than rounding; it only saves time.
        let reach = num::f64::log2(opacity / settings.alpha_cut) + 1e-6;
        for row in 0..height {
            let dy = (y0 + row) as f64 + 0.5 - f.v;
            let s = f.l22 * dy;
            if s * s > reach {
                continue;
            }
            for column in 0..width {
                let at = row * TILE + column;
                if !live[at] {
                    continue;
                }
                evaluations += 1;
                if limits.as_ref().is_some_and(|limits| f.z >= limits[at]) {
                    continue;
                }
                let mut dx = (x0 + column) as f64 + 0.5 - f.u;
                match period {
                    Some(period) if dx > 0.5 * period => dx -= period,
                    Some(period) if dx < -0.5 * period => dx += period,
                    _ => {}
                }
                let t = f.l11 * dx + f.l21 * dy;
                let exponent = t * t + s * s;
                if exponent > reach {
                    continue;
                }
                if let (Some(limits), Some(margin)) = (&limits, margin)
                    && f64::from(limits[at] - margin) * peak.last_inverse_at(dx, dy) <= 1.0
                {
                    continue;
                }
                let alpha = (opacity * num::f64::exp2(-exponent)).min(settings.alpha_cap);
                if alpha < settings.alpha_cut {
                    continue;
                }
                let after = transmittance[at] * (1.0 - alpha);
                if after < settings.stop {
                    live[at] = false;
                    left -= 1;
                    continue;
                }
                blends += 1;
                let weight = transmittance[at] * alpha;
                for (sum, c) in rgb[at].iter_mut().zip(f.rgb) {
                    *sum += weight * f64::from(c);
                }
                match settings.depth {
                    DepthMode::Expected => depth[at] += weight * f64::from(f.z),
                    DepthMode::Median if transmittance[at] > 0.5 && after <= 0.5 => {
                        depth[at] = f64::from(f.z);
                    }
                    DepthMode::Median => {}
                    DepthMode::RayMedian => {
                        let inverse = peak.inverse_at(dx, dy);
                        if transmittance[at] > 0.5 && after <= 0.5 {
                            depth[at] = 1.0 / inverse;
                        }
                        depth_weight[at] += weight * inverse;
                        let held = inverse <= peak.least || inverse >= peak.most;
                        let counted = alpha
                            * (transmittance[at] * (1.0 / COUNTS_DOWN_TO)).min(1.0)
                            * if held { HELD_COUNTS } else { 1.0 };
                        let [sum, all] = &mut sheet[at];
                        let (near, open) =
                            ((inverse * *all - *sum).abs() <= SHEET * *sum, transmittance[at] > 0.5);
                        if near {
                            (*sum, *all) = (*sum + counted * inverse, *all + counted);
                        } else if open {
                            (*sum, *all) = (counted * inverse, counted);
                        }
                    }
                    DepthMode::Transmittance => {
                        depth[at] += weight * transmittance[at] * f64::from(f.z);
                        depth_weight[at] += weight * transmittance[at];
                    }
                }
                if let Some(count) = counts.get_mut(at) {
                    *count += 1.0;
                }
                transmittance[at] = after;
            }
        }
    }
    task.show(|row, column| {
        let at = row * TILE + column;
        let ([r, g, b], t) = (rgb[at].map(|c| c as f32), transmittance[at]);
        let depth = match settings.depth {
            _ if depth[at] <= 0.0 => f32::INFINITY,
            DepthMode::Expected => (depth[at] / (1.0 - t)) as f32,
            DepthMode::Median | DepthMode::RayMedian => depth[at] as f32,
            DepthMode::Transmittance => (depth[at] / depth_weight[at]) as f32,
        };
        // Of `RayMedian`: the mean inverse depth over that of the pixel.
        let spread = (depth_weight[at] / (1.0 - t) * f64::from(depth) - 1.0).abs() as f32;
        let spread = if depth.is_finite() { spread } else { 0.0 };
        let blends = counts.get(at).copied().unwrap_or(0.0);
        let front = if depth.is_finite() { (sheet[at][1] / sheet[at][0]) as f32 } else { depth };
        Pixel { rgba: [r, g, b, (1.0 - t) as f32], depth, blends, front, spread }
    });
    Blended { evaluations, blends }
}
