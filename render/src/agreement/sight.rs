//! Views in which splats and mesh are compared. Each holds a small depth image of the splats.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::types::{Camera, Splats};

use crate::geometry::support::median;
use crate::splat::{Blocks, DepthMode, Settings, render_with};

/// Maximum width and height of the small picture of a wanted view, in pixels.
const WANTED_PX: f64 = 128.0;
/// Width and height of each of the six cube faces around a point, in pixels.
const FACE_PX: u32 = 72;
/// Minimum coverage at which splats count as a surface.
const SOLID: f32 = 0.9;
/// Maximum coverage at which splats count as empty space.
const EMPTY: f32 = 0.1;
/// Maximum relative difference between the mean depth and the median depth of a pixel that shows a single surface.
const SPREAD: f32 = 0.06;
/// Maximum relative difference between the depths of two neighbouring pixels that show the same surface.
pub(super) const STEP: f64 = 0.12;
/// Distance from the eye to the near plane, as a share of the median distance from the eye to the splats.
const NEAR_SHARE: f64 = 0.02;
/// Maximum distance from the eye to the near plane, in metres.
const NEAR_METRES: f64 = 0.2;

/// A view, with the depths of the splats.
pub(super) struct Sight {
    /// Camera of the small picture.
    pub camera: Camera,
    /// True for a view that the graph renders, false for a view around an object.
    pub wanted: bool,
    /// Planar depth of the surface of the splats at each pixel, in world units; +inf where there is no surface.
    pub depth: Vec<f64>,
    /// True for each pixel at which the splats show a single surface, with nothing semi-transparent in front of it.
    pub clear: Vec<bool>,
    /// True for each pixel that hardly any splats cover.
    pub empty: Vec<bool>,
    /// Distance from the eye to the near plane, in world units. Splats that are nearer are not drawn.
    pub near: f64,
}

/// Returns a pinhole camera with about the same view, whose picture is at most [`WANTED_PX`] pixels wide and high.
fn smaller(camera: &Camera) -> Camera {
    let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
    let factor = (WANTED_PX / width.max(height)).min(1.0);
    let [new_width, new_height] = [width, height].map(|side| (side * factor).round().max(1.0));
    let (x, y) = (new_width / width, new_height / height);
    Camera {
        width_px: new_width as u32,
        height_px: new_height as u32,
        fx: camera.fx * x,
        fy: camera.fy * y,
        cx: camera.cx * x,
        cy: camera.cy * y,
        ..camera.without_distortion()
    }
}

/// Cameras for the six faces of a cube around a point. The cube is not aligned with the axes, because walls are
/// often aligned with them.
fn faces(eye: DVec3, [right, forward, up]: [DVec3; 3]) -> [Camera; 6] {
    // Sine and cosine of 0.4 and of 0.25 radians.
    let (right, forward) = (right * 0.921_061 + forward * 0.389_418, forward * 0.921_061 - right * 0.389_418);
    let (forward, up) = (forward * 0.968_912 + up * 0.247_404, up * 0.968_912 - forward * 0.247_404);
    let focal = 0.5 * f64::from(FACE_PX);
    Camera::cube("around the object", FACE_PX, focal, [right, forward, up], eye)
}

impl Sight {
    /// Renders the splats in small pictures of the wanted views. `metre` is the number of world units per metre.
    pub fn wanted(
        splats: &Splats,
        blocks: &Blocks,
        cameras: &[Camera],
        metre: f64,
        cx: &Context,
    ) -> Result<Vec<Self>, NodeError> {
        cameras.iter().map(|camera| Self::of(splats, blocks, smaller(camera), true, metre, cx)).collect()
    }

    /// Renders the splats in the six directions around a point. `metre` is the number of world units per metre; `axes`
    /// point right, forward and up.
    pub fn around(
        splats: &Splats,
        blocks: &Blocks,
        eye: DVec3,
        (axes, metre): ([DVec3; 3], f64),
        cx: &Context,
    ) -> Result<Vec<Self>, NodeError> {
        let render = |camera| Self::of(splats, blocks, camera, false, metre, cx);
        faces(eye, axes).into_iter().map(render).collect()
    }

