//! Tests of objects whose foot is below the floor of a closed room, by no more than the error of its mesh. The
//! light that the room lets in is the same as for an object that stands on the floor.

use super::materials::clear;
use super::*;

/// Heights of the base of a cube above the floor. Negative heights are below the floor.
const HEIGHTS: [f64; 4] = [-0.01, -0.001, 0.0, 0.001];

fn cube(material: &Material, z: f64) -> [Arc<Placed>; 1] {
    [placed(&box_mesh([-0.2, -0.2, 0.0], [0.2, 0.2, 0.4], false), material.clone(), DVec3::Z * z)]
}

/// View of the foot of the cube at height `z` and of its surroundings, at three pixels per centimetre.
fn at_the_foot(z: f64) -> Arc<Rig> {
    rig(DVec3::new(-1.0, 0.05, 0.3 + z), DVec3::new(-0.2, 0.0, z), 24, 20.0)
}

fn reported(surroundings: Surroundings) -> PathTrace {
    PathTrace { contact_metres: Some(0.02), ..params(64, surroundings) }
}

/// No light reaches the floor of a room without openings, or an object on it. This test fails if
/// `Integrator::surface` does not call `Ground::over`.
#[test]
fn no_light_gets_in_under_a_foot() {
    let mirror = Material { double_sided: true, ..Material::default() };
    for material in [matte(0.6), mirror, clear(0.9, Some([0.0; 3]), 1.5)] {
        for z in HEIGHTS {
            let params = reported(Surroundings::OPEN);
            let (out, _) = render(&params, &room(), &cube(&material, z), &at_the_foot(z), &white());
            let object = samples(&out.object).chunks(4);
            assert!(object.clone().any(|pixel| pixel[3] == 1.0), "it is seen");
            let lit = object.flat_map(|pixel| &pixel[..3]).chain(samples(&out.with)).filter(|v| **v != 0.0);
            assert_eq!(lit.count(), 0, "at {z}: {material:?}");
        }
    }
}

/// Under a bright ceiling, the foot of a sunken object is lit as brightly as a foot a millimetre above the floor.
/// This test fails if `Integrator::surface` does not call `Ground::over` (the light is then 10 % off).
#[test]
fn a_sunk_foot_is_lit_like_one_on_the_floor() {
    let mut env = Environment::constant(Up::PlusZ, [0.2; 3], 64);
    let half = env.image.samples.len() / 2;
    env.image.samples[..half].fill(1.0);
    env.origin = Some(DVec3::new(-0.5, 0.4, 1.6));
    for surroundings in [Surroundings::Projected, Surroundings::ROOM] {
        let seen = |z: f64| {
            let params = reported(surroundings);
            let (out, _) = render(&params, &room(), &cube(&matte(0.6), z), &at_the_foot(z), &env);
            [covered(&out.object), mean(&out.with)]
        };
        let over = seen(0.001);
        for z in &HEIGHTS[..3] {
            let found = seen(*z);
            for k in 0..2 {
                let off = found[k] / over[k] - 1.0;
                assert!(off.abs() < 0.03, "{surroundings:?}, {z}: {found:?} for {over:?}");
            }
        }
    }
}

