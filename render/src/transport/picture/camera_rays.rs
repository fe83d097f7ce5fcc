//! Camera rays.

use std::sync::{Arc, OnceLock};

use glam::{DVec2, DVec3, Vec3};
use scene::types::{Camera, Lens};
use serde::Serialize;

use super::silhouette::Silhouette;
use super::splat_rays::SplatRays;
use crate::geometry::bvh::Ray;
use crate::geometry::sampling::{Points, hash, stream};
use crate::transport::path::guide::Guide;
use crate::transport::scene::frame::in_scene_frame;
use crate::transport::scene::objects::Objects;
use crate::transport::scene::supports::Ground;

/// Parameters of a camera without its name, which has no effect on pixels.
#[derive(Serialize)]
pub(crate) struct CameraParams<'a> {
    size: (u32, u32),
    intrinsics: [f64; 4],
    #[serde(skip_serializing_if = "Lens::is_pinhole")]
    lens: &'a Lens,
    world_from_camera: &'a [f64; 16],
}

impl<'a> CameraParams<'a> {
    pub(crate) fn of(camera: &'a Camera) -> Self {
        Self {
            size: (camera.width_px, camera.height_px),
            intrinsics: [camera.fx, camera.fy, camera.cx, camera.cy],
            lens: &camera.lens,
            world_from_camera: &camera.world_from_camera,
        }
    }
}

/// Rays of a camera.
pub struct CameraRays<'a> {
    /// The camera.
    pub camera: &'a Camera,
    pub(crate) eye: Vec3,
    /// Directions to the right, down and forward of the camera, in world coordinates.
    pub axes: [DVec3; 3],
    /// Growth of the footprint per unit of distance: a quarter of the pixel width, since the samples of a
    /// pixel resolve narrower detail.
    pub(crate) spread: f32,
    pub(crate) seed: u64,
    pub(crate) ground: &'a Ground,
    /// Guide of the light samples of the receiver.
    guide: Arc<Option<Guide>>,
    /// Rays to splats in place of those of the camera, one per pixel.
    splats: Option<&'a SplatRays>,
    /// Side, in pixels, of the square blocks into which the image is divided. One pixel of each block is traced.
    coarse_px: u32,
    /// Silhouette of the objects, computed on first use.
    silhouette: OnceLock<Silhouette>,
}

impl<'a> CameraRays<'a> {
    /// Rays from a camera in a frame whose origin is at `origin` in the world.
    pub fn new(camera: &'a Camera, origin: DVec3, seed: u64, ground: &'a Ground, coarse_px: u32) -> Self {
        let pose = camera.world_from_camera();
        let axes = [pose.x_axis, pose.y_axis, pose.z_axis].map(|axis| axis.truncate());
        let spread = (0.25 / (camera.fx * camera.fy).abs().sqrt()) as f32;
        Self {
            camera,
            eye: in_scene_frame(camera.eye(), origin),
            axes,
            spread,
            seed,
            ground,
            guide: Arc::new(None),
            splats: None,
            coarse_px,
            silhouette: OnceLock::new(),
        }
    }

    /// Chooses the light samples of the receiver by a guide.
    pub fn guided(self, guide: Arc<Option<Guide>>) -> Self {
        Self { guide, ..self }
    }

    /// Replaces the rays of the camera, whose image must have the size of that of `splats`.
    pub(crate) fn with_splats(self, splats: Option<&'a SplatRays>) -> Self {
        Self { splats, ..self }
    }

    /// Guide of the light samples of the receiver.
    pub(crate) fn guide(&self) -> Option<&Guide> {
        Option::as_ref(&self.guide)
    }

    /// Rays through `count` positions that are spread over the image. They do not depend on the seed.
    pub fn spread_over_image(&self, count: u32) -> impl Iterator<Item = Ray> + '_ {
        let size = [self.camera.width_px, self.camera.height_px].map(f64::from);
        (0..count).map(move |number| {
            let [x, y] = Points::new(0, number).pair(0).map(f64::from);
            self.through(x * size[0], y * size[1])
        })
    }

    /// Pixel that represents a block: the pixel at the centre of the block, or, if this is outside the image, the
    /// nearest pixel of the image.
    pub(crate) fn pixel(&self, (x, y): (u32, u32)) -> (u32, u32) {
        let middle = |block: u32, size: u32| (block * self.coarse_px + self.coarse_px / 2).min(size - 1);
        (middle(x, self.camera.width_px), middle(y, self.camera.height_px))
    }

    /// Ray through a position in the image.
    pub fn through(&self, x: f64, y: f64) -> Ray {
        if let Some(splats) = self.splats {
            return splats.of((x as u32, y as u32));
        }
        let Camera { fx, fy, cx, cy, lens, .. } = self.camera;
        let [right, down, forward] = self.axes;
        let slope = lens.undistort(DVec2::new((x - cx) / fx, (y - cy) / fy));
        let direction = right * slope.x + down * slope.y + forward;
        Ray::new(self.eye, direction.normalize().as_vec3())
    }

    /// True if objects are visible to the camera and a ray through the pixel that represents a block may hit one of
    /// them. All calls must pass the same objects.
    #[inline]
    pub fn may_show(&self, objects: &Objects, block: (u32, u32)) -> bool {
        let whole = || Silhouette::of(objects, self.camera, self.eye, self.axes);
        objects.shown && self.splats.is_none() && self.silhouette.get_or_init(whole).holds(self.pixel(block))
    }

    /// Random points, hash key and camera ray of one sample of the pixel that represents `block`. The position of
    /// the sample is uniform over the pixel (box filter).
    pub fn sample(&self, block: (u32, u32), sample: u32) -> (Points, u32, Ray) {
        let (x, y) = self.pixel(block);
        let stream = stream(self.seed, x, y);
        let points = Points::new(stream, sample);
        let [dx, dy] = points.pair(0);
        let ray = self.through(f64::from(x) + f64::from(dx), f64::from(y) + f64::from(dy));
        (points, hash(stream, sample), ray)
    }
}
