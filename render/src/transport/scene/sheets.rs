//! Flat objects that lie exactly on another object: a label on a box, a cloth on a table, a card on a card.
//!
//! Which of two coincident surfaces a ray hits would otherwise depend on rounding. A flat object in the plane of a
//! face of another object is lifted off it by a few millionths of its coordinates, so that it is in front for all
//! rays. A rug on the floor under a table is not moved: to separate it from the feet of the table, it would have to
//! move into the floor, and the contact with the feet is not visible.

use glam::{DVec2, Vec3};

use super::face::margin;
use super::objects::Objects;
use super::receiver::Receiver;
use crate::geometry::bvh::{Bvh, Ray};

/// Distance by which a sheet is lifted, in units of the ray offset of the surface below.
const HAIR: f32 = 4.0;

/// A flat object.
struct Sheet {
    /// Unit normal.
    normal: Vec3,
    /// Distance of its plane from the origin, along the normal.
    height: f32,
    low: Vec3,
    high: Vec3,
}

impl Sheet {
    /// Sheet that consists of the given triangles. `None` unless all of them lie in one plane, up to rounding.
    fn of<'a>(triangles: impl Iterator<Item = &'a [Vec3; 3]> + Clone, reach: f32) -> Option<Self> {
        let area = |[a, b, c]: &[Vec3; 3]| (*b - *a).as_dvec3().cross((*c - *a).as_dvec3());
        let by_size = |a: &&[Vec3; 3], b: &&[Vec3; 3]| area(a).length().total_cmp(&area(b).length());
        let largest = triangles.clone().max_by(by_size)?;
        let normal = area(largest).try_normalize()?.as_vec3();
        let height = largest[0].dot(normal);
        let [low, high] = triangles
            .clone()
            .flatten()
            .fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], p| [low.min(*p), high.max(*p)]);
        let sheet = Self { normal, height, low: low - reach, high: high + reach };
        triangles.flatten().all(|p| sheet.off(*p) <= reach).then_some(sheet)
    }

    /// Distance of a point from the plane.
    fn off(&self, point: Vec3) -> f32 {
        (point.dot(self.normal) - self.height).abs()
    }

    /// True if a triangle lies in the plane and overlaps one of the sheet's `own` triangles.
    fn lies_on<'a>(
        &self,
        corners: &[Vec3; 3],
        mut own: impl Iterator<Item = &'a [Vec3; 3]>,
        reach: f32,
    ) -> bool {
        let [a, b, c] = corners;
        let (low, high) = (a.min(*b).min(*c), a.max(*b).max(*c));
        let near = corners.iter().all(|p| self.off(*p) <= reach)
            && low.cmple(self.high).all()
            && high.cmpge(self.low).all();
        let across = self.normal.any_orthonormal_vector().as_dvec3();
        let along = self.normal.as_dvec3().cross(across);
        let flat = |corners: &[Vec3; 3]| {
            corners.map(|p| DVec2::new(p.as_dvec3().dot(across), p.as_dvec3().dot(along)))
        };
        near && own.any(|own| share_area(&flat(own), &flat(corners), f64::from(reach)))
    }

    /// True if the receiver coincides with the sheet at the centre of one of the sheet's triangles.
    fn rests_on<'a>(
        &self,
        receiver: &Receiver,
        mut own: impl Iterator<Item = &'a [Vec3; 3]>,
        reach: f32,
    ) -> bool {
        // Positions of the receiver are only as accurate as the size of its triangles allows.
        let reach = reach + 2.0 * receiver.margin_within(self.low, self.high);
        own.any(|[a, b, c]| {
            let middle = (*a + *b + *c) / 3.0;
            let across = Ray { t_max: 2.0 * reach, ..Ray::new(middle + self.normal * reach, -self.normal) };
            receiver.bvh.any(across, |hit| receiver.normal(hit.triangle).dot(self.normal).abs() > 0.5)
        })
    }
}

