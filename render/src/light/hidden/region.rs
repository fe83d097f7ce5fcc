//! Regression by region: one gain for each connected clipped region, distributed by a fixed profile.

use crate::light::regions;
use engine::{Context, NodeError, Up};
use glam::DVec3;
use scene::math::color::luminance;
use scene::math::num;

use super::clipped::{Clipped, RegionLight};
use super::grid::Grid;
use super::spread::Spread;
use super::sun;

/// Mean of each feature over the data of the regression, in the order of [`features`].
const MEAN: [f64; 9] = [0.0, -7.542, 6.265, 0.229, 0.357, 0.993, 0.619, 0.032, 0.232];
/// Standard deviation of each feature over the data of the regression.
const SPREAD: [f64; 9] = [1.0, 2.404, 3.169, 0.534, 0.151, 0.032, 1.193, 0.118, 0.092];
/// Weight of each normalised feature, from a ridge regression of log2 mean gain on 4123 regions of 28 HDR panoramas
/// of 256x128 pixels, at 5 exposures each.
const WEIGHT: [f64; 9] = [1.012, 0.411, -0.149, 0.362, -0.269, -0.008, -0.235, -0.064, 0.082];
/// Range to which gains are clamped, in stops: the range of the data that the regression was fitted to.
const STOPS: (f64, f64) = (0.0, 14.0);
/// Exponent p of the profile within a region: the gain grows as (distance to the edge / largest distance)^p. The
/// regression was fitted with the same profile.
const PROFILE_POWER: i32 = 4;

/// Predicts the log2 gain of every pixel (0 outside clipped regions) and the light added to each region.
pub fn predict(clipped: &Clipped<'_>, cx: &Context) -> Result<(Vec<f32>, Vec<RegionLight>), NodeError> {
    let Clipped { up, pixels, mask, ceiling, ref grid, ref labels, ref members } = *clipped;
    let total: f64 = (0..grid.clipped.len()).filter(|&c| grid.clipped[c]).map(|c| grid.solid_angle(c)).sum();
    let rest = mean_of(grid, (0..grid.clipped.len()).filter(|&c| !grid.clipped[c] && grid.seen[c]));
    cx.progress(0.2);
    let regression = cx.for_each_tile(labels.count, |i| {
        let weights = features(grid, up, &members[i], (total, rest), ceiling);
        let z = |k: usize| (weights[k] - MEAN[k]) / SPREAD[k] * WEIGHT[k];
        (0..9).map(z).sum::<f64>().clamp(STOPS.0, STOPS.1)
    })?;
    let suns = sun::suns(grid, up, members);
    cx.progress(0.5);
    let distance = regions::distance_to_edge(mask, pixels.width);
    cx.check()?;
    let mut farthest = vec![0.0_f64; labels.count];
    for at in (0..mask.len()).filter(|&at| mask[at]) {
        if let Some(i) = labels.of[grid.cell_of[at] as usize] {
            farthest[i as usize] = farthest[i as usize].max(f64::from(distance[at]));
        }
    }
    let profile = |i: usize, at: usize| {
        let near = f64::from(distance[at]) / farthest[i];
        (0..PROFILE_POWER).fold(1.0, |p, _| p * near)
    };
    let spread = Spread::new(pixels, mask, grid, labels, profile, cx)?;
    let unclipped: f64 = (0..grid.clipped.len())
        .filter(|&cell| !grid.clipped[cell] && grid.seen[cell])
        .map(|cell| f64::from(luminance(grid.rgb[cell].map(|v| v as f32))) * grid.solid_angle(cell))
        .sum();
    let mut log2_gain = vec![0.0_f32; mask.len()];
    let mut found = Vec::with_capacity(labels.count);
    for (i, (&stops, &sun)) in regression.iter().zip(&suns).enumerate() {
        // The regression was fitted with whole cells as the clipped area, so its gain acts on that area.
        let flux = spread.cell_flux[i];
        let least = sun * sun::FLUX * unclipped;
        let least = if least > 0.0 && flux > 0.0 { num::f64::log2(least / flux) } else { 0.0 };
        let stops = stops.max(least).clamp(STOPS.0, STOPS.1);
        let given = spread.apply(i, (num::f64::exp2(stops) - 1.0) * flux, pixels, &mut log2_gain);
        found.push(RegionLight { sun: sun > 0.0, ..clipped.found(i, spread.solid_angle[i], given) });
    }
    Ok((log2_gain, found))
}

/// Nine features of a region. Brightness is relative to the white level `ceiling`.
///
/// 1. The constant 1.
/// 2. log2 of the solid angle of the region.
/// 3. A tenth of the square of feature 2.
/// 4. Mean sine of elevation.
/// 5. Mean brightness of the surroundings.
/// 6. Length of the mean direction, which is near 1 for a compact region.
/// 7. log2 of the solid angle of all clipped regions.
/// 8. Share of the region in that solid angle.
/// 9. Mean brightness of all unclipped parts.
fn features(grid: &Grid, up: Up, cells: &[usize], (total, rest): (f64, f64), ceiling: f64) -> [f64; 9] {
    let above = scene::math::equirect::axes(up)[2];
    let (mut size, mut sine, mut sum) = (0.0, 0.0, DVec3::ZERO);
    for &cell in cells {
        let (d, solid_angle) = (grid.direction(up, cell), grid.solid_angle(cell));
        size += solid_angle;
        sine += d.dot(above) * solid_angle;
        sum += d;
    }
    let ring = mean_of(grid, sun::surroundings(grid, cells).filter(|&c| !grid.clipped[c]));
    let log = num::f64::log2(size);
    let compact = sum.length() / cells.len() as f64;
    let share = size / total;
    let (ring, rest) = (ring / ceiling, rest / ceiling);
    [1.0, log, log * log / 10.0, sine / size, ring, compact, num::f64::log2(total), share, rest]
}

/// Mean of the channels of some cells; half of white if there are no cells. The regression was fitted with this
/// default.
fn mean_of(grid: &Grid, cells: impl Iterator<Item = usize>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for cell in cells {
        sum += grid.rgb[cell].iter().sum::<f64>();
        n += 3.0;
    }
    if n > 0.0 { sum / n } else { 0.5 }
}
