//! Light that objects add: it is not in the panorama, so it goes on from wall to wall whatever the receiver is to the
//! environment's own.

use super::*;

/// The inside of a ball as a receiver.
fn hollow(radius: f32) -> Mesh {
    let ball = ball(radius, matte(0.5), DVec3::ZERO);
    let primitive = &ball.object.primitives[0];
    let triangles = primitive.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    Mesh { positions: primitive.positions.clone(), triangles, ..Mesh::default() }
}

/// In a ball of albedo a, with a lamp at its middle, every bounce spreads light evenly: of the light that the lamp sends to
/// the walls they have `1 + a + a^2 + ..`. The receiver of this file is grey, of albedo 0.5, so that is twice the direct
/// light. Before, only the direct light was added where the panorama is the light or passes the walls.
#[test]
fn light_of_a_lamp_goes_from_wall_to_wall() {
    let (radius, lamp, radiance) = (2.0, 0.2, 50.0);
    let walls = hollow(radius);
    let shines = Material { emissive: [radiance; 3], ..matte(0.0) };
    let objects = [ball(lamp, shines, DVec3::ZERO)];
    let camera = rig(DVec3::new(0.9, 0.0, 0.0), DVec3::new(2.0, 0.3, 0.2), 12, 2.0);
    let mut env = constant(Up::PlusZ, [0.01; 3], 64);
    env.origin = Some(DVec3::new(0.0, 0.5, 0.3));
    let direct = f64::from(0.5 * radiance * (lamp / radius) * (lamp / radius));
    for (name, near_field, env_block) in [
        ("the receiver is the light", NearField::On, EnvBlock::Auto),
        ("the receiver passes it", NearField::Off, EnvBlock::Auto),
        ("the receiver is solid", NearField::Off, EnvBlock::Solid),
    ] {
        let params = PathTrace { near_field, ..params(64, env_block) };
        let (out, _) = render(&params, &walls, &objects, &camera, &env);
        let added = mean(&out.with) - mean(&out.without);
        // The lamp is black, and takes of the light that passes the middle about what it covers there.
        assert!((added / (2.0 * direct) - 1.0).abs() < 0.03, "{name}: {added} for {}", 2.0 * direct);
        let once = PathTrace { max_bounces: 0, ..params };
        let (out, _) = render(&once, &walls, &objects, &camera, &env);
        let added = mean(&out.with) - mean(&out.without);
        assert!((added / direct - 1.0).abs() < 0.03, "{name}, once: {added} for {direct}");
    }
}

/// An object that stands on another one stands.
#[test]
fn objects_stand_on_objects() {
    let cube = box_mesh([-0.2, -0.2, 0.0], [0.2, 0.2, 0.2], false);
    let [table, on_it, aloft] = [0.0, 0.2, 0.4].map(|z| placed(&cube, matte(0.5), DVec3::Z * z));
    let camera = rig(DVec3::new(0.0, -4.0, 2.5), DVec3::ZERO, 8, 2.0);
    let told = |objects: &[Arc<Placed>]| {
        let params = PathTrace { contact_metres: None, ..params(1, EnvBlock::Solid) };
        let (_, notes) = render(&params, &plane(4.0), objects, &camera, &white());
        notes.iter().filter(|note| note.id == "off-the-ground").count()
    };
    assert_eq!(told(&[table.clone(), on_it.clone()]), 0);
    assert_eq!(told(&[on_it]), 1);
    assert_eq!(told(&[table, aloft]), 1);
}

/// A point of capture a hair under the ground sees the lower side of it, which has no sun.
#[test]
fn a_point_of_capture_under_the_ground_is_taken_over_it() {
    let (plane, objects, rig) = shadowed();
    let go = |z: f64| {
        let mut env = sunny();
        env.origin = Some(DVec3::new(0.5, 0.2, z));
        let (out, notes) = render(&params(32, EnvBlock::Auto), &plane, &objects, &rig, &env);
        let told = notes.iter().any(|note| note.id == "capture-under-ground");
        ([mean(&out.without), mean(&out.with), mean(&out.object)], told)
    };
    let ((over, no), (under, yes)) = (go(0.01), go(-0.01));
    assert_eq!((no, yes), (false, true));
    for (a, b) in over.into_iter().zip(under) {
        assert!((a / b - 1.0).abs() < 0.02, "{over:?} {under:?}");
    }
}