/// Surfaces beyond the walls of a room block none of its light: the outer sides of the walls, the next room,
/// another storey. Surfaces in the room block light. A mesh whose faces are visible from both sides blocks no
/// light. This test fails if `outside` is always false in `Block::passes`, or if `Probe::decide` does not use
/// `lit_share`.
#[test]
fn what_is_beyond_the_walls_takes_no_light() {
    let block = |low: [f32; 3], high: [f32; 3]| box_mesh(low, high, true);
    let nothing = Mesh::default();
    let outer = box_mesh([-2.2, -2.2, -0.2], [2.2, 2.2, 4.2], false);
    let next = block([2.2, -2.0, 0.0], [6.2, 2.0, 4.0]);
    let storey = block([-2.0, -2.0, 4.3], [2.0, 2.0, 8.3]);
    let twice = box_mesh([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0], false);
    let object = [ball(0.5, matte(0.5), DVec3::new(0.5, 0.5, 1.0))];
    let seen = |mesh: &Mesh| {
        let (out, notes) = render(&params(16, Surroundings::Auto), mesh, &object, &inside(), &white());
        let reported = notes.iter().find(|note| note.id == "surroundings").expect("a decision").text.clone();
        ([mean(&out.without), mean(&out.with), covered(&out.object)], reported)
    };
    let (alone, reported) = seen(&merge(room(), nothing));
    assert!(reported.starts_with("Room") && reported.contains("would arrive along 100.0 % of"), "{reported}");
    for around in [outer.clone(), next.clone(), merge(outer, next), storey] {
        let (found, reported) = seen(&merge(room(), around));
        assert!(reported.starts_with("Room"), "{reported}");
        for (a, b) in alone.iter().zip(found) {
            assert!((a / b - 1.0).abs() < 1e-6, "{alone:?} {found:?}: {reported}");
        }
    }
    // All light also passes if otherwise nearly none would arrive: here through a hole in the ceiling, in a hall.
    let mut walls = [room(), box_mesh([-2.2, -2.2, -0.2], [2.2, 2.2, 4.2], false)];
    walls.iter_mut().for_each(|mesh| _ = mesh.triangles.remove(2));
    let holed = walls.into_iter().fold(block([-10.0; 3], [10.0; 3]), merge);
    for mesh in [merge(room(), twice), holed] {
        let (found, reported) = seen(&mesh);
        assert!(
            reported.starts_with("Transparent") && (found[0] - 0.5).abs() < 5e-3,
            "{reported}: {found:?}"
        );
    }
    let table = box_mesh([-0.5, -0.5, 0.5], [0.5, 0.5, 1.0], false);
    let (furnished, reported) = seen(&merge(room(), table));
    assert!(reported.starts_with("Room") && furnished[0] < 0.95 * alone[0], "{reported}: {furnished:?}");
}

/// An object behind a wall, in the next room, changes nothing in this room, since it does not block the light of
/// the panorama. This test fails if `sky_transmittance` always returns `all`, or if `before_the_light` returns its
/// argument `object` unchanged.
#[test]
fn objects_behind_a_wall_change_nothing() {
    let mut env = sunny();
    let far = ball(0.9, matte(0.3), DVec3::new(3.5, 0.5, 1.5));
    let mirror = Material { roughness: 0.0, double_sided: true, ..Material::default() };
    let own = ball(0.3, mirror, DVec3::new(0.5, 0.5, 1.0));
    for surroundings in [
        Surroundings::Projected,
        Surroundings::ROOM,
        Surroundings::TRANSPARENT,
        Surroundings::Within { metres: 1.0, bounces: false },
    ] {
        env.origin = Some(DVec3::new(0.0, 0.0, 1.6));
        let go = |objects: &[Arc<Placed>], env, samples| {
            render(&params(samples, surroundings), &room(), objects, &inside(), env).0
        };
        let out = go(std::slice::from_ref(&far), &env, 16);
        let differ = samples(&out.with).iter().zip(samples(&out.without)).filter(|(a, b)| a != b).count();
        assert_eq!(differ, 0, "{surroundings:?}");
        // Suns are removed, since the mirror would reflect them onto small parts of the walls, which paths find
        // only by chance. Under near light the far object changes which rays are sent towards the objects.
        let mut dim = env.clone();
        dim.image.samples.iter_mut().for_each(|v| *v = v.min(2.0));
        let [alone, both] =
            [vec![own.clone()], vec![own.clone(), far.clone()]].map(|objects| go(&objects, &dim, 64));
        for (a, b) in [(&alone.object, &both.object), (&alone.with, &both.with)] {
            assert!((mean(a) / mean(b) - 1.0).abs() < 1e-3, "{surroundings:?}: {} {}", mean(a), mean(b));
        }
    }
}

