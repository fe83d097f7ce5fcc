//! Tests of light through bodies (nested, filled, standing on the receiver and in it) against closed forms.

use render::geometry::sampling::{Points, hash, stream};
use render::transport::bsdf::{Bsdf, Lobe};
use render::transport::path::integrator::{Integrator, Pass, Scene as Traced};
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use render::transport::scene::surface::Surface;
use render::transport::sky::environment::EnvironmentLight;
use scene::math::num::f32::{exp, ln};

use super::materials::{clear, over_cosines};
use super::samplers::matte_rules;
use super::*;

/// Material that absorbs half of the red light per metre and no blue light.
fn tinted(ior: f32) -> Material {
    clear(1.0, Some([ln(2.0), 0.5 * ln(2.0), 0.0]), ior)
}

fn slab(low: f32, high: f32, size: f32, material: Material) -> Arc<Placed> {
    placed(&box_mesh([-size, -size, low], [size, size, high], false), material, DVec3::ZERO)
}

/// Mean of the red channel and mean of the blue channel over all pixels. `channels` is the number of channels of
/// the images.
fn red_and_blue(images: &Images, channels: usize) -> [f64; 2] {
    let of = |k: usize| {
        let values = samples(images).iter().skip(k).step_by(channels);
        scene::math::num::ordered_sum(values.copied()) / (samples(images).len() / channels) as f64
    };
    [of(0), of(2)]
}

fn near([r, b]: [f64; 2], expected: [f64; 2], bound: f64, what: &str) {
    let off = (r / expected[0] - 1.0).abs().max((b / expected[1] - 1.0).abs());
    assert!(off < bound, "{what}: {r} {b} for {expected:?}");
}

fn above(focal: f64) -> Arc<Rig> {
    rig(DVec3::new(0.02, 0.01, 9.0), DVec3::new(0.02, 0.011, 0.0), 8, focal)
}

// An object inside a body is visible through the medium up to its depth, whether it emits light or is unlit, and
// its light on a floor outside the body passes through the same medium.
#[test]
fn what_stands_in_a_body_is_dimmed_by_it() {
    let black = Environment::constant(Up::PlusZ, [0.0; 3], 8);
    let body = slab(0.5, 1.5, 200.0, tinted(1.0));
    let sheet = box_mesh([-200.0, -200.0, 1.0], [200.0, 200.0, 1.0], false);
    let sheet = Mesh { triangles: sheet.triangles[0..2].to_vec(), ..sheet };
    let depth = 0.5 * ln(2.0);
    for (name, lamp) in [
        ("emissive", Material { emissive: [1.0; 3], ..matte(0.0) }),
        ("unlit", Material { unlit: true, ..matte(1.0) }),
    ] {
        let objects = [body.clone(), placed(&sheet, lamp, DVec3::ZERO)];
        let p = params(16, Surroundings::OPEN);
        let (out, _) = render(&p, &Mesh::default(), &objects, &above(40.0), &black);
        near(red_and_blue(&out.object, 4), [f64::from(exp(-depth)), 1.0], 0.01, name);

        // The sheet above the floor acts like a sky behind half a metre of the medium.
        let floor = rig(DVec3::new(0.0, 0.0, 0.4), DVec3::new(0.0, 0.01, 0.0), 8, 4.0);
        let p = PathTrace { max_bounces: 1, ..params(1024, Surroundings::TRANSPARENT) };
        let (out, _) = render(&p, &plane(200.0), &objects, &floor, &black);
        let expected = 0.5 * over_cosines(|c| exp(-depth / c));
        near(red_and_blue(&out.with, 3), [expected, 0.5], 0.02, name);
    }
}

// A body inside another body of the same medium changes nothing: for the camera, in the shadow, and for an object
// in the inner body. This holds for any index of refraction.
#[test]
fn the_same_stuff_in_a_body_changes_nothing() {
    for ior in [1.0, 1.5] {
        let outer = slab(0.5, 1.5, 200.0, tinted(ior));
        let inner = slab(0.7, 1.2, 150.0, tinted(ior));
        let fill = slab(0.9, 1.0, 100.0, matte(0.8));
        let floor = rig(DVec3::new(0.0, 0.0, 0.4), DVec3::new(0.0, 0.01, 0.0), 8, 4.0);
        let camera = |objects: &[Arc<Placed>]| {
            let p = PathTrace { max_bounces: 24, ..params(256, Surroundings::OPEN) };
            red_and_blue(&render(&p, &Mesh::default(), objects, &above(40.0), &white()).0.object, 4)
        };
        let shadow = |objects: &[Arc<Placed>]| {
            let p = params(256, Surroundings::TRANSPARENT);
            red_and_blue(&render(&p, &plane(200.0), objects, &floor, &white()).0.with, 3)
        };
        let both = [outer.clone(), inner.clone()];
        near(camera(&both), camera(&both[..1]), 0.02, "camera");
        near(shadow(&both), shadow(&both[..1]), 0.02, "shadow");
        let filled = [outer, fill.clone()];
        let [outer, fill] = filled.clone();
        near(camera(&[outer, inner, fill]), camera(&filled), 0.03, "filled");
    }
}

