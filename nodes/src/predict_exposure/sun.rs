//! Which clipped region is the sun of a clear sky, and the least light that it then gives.
//!
//! A regression over many places, whose clipped regions are mostly windows, glints and clouds, is too timid there.

use engine::Up;

use super::grid::Grid;
use crate::equirect::axes;
use crate::light::regions;
use crate::num;

/// Cells around a region that count as its surroundings.
pub(super) const RING: usize = 3;
/// The sun is smaller than this, in log2 sr.
const LARGEST: f64 = -2.5;
/// It stands higher than this, as the sine of its mean elevation; the ground lies as far below the horizon.
const LOWEST: f64 = 0.03;
/// It holds at least this share of all that is clipped.
const SHARE: f64 = 0.35;
/// It stands in a sky that is bluer than the ground, which sun and sky light together, whatever the white balance. By how
/// many times as blue, as B over R, it is told to be the sun from, and for certain.
const BLUER: [f64; 2] = [1.02, 1.1];
/// The sun gives at least so much of the flux of everything unclipped. A physical sun gives about 1.7 times as much. The
/// thresholds and this number were chosen on the panoramas of hdri-train (docs/light.md), so those are no test of them.
pub(super) const FLUX: f64 = 0.5;

/// How certain it is that each region, given by its cells, is the sun: 0 to 1, and the part of [`FLUX`] that it gives.
pub(super) fn suns(grid: &Grid, up: Up, regions: &[Vec<usize>]) -> Vec<f64> {
    let above = axes(up)[2];
    let height = |cell: usize| grid.direction(up, cell).dot(above);
    let size = |cells: &[usize]| cells.iter().map(|&c| grid.solid_angle(c)).sum::<f64>();
    let total: f64 = regions.iter().map(|cells| size(cells)).sum();
    let ground = || (0..grid.rgb.len()).filter(|&c| open(grid, c) && height(c) < -LOWEST);
    let sun = |cells: &Vec<usize>| {
        let size = size(cells);
        let mean_height = cells.iter().map(|&c| height(c) * grid.solid_angle(c)).sum::<f64>() / size;
        if num::f64::log2(size) >= LARGEST || size <= SHARE * total || mean_height <= LOWEST {
            return 0.0;
        }
        let ([sky_red, sky_blue], [red, blue]) =
            (red_blue(grid, surroundings(grid, cells)), red_blue(grid, ground()));
        let bluer = if sky_red * blue > 0.0 { sky_blue * red / (sky_red * blue) } else { 0.0 };
        ((bluer - BLUER[0]) / (BLUER[1] - BLUER[0])).clamp(0.0, 1.0)
    };
    regions.iter().map(sun).collect()
}

/// The red and the blue light of some cells.
fn red_blue(grid: &Grid, cells: impl Iterator<Item = usize>) -> [f64; 2] {
    cells.fold([0.0; 2], |[red, blue], c| {
        [red + grid.solid_angle(c) * grid.rgb[c][0], blue + grid.solid_angle(c) * grid.rgb[c][2]]
    })
}

fn open(grid: &Grid, cell: usize) -> bool {
    grid.seen[cell] && !grid.clipped[cell]
}

/// The open cells around a region, in order.
pub(super) fn surroundings<'a>(grid: &'a Grid, cells: &[usize]) -> impl Iterator<Item = usize> + 'a {
    let mut own = vec![false; grid.clipped.len()];
    cells.iter().for_each(|&cell| own[cell] = true);
    let grown = regions::grow(&own, grid.width, RING);
    (0..own.len()).filter(move |&c| grown[c] && open(grid, c))
}
