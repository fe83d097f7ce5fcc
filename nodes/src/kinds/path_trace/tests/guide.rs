//! Tests of light samples that a guide chooses.

use render::geometry::bvh::Ray;
use render::geometry::sampling::Points;
use render::transport::bsdf::Matte;
use render::transport::path::guide::{Guide, LEARNT_PATHS};
use render::transport::path::integrator::Scene as Traced;
use render::transport::path::visibility::Rules;
use render::transport::picture::camera_rays::CameraRays;
use render::transport::picture::film::{PAIR, R0};
use render::transport::picture::pair::{PairTile, trace_pair};
use render::transport::picture::r0::trace_r0;
use render::transport::picture::tile::Tile;
use render::transport::scene::block::Block;
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use render::transport::sky::environment::EnvironmentLight;

use super::*;

/// A room with a window of 1 by 1 m in the wall at y = 2, which the camera of `inside` faces, and a cupboard.
fn window_room() -> Mesh {
    let mut room = room();
    // The two triangles of the wall at y = 2.
    let wall = room.triangles.iter().position(|t| t.iter().all(|&i| room.positions[i as usize][1] == 2.0));
    let wall = wall.expect("a wall");
    room.triangles.drain(wall..wall + 2);
    let piece =
        |low: [f32; 2], high: [f32; 2]| box_mesh([low[0], 2.0, low[1]], [high[0], 2.05, high[1]], false);
    let frame = [
        piece([-2.0, 0.0], [0.0, 4.0]),
        piece([1.0, 0.0], [2.0, 4.0]),
        piece([0.0, 0.0], [1.0, 1.2]),
        piece([0.0, 2.2], [1.0, 4.0]),
        box_mesh([-1.0, 0.8, 0.0], [-0.2, 1.5, 1.7], false),
    ];
    let mut room = frame.into_iter().fold(room, merge);
    room.colours = (0..room.positions.len()).map(|i| [0.9, 0.5 + 0.005 * i as f32, 0.6]).collect();
    room
}

fn rules(max_bounces: u32) -> Rules {
    Rules {
        max_bounces,
        block: Block::Solid,
        bounce_solid: true,
        specular_env: false,
        ..samplers::matte_rules()
    }
}

fn learn(scene: Traced<'_>, camera: &CameraRays<'_>) -> Option<Guide> {
    Guide::learn(scene, camera.spread_over_image(LEARNT_PATHS), None)
        .expect("without a context nothing fails")
}

/// Traces blocks of the picture with and without the guide, and compares their means, by the spread over seeds.
/// Also returns the mean variance of a pixel of each, and the rays per sample.
fn compare(scene: Traced<'_>, seeds: u64) -> [(f64, f64); 2] {
    const BLOCK: usize = 8;
    let rig = inside();
    let none = Arc::new(None);
    let ground = &scene.objects.ground;
    let guide = Arc::new(learn(scene, &CameraRays::new(&rig.cameras[0], DVec3::ZERO, 0, ground, 1)));
    assert!(guide.is_some(), "the walls block most light");
    let side = rig.cameras[0].width_px as usize / BLOCK;
    let results = [&none, &guide].map(|guide| {
        // For each block and channel, the sums over seeds of the mean and of its square.
        let mut sums = vec![[0.0_f64; 2]; side * side * 3];
        let (mut rays, mut samples) = (0, 0);
        for seed in 0..seeds {
            let camera = CameraRays::new(&rig.cameras[0], DVec3::ZERO, seed, ground, 1).guided(guide.clone());
            for (block, sums) in sums.chunks_exact_mut(3).enumerate() {
                let (x, y) = (block % side * BLOCK, block / side * BLOCK);
                let pixel = |i: usize| ((x + i % BLOCK) as u32, (y + i / BLOCK) as u32);
                let pixels: Vec<_> = (0..BLOCK * BLOCK).map(pixel).collect();
                let tile = Tile::new(scene, &camera, &pixels, (0, 4));
                let (found, _) = trace_r0(scene, &tile, 4);
                rays += found.rays.all();
                samples += tile.samples.len() as u64;
                for (k, [sum, square]) in sums.iter_mut().enumerate() {
                    let mean: f64 = found.sums.chunks_exact(R0).map(|pixel| f64::from(pixel[k])).sum();
                    *sum += mean;
                    *square += mean * mean;
                }
            }
        }
        (sums, rays as f64 / samples as f64)
    });
    let n = seeds as f64;
    let of = |[sum, square]: [f64; 2]| (sum / n, (square / n - sum * sum / (n * n)).max(0.0) / (n - 1.0));
    let mut all = Vec::new();
    let mut spread = [0.0; 2];
    for (plain, guided) in results[0].0.iter().zip(&results[1].0) {
        let [(a, va), (b, vb)] = [*plain, *guided].map(of);
        spread[0] += va;
        spread[1] += vb;
        if va + vb > 0.0 {
            all.push((a - b) / (va + vb).sqrt());
        }
    }
    let z = all.iter().sum::<f64>() / (all.len() as f64).sqrt();
    let square = all.iter().map(|z| z * z).sum::<f64>() / all.len() as f64;
    let far = all.iter().filter(|z| z.abs() > 4.5).count();
    assert!(
        all.len() > 20 && z.abs() < 4.0 && square < 3.0 && far == 0,
        "{z} {square} {far} of {}",
        all.len()
    );
    [(spread[0], results[0].1), (spread[1], results[1].1)]
}

