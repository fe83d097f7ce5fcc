//! Peaks: the depths at which splats are densest along the rays of a picture.
//!
//! The depth of the centre of a splat is not the depth of the surface at other pixels: if a floor is seen at a
//! slant, the near half of each of its splats is nearer than the centre. Let `r` be the ray through a pixel, scaled
//! to depth 1. Along `r`, a Gaussian with centre `c` and inverse covariance `A` has its greatest density at the
//! depth `(r.A c) / (r.A r)` (RaDe-GS, arXiv 2406.01467, eq. 10 to 15, which linearizes this depth; PGSR, arXiv
//! 2406.06521, for flat splats). Let `r = r0 + dr`, where `r0` is the ray through the centre, whose depth is `z`.
//! Then the inverse of the depth of greatest density is `(1 + 2 e + q) / (1 + e) / z`, with `e = dr.A r0 / r0.A r0`
//! and `q = dr.A dr / r0.A r0`. For a flat splat, `q = e^2`, and the inverse is a linear function of the position
//! of the pixel.

use glam::DVec3;

use super::camera_model::CameraModel;
use super::shape::axes;

/// Maximum difference in depth between a peak and the centre of its splat, in standard deviations of the splat
/// along the depth axis. If a splat is seen edge-on, peaks at pixels far from its centre may be at any depth.
const HELD_SIGMAS: f64 = 2.0;

/// Minimum standard deviation along an axis, as a share of the longest, so that a flat splat has an inverse
/// covariance.
const THINNEST: f64 = 1e-3;

/// Maximum relative difference between the inverse depth of the peak of a splat and the mean inverse depth of a
/// sheet, for the splat to belong to the sheet. A sheet is a group of consecutive splats along a ray that represent
/// one surface.
pub(super) const SHEET: f64 = 0.02;

/// Minimum transmittance at which a splat of a sheet has full weight in the mean of the sheet. At lower
/// transmittance the weight decreases, since splats behind others belong to the sheet as much as splats in front,
/// but hidden splats do not.
pub(super) const COUNTS_DOWN_TO: f64 = 0.25;

/// Factor on the weight of a splat in the mean of a sheet if `HELD_SIGMAS` limits its peak. Such a peak is not on
/// the surface, but it is used where no other splat is visible.
pub(super) const HELD_COUNTS: f64 = 0.01;

/// Depth of the peak of a splat as a function of the pixel position. The struct fits in one cache line, as does
/// `Footprint`.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Peak {
    /// Reciprocal of the depth of the centre.
    pub inverse: f64,
    /// Change of `e` per pixel to the right.
    pub across: f64,
    /// Change of `e` per pixel down.
    pub down: f64,
    /// First coefficient of `q = xx dx^2 + 2 xy dx dy + yy dy^2`, where `dx` and `dy` are pixels to the right
    /// and down.
    xx: f64,
    xy: f64,
    yy: f64,
    /// Reciprocal of the largest depth to which peaks are clamped.
    pub least: f64,
    /// Reciprocal of the smallest depth to which peaks are clamped.
    pub most: f64,
}

/// Memory for the peak of a splat and its distance from a limiting surface, in bytes.
pub const PEAK_BYTES: u64 = (size_of::<Peak>() + size_of::<f32>()) as u64;

impl Peak {
    /// Placeholder for buffers that are filled later.
    pub(super) const NONE: Self =
        Self { inverse: 0.0, across: 0.0, down: 0.0, xx: 0.0, xy: 0.0, yy: 0.0, least: 0.0, most: 0.0 };

    /// Computes the peaks of a splat whose centre lies at `offset` from the eye, at a depth greater than
    /// `near`.
    pub(super) fn of(
        camera_model: &impl CameraModel,
        offset: DVec3,
        (depth, near): (f64, f64),
        quat: [f32; 4],
        scale: [f32; 3],
    ) -> Self {
        let scale = scale.map(f64::from);
        let longest = scale[0].max(scale[1]).max(scale[2]);
        let turned = axes(quat.map(f64::from), [1.0; 3]);
        let ([across, down], depth_axis) = camera_model.ray_slopes(offset);
        let ray = offset / depth;
        let (mut own, mut e, mut q, mut variance) = (0.0, [0.0; 2], [0.0; 3], 0.0);
        for (axis, sigma) in turned.into_iter().zip(scale) {
            let sigma = sigma.max(THINNEST * longest);
            // Relative to the longest axis, so that tiny splats do not overflow.
            let weight = (longest / sigma) * (longest / sigma);
            let [of_ray, of_across, of_down] = [ray, across, down].map(|v| axis.dot(v));
            own += weight * of_ray * of_ray;
            e[0] += weight * of_ray * of_across;
            e[1] += weight * of_ray * of_down;
            q[0] += weight * of_across * of_across;
            q[1] += weight * of_across * of_down;
            q[2] += weight * of_down * of_down;
            let along = sigma * axis.dot(depth_axis);
            variance += along * along;
        }
        let held = HELD_SIGMAS * variance.sqrt();
        let bounds = Self { inverse: 1.0 / depth, ..Self::NONE };
        let (least, most) = (1.0 / (depth + held), 1.0 / (depth - held).max(near));
        let all = [own, e[0], e[1], q[0], q[1], q[2]];
        // A point has no direction in which it is flat, and overflow gives none either: its centre.
        if !(longest > 0.0 && own > 0.0 && all.iter().all(|v| v.is_finite())) {
            return Self { least: bounds.inverse, most: bounds.inverse, ..bounds };
        }
        Self {
            across: e[0] / own,
            down: e[1] / own,
            xx: q[0] / own,
            xy: q[1] / own,
            yy: q[2] / own,
            least,
            most,
            ..bounds
        }
    }

    /// Reciprocal of the depth of the peak along the ray of a pixel, without linearization. `dx` and `dy` are the
    /// offset of the pixel from the centre.
    pub(super) fn inverse_at(&self, dx: f64, dy: f64) -> f64 {
        let e = self.across * dx + self.down * dy;
        let q = self.xx * dx * dx + 2.0 * self.xy * dx * dy + self.yy * dy * dy;
        // At or beyond the ray along which it peaks at infinity.
        if e <= -1.0 {
            return self.least;
        }
        (self.inverse * (1.0 + 2.0 * e + q) / (1.0 + e)).max(self.least).min(self.most)
    }

    /// Same as [`Self::inverse_at`], but the reciprocal of the largest depth where the peak is clamped: the splat
    /// is nowhere behind it, so it is in front of every surface beyond.
    pub(super) fn last_inverse_at(&self, dx: f64, dy: f64) -> f64 {
        let inverse = self.inverse_at(dx, dy);
        if inverse >= self.most { self.least } else { inverse }
    }
}
