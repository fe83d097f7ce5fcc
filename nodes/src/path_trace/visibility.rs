//! How the receiver treats each sort of ray.
//!
//! One function, [`Block::passes`], decides whether light of the environment reaches a point past the
//! receiver. Light samples, scattered rays and the shadow all use it, so no energy is lost between them.

use engine::ParamType;
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::bsdf::Lobe;
use super::receiver::Receiver;
use crate::bvh::{Hit, Ray};
use crate::sampling::{Points, circle};

/// How the receiver blocks light of the environment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum EnvBlock {
    /// Decided by probe rays; see the report.
    Auto,
    /// Like any solid body: right for open scenes.
    Solid,
    /// Not at all.
    Pass,
    /// Rays pass faces seen from the front and stop at backs: in a closed mesh whose normals point into
    /// the room only the outer shell is transparent, furniture casts shadows.
    FrontFace {
        /// A ray that has passed this many front faces reaches the sky.
        #[serde(default = "three")]
        max_layers: u32,
    },
    /// What lies farther than this from the point of capture does not block.
    PassBeyond {
        /// The distance.
        metres: f64,
    },
    /// The indicator as the paper prints it, for comparison: solid to shadow and diffuse rays, not there for
    /// camera and glossy ones. It gives a closed room no light and no shadow; `bounce` and
    /// `object_specular_sees` have no say.
    Paper,
}

fn three() -> u32 {
    3
}

impl ParamType for EnvBlock {
    fn describe() -> String {
        "Auto | Solid | Pass | FrontFace(max_layers: 3) | PassBeyond(metres: number) | Paper".to_owned()
    }
}

impl EnvBlock {
    /// What its number must be, where it is not so.
    pub fn out_of_range(&self) -> Option<String> {
        match self {
            EnvBlock::PassBeyond { metres } if !metres.is_finite() || *metres < 0.0 => {
                Some(format!("`metres` must be at least 0, and is {metres}"))
            }
            EnvBlock::FrontFace { max_layers } if !(1..=MOST_LAYERS as u32).contains(max_layers) => {
                Some(format!("`max_layers` must lie between 1 and {MOST_LAYERS}, and is {max_layers}"))
            }
            _ => None,
        }
    }
}

engine::choices! {
    /// What a scattered ray finds where it meets the receiver.
    pub enum Bounce {
        /// `Solid` where the receiver blocks like a solid body, else `Env`.
        Auto,
        /// The environment behind it, which already shows the room: each light counts once.
        Env,
        /// The receiver, lit and matte.
        Solid,
    }
}

engine::choices! {
    /// What a reflection in an object shows where it meets the receiver.
    pub enum SpecularSees {
        /// `Env` where the environment was captured in the place or the receiver lets it through, else
        /// `Receiver`.
        Auto,
        /// The environment, which is sharper than a mesh of vertex colours.
        Env,
        /// The receiver.
        Receiver,
    }
}

engine::choices! {
    /// Whether the receiver is the light that the environment shows of it.
    pub enum NearField {
        /// `On` where the environment was captured in a place of which the receiver is a quarter or more, and
        /// `env_block`, `bounce` and `object_specular_sees` are left to `Auto`.
        Auto,
        /// Rays that meet the receiver find what the environment shows in the direction of that place, seen
        /// from the point of capture. The other rules of visibility have no say then.
        On,
        /// The environment is infinitely far.
        Off,
    }
}

/// Most layers of front faces that can be counted.
pub const MOST_LAYERS: usize = 16;

/// [`EnvBlock`] after `Auto` was decided, in the frame of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum Block {
    /// See [`EnvBlock::Solid`].
    Solid,
    /// See [`EnvBlock::Pass`].
    Pass,
    /// See [`EnvBlock::FrontFace`]; `flip` where the normals point out of the room.
    FrontFace {
        /// Front faces that end the search.
        max_layers: u32,
        /// Backs count as fronts.
        flip: bool,
        /// What lies outside of this box has no say: the outer side of a wall, the next room. For all that the user says
        /// himself it is [`EVERYWHERE`].
        within: [[f32; 3]; 2],
    },
    /// See [`EnvBlock::PassBeyond`].
    PassBeyond {
        /// The point of capture.
        centre: [f32; 3],
        /// In world units.
        radius: f32,
    },
}

/// The box that holds everything; the key takes no infinity.
pub const EVERYWHERE: [[f32; 3]; 2] = [[-f32::MAX; 3], [f32::MAX; 3]];

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
        Block::FrontFace { max_layers: three(), flip: self.front_share() < 0.5, within: self.room }
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

/// The receiver's part in light transport, decided.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rules {
    /// How it blocks the environment.
    pub block: Block,
    /// Scattered rays meet it as a lit surface.
    pub bounce_solid: bool,
    /// Reflections in objects pass it and show the environment.
    pub specular_env: bool,
    /// Whether the camera sees it, and shadow rays of reflections meet it though reflections do not: the
    /// printed indicator.
    pub printed: bool,
    /// The point of capture, in the frame of the scene, where the receiver is the light: see
    /// [`super::near_field`].
    pub near: Option<[f32; 3]>,
    /// How many times light may be scattered after the first time.
    pub max_bounces: u32,
    /// Largest channel of one contribution after the first vertex of a path; infinite for no limit.
    pub clamp: f32,
}