// A clear body displaces a tinted body, so nothing is absorbed over a path of 0.3 m.
#[test]
fn the_inner_body_absorbs_alone() {
    let objects =
        [slab(0.5, 1.5, 200.0, tinted(1.0)), slab(0.8, 1.1, 150.0, clear(1.0, Some([0.0; 3]), 1.0))];
    let depth = 0.7 * ln(2.0);
    let (out, _) =
        render(&params(16, Surroundings::OPEN), &Mesh::default(), &objects, &above(40.0), &white());
    near(red_and_blue(&out.object, 4), [f64::from(exp(-depth)), 1.0], 0.01, "camera");
    let floor = rig(DVec3::new(0.0, 0.0, 0.4), DVec3::new(0.0, 0.01, 0.0), 8, 4.0);
    let p = params(256, Surroundings::TRANSPARENT);
    let (out, _) = render(&p, &plane(200.0), &objects, &floor, &white());
    near(red_and_blue(&out.with, 3), [0.5 * over_cosines(|c| exp(-depth / c)), 0.5], 0.02, "shadow");
}

// A body a millimetre above the floor, on it and in it looks the same: the light on the floor below it passes
// through the body once, and the floor seen through the body a second time.
#[test]
fn a_body_looks_the_same_over_the_floor_on_it_and_in_it() {
    let expected = 0.5 * over_cosines(|c| exp(-ln(2.0) / c));
    for foot in [0.001, 0.0, -0.001] {
        let object = [slab(foot, foot + 1.0, 200.0, tinted(1.0))];
        let p = params(256, Surroundings::Open { bounces: false });
        let (out, _) = render(&p, &plane(400.0), &object, &above(40.0), &white());
        let what = format!("foot at {foot}");
        near(red_and_blue(&out.with, 3), [expected, 0.5], 0.02, &what);
        near(red_and_blue(&out.object, 4), [0.5 * expected, 0.5], 0.02, &what);
    }
}

// Two bodies that touch act as one body, in any order, also for the floor below both.
#[test]
fn bodies_that_touch_are_as_one() {
    let expected = f64::from(exp(-ln(2.0))) * 0.5 * over_cosines(|c| exp(-ln(2.0) / c));
    let [low, high] = [(0.2, 0.7), (0.7, 1.2)].map(|(low, high)| slab(low, high, 200.0, tinted(1.0)));
    for objects in [[low.clone(), high.clone()], [high, low]] {
        let p = params(256, Surroundings::Open { bounces: false });
        let (out, _) = render(&p, &plane(400.0), &objects, &above(40.0), &white());
        near(red_and_blue(&out.object, 4), [expected, 0.5], 0.02, "object");
        near(red_and_blue(&out.with, 3), [2.0 * expected, 0.5], 0.02, "floor");
    }
}

// A camera inside a body sees objects in it and outside through its medium.
#[test]
fn a_camera_may_be_in_a_body() {
    let body = slab(0.0, 10.0, 200.0, tinted(1.0));
    let sheet = slab(2.0, 2.1, 100.0, Material { unlit: true, ..matte(1.0) });
    let go = |objects: &[Arc<Placed>]| {
        let p = params(4, Surroundings::OPEN);
        red_and_blue(&render(&p, &Mesh::default(), objects, &above(40.0), &white()).0.object, 4)
    };
    near(go(&[body.clone(), sheet]), [f64::from(exp(-6.9 * ln(2.0))), 1.0], 0.01, "what stands in it");
    near(go(&[body]), [f64::from(exp(-9.0 * ln(2.0))), 1.0], 0.01, "out of it");
    // Bodies in files may have single-sided surfaces, but are solid all the same. An earlier version did not show
    // them to the camera.
    let sheet = slab(2.0, 2.1, 100.0, Material { unlit: true, ..matte(1.0) });
    let body = slab(0.0, 10.0, 200.0, Material { double_sided: false, ..tinted(1.0) });
    near(
        go(&[body.clone(), sheet]),
        [f64::from(exp(-6.9 * ln(2.0))), 1.0],
        0.01,
        "one side, what stands in it",
    );
    near(go(&[body]), [f64::from(exp(-9.0 * ln(2.0))), 1.0], 0.01, "one side, out of it");
}

