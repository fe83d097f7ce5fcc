//! Triangles of objects that coincide with the receiver, and the rules by which rays hit them.

use glam::Vec3;

use super::aabb::Aabb;
use super::face::margin;
use super::objects::Objects;
use super::receiver::Receiver;
use super::supports::Ground;
use super::surface::Surface;
use super::touching::Touching;
use crate::geometry::bvh::Hit;

/// Minimum cosine between the normals of two surfaces that lie on each other. The sides of an object that stands on
/// a surface have a smaller cosine.
const ALONG: f32 = 0.5;

/// Finds the triangles of objects that coincide with the receiver. Camera hits on the receiver may be moved to the
/// supports in `ground`.
pub fn find_touching(objects: &Objects, receiver: &Receiver, ground: &Ground) -> Touching {
    let Some((low, high)) = objects.bvh.bounds() else { return Touching::default() };
    let space = margin(&[low, high, low]);
    let whole = Aabb { low, high }.grown(space);
    // The part of the receiver within the bounds of the objects.
    let (mut place, mut coarsest) = (None::<Aabb>, 0.0_f32);
    receiver.bvh.visit(|corners| {
        let here = Aabb::around(corners);
        let meets = here.meets(&whole);
        if let ([a, b, c], true) = (corners, meets) {
            coarsest = coarsest.max(margin(&[*a, *b, *c]));
            let here = here.common(whole);
            place = Some(place.map_or(here, |place| place.joined(here)));
        }
        meets
    });
    // An object that was lifted off another may lie this far below the receiver.
    let reach = 2.0 * (space + coarsest) + objects.lifted;
    let touches = |corners: &[Vec3; 3]| {
        let own = Aabb::around(corners).grown(reach);
        if ground.is_base(corners, reach) {
            return true;
        }
        let mut found = false;
        if place.is_some_and(|place| own.meets(&place)) {
            receiver.bvh.visit(|corners| {
                let meets = !found && Aabb::around(corners).meets(&own);
                found |= meets && corners.len() == 3;
                meets
            });
        }
        found
    };
    let mut all = Touching { triangles: vec![false; objects.corners.len()], held: None, reach };
    for (_, triangles) in objects.parts_with_triangles().filter(|(part, _)| part.body.is_none()) {
        for triangle in triangles {
            let corners = &objects.corners[triangle];
            if corners.iter().all(|corner| corner.is_finite()) && touches(corners) {
                all.triangles[triangle] = true;
                let own = Aabb::around(corners).grown(reach);
                all.held = Some(all.held.map_or(own, |held| held.joined(own)));
            }
        }
    }
    if all.held.is_some() { all } else { Touching::default() }
}

impl Objects {
    /// Distance by which a receiver hit may lie in front of a hit on an object and still count as behind it. 0 for
    /// an object that does not lie on the receiver.
    pub fn slack(&self, hit: &Hit, direction: Vec3) -> f32 {
        if !self.touching.holds(hit.triangle) {
            return 0.0;
        }
        self.touching.reach / self.normal(hit.triangle).dot(direction).abs().max(0.01)
    }

    /// Depth below a point of the receiver at which rays to objects start, so that they hit the object that
    /// lies on it. `None` if there is no such object.
    pub fn covers(&self, position: Vec3, normal: Vec3) -> Option<f32> {
        let touching = &self.touching;
        if !touching.held?.holds(position) {
            return None;
        }
        let lies =
            |hit: &Hit| touching.holds(hit.triangle) && self.normal(hit.triangle).dot(normal).abs() > ALONG;
        self.bvh.any(touching.across(position, normal), lies).then_some(touching.reach)
    }

    /// Offset from an object's surface at which rays to the receiver start, so that they hit the receiver that the
    /// surface lies on. The offset is along the normal, or against the normal if the ray started very close to the
    /// surface. `None` if the surface does not lie on the receiver.
    pub fn bed(&self, hit: &Hit, direction: Vec3, surface: &Surface, receiver: &Receiver) -> Option<Vec3> {
        let touching = &self.touching;
        let lies = |hit: &Hit| receiver.normal(hit.triangle).dot(surface.normal).abs() > ALONG;
        let found = touching.holds(hit.triangle)
            && receiver.bvh.any(touching.across(surface.position, surface.normal), lies);
        let from_there = hit.t * surface.normal.dot(direction).abs() <= 3.0 * touching.reach;
        found.then(|| surface.normal * if from_there { -touching.reach } else { touching.reach })
    }
}
