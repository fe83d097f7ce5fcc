//! Detection of the sun in a clear sky, and a lower bound of its light.
//!
//! A regression over many places, whose clipped regions are mostly windows, glints and clouds, underestimates the
//! sun.

use engine::{Notes, Up};

use super::grid::Grid;
use crate::light::regions;
use crate::math::equirect::axes;
use crate::math::num;

/// Radius in cells of the surroundings of a region.
pub(super) const RING: usize = 3;
/// Largest size of the sun, in log2 sr.
const LARGEST: f64 = -2.5;
/// Smallest sine of the sun's mean elevation; the ground lies equally far below the horizon.
const LOWEST: f64 = 0.03;
/// Smallest share of the sun in the light of all clipped pixels above the horizon. Clipped pixels below the
/// horizon are lit by the sun: snow or glints.
const SHARE: f64 = 0.35;
/// Ratios of blueness (B over R) of sky to ground from which a region may be the sun, and from which it
/// certainly is. The sun stands in a sky that is bluer than the ground, because the ground is lit by both sun
/// and sky. This holds for any white balance.
const BLUER: [f64; 2] = [1.02, 1.1];
/// Smallest flux of the sun relative to that of all unclipped parts. A physical sun gives about 1.7 times as
/// much. The thresholds and this number were chosen on the panoramas of hdri-train (docs/light.md), so those
/// cannot test them.
pub(super) const FLUX: f64 = 0.5;

/// Minimum blueness (B over R) of a clear sky, relative to that of the ground and absolute. Rooms with brown
/// floors and captures under clouds satisfy only one of the two conditions. The other numbers are the shares
/// of the solid angle above [`HORIZON`] from which the sky may be clear, and from which it certainly is,
/// since walls and trees may hide the rest.
const CLEAR: [f64; 2] = [2.0, 1.1];
const SEEN_SKY: [f64; 2] = [0.1, 0.25];
/// Sine of the elevation from which the sky begins.
const HORIZON: f64 = 0.1;

/// Blueness (B over R) of the sky around a region from which it may be the sun even if the ground is as blue.
const BLUE: f64 = 1.25;

/// Probability from 0 to 1 that each region, given by its cells, is the sun of a clear sky, which is also the
/// fraction of [`FLUX`] that it gives. At most one region qualifies: the largest.
pub(super) fn suns(grid: &Grid, up: Up, regions: &[Vec<usize>]) -> Vec<f64> {
    let clear = ramp(clear_sky(grid, up), SEEN_SKY);
    let part = |[bluer, _]: [f64; 2]| clear * ramp(bluer, BLUER);
    let mut suns: Vec<f64> = hues(grid, up, regions).into_iter().map(|hues| hues.map_or(0.0, part)).collect();
    let size = |i: usize| regions[i].iter().map(|&c| grid.clipped_angle(c)).sum::<f64>();
    let reported = (0..suns.len()).filter(|&i| suns[i] > 0.0);
    let largest = reported.max_by(|&a, &b| size(a).total_cmp(&size(b)).then(b.cmp(&a)));
    suns.iter_mut().enumerate().filter(|(i, _)| Some(*i) != largest).for_each(|(_, sun)| *sun = 0.0);
    suns
}

fn ramp(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

/// Fraction of the solid angle above the horizon that is clear sky.
fn clear_sky(grid: &Grid, up: Up) -> f64 {
    let above = axes(up)[2];
    let height = |cell: usize| grid.direction(up, cell).dot(above);
    let (mut all, mut clear) = (0.0, 0.0);
    let [red, blue] = red_blue(grid, (0..grid.rgb.len()).filter(|&c| height(c) < -LOWEST));
    for c in (0..grid.rgb.len()).filter(|&c| height(c) > HORIZON) {
        let [cell_red, _, cell_blue] = grid.open_rgb[c];
        all += grid.solid_angle(c);
        if cell_blue * red > CLEAR[0] * cell_red * blue && cell_blue > CLEAR[1] * cell_red {
            clear += grid.open_angle(c);
        }
    }
    clear / all
}

/// Reports a light that looks like the sun in a blue sky, except that the ground is as blue as the sky, as
/// over water.
pub(super) fn report_doubtful(grid: &Grid, up: Up, regions: &[Vec<usize>], notes: &mut Notes) {
    let doubtful = |[bluer, blue]: &[f64; 2]| *bluer <= BLUER[0] && *blue > BLUE;
    if hues(grid, up, regions).iter().flatten().any(doubtful) {
        let text = "a small clipped region above the horizon, in blue surroundings, does not count as the sun, since the ground is as blue; if it is the sun (over water, for example), add it by `method: Manual`";
        notes.decision("sun-doubtful", text);
    }
}

/// Blueness of the surroundings of each region, relative to the ground and absolute. `None` for regions that
/// do not qualify by size, height and share.
fn hues(grid: &Grid, up: Up, regions: &[Vec<usize>]) -> Vec<Option<[f64; 2]>> {
    let above = axes(up)[2];
    let height = |cell: usize| grid.direction(up, cell).dot(above);
    let size = |cells: &[usize]| cells.iter().map(|&c| grid.clipped_angle(c)).sum::<f64>();
    let total: f64 =
        regions.iter().flatten().filter(|&&c| height(c) > 0.0).map(|&c| grid.clipped_angle(c)).sum();
    let ground = || (0..grid.rgb.len()).filter(|&c| height(c) < -LOWEST);
    let hues = |cells: &Vec<usize>| {
        let size = size(cells);
        let mean_height = cells.iter().map(|&c| height(c) * grid.clipped_angle(c)).sum::<f64>() / size;
        if num::f64::log2(size) >= LARGEST || size <= SHARE * total || mean_height <= LOWEST {
            return None;
        }
        let ([sky_red, sky_blue], [red, blue]) =
            (red_blue(grid, surroundings(grid, cells)), red_blue(grid, ground()));
        (sky_red * blue > 0.0).then(|| [sky_blue * red / (sky_red * blue), sky_blue / sky_red])
    };
    regions.iter().map(hues).collect()
}

/// Red and blue light of the unclipped parts of cells.
fn red_blue(grid: &Grid, cells: impl Iterator<Item = usize>) -> [f64; 2] {
    cells.fold([0.0; 2], |[red, blue], c| {
        [red + grid.open_angle(c) * grid.open_rgb[c][0], blue + grid.open_angle(c) * grid.open_rgb[c][2]]
    })
}

/// Cells of a region and around it that have an unclipped part, in order.
pub(super) fn surroundings(grid: &Grid, cells: &[usize]) -> impl Iterator<Item = usize> {
    let around = regions::around(cells, (grid.width, grid.clipped.len()), RING);
    around.into_iter().filter(move |&c| grid.open_angle(c) > 0.0)
}
