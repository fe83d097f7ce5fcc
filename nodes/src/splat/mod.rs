//! EWA splatting on the CPU: project, sort, bin, blend.
//!
//! One camera at a time. `project` turns every splat that can matter into a `Footprint` (f64
//! throughout, so that needles and far-off worlds keep their digits), `bin` sorts the footprints once
//! (stable; equal keys stay in file order) and lists them by tile, and `blend32` or `blend64`
//! composites each tile front to back. Every stage gives the same bits for any number of threads and
//! any instruction set.

mod bin;
mod blend32;
mod blend64;
mod lens;
mod project;
mod sh;
#[cfg(test)]
mod tests;

use engine::{Context, NodeError, Notes, Up};
use fearless_simd::Level;
use glam::DVec3;

pub use bin::TILE;
use lens::{Lens, Pinhole, Sphere};
use project::{Footprint, Projected};

use crate::types::{Camera, Data, Image, Splats};

engine::choices! {
    /// Which pixels a splat is evaluated at.
    pub enum Bounds {
        /** Where its alpha reaches the cut: the exact ellipse, closed. */ Exact,
        /** As the INRIA rasterizer: every tile that a square of 3 standard deviations touches. */ Inria,
        /** All. */ None,
    }
}
engine::choices! {
    /// Arithmetic of the blend; the projection is always in f64.
    pub enum Precision { /** 8 pixels at once. */ F32, /** The reference: slow. */ F64 }
}
engine::choices! {
    /// What orders the splats of a pixel.
    pub enum Sort {
        /** Planar depth of the centre, as nearly every trainer. */ Depth,
        /** Distance of the centre, which does not change as the camera turns. */ Distance,
    }
}
engine::choices! {
    /// Whether opacity makes up for what the low-pass filter adds to a splat's area.
    pub enum Compensation { /** As the file says it was trained. */ File, /** Always. */ On, /** Never. */ Off }
}
engine::choices! {
    /// What the depth of a pixel is.
    pub enum DepthMode {
        /** Mean depth of what was blended, by weight. */ Expected,
        /** Depth of the splat that takes transmittance to one half or below; none where none does. */
        Median,
        /** As `Expected`, with each weight times the transmittance in front once more: what shines through
        counts less, so it lies nearer to the first surface. */
        Transmittance,
    }
}

impl Compensation {
    /// Whether to compensate for a scene.
    pub(crate) fn applies(self, splats: &Splats) -> bool {
        match self {
            Self::File => splats.antialiased,
            Self::On => true,
            Self::Off => false,
        }
    }

    /// Warns where the file says otherwise.
    pub(crate) fn warn(self, splats: &Splats, notes: &mut Notes) {
        let text = match (self, splats.antialiased) {
            (Self::On, false) => {
                "compensation is on, but the file does not say it was trained so; thin detail may vanish"
            }
            (Self::Off, true) => "compensation is off, but the file says it was trained with it",
            _ => return,
        };
        notes.warning("compensation-mismatch", text);
    }
}

/// How to render; the parameters of `splat-render` with the file's own flag applied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Which pixels a splat is evaluated at.
    pub bounds: Bounds,
    /// Arithmetic of the blend.
    pub precision: Precision,
    /// What orders the splats.
    pub sort: Sort,
    /// Highest degree of the spherical harmonics that is used.
    pub sh_degree: u32,
    /// Splats at or below this planar depth are left out, in world units.
    pub near: f64,
    /// Variance added to both axes of the footprint, in square pixels.
    pub low_pass_px2: f64,
    /// True when opacity is scaled by the square root of the ratio of the footprint's areas.
    pub compensate: bool,
    /// Smallest alpha that is blended.
    pub alpha_cut: f64,
    /// Largest alpha of one splat.
    pub alpha_cap: f64,
    /// A pixel is finished, without the splat at hand, when its transmittance would fall below.
    pub stop: f64,
    /// What the depth of a pixel is.
    pub depth: DepthMode,
    /// True to count the blends of each pixel.
    pub count_blends: bool,
}

impl Default for Settings {
    /// The constants of the INRIA rasterizer (diff-gaussian-rasterization 59f5f77) with exact bounds.
    fn default() -> Self {
        Self {
            bounds: Bounds::Exact,
            precision: Precision::F32,
            sort: Sort::Depth,
            sh_degree: 4,
            near: 0.2,
            low_pass_px2: 0.3,
            compensate: false,
            alpha_cut: 1.0 / 255.0,
            alpha_cap: 0.99,
            stop: 1e-4,
            depth: DepthMode::Expected,
            count_blends: false,
        }
    }
}

