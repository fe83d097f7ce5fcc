//! Camera models: projection of the world to a picture, and the tiles that a footprint touches.

use std::f64::consts::PI;
use std::ops::Range;

use engine::Up;
use glam::DVec3;
use scene::math::{equirect, num};
use scene::types::Camera;

use super::block::Block;
use super::settings::TILE;

/// Distance beyond the edges of the image, as a fraction of half the size of the image, up to which the derivative
/// of the projection is evaluated at the centre of the splat. For splats farther out it is evaluated at this
/// distance, because the linear approximation diverges (INRIA forward.cu: 1.3 times the tangent).
pub(super) const GUARD: f64 = 0.3;

/// Margin, in pixels, that is added to bounds, so that no pixel whose alpha reaches `alpha_cut` is lost to
/// rounding.
pub(super) const SLACK_PX: f64 = 0.01;

/// Minimum distance from the axis through the poles at which the derivative of a panorama is evaluated, as a
/// fraction of the distance from the eye. The derivative is infinite at a pole (splat-transform #247 has the same
/// limit).
const POLE: f64 = 0.005;

/// Half-open range of the tiles of a footprint. In a panorama `x1` may exceed the number of columns. The excess
/// columns wrap around, and no tile occurs twice.
#[derive(Debug, Clone, Copy)]
pub(super) struct TileRange {
    pub x0: u16,
    pub x1: u16,
    pub y0: u16,
    pub y1: u16,
}

/// Centre of a splat in the picture.
pub(super) struct ProjectedCentre {
    /// Horizontal position, in pixels.
    pub u: f64,
    /// Vertical position, in pixels.
    pub v: f64,
    /// Derivative of `u` with respect to world coordinates.
    pub row_x: DVec3,
    /// Derivative of `v` with respect to world coordinates.
    pub row_y: DVec3,
    /// Depth in world units: planar depth, or distance for a panorama.
    pub depth: f64,
}

/// Projection of the world to a picture.
pub(super) trait CameraModel: Sync {
    /// Position of the camera, in world units.
    fn eye(&self) -> DVec3;
    /// Columns and rows, in pixels.
    fn size(&self) -> (usize, usize);
    /// Number of pixel columns after which the picture repeats; `None` if it does not repeat.
    fn period(&self) -> Option<u32>;
    /// True if the depth of a point at `d` from the eye is at most `near`.
    fn is_behind(&self, d: DVec3, near: f64) -> bool;
    /// True if a splat at `d` cannot be visible in the picture. The splat must be beyond the near plane, and must
    /// extend over at most `world` world units plus `pixels` pixels.
    fn is_aside(&self, d: DVec3, world: f64, pixels: f64) -> bool;
    /// Projects a point at `d` for which `is_behind` and `is_aside` are false.
    fn project_centre(&self, d: DVec3) -> ProjectedCentre;
    /// Derivatives of the ray through a point at `d`, scaled to depth 1, with respect to pixels to the right
    /// and down, and the direction in which depth increases.
    fn ray_slopes(&self, d: DVec3) -> ([DVec3; 2], DVec3);
    /// True if `is_behind` or `is_aside` holds for every splat of the block. Each splat is assumed to extend over
    /// at most `sigmas` times its longest axis plus `pixels` pixels.
    fn misses(&self, block: &Block, near: f64, sigmas: f64, pixels: f64) -> bool;
    /// Tiles with a pixel centre inside a box or on its edge. The box is centred at `(u, v)` and extends by
    /// `half_x` and `half_y` to each side, in pixels.
    fn exact_reach(&self, u: f64, v: f64, half_x: f64, half_y: f64) -> Option<TileRange>;
    /// Tiles that the INRIA rasterizer assigns to a splat with this covariance and determinant. They are the tiles
    /// that overlap a square around the centre, which extends 3 standard deviations of the longer axis to each side
    /// (auxiliary.h, `getRect`; forward.cu, `preprocessCUDA`).
    fn inria_reach(&self, u: f64, v: f64, xx: f64, yy: f64, det: f64) -> Option<TileRange>;
    /// All tiles.
    fn everywhere(&self) -> TileRange;
}

/// Smallest integer not below `x`, clamped to the range of i32. `f64::ceil` would be a function call without
/// SSE4.1, which the portable build cannot assume.
#[inline(always)]
fn ceil(x: f64) -> i32 {
    let x = x.clamp(-1e9, 1e9);
    let whole = x as i32;
    whole + i32::from(f64::from(whole) < x)
}

/// First and last pixel whose centre lies in an interval.
#[inline(always)]
fn pixels(left: f64, right: f64) -> (i32, i32) {
    (ceil(left - 0.5), ceil(right + 0.5) - 2)
}