    fn of(
        splats: &Splats,
        blocks: &Blocks,
        camera: Camera,
        wanted: bool,
        metre: f64,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let eye = camera.eye();
        let step = (splats.len() / 1000).max(1);
        let far = (0..splats.len()).step_by(step).map(|i| (splats.mean(i) - eye).length());
        let near =
            (NEAR_SHARE * median(far.collect()).unwrap_or_default()).min(NEAR_METRES * metre).max(1e-12);
        let settings = Settings {
            near,
            depth: DepthMode::RayMedian,
            sh_degree: 0,
            compensate: splats.antialiased,
            ..Settings::default()
        };
        let seen = render_with(splats, Some(blocks), &camera, None, &settings, cx)?;
        let alphas = || seen.rgba.as_chunks::<4>().0.iter().map(|pixel| pixel[3]);
        let surface = |(depth, alpha): (&f32, f32)| {
            if alpha >= SOLID && *depth > 0.0 { f64::from(*depth) } else { f64::INFINITY }
        };
        let depth: Vec<f64> = seen.depth.iter().zip(alphas()).map(surface).collect();
        let clear =
            depth.iter().zip(&seen.spread).map(|(depth, spread)| depth.is_finite() && spread.abs() <= SPREAD);
        Ok(Self {
            clear: clear.collect(),
            empty: alphas().map(|alpha| alpha <= EMPTY).collect(),
            depth,
            camera,
            wanted,
            near,
        })
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.camera.width_px as usize, self.camera.height_px as usize)
    }

    /// Vector in world coordinates from the eye to the point at planar depth 1 on the ray through the centre of a
    /// pixel.
    pub fn ray(&self, pixel: usize) -> DVec3 {
        let (width, _) = self.size();
        let camera = &self.camera;
        let x = ((pixel % width) as f64 + 0.5 - camera.cx) / camera.fx;
        let y = ((pixel / width) as f64 + 0.5 - camera.cy) / camera.fy;
        camera.world_from_camera().transform_vector3(DVec3::new(x, y, 1.0))
    }

    /// Point in world coordinates at a given planar depth on the ray through the centre of a pixel.
    pub fn point(&self, pixel: usize, depth: f64) -> DVec3 {
        self.camera.eye() + self.ray(pixel) * depth
    }

    /// Index of the pixel that contains a point, given in the frame of the camera. `None` if the point is outside
    /// the picture or the splats have no surface at the pixel.
    pub fn pixel(&self, local: DVec3) -> Option<usize> {
        self.inside(local).filter(|pixel| self.depth[*pixel].is_finite())
    }

    /// True if the picture contains a point, given in world coordinates, and the splats have no surface in front of it.
    pub fn sees(&self, point: DVec3) -> bool {
        let local = self.camera.camera_from_world().transform_point3(point);
        self.inside(local).is_some_and(|pixel| {
            self.empty[pixel] || (self.depth[pixel].is_finite() && local.z < self.depth[pixel])
        })
    }

    /// Index of the pixel that contains a point, given in the frame of the camera. `None` if the point is outside the
    /// picture.
    fn inside(&self, local: DVec3) -> Option<usize> {
        let (width, height) = self.size();
        if local.z <= 0.0 {
            return None;
        }
        let x = self.camera.fx * local.x / local.z + self.camera.cx;
        let y = self.camera.fy * local.y / local.z + self.camera.cy;
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        inside.then(|| y as usize * width + x as usize)
    }

    /// Unit normal of the surface of the splats at a pixel, computed from the depths of its four neighbours; `None`
    /// at edges of the surface.
    pub fn normal(&self, pixel: usize) -> Option<DVec3> {
        let (width, height) = self.size();
        let (x, y) = (pixel % width, pixel / width);
        if x == 0 || y == 0 || x + 1 >= width || y + 1 >= height {
            return None;
        }
        let own = self.depth[pixel];
        let at = |pixel: usize| {
            let depth = self.depth[pixel];
            ((depth - own).abs() <= STEP * own).then(|| self.point(pixel, depth))
        };
        let across = at(pixel + 1)? - at(pixel - 1)?;
        let along = at(pixel + width)? - at(pixel - width)?;
        let normal = across.cross(along);
        let length = normal.length();
        (length > 0.0).then(|| normal / length)
    }
}
