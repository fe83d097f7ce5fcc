//! Tests of a glossy receiver: energy, a mirrored object, and a reference without importance sampling.

use super::*;
use render::geometry::bvh::Ray;
use render::geometry::sampling::{Points, stream};
use render::transport::bsdf::Matte;
use render::transport::path::integrator::{Integrator, Pass, Scene as Traced};
use render::transport::path::path::Vertex;
use render::transport::path::visibility::Rules;
use render::transport::scene::block::Block;
use render::transport::scene::media::Media;
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use render::transport::scene::surface::Surface;
use render::transport::sky::environment::EnvironmentLight;
use scene::types::Gloss;

/// Gloss of a dielectric of index 1.5.
fn polish(roughness: f32) -> Gloss {
    Gloss { roughness, metallic: 0.0, ior: 1.5, specular: 1.0, normal: [0.0; 3] }
}

fn mirror() -> Gloss {
    Gloss { metallic: 1.0, ..polish(0.0) }
}

fn glossy(mesh: Mesh, gloss: Gloss, albedo: f32) -> Mesh {
    Mesh {
        colours: vec![[albedo; 3]; mesh.positions.len()],
        glosses: vec![gloss],
        gloss_of: vec![1; mesh.triangles.len()],
        ..mesh
    }
}

/// Parameters with the panorama projected onto the mesh, and an environment with a point of capture.
fn projected(samples: u32, env: Environment) -> (PathTrace, Environment) {
    let env = Environment { origin: Some(DVec3::new(0.3, -0.2, 1.5)), ..env };
    (params(samples, Surroundings::Projected), env)
}

fn every_place(samples: u32, env: &Environment) -> Vec<(PathTrace, Environment)> {
    let far = [Surroundings::OPEN, Surroundings::TRANSPARENT, Surroundings::ROOM];
    let mut all: Vec<_> = far.map(|place| (params(samples, place), env.clone())).into();
    all.push(projected(samples, env.clone()));
    all
}

/// A white floor under a white sky is white, however rough, with every model of the place; and so is a white ball on
/// it, with all reflections between the two. This test fails if the specular lobe is left out of `light_sample`, or if
/// `is_paired` ignores gloss.
#[test]
fn a_white_glossy_floor_keeps_all_light() {
    let camera = rig(DVec3::new(0.0, -3.0, 1.2), DVec3::ZERO, 12, 4.0);
    for gloss in [polish(0.0), polish(0.2), polish(0.7), mirror(), Gloss { metallic: 0.5, ..polish(0.4) }] {
        let floor = glossy(plane(40.0), gloss, 1.0);
        for (how, env) in every_place(64, &white()) {
            let (out, _) = render(&how, &floor, &[], &camera, &env);
            let light = mean(&out.without);
            assert!((light - 1.0).abs() < 0.01, "{gloss:?} {:?}: {light}", how.surroundings);
        }
        let chrome = Material { metallic: 1.0, roughness: 0.3, ior: 1.5, ..matte(1.0) };
        let objects =
            [ball(0.4, matte(1.0), DVec3::new(0.5, 0.0, 0.5)), ball(0.4, chrome, DVec3::new(-0.5, 0.0, 0.5))];
        let how = PathTrace { max_bounces: 64, ..params(256, Surroundings::OPEN) };
        let (out, _) = render(&how, &floor, &objects, &camera, &white());
        let light = mean(&out.with);
        assert!((light - 1.0).abs() < 0.015, "{gloss:?} with balls: {light}");
    }
}

/// Where no path can meet an object, both renders are equal bit for bit. This test fails if `paired_estimate` gives its
/// second path other random numbers, and adds the difference of paths that touch no object.
#[test]
fn what_meets_no_object_is_the_same_bit_for_bit() {
    let (_, _, camera) = shadowed();
    let below = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let floor = glossy(plane(4.0), polish(0.3), 0.5);
    for (how, env) in every_place(8, &sunny()) {
        let (out, _) = render(&how, &floor, &below, &camera, &env);
        assert_eq!(samples(&out.without), samples(&out.with), "{:?}", how.surroundings);
        assert!(mean(&out.without) > 0.0);
    }
}

/// A mesh whose triangles are all matte gives the bits of a mesh without gloss, although the list has one. This test
/// fails if `Receiver::made` keeps a list of zeros.
#[test]
fn a_mesh_of_matte_triangles_is_matte() {
    let (floor, objects, camera) = shadowed();
    let listed = Mesh { glosses: vec![mirror()], gloss_of: vec![0; floor.triangles.len()], ..floor.clone() };
    let how = params(8, Surroundings::OPEN);
    let [a, b] = [&floor, &listed].map(|mesh| render(&how, mesh, &objects, &camera, &sunny()).0);
    assert_eq!(samples(&a.without), samples(&b.without));
    assert_eq!(samples(&a.with), samples(&b.with));
}

