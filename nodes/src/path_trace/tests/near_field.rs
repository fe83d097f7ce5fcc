//! The receiver as the light that the panorama shows of it.

use super::*;
use crate::bvh::Ray;
use crate::equirect;
use crate::path_trace::environment::EnvironmentLight;
use crate::path_trace::near_field::NearFieldLight;
use crate::path_trace::receiver::Receiver;
use crate::sampling::{Points, circle};

/// Where the panoramas below were taken.
const EYE: DVec3 = DVec3::new(-0.9, -0.7, 1.1);
/// A lamp on the wall at x = 2 of [`room`]: its lowest and highest y and z.
const LAMP: [[f64; 2]; 2] = [[0.2, 1.2], [1.5, 2.3]];

/// What [`EYE`] sees in a black room with the lamp, of radiance 10; each texel is the mean of many points.
fn lamplight(width: usize) -> Environment {
    let mut env = constant(Up::PlusZ, [0.0; 3], width);
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
            f64::from(crate::num::f32::acos(a.dot(b) as f32)) * a.cross(b).normalize().dot(normal)
        })
        .sum();
    5.0 * sum.abs()
}

fn near(samples: u32) -> PathTrace {
    PathTrace { near_field: NearField::On, ..params(samples, EnvBlock::Auto) }
}

/// Mean of a small view straight down on, or straight at, a point of the room.
fn at(p: &PathTrace, env: &Environment, point: DVec3, normal: DVec3) -> f64 {
    of(p, &room(), env, point, normal)
}

fn of(p: &PathTrace, room: &Mesh, env: &Environment, point: DVec3, normal: DVec3) -> f64 {
    let camera = rig(point + normal, point + DVec3::new(0.0, 1e-6, 0.0), 4, 40.0);
    mean(&render(p, room, &[], &camera, env).0.without)
}

// The whole point: a lamp two metres away lights each point from where it stands. The distant model is wrong
// by a fifth and more, and the wall beside the lamp gets light from it that it cannot see.
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
        let far = PathTrace { near_field: NearField::Off, ..near(256) };
        let distant = at(&far, &env, point, normal);
        assert!((distant / expected - 1.0).abs() > 0.2, "{point}: {distant} for {expected}");
    }
    assert_eq!(at(&near(16), &env, DVec3::new(2.0, -1.0, 1.0), DVec3::NEG_X), 0.0);
}

// Notes, section 2: constant environment 1, albedo 0.5: 0.5, whatever the number of bounces and the block. The
// bound is some four standard errors of so many samples.
#[test]
fn a_white_room_is_half_lit() {
    let mut env = white();
    env.origin = Some(EYE);
    for (max_bounces, env_block) in [(0, EnvBlock::Auto), (8, EnvBlock::Pass)] {
        let p = PathTrace { max_bounces, env_block, ..near(256) };
        let (out, notes) = render(&p, &room(), &[], &inside(), &env);
        assert!((mean(&out.without) - 0.5).abs() < 1.5e-3, "{}", mean(&out.without));
        assert!(notes.iter().any(|n| n.id == "near-field" && n.text.starts_with("On")));
    }
}

// In the open too, where the receiver holds the ground; not where it is a patch of it, nor where nothing says that the
// panorama shows it.
#[test]
fn auto_is_near_where_the_receiver_is_what_the_panorama_shows() {
    let decided = |floor: f32, origin| {
        let env = Environment { origin, ..white() };
        let (_, notes) = render(&params(1, EnvBlock::Auto), &plane(floor), &[], &inside(), &env);
        notes.iter().find(|note| note.id == "near-field").map(|note| note.text.clone()).unwrap_or_default()
    };
    let told = decided(400.0, Some(DVec3::Z));
    assert!(told.starts_with("On: the environment was captured in this place"), "{told}");
    let told = decided(0.5, Some(DVec3::Z));
    assert!(told.starts_with("Off: the scene is open, and the receiver is"), "{told}");
    assert!(decided(400.0, None).starts_with("Off: the environment has no point of capture"));
}

