//! What the objects stand on: the receiver, one another, or nothing.

use engine::Notes;
use glam::{DVec3, Vec3};

use super::contact::{self, Ground, LARGEST, TOUCHING};
use super::objects::Objects;
use super::prepared::PreparedScene;
use super::reporting::{report_contact, report_lost, report_sides};
use super::side::{Lost, Side};
use super::sunk::Sunk;
use super::touching::Touching;
use super::visibility::Probe;
use crate::bvh::Hit;
use crate::types::Placed;

/// How much farther down one reaches at least on which an object rests, in metres.
const LOWER: f64 = 0.005;

/// Finds the ground of the objects and where they lie on it, and tells of those that miss it. `eye` is that of a camera in
/// the place, `contact_metres` how far the receiver may be wrong, where that is told.
pub(super) fn find_ground(
    objects: &mut Objects,
    prepared: &PreparedScene<'_>,
    eye: Vec3,
    (up, metres_per_unit): (DVec3, f64),
    contact_metres: Option<f64>,
    notes: &mut Notes,
) {
    let (receiver, placed, origin) = (prepared.receiver(), &prepared.inputs.objects, prepared.origin);
    let metre = 1.0 / metres_per_unit;
    let view = Probe::send(receiver, eye);
    let inverted = view.escaped < view.rays && view.front_share() < 0.5;
    // What rests on another object has that for its ground.
    let on_others = objects.on_others(placed, origin, up, metre);
    let each: Vec<_> = placed.iter().zip(&on_others).map(|(one, on)| (one.clone(), !on)).collect();
    let (ground, found) = Ground::measure((receiver, inverted), &each, origin, up, metre, contact_metres);
    let measured: Vec<_> = found.iter().map(|found| found.ground).collect();
    let carried = objects.carried(placed, origin, up, metre);
    let tall: Vec<f64> =
        objects.boxes().iter().map(|one| (one.high - one.low).as_dvec3().dot(up.abs())).collect();
    report_contact(&measured, &carried, &tall, (metres_per_unit, contact_metres), notes);
    let lost = |index: usize| {
        let rests = measured[index].is_some() || carried[index] || on_others[index];
        let foot = (!rests && found[index].sides.is_empty()).then(|| Side::foot(&placed[index], up))?;
        foot?.lost((receiver, inverted), origin, metre)
    };
    let lost: Vec<_> = (0..placed.len()).map(lost).collect();
    for why in [Lost::OverNothing, Lost::Buried] {
        report_lost((0..placed.len()).filter(|index| lost[*index] == Some(why)), why, notes);
    }
    report_sides(found.iter().map(|found| &found.sides[..]), metres_per_unit, notes);
    let stands = |index: usize| {
        let hangs = ground.error() > 0.0 && !found[index].sides.is_empty();
        measured[index].is_some_and(|level| contact::is_near(&level, metre)) || carried[index] || hangs
    };
    Sunk::report(objects, receiver, stands, metres_per_unit, notes);
    objects.touching = Touching::of(objects, receiver, &ground);
    objects.ground = ground;
}

impl Objects {
    /// Whether each object stands on another one: some of what is under its foot, as far as a mesh may be wrong.
    pub fn carried(&self, placed: &[impl AsRef<Placed>], origin: DVec3, up: DVec3, metre: f64) -> Vec<bool> {
        let stands = |(index, placed): (usize, &Placed)| {
            let Some(foot) = Side::foot(placed, up) else { return false };
            let largest = LARGEST * metre;
            let others = |hit: &Hit| self.part(hit.triangle).0.placed != index;
            foot.feelers(origin, largest).any(|(_, ray)| self.bvh.any(ray, others))
        };
        // One alone stands on none.
        let alone = placed.len() < 2;
        placed.iter().map(AsRef::as_ref).enumerate().map(|one| !alone && stands(one)).collect()
    }

    /// Whether each object rests on one that reaches farther down, such as a plate on a coaster: what lies below the plate
    /// beside the coaster is no ground of it.
    pub fn on_others(
        &self,
        placed: &[impl AsRef<Placed>],
        origin: DVec3,
        up: DVec3,
        metre: f64,
    ) -> Vec<bool> {
        let feet: Vec<Option<Side>> = placed.iter().map(|one| Side::foot(one.as_ref(), up)).collect();
        let bases: Vec<f64> =
            feet.iter().map(|foot| foot.as_ref().map_or(f64::INFINITY, |foot| foot.height)).collect();
        let rests = |foot: &Side| {
            let lower = |hit: &Hit| bases[self.part(hit.triangle).0.placed] < foot.height - LOWER * metre;
            let half = foot.own();
            let under = |at: &[f64; 2]| at[0].abs() <= half[0] && at[1].abs() <= half[1];
            let mut rays = foot.feelers(origin, TOUCHING * metre).filter(|(at, _)| under(at));
            rays.any(|(_, ray)| self.bvh.any(ray, lower))
        };
        let alone = placed.len() < 2;
        feet.iter().map(|foot| !alone && foot.as_ref().is_some_and(rests)).collect()
    }
}
