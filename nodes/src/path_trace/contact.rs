//! Where objects stand: the mesh of the place, made level with their bases for the camera.
//!
//! A mesh from a capture misses the true ground by some millimetres. Where it lies too low the camera looks
//! into a gap under the object, which draws a black line; where it lies too high it hides the object's foot.
//! What the camera sees is the true place, so a hit of one of its rays that is as high as the base of an
//! object, to the error of the mesh, is moved along the ray to the height of the base: there the light that
//! objects take away is judged, and there the object is in front or behind. What the receiver itself
//! shades stays where it is, so R0 depends on no object.

use glam::{DMat3, DVec3, Vec3};

use super::scene::Receiver;
use crate::bvh::Ray;
use crate::types::Placed;

/// Rays a side of the grid that feels the ground under an object.
const GRID: u32 = 16;
/// Share of those rays that must find ground for an object to stand on it.
const FOUND: f64 = 0.25;
/// Cosine of the steepest ground.
const STEEPEST: f32 = 0.7;
/// The largest error of a mesh that is believed without being told, in metres.
const LARGEST: f64 = 0.05;
/// A mesh smoother than this is taken as it is, in metres.
const SMOOTHEST: f64 = 1e-4;

/// What one object stands on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    low: Vec3,
    high: Vec3,
    /// Height of the base along up, in the frame of the scene.
    height: f32,
    /// The mesh's error: hits this near in height belong to the ground; up to twice as far, in part.
    reach: f32,
}

/// What the ground under an object is found to be, in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Felt {
    /// Median height of the mesh over the base of the object.
    pub offset: f64,
    /// Roughness: standard deviation of heights about their plane, by the median deviation.
    pub roughness: f64,
}

/// The supports of all objects.
#[derive(Debug, Clone, Default)]
pub struct Ground {
    up: Vec3,
    supports: Vec<Support>,
}

/// Corners of an object's triangles in the frame of the scene.
fn corners(placed: &Placed, origin: DVec3) -> impl Iterator<Item = DVec3> {
    let used = placed.object.primitives.iter().flat_map(|primitive| {
        primitive.triangles.iter().flatten().filter_map(|&i| primitive.positions.get(i as usize))
    });
    let place = move |p: &[f32; 3]| {
        placed.world_from_object.transform_point3(DVec3::from_array(p.map(f64::from))) - origin
    };
    used.map(place).filter(|p| p.is_finite())
}

/// The box around some points.
fn around(points: impl Iterator<Item = DVec3>) -> Option<(DVec3, DVec3)> {
    points.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))
}

impl Ground {
    /// Feels the ground under every object. `metre` is its length in world units; `fixed` an error in metres
    /// that the user knows better, 0 for a mesh without. Gives what was found for each object.
    pub fn feel(
        receiver: &Receiver,
        objects: &[impl AsRef<Placed>],
        origin: DVec3,
        up: DVec3,
        metre: f64,
        fixed: Option<f64>,
    ) -> (Self, Vec<Option<Felt>>) {
        let mut ground = Self { up: up.as_vec3(), supports: Vec::new() };
        let mut found = Vec::with_capacity(objects.len());
        for placed in objects {
            let Some((low, high)) = around(corners(placed.as_ref(), origin)) else {
                found.push(None);
                continue;
            };
            let (base, top) = (low.dot(up).min(high.dot(up)), low.dot(up).max(high.dot(up)));
            let felt = match fixed {
                Some(_) => None,
                None => {
                    // The foot is what lies in the lowest fiftieth, or some of the middle for a point.
                    let slice = base + 0.02 * (top - base);
                    let lowest = corners(placed.as_ref(), origin).filter(|p| p.dot(up) <= slice);
                    let (a, b) = around(lowest).unwrap_or((low, high));
                    let half = ((b - a) * 0.75).max((high - low) * 0.125);
                    under(receiver, (a + b) * 0.5, half, up, base, LARGEST * metre)
                }
            };
            let reach = match (fixed, felt) {
                (Some(metres), _) => metres * metre,
                (None, Some(felt)) if felt.roughness > SMOOTHEST * metre => {
                    (felt.offset.abs() + 3.0 * felt.roughness).min(LARGEST * metre)
                }
                _ => 0.0,
            };
            if reach > 0.0 {
                let (low, high) = (low.as_vec3(), high.as_vec3());
                ground.supports.push(Support { low, high, height: base as f32, reach: reach as f32 });
            }
            found.push(felt);
        }
        (ground, found)
    }

