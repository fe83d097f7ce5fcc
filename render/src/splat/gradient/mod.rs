//! Gradients of a loss with respect to the splats of a scene, through the renderer.
//!
//! The forward pass is that of [`render`](super::render) with pixels in f32. Its lists of tiles are kept for the
//! backward pass, which computes sums for each pair of a tile and a footprint, and adds them in the order of the
//! tiles. So the gradients have the same bits for any number of threads and any instruction set.

mod blend;
mod chain;
mod row;
mod sums;
#[cfg(test)]
mod tests;

use engine::{Context, NodeError};
use fearless_simd::Level;
use scene::types::{Camera, Splats};

pub use chain::{Chain, SH_LEN, SplatGradient, SplatValues};
pub use row::Row;
pub use sums::Sums;

use super::camera_model::{CameraModel, Pinhole};
use super::draw::{Clock, area};
use super::project::{Projected, project_indexed};
use super::settings::{Settings, TILE};
use super::tile::{Strip, Task};
use super::{bin, blend32};

/// Gradient of a loss with respect to a picture, one plane of `width * height` values per channel.
pub struct PictureGradient {
    /// Derivatives by premultiplied red, green and blue.
    pub rgb: [Vec<f32>; 3],
    /// Derivatives by alpha.
    pub alpha: Vec<f32>,
}

/// Result of the backward pass of one view.
pub struct Backward {
    projected: Projected,
    /// For each chunk of the scene, the sums of its footprints.
    sums: Vec<Vec<Sums>>,
    /// Number of pairs of a tile and a splat in its list.
    pub pairs: u64,
    /// Number of times that a splat was blended into a pixel.
    pub blends: u64,
    /// Seconds of the stages project, sort and bin, blend, loss, backward pass of blending, and addition, measured
    /// by the given clock. Used by benches, never part of a result.
    pub seconds: [f64; 6],
}

impl Backward {
    /// Number of chunks of `CHUNK` splats.
    pub fn chunks(&self) -> usize {
        self.sums.len()
    }

    /// Splats of a chunk that were blended into at least one pixel, in the order of the scene.
    pub fn rows(&self, chunk: usize) -> impl Iterator<Item = Row<'_>> {
        let (footprints, indices) = self.projected.chunk(chunk);
        let rows = footprints.iter().zip(indices).zip(&self.sums[chunk]);
        rows.filter(|(_, sums)| sums.weight > 0.0).map(|((footprint, splat), sums)| Row {
            splat: *splat as usize,
            footprint,
            sums,
        })
    }
}

/// Number of jobs that add the sums of tiles. Each job adds those of some of the chunks.
const ADDING_JOBS: usize = 8;

/// Renders the view of a camera, calls `loss` with its premultiplied RGB and alpha, and computes the gradients of
/// the loss. `alpha_cap` of the settings must be below 1. Settings for depth and for the memory of lists are
/// ignored.
pub fn backward(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    cx: &Context,
    (level, clock): (Level, Clock<'_>),
    loss: impl FnOnce(&[[f32; 4]]) -> Result<PictureGradient, NodeError>,
) -> Result<Backward, NodeError> {
    super::checked(camera)?;
    let mut last = clock();
    let mut lap = || {
        let now = clock();
        now - std::mem::replace(&mut last, now)
    };
    let settings = &Settings { list_bytes: u64::MAX, count_blends: false, ..*settings };
    let camera_model = Pinhole::new(camera);
    let projected = project_indexed(splats, &camera_model, settings, cx, level)?;
    let mut seconds = [lap(), 0.0, 0.0, 0.0, 0.0, 0.0];

    let size = camera_model.size();
    let (columns, rows) = (size.0.div_ceil(TILE), size.1.div_ceil(TILE));
    // Without a limit on their memory, the lists of all tiles are one group.
    let groups = bin::groups(&projected, (columns, rows), settings);
    let [group] = groups.as_slice() else {
        return Err(NodeError::new(format!("view `{}` has no pixels", camera.name)).at("rig"));
    };
    let sorted = bin::sort(&projected, group, settings, cx)?;
    let lists = bin::bin(&projected, &sorted, group, columns, settings, cx)?;
    drop(sorted);
    seconds[1] = lap();

    let mut rgba = vec![[0.0_f32; 4]; size.0 * size.1];
    let mut depth = vec![0.0_f32; size.0 * size.1];
    let strips = Strip::of(size.0, &mut rgba, &mut depth, [&mut [], &mut [], &mut []]);
    let tiles = cx.for_each_tile(lists.tiles(), |tile| {
        let (list, column, row) = lists.tile(tile);
        let (area, strip) = (area((column, row), size), &strips[row]);
        blend32::blend(level, &Task { projected: &projected, list, area, limit: None, settings, cx, strip })
    })?;
    drop(strips);
    cx.check()?;
    seconds[2] = lap();

    let gradient = loss(&rgba)?;
    seconds[3] = lap();
    let [red, green, blue] = &gradient.rgb;
    let planes = [red.as_slice(), green, blue, &gradient.alpha];
    let sums = cx.for_each_tile(lists.tiles(), |tile| {
        let (list, column, row) = lists.tile(tile);
        blend::backward(
            level,
            &blend::Task {
                projected: &projected,
                list,
                area: area((column, row), size),
                settings,
                width: size.0,
                rgba: &rgba,
                gradient: planes,
            },
        )
    })?;
    seconds[4] = lap();

    let chunks = projected.chunks();
    let each = chunks.div_ceil(ADDING_JOBS).max(1);
    let added = cx.for_each_tile(chunks.div_ceil(each), |job| {
        let own = job * each..((job + 1) * each).min(chunks);
        let mut added: Vec<Vec<Sums>> =
            own.clone().map(|chunk| vec![Sums::ZERO; projected.chunk(chunk).0.len()]).collect();
        for (tile, sums) in sums.iter().enumerate() {
            for (index, sums) in lists.tile(tile).0.iter().zip(sums) {
                let (chunk, at) = Projected::place(*index);
                if own.contains(&chunk) && sums.weight > 0.0 {
                    added[chunk - own.start][at] += *sums;
                }
            }
        }
        added
    })?;
    let (pairs, blends) = (lists.pairs(), tiles.iter().map(|tile| tile.blends).sum());
    seconds[5] = lap();
    Ok(Backward { projected, sums: added.into_iter().flatten().collect(), pairs, blends, seconds })
}
