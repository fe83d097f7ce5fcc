//! Panoramas: splats drawn directly into the equirectangular layout, except for the two caps around the
//! poles, which are drawn as pinhole pictures.
//!
//! A footprint can be drawn only where the layout is approximately linear over it. Near a pole, the layout is not
//! linear: a splat there covers a ring or a disc across all columns, not an ellipse. So directions within [`CAP`]
//! of a pole are drawn by a camera that looks at the pole, and are then resampled. Between [`FADE`] and [`CAP`] the
//! pinhole picture and the layout are blended. The caps cost no additional work. They cover a third of the pixels
//! of the layout, and the two pinhole pictures together have slightly fewer pixels than that, although their
//! resolution is higher.

use std::f64::consts::{FRAC_PI_6, TAU};

use engine::{Context, NodeError, Up};
use fearless_simd::Level;
use glam::DVec3;
use scene::math::{equirect, num};
use scene::types::{Camera, Data, Image, Splats};

use super::block::Blocks;
use super::camera_model::{Pinhole, Sphere};
use super::draw::{Clock, Limit, Rendered, draw};
use super::settings::{Settings, Sort};
use super::surface::Surface;
use super::work::Work;

/// Angle from the pole within which the cap is drawn, in radians.
const CAP: f64 = FRAC_PI_6;
/// Angle from the pole up to which only the cap is used, in radians.
const FADE: f64 = 5.0 / 6.0 * CAP;

/// Resolution at the centre of the picture of a cap, in pixels per pixel of the layout along a great circle. It is
/// above 1 because resampling between pixel centres blurs by about a pixel.
const DENSITY: f64 = 1.5;

/// Position, orientation and size of a panorama.
#[derive(Debug, Clone, Copy)]
pub struct PanoramaCamera {
    /// Position, in world units.
    pub eye: DVec3,
    /// Up direction of the world. It is shown along the top edge of the picture.
    pub up: Up,
    /// Number of columns, which must be even. There are half as many rows.
    pub width_px: u32,
}

/// Renders all directions around a point as an equirectangular picture (see [`scene::math::equirect`]).
/// Splats are sorted by distance, and `near` and depth are distances too. Splats at or beyond `limit`, a
/// surface as seen from the same point, are left out.
pub fn panorama(
    splats: &Splats,
    around: &PanoramaCamera,
    limit: Option<&Surface>,
    settings: &Settings,
    cx: &Context,
) -> Result<Rendered, NodeError> {
    panorama_at(splats, around, limit, settings, cx, Level::new())
}

