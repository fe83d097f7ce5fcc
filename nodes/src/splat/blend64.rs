//! The blend in f64, one pixel after another: the reference that the fast one is measured against.

use super::bin::TILE;
use super::project::Projected;
use super::{DepthMode, Settings, Tile};
use crate::num;

/// Blends the footprints of `list`, front to back, over the tile `[x0, y0, width, height]`.
pub(super) fn blend(
    projected: &Projected,
    list: &[u32],
    [x0, y0, width, height]: [usize; 4],
    settings: &Settings,
) -> Tile {
    let mut rgb = vec![[0.0_f64; 3]; TILE * TILE];
    let mut depth = vec![0.0_f64; TILE * TILE];
    let mut transmittance = vec![1.0_f64; TILE * TILE];
    let mut live = vec![true; TILE * TILE];
    let mut left = width * height;
    let (mut evaluations, mut blends) = (0, 0);
    for index in list {
        if left == 0 {
            break;
        }
        let f = projected.footprint(*index);
        let opacity = f64::from(f.opacity);
        // Looser than the test on alpha below by far more than rounding; it only saves time.
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
                let t = f.l11 * ((x0 + column) as f64 + 0.5 - f.u) + f.l21 * dy;
                let exponent = t * t + s * s;
                if exponent > reach {
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
                }
                transmittance[at] = after;
            }
        }
    }
    let rgba = rgb
        .iter()
        .zip(&transmittance)
        .map(|(c, t)| [c[0] as f32, c[1] as f32, c[2] as f32, (1.0 - t) as f32])
        .collect();
    let depth = depth.iter().zip(&transmittance).map(|(sum, t)| match settings.depth {
        _ if *sum <= 0.0 => f32::INFINITY,
        DepthMode::Expected => (sum / (1.0 - t)) as f32,
        DepthMode::Median => *sum as f32,
    });
    Tile { rgba, depth: depth.collect(), evaluations, blends }
}
