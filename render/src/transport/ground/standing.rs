//! Supports of the objects: each stands on the receiver, on another object, or on nothing.

use glam::{DVec3, Vec3};
use scene::types::Placed;

use super::contact;
use super::embedded::Embedded;
use super::limits::{LARGEST, TOUCHING};
use super::probe::Probe;
use super::side::{Side, Unsupported};
use crate::geometry::bvh::Hit;
use crate::geometry::support::GroundPlane;
use crate::transport::scene::coincident::find_touching;
use crate::transport::scene::objects::Objects;
use crate::transport::scene::receiver::Receiver;

/// Minimum height, in metres, by which an object must reach farther down than the object that it supports.
const LOWER: f64 = 0.005;

/// Supports of the objects, with one entry per object.
pub struct Standing {
    /// Level of the ground below each object, even if it is too far away to support the object.
    pub ground: Vec<Option<GroundPlane>>,
    /// Levels of the surfaces that the flat sides of each object rest on.
    pub sides: Vec<Vec<GroundPlane>>,
    /// True for each object that stands on another object.
    pub carried: Vec<bool>,
    /// Extent of each object along the up direction, in world units.
    pub tall: Vec<f64>,
    /// For each object, the reason why there is no ground below it; `None` if there is ground.
    pub unsupported: Vec<Option<Unsupported>>,
    /// Part of each object that is embedded in a surface that it does not stand on.
    pub embedded: Vec<Option<Embedded>>,
}

/// Finds the supports of the objects and stores them in `objects`. `eye` is the position of a camera in the scene.
/// `contact_metres` is the error of the mesh, if known.
pub fn find_ground(
    objects: &mut Objects,
    receiver: &Receiver,
    origin: DVec3,
    eye: Vec3,
    (up, metres_per_unit): (DVec3, f64),
    contact_metres: Option<f64>,
) -> Standing {
    let placed = objects.placed().to_vec();
    let metre = 1.0 / metres_per_unit;
    let view = Probe::send(receiver, eye);
    let inverted = view.escaped < view.rays && view.front_share() < 0.5;
    // An object on another one does not rest on the receiver.
    let on_others = on_others(objects, &placed, origin, up, metre);
    let each: Vec<_> = placed.iter().zip(&on_others).map(|(one, on)| (one.clone(), !on)).collect();
    let (ground, found) = contact::measure((receiver, inverted), &each, origin, up, metre, contact_metres);
    let measured: Vec<_> = found.iter().map(|found| found.ground).collect();
    let carried = carried(objects, &placed, origin, up, metre);
    let tall = objects.boxes().iter().map(|one| (one.high - one.low).as_dvec3().dot(up.abs())).collect();
    let unsupported = |index: usize| {
        let rests = measured[index].is_some() || carried[index] || on_others[index];
        let foot = (!rests && found[index].sides.is_empty()).then(|| Side::foot(&placed[index], up))?;
        foot?.unsupported((receiver, inverted), origin, metre)
    };
    let unsupported = (0..placed.len()).map(unsupported).collect();
    let stands = |index: usize| {
        let hangs = ground.error() > 0.0 && !found[index].sides.is_empty();
        measured[index].is_some_and(|level| contact::is_near(&level, metre)) || carried[index] || hangs
    };
    let near = (LARGEST / metres_per_unit) as f32;
    let embedded = |index| if stands(index) { None } else { Embedded::of(objects, index, receiver, near) };
    let embedded = (0..placed.len()).map(embedded).collect();
    objects.touching = find_touching(objects, receiver, &ground);
    objects.ground = ground;
    let sides = found.into_iter().map(|found| found.sides).collect();
    Standing { ground: measured, sides, carried, tall, unsupported, embedded }
}

/// True for each object whose foot stands at least partly on another object. Gaps up to the error of a mesh are
/// allowed.
fn carried(
    objects: &Objects,
    placed: &[impl AsRef<Placed>],
    origin: DVec3,
    up: DVec3,
    metre: f64,
) -> Vec<bool> {
    let stands = |(index, placed): (usize, &Placed)| {
        let Some(foot) = Side::foot(placed, up) else { return false };
        let largest = LARGEST * metre;
        let others = |hit: &Hit| objects.part(hit.triangle).0.placed != index;
        foot.grid_rays(origin, largest).any(|(_, ray)| objects.bvh.any(ray, others))
    };
    // A single object stands on no other.
    let alone = placed.len() < 2;
    placed.iter().map(AsRef::as_ref).enumerate().map(|one| !alone && stands(one)).collect()
}

/// True for each object that rests on another object that reaches farther down, such as a plate on a coaster. The
/// receiver below the rim of the plate is not its ground.
fn on_others(
    objects: &Objects,
    placed: &[impl AsRef<Placed>],
    origin: DVec3,
    up: DVec3,
    metre: f64,
) -> Vec<bool> {
    let feet: Vec<Option<Side>> = placed.iter().map(|one| Side::foot(one.as_ref(), up)).collect();
    let bases: Vec<f64> =
        feet.iter().map(|foot| foot.as_ref().map_or(f64::INFINITY, |foot| foot.height)).collect();
    let rests = |foot: &Side| {
        let lower = |hit: &Hit| bases[objects.part(hit.triangle).0.placed] < foot.height - LOWER * metre;
        let half = foot.own();
        let under = |at: &[f64; 2]| at[0].abs() <= half[0] && at[1].abs() <= half[1];
        let mut rays = foot.grid_rays(origin, TOUCHING * metre).filter(|(at, _)| under(at));
        rays.any(|(_, ray)| objects.bvh.any(ray, lower))
    };
    let alone = placed.len() < 2;
    feet.iter().map(|foot| !alone && foot.as_ref().is_some_and(rests)).collect()
}