/// Work of one view; the same on every machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
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

impl Work {
    /// Counts it, and notes what was left out.
    pub(crate) fn report(&self, cx: &Context, notes: &mut Notes) {
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
    /// Seconds of wall time (unless another clock was given) in project, sort, bin and blend; for benches, never part of a result.
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

/// Renders a scene for one camera on the threads of `cx`, at the best instruction set of the machine.
pub fn render(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    render_at(splats, camera, settings, cx, Level::new())
}

/// [`render`] in front of a surface: splats at or beyond its planar depth are left out of a pixel. A depth
/// of 0 or +inf is no surface.
pub fn render_before(
    splats: &Splats,
    camera: &Camera,
    limit: &Image<Data>,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    let size = (camera.width_px as usize, camera.height_px as usize, 1);
    if (limit.width, limit.height, limit.channels) != size {
        let what = format!(
            "the depth of view `{}` is {}x{} of {} channels, the view {}x{}",
            camera.name, limit.width, limit.height, limit.channels, size.0, size.1
        );
        return Err(NodeError::new(what).at("limit"));
    }
    checked(camera)?;
    let lens = Pinhole::new(camera);
    draw(splats, &lens, Some(limit), settings, cx, (Level::new(), &|| 0.0))
}

/// Everything around `eye` as an equirectangular picture (see [`crate::equirect`]), `width_px` wide, even,
/// and half as high. Splats are ordered by distance, which is also what `near` and the depth mean.
pub fn panorama(
    splats: &Splats,
    eye: DVec3,
    up: Up,
    width_px: u32,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    panorama_clocked(splats, (eye, up, width_px), settings, cx, Level::new(), &|| 0.0)
}

/// [`panorama`] at a given instruction set, its stages timed as [`render_clocked`] does.
#[doc(hidden)]
pub fn panorama_clocked(
    splats: &Splats,
    (eye, up, width_px): (DVec3, Up, u32),
    settings: &Settings,
    cx: &Context,
    level: Level,
    clock: &dyn Fn() -> f64,
) -> Result<Rendered, NodeError> {
    let settings = Settings { sort: Sort::Distance, ..*settings };
    draw(splats, &Sphere::new(eye, up, width_px), None, &settings, cx, (level, clock))
}

/// Evaluations a second of the blend's arithmetic: one tile that stays in the first cache, every splat
/// covering it, no pixel ever finished. A yardstick for benches.
#[doc(hidden)]
pub fn calibrate(splats: usize) -> f64 {
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
    let tile = blend32::blend(Level::new(), &task);
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
    draw(splats, &Pinhole::new(camera), None, settings, cx, (level, clock))
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

fn draw<L: Lens>(
    splats: &Splats,
    lens: &L,
    limit: Option<&Image<Data>>,
    settings: &Settings,
    cx: &Context,
    (level, clock): (Level, &dyn Fn() -> f64),
) -> Result<Rendered, NodeError> {
    let (width, height) = lens.size();
    let mut last = clock();
    let mut lap = || {
        let now = clock();
        now - std::mem::replace(&mut last, now)
    };

    let projected = project::project(splats, lens, settings, cx, level)?;
    let project_s = lap();
    let order = bin::order(projected.keys());
    let sort_s = lap();
    let lists = bin::bin(&projected, order, width, height, settings, cx)?;
    let bin_s = lap();

    let tiles = cx.for_each_tile(lists.tiles(), |tile| {
        let (list, x0, y0) = lists.tile(tile);
        let area = [x0, y0, (width - x0).min(TILE), (height - y0).min(TILE)];
        let task = Task { projected: &projected, list, area, limit, settings };
        match settings.precision {
            Precision::F32 => blend32::blend(level, &task),
            Precision::F64 => blend64::blend(&task),
        }
    })?;

    let mut work = Work {
        projected: projected.len() as u64,
        behind: projected.behind(),
        degenerate: projected.degenerate(),
        tile_pairs: lists.pairs(),
        ..Work::default()
    };
    let mut rgba = vec![0.0_f32; width * height * 4];
    let mut depth = vec![f32::INFINITY; width * height];
    let mut blends = vec![0.0_f32; if settings.count_blends { width * height } else { 0 }];
    for (index, tile) in tiles.iter().enumerate() {
        let (_, x0, y0) = lists.tile(index);
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
    Ok(Rendered { rgba, depth, blends, work, seconds: [project_s, sort_s, bin_s, lap()] })
}
