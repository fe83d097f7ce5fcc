//! Rendering of one picture.

use engine::{Context, NodeError};
use fearless_simd::Level;
use scene::types::{Data, Image, Splats};

use super::block::Blocks;
use super::camera_model::CameraModel;
use super::settings::{DepthMode, Precision, Settings, TILE};
use super::tile::{Strip, Task};
use super::work::Work;
use super::{bin, blend32, blend64, project};

/// The rendered view of one camera.
pub struct Rendered {
    /// Premultiplied RGB and alpha of each pixel, row by row.
    pub rgba: Vec<f32>,
    /// Planar depth in world units (distance for a panorama); +inf where nothing is visible.
    pub depth: Vec<f32>,
    /// Number of splats blended into each pixel; empty unless they are counted.
    pub blends: Vec<f32>,
    /// Mean depth of the splats that represent the front surface at each pixel. It is less noisy than the depth of
    /// one splat, and no nearer than this surface. Empty for panoramas and for depth modes other than `RayMedian`.
    pub front: Vec<f32>,
    /// Relative difference between the mean depth of the blended splats and `depth`: near 0 where one surface is
    /// visible, large where several are. Empty for panoramas and for depth modes other than `RayMedian`.
    pub spread: Vec<f32>,
    /// Work counts.
    pub work: Work,
    /// Seconds spent in the stages project, sort, bin and blend, measured by the given clock; 0 if there is no
    /// clock. Used by benches, never part of a result.
    pub seconds: [f64; 4],
}

/// Function that returns the current time in seconds.
pub type Clock<'a> = &'a (dyn Fn() -> f64 + Sync);

/// Surface in front of a camera. At each pixel, splats at or beyond the surface are left out.
#[derive(Debug, Clone, Copy)]
pub struct Limit<'a> {
    /// Planar depth in world units: an image with one channel and the size of the picture. 0 or +inf means that
    /// there is no surface.
    pub depth: &'a Image<Data>,
    /// Distance by which a splat must lie in front of the surface, at least 0, in standard deviations along the
    /// middle axis of the splat. It applies per pixel to the depth at which the splat is densest along the ray (see
    /// [`DepthMode::RayMedian`]), or to two standard deviations of depth behind the centre if this depth is farther
    /// in front of the centre than that. The splats that represent a surface scatter around it by less than their
    /// width. The centre of the splat must lie in front as well. If this is 0, only the centre counts.
    pub sigmas: f64,
}

/// First column and row, width and height of a tile in a picture of this width and height, in pixels.
pub(super) fn area((column, row): (usize, usize), (width, height): (usize, usize)) -> [usize; 4] {
    let (x0, y0) = (column * TILE, row * TILE);
    [x0, y0, (width - x0).min(TILE), (height - y0).min(TILE)]
}

/// Renders one picture.
pub(super) fn draw<L: CameraModel>(
    splats: &Splats,
    blocks: Option<&Blocks>,
    camera_model: &L,
    limit: Option<Limit<'_>>,
    settings: &Settings,
    cx: &Context,
    (level, clock): (Level, Clock<'_>),
) -> Result<Rendered, NodeError> {
    let mut last = clock();
    let mut lap = || {
        let now = clock();
        now - std::mem::replace(&mut last, now)
    };

    let limit_sigmas = limit.map(|limit| limit.sigmas);
    let projected = project::project(splats, blocks, camera_model, (settings, limit_sigmas), cx, level)?;
    let mut work = projected.work();
    let mut seconds = [lap(), 0.0, 0.0, 0.0];

    let (width, height) = camera_model.size();
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    let pixels = width * height;
    let (mut rgba, mut depth) = (vec![0.0_f32; pixels * 4], vec![0.0_f32; pixels]);
    let mut blends = vec![0.0_f32; if settings.count_blends { pixels } else { 0 }];
    let of_rays = if settings.depth == DepthMode::RayMedian { pixels } else { 0 };
    let (mut front, mut spread) = (vec![0.0_f32; of_rays], vec![0.0_f32; of_rays]);
    let strips = Strip::of(width, rgba.as_chunks_mut().0, &mut depth, [&mut blends, &mut front, &mut spread]);
    for group in bin::groups(&projected, (columns, rows), settings) {
        let sorted = bin::sort(&projected, &group, settings, cx)?;
        seconds[1] += lap();
        let lists = bin::bin(&projected, &sorted, &group, columns, settings, cx)?;
        drop(sorted);
        seconds[2] += lap();
        let tiles = cx.for_each_tile(lists.tiles(), |tile| {
            let (list, column, row) = lists.tile(tile);
            let area = area((column, row), (width, height));
            let strip = &strips[row];
            let limit = limit.map(|limit| limit.depth);
            let task = Task { projected: &projected, list, area, limit, settings, cx, strip };
            match settings.precision {
                Precision::F32 => blend32::blend(level, &task),
                Precision::F64 => blend64::blend(&task),
            }
        })?;
        // A tile may take seconds with `bounds: None`, so a blend ends early when the run is cancelled.
        cx.check()?;
        work.tile_pairs += lists.pairs();
        for tile in tiles {
            work.evaluations += tile.evaluations;
            work.blends += tile.blends;
        }
        seconds[3] += lap();
    }
    drop(strips);
    Ok(Rendered { rgba, depth, blends, front, spread, work, seconds })
}
