//! What `Auto` becomes, and what the user should know of it.

use engine::Notes;
use glam::DVec3;

use super::PathTrace;
use super::rules::{self, Block, Bounce, EnvBlock, Probe, Rules, SpecularSees};
use super::stage::Stage;

impl PathTrace {
    /// Decides what was left to `Auto`, and tells.
    pub(super) fn decide(
        &self,
        stage: &Stage<'_>,
        centre: DVec3,
        metres_per_unit: f64,
        notes: &mut Notes,
    ) -> (Rules, Option<Probe>) {
        let from = rules::framed(centre, stage.origin);
        let needs_probe = matches!(self.env_block, EnvBlock::Auto | EnvBlock::FrontFace { .. });
        let probe = needs_probe.then(|| Probe::send(stage.receiver(), from));
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
                Block::PassBeyond { centre: from.to_array(), radius: rules::units(metres, metres_per_unit) }
            }
            (EnvBlock::FrontFace { max_layers }, probe) => {
                if let Some(p) = probe.filter(|p| p.escaped < p.rays && p.front_share() <= 0.1) {
                    let text = format!("the normals seem to point out of the room: {}", seen(&p));
                    notes.warning("normals-outward", text);
                }
                Block::FrontFace { max_layers, flip: false }
            }
            (EnvBlock::Auto, probe) => {
                let probe = probe.unwrap_or_default();
                let block = probe.decide();
                let name = match block {
                    Block::Solid => "Solid",
                    Block::FrontFace { flip: true, .. } => "FrontFace with normals turned round",
                    Block::FrontFace { .. } => "FrontFace",
                    _ => "Pass",
                };
                notes.decision("env-block", format!("{name}: {}", seen(&probe)));
                block
            }
        };
        let solid = block == Block::Solid;
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
                SpecularSees::Auto => !solid || stage.inputs.env.origin.is_some(),
                SpecularSees::Env => true,
                SpecularSees::Receiver => false,
            },
            printed,
            max_bounces: self.max_bounces,
            // The key takes no infinity.
            clamp: if self.clamp_indirect > 0.0 { self.clamp_indirect as f32 } else { f32::MAX },
        };
        if rules.bounce_solid && block != Block::Solid {
            // Each bounce returns the albedo's share of what falls on a wall: in a closed room all of them
            // together a / (1 - a), at most.
            let albedo = stage.receiver().mean_albedo();
            let most = 100.0 * albedo / (1.0 - albedo).max(1e-3);
            let text = format!(
                "light of the room counts twice, in the environment and off its walls: up to {most:.0} % too much"
            );
            notes.warning("double-count", text);
        }
        (rules, probe)
    }
}