/// Range of tiles with a pixel centre in an interval, in a row of `size` pixels.
#[inline(always)]
fn tiles(left: f64, right: f64, size: f64) -> Option<(u16, u16)> {
    let (first, last) = pixels(left, right);
    let (first, last) = (first.max(0), last.min(size as i32 - 1));
    (first <= last).then(|| ((first as usize / TILE) as u16, (last as usize / TILE) as u16 + 1))
}

/// Same as [`tiles`] for a picture that repeats after `period` pixels. The end may exceed the number of columns, as
/// described for [`TileRange`].
#[inline(always)]
fn tiles_around(left: f64, right: f64, period: u32) -> Option<(u16, u16)> {
    let (first, last) = pixels(left, right);
    let (period, columns) = (period as i32, (period as usize).div_ceil(TILE) as u16);
    if first > last {
        return None;
    }
    if last - first + 1 >= period {
        return Some((0, columns));
    }
    let tile = |pixel: i32| (pixel.rem_euclid(period) as usize / TILE) as u16;
    let (x0, x1) = (tile(first), tile(last) + 1);
    let wraps = first.rem_euclid(period) > last.rem_euclid(period);
    Some((x0, if wraps { (columns + x1).min(x0 + columns) } else { x1 }))
}

/// Range of tiles with a pixel centre in an interval. Without a `period`, the range is limited to `span`; with a
/// `period`, it wraps around. It is empty if there are no such tiles.
pub(super) fn columns(left: f64, right: f64, span: (u16, u16), period: Option<u32>) -> (u16, u16) {
    let found = match period {
        None => tiles(left, right, (usize::from(span.1) * TILE) as f64).map(|(a, b)| (a.max(span.0), b)),
        Some(period) => tiles_around(left, right, period),
    };
    found.filter(|(first, end)| first < end).unwrap_or((span.0, span.0))
}

/// Same as [`CameraModel::ray_slopes`] for cameras whose depth is the distance. The derivatives are steps on the
/// sphere through `d` that move the projection by one pixel.
fn ray_slopes_by_distance(d: DVec3, centre: &ProjectedCentre) -> ([DVec3; 2], DVec3) {
    let (distance, row_x, row_y) = (d.length(), centre.row_x, centre.row_y);
    let outwards = d / distance;
    let across = row_y.cross(outwards);
    let scale = 1.0 / (row_x.dot(across) * distance);
    ([across * scale, outwards.cross(row_x) * scale], outwards)
}

/// A pinhole camera.
pub(super) struct Pinhole {
    eye: DVec3,
    pub(super) right: DVec3,
    pub(super) down: DVec3,
    pub(super) forward: DVec3,
    pub(super) fx: f64,
    pub(super) fy: f64,
    cx: f64,
    cy: f64,
    width: f64,
    height: f64,
    /// Range of slopes x/z to which the derivative of the projection is clamped.
    pub(super) slope_x: [f64; 2],
    /// Range of slopes y/z to which the derivative of the projection is clamped.
    pub(super) slope_y: [f64; 2],
    /// Largest number of pixels per world unit at a depth of 1.
    steepest: f64,
    columns: u16,
    rows: u16,
    /// True if the picture is part of a panorama. Then `near` and depths are distances from the eye, and splats too
    /// far from the viewing direction are left out (see [`ASIDE`]).
    by_distance: bool,
}

/// Cosine of the maximum angle between the viewing direction of a cap and the direction of a splat that is drawn.
/// The limit is needed because the near plane does not apply to caps, and the projection diverges near the plane of
/// the camera.
const ASIDE: f64 = 0.1;

impl Pinhole {
    /// Creates a camera for a part of a panorama.
    pub(super) fn by_distance(camera: &Camera) -> Self {
        Self { by_distance: true, ..Self::new(camera) }
    }

    pub(super) fn new(camera: &Camera) -> Self {
        let m = camera.world_from_camera();
        let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
        let (guard_x, guard_y) = (GUARD * 0.5 * width / camera.fx, GUARD * 0.5 * height / camera.fy);
        let slope_x = [-camera.cx / camera.fx - guard_x, (width - camera.cx) / camera.fx + guard_x];
        let slope_y = [-camera.cy / camera.fy - guard_y, (height - camera.cy) / camera.fy + guard_y];
        let squared = |f: f64, [low, high]: [f64; 2]| f * f * (1.0 + (low * low).max(high * high));
        Self {
            eye: camera.eye(),
            right: m.x_axis.truncate(),
            down: m.y_axis.truncate(),
            forward: m.z_axis.truncate(),
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            width,
            height,
            slope_x,
            slope_y,
            steepest: (squared(camera.fx, slope_x) + squared(camera.fy, slope_y)).sqrt(),
            columns: (camera.width_px as usize).div_ceil(TILE) as u16,
            rows: (camera.height_px as usize).div_ceil(TILE) as u16,
            by_distance: false,
        }
    }
}

