//! Tests of the receiver as a light source, with the radiance that the panorama shows.

use super::*;
use render::geometry::bvh::Ray;
use render::geometry::sampling::{Points, stream};
use render::transport::path::light_points::LightPoints;
use render::transport::path::near_draws::NearDraws;
use render::transport::path::near_field::NearFieldLight;
use render::transport::scene::receiver::Receiver;
use render::transport::sky::environment::EnvironmentLight;
use scene::math::equirect;
use testing::{SphereBins, chi_square};

/// Point of capture of the panoramas below.
const EYE: DVec3 = DVec3::new(-0.9, -0.7, 1.1);
/// Range in y and range in z of the lamp, which is on the wall at x = 2 of [`room`].
const LAMP: [[f64; 2]; 2] = [[0.2, 1.2], [1.5, 2.3]];

/// Panorama at [`EYE`] in a black room with the lamp, of radiance 10. Each texel is the mean of many points.
fn lamplight(width: usize) -> Environment {
    let mut env = Environment::constant(Up::PlusZ, [0.0; 3], width);
    let sub = 8;
    for y in 0..width / 2 {
        for x in 0..width {
            let mut hits = 0;
            for k in 0..sub * sub {
                let u = (x as f64 + (f64::from(k % sub) + 0.5) / f64::from(sub)) / width as f64;
                let v = (y as f64 + (f64::from(k / sub) + 0.5) / f64::from(sub)) / (width / 2) as f64;
                let d = equirect::direction(Up::PlusZ, u, v);
                let at = EYE + d * ((2.0 - EYE.x) / d.x);
                let inside = |k: usize, v: f64| (LAMP[k][0]..LAMP[k][1]).contains(&v);
                hits += i32::from(d.x > 0.0 && inside(0, at.y) && inside(1, at.z));
            }
            let share = f64::from(hits) / f64::from(sub * sub);
            env.image.pixel_mut(x, y).fill((10.0 * share) as f32);
        }
    }
    env.origin = Some(EYE);
    env
}

/// Irradiance at a point from the lamp of radiance 10, by Lambert's sum over its edges.
fn lambert(point: DVec3, normal: DVec3) -> f64 {
    let [[y0, y1], [z0, z1]] = LAMP;
    let corners =
        [[y0, z0], [y1, z0], [y1, z1], [y0, z1]].map(|[y, z]| (DVec3::new(2.0, y, z) - point).normalize());
    let sum: f64 = (0..4)
        .map(|k| {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            f64::from(scene::math::num::f32::acos(a.dot(b) as f32)) * a.cross(b).normalize().dot(normal)
        })
        .sum();
    5.0 * sum.abs()
}

fn near(samples: u32) -> PathTrace {
    params(samples, Surroundings::Projected)
}

/// Mean light in a small view that faces a point of the room perpendicularly.
fn at(p: &PathTrace, env: &Environment, point: DVec3, normal: DVec3) -> f64 {
    of(p, &room(), env, point, normal)
}

fn of(p: &PathTrace, room: &Mesh, env: &Environment, point: DVec3, normal: DVec3) -> f64 {
    let camera = rig(point + normal, point + DVec3::new(0.0, 1e-6, 0.0), 4, 40.0);
    mean(&render(p, room, &[], &camera, env).0.without)
}

// The purpose of near light: a lamp two metres away lights each point from its own direction. The distant model is
// wrong by a fifth and more, and lights the wall next to the lamp, which cannot see it.
#[test]
fn a_lamp_on_a_wall_lights_each_point_from_where_it_is() {
    let env = lamplight(256);
    for (point, normal) in [
        (DVec3::new(1.2, 0.5, 0.0), DVec3::Z),
        (DVec3::new(1.5, -1.5, 0.0), DVec3::Z),
        (DVec3::new(0.3, 1.0, 4.0), DVec3::NEG_Z),
        (DVec3::new(-0.5, 2.0, 1.0), DVec3::NEG_Y),
    ] {
        let expected = 0.5 * lambert(point, normal) / std::f64::consts::PI;
        let got = at(&near(256), &env, point, normal);
        assert!((got / expected - 1.0).abs() < 0.02, "{point}: {got} for {expected}");
        let far = PathTrace { surroundings: Surroundings::Distant, ..near(256) };
        let distant = at(&far, &env, point, normal);
        assert!((distant / expected - 1.0).abs() > 0.2, "{point}: {distant} for {expected}");
    }
    assert_eq!(at(&near(16), &env, DVec3::new(2.0, -1.0, 1.0), DVec3::NEG_X), 0.0);
}

