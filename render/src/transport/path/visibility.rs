//! Visibility of the receiver for each kind of ray.

use glam::Vec3;
use serde::Serialize;

use crate::transport::bsdf::Lobe;
use crate::transport::scene::block::Block;

/// Role of the receiver in light transport.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rules {
    /// Rule by which the receiver blocks the environment.
    pub block: Block,
    /// True if diffuse rays hit the receiver as a lit surface.
    pub bounce_solid: bool,
    /// True if specular rays, of objects or of a glossy receiver, pass through the receiver and show the environment.
    pub specular_env: bool,
    /// True if the visibility is the one printed in the LightHarmony3D paper: the receiver is invisible to the
    /// camera, and blocks shadow rays at reflecting surfaces but not the reflected rays themselves.
    pub printed: bool,
    /// Point of capture in the frame of the scene, if near light is used; see [`super::near_field`].
    pub near: Option<[f32; 3]>,
    /// Maximum number of scatterings after the first.
    pub max_bounces: u32,
    /// Limit of each channel of a contribution after the first vertex of a path; `f32::MAX` for no limit.
    pub clamp: f32,
}

impl Rules {
    /// Contribution `light` of the vertex after `bounce` scatterings, scaled down if it exceeds the limit.
    #[inline]
    pub fn clamped(&self, bounce: u32, light: Vec3) -> Vec3 {
        let largest = light.max_element();
        if bounce == 0 || largest <= self.clamp { light } else { light * (self.clamp / largest) }
    }
}

/// Visibility of the receiver for rays that leave a surface by one class of lobes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility {
    /// Rule by which the receiver blocks the environment for a scattered ray.
    pub block: Block,
    /// Rule by which the receiver blocks the environment for a shadow ray. It equals the rule for scattered rays,
    /// since light would be lost otherwise (see `docs/light-transport.md`). Only the visibility printed in the
    /// paper uses two different rules.
    pub shadow: Block,
    /// True if a scattered ray that hits the receiver continues the path from there.
    pub lands: bool,
}

impl Rules {
    /// True if light of the sky never passes through the receiver.
    #[inline]
    pub fn is_solid(&self) -> bool {
        self.near.is_some() || self.printed || (self.block == Block::Solid && !self.specular_env)
    }

    /// Visibility of the receiver for the rays of a class of lobes. Diffuse rays start on the receiver and on
    /// objects. Specular rays start on objects and on glossy parts of the receiver; they show either the environment or
    /// the receiver. Objects are solid to every ray.
    #[inline]
    pub fn visibility(&self, lobe: Lobe) -> Visibility {
        let alike = |block, lands| Visibility { block, shadow: block, lands };
        match lobe {
            _ if self.near.is_some() => alike(Block::Solid, true),
            Lobe::Diffuse => alike(self.block, self.bounce_solid),
            Lobe::Specular if self.printed => {
                Visibility { shadow: Block::Solid, ..alike(Block::Pass, false) }
            }
            Lobe::Specular if self.specular_env => alike(Block::Pass, false),
            Lobe::Specular => alike(Block::Solid, true),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::scene::block::EVERYWHERE;

    /// Tests the results of a scattered ray and a shadow ray at the receiver, for each class of rays and each
    /// rule.
    #[test]
    fn each_ray_sees_the_receiver_by_its_rule() {
        let rules = |block, bounce_solid, specular_env, printed| Rules {
            block,
            bounce_solid,
            specular_env,
            printed,
            near: None,
            max_bounces: 1,
            clamp: f32::MAX,
        };
        let visibility = |block, shadow, lands| Visibility { block, shadow, lands };
        let front = Block::FrontFace { max_layers: 3, flip: false, within: EVERYWHERE };
        for block in [Block::Solid, Block::Pass, front] {
            for bounce in [false, true] {
                for (env, specular) in [(true, (Block::Pass, false)), (false, (Block::Solid, true))] {
                    let rules = rules(block, bounce, env, false);
                    assert_eq!(rules.visibility(Lobe::Diffuse), visibility(block, block, bounce));
                    assert_eq!(
                        rules.visibility(Lobe::Specular),
                        visibility(specular.0, specular.0, specular.1)
                    );
                }
            }
        }
        let near = Rules { near: Some([0.0; 3]), ..rules(Block::Pass, false, true, false) };
        for lobe in [Lobe::Diffuse, Lobe::Specular] {
            assert_eq!(near.visibility(lobe), visibility(Block::Solid, Block::Solid, true));
        }
        let printed = rules(Block::Solid, true, true, true);
        assert_eq!(printed.visibility(Lobe::Diffuse), visibility(Block::Solid, Block::Solid, true));
        assert_eq!(printed.visibility(Lobe::Specular), visibility(Block::Pass, Block::Solid, false));
    }
}