/// Same as [`panorama`] with a given instruction set, which never changes the result.
pub fn panorama_at(
    splats: &Splats,
    &PanoramaCamera { eye, up, width_px }: &PanoramaCamera,
    limit: Option<&Surface>,
    settings: &Settings,
    cx: &Context,
    level: Level,
) -> Result<Rendered, NodeError> {
    let settings = Settings { sort: Sort::Distance, ..*settings };
    let how = (level, &(|| 0.0) as Clock<'_>);
    let height = width_px / 2;
    // Rows that are covered by the caps only, at either end.
    let left_out = (FADE / (TAU / f64::from(width_px))) as u32;
    let left_out = left_out.min(height.saturating_sub(1) / 2);
    let seen_from_belt = |surface: &Surface| {
        let direction = |x: usize, y: usize| {
            let (u, v) = (x as f64 + 0.5, (y + left_out as usize) as f64 + 0.5);
            equirect::direction(up, u / f64::from(width_px), v / f64::from(height))
        };
        surface.distances(width_px as usize, (height - 2 * left_out) as usize, direction, cx)
    };
    // The light uses every splat in front of the mesh, by its centre.
    fn at_centres(depth: &Image<Data>) -> Limit<'_> {
        Limit { depth, sigmas: 0.0 }
    }
    let before = limit.map(seen_from_belt).transpose()?;
    let belt = Sphere::new(eye, up, width_px, left_out..height - left_out);
    let belt = draw(splats, None, &belt, before.as_ref().map(at_centres), &settings, cx, how)?;
    drop(before);
    cx.progress(0.5);

    // The belt shows nearly everything, a cap very little.
    let blocks = settings.skip_unseen.then(|| Blocks::of(splats, cx)).transpose()?;
    let seen_by = |camera: &Camera| {
        let side = camera.width_px as usize;
        let direction = |x: usize, y: usize| camera.direction(x as f64 + 0.5, y as f64 + 0.5);
        let before = limit.map(|surface| surface.distances(side, side, direction, cx)).transpose()?;
        let before = before.as_ref().map(at_centres);
        draw(splats, blocks.as_ref(), &Pinhole::by_distance(camera), before, &settings, cx, how)
    };
    let cameras = [cap(eye, up, 1.0, width_px), cap(eye, up, -1.0, width_px)];
    let caps = [seen_by(&cameras[0])?, seen_by(&cameras[1])?];
    let caps: Vec<Cap<'_>> = cameras.iter().zip(&caps).map(|(camera, seen)| Cap { camera, seen }).collect();

    let (width, first) = (width_px as usize, left_out as usize);
    let rows = cx.for_each_tile(height as usize, |y| {
        let theta = (y as f64 + 0.5) * TAU / width as f64;
        let from_pole = theta.min(0.5 * TAU - theta);
        let t = ((CAP - from_pole) / (CAP - FADE)).clamp(0.0, 1.0);
        let share = t * t * (3.0 - 2.0 * t);
        let at = |x: usize| (y - first) * width + x;
        let mut row = PixelRow::default();
        for x in 0..width {
            let mut pixel = PanoramaPixel::default();
            if share < 1.0 {
                pixel.rgba = belt.rgba.as_chunks::<4>().0[at(x)].map(|v| v * (1.0 - share) as f32);
            }
            if share < 0.5 {
                pixel.depth = belt.depth[at(x)];
                pixel.blends = belt.blends.get(at(x)).copied();
            }
            if share > 0.0 {
                let u = (x as f64 + 0.5) / width as f64;
                let direction = equirect::direction(up, u, theta / (0.5 * TAU));
                let cap = &caps[usize::from(theta > 0.25 * TAU)];
                cap.add(direction, share, &mut pixel);
            }
            row.rgba.extend(pixel.rgba);
            row.depth.push(pixel.depth);
            row.blends.extend(pixel.blends);
        }
        row
    })?;
    let mut all = Rendered {
        rgba: Vec::with_capacity(width * height as usize * 4),
        depth: Vec::with_capacity(width * height as usize),
        blends: Vec::new(),
        front: Vec::new(),
        spread: Vec::new(),
        work: Work::default(),
        seconds: [0.0; 4],
    };
    for row in rows {
        all.rgba.extend(row.rgba);
        all.depth.extend(row.depth);
        all.blends.extend(row.blends);
    }
    [&belt, caps[0].seen, caps[1].seen].into_iter().for_each(|part| all.work += part.work);
    Ok(all)
}

/// Camera that looks up (`side` 1) or down (`side` -1).
fn cap(eye: DVec3, up: Up, side: f64, width_px: u32) -> Camera {
    let [right, forward, above] = equirect::axes(up);
    let focal = DENSITY * f64::from(width_px) / TAU;
    // One pixel and a half more, so that resampling between pixel centres stays inside.
    let half = (focal * num::f64::tan(CAP) + 1.5).ceil();
    // Right, down, and viewing direction, right-handed.
    Camera::centred("cap", [2 * half as u32; 2], focal, [right, -forward * side, above * side], eye)
}

#[derive(Default)]
struct PixelRow {
    rgba: Vec<f32>,
    depth: Vec<f32>,
    blends: Vec<f32>,
}

#[derive(Default)]
struct PanoramaPixel {
    rgba: [f32; 4],
    depth: f32,
    blends: Option<f32>,
}

/// Picture around a pole.
struct Cap<'a> {
    camera: &'a Camera,
    seen: &'a Rendered,
}

impl Cap<'_> {
    /// Adds to `pixel` the colour of the cap in a direction, multiplied by `share`. Colours are interpolated
    /// between four pixel centres. Depth and count are taken from the nearest pixel, since the mean of two depths
    /// may be in empty space.
    fn add(&self, direction: DVec3, share: f64, pixel: &mut PanoramaPixel) {
        let m = self.camera.world_from_camera();
        let along = |axis: glam::DVec4| axis.truncate().dot(direction);
        let z = along(m.z_axis);
        let side = self.camera.width_px as usize;
        let place = |slope: f64| {
            let at = (slope / z * self.camera.fx + self.camera.cx - 0.5).clamp(0.0, (side - 1) as f64);
            let first = (at as usize).min(side - 2);
            (first, at - first as f64)
        };
        let ((x, fx), (y, fy)) = (place(along(m.x_axis)), place(along(m.y_axis)));
        let pixels = self.seen.rgba.as_chunks::<4>().0;
        for (dx, dy, part) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            for (sum, value) in pixel.rgba.iter_mut().zip(pixels[(y + dy) * side + x + dx]) {
                *sum += (share * part) as f32 * value;
            }
        }
        if share >= 0.5 {
            let nearest = (y + usize::from(fy >= 0.5)) * side + x + usize::from(fx >= 0.5);
            pixel.depth = self.seen.depth[nearest];
            pixel.blends = self.seen.blends.get(nearest).copied();
        }
    }
}
