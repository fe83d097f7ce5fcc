//! What the objects stand on: the receiver, one another, or nothing.

use engine::Notes;
use glam::{DVec3, Vec3};

use super::contact::{self, Ground};
use super::objects::Objects;
use super::prepared::PreparedScene;
use super::reporting::{report_contact, report_no_ground};
use super::sunk::Sunk;
use super::touching::Touching;
use super::visibility::Probe;

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
    let on_ground = placed.iter().zip(&on_others).filter(|(_, on)| !**on);
    let on_ground: Vec<_> = on_ground.map(|(one, _)| one.clone()).collect();
    let (ground, levels) =
        Ground::measure((receiver, inverted), &on_ground, origin, up, metre, contact_metres);
    let mut levels = levels.into_iter();
    let measured: Vec<_> =
        on_others.iter().map(|on| if *on { None } else { levels.next().flatten() }).collect();
    let carried = objects.carried(placed, origin, up, metre);
    let tall: Vec<f64> =
        objects.boxes().iter().map(|one| (one.high - one.low).as_dvec3().dot(up.abs())).collect();
    report_contact(&measured, &carried, &tall, (metres_per_unit, contact_metres), notes);
    let over_nothing = |index: &usize| {
        let lost = measured[*index].is_none() && !carried[*index] && !on_others[*index];
        lost && contact::is_over_nothing(receiver, &placed[*index], origin, up, metre)
    };
    report_no_ground((0..placed.len()).filter(over_nothing), notes);
    let stands =
        |index: usize| measured[index].is_some_and(|level| contact::is_near(&level, metre)) || carried[index];
    Sunk::report(objects, receiver, stands, metres_per_unit, notes);
    objects.touching = Touching::of(objects, receiver, &ground);
    objects.ground = ground;
}