impl CameraModel for Pinhole {
    fn eye(&self) -> DVec3 {
        self.eye
    }

    fn size(&self) -> (usize, usize) {
        (self.width as usize, self.height as usize)
    }

    fn period(&self) -> Option<u32> {
        None
    }

    #[inline(always)]
    fn is_behind(&self, d: DVec3, near: f64) -> bool {
        let z = self.forward.dot(d);
        if self.by_distance {
            let distance = d.length();
            return (distance <= near) | (z <= ASIDE * distance);
        }
        z <= near
    }

    /// Returns true if a splat lies outside one of the four edges of the picture. The comparisons are in
    /// coordinates multiplied by z, so that most splats outside the picture need no division. There are no
    /// branches, so the compiler can vectorise the test over several splats.
    #[inline(always)]
    fn is_aside(&self, d: DVec3, world: f64, pixels: f64) -> bool {
        let (x, y, z) = (self.right.dot(d), self.down.dot(d), self.forward.dot(d));
        let spread = world * self.steepest + pixels * z;
        let (from_left, from_top) = (self.fx * x + self.cx * z, self.fy * y + self.cy * z);
        (from_left < -spread)
            | (from_top < -spread)
            | (from_left - self.width * z > spread)
            | (from_top - self.height * z > spread)
    }

    #[inline(always)]
    fn project_centre(&self, d: DVec3) -> ProjectedCentre {
        let (x, y, z) = (self.right.dot(d), self.down.dot(d), self.forward.dot(d));
        let inverse_z = 1.0 / z;
        let (slope_x, slope_y) = (x * inverse_z, y * inverse_z);
        // Not `clamp`, whose check of its bounds prevents vectorised code.
        let held_x = slope_x.max(self.slope_x[0]).min(self.slope_x[1]);
        let held_y = slope_y.max(self.slope_y[0]).min(self.slope_y[1]);
        ProjectedCentre {
            u: self.fx * slope_x + self.cx,
            v: self.fy * slope_y + self.cy,
            // Rows of the derivative of (u, v) by world coordinates, eq. 26 of the EWA paper.
            row_x: (self.right - self.forward * held_x) * (self.fx * inverse_z),
            row_y: (self.down - self.forward * held_y) * (self.fy * inverse_z),
            depth: if self.by_distance { d.length() } else { z },
        }
    }

    fn ray_slopes(&self, d: DVec3) -> ([DVec3; 2], DVec3) {
        if self.by_distance {
            return ray_slopes_by_distance(d, &self.project_centre(d));
        }
        ([self.right / self.fx, self.down / self.fy], self.forward)
    }

    /// Tests the corners of the box of a block. The tests of one splat are linear in its centre, so their maximum
    /// over a box is at a corner.
    #[inline(always)]
    fn misses(&self, block: &Block, near: f64, sigmas: f64, pixels: f64) -> bool {
        // If depth is distance, points behind the plane of the camera count as behind at any distance.
        let nearest = if self.by_distance { 0.0 } else { near };
        if block.most(self.forward, -nearest) < 0.0 {
            return true;
        }
        let world = sigmas * block.longest * self.steepest;
        let (x, y, z) = (self.right * self.fx, self.down * self.fy, self.forward);
        [x + z * (self.cx + pixels), y + z * (self.cy + pixels)]
            .into_iter()
            .chain([z * (self.width - self.cx + pixels) - x, z * (self.height - self.cy + pixels) - y])
            .any(|inwards| block.most(inwards, world) < 0.0)
    }

    #[inline(always)]
    fn exact_reach(&self, u: f64, v: f64, half_x: f64, half_y: f64) -> Option<TileRange> {
        let (half_x, half_y) = (half_x + SLACK_PX, half_y + SLACK_PX);
        let (x0, x1) = tiles(u - half_x, u + half_x, self.width)?;
        let (y0, y1) = tiles(v - half_y, v + half_y, self.height)?;
        Some(TileRange { x0, x1, y0, y1 })
    }

    fn inria_reach(&self, u: f64, v: f64, xx: f64, yy: f64, det: f64) -> Option<TileRange> {
        let middle = 0.5 * (xx + yy);
        let radius = (3.0 * (middle + (middle * middle - det).max(0.1).sqrt()).sqrt()).ceil();
        let tile = TILE as f64;
        // In the INRIA rasterizer, pixel centres are integers; here they are half a pixel farther.
        let tiles = |centre: f64, count: u16| {
            let clamp = |t: f64| t.clamp(0.0, f64::from(count)) as u16;
            let (first, end) =
                (clamp((centre - 0.5 - radius) / tile), clamp((centre - 0.5 + radius + tile - 1.0) / tile));
            (first < end).then_some((first, end))
        };
        let (x0, x1) = tiles(u, self.columns)?;
        let (y0, y1) = tiles(v, self.rows)?;
        Some(TileRange { x0, x1, y0, y1 })
    }

