//! What rays in all directions from a point meet.

use glam::Vec3;

use crate::geometry::bvh::Ray;
use crate::geometry::sampling::{Points, circle};
use crate::render::transport::scene::block::{Block, LAYERS};
use crate::render::transport::scene::receiver::Receiver;

/// The share of the light that a rule must let in to be chosen.
const LEAST_LIGHT: f64 = 0.25;

/// What probe rays from the point of capture met first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Probe {
    /// Rays sent.
    pub rays: u32,
    /// Rays that left without meeting the receiver.
    pub escaped: u32,
    /// Rays that met a front face first.
    pub front: u32,
    /// Rays to which `FrontFace` would let light come, as [`decide`](Self::decide) would choose it.
    pub lit: u32,
    /// The box around the places that they met: the room, if it is one.
    pub room: [[f32; 3]; 2],
}

impl Probe {
    const RAYS: u32 = 256;

    /// Sends rays in all directions.
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

    /// Rays in all directions.
    pub fn rays(from: Vec3) -> impl Iterator<Item = Ray> {
        (0..Self::RAYS).map(move |i| {
            let [u, v] = Points::new(0, i).pair(0);
            let z = 1.0 - 2.0 * v;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let (sin, cos) = circle(u);
            Ray::new(from, Vec3::new(r * cos, r * sin, z))
        })
    }

    /// Share of the rays that left.
    pub fn escaped_share(&self) -> f64 {
        f64::from(self.escaped) / f64::from(self.rays.max(1))
    }

    /// Whether the scene is open there: over 5 % of the rays left.
    pub fn is_open(&self) -> bool {
        self.escaped_share() > 0.05
    }

    /// Share of the rays that met the receiver.
    pub fn held_share(&self) -> f64 {
        f64::from(self.rays - self.escaped) / f64::from(self.rays.max(1))
    }

    /// Share of front faces among what was met.
    pub fn front_share(&self) -> f64 {
        f64::from(self.front) / f64::from((self.rays - self.escaped).max(1))
    }

    /// Share of the rays to which `FrontFace` would let light come.
    pub fn lit_share(&self) -> f64 {
        f64::from(self.lit) / f64::from(self.rays.max(1))
    }

    /// Whether 90 % of what was met showed one side.
    pub fn one_side(&self) -> bool {
        self.front_share() >= 0.9 || self.front_share() <= 0.1
    }

    /// The rule for a closed room: fronts are on the side that most rays met.
    fn front_face(&self) -> Block {
        Block::FrontFace { max_layers: LAYERS, flip: self.front_share() < 0.5, within: self.room }
    }

    /// What `Auto` becomes, where a solid receiver lets a share of the light come. Over 5 % of sky means an open scene, if a
    /// quarter of the light comes from there and not from the walls; else 90 % of one side mean that the orientation of
    /// the mesh can be trusted, unless it then keeps out three quarters of the light. The bounds are judgement, so the
    /// report tells the shares.
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
