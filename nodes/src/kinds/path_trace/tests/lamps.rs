//! Tests of light that objects emit. This light is not in the panorama, so it is reflected between walls
//! regardless of how the receiver treats the light of the environment.

use scene::types::{ColourMap, DiffuseTransmission, Map};

use super::*;

fn square(v: f64) -> f64 {
    v * v
}

/// Ball seen from inside, as a receiver.
fn hollow(radius: f32) -> Mesh {
    let ball = ball(radius, matte(0.5), DVec3::ZERO);
    let primitive = &ball.object.primitives[0];
    let triangles = primitive.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    Mesh { positions: primitive.positions.clone(), triangles, ..Mesh::default() }
}

/// In a hollow ball of albedo a with a lamp at its centre, every bounce distributes light evenly, so the walls
/// receive `1 + a + a^2 + ..` times the direct light. The receiver here has an albedo of 0.5, so the total is twice
/// the direct light. An earlier version added only the direct light if the receiver emitted the light of the
/// panorama or let it pass.
#[test]
fn light_of_a_lamp_goes_from_wall_to_wall() {
    let (radius, lamp, radiance) = (2.0, 0.2, 50.0);
    let walls = hollow(radius);
    let objects = [ball(lamp, shining(radiance), DVec3::ZERO)];
    let camera = rig(DVec3::new(0.9, 0.0, 0.0), DVec3::new(2.0, 0.3, 0.2), 12, 2.0);
    let mut env = Environment::constant(Up::PlusZ, [0.01; 3], 64);
    env.origin = Some(DVec3::new(0.0, 0.5, 0.3));
    let direct = f64::from(0.5 * radiance * (lamp / radius) * (lamp / radius));
    for (name, surroundings) in [
        ("the receiver is the light", Surroundings::Projected),
        ("the receiver passes it", Surroundings::Distant),
        ("the receiver is solid", Surroundings::OPEN),
    ] {
        let params = params(64, surroundings);
        let (out, _) = render(&params, &walls, &objects, &camera, &env);
        let added = mean(&out.with) - mean(&out.without);
        // The lamp is black. Of the light that passes through the centre, it absorbs about the share that it
        // covers.
        assert!((added / (2.0 * direct) - 1.0).abs() < 0.03, "{name}: {added} for {}", 2.0 * direct);
        let once = PathTrace { max_bounces: 0, ..params };
        let (out, _) = render(&once, &walls, &objects, &camera, &env);
        let added = mean(&out.with) - mean(&out.without);
        assert!((added / direct - 1.0).abs() < 0.03, "{name}, once: {added} for {direct}");
    }
}

fn shining(radiance: f32) -> Material {
    Material { emissive: [radiance; 3], ..matte(0.0) }
}