// With a constant environment of 1 and an albedo of 0.5, the radiance is 0.5 for any number of bounces. The bound
// is about four standard errors of this number of samples.
#[test]
fn a_white_room_is_half_lit() {
    let mut env = white();
    env.origin = Some(EYE);
    for max_bounces in [0, 8] {
        let p = PathTrace { max_bounces, ..near(256) };
        let (out, notes) = render(&p, &room(), &[], &inside(), &env);
        assert!((mean(&out.without) - 0.5).abs() < 1.5e-3, "{}", mean(&out.without));
        let reported = notes.iter().find(|note| note.id == "surroundings").expect("a decision");
        assert!(reported.text.starts_with("Projected: "));
    }
}

// `Auto` is also `Projected` in the open if the receiver contains the ground. It is not if the receiver is only a
// patch of ground, or if the environment has no point of capture.
#[test]
fn auto_is_near_where_the_receiver_is_what_the_panorama_shows() {
    let decided = |floor: f32, origin| {
        let env = Environment { origin, ..white() };
        let (_, notes) = render(&params(1, Surroundings::Auto), &plane(floor), &[], &inside(), &env);
        notes.iter().find(|note| note.id == "surroundings").map(|note| note.text.clone()).unwrap_or_default()
    };
    let reported = decided(400.0, Some(DVec3::Z));
    assert!(
        reported.starts_with("Projected: ") && reported.ends_with("captured inside this mesh"),
        "{reported}"
    );
    let reported = decided(0.5, Some(DVec3::Z));
    assert!(
        reported.starts_with("Open: ") && reported.ends_with("too few probe rays hit the mesh"),
        "{reported}"
    );
    assert!(decided(400.0, None).ends_with("the environment has no point of capture"));
}

/// Chi-square test of light samples against the density that is evaluated for scattered rays, by direction from a
/// point: in a room, in a room with a cupboard that hides some of the light, and above a patch of ground. This test
/// fails if `square.sqrt()` is replaced by `1.0` in `NearFieldLight::spread`, or if `NearFieldLight::eval` leaves
/// out the density of directions that show the sky from both points.
#[test]
fn light_samples_follow_their_density() {
    let mut env = Environment::constant(Up::PlusZ, [0.0; 3], 16);
    // The environment has no edges that the integral would miss.
    for (i, v) in env.image.samples.iter_mut().enumerate() {
        *v = 1.0 + 0.3 * render::geometry::sampling::unit(render::geometry::sampling::mix(i as u32 / 3));
    }
    let sky = EnvironmentLight::new(&env);
    let cupboard = box_mesh([-0.6, 0.8, 0.0], [0.9, 1.5, 1.7], false);
    for (name, mesh) in [("room", room()), ("cupboard", merge(room(), cupboard)), ("ground", plane(4.0))] {
        let receiver = Receiver::new(&mesh, DVec3::ZERO);
        let near = NearFieldLight { receiver: &receiver, sky: &sky, eye: EYE.as_vec3() };
        let (point, bins) = (Vec3::new(1.1, 0.4, 1.5), SphereBins { rings: 12, sectors: 12 });
        for (side, first) in
            [None, Some(Vec3::new(0.6, 0.0, 0.8))].into_iter().flat_map(|s| [(s, false), (s, true)])
        {
            let lights = near.lights(first);
            // With more samples, the error of the integrals at silhouettes would show.
            let n = 40_000 / lights.count();
            let all = (n * lights.count()) as f32;
            let [expected] = bins.integrals(24, |d| {
                let ray = Ray::new(point, d);
                let hit = receiver.bvh.closest(ray, |_| true);
                [near
                    .eval(ray, &near.samples(side, lights), hit.as_ref(), 0.0)
                    .map_or(0.0, |(light, _)| light.pdf * all)]
            });
            let mut counts = vec![0.0; bins.count()];
            for i in 0..n {
                let points = Points::new(stream(2, i, 0), 0);
                let vertex = (point, near.samples(side, lights));
                for (light, place) in NearDraws::at_one(near, vertex, points, lights, 0).into_iter().flatten()
                {
                    let ray = NearFieldLight::towards(Ray::new(point, light.direction), place.as_ref());
                    // Surfaces that the point cannot see from its side have no light.
                    if light.radiance != Vec3::ZERO && near.reaches(ray, place.as_ref()) {
                        counts[bins.of(light.direction)] += 1.0;
                    }
                }
            }
            let z = chi_square(&counts, &expected);
            assert!(z < 4.0, "{name}, {side:?}, {lights:?}: {z}");
        }
    }
}

