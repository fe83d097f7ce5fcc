//! Gradients of splats from gradients of their footprints: the chain rule through the projection, in f64.

use std::f64::consts::{LN_2, LOG2_E};

use glam::DVec3;
use scene::types::Camera;

use super::super::camera_model::Pinhole;
use super::super::settings::Settings;
use super::super::sh;
use super::super::shape::axes;
use super::row::Row;

/// Parameters of a splat, as the renderer reads them.
#[derive(Debug, Clone, Copy)]
pub struct SplatValues<'a> {
    /// Centre, in world units.
    pub mean: DVec3,
    /// Unit quaternion (w, x, y, z).
    pub quat: [f64; 4],
    /// Standard deviations along the axes, in world units.
    pub scale: [f64; 3],
    /// Opacity, above 0 and at most 1.
    pub opacity: f64,
    /// Spherical harmonics coefficients.
    pub sh: &'a [[f32; 3]],
}

/// Gradient of a loss with respect to the parameters of a splat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SplatGradient {
    /// Derivatives by the coordinates of the centre.
    pub mean: [f64; 3],
    /// Derivatives by the components of the quaternion, whose length is scaled to 1 before use.
    pub quat: [f64; 4],
    /// Derivatives by the natural logarithms of the standard deviations.
    pub log_scale: [f64; 3],
    /// Derivative by the logit of the opacity.
    pub logit: f64,
    /// Derivatives by the spherical harmonics coefficients of degrees up to the one in use; 0 above.
    pub sh: [[f32; 3]; SH_LEN],
}

/// Number of coefficients of a splat of degree 3.
pub const SH_LEN: usize = 16;

/// Chain rule through the projection of one view.
pub struct Chain<'a> {
    camera: Pinhole,
    eye: DVec3,
    settings: &'a Settings,
    /// Degree of the harmonics that are used, at most 3.
    degree: u32,
}

/// Gradient with respect to the shape of a footprint before it is projected back.
struct Shape {
    mean: DVec3,
    quat: [f64; 4],
    log_scale: [f64; 3],
}

impl<'a> Chain<'a> {
    /// Chain rule for a view that was rendered with these settings, from splats with harmonics of degree
    /// `sh_degree`.
    pub fn new(camera: &Camera, settings: &'a Settings, sh_degree: u32) -> Self {
        let degree = settings.sh_degree.min(sh_degree).min(3);
        Self { camera: Pinhole::new(camera), eye: camera.eye(), settings, degree }
    }

    /// Number of coefficients that have a gradient.
    pub fn sh_len(&self) -> usize {
        ((self.degree + 1) * (self.degree + 1)) as usize
    }

    /// Gradient of the splat of a row, whose parameters are `of`.
    pub fn gradient(&self, row: &Row<'_>, of: &SplatValues<'_>) -> SplatGradient {
        let (f, sums) = (row.footprint, row.sums);
        let [q, t, tt, s, ts, ss] = [sums.q, sums.t, sums.tt, sums.s, sums.ts, sums.ss].map(f64::from);
        // The exponent is log2(opacity) - t^2 - s^2.
        let by_exponent = q * LN_2;
        let by_u = 2.0 * LN_2 * f.l11 * t;
        let by_v = 2.0 * LN_2 * (f.l21 * t + f.l22 * s);
        let by_l11 = -2.0 * LN_2 / f.l11 * (tt - f.l21 / f.l22 * ts);
        let by_l21 = -2.0 * LN_2 / f.l22 * ts;
        let by_l22 = -2.0 * LN_2 / f.l22 * ss;
        let footprint = [by_u, by_v, by_l11, by_l21, by_l22, by_exponent];
        let Shape { mean, quat, log_scale } = self.shape(of, footprint);
        // d log2(o) / d logit = (1 - o) / ln 2.
        let logit = q * (1.0 - of.opacity);
        let (sh, by_direction) = self.harmonics(of, f.rgb, sums.rgb);
        SplatGradient { mean: (mean + by_direction).to_array(), quat, log_scale, logit, sh }
    }

