//! EWA splatting on the CPU: project, sort, bin, blend.
//!
//! One picture at a time. `project` turns every splat that can matter into a `Footprint` (f64
//! throughout, so that needles and far-off worlds keep their digits), `bin` sorts the footprints once
//! (stable; equal keys stay in file order) and lists them by tile, and `blend32` or `blend64`
//! composites each tile front to back. Where the lists would be too long, the last two take a group of tiles after the
//! other. Every stage gives the same bits for any number of threads and
//! any instruction set.

mod bin;
mod blend32;
mod blend64;
mod block;
mod camera_model;
mod panorama;
mod peak;
mod project;
mod settings;
mod sh;
mod shape;
mod surface;
#[cfg(test)]
mod tests;
mod tile;

use std::ops::AddAssign;

use engine::{Context, NodeError, Notes};
use fearless_simd::Level;

pub use bin::TILE;
pub(crate) use bin::most_bytes;
pub use block::Blocks;
use camera_model::{CameraModel, Pinhole};
pub use panorama::{PanoramaCamera, panorama, panorama_at};
use project::{Footprint, Projected};
pub use settings::{Bounds, Compensation, DepthMode, Drawing, Precision, Settings, Sort};
pub use surface::Surface;
use tile::{Strip, Task};

use crate::types::{Camera, Data, Image, Splats};

/// Work of one view; the same on every machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Splats that were looked at one by one.
    pub visited: u64,
    /// Splats that were left out by blocks, since none of the block can be in the picture.
    pub skipped: u64,
    /// Splats that were coloured and sorted.
    pub projected: u64,
    /// Of these, the ones whose harmonics were summed up in a direction; none of a scene of degree 0.
    pub directed: u64,
    /// Splats whose opacity is below the cut; counted where next to nothing is seen, and 0 otherwise.
    pub faint: u64,
    /// Others at or below the near plane; counted where next to nothing is seen, and 0 otherwise.
    pub behind: u64,
    /// Splats whose footprint is not a finite ellipse.
    pub degenerate: u64,
    /// Splats whose colour was held at the largest there is.
    pub held: u64,
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
        self.skipped += other.skipped;
        self.projected += other.projected;
        self.directed += other.directed;
        self.faint += other.faint;
        self.behind += other.behind;
        self.degenerate += other.degenerate;
        self.held += other.held;
        self.tile_pairs += other.tile_pairs;
        self.evaluations += other.evaluations;
        self.blends += other.blends;
    }
}

