//! Probe rays: the first hits of rays in all directions from a point.

use glam::Vec3;

use crate::geometry::bvh::Ray;
use crate::geometry::sampling::{Points, circle};
use crate::transport::scene::block::{Block, LAYERS};
use crate::transport::scene::receiver::Receiver;

/// Minimum share of the light that a blocking rule must let in for [`Probe::decide`] to choose it.
const LEAST_LIGHT: f64 = 0.25;

/// Statistics of the first hits of probe rays from a point, usually the point of capture.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Probe {
    /// Number of rays.
    pub rays: u32,
    /// Number of rays that missed the receiver.
    pub escaped: u32,
    /// Number of rays that hit a front face.
    pub front: u32,
    /// Number of rays along which light would arrive if the receiver were a closed room, under the rule that
    /// [`decide`](Self::decide) chooses for closed rooms.
    pub lit: u32,
    /// Bounding box of the hits. In a closed place, this is the box of the room.
    pub room: [[f32; 3]; 2],
}

impl Probe {
    const RAYS: u32 = 256;

    /// Traces rays from a point in all directions.
    pub fn send(receiver: &Receiver, from: Vec3) -> Self {
        let mut probe = Self { rays: Self::RAYS, ..Self::default() };
        let (mut low, mut high) = (from, from);
        for ray in Self::rays(from) {
            match receiver.bvh.closest(ray, |_| true) {
                None => probe.escaped += 1,
                Some(hit) => {
                    probe.front += u32::from(!hit.back);
                    let place = from + ray.direction * hit.t;
                    low = low.min(place);
                    high = high.max(place);
                }
            }
        }
        probe.room = [low.to_array(), high.to_array()];
        let block = probe.front_face();
        probe.lit = Self::rays(from).map(|ray| u32::from(block.passes(receiver, ray))).sum();
        probe
    }

    /// Rays from the point `from`, spread over all directions.
    pub fn rays(from: Vec3) -> impl Iterator<Item = Ray> {
        (0..Self::RAYS).map(move |i| {
            let [u, v] = Points::new(0, i).pair(0);
            let z = 1.0 - 2.0 * v;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let (sin, cos) = circle(u);
            Ray::new(from, Vec3::new(r * cos, r * sin, z))
        })
    }

    /// Share of the rays that missed the receiver.
    pub fn escaped_share(&self) -> f64 {
        f64::from(self.escaped) / f64::from(self.rays.max(1))
    }

    /// True if the scene is open at the point: more than 5 % of the rays missed.
    pub fn is_open(&self) -> bool {
        self.escaped_share() > 0.05
    }

    /// Share of the rays that hit the receiver.
    pub fn held_share(&self) -> f64 {
        f64::from(self.rays - self.escaped) / f64::from(self.rays.max(1))
    }

    /// Share of front faces among the hits.
    pub fn front_share(&self) -> f64 {
        f64::from(self.front) / f64::from((self.rays - self.escaped).max(1))
    }

    /// Share of the rays along which light would arrive if the receiver were a closed room.
    pub fn lit_share(&self) -> f64 {
        f64::from(self.lit) / f64::from(self.rays.max(1))
    }

    /// True if at least 90 % of the hits were on the same side of the mesh.
    pub fn one_side(&self) -> bool {
        self.front_share() >= 0.9 || self.front_share() <= 0.1
    }

    /// Rule for a closed room, in which front faces are those on the side that most rays hit.
    fn front_face(&self) -> Block {
        Block::FrontFace { max_layers: LAYERS, flip: self.front_share() < 0.5, within: self.room }
    }

    /// Chooses the rule by which the receiver blocks light if the user sets none. `solid_light` computes the share
    /// of the light that a solid receiver lets in. The receiver is solid if more than 5 % of the rays miss it and
    /// it then lets in at least a quarter of the light. Otherwise, its front faces let light pass, as in a closed
    /// room, if at least 90 % of the hits are on one side and at least a quarter of the rays are lit under this
    /// rule. Otherwise, it blocks no light. These thresholds are rules of thumb, so the shares are reported.
    pub fn decide(&self, solid_light: impl FnOnce() -> f64) -> Block {
        if self.is_open() && solid_light() >= LEAST_LIGHT {
            Block::Solid
        } else if !self.one_side() || self.lit_share() < LEAST_LIGHT {
            Block::Pass
        } else {
            self.front_face()
        }
    }
}