    /// Gradient with respect to centre and shape, from derivatives by u, v, l11, l21, l22 and the exponent.
    fn shape(
        &self,
        of: &SplatValues<'_>,
        [by_u, by_v, by_l11, by_l21, by_l22, by_exponent]: [f64; 6],
    ) -> Shape {
        let Self { camera, settings, .. } = self;
        let d = of.mean - self.eye;
        let (x, y, z) = (camera.right.dot(d), camera.down.dot(d), camera.forward.dot(d));
        let inverse_z = 1.0 / z;
        let (slope_x, slope_y) = (x * inverse_z, y * inverse_z);
        let held_x = slope_x.max(camera.slope_x[0]).min(camera.slope_x[1]);
        let held_y = slope_y.max(camera.slope_y[0]).min(camera.slope_y[1]);
        let (across, along) = (camera.right - camera.forward * held_x, camera.down - camera.forward * held_y);
        let (row_x, row_y) = (across * (camera.fx * inverse_z), along * (camera.fy * inverse_z));
        let axes_of = axes(of.quat, of.scale);
        let p = DVec3::new(row_x.dot(axes_of[0]), row_x.dot(axes_of[1]), row_x.dot(axes_of[2]));
        let q = DVec3::new(row_y.dot(axes_of[0]), row_y.dot(axes_of[1]), row_y.dot(axes_of[2]));
        let (raw_xx, xy, raw_yy) = (p.dot(p), p.dot(q), q.dot(q));
        let low = settings.low_pass_px2;
        let (xx, yy) = (raw_xx + low, raw_yy + low);
        let raw_det = p.cross(q).length_squared();
        let det = raw_det + low * (raw_xx + raw_yy) + low * low;
        let (root_det, root_yy) = (det.sqrt(), yy.sqrt());
        let to_base_2 = (0.5 * LOG2_E).sqrt();
        let l11 = to_base_2 * root_yy / root_det;
        let l21 = -to_base_2 * xy / (root_yy * root_det);
        let l22 = to_base_2 / root_yy;

        let mut by_det = -0.5 * (by_l11 * l11 + by_l21 * l21) / det;
        let mut by_xy = -by_l21 * to_base_2 / (root_yy * root_det);
        let mut by_yy = 0.5 * (by_l11 * l11 - by_l21 * l21 - by_l22 * l22) / yy;
        let mut by_xx = 0.0;
        if settings.compensate && raw_det > 0.0 {
            // The exponent has 1/2 log2(raw_det / det) as a further term.
            let half = 0.5 * by_exponent * LOG2_E;
            by_det -= half / det;
            by_xx += half / raw_det * raw_yy;
            by_yy += half / raw_det * raw_xx;
            by_xy -= half / raw_det * 2.0 * xy;
        }
        by_xx += by_det * yy;
        by_yy += by_det * xx;
        by_xy -= 2.0 * by_det * xy;
        let by_p = (p * (2.0 * by_xx) + q * by_xy).to_array();
        let by_q = (q * (2.0 * by_yy) + p * by_xy).to_array();

        let (mut by_row_x, mut by_row_y) = (DVec3::ZERO, DVec3::ZERO);
        let turned = axes(of.quat, [1.0; 3]);
        let (mut log_scale, mut columns) = ([0.0; 3], [DVec3::ZERO; 3]);
        for i in 0..3 {
            by_row_x += axes_of[i] * by_p[i];
            by_row_y += axes_of[i] * by_q[i];
            let by_axis = (row_x * by_p[i] + row_y * by_q[i]) * of.scale[i];
            log_scale[i] = by_axis.dot(turned[i]);
            columns[i] = by_axis;
        }

        let mut by_slope_x = camera.fx * by_u;
        let mut by_slope_y = camera.fy * by_v;
        if held_x == slope_x {
            by_slope_x -= by_row_x.dot(camera.forward) * camera.fx * inverse_z;
        }
        if held_y == slope_y {
            by_slope_y -= by_row_y.dot(camera.forward) * camera.fy * inverse_z;
        }
        let by_inverse_z = by_row_x.dot(across) * camera.fx
            + by_row_y.dot(along) * camera.fy
            + by_slope_x * x
            + by_slope_y * y;
        let by_z = -by_inverse_z * inverse_z * inverse_z;
        let mean = camera.right * (by_slope_x * inverse_z)
            + camera.down * (by_slope_y * inverse_z)
            + camera.forward * by_z;
        Shape { mean, quat: quaternion(of.quat, columns), log_scale }
    }

    /// Gradient with respect to the coefficients, and with respect to the centre through the direction in which it
    /// is seen. Channels of the colour that are clamped to 0 have no gradient.
    fn harmonics(
        &self,
        of: &SplatValues<'_>,
        colour: [f32; 3],
        by_colour: [f32; 3],
    ) -> ([[f32; 3]; SH_LEN], DVec3) {
        let mut out = [[0.0; 3]; SH_LEN];
        let by: [f32; 3] =
            std::array::from_fn(
                |c| {
                    if colour[c] > 0.0 && colour[c] < sh::LARGEST { by_colour[c] } else { 0.0 }
                },
            );
        if self.degree == 0 {
            let basis = sh::basis(0, [0.0; 3]);
            out[0] = by.map(|value| value * basis[0]);
            return (out, DVec3::ZERO);
        }
        let offset = of.mean - self.eye;
        let distance = offset.length();
        let direction = offset / distance;
        let along = direction.to_array().map(|c| c as f32);
        let basis = sh::basis(self.degree, along);
        // Derivative of the loss by each basis function.
        let mut by_basis = [0.0_f32; SH_LEN];
        for (k, (out, coefficient)) in out.iter_mut().zip(of.sh).enumerate().take(self.sh_len()) {
            *out = by.map(|value| value * basis[k]);
            by_basis[k] = coefficient[0] * by[0] + coefficient[1] * by[1] + coefficient[2] * by[2];
        }
        let by_direction = sh::by_direction(self.degree, along, &by_basis);
        let by_direction = DVec3::from(by_direction.map(f64::from));
        (out, (by_direction - direction * direction.dot(by_direction)) / distance)
    }
}

/// Gradient with respect to a quaternion whose length is scaled to 1, from the gradients with respect to the
/// columns of its rotation matrix.
fn quaternion([w, x, y, z]: [f64; 4], [a, b, c]: [DVec3; 3]) -> [f64; 4] {
    let by = [
        z * (a.y - b.x) + y * (c.x - a.z) + x * (b.z - c.y),
        y * (a.y + b.x) + z * (a.z + c.x) + w * (b.z - c.y) - 2.0 * x * (b.y + c.z),
        x * (a.y + b.x) + z * (b.z + c.y) + w * (c.x - a.z) - 2.0 * y * (a.x + c.z),
        x * (a.z + c.x) + y * (b.z + c.y) + w * (a.y - b.x) - 2.0 * z * (a.x + b.y),
    ]
    .map(|v| 2.0 * v);
    let along = by[0] * w + by[1] * x + by[2] * y + by[3] * z;
    [by[0] - along * w, by[1] - along * x, by[2] - along * y, by[3] - along * z]
}