// White light stays white for nested balls of air, water and glass.
#[test]
fn nested_glass_keeps_white_light() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 16, 1.5);
    let none = Some([0.0; 3]);
    for (outer, inner) in [(1.5, 1.0), (1.33, 1.5), (1.5, 1.33), (1.5, 1.5)] {
        let p = PathTrace { max_bounces: 40, ..params(64, Surroundings::OPEN) };
        let object = [
            ball(0.8, clear(1.0, none, outer), DVec3::ZERO),
            ball(0.5, clear(1.0, none, inner), DVec3::ZERO),
        ];
        let got = covered(&render(&p, &Mesh::default(), &object, &camera, &white()).0.object);
        assert!((got - 1.0).abs() < 0.03, "{inner} in {outer}: {got}");
    }
}

/// If glass stands exactly on a table (which is also an object) or on the floor, the surface under it is visible
/// and lit as if the glass were a millimetre higher. A body or thin wall of a clear medium of index 1 is invisible.
/// This test fails if `touching` is always `None` in `Integrator::scatter`, or if `Objects::reach` does not test
/// `part.clear`.
#[test]
fn glass_on_a_table_changes_nothing() {
    let table = slab(0.2, 0.5, 300.0, matte(0.5));
    let p = params(256, Surroundings::OPEN);
    for (name, volume) in [("body", Some([0.0; 3])), ("wall", None)] {
        let glass = |foot: f32| slab(foot, foot + 1.0, 200.0, clear(1.0, volume, 1.0));
        for objects in [[table.clone(), glass(0.5)], [glass(0.5), table.clone()]] {
            let (out, _) = render(&p, &Mesh::default(), &objects, &above(40.0), &white());
            near(red_and_blue(&out.object, 4), [0.5; 2], 0.02, &format!("{name} on a table"));
        }
        let (out, _) = render(&p, &plane(400.0), &[glass(0.0)], &above(40.0), &white());
        near(red_and_blue(&out.object, 4), [0.5; 2], 0.02, &format!("{name} on the floor"));
    }
}

/// Two bodies that share a face absorb light along the path lengths inside each of them. Tested with one body
/// around the other, and with one body that fills the hollow of the other. This test fails if `touching` is always
/// `None` in `Integrator::scatter`.
#[test]
fn bodies_may_share_a_face() {
    let block = |low: f32, high: f32, inward| box_mesh([-100.0, -100.0, low], [100.0, 100.0, high], inward);
    let red = clear(1.0, Some([ln(2.0), 0.0, 0.0]), 1.0);
    let blue = clear(1.0, Some([0.0, 0.0, ln(2.0)]), 1.0);
    let hollow = placed(&merge(block(0.4, 1.3, false), block(0.7, 1.0, true)), blue.clone(), DVec3::ZERO);
    let fill = placed(&block(0.7, 1.0, false), red.clone(), DVec3::ZERO);
    let whole = placed(&block(0.4, 1.3, false), blue, DVec3::ZERO);
    let flush = placed(&block(0.8, 1.3, false), red, DVec3::ZERO);
    for (name, [a, b], ways) in
        [("filled", [hollow, fill], [0.3, 0.6]), ("flush", [whole, flush], [0.5, 0.4])]
    {
        let expected = ways.map(|way: f32| f64::from(exp(-way * ln(2.0))));
        for objects in [[a.clone(), b.clone()], [b, a]] {
            let (out, _) =
                render(&params(256, Surroundings::OPEN), &Mesh::default(), &objects, &above(40.0), &white());
            near(red_and_blue(&out.object, 4), expected, 0.02, name);
        }
    }
}

/// Mean of each channel, and the square of its standard error.
fn estimate(n: u32, value: impl Fn(u32) -> Vec3) -> [DVec3; 2] {
    let values = || (0..n).map(|i| value(i).as_dvec3());
    let mean = values().sum::<DVec3>() / f64::from(n);
    let spread = values().map(|v| (v - mean) * (v - mean)).sum::<DVec3>();
    [mean, spread / f64::from(n) / f64::from(n - 1)]
}

