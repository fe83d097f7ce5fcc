//! What `Auto` becomes, and what the user should know of it.

use engine::Notes;
use glam::{DVec3, Vec3};

use super::visibility::{Bounce, EnvBlock, NearField, SpecularSees};
use super::{In, PathTrace};
use crate::geometry::sampling::Points;
use crate::math::color::luminance;
use crate::math::num;
use crate::render::transport::ground::capture_point::{CapturePoint, stand_in};
use crate::render::transport::ground::light_share::share_past;
use crate::render::transport::ground::probe::Probe;
use crate::render::transport::path::integrator::{Integrator, Scene};
use crate::render::transport::path::path::Vertex;
use crate::render::transport::path::visibility::Rules;
use crate::render::transport::picture::prepared::PreparedScene;
use crate::render::transport::scene::block::Block;
use crate::render::transport::scene::block::EVERYWHERE;
use crate::render::transport::scene::frame::{in_scene_frame, scene_units};
use crate::render::transport::scene::objects::Objects;

/// Share of what the point of capture sees that the receiver must be for `near_field: Auto`: half of a ground. It is
/// judgement. With less, most of what the panorama shows near by is missing in the receiver.
const LEAST_HELD: f64 = 0.25;

/// What was decided, and what it was decided by.
pub(crate) struct Decided {
    pub(crate) rules: Rules,
    pub(crate) probe: Option<Probe>,
    /// What walls counted twice add, or would add; none where the receiver is a solid body anyway.
    pub(crate) twice: Option<f64>,
}