impl Work {
    /// Counts it, and notes what was left out of a scene of so many splats.
    pub(crate) fn report(&self, splats: usize, settings: &Settings, cx: &Context, notes: &mut Notes) {
        let near = settings.near;
        cx.count("splats_visited", self.visited);
        cx.count("splats_skipped", self.skipped);
        cx.count("splats_projected", self.projected);
        cx.count("splats_directed", self.directed);
        cx.count("splat_tile_pairs", self.tile_pairs);
        cx.count("splat_evaluations", self.evaluations);
        if settings.precision == Precision::F64 {
            cx.count("splat_evaluations_f64", self.evaluations);
        }
        cx.count("splat_blends", self.blends);
        notes.count("degenerate-splats", self.degenerate, "footprints are no finite ellipse; left out");
        let text =
            format!("colours are above {:e}, where white is 1, or overflow; held at that", sh::LARGEST);
        notes.count("colours-held", self.held, text);
        // A scene and an eye in different frames give an empty picture, not an error.
        if self.projected * 100 < splats as u64 {
            let most = |count: u64| count * 2 >= self.visited + self.skipped;
            let why = if splats > 0 && most(self.faint) {
                format!("most have an opacity of 0 or below `alpha_cut`, {:.6}", settings.alpha_cut)
            } else if most(self.behind) {
                format!(
                    "most lie behind or nearer than `near`, {near} world units: is that too far for this scene, or does \
                     the eye look away from it?"
                )
            } else if self.degenerate > self.projected {
                format!(
                    "the footprints of {} are no finite ellipse: are their scales meant?",
                    self.degenerate
                )
            } else {
                "do the eye and the splats share a frame and a scale?".to_owned()
            };
            let text = format!("{} of {splats} splats are seen; {why}", self.projected);
            notes.warning("few-splats-seen", text);
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
    /// The mean depth of the sheet of splats that is seen first: less noisy than that of one splat, and not nearer than the
    /// sheet. Of `RayMedian` alone; else empty, and of panoramas.
    pub front: Vec<f32>,
    /// How far the mean of what was blended lies from the depth, as a share of it: near 0 where one surface is seen, large
    /// where several are. Of `RayMedian` alone; else empty, and of panoramas.
    pub spread: Vec<f32>,
    /// What it took.
    pub work: Work,
    /// Seconds in project, sort, bin and blend by the clock that was given, 0 without; for benches, never part
    /// of a result.
    pub seconds: [f64; 4],
}

/// Tells seconds.
pub type Clock<'a> = &'a (dyn Fn() -> f64 + Sync);

/// The largest picture that is rendered, in pixels.
pub const MAX_PIXELS: u64 = 1 << 28;

/// The longest side of a picture, in pixels.
const MAX_SIDE: u32 = 1 << 19;

/// A surface in front of a camera: splats at or beyond it are left out of a pixel.
#[derive(Debug, Clone, Copy)]
pub struct Limit<'a> {
    /// Planar depth in world units, one channel, of the size of the picture; 0 or +inf is no surface.
    pub depth: &'a Image<Data>,
    /// How far before the surface the centre of a splat must lie, in standard deviations along its middle axis, at
    /// least 0. The splats of a surface lie about it by less than they are wide.
    pub sigmas: f64,
}

/// What a camera sees, on the threads of `cx`, at the best instruction set of the machine; with a `limit` only what
/// lies before that.
///
/// The faces of a cube are rendered one by one: a splat is seen by 1.14 of them, so a pass for all six spares
/// next to nothing of the projection, and sorts and holds six times as much; measured, it took longer.
pub fn render(
    splats: &Splats,
    camera: &Camera,
    limit: Option<Limit<'_>>,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    render_with(splats, None, camera, limit, settings, cx)
}

/// [`render`] where blocks that cannot be seen are not looked at: for several pictures of a scene.
pub fn render_with(
    splats: &Splats,
    blocks: Option<&Blocks>,
    camera: &Camera,
    limit: Option<Limit<'_>>,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    check(camera, limit)?;
    draw(splats, blocks, &Pinhole::new(camera), limit, settings, cx, (Level::new(), &|| 0.0))
}

/// [`render`] at a given instruction set, which never changes the result, with the stages timed by a clock that
/// tells seconds: for tests and benches.
#[doc(hidden)]
pub fn render_at(
    splats: &Splats,
    camera: &Camera,
    limit: Option<Limit<'_>>,
    settings: &Settings,
    cx: &Context,
    how: (Level, Clock<'_>),
) -> Result<Rendered, NodeError> {
    check(camera, limit)?;
    draw(splats, None, &Pinhole::new(camera), limit, settings, cx, how)
}

/// An error for a picture that is too large, or a surface of another size.
fn check(camera: &Camera, limit: Option<Limit<'_>>) -> Result<(), NodeError> {
    checked(camera)?;
    let size = (camera.width_px as usize, camera.height_px as usize, 1);
    let found = limit.map_or(size, |Limit { depth, .. }| (depth.width, depth.height, depth.channels));
    if found != size {
        let what = format!(
            "the depth of view `{}` is {}x{} of {} channels, the view {}x{}",
            camera.name, found.0, found.1, found.2, size.0, size.1
        );
        return Err(NodeError::new(what).at("limit"));
    }
    Ok(())
}

/// Evaluations a second of the blend's arithmetic, by a clock that tells seconds: one tile that stays in the
/// first cache, every splat covering it, no pixel ever finished. A yardstick for benches.
#[doc(hidden)]
pub fn calibrate(splats: usize, level: Level, clock: Clock<'_>, cx: &Context) -> f64 {
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
    let projected = Projected::of(vec![wide]);
    let (mut rgba, mut depth) = ([[0.0; 4]; TILE * TILE], [0.0; TILE * TILE]);
    let strips = Strip::of(TILE, &mut rgba, &mut depth, [&mut [], &mut [], &mut []]);
    let task = Task {
        projected: &projected,
        list: &list,
        area: [0, 0, TILE, TILE],
        limit: None,
        settings: &settings,
        cx,
        strip: &strips[0],
    };
    let start = clock();
    let work = blend32::blend(level, &task);
    let rate = work.evaluations as f64 / (clock() - start);
    std::hint::black_box(&rgba);
    rate
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

/// One picture.
fn draw<L: CameraModel>(
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
            let (x0, y0) = (column * TILE, row * TILE);
            let area = [x0, y0, (width - x0).min(TILE), (height - y0).min(TILE)];
            let strip = &strips[row];
            let limit = limit.map(|limit| limit.depth);
            let task = Task { projected: &projected, list, area, limit, settings, cx, strip };
            match settings.precision {
                Precision::F32 => blend32::blend(level, &task),
                Precision::F64 => blend64::blend(&task),
            }
        })?;
        // A tile may take seconds where bounds are `None`, so a blend ends early once the run is stopped.
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
