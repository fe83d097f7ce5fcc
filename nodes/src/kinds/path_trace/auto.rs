//! Decision made for `surroundings: Auto`, and its report.

use engine::Notes;
use glam::Vec3;
use render::transport::ground::probe::Probe;
use render::transport::path::visibility::Rules;
use render::transport::scene::block::{Block, EVERYWHERE};
use render::transport::scene::frame::scene_units;

use super::surroundings::Surroundings;

/// Minimum share of the probe rays that must hit the mesh for `Auto` to become `Projected`. It is half of the share
/// that hits an infinite ground plane. This is a rule of thumb: below the minimum, most of the nearby surfaces that
/// the panorama shows are missing in the mesh.
const LEAST_HELD: f64 = 0.25;

/// Facts on which the decision is based.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facts {
    /// Hits of probe rays from the point of capture, if `surroundings` needs them.
    pub(super) probe: Option<Probe>,
    /// Point of capture, or position of the camera used in its place, in the frame of the scene.
    pub(super) from: Vec3,
    /// True if the environment contains its point of capture.
    pub(super) captured: bool,
    /// Metres per world unit.
    pub(super) metres_per_unit: f64,
}

/// Reason why the panorama is infinitely far away, or projected onto the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Reason {
    /// The graph sets `surroundings` to a choice that determines whether the panorama is projected.
    AsSet,
    /// The environment has no point of capture.
    NoCapture,
    /// Fewer than [`LEAST_HELD`] of the probe rays hit the mesh.
    TooOpen,
    /// The environment was captured inside the mesh.
    CapturedInside,
}

/// Decision on how the mesh and the panorama together model the place.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Decision {
    /// Rule by which the mesh blocks the light of a distant panorama.
    pub(super) block: Block,
    /// True if the mesh reflects light.
    pub(super) bounces: bool,
    /// True if rays reflected by objects pass through the mesh and show the panorama.
    pub(super) reflections_pass: bool,
    /// True for visibility as printed in the paper.
    pub(super) printed: bool,
    /// Whether the panorama is projected onto the mesh, and the reason.
    pub(super) projected: (bool, Reason),
    /// Share of the light that would reach the point of capture if the mesh were solid. `None` if it was not
    /// computed.
    pub(super) solid_light: Option<f64>,
}

impl Decision {
    /// Makes the decision. `solid_light` computes the share of the light that would reach the point of
    /// capture if the mesh were solid.
    pub(super) fn of(surroundings: Surroundings, facts: &Facts, solid_light: impl FnOnce() -> f64) -> Self {
        let probe = facts.probe.unwrap_or_default();
        let mut light = None;
        let (block, bounces) = match surroundings {
            Surroundings::Open { bounces } => (Block::Solid, Some(bounces)),
            Surroundings::Transparent { bounces } => (Block::Pass, Some(bounces)),
            Surroundings::Room { layers, bounces } => {
                (Block::FrontFace { max_layers: layers, flip: false, within: EVERYWHERE }, Some(bounces))
            }
            Surroundings::Within { metres, bounces } => {
                let radius = scene_units(metres, facts.metres_per_unit);
                (Block::PassBeyond { centre: facts.from.to_array(), radius }, Some(bounces))
            }
            Surroundings::Paper => (Block::Solid, Some(true)),
            Surroundings::Auto | Surroundings::Distant | Surroundings::Projected => {
                (probe.decide(|| *light.insert(solid_light())), None)
            }
        };
        let solid = block == Block::Solid;
        let printed = surroundings == Surroundings::Paper;
        let projected = match surroundings {
            Surroundings::Projected => (true, Reason::AsSet),
            Surroundings::Auto if !facts.captured => (false, Reason::NoCapture),
            Surroundings::Auto if probe.held_share() < LEAST_HELD => (false, Reason::TooOpen),
            Surroundings::Auto => (true, Reason::CapturedInside),
            _ => (false, Reason::AsSet),
        };
        Self {
            block,
            bounces: bounces.unwrap_or(solid),
            reflections_pass: printed || !solid || facts.captured,
            printed,
            projected,
            solid_light: light,
        }
    }

    /// Text of the choice of `surroundings` that is equivalent to the decision.
    pub(super) fn name(&self) -> String {
        let extra = |usual: bool| match self.bounces {
            bounces if bounces == usual => "",
            true => ", with bounces",
            false => ", without bounces",
        };
        match &self.block {
            _ if self.projected.0 => "Projected".to_owned(),
            _ if self.printed => "Paper".to_owned(),
            Block::Solid => format!("Open{}", extra(true)),
            Block::Pass => format!("Transparent{}", extra(false)),
            Block::FrontFace { max_layers, flip, .. } => {
                let side = if *flip { ", normals reversed" } else { "" };
                format!("Room(layers: {max_layers}){side}{}", extra(false))
            }
            Block::PassBeyond { radius, .. } => {
                format!("Within {radius} units of the point of capture{}", extra(false))
            }
        }
    }

