//! Projection of splats through a lens with distortion.

use glam::{DMat2, DVec2, DVec3};
use scene::types::{Camera, Lens};

use super::block::Block;
use super::camera_model::{CameraModel, GUARD, Pinhole, ProjectedCentre, TileRange};

/// Number of intervals along the width and the height of the picture at whose ends the lens is sampled for bounds.
const GRID: u32 = 32;
/// Factor on the largest derivative of the projection at these samples, since it may be larger between them.
const BETWEEN: f64 = 1.1;

/// A camera with lens distortion. Centres are projected exactly; around its centre, a splat is projected by the
/// derivative, as in a pinhole camera.
pub(super) struct Distorted {
    /// The same camera without distortion.
    pinhole: Pinhole,
    lens: Lens,
    focal: DVec2,
    middle: DVec2,
    size: DVec2,
    /// Least and largest slopes to which the derivative of the projection is clamped.
    held: [DVec2; 2],
    /// Square of the largest slope that is shown.
    limit_squared: f64,
    /// Largest number of pixels per world unit at a depth of 1.
    steepest: f64,
}

impl Distorted {
    pub(super) fn new(camera: &Camera) -> Self {
        let lens = camera.lens;
        let (focal, middle) = (DVec2::new(camera.fx, camera.fy), DVec2::new(camera.cx, camera.cy));
        let size = DVec2::new(f64::from(camera.width_px), f64::from(camera.height_px));
        let samples = || {
            let along = |k: u32| f64::from(k) / f64::from(GRID);
            (0..=GRID).flat_map(move |i| (0..=GRID).map(move |j| DVec2::new(along(i), along(j))))
        };
        let shown = samples().map(|at| lens.undistort((at * size - middle) / focal));
        let (low, high) = shown.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), slope| {
            (low.min(slope), high.max(slope))
        });
        let guard = 0.5 * GUARD * (high - low);
        let held = [low - guard, high + guard];
        let steepest = samples().map(|at| {
            let slope = (held[0] + (held[1] - held[0]) * at).clamp_length_max(lens.limit());
            let rows = DMat2::from_diagonal(focal) * lens.derivative(slope);
            // The squared length of r * right + s * down - (r * x + s * y) * forward.
            let square = |row: DVec2| row.length_squared() + row.dot(slope) * row.dot(slope);
            square(rows.row(0)) + square(rows.row(1))
        });
        Self {
            pinhole: Pinhole::new(camera),
            lens,
            focal,
            middle,
            size,
            held,
            limit_squared: lens.limit() * lens.limit(),
            steepest: BETWEEN * steepest.fold(0.0, f64::max).sqrt(),
        }
    }

    /// Coordinates of a point at `d` from the eye in the frame of the camera.
    #[inline(always)]
    fn local(&self, d: DVec3) -> DVec3 {
        DVec3::new(self.pinhole.right.dot(d), self.pinhole.down.dot(d), self.pinhole.forward.dot(d))
    }

    #[inline(always)]
    fn shown(&self, slope: DVec2) -> DVec2 {
        self.lens.distort(slope) * self.focal + self.middle
    }
}

impl CameraModel for Distorted {
    fn eye(&self) -> DVec3 {
        self.pinhole.eye()
    }

    fn size(&self) -> (usize, usize) {
        self.pinhole.size()
    }

    fn period(&self) -> Option<u32> {
        None
    }

    /// Also true beyond the limit of the lens, where the formulas fold the picture over.
    #[inline(always)]
    fn is_behind(&self, d: DVec3, near: f64) -> bool {
        let at = self.local(d);
        (at.z <= near) | (at.truncate().length_squared() > self.limit_squared * at.z * at.z)
    }

    #[inline(always)]
    fn is_aside(&self, d: DVec3, world: f64, pixels: f64) -> bool {
        let at = self.local(d);
        let spread = DVec2::splat(world * self.steepest / at.z + pixels);
        let shown = self.shown(at.truncate() / at.z);
        shown.cmplt(-spread).any() | shown.cmpgt(self.size + spread).any()
    }

    fn project_centre(&self, d: DVec3) -> ProjectedCentre {
        let Pinhole { right, down, forward, .. } = self.pinhole;
        let at = self.local(d);
        let slope = at.truncate() / at.z;
        let shown = self.shown(slope);
        let held = slope.max(self.held[0]).min(self.held[1]).clamp_length_max(self.lens.limit());
        let rows = DMat2::from_diagonal(self.focal / at.z) * self.lens.derivative(held);
        let (along_x, along_y) = (right - forward * held.x, down - forward * held.y);
        let row = |row: DVec2| along_x * row.x + along_y * row.y;
        ProjectedCentre {
            u: shown.x,
            v: shown.y,
            row_x: row(rows.row(0)),
            row_y: row(rows.row(1)),
            depth: at.z,
        }
    }

    fn ray_slopes(&self, d: DVec3) -> ([DVec3; 2], DVec3) {
        let Pinhole { right, down, forward, .. } = self.pinhole;
        let at = self.local(d);
        let slope = (at.truncate() / at.z).clamp_length_max(self.lens.limit());
        let by_pixel = (DMat2::from_diagonal(self.focal) * self.lens.derivative(slope)).inverse();
        let step = |by: DVec2| right * by.x + down * by.y;
        ([step(by_pixel.x_axis), step(by_pixel.y_axis)], forward)
    }

    /// Tests the plane of the camera only. The other sides of the picture are curved.
    #[inline(always)]
    fn misses(&self, block: &Block, near: f64, _sigmas: f64, _pixels: f64) -> bool {
        block.most(self.pinhole.forward, -near) < 0.0
    }

    #[inline(always)]
    fn exact_reach(&self, u: f64, v: f64, half_x: f64, half_y: f64) -> Option<TileRange> {
        self.pinhole.exact_reach(u, v, half_x, half_y)
    }

    fn inria_reach(&self, u: f64, v: f64, xx: f64, yy: f64, det: f64) -> Option<TileRange> {
        self.pinhole.inria_reach(u, v, xx, yy, det)
    }

    fn everywhere(&self) -> TileRange {
        self.pinhole.everywhere()
    }
}