impl PathTrace {
    /// Decides what was left to `Auto`, and tells.
    pub(crate) fn decide(
        &self,
        inputs: &In,
        prepared: &PreparedScene<'_>,
        centre: DVec3,
        (up, metres_per_unit): (DVec3, f64),
        notes: &mut Notes,
    ) -> Decided {
        let from = in_scene_frame(centre, prepared.origin);
        let needs_probe = matches!(self.env_block, EnvBlock::Auto | EnvBlock::FrontFace { .. });
        let probe = needs_probe.then(|| Probe::send(prepared.receiver(), from));
        let (from, probe) = match probe {
            Some(probe) if inputs.env.origin.is_some() => {
                let mends = self.near_field != NearField::Off;
                let point = CapturePoint { at: from, probe };
                let camera = stand_in(prepared.receiver(), &inputs.rig.cameras, prepared.origin);
                let camera = in_scene_frame(camera.eye(), prepared.origin);
                let scene = (prepared.receiver(), camera);
                let CapturePoint { at, probe } = point.checked(scene, (up, metres_per_unit), mends, notes);
                (at, Some(probe))
            }
            probe => (from, probe),
        };
        let seen = |p: &Probe| {
            format!(
                "{:.1} % of {} probe rays leave, {:.1} % of the others meet a front face",
                100.0 * p.escaped_share(),
                p.rays,
                100.0 * p.front_share()
            )
        };
        let block = match (self.env_block, probe) {
            (EnvBlock::Solid, _) => Block::Solid,
            (EnvBlock::Pass, _) => Block::Pass,
            (EnvBlock::Paper, _) => Block::Solid,
            (EnvBlock::PassBeyond { metres }, _) => {
                Block::PassBeyond { centre: from.to_array(), radius: scene_units(metres, metres_per_unit) }
            }
            (EnvBlock::FrontFace { max_layers }, probe) => {
                if let Some(p) = probe.filter(|p| p.escaped < p.rays && p.front_share() <= 0.1) {
                    let text = format!("the normals seem to point out of the room: {}", seen(&p));
                    notes.warning("normals-outward", text);
                }
                Block::FrontFace { max_layers, flip: false, within: EVERYWHERE }
            }
            (EnvBlock::Auto, probe) => {
                let probe = probe.unwrap_or_default();
                let mut solid_light = None;
                let block = probe.decide(|| {
                    let sky = prepared.sky();
                    *solid_light.insert(share_past(sky, prepared.receiver(), from, &Block::Solid))
                });
                let name = match block {
                    Block::Solid => "Solid",
                    Block::FrontFace { flip: true, .. } => "FrontFace with normals turned round",
                    Block::FrontFace { .. } => "FrontFace",
                    _ => "Pass",
                };
                let mut text = format!("{name}: {}", seen(&probe));
                if let Some(share) = solid_light {
                    text += &format!("; a solid receiver lets in {:.1} % of the light", 100.0 * share);
                }
                if block != Block::Solid && probe.one_side() {
                    let lit = 100.0 * probe.lit_share();
                    text += &format!(
                        "; by FrontFace light comes to {lit:.1} % of them, past what stands in the room"
                    );
                }
                notes.decision("env-block", text);
                block
            }
        };
        let solid = block == Block::Solid;
        let left_to_us = self.env_block == EnvBlock::Auto
            && self.bounce == Bounce::Auto
            && self.object_specular_sees == SpecularSees::Auto;
        let held = probe.unwrap_or_default().held_share();
        let (near, why) = match (self.near_field, inputs.env.origin) {
            (NearField::On, _) if left_to_us => (true, "as set".to_owned()),
            (NearField::On, _) => (
                true,
                "as set, so that `env_block`, `bounce` and `object_specular_sees` have no say".to_owned(),
            ),
            (NearField::Off, _) => (false, "as set".to_owned()),
            (_, None) => (false, "the environment has no point of capture".to_owned()),
            (_, Some(_)) if !left_to_us => {
                (false, "the graph sets `env_block`, `bounce` or `object_specular_sees` itself".to_owned())
            }
            (_, Some(_)) if held < LEAST_HELD => {
                let held = 100.0 * held;
                (
                    false,
                    format!("the scene is open, and the receiver is {held:.1} % of what is seen from there"),
                )
            }
            (_, Some(_)) => {
                let held = 100.0 * held;
                (
                    true,
                    format!(
                        "the environment was captured in this place, of which the receiver is {held:.1} %"
                    ),
                )
            }
        };
        let text = if near {
            format!("On: {why}; a ray that meets the receiver finds what the panorama shows of that place")
        } else {
            format!("Off: {why}; light of the panorama comes from infinitely far")
        };
        notes.decision("near-field", text);
        let printed = self.env_block == EnvBlock::Paper;
        let rules = Rules {
            block,
            bounce_solid: match self.bounce {
                _ if printed => true,
                Bounce::Auto => solid,
                Bounce::Env => false,
                Bounce::Solid => true,
            },
            specular_env: match self.object_specular_sees {
                _ if printed => true,
                SpecularSees::Auto => !solid || inputs.env.origin.is_some(),
                SpecularSees::Env => true,
                SpecularSees::Receiver => false,
            },
            printed,
            near: near.then(|| from.to_array()),
            max_bounces: self.max_bounces,
            // The key takes no infinity.
            clamp: if self.clamp_indirect > 0.0 { self.clamp_indirect as f32 } else { f32::MAX },
        };
        let twice = (!solid).then(|| counted_twice(prepared, from, &rules));
        if let Some(twice) = twice.filter(|_| rules.bounce_solid && !near) {
            let text = "light of the room counts twice, in the environment and off its walls:";
            notes.warning("double-count", format!("{text} {:.0} % too much", 100.0 * twice));
        }
        Decided { rules, probe, twice }
    }
}

/// What is added to the light of the receiver, as the point of capture sees it, where its walls reflect the
/// environment that already shows them: a share of what there is without.
fn counted_twice(prepared: &PreparedScene<'_>, from: Vec3, rules: &Rules) -> f64 {
    let Ok(objects) = Objects::new(None, &[], prepared.origin) else { return 0.0 };
    let light = |bounce_solid| {
        let rules = Rules { bounce_solid, near: None, ..*rules };
        let scene = Scene {
            receiver: prepared.receiver(),
            objects: &objects,
            sky: prepared.sky(),
            rules: &rules,
            light_points: None,
        };
        let seen = Probe::rays(from).zip(0..).filter_map(|(ray, i)| {
            let hit = scene.receiver.bvh.closest(ray, |_| true)?;
            let mut integrator = Integrator::new(scene, Points::new(1, i), i, false);
            Some(luminance(integrator.radiance(Vertex::Receiver(hit), ray).to_array()))
        });
        num::ordered_sum(seen)
    };
    let once = light(false);
    if once > 0.0 { light(true) / once - 1.0 } else { 0.0 }
}