// Surfaces that are hidden from the point of capture are lit and scatter light: the far side of a screen is neither
// black nor as bright as the panorama, which shows the screen there.
#[test]
fn hidden_places_are_lit() {
    let screen = box_mesh([0.5, -2.0, 0.0], [0.6, 2.0, 3.0], false);
    let mut env = white();
    env.origin = Some(EYE);
    let behind = rig(DVec3::new(1.5, 0.0, 0.3), DVec3::new(1.5, 0.01, 0.0), 4, 4.0);
    let lit = |max_bounces| {
        let p = PathTrace { max_bounces, ..near(256) };
        mean(&render(&p, &merge(room(), screen.clone()), &[], &behind, &env).0.without)
    };
    let (one, many) = (lit(0), lit(8));
    assert!(one > 0.02 && many > one && many < 0.5, "{one} {many}");
}

// With and without objects, paths share their random numbers: S is exactly 1 if no ray hits an object.
#[test]
fn pairs_stay_pairs() {
    let mut env = sunny();
    env.origin = Some(EYE);
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let (out, _) = render(&near(20), &room(), &far, &inside(), &env);
    assert_eq!(samples(&out.without), samples(&out.with));
    // A black object removes light and adds none.
    let black = [ball(0.4, matte(0.0), DVec3::new(0.5, 0.5, 0.5))];
    let (out, _) = render(&near(32), &room(), &black, &inside(), &env);
    let pairs = samples(&out.with).iter().zip(samples(&out.without));
    assert!(pairs.clone().all(|(with, without)| *with <= without * 1.0001 + 1e-6));
    assert!(mean(&out.with) < 0.99 * mean(&out.without));
}

// Light that an object blocks from a wall is also missing in the light that this wall emits: under a lid just above
// the floor it is dark, although the panorama shows a bright floor.
#[test]
fn the_shadow_of_an_object_dims_what_lies_in_it() {
    let mut env = white();
    env.origin = Some(EYE);
    let lid = |z| placed(&box_mesh([-1.0, -1.0, z], [1.0, 1.0, z + 0.1], false), matte(0.8), DVec3::ZERO);
    let below = rig(DVec3::new(0.0, -0.4, 0.02), DVec3::new(0.0, 0.0, 0.05), 8, 4.0);
    let under = |z| covered(&render(&near(64), &room(), &[lid(z)], &below, &env).0.object);
    let low = under(0.05);
    assert!(low < 0.2, "{low}");
}