/// In a room with a window, a guide changes no mean, of direct light and of light after bounces. It lowers the noise
/// and casts no more rays.
#[test]
fn a_guide_changes_noise_and_no_mean() {
    let receiver = Receiver::new(&window_room(), DVec3::ZERO);
    let objects = Objects::new(None, &[], DVec3::ZERO).expect("no objects");
    let skies = [sunny(), Environment::constant(Up::PlusZ, [1.0, 0.8, 0.6], 64)]
        .map(|env| EnvironmentLight::new(&env));
    for (sky, max_bounces) in [(&skies[0], 0), (&skies[0], 3), (&skies[1], 0), (&skies[1], 3)] {
        let rules = rules(max_bounces);
        let scene = Traced { receiver: &receiver, objects: &objects, sky, rules: &rules, light_points: None };
        let [(plain, rays), (guided, fewer)] = compare(scene, 60);
        assert!(guided < plain && fewer < rays, "{max_bounces}: {plain} {guided}, rays {rays} {fewer}");
    }
}

/// There is no guide in the open, in a closed room, under near light, or if the receiver lets the light pass.
#[test]
fn a_guide_is_learnt_only_where_it_is_of_use() {
    let objects = Objects::new(None, &[], DVec3::ZERO).expect("no objects");
    let sky = EnvironmentLight::new(&sunny());
    let learnt = |mesh: &Mesh, rules: &Rules| {
        let receiver = Receiver::new(mesh, DVec3::ZERO);
        let scene = Traced { receiver: &receiver, objects: &objects, sky: &sky, rules, light_points: None };
        let rig = inside();
        learn(scene, &CameraRays::new(&rig.cameras[0], DVec3::ZERO, 5, &objects.ground, 1)).is_some()
    };
    assert!(learnt(&window_room(), &rules(8)) && learnt(&window_room(), &rules(0)));
    assert!(
        !learnt(&plane(4.0), &rules(8))
            && !learnt(&room(), &rules(8))
            && !learnt(&Mesh::default(), &rules(8))
    );
    assert!(!learnt(&window_room(), &Rules { block: Block::Pass, ..rules(8) }));
    assert!(!learnt(&window_room(), &Rules { near: Some([0.0, 0.0, 1.5]), ..rules(8) }));
}

