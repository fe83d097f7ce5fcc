//! Tests of random choices without a density: positions in a pixel, Russian roulette, coverage of surfaces.
//! Samplers of directions and points have chi-square tests in their own files.

use super::*;
use render::geometry::bvh::Ray;
use render::geometry::sampling::{Points, hash, stream};
use render::transport::path::integrator::{Integrator, Pass, Scene as Traced};
use render::transport::path::visibility::Rules;
use render::transport::picture::camera_rays::CameraRays;
use render::transport::scene::block::Block;
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use render::transport::scene::supports::Ground;
use render::transport::sky::environment::EnvironmentLight;
use testing::chi_square;

/// Rules for a receiver that lets the sky through and emits no light.
pub(super) fn matte_rules() -> Rules {
    Rules {
        block: Block::Pass,
        bounce_solid: false,
        specular_env: true,
        printed: false,
        near: None,
        max_bounces: 8,
        clamp: f32::MAX,
    }
}

/// Compares the frequency of an event over independent samples with its probability.
fn expect_share(what: &str, probability: f64, happens: impl Fn(u32) -> bool) {
    let n = 100_000;
    let count = f64::from((0..n).map(|i| u32::from(happens(i))).sum::<u32>());
    let (n, expected) = (f64::from(n), f64::from(n) * probability);
    let z = chi_square(&[count, n - count], &[expected, n - expected]);
    assert!(z < 4.0, "{what}: {count} of {n} for {expected}");
}

/// With the box filter, the first sample is uniformly distributed over its pixel, over many seeds. This test fails
/// if `points.pair(0)` is squared in `CameraRays::sample`.
#[test]
fn samples_fill_their_pixel_evenly() {
    let (rig, ground) = (inside(), Ground::default());
    let mut counts = vec![0.0; 16 * 16];
    let n = 50_000;
    for seed in 0..n {
        let camera = CameraRays::new(&rig.cameras[0], DVec3::ZERO, seed, &ground, 1);
        let (_, _, ray) = camera.sample((7, 12), 0);
        let [x, y, z] = camera.axes.map(|axis| axis.dot(ray.direction.as_dvec3()));
        let lens = camera.camera;
        let place = [lens.fx * x / z + lens.cx - 7.0, lens.fy * y / z + lens.cy - 12.0];
        let [column, row] = place.map(|v| {
            assert!((-1e-5..1.0 + 1e-5).contains(&v), "{v}");
            ((16.0 * v) as usize).min(15)
        });
        counts[16 * row + column] += 1.0;
    }
    let z = chi_square(&counts, &[n as f64 / 256.0; 256]);
    assert!(z < 4.0, "{z}");
}

/// Paths of low throughput end at random, and the surviving paths are weighted so that the mean is unchanged. This
/// test fails if `throughput / survival` is replaced by `throughput`, or `0.05` by `0.2`.
#[test]
fn russian_roulette_keeps_what_paths_bring() {
    let (receiver, objects) =
        (Receiver::new(&plane(1.0), DVec3::ZERO), Objects::new(None, &[], DVec3::ZERO).expect("none"));
    let sky = EnvironmentLight::new(&white());
    let rules = matte_rules();
    let scene =
        Traced { receiver: &receiver, objects: &objects, sky: &sky, rules: &rules, light_points: None };
    for (throughput, survival) in [(2.0_f32, 0.95), (0.6, 0.6), (0.1, 0.1), (0.001, 0.05)] {
        let throughput = Vec3::new(0.25, 1.0, 0.5) * throughput;
        let left = |i: u32, bounce: u32| {
            let points = Points::new(stream(6, i, 0), 0);
            Integrator::new(scene, 0, Pass::new(points, false)).russian_roulette(bounce, throughput, 1.0)
        };
        expect_share("survival", survival, |i| left(i, 3).is_some());
        for i in 0..100 {
            assert_eq!(left(i, 0), Some(throughput), "short paths go on");
            let brought = left(i, 5).map_or(1.0, |left| left.y * survival as f32 / throughput.y);
            assert!((brought - 1.0).abs() < 1e-6, "{brought}");
        }
    }
}

/// A ray of any kind stops at a blended surface with a probability equal to the alpha of the surface. At a surface
/// that lets light pass straight through, the probability is one minus the transmittance. This test fails if `<
/// coverage` is replaced by `<= coverage * coverage` in `Objects::accepts`, or `!key` by `1` in
/// `Objects::closest_straight`.
#[test]
fn surfaces_are_met_as_often_as_they_hide() {
    let ray = Ray::new(Vec3::new(0.1, 0.2, 3.0), Vec3::NEG_Z);
    let key = |i: u32| hash(hash(stream(7, i % 100, 3), i / 100), 5);
    let of = |material| {
        Objects::new(None, &[placed(&plane(1.0), material, DVec3::ZERO)], DVec3::ZERO).expect("one")
    };
    for alpha in [0.02_f32, 0.3, 0.9] {
        let mut material = Material { alpha_mode: scene::types::AlphaMode::Blend, ..matte(0.5) };
        material.base_colour[3] = alpha;
        let objects = of(material);
        let met = |i| objects.bvh.any(ray, |hit| objects.accepts(hit, key(i), false));
        expect_share("alpha", f64::from(alpha), met);
    }
    for colour in [0.3_f32, 0.8] {
        let mut wall = materials::clear(1.0, None, 1.0);
        wall.base_colour[..3].fill(colour);
        let objects = of(wall);
        expect_share("straight", 1.0 - f64::from(colour), |i| {
            objects.closest_straight(ray, key(i)).is_some()
        });
    }
}
