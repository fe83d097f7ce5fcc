//! Sheets that lie exactly on another object: a label on a box, a cloth on a table, a card on a card.
//!
//! Of two surfaces in one place rounding would choose which a ray meets. A flat object in the plane of a face of another one
//! lies on that face: it is lifted off it by a hair, some millionths of its coordinates, so that it is in front for all rays.

use glam::Vec3;

use super::objects::Objects;
use super::receiver::margin;
use crate::bvh::Bvh;

/// How far a sheet is lifted, in units of how far rays start off what it lies on.
const HAIR: f32 = 4.0;

/// A flat object.
struct Sheet {
    /// Unit normal.
    normal: Vec3,
    /// Distance of its plane from the start of coordinates, along the normal.
    height: f32,
    low: Vec3,
    high: Vec3,
}

impl Sheet {
    /// Of triangles, if all of them lie in one plane as far as rounding tells.
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

    /// Distance of a point from its plane.
    fn off(&self, point: Vec3) -> f32 {
        (point.dot(self.normal) - self.height).abs()
    }

    /// Whether a triangle lies in its plane, where it is.
    fn lies_on(&self, corners: &[Vec3; 3], reach: f32) -> bool {
        let [a, b, c] = corners;
        let (low, high) = (a.min(*b).min(*c), a.max(*b).max(*c));
        corners.iter().all(|p| self.off(*p) <= reach)
            && low.cmple(self.high).all()
            && high.cmpge(self.low).all()
    }
}

impl Objects {
    /// Lifts flat objects off those in whose place they lie: to the side that a face's winding shows; of two flat ones the
    /// later off the earlier.
    pub(super) fn lift_sheets(&mut self) {
        let Some((low, high)) = self.bvh.bounds().filter(|_| self.placed().len() > 1) else { return };
        let space = margin(&[low, high, low]);
        let reach = 2.0 * space;
        let count = self.placed().len();
        let mut spans = vec![Vec::new(); count];
        for (index, part) in self.parts.iter().enumerate() {
            let end = self.parts.get(index + 1).map_or(self.corners.len(), |next| next.first as usize);
            spans[part.placed].push(part.first as usize..end);
        }
        let of = |index: usize| spans[index].iter().flat_map(|span| &self.corners[span.clone()]);
        let sheets: Vec<Option<Sheet>> = (0..count).map(|index| Sheet::of(of(index), reach)).collect();
        // How many hairs along its normal each is lifted.
        let mut lifts = vec![0.0_f32; count];
        for index in 0..count {
            let Some(sheet) = &sheets[index] else { continue };
            for below in (0..count).filter(|&below| below != index) {
                if sheets[below].is_some() && below > index {
                    continue;
                }
                let Some([a, b, c]) = of(below).find(|corners| sheet.lies_on(corners, reach)) else {
                    continue;
                };
                let side = 1.0_f32.copysign((*b - *a).cross(*c - *a).dot(sheet.normal));
                // That of a sheet that was lifted itself.
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
            let way = sheet.normal * (lifts[index] * HAIR * space);
            for span in &spans[index] {
                self.corners[span.clone()].iter_mut().flatten().for_each(|corner| *corner += way);
            }
        }
        self.bvh = Bvh::build(&self.corners);
    }
}
