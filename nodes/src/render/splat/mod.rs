//! EWA splatting on the CPU, in four stages: project, sort, bin, blend.
//!
//! Pictures are rendered one at a time. `project` computes a `Footprint` for every splat that can be visible, in
//! f64, so that needles and worlds far from the origin are exact. `bin` sorts the footprints once, by a stable
//! sort, and lists them by tile. `blend32` or `blend64` composites each tile front to back. If the lists would be
//! too long, the last two stages process one group of tiles after the other. Every stage gives the same bits for
//! any number of threads and any instruction set.

mod bin;
mod blend32;
mod blend64;
mod block;
mod camera_model;
mod listed;
pub(crate) mod near;
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

pub(crate) use bin::most_bytes;
pub use block::Blocks;
use camera_model::{CameraModel, Pinhole};
pub use panorama::{PanoramaCamera, panorama, panorama_at};
use project::{Footprint, Projected};
pub(crate) use settings::former;
pub use settings::{Bounds, Compensation, DepthMode, Drawing, Precision, Settings, Sort, TILE};
pub use surface::Surface;
use tile::{Strip, Task};

use crate::types::{Camera, Data, Image, Splats};

/// Work counts of one view, which are the same on every machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Number of splats that were tested individually.
    pub visited: u64,
    /// Number of splats in blocks that were skipped because no splat of the block can be in the picture.
    pub skipped: u64,
    /// Number of splats that were projected, coloured and sorted.
    pub projected: u64,
    /// Number of projected splats whose harmonics were evaluated in a direction; 0 for a scene of degree 0.
    pub directed: u64,
    /// Number of splats with an opacity of 0 or below `alpha_cut`; counted only if almost nothing is visible.
    pub faint: u64,
    /// Number of splats that are at or below the near plane and not counted in `faint`; counted only if almost
    /// nothing is visible.
    pub behind: u64,
    /// Number of splats whose footprint is not a finite ellipse.
    pub degenerate: u64,
    /// Number of splats with a colour that was clamped to the maximum or overflowed.
    pub held: u64,
    /// Number of pairs of a splat and a tile that lists it.
    pub tile_pairs: u64,
    /// Number of times that a splat was evaluated at a pixel.
    pub evaluations: u64,
    /// Number of times that a splat was blended into a pixel.
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
    /// Reports the counts to `cx`, and adds notes about splats that were left out. `splats` is the number of splats
    /// of the scene.
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
        notes.count(
            "degenerate-splats",
            self.degenerate,
            "of the footprints had to be left out because of a shape that is not a finite ellipse",
        );
        let text = format!(
            "of the colours exceeded the maximum of {:e} (white is 1) or overflowed, and had to be clamped to that maximum",
            sh::LARGEST
        );
        notes.count("colours-held", self.held, text);
        // A scene and an eye in different frames give an empty picture, not an error.
        if self.projected * 100 < splats as u64 {
            let most = |count: u64| count * 2 >= self.visited + self.skipped;
            let why = if splats > 0 && most(self.faint) {
                format!(
                    "most splats have an opacity that is 0 or below `alpha_cut` ({:.6})",
                    settings.alpha_cut
                )
            } else if most(self.behind) {
                format!(
                    "most splats are behind the camera or nearer than `near` ({near} world units); check that `near` is not too large for this scene, and that the camera looks towards it"
                )
            } else if self.degenerate > self.projected {
                format!(
                    "footprints that are not finite ellipses were left out (number: {}); check the scales of the splats",
                    self.degenerate
                )
            } else {
                "check that the camera and the splats use the same frame and scale".to_owned()
            };
            let text = format!("only {} of {splats} splats can be seen; {why}", self.projected);
            notes.warning("few-splats-seen", text);
        }
    }
}

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

/// Maximum number of pixels of a picture.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Maximum side of a picture, in pixels.
const MAX_SIDE: u32 = 1 << 19;

/// Memory for the peak of a splat and its distance from a limiting surface, in bytes.
pub(crate) const PEAK_BYTES: u64 = (size_of::<peak::Peak>() + size_of::<f32>()) as u64;

/// Surface in front of a camera. At each pixel, splats at or beyond the surface are left out.
#[derive(Debug, Clone, Copy)]
pub struct Limit<'a> {
    /// Planar depth in world units: an image with one channel and the size of the picture. 0 or +inf means that
    /// there is no surface.
    pub depth: &'a Image<Data>,
    /// Distance by which a splat must lie in front of the surface, at least 0, in standard deviations along the
    /// middle axis of the splat. It applies per pixel to the depth at which the splat is densest along the ray (see
    /// [`DepthMode::RayMedian`]), or to two standard deviations of depth behind the centre if this depth is farther
    /// in front of it than that. The splats that represent a surface scatter around it by less than their width.
    /// The centre of the splat must lie in front as well. If this is 0, only the centre counts.
    pub sigmas: f64,
}

/// Renders the view of a camera, on the threads of `cx`, with the best instruction set of the machine. If
/// there is a `limit`, only splats in front of it are rendered.
///
/// The faces of a cube are rendered one by one. A splat is visible in 1.14 of them on average, so a pass for
/// all six would save little of the projection, and would sort and keep six times as much data. In
/// measurements it took longer.
pub fn render(
    splats: &Splats,
    camera: &Camera,
    limit: Option<Limit<'_>>,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    render_with(splats, None, camera, limit, settings, cx)
}

/// Same as [`render`], but skips blocks of splats that are not visible, if `blocks` is given. Used to render
/// several pictures of a scene.
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

/// Same as [`render`] with a given instruction set, which never changes the result, and a clock that measures the
/// time of each stage. Used by tests and benches.
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

/// Checks the size of the picture, and that the depth image of the limit has the same size.
fn check(camera: &Camera, limit: Option<Limit<'_>>) -> Result<(), NodeError> {
    checked(camera)?;
    let size = (camera.width_px as usize, camera.height_px as usize, 1);
    let found = limit.map_or(size, |Limit { depth, .. }| (depth.width, depth.height, depth.channels));
    if found != size {
        let what = format!(
            "the limiting depth for view `{}` has {}x{} pixels and the channel count {}; it must have {}x{} pixels and 1 channel",
            camera.name, found.0, found.1, found.2, size.0, size.1
        );
        return Err(NodeError::new(what).at("limit"));
    }
    Ok(())
}

/// Measures the speed of blending arithmetic, in evaluations per second, as a reference for benchmarks. It blends
/// one tile that stays in the first-level cache. Every splat covers the tile, and no pixel is ever finished.
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
    let what = format!("view `{}` is too large: it has {width}x{height} pixels", camera.name);
    let hint = format!("the limit is {MAX_PIXELS} pixels, and {MAX_SIDE} pixels per side");
    Err(NodeError::new(what).at("rig").hint(hint))
}

/// Renders one picture.
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
