//! Detection of the sun in a clear sky, and a lower bound of its light.
//!
//! A regression over many places underestimates the sun, because their clipped regions are mostly windows, glints
//! and clouds.

use crate::light::regions;
use engine::{Notes, Up};
use scene::math::equirect::axes;
use scene::math::num;

use super::grid::Grid;

/// Radius of the surroundings of a region, in cells.
pub const RING: usize = 3;
/// Maximum solid angle of the clipped region of a sun, as log2 of steradians.
const LARGEST: f64 = -2.5;
/// Minimum sine of the elevation of a sun, averaged over its cells. Cells count as ground if the sine of their
/// elevation is below the negative of this value.
const LOWEST: f64 = 0.03;
/// Minimum ratio of the solid angle of a sun to the solid angle of all clipped pixels above the horizon. Clipped
/// pixels below the horizon are left out, since they may be lit by the sun, like snow and glints.
const SHARE: f64 = 0.35;
/// Two limits of the blueness (B over R) of the sky around a region, divided by the blueness of the ground. Above
/// the first limit the region may be the sun, and above the second it certainly is. The sky around the sun is bluer
/// than the ground, because the ground is lit by both sun and sky. This holds for any white balance.
const BLUER: [f64; 2] = [1.02, 1.1];
/// Minimum flux of the sun, relative to the flux of all unclipped parts. A physical sun gives about 1.7 times as
/// much as all unclipped parts. The constants of this module were chosen with the panoramas of hdri-train
/// (docs/light.md), so these panoramas cannot be used to test them.
pub const FLUX: f64 = 0.5;

/// Minimum blueness (B over R) of a clear sky. The first limit is for the blueness divided by the blueness of the
/// ground, and the second for the blueness itself. Rooms with brown floors and captures under clouds satisfy only
/// one of the two conditions.
const CLEAR: [f64; 2] = [2.0, 1.1];
/// Two limits of the fraction of the solid angle above [`HORIZON`] that is clear sky. Above the first limit the sky
/// may be clear, and above the second it certainly is. Walls and trees may hide the rest of the sky.
const SEEN_SKY: [f64; 2] = [0.1, 0.25];
/// Sine of the elevation above which the sky is searched for.
const HORIZON: f64 = 0.1;

/// Minimum blueness (B over R) of the sky around a region for the region to count as the sun even if the ground is
/// equally blue.
const BLUE: f64 = 1.25;

/// Degree, from 0 to 1, to which each region is the sun of a clear sky. `regions` holds the cells of each region.
/// The predicted flux of a region is raised to at least this fraction of [`FLUX`]. The degree is above 0 for at
/// most one region: the largest that qualifies.
pub fn suns(grid: &Grid, up: Up, regions: &[Vec<usize>]) -> Vec<f64> {
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

/// Fraction of the solid angle above [`HORIZON`] that is clear sky.
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

/// Reports a light that looks like the sun in a blue sky, except that the ground is as blue as the sky. This can
/// happen over water.
pub fn report_doubtful(grid: &Grid, up: Up, regions: &[Vec<usize>], notes: &mut Notes) {
    let doubtful = |[bluer, blue]: &[f64; 2]| *bluer <= BLUER[0] && *blue > BLUE;
    if hues(grid, up, regions).iter().flatten().any(doubtful) {
        let text = "a small clipped region above the horizon, in blue surroundings, does not count as the sun, since the ground is as blue; if it is the sun (over water, for example), add it by `method: Manual`";
        notes.decision("sun-doubtful", text);
    }
}

/// Blueness of the surroundings of each region: first divided by the blueness of the ground, then undivided. `None`
/// for regions that are too large ([`LARGEST`]), too low ([`LOWEST`]) or have too small a share ([`SHARE`]) to be a
/// sun.
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

/// Total red and blue light of the unclipped parts of some cells.
fn red_blue(grid: &Grid, cells: impl Iterator<Item = usize>) -> [f64; 2] {
    cells.fold([0.0; 2], |[red, blue], c| {
        [red + grid.open_angle(c) * grid.open_rgb[c][0], blue + grid.open_angle(c) * grid.open_rgb[c][2]]
    })
}

/// Cells in and around a region that have an unclipped part, in order.
pub fn surroundings(grid: &Grid, cells: &[usize]) -> impl Iterator<Item = usize> {
    let around = regions::around(cells, (grid.width, grid.clipped.len()), RING);
    around.into_iter().filter(move |&c| grid.open_angle(c) > 0.0)
}
