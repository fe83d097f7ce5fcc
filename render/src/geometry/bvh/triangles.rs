//! The intersection test of a ray with four triangles at once.

use glam::Vec4;

use super::ray::{Hit, Ray};

/// Four triangles, one per lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Packet {
    pub(super) corners: [[Vec4; 3]; 3],
    pub(super) ids: [u32; 4],
}

/// A ray prepared for the triangle test: a permutation of the axes, such that the direction is largest along the
/// last axis, and the shear that maps the direction to that axis (Woop, Benthin and Wald 2013, Watertight
/// Ray/Triangle Intersection).
pub(super) struct Sheared {
    axes: [usize; 3],
    origin: [Vec4; 3],
    shear: [Vec4; 3],
}

impl Sheared {
    #[inline(always)]
    pub(super) fn new(ray: &Ray) -> Self {
        let z = ray.direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        let d = ray.direction.to_array();
        // Swapping keeps the winding.
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let shear = [Vec4::splat(d[x] / d[z]), Vec4::splat(d[y] / d[z]), Vec4::splat(1.0 / d[z])];
        let o = ray.origin.to_array();
        Self { axes: [x, y, z], origin: [Vec4::splat(o[x]), Vec4::splat(o[y]), Vec4::splat(o[z])], shear }
    }

    /// Projects one corner of each of four triangles along the ray. Returns two coordinates across the ray, and the
    /// distance. There is one call per corner, because a call with all corners would pass them through memory.
    #[inline(always)]
    fn project(&self, corner: &[Vec4; 3]) -> [Vec4; 3] {
        let [kx, ky, kz] = self.axes;
        // Checked once, so that indexing needs no further checks.
        assert!(kx < 3 && ky < 3 && kz < 3, "three axes");
        let z = corner[kz] - self.origin[2];
        let x = corner[kx] - self.origin[0] - self.shear[0] * z;
        let y = corner[ky] - self.origin[1] - self.shear[1] * z;
        [x, y, z * self.shear[2]]
    }
}

impl Packet {
    /// A packet without triangles. Its corners are NaN, which fail the first test. Triangles that are points would
    /// pass all tests up to the last one, since a point lies on its own edges.
    pub(super) const EMPTY: Self = Self { corners: [[Vec4::NAN; 3]; 3], ids: [u32::MAX; 4] };

    /// Tests four triangles. Each corner is projected separately, so neighbouring triangles have the same projected
    /// corners. The sign of an edge function of two corners is exact, because rounding is monotonic and results of
    /// 0 are computed again in f64. So a ray cannot pass between neighbouring triangles, even at corners.
    #[inline(always)]
    pub(super) fn intersect(&self, ray: &Sheared, limit: f32, mut hit: impl FnMut(Hit) -> bool) -> bool {
        let [a, b, c] = &self.corners;
        let ([ax, ay, az], [bx, by, bz], [cx, cy, cz]) = (ray.project(a), ray.project(b), ray.project(c));
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        let edge = u.cmpeq(Vec4::ZERO) | v.cmpeq(Vec4::ZERO) | w.cmpeq(Vec4::ZERO);
        if edge.any() {
            let exact = |px: Vec4, qy: Vec4, py: Vec4, qx: Vec4, lane: usize| {
                (f64::from(px[lane]) * f64::from(qy[lane]) - f64::from(py[lane]) * f64::from(qx[lane])) as f32
            };
            for lane in 0..4 {
                if edge.test(lane) {
                    u[lane] = exact(cx, by, cy, bx, lane);
                    v[lane] = exact(ax, cy, ay, cx, lane);
                    w[lane] = exact(bx, ay, by, ax, lane);
                }
            }
        }
        let (least, most) = (u.min(v).min(w), u.max(v).max(w));
        let inside = least.cmpge(Vec4::ZERO) | most.cmple(Vec4::ZERO);
        if !inside.any() {
            return true;
        }
        let det = u + v + w;
        let t = (u * az + v * bz + w * cz) / det;
        // Comparisons with NaN, from a ray in the plane of a triangle, are false.
        let ahead = t.cmpgt(Vec4::ZERO) & t.cmple(Vec4::splat(limit));
        let mut lanes = (inside & ahead & det.cmpne(Vec4::ZERO)).bitmask();
        if lanes == 0 {
            return true;
        }
        let (t, v, w, det) = (t.to_array(), v.to_array(), w.to_array(), det.to_array());
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let b1 = (v[lane] / det[lane]).clamp(0.0, 1.0);
            let b2 = (w[lane] / det[lane]).clamp(0.0, 1.0 - b1);
            let found = Hit { t: t[lane], triangle: self.ids[lane], b1, b2, back: det[lane] < 0.0 };
            if !hit(found) {
                return false;
            }
        }
        true
    }
}