/// A mirror on the floor shows the object as a camera below the floor sees it: where a ray of that camera meets the
/// ball, `with` has the colour of the ball, and elsewhere that of the sky. This test fails if `Bsdf::glossy`
/// ignores the normal of the gloss, or if `is_paired` ignores gloss.
#[test]
fn a_mirror_shows_the_object_where_it_is_mirrored() {
    let (eye, target) = (DVec3::new(0.0, -3.0, 1.0), DVec3::new(0.0, 0.0, -0.6));
    let objects =
        [ball(0.35, Material { emissive: [3.0, 0.5, 0.1], ..matte(0.0) }, DVec3::new(0.15, 0.0, 0.9))];
    let camera = rig(eye, target, 32, 4.0);
    // Mirrored at the floor, the picture is upside down.
    let flipped = |v: DVec3| DVec3::new(v.x, v.y, -v.z);
    let below = rig(flipped(eye), flipped(target), 32, 4.0);
    let how = params(16, Surroundings::OPEN);
    let (seen, _) = render(&how, &Mesh::default(), &objects, &below, &white());
    // Value of a pixel away from outlines, where both pictures show the same surface.
    let alpha = |x: usize, y: usize| {
        let around = |k: usize| samples(&seen.object)[4 * ((31 - y + k / 3 - 1) * 32 + x + k % 3 - 1) + 3];
        (0..9).all(|k| around(k) == around(4)).then(|| around(4))
    };
    let count = |floor: &Mesh| {
        let (out, _) = render(&how, floor, &objects, &camera, &white());
        let (mut shown, mut off) = ([0; 2], 0);
        for (y, x) in (1..31).flat_map(|y| (1..31).map(move |x| (y, x))) {
            let Some(alpha) = alpha(x, y) else { continue };
            let wanted: [f32; 3] = if alpha == 1.0 { [3.0, 0.5, 0.1] } else { [1.0; 3] };
            let with = &samples(&out.with)[3 * (y * 32 + x)..][..3];
            shown[usize::from(alpha == 1.0)] += 1;
            // A sample in the tail of the facets has another weight.
            off += u32::from(with.iter().zip(wanted).any(|(a, b)| (a - b).abs() > 0.1 * b));
        }
        assert!(shown[0] > 200 && shown[1] > 20, "{shown:?}");
        off
    };
    let upright = Gloss { normal: [0.0, 0.0, -1.0], ..mirror() };
    assert_eq!([mirror(), upright].map(|gloss| count(&glossy(plane(40.0), gloss, 1.0))), [0, 0]);
    // With a normal of its own, the gloss does not show the bumps of the mesh, here of four millimetres.
    let bumpy = |gloss| {
        let at = |i: u32| [(i % 61) as f32 * 0.1 - 3.0, (i / 61) as f32 * 0.1 - 3.0];
        let height = |i: u32| 0.004 * f32::from((i * 7919 % 31 % 2) as u8);
        let quads = (0..60 * 60).map(|i| i / 60 * 61 + i % 60);
        let triangles = quads.flat_map(|i| [[i, i + 1, i + 62], [i, i + 62, i + 61]]).collect();
        let positions = (0..61 * 61).map(|i| [at(i)[0], at(i)[1], height(i)]).collect();
        count(&glossy(Mesh { positions, triangles, ..Mesh::default() }, gloss, 1.0))
    };
    let found = [upright, mirror()].map(bumpy);
    assert!(found[0] < 10 && found[1] > 15, "{found:?}");
}

/// Light that a surface reflects, by a direction around its normal: no light samples, no lobes, no weights.
fn plainly_lit(scene: &Traced<'_>, surface: &Surface, objects: bool, random: Points, bounce: u32) -> Vec3 {
    let around = Matte::new(surface.normal, Vec3::ONE);
    let Some(towards) = around.direction(random.pair(bounce)) else { return Vec3::ZERO };
    let [diffuse, specular] = surface.bsdf.eval(towards);
    let weight = (diffuse.value + specular.value) / around.eval(towards).pdf;
    weight * plain_radiance(scene, surface.spawn_ray(towards), objects, random, bounce + 1)
}

/// Radiance of the ray that reaches the vertex after `bounce` scatterings.
fn plain_radiance(scene: &Traced<'_>, ray: Ray, objects: bool, random: Points, bounce: u32) -> Vec3 {
    let (landed, out) = (scene.receiver.bvh.closest(ray, |_| true), -ray.direction);
    let met = if objects { scene.objects.bvh.closest(ray, |_| true) } else { None };
    let met = met.filter(|met| landed.is_none_or(|landed| met.t < landed.t));
    let surface = match (met, landed) {
        (Some(hit), _) => scene.objects.surface(&hit, out, false, 0.0, Media::default()),
        (None, Some(hit)) => scene.receiver.surface(&hit, out),
        (None, None) => return scene.sky.eval_one(None, ray.direction).radiance,
    };
    if bounce > scene.rules.max_bounces {
        return Vec3::ZERO;
    }
    plainly_lit(scene, &surface, objects, random, bounce)
}