    /// Rules of light transport that follow from the decision.
    pub(super) fn rules(&self, from: Vec3, max_bounces: u32, clamp_indirect: f64) -> Rules {
        Rules {
            block: self.block,
            bounce_solid: self.bounces,
            specular_env: self.reflections_pass,
            printed: self.printed,
            near: self.projected.0.then(|| from.to_array()),
            max_bounces,
            // Keys cannot hold infinity.
            clamp: if clamp_indirect > 0.0 { clamp_indirect as f32 } else { f32::MAX },
        }
    }

    /// Reports the decision, and the facts on which it is based.
    pub(super) fn report(&self, surroundings: Surroundings, probe: Option<&Probe>, notes: &mut Notes) {
        if let (Surroundings::Room { .. }, Some(probe)) = (surroundings, probe) {
            if probe.escaped < probe.rays && probe.front_share() <= 0.1 {
                let hint = "reverse the normals, or use `surroundings: Auto`";
                let text = format!("the mesh normals point out of the room ({}); {hint}", seen(probe));
                notes.warning("normals-outward", text);
            }
            return;
        }
        let decided =
            matches!(surroundings, Surroundings::Auto | Surroundings::Distant | Surroundings::Projected);
        let Some(probe) = probe.filter(|_| decided) else { return };
        let mut text = format!("{}: {}", self.name(), seen(probe));
        if let Some(share) = self.solid_light {
            text += &format!("; a solid mesh would let in {:.1} % of the light", 100.0 * share);
        }
        if !self.projected.0 && self.block != Block::Solid && probe.one_side() {
            let lit = 100.0 * probe.lit_share();
            text += &format!("; in a `Room`, light would arrive along {lit:.1} % of the probe rays");
        }
        text += match self.projected {
            (_, Reason::AsSet) => "",
            (_, Reason::NoCapture) => "; not Projected, since the environment has no point of capture",
            (_, Reason::TooOpen) => "; not Projected, since too few probe rays hit the mesh",
            (_, Reason::CapturedInside) => "; the environment was captured inside this mesh",
        };
        notes.decision("surroundings", text);
    }
}

/// Result of the probe rays in words.
fn seen(probe: &Probe) -> String {
    format!(
        "{:.1} % of {} probe rays miss the mesh, and {:.1} % of the others hit a front face",
        100.0 * probe.escaped_share(),
        probe.rays,
        100.0 * probe.front_share()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Result of 256 probe rays: `escaped` rays miss the mesh, `front` rays hit a front face, and along `lit` rays
    /// light would arrive in a closed room.
    fn probe(escaped: u32, front: u32, lit: u32) -> Probe {
        Probe { rays: 256, escaped, front, lit, room: EVERYWHERE }
    }

    /// Checks each row of the table of decisions. This test fails if `LEAST_HELD` is 0.0, if `captured` is ignored,
    /// or if the thresholds in `Probe::decide` are changed.
    #[test]
    fn each_place_is_decided() {
        use Surroundings::{Auto, Distant, Paper, Projected};
        let (room, outdoors, garden, mixed, dark) = (
            probe(0, 256, 256),
            probe(250, 6, 250),
            probe(128, 128, 128),
            probe(0, 128, 0),
            probe(0, 256, 10),
        );
        for (surroundings, probe, captured, light, expected) in [
            (Auto, room, true, 0.0, "Projected"),
            (Auto, room, false, 0.0, "Room(layers: 3)"),
            (Distant, room, true, 0.0, "Room(layers: 3)"),
            (Projected, outdoors, true, 1.0, "Projected"),
            (Auto, outdoors, true, 1.0, "Open"),
            (Auto, garden, true, 1.0, "Projected"),
            (Distant, garden, true, 1.0, "Open"),
            (Auto, garden, false, 0.1, "Room(layers: 3)"),
            (Auto, mixed, false, 0.0, "Transparent"),
            (Auto, dark, false, 0.0, "Transparent"),
            (Auto, probe(0, 0, 256), false, 0.0, "Room(layers: 3), normals reversed"),
            (Surroundings::OPEN, room, true, 0.0, "Open"),
            (Surroundings::Open { bounces: false }, room, true, 0.0, "Open, without bounces"),
            (Surroundings::ROOM, outdoors, true, 0.0, "Room(layers: 3)"),
            (Surroundings::Transparent { bounces: true }, room, true, 0.0, "Transparent, with bounces"),
            (
                Surroundings::Within { metres: 2.0, bounces: false },
                room,
                true,
                0.0,
                "Within 4 units of the point of capture",
            ),
            (Paper, room, true, 0.0, "Paper"),
        ] {
            let facts = Facts { probe: Some(probe), from: Vec3::ZERO, captured, metres_per_unit: 0.5 };
            let decision = Decision::of(surroundings, &facts, || light);
            assert_eq!(decision.name(), expected, "{surroundings:?}, {probe:?}");
        }
    }
}