    fn everywhere(&self) -> TileRange {
        TileRange { x0: 0, x1: self.columns, y0: 0, y1: self.rows }
    }
}

/// Camera model for some rows of a panorama in the layout of [`scene::math::equirect`].
pub(super) struct Sphere {
    eye: DVec3,
    right: DVec3,
    forward: DVec3,
    above: DVec3,
    width: u32,
    rows: Range<u32>,
}

impl Sphere {
    /// Creates the camera model for the given rows of the layout.
    pub(super) fn new(eye: DVec3, up: Up, width_px: u32, rows: Range<u32>) -> Self {
        let [right, forward, above] = equirect::axes(up);
        Self { eye, right, forward, above, width: width_px, rows }
    }

    fn height(&self) -> u32 {
        self.rows.end - self.rows.start
    }
}

impl CameraModel for Sphere {
    fn eye(&self) -> DVec3 {
        self.eye
    }

    fn size(&self) -> (usize, usize) {
        (self.width as usize, self.height() as usize)
    }

    fn period(&self) -> Option<u32> {
        Some(self.width)
    }

    #[inline(always)]
    fn is_behind(&self, d: DVec3, near: f64) -> bool {
        d.length() <= near
    }

    /// Always false, because a panorama covers all directions.
    #[inline(always)]
    fn is_aside(&self, _d: DVec3, _world: f64, _pixels: f64) -> bool {
        false
    }

    /// Projects a centre. With x, y and z along right, forward and up, the angle from forward is atan2(x, y) and
    /// the angle from up is atan2(rho, z), where rho is the distance from the axis. The derivative of each angle is
    /// the unit vector along which the angle increases, divided by rho for the first angle and by the distance for
    /// the second. Depth is the distance from the eye.
    #[inline(always)]
    fn project_centre(&self, d: DVec3) -> ProjectedCentre {
        let (x, y, z) = (self.right.dot(d), self.forward.dot(d), self.above.dot(d));
        let rho = (x * x + y * y).sqrt();
        let distance = (rho * rho + z * z).sqrt();
        let per_radian = f64::from(self.width) / (2.0 * PI);
        let (sin, cos) = if rho > 0.0 { (x / rho, y / rho) } else { (0.0, 1.0) };
        let outwards = self.right * sin + self.forward * cos;
        let along = self.right * cos - self.forward * sin;
        let downwards = (outwards * z - self.above * rho) / distance;
        let u = (num::atan2(x, y) + PI) * per_radian;
        ProjectedCentre {
            u: if u >= f64::from(self.width) { 0.0 } else { u },
            v: num::atan2(rho, z) * per_radian - f64::from(self.rows.start),
            row_x: along * (per_radian / rho.max(POLE * distance)),
            row_y: downwards * (per_radian / distance),
            depth: distance,
        }
    }

    fn ray_slopes(&self, d: DVec3) -> ([DVec3; 2], DVec3) {
        ray_slopes_by_distance(d, &self.project_centre(d))
    }

    /// Always false, because a panorama covers all directions.
    #[inline(always)]
    fn misses(&self, _block: &Block, _near: f64, _sigmas: f64, _pixels: f64) -> bool {
        false
    }

    #[inline(always)]
    fn exact_reach(&self, u: f64, v: f64, half_x: f64, half_y: f64) -> Option<TileRange> {
        let (half_x, half_y) = (half_x + SLACK_PX, half_y + SLACK_PX);
        let (x0, x1) = tiles_around(u - half_x, u + half_x, self.width)?;
        let (y0, y1) = tiles(v - half_y, v + half_y, f64::from(self.height()))?;
        Some(TileRange { x0, x1, y0, y1 })
    }

    /// Tiles that overlap the same square as for a pinhole camera, clamped at the poles and wrapped around
    /// horizontally. The INRIA rasterizer itself does not render panoramas.
    fn inria_reach(&self, u: f64, v: f64, xx: f64, yy: f64, det: f64) -> Option<TileRange> {
        let middle = 0.5 * (xx + yy);
        let radius = (3.0 * (middle + (middle * middle - det).max(0.1).sqrt()).sqrt()).ceil();
        self.exact_reach(u, v, radius, radius)
    }

    fn everywhere(&self) -> TileRange {
        let columns = (self.width as usize).div_ceil(TILE) as u16;
        TileRange { x0: 0, x1: columns, y0: 0, y1: (self.height() as usize).div_ceil(TILE) as u16 }
    }
}
