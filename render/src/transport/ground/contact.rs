//! Contact: for camera rays, the surface of the receiver mesh is moved to the bases of objects.
//!
//! Captured meshes miss the true ground by some millimetres. Where the mesh is too low, the camera looks into a gap
//! under the object, which appears as a black line; where it is too high, it hides the foot of the object. The
//! picture shows the true place. A camera hit whose height differs from that of an object's base by no more than
//! the error of the mesh is therefore moved along its ray to the base. At the moved point, the change of light is
//! estimated and the depth is compared with the depth of objects. The receiver itself is shaded at the original
//! hit, so the picture without objects does not depend on objects. If the mesh covers a foot, rays from the foot to
//! the receiver start just above the mesh, at the height of the original hits; from below they would see the
//! outside of a closed room.
//!
//! The same applies to a flat side with which an object rests on a wall, a ceiling or a roof: see `side`.

use glam::DVec3;
use scene::types::Placed;

use super::limits::{LARGEST, SMOOTHEST};
use super::side::Side;
use crate::geometry::support::GroundPlane;
use crate::transport::scene::receiver::Receiver;
use crate::transport::scene::supports::{Ground, STEEPEST, Support};

/// Maximum distance, in metres, at which the ground below an object is searched for, so that the gap below an
/// object that does not stand on the ground can be reported.
const FARTHEST: f64 = 0.5;
/// True if the mesh is close enough to the base of an object to support it; `metre` is the length of a metre in
/// world units.
pub(crate) fn is_near(measured: &GroundPlane, metre: f64) -> bool {
    measured.height.abs() <= LARGEST * metre
}

/// Supports found for an object.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Measured {
    /// Level of the ground below the object, even if it is too far away to support the object.
    pub ground: Option<GroundPlane>,
    /// Levels of the surfaces that the flat sides of the object rest on.
    pub sides: Vec<GroundPlane>,
}

/// Converts a side of an object to a [`Support`] in the frame of the scene. `reach` is the error of the mesh in
/// world units, which is 0 for a smooth mesh.
fn support(side: &Side, reach: f64, origin: DVec3, metre: f64) -> Support {
    let [low, high] = [side.low, side.high].map(|p| (p - origin).as_vec3());
    let height = (side.height - origin.dot(side.out)) as f32;
    let claims = if reach > 0.0 { 2.0 * reach } else { LARGEST * metre };
    let [reach, claims] = [reach, claims].map(|v| v as f32);
    Support { out: side.out.as_vec3(), low, high, height, reach, claims }
}