// The sun through a window lights the patch of floor from which it is visible, wherever the point of capture saw
// the sun from. Light through the window is distant; light from the walls is near.
#[test]
fn the_sun_through_a_window_lights_its_patch() {
    // The wall at x = 2 with a hole at y from -0.7 to 0.3 and z from 1.5 to 2.5.
    let mut walls = room();
    walls.triangles.retain(|t| t.iter().any(|&i| walls.positions[i as usize][0] < 2.0));
    let strip = |y: [f32; 2], z: [f32; 2]| Mesh {
        positions: vec![[2.0, y[0], z[0]], [2.0, y[0], z[1]], [2.0, y[1], z[1]], [2.0, y[1], z[0]]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    for (y, z) in [
        ([-2.0, -0.7], [0.0, 4.0]),
        ([0.3, 2.0], [0.0, 4.0]),
        ([-0.7, 0.3], [0.0, 1.5]),
        ([-0.7, 0.3], [2.5, 4.0]),
    ] {
        walls = merge(walls, strip(y, z));
    }
    // A sun 30 degrees up over +x, seen from the point of capture through the window.
    let (mut env, sun) =
        (Environment::constant(Up::PlusZ, [0.0; 3], 256), DVec3::new(0.866, 0.2, 0.5).normalize());
    let (u, v) = equirect::uv(Up::PlusZ, sun);
    let texel = ((u * 256.0) as usize, (v * 128.0) as usize);
    env.image.pixel_mut(texel.0, texel.1).fill(1000.0);
    let sun = equirect::direction(Up::PlusZ, (texel.0 as f64 + 0.5) / 256.0, (texel.1 as f64 + 0.5) / 128.0);
    env.origin = Some(DVec3::new(0.3, -0.6, 1.0));
    let area = equirect::pixel_solid_angle(256, 128, texel.1);
    let expected = 0.5 / std::f64::consts::PI * 1000.0 * area * sun.z;
    // On the floor, the patch that the walls leave lit extends from x = -2.33 to -0.6 and is 1 wide.
    for (x, y, lit) in [(-1.2, -0.9, true), (-1.2, 0.2, false), (0.3, -0.6, false), (1.5, -0.2, false)] {
        let got = of(&near(64), &walls, &env, DVec3::new(x, y, 0.0), DVec3::Z);
        let is = if lit { expected } else { 0.0 };
        assert!((got - is).abs() < 0.02 * expected, "{x} {y}: {got} for {is}");
    }
}

/// In a room so large that every visible point sees the walls in the same directions, light emitted by the
/// walls equals distant light, even through nested bodies of tinted glass.
#[test]
fn a_near_light_that_is_far_shines_through_bodies_as_a_far_one() {
    let hall = box_mesh([-400.0, -400.0, 0.0], [400.0, 400.0, 800.0], true);
    let mut env = Environment::constant(Up::PlusZ, [0.0; 3], 16);
    // The sky is dark up to the horizon, also when interpolated between texel centres, because the ground is near.
    for (i, v) in env.image.samples[..16 * 3 * 3].iter_mut().enumerate() {
        *v = 0.5 + render::geometry::sampling::unit(render::geometry::sampling::mix(i as u32));
    }
    env.origin = Some(DVec3::new(0.1, 0.2, 1.0));
    let tinted = |ior| materials::clear(1.0, Some([0.9, 0.3, 0.0]), ior);
    let camera = rig(DVec3::new(0.0, -3.0, 3.0), DVec3::new(0.0, 0.0, 0.4), 16, 2.5);
    let slab = placed(&box_mesh([-0.8, -0.6, 0.1], [0.8, 0.6, 1.1], false), tinted(1.2), DVec3::ZERO);
    let ball = ball(0.3, tinted(1.5), DVec3::new(0.2, 0.0, 0.6));
    for (name, objects) in [("tinted", vec![slab.clone()]), ("nested", vec![slab, ball])] {
        let light = |surroundings| {
            let p = PathTrace { max_bounces: 16, ..params(256, surroundings) };
            let (out, _) = render(&p, &hall, &objects, &camera, &env);
            let of = |images: &Images, channels: usize, k: usize| {
                samples(images).iter().skip(k).step_by(channels).map(|v| f64::from(*v)).sum::<f64>()
            };
            [0, 1, 2].map(|k| [of(&out.without, 3, k), of(&out.with, 3, k), of(&out.object, 4, k)])
        };
        for (near, far) in light(Surroundings::Projected).iter().zip(light(Surroundings::TRANSPARENT)) {
            for (layer, (near, far)) in ["without", "with", "object"].iter().zip(near.iter().zip(far)) {
                assert!((near / far - 1.0).abs() < 0.01, "{name}, {layer}: {near} for {far}");
            }
        }
    }
}

// A point of capture is needed.
#[test]
fn nowhere_is_refused() {
    let inputs = In {
        receiver: Arc::new(room()),
        objects: vec![],
        rig: inside(),
        env: Arc::new(white()),
        points: None,
    };
    let error = PathTrace::run(&near(1), inputs, &context()).err().expect("no origin");
    assert!(error.to_string().contains("point of capture"), "{error}");
}

/// In a room with a white lamp on a wall and bluish walls a hundredth as bright, the lamp is chosen in proportion
/// to its share of the light in each channel, at any point of the room. The share has a closed form. This test
/// fails if `hit.t * hit.t` is replaced by `hit.t`, if `/ (distance * distance)` is left out, or if `up_to[k] >
/// wanted[k]` is replaced by `up_to.y > wanted.y`.
#[test]
fn choices_follow_the_light_of_a_place() {
    let mut env = lamplight(256);
    let walls = [0.05, 0.1, 0.2];
    env.image.samples.iter_mut().enumerate().for_each(|(i, v)| *v += walls[i % 3]);
    let eye = env.origin.expect("a place").as_vec3();
    let (receiver, sky) = (Receiver::new(&room(), DVec3::ZERO), EnvironmentLight::new(&env));
    let points = LightPoints::new(&receiver, &sky, eye);
    for (place, normal) in [
        (DVec3::new(1.2, 0.5, 0.0), DVec3::Z),
        (DVec3::new(-1.5, -1.5, 0.0), DVec3::Z),
        (DVec3::new(-0.5, 2.0, 1.0), DVec3::NEG_Y),
        (DVec3::new(-2.0, -1.0, 2.0), DVec3::X),
    ] {
        let lamp = lambert(place, normal);
        let n = 4096;
        let mut on_lamp = [0_u32; 3];
        for i in 0..n {
            let bits = Points::new(stream(3, i, 0), 0).bits(0);
            let chosen = points.choose(place.as_vec3(), normal.as_vec3(), bits, [0.5; 2]);
            for (count, way) in on_lamp.iter_mut().zip(chosen) {
                let way = way.expect("light");
                let at = place + way.direction.as_dvec3() * f64::from(way.distance);
                *count +=
                    u32::from(at.x > 1.99 && (0.15..1.25).contains(&at.y) && (1.45..2.35).contains(&at.z));
            }
        }
        for (count, wall) in on_lamp.into_iter().zip(walls) {
            let share = f64::from(count) / f64::from(n);
            let expected = lamp / (lamp + f64::from(wall) * std::f64::consts::PI);
            // A block estimates the sum with 32 points.
            assert!((share - expected).abs() < 0.05, "{place}: {share} for {expected}");
        }
    }
}

/// In a white room under uniform light (a white furnace), objects change nothing, whether the room is seen directly
/// or in a mirror. A cube reflects as much light to the floor as it blocks. This test fails if `objects_beyond`
/// returns 0.
#[test]
fn a_white_room_stays_white_in_a_mirror() {
    let mut env = white();
    env.origin = Some(EYE);
    let mesh = Mesh { colours: vec![[1.0; 3]; 8], ..room() };
    let cube = box_mesh([-0.4, 0.6, 0.0], [0.4, 1.4, 0.8], false);
    let mirror = Material { roughness: 0.0, metallic: 1.0, ..matte(1.0) };
    let camera = rig(DVec3::new(0.1, -1.5, 1.2), DVec3::new(0.0, 0.6, 0.2), 16, 1.5);
    let p = PathTrace { max_bounces: 12, ..near(64) };
    for material in [mirror, matte(1.0)] {
        let (out, _) = render(&p, &mesh, &[placed(&cube, material, DVec3::ZERO)], &camera, &env);
        let object = samples(&out.object);
        let (light, cover) = object.chunks_exact(4).fold((0.0, 0.0), |(light, cover), pixel| {
            (light + f64::from(pixel[1]), cover + f64::from(pixel[3]))
        });
        // The light at a point is approximated by 1024 pieces, with an error of 2 to 3 % where up to half of it
        // changes.
        assert!((light / cover - 1.0).abs() < 0.02, "{}", light / cover);
        // Only pixels that the cube does not cover.
        let seen = |images: &Images| -> f64 {
            let pixels = samples(images).chunks_exact(3).zip(object.chunks_exact(4));
            pixels.filter(|(_, object)| object[3] == 0.0).map(|(rgb, _)| f64::from(rgb[1])).sum()
        };
        let ratio = seen(&out.with) / seen(&out.without);
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }
}

/// An object in the next room that cannot be seen from the point of capture through the doorway is reported. An
/// object in the same room is not. This test fails if `all` is replaced by `any` in `report_unseen_places`, or if
/// this function is not called.
#[test]
fn an_object_that_the_point_of_capture_does_not_see_is_reported() {
    let cupboard = box_mesh([-0.6, 0.8, 0.0], [0.9, 1.5, 1.7], false);
    let mut next = box_mesh([2.0, -2.0, 0.0], [6.0, 2.0, 4.0], true);
    // Only half of the wall remains between the two rooms.
    next.triangles.drain(8..10);
    let mut flat = merge(merge(room(), cupboard), next);
    flat.triangles.remove(10);
    let env = Environment { origin: Some(EYE), ..white() };
    for (at, expected) in [
        (DVec3::new(1.2, -1.0, 0.3), false),
        (DVec3::new(1.3, 1.2, 0.3), false),
        (DVec3::new(2.5, -1.7, 3.6), true),
    ] {
        let object = [ball(0.2, matte(0.5), at)];
        let (_, notes) = render(&near(1), &flat, &object, &inside(), &env);
        assert_eq!(notes.iter().any(|note| note.id == "capture-elsewhere"), expected, "{at}");
    }
}