/// True if two triangles overlap by more than the length `by`, that is, if no edge of either separates them
/// (separating axis theorem).
fn share_area(a: &[DVec2; 3], b: &[DVec2; 3], by: f64) -> bool {
    let extent = |corners: &[DVec2; 3], way: DVec2| {
        let at = corners.map(|p| p.dot(way));
        (at[0].min(at[1]).min(at[2]), at[0].max(at[1]).max(at[2]))
    };
    [a, b].into_iter().flat_map(|corners| [0, 1, 2].map(|i| corners[(i + 1) % 3] - corners[i])).all(|edge| {
        let Some(way) = edge.perp().try_normalize() else { return false };
        let ((low, high), (other_low, other_high)) = (extent(a, way), extent(b, way));
        high.min(other_high) - low.max(other_low) > by
    })
}

impl Objects {
    /// Lifts each flat object off the face of another object that it coincides with, towards the front of this
    /// face. Of two flat objects, the later one is lifted off the earlier one, towards the camera if the earlier
    /// one is two-sided. A flat object on the receiver is lifted only off other flat objects.
    pub(crate) fn lift_sheets(&mut self, receiver: Option<&Receiver>) {
        let Some((low, high)) = self.bvh.bounds().filter(|_| self.placed().len() > 1) else { return };
        let space = margin(&[low, high, low]);
        let reach = 2.0 * space;
        let count = self.placed().len();
        let mut spans = vec![Vec::new(); count];
        for (part, triangles) in self.parts_with_triangles() {
            spans[part.placed].push(triangles);
        }
        let of = |index: usize| spans[index].iter().flat_map(|span| &self.corners[span.clone()]);
        let sheets: Vec<Option<Sheet>> = (0..count).map(|index| Sheet::of(of(index), reach)).collect();
        let rests = |index: usize| match (&sheets[index], receiver) {
            (Some(sheet), Some(receiver)) => sheet.rests_on(receiver, of(index), reach),
            _ => false,
        };
        let rests: Vec<bool> = (0..count).map(rests).collect();
        let two_sided = |index: usize| self.placed()[index].object.materials.iter().all(|m| m.double_sided);
        // Lift of each object along its normal, in units of [`HAIR`].
        let mut lifts = vec![0.0_f32; count];
        for index in 0..count {
            let Some(sheet) = &sheets[index] else { continue };
            for below in (0..count).filter(|&below| below != index) {
                if if sheets[below].is_some() { below > index } else { rests[index] } {
                    continue;
                }
                let lies = |corners: &&[Vec3; 3]| sheet.lies_on(corners, of(index), reach);
                let Some([a, b, c]) = of(below).find(lies) else {
                    continue;
                };
                let seen = sheets[below].is_some() && two_sided(below) && sheet.height != 0.0;
                let winding = (*b - *a).cross(*c - *a).dot(sheet.normal);
                let side = 1.0_f32.copysign(if seen { -sheet.height } else { winding });
                // Lift of the sheet below, if it was lifted itself.
                let own =
                    sheets[below].as_ref().map_or(0.0, |own| lifts[below] * own.normal.dot(sheet.normal));
                let lift = if own == 0.0 { side } else { own + 1.0_f32.copysign(own) };
                if lift.abs() > lifts[index].abs() {
                    lifts[index] = lift;
                }
            }
        }
        if lifts.iter().all(|&lift| lift == 0.0) {
            return;
        }
        for (index, sheet) in sheets.iter().enumerate() {
            let Some(sheet) = sheet else { continue };
            let far = lifts[index] * HAIR * space;
            self.lifted = self.lifted.max(far.abs());
            let way = sheet.normal * far;
            for span in &spans[index] {
                self.corners[span.clone()].iter_mut().flatten().for_each(|corner| *corner += way);
            }
        }
        self.bvh = Bvh::build(&self.corners);
    }
}
