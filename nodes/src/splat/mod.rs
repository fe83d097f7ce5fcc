//! EWA splatting on the CPU: project, sort, bin, blend.
//!
//! One camera at a time. `project` turns every splat that can matter into a `Footprint` (f64
//! throughout, so that needles and far-off worlds keep their digits), `bin` sorts the footprints once
//! (stable; equal keys stay in file order) and lists them by tile, and `blend32` or `blend64`
//! composites each tile front to back. Every stage gives the same bits for any number of threads and
//! any instruction set.

mod around;
mod bin;
mod blend32;
mod blend64;
mod lens;
mod project;
mod settings;
mod sh;
#[cfg(test)]
mod tests;

use std::ops::AddAssign;

use engine::{Context, NodeError, Notes};
use fearless_simd::Level;

pub use around::{panorama, panorama_clocked};
pub use bin::TILE;
use lens::{Lens, Pinhole};
use project::{Footprint, Projected};
pub use settings::{Bounds, Compensation, DepthMode, Drawing, Precision, Settings, Sort};

use crate::types::{Camera, Data, Image, Splats};

/// Work of one view; the same on every machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Splats that were read; 0 of a view that shares its eye with one before it, which has read them for both.
    pub visited: u64,
    /// Splats whose colour was computed, and not for a view before this one already.
    pub coloured: u64,
    /// Splats that reached the sort.
    pub projected: u64,
    /// Splats at or below the near plane.
    pub behind: u64,
    /// Splats whose footprint is not a finite ellipse.
    pub degenerate: u64,
    /// Pairs of a splat and a tile.
    pub tile_pairs: u64,
    /// Pixels at which a splat was evaluated.
    pub evaluations: u64,
    /// Pixels to which a splat was added.
    pub blends: u64,
}

impl AddAssign for Work {
    fn add_assign(&mut self, other: Self) {
        self.visited += other.visited;
        self.coloured += other.coloured;
        self.projected += other.projected;
        self.behind += other.behind;
        self.degenerate += other.degenerate;
        self.tile_pairs += other.tile_pairs;
        self.evaluations += other.evaluations;
        self.blends += other.blends;
    }
}

impl Work {
    /// Counts it, and notes what was left out.
    pub(crate) fn report(&self, cx: &Context, notes: &mut Notes) {
        cx.count("splats_visited", self.visited);
        cx.count("splats_coloured", self.coloured);
        cx.count("splats_projected", self.projected);
        cx.count("splat_tile_pairs", self.tile_pairs);
        cx.count("splat_evaluations", self.evaluations);
        cx.count("splat_blends", self.blends);
        if self.degenerate > 0 {
            notes.count("degenerate-splats", self.degenerate, "footprints are no finite ellipse; left out");
        }
    }
}

/// What one camera sees.
pub struct Rendered {
    /// RGB premultiplied, and alpha; row by row.
    pub rgba: Vec<f32>,
    /// Planar depth in world units (of a panorama the distance), +inf where nothing was seen.
    pub depth: Vec<f32>,
    /// Splats added to each pixel; empty unless they were counted.
    pub blends: Vec<f32>,
    /// What it took.
    pub work: Work,
    /// Seconds of wall time (unless another clock was given) in project, sort, bin and blend, the first three
    /// 0 of views that share the pass of one before them; for benches, never part of a result.
    pub seconds: [f64; 4],
}

/// What is blended over one tile.
struct Task<'a> {
    projected: &'a Projected,
    list: &'a [u32],
    /// First column and row, width and height, in pixels.
    area: [usize; 4],
    limit: Option<&'a Image<Data>>,
    settings: &'a Settings,
}

impl Task<'_> {
    /// Depth at which the blend of each pixel ends, in rows of [`TILE`]; +inf outside of the picture.
    fn limits(&self) -> Option<Vec<f32>> {
        let image = self.limit?;
        let [x0, y0, width, height] = self.area;
        let mut limits = vec![f32::INFINITY; TILE * TILE];
        for row in 0..height {
            for column in 0..width {
                // 0 is what some files hold where there is no surface.
                let depth = image.pixel(x0 + column, y0 + row)[0];
                limits[row * TILE + column] = if depth > 0.0 { depth } else { f32::INFINITY };
            }
        }
        Some(limits)
    }
}

