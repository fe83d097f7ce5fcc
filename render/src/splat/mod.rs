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
mod distorted;
mod draw;
pub mod gradient;
mod listed;
pub mod near;
mod panorama;
mod peak;
mod project;
mod rows;
mod settings;
mod sh;
mod shape;
mod surface;
#[cfg(test)]
mod tests;
mod tile;
mod work;

use engine::{Context, NodeError};
use fearless_simd::Level;
use scene::types::{Camera, Splats};

pub use bin::most_bytes;
pub use block::Blocks;
use camera_model::Pinhole;
use distorted::Distorted;
use draw::draw;
pub use draw::{Clock, Limit, Rendered};
pub use panorama::{PanoramaCamera, panorama, panorama_at};
pub use peak::PEAK_BYTES;
pub(crate) use project::CHUNK;
use project::{Footprint, Projected};
pub use settings::former;
pub use settings::{Bounds, Compensation, DepthMode, Drawing, Precision, Settings, Sort, TILE};
pub use surface::Surface;
use tile::{Strip, Task};
pub use work::Work;

/// Maximum number of pixels of a picture.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Maximum side of a picture, in pixels.
const MAX_SIDE: u32 = 1 << 19;

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
    drawn((splats, blocks), camera, limit, settings, cx, (Level::new(), &|| 0.0))
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
    drawn((splats, None), camera, limit, settings, cx, how)
}

fn drawn(
    (splats, blocks): (&Splats, Option<&Blocks>),
    camera: &Camera,
    limit: Option<Limit<'_>>,
    settings: &Settings,
    cx: &Context,
    how: (Level, Clock<'_>),
) -> Result<Rendered, NodeError> {
    check(camera, limit)?;
    if camera.lens.is_pinhole() {
        draw(splats, blocks, &Pinhole::new(camera), limit, settings, cx, how)
    } else {
        draw(splats, blocks, &Distorted::new(camera), limit, settings, cx, how)
    }
}

/// Checks the size of the picture, and that the depth image of the limit has the same size.
fn check(camera: &Camera, limit: Option<Limit<'_>>) -> Result<(), NodeError> {
    checked(camera)?;
    let size = (camera.width_px as usize, camera.height_px as usize, 1);
    let found = limit.map_or(size, |Limit { depth, .. }| (depth.width, depth.height, depth.channels));
    if found != size {
        let what = format!(
            "the limiting depth for view `{}` is {}x{} pixels (channels: {}); it must be {}x{} pixels with 1 channel",
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
    let what = format!("view `{}` is too large: it is {width}x{height} pixels", camera.name);
    let hint = format!("the limit is {MAX_PIXELS} pixels, and {MAX_SIDE} pixels per side");
    Err(NodeError::new(what).at("rig").hint(hint))
}