    /// How far a camera's hit must move along its unit ray to lie on the ground of the object that is
    /// nearest to it (the first of equally near ones); 0 where it belongs to no ground.
    pub fn shift(&self, position: Vec3, normal: Vec3, direction: Vec3) -> f32 {
        let (steep, height) = (normal.dot(self.up).abs(), position.dot(self.up));
        let fall = direction.dot(self.up);
        if steep < STEEPEST || fall == 0.0 {
            return 0.0;
        }
        let aside = |s: &Support| {
            let out = (s.low - position).max(position - s.high).max(Vec3::ZERO);
            (out - self.up * out.dot(self.up)).length_squared()
        };
        let near = self.supports.iter().filter(|s| (s.height - height).abs() < 2.0 * s.reach);
        let Some(support) = near.min_by(|a, b| aside(a).total_cmp(&aside(b))) else { return 0.0 };
        let error = support.height - height;
        // The whole of it up to the reach, then less, to none at twice the reach.
        let whole = error.clamp(-support.reach, support.reach);
        let part = whole - (error - whole).clamp(-support.reach, support.reach);
        // A ray that hardly falls would run far; it moves ten times its height at most.
        let way = part / fall;
        way.clamp(-10.0 * part.abs(), 10.0 * part.abs())
    }
}

/// Heights of the mesh under a foot, by rays straight down over a grid.
fn under(
    receiver: &Receiver,
    middle: DVec3,
    half: DVec3,
    up: DVec3,
    base: f64,
    largest: f64,
) -> Option<Felt> {
    let across = if up.x.abs() > 0.5 { DVec3::Y } else { DVec3::X };
    let along = up.cross(across).abs();
    let mut heights = Vec::new();
    for k in 0..GRID * GRID {
        let [u, v] = [k % GRID, k / GRID].map(|i| (f64::from(2 * i + 1) / f64::from(GRID)) - 1.0);
        let (x, y) = (u * half.dot(across), v * half.dot(along));
        let flat = middle - up * middle.dot(up) + across * x + along * y;
        let start = (flat + up * (base + largest)).as_vec3();
        let ray = Ray { t_max: (2.0 * largest) as f32, ..Ray::new(start, -up.as_vec3()) };
        if let Some(hit) = receiver.bvh.closest(ray, |_| true)
            && receiver.normal(hit.triangle).dot(up.as_vec3()).abs() >= STEEPEST
        {
            heights.push((x, y, largest - f64::from(hit.t)));
        }
    }
    if (heights.len() as f64) < FOUND * f64::from(GRID * GRID) {
        return None;
    }
    let offset = median(heights.iter().map(|h| h.2).collect());
    // The plane through them by least squares; a slope is no roughness.
    let (mut moments, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for &(x, y, z) in &heights {
        let row = DVec3::new(x, y, 1.0);
        moments += DMat3::from_cols(row * x, row * y, row);
        right += row * z;
    }
    let plane = if moments.determinant() > 0.0 { moments.inverse() * right } else { DVec3::Z * offset };
    let plane = if plane.is_finite() { plane } else { DVec3::Z * offset };
    let away = heights.iter().map(|&(x, y, z)| (z - plane.dot(DVec3::new(x, y, 1.0))).abs()).collect();
    // 1.4826 makes the median deviation of a normal distribution its standard deviation.
    Some(Felt { offset, roughness: 1.4826 * median(away) })
}

/// The upper median of some finite numbers, 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::sampling::{mix, unit};
    use crate::types::{Mesh, Object, Primitive};

    /// A square of 40 x 40 cells, 2 wide, at heights given by a function of the vertex.
    fn ground(height: impl Fn(u32, f32) -> f32) -> Mesh {
        let side = 41_u32;
        let mut mesh = Mesh::default();
        for i in 0..side * side {
            let [x, y] = [i % side, i / side].map(|k| k as f32 / 20.0 - 1.0);
            mesh.positions.push([x, y, height(i, x)]);
        }
        for i in (0..side * (side - 1)).filter(|i| i % side + 1 < side) {
            mesh.triangles.extend([[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]);
        }
        mesh
    }

    fn slab(z: f64) -> Arc<Placed> {
        let mut primitive = Primitive::default();
        for i in 0..8_u32 {
            primitive
                .positions
                .push([0, 1, 2].map(|k| (i >> k & 1) as f32 * 0.4 - if k < 2 { 0.2 } else { 0.0 }));
        }
        primitive.triangles = vec![[0, 1, 2], [3, 4, 5], [6, 7, 0]];
        let object = Object { primitives: vec![primitive], ..Object::default() };
        let world_from_object = glam::DMat4::from_translation(DVec3::Z * z);
        Arc::new(Placed { object: Arc::new(object), world_from_object })
    }

    fn felt(mesh: &Mesh, z: f64) -> (Ground, Option<Felt>) {
        let receiver = Receiver::new(mesh, DVec3::ZERO);
        let (ground, found) = Ground::feel(&receiver, &[slab(z)], DVec3::ZERO, DVec3::Z, 1.0, None);
        (ground, found[0])
    }

    fn noise(i: u32) -> f32 {
        unit(mix(i)) * 0.02 - 0.01
    }

    #[test]
    fn a_smooth_mesh_is_believed_and_a_rough_one_is_not() {
        for mesh in [ground(|_, _| 0.0), ground(|_, x| 0.1 * x)] {
            let (level, found) = felt(&mesh, 0.01);
            assert!(level.supports.is_empty() && found.expect("ground").roughness < 1e-6);
        }
        let (rough, found) = felt(&ground(|i, _| noise(i) - 0.005), 0.0);
        let found = found.expect("ground");
        assert!(
            (0.002..0.008).contains(&found.roughness) && (found.offset + 0.005).abs() < 0.003,
            "{found:?}"
        );
        assert!((0.012..0.04).contains(&rough.supports[0].reach));
        assert_eq!(felt(&ground(|i, _| noise(i)), 0.3).1, None, "nothing under it");
    }

    // A hit of the camera lands at the height of the base, whatever the mesh has there.
    #[test]
    fn hits_move_along_the_ray_to_the_base() {
        let (ground, _) = felt(&ground(|i, _| noise(i)), 0.0);
        let reach = ground.supports[0].reach;
        let ray = Vec3::new(0.6, 0.0, -0.8);
        for error in [-0.9, -0.2, 0.0, 0.5, 0.99_f32] {
            let at = Vec3::new(0.5, 0.2, error * reach);
            assert!((at + ray * ground.shift(at, Vec3::Z, ray)).z.abs() < 1e-6, "{error}");
        }
        // Without a jump to nothing at twice the reach, on walls, and for rays along the ground.
        let shift = |z: f32, normal, ray| ground.shift(Vec3::new(0.5, 0.2, z), normal, ray);
        assert!((shift(1.5 * reach, Vec3::Z, ray) - 0.5 * reach / 0.8).abs() < 1e-6);
        assert_eq!(shift(2.0 * reach, Vec3::Z, ray), 0.0);
        assert_eq!(shift(0.5 * reach, Vec3::X, ray), 0.0);
        assert_eq!(shift(0.5 * reach, Vec3::Z, Vec3::X), 0.0);
        let grazing = Vec3::new(1.0, 0.0, -1e-6);
        assert!(shift(0.5 * reach, Vec3::Z, grazing).abs() <= 5.0 * reach);
    }
}