/// One finished tile: RGBA, depth and blends of its pixels, in rows of [`TILE`].
struct Tile {
    rgba: Vec<[f32; 4]>,
    depth: Vec<f32>,
    counts: Vec<f32>,
    evaluations: u64,
    blends: u64,
}

/// The largest picture that is rendered, in pixels.
pub const MAX_PIXELS: u64 = 1 << 28;

/// The longest side of a picture, in pixels.
const MAX_SIDE: u32 = 1 << 19;

/// Views that share a pass over the scene: a cube's. More would hold more footprints at once.
const TOGETHER: usize = 6;

/// What a camera sees, for each; on the threads of `cx`, at the best instruction set of the machine.
///
/// Cameras in a row that stand at one point share a pass over the scene: a splat is read, turned and coloured
/// once, and one sort serves them all. Their pictures have the same bits as on their own.
///
/// `limits`, where given, holds a surface in front of each camera: splats at or beyond its planar depth are
/// left out of a pixel. A depth of 0 or +inf is no surface.
pub fn render_all(
    splats: &Splats,
    cameras: &[Camera],
    limits: Option<&[&Image<Data>]>,
    settings: &Settings,
    cx: &Context,
) -> Result<Vec<Rendered>, NodeError> {
    for (index, camera) in cameras.iter().enumerate() {
        checked(camera)?;
        let size = (camera.width_px as usize, camera.height_px as usize, 1);
        let Some(limits) = limits else { continue };
        let found = limits.get(index).map_or((0, 0, 0), |of| (of.width, of.height, of.channels));
        if found != size {
            let what = format!(
                "the depth of view `{}` is {}x{} of {} channels, the view {}x{}",
                camera.name, found.0, found.1, found.2, size.0, size.1
            );
            return Err(NodeError::new(what).at("limit"));
        }
    }
    let together = project::views_at_once(splats).clamp(1, TOGETHER);
    let mut all = Vec::with_capacity(cameras.len());
    for stand in cameras.chunk_by(|a, b| a.eye() == b.eye()) {
        for some in stand.chunks(together) {
            cx.progress(all.len() as f32 / cameras.len() as f32);
            let lenses: Vec<Pinhole> = some.iter().map(Pinhole::new).collect();
            let limits = limits.map(|limits| &limits[all.len()..all.len() + some.len()]);
            all.extend(draw(splats, &lenses, limits, settings, cx, (Level::new(), &|| 0.0))?);
        }
    }
    Ok(all)
}

/// What one camera sees; see [`render_all`].
pub fn render(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    render_at(splats, camera, settings, cx, Level::new())
}

/// Evaluations a second of the blend's arithmetic: one tile that stays in the first cache, every splat
/// covering it, no pixel ever finished. A yardstick for benches.
#[doc(hidden)]
pub fn calibrate(splats: usize, level: Level) -> f64 {
    let wide = Footprint {
        u: 8.0,
        v: 8.0,
        l11: 1e-3,
        l21: 1e-4,
        l22: 1e-3,
        opacity: 0.005,
        log2_opacity: -7.64,
        rgb: [0.5; 3],
        z: 1.0,
    };
    let list = vec![0; splats];
    let settings = Settings { stop: 0.0, ..Settings::default() };
    let start = std::time::Instant::now();
    let projected = Projected::of(vec![wide]);
    let area = [0, 0, TILE, TILE];
    let task = Task { projected: &projected, list: &list, area, limit: None, settings: &settings };
    let tile = blend32::blend(level, &task);
    std::hint::black_box(&tile.rgba);
    tile.evaluations as f64 / start.elapsed().as_secs_f64()
}

/// [`render`] at a given instruction set, which never changes the result.
pub fn render_at(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    cx: &Context,
    level: Level,
) -> Result<Rendered, NodeError> {
    let start = std::time::Instant::now();
    render_clocked(splats, camera, settings, cx, level, &|| start.elapsed().as_secs_f64())
}

