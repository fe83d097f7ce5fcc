//! Rules by which the receiver mesh blocks light of the environment.
//!
//! One function, [`Block::passes`], decides whether the receiver lets environment light through to a point. Light
//! samples, scattered rays and shadow rays all use it, so that multiple importance sampling loses no energy.

use glam::Vec3;
use serde::Serialize;

use super::receiver::Receiver;
use crate::geometry::bvh::{Hit, Ray};

/// Maximum number of front-face layers that can be counted.
pub const MOST_LAYERS: usize = 16;
/// Default number of front-face layers.
pub const LAYERS: u32 = 3;

/// A rule by which the receiver blocks light of the environment, in the frame of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum Block {
    /// Every surface blocks light.
    Solid,
    /// No surface blocks light.
    Pass,
    /// Front faces let light pass and back faces block it.
    FrontFace {
        /// Number of front faces after which a ray counts as outside.
        max_layers: u32,
        /// True if the normals point out of the room, so that back faces count as front faces.
        flip: bool,
        /// Box of the room. Surfaces outside it are ignored, such as the outer side of a wall or the next room.
        /// [`EVERYWHERE`] unless the room was measured.
        within: [[f32; 3]; 2],
    },
    /// Surfaces farther than `radius` from the point of capture do not block light.
    PassBeyond {
        /// The point of capture.
        centre: [f32; 3],
        /// Radius in world units.
        radius: f32,
    },
}

/// Box that contains all points. It is finite, since keys cannot contain infinity.
pub const EVERYWHERE: [[f32; 3]; 2] = [[-f32::MAX; 3], [f32::MAX; 3]];

impl Block {
    /// True if the receiver lets environment light through to the origin of a ray.
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
                // One traversal over all hits: the nearest back face blocks unless enough front faces lie before
                // it.
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
                        // Keeps the nearest distances in order; an edge hit twice counts once.
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

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use scene::types::Mesh;

    /// Squares perpendicular to the x axis at the given positions. A negative position x gives a square at -x whose
    /// back faces the origin.
    fn squares(at: &[f32]) -> Receiver {
        let mut mesh = Mesh::default();
        for &x in at {
            let first = mesh.positions.len() as u32;
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            mesh.positions.extend(corners.map(|[y, z]| [x.abs(), y, z]));
            let [a, b, c, d] = [0, 1, 2, 3].map(|i| first + i);
            // Front faces are counter-clockwise seen from the origin.
            mesh.triangles.extend(if x < 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
        Receiver::new(&mesh, DVec3::ZERO)
    }

    /// Tests each rule with each arrangement of surfaces. The rows are those of the table in
    /// docs/light-transport.md.
    #[test]
    fn what_lets_the_environment_through() {
        let nothing = squares(&[]);
        let shell = squares(&[2.0]);
        let furniture = squares(&[1.0, -1.5, 2.0]);
        let back = squares(&[-1.0]);
        let layers = squares(&[0.5, 1.0, 1.2, -1.5]);
        // A ray through an edge hits both triangles at one point.
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
}