impl Rules {
    /// A contribution of the vertex after `bounce` scatterings, scaled down to the limit where it is over.
    #[inline]
    pub fn clamped(&self, bounce: u32, light: Vec3) -> Vec3 {
        let largest = light.max_element();
        if bounce == 0 || largest <= self.clamp { light } else { light * (self.clamp / largest) }
    }
}

/// How the receiver appears to rays that leave a surface by one lobe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility {
    /// How it blocks the environment from a scattered ray.
    pub block: Block,
    /// How it blocks the environment from a shadow ray: alike, or light would be lost (see the notes of
    /// `docs/light-transport.md`), except as printed.
    pub shadow: Block,
    /// Whether the scattered ray goes on from it.
    pub lands: bool,
}

impl Rules {
    /// Whether no light of the sky passes the receiver to any lobe.
    #[inline]
    pub fn is_solid(&self) -> bool {
        self.near.is_some() || self.printed || (self.block == Block::Solid && !self.specular_env)
    }

    /// The row of the table for rays of a lobe. Rows: diffuse rays of the receiver and of objects, and
    /// specular rays of objects that see the environment or the receiver. The receiver has no specular
    /// lobe, and the objects are solid to every ray.
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

impl Block {
    /// Whether light of the environment reaches the start of a ray past the receiver.
    pub fn passes(&self, receiver: &Receiver, ray: Ray) -> bool {
        match *self {
            Block::Pass => true,
            Block::Solid => !receiver.bvh.any(ray, |_| true),
            Block::PassBeyond { centre, radius } => !receiver.bvh.any(ray, |hit| {
                (ray.origin + ray.direction * hit.t - Vec3::from_array(centre)).length() <= radius
            }),
            Block::FrontFace { max_layers, flip, within: [low, high] } => {
                let [low, high] = [low, high].map(Vec3::from_array);
                let outside = |hit: &Hit| {
                    let place = ray.origin + ray.direction * hit.t;
                    place.cmplt(low).any() || place.cmpgt(high).any()
                };
                // One walk over all hits: the nearest back blocks unless enough fronts lie before it.
                let mut fronts = [f32::INFINITY; MOST_LAYERS];
                let layers = (max_layers as usize).clamp(1, MOST_LAYERS);
                let mut back = f32::INFINITY;
                receiver.bvh.any(ray, |hit| {
                    if outside(hit) {
                        return false;
                    }
                    if hit.back != flip {
                        back = back.min(hit.t);
                    } else {
                        // Keeps the nearest ones in order; an edge met twice counts once.
                        let mut t = hit.t;
                        for slot in &mut fronts[..layers] {
                            if t == *slot {
                                break;
                            }
                            if t < *slot {
                                std::mem::swap(&mut t, slot);
                            }
                        }
                    }
                    false
                });
                back >= fronts[layers - 1]
            }
        }
    }
}

/// Distance in the scene for a distance in metres.
pub fn scene_units(metres: f64, metres_per_unit: f64) -> f32 {
    (metres / metres_per_unit) as f32
}

/// A point in the frame of the scene.
pub fn in_scene_frame(point: DVec3, origin: DVec3) -> Vec3 {
    (point - origin).as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::Mesh;

    /// Squares across the x axis; a negative x stands for one at -x whose back is seen from the origin.
    fn squares(at: &[f32]) -> Receiver {
        let mut mesh = Mesh::default();
        for &x in at {
            let first = mesh.positions.len() as u32;
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            mesh.positions.extend(corners.map(|[y, z]| [x.abs(), y, z]));
            let [a, b, c, d] = [0, 1, 2, 3].map(|i| first + i);
            // Counter-clockwise seen from the origin is the front.
            mesh.triangles.extend(if x < 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
        Receiver::new(&mesh, DVec3::ZERO)
    }

    /// Every way to block against everything that a ray may meet. Rows are those of docs/light-transport.md.
    #[test]
    fn row_46_what_lets_the_environment_through() {
        let nothing = squares(&[]);
        let shell = squares(&[2.0]);
        let furniture = squares(&[1.0, -1.5, 2.0]);
        let back = squares(&[-1.0]);
        let layers = squares(&[0.5, 1.0, 1.2, -1.5]);
        // A ray through an edge meets both of its triangles, in one place.
        let edge = squares(&[0.5, 0.5, 1.0, -1.5]);
        let receivers = [&nothing, &shell, &furniture, &back, &layers, &edge];
        let front = |max_layers, flip| Block::FrontFace { max_layers, flip, within: EVERYWHERE };
        let beyond = |radius| Block::PassBeyond { centre: [0.0; 3], radius };
        let (t, f) = (true, false);
        for (block, expected) in [
            (Block::Solid, [t, f, f, f, f, f]),
            (Block::Pass, [t, t, t, t, t, t]),
            (front(3, false), [t, t, f, f, t, f]),
            (front(4, false), [t, t, f, f, f, f]),
            (front(1, false), [t, t, t, f, t, t]),
            (front(3, true), [t, f, f, t, f, f]),
            (beyond(1.25), [t, t, f, f, f, f]),
            (beyond(0.25), [t, t, t, t, t, t]),
            (beyond(3.0), [t, f, f, f, f, f]),
        ] {
            let ray = Ray::new(Vec3::ZERO, Vec3::new(1.0, 0.01, 0.02).normalize());
            let got = receivers.map(|receiver| block.passes(receiver, ray));
            assert_eq!(got, expected, "{block:?}");
        }
    }

    /// Every ray by every rule: what a scattered ray and a shadow ray find at the receiver.
    #[test]
    fn row_46_each_ray_sees_the_receiver_by_its_rule() {
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