/// Under a guide, light that objects block is light that the receiver has: where an object hides the whole window, no
/// light is left.
#[test]
fn a_guided_shadow_is_exactly_dark() {
    let receiver = Receiver::new(&window_room(), DVec3::ZERO);
    let sky = EnvironmentLight::new(&sunny());
    let rules = rules(0);
    // A ball so large that it is a wall in front of the window, in all directions from the room.
    let wall = ball(3000.0, matte(0.6), DVec3::new(0.0, 3002.5, 1.5));
    let objects = Objects::new(Some(&receiver), &[wall], DVec3::ZERO).expect("consistent");
    let scene =
        Traced { receiver: &receiver, objects: &objects, sky: &sky, rules: &rules, light_points: None };
    let rig = inside();
    let camera = CameraRays::new(&rig.cameras[0], DVec3::ZERO, 5, &objects.ground, 1);
    let guide = Arc::new(learn(scene, &camera));
    assert!(guide.is_some());
    let camera = camera.guided(guide);
    let pixels: Vec<(u32, u32)> = (0..64).map(|i| (8 + i % 8, 8 + i / 8)).collect();
    let tile = Tile::new(scene, &camera, &pixels, (0, 4));
    // Pixels that show nothing but the receiver.
    let shows: Vec<bool> = tile
        .samples
        .chunks_exact(4)
        .map(|samples| samples.iter().all(|sample| sample.hit.is_some()))
        .collect();
    let (r0, firsts) = trace_r0(scene, &tile, 4);
    let of_tile =
        PairTile { pixels: &pixels, range: (0, 4), r0: &r0.sums, bounds: r0.bounds.unwrap_or_default() };
    let pair = trace_pair(scene, &camera, None, &of_tile, Some((tile, firsts)));
    let mut lit = 0;
    let sums = r0.sums.chunks_exact(R0).zip(pair.sums.chunks_exact(PAIR));
    for ((without, with), _) in sums.zip(&shows).filter(|(_, shows)| **shows) {
        lit += u32::from(without[0] > 0.0);
        assert_eq!(with[..3], [0.0; 3]);
    }
    assert!(lit > 10, "{lit} pixels with light");
}

/// Guided light samples bring the light that scattered rays find through the window.
#[test]
fn guided_light_is_what_the_window_shows() {
    let receiver = Receiver::new(&window_room(), DVec3::ZERO);
    let objects = Objects::new(None, &[], DVec3::ZERO).expect("no objects");
    let env = Environment::constant(Up::PlusZ, [1.0; 3], 64);
    let sky = EnvironmentLight::new(&env);
    let rules = rules(0);
    let scene =
        Traced { receiver: &receiver, objects: &objects, sky: &sky, rules: &rules, light_points: None };
    let rig = inside();
    let camera = CameraRays::new(&rig.cameras[0], DVec3::ZERO, 5, &objects.ground, 1);
    let guide = learn(scene, &camera).expect("a guide");
    let hit = receiver.bvh.closest(camera.through(12.0, 20.0), |_| true).expect("a hit");
    let (start, normal) = (receiver.start(&hit), receiver.facing(&hit));
    let albedo = receiver.albedo_at(&hit);
    let n = 40_000;
    let (mut guided, mut scattered) = (0.0, 0.0);
    for i in 0..n {
        let points = Points::new(17, i);
        let distributions = guide.distributions(&sky, start, normal);
        let numbers = sky.numbers(distributions, None);
        let (tier, point) = sky.tier(numbers, points.bits(0));
        let light = sky.light(&sky.draw_one(tier, distributions[tier], numbers[tier], point));
        let ray = Ray::new(start, light.direction);
        let cosine = light.direction.dot(normal).max(0.0);
        if cosine > 0.0 && !receiver.bvh.any(ray, |_| true) {
            guided += f64::from(cosine * light.radiance.x / light.pdf / std::f32::consts::PI);
        }
        let matte = Matte::new(normal, albedo);
        if let Some((direction, _)) = matte.sample(&points, 1) {
            let ray = Ray::new(start, direction);
            scattered += f64::from(u32::from(!receiver.bvh.any(ray, |_| true)));
        }
    }
    assert!(scattered > 300.0 && (guided / scattered - 1.0).abs() < 0.05, "{guided} {scattered}");
}