// The density of light samples, per steradian of a point that sees all that the point of capture sees,
// integrates to 1, and samples follow it: the share that falls on a side of the room is its integral there.
#[test]
fn light_samples_have_the_density_they_claim() {
    let env = sunny();
    let (receiver, sky) = (Receiver::new(&room(), DVec3::ZERO), EnvironmentLight::new(&env));
    let near = NearFieldLight { receiver: &receiver, sky: &sky, eye: EYE.as_vec3() };
    let (point, n) = (Vec3::new(1.1, 0.4, 2.5), 1 << 16);
    for side in [None, Some(Vec3::new(0.6, 0.0, 0.8))] {
        let (mut total, mut right, mut sampled) = (0.0, 0.0, 0.0);
        for i in 0..n {
            let [u, v] = Points::new(1, i).pair(0);
            let z = 1.0 - 2.0 * v;
            let ((sin, cos), r) = (circle(u), (1.0 - z * z).max(0.0).sqrt());
            let ray = Ray::new(point, Vec3::new(r * cos, r * sin, z));
            let hit = receiver.bvh.closest(ray, |_| true).expect("a closed room");
            let (found, place) = near.eval(ray, side, Some(&hit)).expect("all is seen");
            let pdf = f64::from(found.pdf) * 4.0 * std::f64::consts::PI / f64::from(n);
            total += pdf;
            right += if place.expect("a wall").position.x > 1.999 { pdf } else { 0.0 };
            let (_, place) = near.sample(point, side, Points::new(2, i).bits(0)).expect("light");
            sampled += f64::from(u8::from(place.expect("a wall").position.x > 1.999)) / f64::from(n);
        }
        assert!((total - 1.0).abs() < 0.01, "{total}");
        assert!((right - sampled).abs() < 0.01, "{right} {sampled}");
    }
}

// What the point of capture does not see is lit and scatters: the far side of a screen is neither black nor as
// bright as the panorama, which shows the screen there.
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

// Pairs share their random numbers as ever: nothing there, S = 1 bit for bit; and a probe that meets nothing
// means that nothing changes.
#[test]
fn pairs_stay_pairs() {
    let mut env = sunny();
    env.origin = Some(EYE);
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let (out, _) = render(&near(20), &room(), &far, &inside(), &env);
    assert_eq!(samples(&out.without), samples(&out.with));
    // An object takes light and gives none that was not there, but for what it throws back.
    let black = [ball(0.4, matte(0.0), DVec3::new(0.5, 0.5, 0.5))];
    let (out, _) = render(&near(32), &room(), &black, &inside(), &env);
    let pairs = samples(&out.with).iter().zip(samples(&out.without));
    assert!(pairs.clone().all(|(with, without)| *with <= without * 1.0001 + 1e-6));
    assert!(mean(&out.with) < 0.99 * mean(&out.without));
}

// What an object takes from the light of a wall is missing in what that wall gives: under a lid just over the
// floor there is no light, though the panorama shows a bright floor.
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

// The sun through a window lights the patch of the floor that it is seen from, wherever the point of capture
// saw it from: what leaves by the window is far, what meets a wall is not.
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
    let (mut env, sun) = (constant(Up::PlusZ, [0.0; 3], 256), DVec3::new(0.866, 0.2, 0.5).normalize());
    let (u, v) = equirect::uv(Up::PlusZ, sun);
    let texel = ((u * 256.0) as usize, (v * 128.0) as usize);
    env.image.pixel_mut(texel.0, texel.1).fill(1000.0);
    let sun = equirect::direction(Up::PlusZ, (texel.0 as f64 + 0.5) / 256.0, (texel.1 as f64 + 0.5) / 128.0);
    env.origin = Some(DVec3::new(0.3, -0.6, 1.0));
    let area = equirect::pixel_solid_angle(256, 128, texel.1);
    let expected = 0.5 / std::f64::consts::PI * 1000.0 * area * sun.z;
    // On the floor the patch reaches from x = -2.33 to -0.6 where the walls leave it, and is 1 wide.
    for (x, y, lit) in [(-1.2, -0.9, true), (-1.2, 0.2, false), (0.3, -0.6, false), (1.5, -0.2, false)] {
        let got = of(&near(64), &walls, &env, DVec3::new(x, y, 0.0), DVec3::Z);
        let is = if lit { expected } else { 0.0 };
        assert!((got - is).abs() < 0.02 * expected, "{x} {y}: {got} for {is}");
    }
}

// A point of capture is needed.
#[test]
fn nowhere_is_refused() {
    let inputs = In { receiver: Arc::new(room()), objects: vec![], rig: inside(), env: Arc::new(white()) };
    let error = PathTrace::run(&near(1), inputs, &context()).err().expect("no origin");
    assert!(error.to_string().contains("point of capture"), "{error}");
}