/// Measures the ground under each object that may stand on it, and the surfaces that the flat sides of the objects
/// rest on. The flag in `receiver` is true if the normals of the mesh point away from the viewer. The flag of each
/// object is true if the object may stand on the receiver. `metre` is the length of a metre in world units. `fixed`
/// is the error of the mesh in metres if the user gave it; 0 means an exact mesh.
pub fn measure(
    receiver: (&Receiver, bool),
    objects: &[(impl AsRef<Placed>, bool)],
    origin: DVec3,
    up: DVec3,
    metre: f64,
    fixed: Option<f64>,
) -> (Ground, Vec<Measured>) {
    let mut ground = Ground::default();
    let mut found = Vec::with_capacity(objects.len());
    for (placed, stands) in objects {
        let mut of_object = Measured::default();
        let flat = if fixed == Some(0.0) { Vec::new() } else { Side::flat(placed.as_ref(), up) };
        let mut is_level = true;
        for side in flat {
            let Some((level, tilt)) = side.rests(receiver, origin, metre, fixed) else { continue };
            let reach = match fixed {
                Some(metres) => metres * metre,
                None if level.roughness <= SMOOTHEST * metre => 0.0,
                None => (level.height.abs() + 3.0 * level.roughness + tilt).min(LARGEST * metre),
            };
            ground.supports.push(support(&side, reach, origin, metre));
            // The ground of an object on a slope is the slope.
            is_level &= side.out.dot(up) < f64::from(STEEPEST);
            of_object.sides.push(level);
        }
        if let Some(foot) = Side::foot(placed.as_ref(), up).filter(|_| *stands) {
            let measured = [LARGEST, FARTHEST]
                .into_iter()
                .find_map(|largest| foot.ground(receiver, origin, largest * metre));
            let near = |measured: &GroundPlane| is_near(measured, metre);
            let reach = match (fixed, measured) {
                (Some(metres), _) => metres * metre,
                (None, Some(measured)) if near(&measured) && measured.roughness > SMOOTHEST * metre => {
                    (measured.height.abs() + 3.0 * measured.roughness).min(LARGEST * metre)
                }
                _ => 0.0,
            };
            let smooth = fixed.is_none() && measured.as_ref().is_some_and(near);
            if is_level && (reach > 0.0 || smooth) {
                ground.supports.push(support(&foot, reach, origin, metre));
            }
            of_object.ground = measured;
        }
        found.push(of_object);
    }
    if ground.error() == 0.0 {
        // Nothing is moved.
        ground.supports.clear();
    }
    for support in &ground.supports {
        if !ground.ways.contains(&support.out) {
            ground.ways.push(support.out);
        }
    }
    (ground, found)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::geometry::sampling::{mix, unit};
    use scene::types::{Mesh, Object, Primitive};

    /// Square mesh, 2 wide, of 40 x 40 cells. `height` computes the height of a vertex from its index and its x
    /// coordinate.
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

    fn measured(mesh: &Mesh, z: f64) -> (Ground, Option<GroundPlane>) {
        let receiver = Receiver::new(mesh, DVec3::ZERO);
        let (ground, found) =
            measure((&receiver, false), &[(slab(z), true)], DVec3::ZERO, DVec3::Z, 1.0, None);
        (ground, found[0].ground)
    }

    fn noise(i: u32) -> f32 {
        unit(mix(i)) * 0.02 - 0.01
    }

    #[test]
    fn a_smooth_mesh_is_believed_and_a_rough_one_is_not() {
        for mesh in [ground(|_, _| 0.0), ground(|_, x| 0.1 * x)] {
            let (level, found) = measured(&mesh, 0.01);
            assert!(level.supports.is_empty() && found.expect("ground").roughness < 1e-6);
        }
        let (rough, found) = measured(&ground(|i, _| noise(i) - 0.005), 0.0);
        let found = found.expect("ground");
        assert!(
            (0.002..0.008).contains(&found.roughness) && (found.height + 0.005).abs() < 0.003,
            "{found:?}"
        );
        assert!((0.012..0.04).contains(&rough.supports[0].reach));
        let (far, found) = measured(&ground(|i, _| noise(i)), 0.3);
        assert!(far.supports.is_empty() && (found.expect("ground").height + 0.3).abs() < 0.01);
        assert_eq!(measured(&ground(|i, _| noise(i)), 0.8).1, None, "nothing under it");
    }

    /// With a box on a smooth floor and a second box on a rough rug next to it, only hits that are nearer to the
    /// second box are moved. This test fails if `smooth` is always false in `measure`.
    #[test]
    fn ground_of_one_object_is_not_that_of_another() {
        let mesh = ground(|i, x| if x > 0.0 { 0.008 + 0.4 * noise(i) } else { 0.0 });
        let receiver = Receiver::new(&mesh, DVec3::ZERO);
        let at = |x: f64, z: f64| {
            let world_from_object = glam::DMat4::from_translation(DVec3::new(x, 0.0, z));
            Arc::new(Placed { world_from_object, ..Placed::clone(&slab(0.0)) })
        };
        let objects = [(at(-0.6, 0.0), true), (at(0.6, 0.008), true)];
        let (ground, _) = measure((&receiver, false), &objects, DVec3::ZERO, DVec3::Z, 1.0, None);
        let shift = |x: f32, z: f32| ground.shift(Vec3::new(x, 0.0, z), Vec3::Z, Vec3::new(0.6, 0.0, -0.8));
        assert!(ground.error() > 0.005);
        assert_eq!(shift(-0.3, 0.0), 0.0);
        assert!((shift(0.3, 0.004) + 0.004 / 0.8).abs() < 1e-6);
    }

    /// A panel just below a rough ceiling is attached to it, even if all normals point out of the room. A panel on
    /// a floor that is too high stands on it. This test fails if `Side::ground` also counts surfaces that face away
    /// from the object.
    #[test]
    fn a_ceiling_is_no_ground() {
        let rough = ground(|i, _| 0.003 / 0.01 * noise(i));
        let turned = |mesh: &Mesh| Mesh {
            triangles: mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(),
            ..mesh.clone()
        };
        let thin = glam::DMat4::from_scale(DVec3::new(1.0, 1.0, 0.03 / 0.4));
        for (mesh, inverted, stands) in
            [(turned(&rough), false, false), (rough.clone(), true, false), (rough.clone(), false, true)]
        {
            let receiver = Receiver::new(&mesh, DVec3::ZERO);
            let panel = Placed {
                world_from_object: slab(-0.03).world_from_object * thin,
                ..Placed::clone(&slab(0.0))
            };
            let (level, found) =
                measure((&receiver, inverted), &[(Arc::new(panel), true)], DVec3::ZERO, DVec3::Z, 1.0, None);
            let hangs = level.supports.iter().any(|s| s.out == Vec3::NEG_Z && s.reach > 0.0);
            assert_eq!((hangs, found[0].ground.is_some()), (!stands, stands));
            assert!(level.error() > 0.0);
        }
    }

    // A camera hit lands at the height of the base, whatever the height of the mesh.
    #[test]
    fn hits_move_along_the_ray_to_the_base() {
        let (ground, _) = measured(&ground(|i, _| noise(i)), 0.0);
        let reach = ground.supports[0].reach;
        let ray = Vec3::new(0.6, 0.0, -0.8);
        for error in [-0.9, -0.2, 0.0, 0.5, 0.99_f32] {
            let at = Vec3::new(0.5, 0.2, error * reach);
            assert!((at + ray * ground.shift(at, Vec3::Z, ray)).z.abs() < 1e-6, "{error}");
        }
        // Continuous to 0 at twice the reach, on walls, and for rays along the ground.
        let shift = |z: f32, normal, ray| ground.shift(Vec3::new(0.5, 0.2, z), normal, ray);
        assert!((shift(1.5 * reach, Vec3::Z, ray) - 0.5 * reach / 0.8).abs() < 1e-6);
        assert_eq!(shift(2.0 * reach, Vec3::Z, ray), 0.0);
        assert_eq!(shift(0.5 * reach, Vec3::X, ray), 0.0);
        assert_eq!(shift(0.5 * reach, Vec3::Z, Vec3::X), 0.0);
        let grazing = Vec3::new(1.0, 0.0, -1e-6);
        assert!(shift(0.5 * reach, Vec3::Z, grazing).abs() <= 5.0 * reach);
    }
}