/// Mean of the function `of` over the pixels of a square camera. Its argument is the position on the plane at
/// height `z` that the pixel shows.
fn mean_over(eye: DVec3, size: u32, focal: f64, z: f64, of: impl Fn(DVec3) -> f64) -> f64 {
    let rig = rig(eye, DVec3::Z * z, size, focal);
    let [camera] = &rig.cameras[..] else { panic!("one camera") };
    let pose = DMat4::from_cols_array(&camera.world_from_camera);
    let place = |i: u32| {
        let [x, y] = [i % size, i / size].map(|k| f64::from(k) + 0.5);
        let (x, y) = ((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
        let way = pose.transform_vector3(DVec3::new(x, y, 1.0));
        of(eye + way * ((z - eye.z) / way.z))
    };
    scene::math::num::ordered_sum((0..size * size).map(|i| place(i) as f32)) / f64::from(size * size)
}

/// The light of a glowing ball of fine facets on a floor and on a table, near and far from the origin, has a closed
/// form: the radiance is `albedo * L * (r / d)^2 * cos`. Neighbouring facets must not block the light of a facet.
/// In an earlier version, light samples ended on the triangle itself. Only 95 % of the light of a ball with a
/// radius of 2 cm arrived, and only 80 % for a radius of 1 cm.
#[test]
fn fine_lamps_shed_all_their_light() {
    let (radiance, height) = (5e4, 1.0);
    let mut env = Environment::constant(Up::PlusZ, [1e-3; 3], 64);
    env.origin = Some(DVec3::new(0.0, 0.0, 0.5));
    for (radius, rings, away, surroundings) in [
        (0.02, 48, 2.0, Surroundings::Distant),
        (0.02, 48, 7.0, Surroundings::Distant),
        (0.02, 48, 7.0, Surroundings::Projected),
        (0.02, 48, 27.0, Surroundings::Distant),
        (0.01, 80, 7.0, Surroundings::Distant),
        (0.2, 96, 7.0, Surroundings::Distant),
    ] {
        for table in [None, Some(0.3)] {
            let z = table.unwrap_or(0.0);
            let lamp = DVec3::Z * (z + height);
            let mut objects = vec![fine_ball(radius, rings, shining(radiance), lamp)];
            objects.extend(table.map(|z| placed(&plane(1.0), matte(0.5), DVec3::Z * z)));
            let (eye, focal) = (DVec3::Z * z + DVec3::new(0.0, -0.8, 0.6) * away, away / 0.15);
            let params = params(64, surroundings);
            let (out, _) = render(&params, &plane(30.0), &objects, &rig(eye, DVec3::Z * z, 24, focal), &env);
            let found = match table {
                None => mean(&out.with) - mean(&out.without),
                Some(_) => covered(&out.object),
            };
            let expected = mean_over(eye, 24, focal, z, |place| {
                let way = lamp - place;
                let seen = square(radius.into()) / way.length_squared();
                0.5 * f64::from(radiance) * seen * way.z / way.length()
            });
            let name = format!("{radius} m, {rings} rings, {away} m away, {surroundings:?}, {table:?}");
            assert!((found / expected - 1.0).abs() < 0.01, "{name}: {}", found / expected);
        }
    }
}

/// A lamp is in a paper globe that transmits half of the light and reflects half. From outside, the globe has the
/// radiance L (r / R)^2 times (0.5 + 0.25 + ..), minus the reflected light that the lamp absorbs, whether or not
/// the receiver emits the light of the panorama. Scattered rays seldom hit the lamp, while rays sent towards it do,
/// so every pixel is lit. Both kinds of rays count, and nothing counts twice. This test fails if Russian roulette
/// uses the throughput without `share`: the relative spread of the pixels is then 1.2. Without rays towards the
/// lamp it was 1.5.
#[test]
fn a_lamp_in_a_globe_lights_every_pixel() {
    let (radiance, lamp, globe) = (5e4_f32, 0.02_f32, 0.1_f32);
    let paper = DiffuseTransmission { strength: Map::of(0.5), colour: ColourMap::of(1.0) };
    let paper = Material { diffuse_transmission: paper, ..matte(1.0) };
    let middle = DVec3::Z;
    let objects = [fine_ball(lamp, 48, shining(radiance), middle), fine_ball(globe, 48, paper, middle)];
    let (eye, focal) = (DVec3::new(0.0, -4.0, 3.0), 40.0);
    let camera = rig(eye, DVec3::ZERO, 24, focal);
    let mut env = Environment::constant(Up::PlusZ, [1e-3; 3], 64);
    env.origin = Some(DVec3::new(0.0, 0.0, 0.5));
    // The black lamp absorbs this share of the light that the globe reflects.
    let taken = square((lamp / globe).into());
    let outside = f64::from(radiance) * taken * 0.5 / (1.0 - 0.5 * (1.0 - taken));
    let expected = mean_over(eye, 24, focal, 0.0, |place| {
        let way = middle - place;
        0.5 * outside * square(globe.into()) / way.length_squared() * way.z / way.length()
    });
    for surroundings in [Surroundings::Distant, Surroundings::Projected] {
        let params = params(64, surroundings);
        let (out, _) = render(&params, &plane(30.0), &objects, &camera, &env);
        let (with, pixels) = (mean(&out.with), samples(&out.with));
        let found = with - mean(&out.without);
        let square = pixels.iter().map(|&v| square(f64::from(v) - with)).sum::<f64>();
        let spread = (square / pixels.len() as f64).sqrt() / found;
        assert!(spread < 0.35, "{surroundings:?}: pixels differ by {spread}");
        let error = spread / f64::from(24 * 24).sqrt();
        let off = found / expected - 1.0;
        assert!(off.abs() < 4.0 * error, "{surroundings:?}: {off} for an error of {error}");
    }
}

/// With the globe above a card, which is an object, rays from the visible points of the card also find the globe.
/// This test fails if `shades` is not used: the relative spread of the pixels is then 2.1.
#[test]
fn a_lamp_in_a_globe_lights_every_pixel_of_an_object() {
    let (radiance, lamp, globe) = (5e4_f32, 0.02_f32, 0.1_f32);
    let paper = DiffuseTransmission { strength: Map::of(0.5), colour: ColourMap::of(1.0) };
    let paper = Material { diffuse_transmission: paper, ..matte(1.0) };
    let middle = DVec3::Z;
    let card = placed(&plane(3.0), matte(0.5), DVec3::ZERO);
    let objects = [fine_ball(lamp, 48, shining(radiance), middle), fine_ball(globe, 48, paper, middle), card];
    let (eye, focal) = (DVec3::new(0.0, -4.0, 3.0), 40.0);
    let camera = rig(eye, DVec3::ZERO, 24, focal);
    let env = Environment::constant(Up::PlusZ, [1e-3; 3], 64);
    let taken = square((lamp / globe).into());
    let outside = f64::from(radiance) * taken * 0.5 / (1.0 - 0.5 * (1.0 - taken));
    let expected = mean_over(eye, 24, focal, 0.0, |place| {
        let way = middle - place;
        0.5 * outside * square(globe.into()) / way.length_squared() * way.z / way.length()
    });
    let mut ground = plane(30.0);
    ground.positions.iter_mut().for_each(|p| p[2] = -5.0);
    let (out, _) = render(&params(64, Surroundings::OPEN), &ground, &objects, &camera, &env);
    let light: Vec<f64> = samples(&out.object).chunks(4).map(|p| f64::from(p[0])).collect();
    let found = light.iter().sum::<f64>() / light.len() as f64;
    let spread = (light.iter().map(|v| square(v - found)).sum::<f64>() / light.len() as f64).sqrt() / found;
    assert!(spread < 0.35, "pixels differ by {spread}");
    let off = found / expected - 1.0;
    assert!(off.abs() < 4.0 * spread / f64::from(24 * 24).sqrt(), "{off}, pixels by {spread}");
}

/// A panel of 256 by 256 texels that is dark except for a lamp of 8 by 8 texels lights a floor with the radiance
/// `L * area * cos^2 / d^2 / pi * albedo`. There is little noise, because light samples are taken on the lamp and
/// not on the rest of the panel. An earlier version took no light samples on the lamp.
#[test]
fn a_small_lamp_of_a_picture_is_a_lamp() {
    use scene::types::{Sampler, Texture, TextureRef, Wrap};
    // A lamp of 8 by 8 texels, and a lamp of a single texel in a texture whose mipmaps round it to black.
    for (side, [left, right], [top, bottom]) in
        [(256_u32, [152, 160], [88, 96]), (1024, [617, 618], [361, 362])]
    {
        let lit = |i: u32| (left..right).contains(&(i % side)) && (top..bottom).contains(&(i / side));
        let texel = |i: u32| if lit(i) { [255; 4] } else { [0, 0, 0, 255] };
        let texture = Texture { width: side, height: side, rgba: (0..side * side).flat_map(texel).collect() };
        let sampler = Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
        let picture = TextureRef { texture: 0, uv_set: 0, sampler, transform: None };
        let material = Material { emissive_texture: Some(picture), ..shining(5e4) };
        let primitive = Primitive {
            positions: vec![[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]],
            uv0: vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Primitive::default()
        };
        let object =
            Object { primitives: vec![primitive], materials: vec![material], textures: vec![texture] };
        let world_from_object = DMat4::from_translation(DVec3::Z);
        let objects = [Arc::new(Placed { object: Arc::new(object), world_from_object })];
        let size = f64::from(side);
        let lamp = DVec3::new(
            f64::from(left + right) / 2.0 / size - 0.5,
            0.5 - f64::from(top + bottom) / 2.0 / size,
            1.0,
        );
        let area = square(f64::from(right - left) / size);
        let (eye, focal) = (DVec3::new(0.0, -4.0, 3.0), 40.0);
        let camera = rig(eye, DVec3::ZERO, 16, focal);
        let env = Environment::constant(Up::PlusZ, [1e-7; 3], 64);
        let (out, _) = render(&params(64, Surroundings::Auto), &plane(30.0), &objects, &camera, &env);
        let found = mean(&out.with) - mean(&out.without);
        let expected = mean_over(eye, 16, focal, 0.0, |place| {
            let way = lamp - place;
            let cosine = way.z / way.length();
            0.5 / std::f64::consts::PI * 5e4 * area * cosine * cosine / way.length_squared()
        });
        assert!((found / expected - 1.0).abs() < 0.03, "{}", found / expected);
        let off = |v: &f32| square(f64::from(*v) / mean(&out.with) - 1.0);
        let spread = (samples(&out.with).iter().map(off).sum::<f64>() / (3.0 * 256.0)).sqrt();
        assert!(spread < 0.4, "pixels of {side} differ by {spread}");
    }
}

/// A lamp a tenth of a millimetre above a black sheet, 7 m from the origin, sends no light through the sheet.
#[test]
fn what_lies_before_a_lamp_hides_it() {
    let lamp = placed(&plane(0.1), shining(5e4), DVec3::Z * 1.0001);
    let sheet = placed(&plane(0.11), matte(0.0), DVec3::Z);
    let eye = DVec3::new(0.0, -5.6, 4.2);
    let camera = rig(eye, DVec3::ZERO, 16, 40.0);
    let added = |objects: &[Arc<Placed>]| {
        let env = Environment::constant(Up::PlusZ, [1e-3; 3], 64);
        let (out, _) = render(&params(16, Surroundings::Auto), &plane(30.0), objects, &camera, &env);
        mean(&out.with) - mean(&out.without)
    };
    let open = added(std::slice::from_ref(&lamp));
    let hidden = added(&[lamp, sheet]);
    assert!(hidden.abs() < 1e-6 * open, "{hidden} of {open}");
}

/// An object that stands on another object is not reported as unsupported.
#[test]
fn objects_stand_on_objects() {
    let cube = box_mesh([-0.2, -0.2, 0.0], [0.2, 0.2, 0.2], false);
    let [table, on_it, aloft] = [0.0, 0.2, 0.4].map(|z| placed(&cube, matte(0.5), DVec3::Z * z));
    let camera = rig(DVec3::new(0.0, -4.0, 2.5), DVec3::ZERO, 8, 2.0);
    let reported = |objects: &[Arc<Placed>]| {
        let params = PathTrace { contact_metres: None, ..params(1, Surroundings::OPEN) };
        let (_, notes) = render(&params, &plane(4.0), objects, &camera, &white());
        notes.iter().filter(|note| note.id == "off-the-ground").count()
    };
    assert_eq!(reported(&[table.clone(), on_it.clone()]), 0);
    assert_eq!(reported(&[on_it]), 1);
    assert_eq!(reported(&[table, aloft]), 1);
}

/// An object beyond the edge of the receiver is reported. An object that stands on the edge or extends over it is
/// not. This test fails if `unsupported` is always `None`, if `find_ground` does not test `carried`, or if
/// `Side::unsupported` leaves out `over`.
#[test]
fn an_object_beyond_the_edge_has_no_ground() {
    let cube = box_mesh([-0.2, -0.2, 0.0], [0.2, 0.2, 0.2], false);
    let at = |x: f64, z: f64| placed(&cube, matte(0.5), DVec3::new(x, 0.0, z));
    let camera = rig(DVec3::new(0.0, -4.0, 2.5), DVec3::ZERO, 8, 2.0);
    let reported = |objects: &[Arc<Placed>]| {
        let params = PathTrace { contact_metres: None, ..params(1, Surroundings::OPEN) };
        let (_, notes) = render(&params, &plane(4.0), objects, &camera, &white());
        notes.iter().find(|note| note.id == "no-ground").map(|note| note.text.clone())
    };
    assert_eq!(reported(&[at(0.0, 0.0), at(0.0, 3.0), at(0.0, 0.21)]), None);
    let text = reported(&[at(0.0, 0.0), at(9.0, 0.0), at(9.0, 0.2)]).expect("a note");
    assert!(text.starts_with("object 1 stands over a hole"), "{text}");
    assert_eq!(reported(&[at(0.0, -3.0)]), None);
}

/// The shadow of a boulder half in the ground touches the boulder. A boulder entirely under the ground is
/// reported.
#[test]
fn half_buried_objects_meet_their_shadows() {
    let camera = rig(DVec3::new(0.0, -4.0, 2.5), DVec3::ZERO, 8, 2.0);
    for (z, id) in [(0.0, "in-the-ground"), (-0.25, "off-the-ground"), (0.5, "off-the-ground")] {
        let boulder = [ball(0.2, matte(0.5), DVec3::Z * z)];
        let params = PathTrace { contact_metres: None, ..params(1, Surroundings::OPEN) };
        let (_, notes) = render(&params, &plane(4.0), &boulder, &camera, &white());
        let ids = notes.iter().map(|note| note.id.clone());
        let reported: Vec<_> = ids.filter(|id| id.ends_with("the-ground")).collect();
        assert_eq!(reported, [id], "{z}");
    }
}

/// A point of capture slightly under the ground would see the unlit lower side of the ground, and a point exactly
/// on the ground would not see it at all. Both are moved above the ground. Tested in the open, in a closed room,
/// and in a room whose walls have an outer side.
#[test]
fn a_point_of_capture_under_the_ground_is_taken_over_it() {
    let (plane, objects, open) = shadowed();
    let outside = box_mesh([-2.3, -2.3, -0.3], [2.3, 2.3, 4.3], false);
    for (mesh, camera) in [(plane, open), (room(), inside()), (merge(room(), outside), inside())] {
        let go = |z: f64| {
            let mut env = sunny();
            env.origin = Some(DVec3::new(0.5, 0.2, z));
            let (out, notes) = render(&params(32, Surroundings::Auto), &mesh, &objects, &camera, &env);
            let reported = notes.iter().any(|note| note.id == "capture-under-ground");
            ([mean(&out.without), mean(&out.with), mean(&out.object)], reported)
        };
        let (over, no) = go(0.01);
        assert!(!no && over[0] > 0.0);
        for z in [0.002, 0.0, -0.01, -0.05] {
            let (under, yes) = go(z);
            assert!(yes, "{z}");
            for (a, b) in over.into_iter().zip(under) {
                assert!((a / b - 1.0).abs() < 0.02, "{z}: {over:?} {under:?}");
            }
        }
    }
}

/// A point of capture in a cupboard, outside the room or on a wall is reported. A point in the room is not, even if
/// the room is inside out. This test fails if any of the conditions of `CapturePoint::checked` is turned off.
#[test]
fn a_point_of_capture_where_no_camera_stood_is_reported() {
    let cupboard = box_mesh([-0.6, 0.8, 0.05], [0.9, 1.5, 1.7], false);
    let (furnished, outward) = (merge(room(), cupboard), box_mesh([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0], false));
    let (behind, on) = (Some("capture-behind-surfaces"), Some("capture-on-surface"));
    for (mesh, origin, expected) in [
        (&furnished, DVec3::new(-0.9, -0.7, 1.1), None),
        (&outward, DVec3::new(-0.9, -0.7, 1.1), None),
        (&furnished, DVec3::new(0.1, 1.1, 0.9), behind),
        (&furnished, DVec3::new(3.0, 0.0, 1.0), behind),
        (&furnished, DVec3::new(1.99, -0.7, 1.1), on),
        (&furnished, DVec3::new(1.97, -0.7, 1.1), None),
        (&furnished, DVec3::new(12.0, 2.0, 500.0), Some("capture-far-off")),
        (&furnished, DVec3::new(2.0, -0.7, 1.1), on),
    ] {
        let env = Environment { origin: Some(origin), ..white() };
        let (_, notes) = render(&params(1, Surroundings::Auto), mesh, &[], &inside(), &env);
        let reported = notes.iter().find(|note| note.id.starts_with("capture-")).map(|note| note.id.as_str());
        assert_eq!(reported, expected, "{origin}");
    }
}

/// The limit on contributions after the first vertex does not affect the direct light of a lamp, whichever strategy
/// samples it. This test fails if emission is clamped by `bounce` instead of the previous bounce.
#[test]
fn the_limit_spares_direct_light_of_lamps() {
    let shines = Material { emissive: [40.0; 3], ..matte(0.0) };
    let tube = [placed(&box_mesh([-0.4, -0.01, 0.03], [0.4, 0.01, 0.05], false), shines, DVec3::ZERO)];
    let camera = rig(DVec3::new(0.0, -0.6, 0.5), DVec3::ZERO, 24, 2.0);
    let dark = Environment::constant(Up::PlusZ, [1e-3; 3], 16);
    let lit = |clamp_indirect: f64| {
        let how = PathTrace { clamp_indirect, max_bounces: 0, ..params(64, Surroundings::OPEN) };
        mean(&render(&how, &plane(4.0), &tube, &camera, &dark).0.with)
    };
    let (free, limited) = (lit(0.0), lit(1.0));
    assert!(free > 0.1 && (limited / free - 1.0).abs() < 1e-6, "{limited} for {free}");
}