/// R0 and R1 agree with a reference that samples every direction alike, within 4 standard errors,
/// on a floor with a sun and a ball, for two roughnesses and a metal. This test fails if the specular lobe is left
/// out of `light_sample`.
#[test]
fn light_agrees_with_a_reference_without_importance_sampling() {
    let mut env = Environment::constant(Up::PlusZ, [0.3, 0.4, 0.6], 16);
    for (x, y) in [(5, 1), (6, 1), (5, 2), (6, 2)] {
        env.image.pixel_mut(x, y).copy_from_slice(&[9.0, 8.0, 7.0]);
    }
    let sky = EnvironmentLight::new(&env);
    let rules =
        Rules { block: Block::Solid, bounce_solid: true, specular_env: false, ..samplers::matte_rules() };
    let rules = Rules { max_bounces: 2, ..rules };
    let ray = Ray::new(Vec3::new(0.1, -2.0, 1.0), Vec3::new(0.0, 2.2, -1.0).normalize());
    for gloss in [polish(0.5), polish(0.8), Gloss { metallic: 1.0, ..polish(0.6) }] {
        // A wall behind makes reflections of the receiver in itself.
        let mut mesh = merge(plane(6.0), box_mesh([-2.0, 1.2, 0.0], [2.0, 1.4, 1.5], false));
        mesh = glossy(mesh, gloss, 0.6);
        mesh.gloss_of[5] = 0;
        let receiver = Receiver::new(&mesh, DVec3::ZERO);
        let bright = Material { base_colour: [0.9, 0.3, 0.2, 1.0], ..matte(0.5) };
        let balls = [ball(0.3, bright, DVec3::new(0.0, 0.7, 0.45))];
        let objects = Objects::new(Some(&receiver), &balls, DVec3::ZERO).expect("consistent");
        let scene =
            Traced { receiver: &receiver, objects: &objects, sky: &sky, rules: &rules, light_points: None };
        let hit = scene.receiver.bvh.closest(ray, |_| true).expect("the floor");
        let surface = receiver.surface(&hit, -ray.direction);
        let n = 60_000;
        let each = |of: &dyn Fn(Points, u32) -> Vec3| {
            let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
            for i in 0..n {
                // Points that are independent of one another.
                let light = of(Points::new(stream(8, i, 0), 0), i).as_dvec3();
                (sum, squares) = (sum + light, squares + light * light);
            }
            let mean = sum / f64::from(n);
            (mean, (squares / f64::from(n) - mean * mean).max(DVec3::ZERO) / f64::from(n))
        };
        for objects in [false, true] {
            let (found, a) = each(&|points, key| {
                Integrator::new(scene, key, Pass::new(points, objects)).radiance(Vertex::Receiver(hit), ray)
            });
            let (expected, b) = each(&|points, _| plainly_lit(&scene, &surface, objects, points, 0));
            let z = ((found - expected) / (a + b).map(f64::sqrt)).abs().max_element();
            let off = ((found - expected) / expected).abs().max_element();
            assert!(z < 4.0 && off < 0.03, "{gloss:?} {objects}: {found} for {expected}, z {z}");
        }
    }
}

/// A mirror floor under a uniform panorama shows what it would show in the open, whether the panorama is projected
/// onto it or infinitely far: the light of the floor, of the balls that it mirrors, and of its own image in a metal ball.
/// This test fails if `goes_on_at` is always false: the metal ball then shows the floor without the dark ball.
#[test]
fn a_mirror_in_a_mirror_shows_the_object() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.6), DVec3::new(0.0, 0.0, 0.4), 32, 3.0);
    let floor = glossy(plane(40.0), mirror(), 1.0);
    let chrome = Material { metallic: 1.0, roughness: 0.0, ior: 1.5, ..matte(1.0) };
    let objects =
        [ball(0.4, matte(0.0), DVec3::new(0.45, 0.0, 0.9)), ball(0.4, chrome, DVec3::new(-0.45, 0.0, 0.5))];
    let open = render(&params(64, Surroundings::OPEN), &floor, &objects, &camera, &white()).0;
    let (how, env) = projected(64, white());
    let near = render(&how, &floor, &objects, &camera, &env).0;
    for (a, b) in [(&open.with, &near.with), (&open.object, &near.object)] {
        let off = samples(a).iter().zip(samples(b)).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
        let off = off / samples(a).len() as f64;
        assert!(off < 1e-3, "{off}");
    }
}
