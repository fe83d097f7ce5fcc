//! Shapes of splats in the picture, computed in batches. The values of a batch are in arrays, and there is a single
//! loop over the arrays without branches, so that the compiler vectorises it. Every lane does the same IEEE
//! operations for any number of lanes, so the result for a splat has the same bits in any batch.

use glam::DVec3;

use super::camera_model::{CameraModel, ProjectedCentre};

/// Number of splats per batch.
pub(super) const BATCH: usize = 64;

/// One number per splat.
type Lanes = [f64; BATCH];

/// Splats that are projected together. If there are fewer than [`BATCH`], the remaining lanes keep old values.
pub(super) struct Batch {
    /// Vector from the eye to the centre, in world units.
    offset: [Lanes; 3],
    /// Rotation as a unit quaternion (w, x, y, z).
    quat: [Lanes; 4],
    /// Standard deviations along the axes, in world units.
    scale: [Lanes; 3],
    /// Horizontal position of the centre on the picture, in pixels.
    u: Lanes,
    /// Vertical position of the centre on the picture, in pixels.
    v: Lanes,
    /// Depth of the centre, in world units.
    depth: Lanes,
    /// Horizontal variance with the low-pass filter, in square pixels.
    xx: Lanes,
    /// Vertical variance with the low-pass filter, in square pixels.
    yy: Lanes,
    /// Determinant of the covariance with the low-pass filter.
    det: Lanes,
    /// Determinant of the covariance without the low-pass filter.
    raw_det: Lanes,
    root_xx: Lanes,
    root_yy: Lanes,
    /// First element of the Cholesky factor of the inverse covariance; see [`super::project::Footprint`].
    l11: Lanes,
    l21: Lanes,
    l22: Lanes,
}

/// The shape of one splat.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub offset: DVec3,
    pub u: f64,
    pub v: f64,
    pub depth: f64,
    pub xx: f64,
    pub yy: f64,
    pub det: f64,
    pub raw_det: f64,
    pub root_xx: f64,
    pub root_yy: f64,
    pub l11: f64,
    pub l21: f64,
    pub l22: f64,
}

/// Returns the numbers of a lane.
#[inline(always)]
fn at<const N: usize>(lanes: &[Lanes; N], lane: usize) -> [f64; N] {
    std::array::from_fn(|k| lanes[k][lane])
}

/// The principal axes of a splat. The length of each axis is the standard deviation along it.
#[inline(always)]
pub(super) fn axes([w, x, y, z]: [f64; 4], scale: [f64; 3]) -> [DVec3; 3] {
    [
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)) * scale[0],
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)) * scale[1],
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)) * scale[2],
    ]
}

impl Batch {
    pub(super) fn new() -> Self {
        const ZERO: Lanes = [0.0; BATCH];
        Self {
            offset: [ZERO; 3],
            quat: [ZERO; 4],
            scale: [ZERO; 3],
            u: ZERO,
            v: ZERO,
            depth: ZERO,
            xx: ZERO,
            yy: ZERO,
            det: ZERO,
            raw_det: ZERO,
            root_xx: ZERO,
            root_yy: ZERO,
            l11: ZERO,
            l21: ZERO,
            l22: ZERO,
        }
    }

    /// Sets the vector from the eye to the centre, the rotation and the standard deviations of a lane.
    #[inline(always)]
    pub(super) fn set(&mut self, lane: usize, offset: DVec3, quat: [f32; 4], scale: [f32; 3]) {
        for (to, value) in self.offset.iter_mut().zip(offset.to_array()) {
            to[lane] = value;
        }
        for (to, value) in self.quat.iter_mut().zip(quat) {
            to[lane] = f64::from(value);
        }
        for (to, value) in self.scale.iter_mut().zip(scale) {
            to[lane] = f64::from(value);
        }
    }

    /// Projects all lanes, with a low-pass filter of this variance in square pixels.
    #[inline(always)]
    pub(super) fn project(&mut self, camera_model: &impl CameraModel, low_pass: f64) {
        // Exponents are to base 2: half of log2(e) is part of the factor.
        let to_base_2 = (0.5 * std::f64::consts::LOG2_E).sqrt();
        for i in 0..BATCH {
            let ProjectedCentre { u, v, row_x, row_y, depth } =
                camera_model.project_centre(DVec3::from(at(&self.offset, i)));
            let axes = axes(at(&self.quat, i), at(&self.scale, i));
            let p = DVec3::new(row_x.dot(axes[0]), row_x.dot(axes[1]), row_x.dot(axes[2]));
            let q = DVec3::new(row_y.dot(axes[0]), row_y.dot(axes[1]), row_y.dot(axes[2]));
            let (raw_xx, xy, raw_yy) = (p.dot(p), p.dot(q), q.dot(q));
            let (xx, yy) = (raw_xx + low_pass, raw_yy + low_pass);
            // By Lagrange's identity, so that the determinant of a needle does not cancel.
            let raw_det = p.cross(q).length_squared();
            let det = raw_det + low_pass * (raw_xx + raw_yy) + low_pass * low_pass;
            let (root_det, root_yy) = (det.sqrt(), yy.sqrt());
            (self.u[i], self.v[i], self.depth[i]) = (u, v, depth);
            (self.xx[i], self.yy[i], self.det[i], self.raw_det[i]) = (xx, yy, det, raw_det);
            (self.root_xx[i], self.root_yy[i]) = (xx.sqrt(), root_yy);
            self.l11[i] = to_base_2 * root_yy / root_det;
            self.l21[i] = -to_base_2 * xy / (root_yy * root_det);
            self.l22[i] = to_base_2 / root_yy;
        }
    }

    /// The shape in a lane.
    #[inline(always)]
    pub(super) fn get(&self, lane: usize) -> Shape {
        Shape {
            offset: DVec3::from(at(&self.offset, lane)),
            u: self.u[lane],
            v: self.v[lane],
            depth: self.depth[lane],
            xx: self.xx[lane],
            yy: self.yy[lane],
            det: self.det[lane],
            raw_det: self.raw_det[lane],
            root_xx: self.root_xx[lane],
            root_yy: self.root_yy[lane],
            l11: self.l11[lane],
            l21: self.l21[lane],
            l22: self.l22[lane],
        }
    }
}