/// If a mesh is too low, but within its error, a lamp lights the visible ground as on a correct mesh, and no light
/// escapes below a box that emits only at its bottom. This test fails if `sample_emitters` leaves out `lift` (the
/// ground is then 4 % too bright).
#[test]
fn lamps_light_the_ground_where_the_camera_sees_it() {
    let lamp = Material { emissive: [3.0; 3], ..matte(0.0) };
    let sides = box_mesh([-0.2, -0.2, 0.0], [0.2, 0.2, 0.3], false);
    let part = |mesh: &Mesh, triangles: &[[u32; 3]], material| Primitive {
        positions: mesh.positions.clone(),
        triangles: triangles.to_vec(),
        material,
        ..Primitive::default()
    };
    let object = |primitives| {
        let object = Object { primitives, materials: vec![matte(0.0), lamp.clone()], textures: Vec::new() };
        [Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY })]
    };
    let whole = object(vec![part(&sides, &sides.triangles, 1)]);
    let bottom = object(vec![part(&sides, &sides.triangles[..2], 1), part(&sides, &sides.triangles[2..], 0)]);
    let ground = |z: f32| {
        let mut mesh = plane(3.0);
        mesh.positions.iter_mut().for_each(|p| p[2] = z);
        mesh
    };
    let camera = rig(DVec3::new(0.0, -2.0, 1.2), DVec3::new(0.0, -0.3, 0.0), 24, 4.0);
    let added = |z: f32, objects: &[Arc<Placed>]| {
        let params = PathTrace { contact_metres: Some(0.05), ..params(128, Surroundings::OPEN) };
        let env = Environment::constant(Up::PlusZ, [0.2; 3], 64);
        let (out, _) = render(&params, &ground(z), objects, &camera, &env);
        // Only pixels that the object does not cover.
        let open = samples(&out.object).chunks(4).map(|pixel| pixel[3] == 0.0);
        let light = samples(&out.with).chunks(3).zip(samples(&out.without).chunks(3));
        let each = light.zip(open).filter(|(_, open)| *open).map(|((b, a), _)| f64::from(b[0] - a[0]));
        let found: Vec<f64> = each.collect();
        found.iter().sum::<f64>() / found.len() as f64
    };
    for (objects, least) in [(&whole, 0.05), (&bottom, -0.05)] {
        let right = added(0.0, objects);
        for z in [-0.03, 0.01] {
            let found = added(z, objects);
            let off = (found - right).abs();
            assert!(off < 0.03 * right.abs() + 1e-4, "{z}: {found} for {right}");
        }
        assert!(if least > 0.0 { right > least } else { right < 0.0 && right > least }, "{right}");
    }
}

/// A rug exactly on the floor stays visible with a box on it, however high other objects are. This test fails if
/// `lifted` is left out of the reach of `Touching` (the rug then vanishes).
#[test]
fn a_rug_under_a_box_stays_in_front_of_the_floor() {
    let red = Material { base_colour: [0.9, 0.05, 0.05, 1.0], ..matte(0.5) };
    let rug = |z: f64| placed(&plane(0.6), red.clone(), DVec3::Z * z);
    let block = placed(&box_mesh([-0.2, -0.2, 0.0], [0.2, 0.2, 0.3], false), matte(0.5), DVec3::ZERO);
    let pendant = ball(0.1, matte(0.5), DVec3::Z * 10.0);
    let camera = rig(DVec3::new(1.2, -1.3, 1.5), DVec3::ZERO, 24, 2.5);
    let seen = |z: f64| -> f64 {
        let objects = [rug(z), block.clone(), pendant.clone()];
        // The floor has small triangles near the objects, since the rounding tolerance depends on the largest
        // triangle.
        let (out, _) = render(&params(16, Surroundings::OPEN), &plane(1.0), &objects, &camera, &white());
        samples(&out.object).chunks(4).map(|pixel| f64::from(pixel[3])).sum()
    };
    let (over, on) = (seen(0.002), seen(0.0));
    assert!((on / over - 1.0).abs() < 0.02 && over > 50.0, "{on} for {over}");
}