/// [`render_at`] with the stages timed by `clock`, in seconds; a bench gives one of CPU time.
#[doc(hidden)]
pub fn render_clocked(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    cx: &Context,
    level: Level,
    clock: &dyn Fn() -> f64,
) -> Result<Rendered, NodeError> {
    checked(camera)?;
    alone(draw(splats, &[Pinhole::new(camera)], None, settings, cx, (level, clock))?)
}

/// The only view of a pass.
fn alone(views: Vec<Rendered>) -> Result<Rendered, NodeError> {
    views.into_iter().next().ok_or_else(|| NodeError::new("a pass without a view"))
}

fn checked(camera: &Camera) -> Result<(), NodeError> {
    let (width, height) = (camera.width_px, camera.height_px);
    if u64::from(width) * u64::from(height) <= MAX_PIXELS && width.max(height) <= MAX_SIDE {
        return Ok(());
    }
    let what = format!("view `{}` has {width}x{height} pixels", camera.name);
    let hint = format!("the limit is {MAX_PIXELS} pixels, and {MAX_SIDE} a side");
    Err(NodeError::new(what).at("rig").hint(hint))
}

/// One pass: views that share an eye.
fn draw<L: Lens>(
    splats: &Splats,
    lenses: &[L],
    limits: Option<&[&Image<Data>]>,
    settings: &Settings,
    cx: &Context,
    (level, clock): (Level, &dyn Fn() -> f64),
) -> Result<Vec<Rendered>, NodeError> {
    let mut last = clock();
    let mut lap = || {
        let now = clock();
        now - std::mem::replace(&mut last, now)
    };

    let projected = project::project(splats, lenses, settings, cx, level)?;
    let project_s = lap();
    let order = bin::order(projected.keys());
    let sort_s = lap();
    let sizes: Vec<(usize, usize)> = lenses.iter().map(Lens::size).collect();
    let lists = bin::bin(&projected, order, &sizes, settings, cx)?;
    let mut shared_s = [project_s, sort_s, lap()];

    let mut views = Vec::with_capacity(lenses.len());
    for (view, (width, height)) in sizes.into_iter().enumerate() {
        let limit = limits.map(|limits| limits[view]);
        let tiles = cx.for_each_tile(lists.tiles(view), |tile| {
            let (list, x0, y0) = lists.tile(view, tile);
            let area = [x0, y0, (width - x0).min(TILE), (height - y0).min(TILE)];
            let task = Task { projected: &projected, list, area, limit, settings };
            match settings.precision {
                Precision::F32 => blend32::blend(level, &task),
                Precision::F64 => blend64::blend(&task),
            }
        })?;
        let mut work = Work { tile_pairs: lists.pairs(view), ..projected.work(view) };
        let mut rgba = vec![0.0_f32; width * height * 4];
        let mut depth = vec![f32::INFINITY; width * height];
        let mut blends = vec![0.0_f32; if settings.count_blends { width * height } else { 0 }];
        for (index, tile) in tiles.iter().enumerate() {
            let (_, x0, y0) = lists.tile(view, index);
            work.evaluations += tile.evaluations;
            work.blends += tile.blends;
            let w = (width - x0).min(TILE);
            for row in 0..(height - y0).min(TILE) {
                let to = (y0 + row) * width + x0;
                let from = row * TILE;
                rgba[to * 4..(to + w) * 4].copy_from_slice(tile.rgba[from..from + w].as_flattened());
                depth[to..to + w].copy_from_slice(&tile.depth[from..from + w]);
                if settings.count_blends {
                    blends[to..to + w].copy_from_slice(&tile.counts[from..from + w]);
                }
            }
        }
        let [project_s, sort_s, bin_s] = std::mem::take(&mut shared_s);
        views.push(Rendered { rgba, depth, blends, work, seconds: [project_s, sort_s, bin_s, lap()] });
    }
    Ok(views)
}