/// The two strategies by which a matte surface samples the sky agree, whatever lies in between. Light samples are
/// attenuated by bodies, and scattered rays pass through bodies at random. Each strategy is used alone, and a
/// z-test compares them for each colour: on the floor, in a body, and below a body that extends into the floor.
#[test]
fn light_samples_and_scattered_rays_agree_through_bodies() {
    let wall = Material { base_colour: [0.9, 0.6, 0.3, 1.0], ..clear(1.0, None, 1.5) };
    let mut veil = Material { alpha_mode: scene::types::AlphaMode::Blend, ..matte(0.5) };
    veil.base_colour[3] = 0.4;
    let (receiver, sky, rules) =
        (Receiver::new(&plane(4.0), DVec3::ZERO), EnvironmentLight::new(&sunny()), matte_rules());
    for (name, objects) in [
        ("slab", vec![slab(0.5, 1.5, 2.0, tinted(1.5))]),
        (
            "nested",
            vec![slab(0.3, 1.5, 2.0, tinted(1.33)), ball(0.4, tinted(1.7), DVec3::new(0.0, 0.0, 0.9))],
        ),
        ("wall in glass", vec![slab(0.3, 1.5, 2.0, tinted(1.5)), slab(0.7, 0.8, 1.0, wall.clone())]),
        ("veil in glass", vec![slab(-0.1, 1.5, 2.0, tinted(1.5)), slab(0.6, 0.7, 1.5, veil)]),
        ("overlapping", vec![slab(0.3, 1.0, 2.0, tinted(1.5)), slab(0.8, 1.5, 1.0, tinted(1.2))]),
        ("wall", vec![slab(0.5, 0.6, 2.0, wall)]),
    ] {
        let objects = Objects::new(None, &objects, DVec3::ZERO).expect("consistent");
        let scene =
            Traced { receiver: &receiver, objects: &objects, sky: &sky, rules: &rules, light_points: None };
        for height in [0.0, 0.4] {
            let bsdf = Bsdf::matte(Vec3::Z, Vec3::ONE);
            let (position, normal) = (Vec3::new(0.2, -0.1, height), Vec3::Z);
            let seen = Surface {
                position,
                normal,
                margin: 1e-5,
                bsdf,
                emission: Vec3::ZERO,
                media: Default::default(),
                cover: None,
                bed: None,
                lift: Vec3::ZERO,
            };
            let around = Integrator::new(scene, 0, Pass::new(Points::new(0, 0), true)).around(seen.upright());
            let surface = Surface { media: [around; 2], ..seen };
            let path = |i: u32| (Points::new(stream(8, i, 0), 0), hash(i, 9));
            let [light, light_error] = estimate(20_000, |i| {
                let (points, key) = path(i);
                let sample = sky.sample_one(Some(normal), points.bits(0)).expect("light");
                let ray = surface.spawn_ray(sample.direction);
                let passed = Integrator::new(scene, key, Pass::new(points, true))
                    .object_transmittance(ray, key, None, around);
                passed[0] * surface.bsdf.eval(sample.direction)[0].value * sample.radiance / sample.pdf
            });
            let [scattered, scattered_error] = estimate(60_000, |i| {
                let (points, key) = path(i);
                let (_, direction, scatter) = surface.bsdf.sample(&points, 2).expect("a direction");
                let (ray, mut integrator) =
                    (surface.spawn_ray(direction), Integrator::new(scene, key, Pass::new(points, true)));
                let object = integrator.object(ray, key, Lobe::Diffuse);
                let (passed, _) = integrator.along(ray, key, Lobe::Diffuse, object.as_ref(), around);
                let seen = if object.is_none() { sky.radiance(direction) } else { Vec3::ZERO };
                passed * scatter.value * seen / scatter.pdf
            });
            for k in 0..3 {
                let z = (light[k] - scattered[k]) / (light_error[k] + scattered_error[k]).sqrt();
                assert!(z.abs() < 4.0, "{name} from {height}: {light} and {scattered}, z {z}");
                assert!(light[k] > 1e-3, "{name}");
            }
        }
    }
}

// More nested bodies than a path tracks are reported.
#[test]
fn bodies_beyond_the_deepest_are_reported() {
    let reported = |count: u32| {
        let bodies: Vec<_> = (0..count)
            .map(|k| {
                slab(0.1 * k as f32, 2.0 - 0.1 * k as f32, 1.0 - 0.1 * k as f32, tinted(1.0 + 0.1 * k as f32))
            })
            .collect();
        let (_, notes) = render(&params(1, Surroundings::OPEN), &plane(4.0), &bodies, &above(4.0), &white());
        notes.iter().find(|note| note.id == "nested-bodies").map(|note| note.text.clone())
    };
    assert_eq!(reported(4), None);
    let text = reported(6).expect("a note");
    assert!(text.starts_with("6 transparent bodies are nested"), "{text}");
    // Bodies next to each other are not nested.
    let aside: Vec<_> = (0..6).map(|k| ball(0.2, tinted(1.1), DVec3::new(f64::from(k), 0.0, 1.0))).collect();
    let (_, notes) = render(&params(1, Surroundings::OPEN), &plane(4.0), &aside, &above(4.0), &white());
    assert!(notes.iter().all(|note| note.id != "nested-bodies"));
}
