//! Tests of paths that are traced many at once, or only to find out whether they touch an object.

use super::*;
use render::geometry::bvh::{Hit, Ray};
use render::geometry::sampling::{Points, hash, stream};
use render::transport::path::change::ChangeSampling;
use render::transport::path::integrator::{Integrator, Pass, Scene as Traced};
use render::transport::path::light_points::LightPoints;
use render::transport::path::path::{Vertex, first_pair};
use render::transport::path::receiver_paths::{ReceiverPaths, TOGETHER};
use render::transport::path::visibility::Rules;
use render::transport::picture::camera_rays::CameraRays;
use render::transport::picture::film::{Area, TILE, TileSums};
use render::transport::picture::pair::{PairTile, trace_pair};
use render::transport::picture::r0::trace_r0;
use render::transport::picture::tile::Tile;
use render::transport::scene::block::{Block, EVERYWHERE};
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use render::transport::sky::environment::EnvironmentLight;
use render::transport::sky::light_draws::LightDraws;
use testing::direction;

/// Point of capture.
const EYE: Vec3 = Vec3::new(-0.9, -0.7, 1.1);

/// A coloured room with one wall missing, and a cupboard in it.
fn open_room() -> Mesh {
    let mut room = merge(room(), box_mesh([-0.6, 0.8, 0.0], [0.9, 1.5, 1.7], false));
    room.triangles.drain(10..12);
    room.colours = (0..room.positions.len()).map(|i| [0.9, 0.2 + 0.04 * i as f32, 0.5]).collect();
    room
}

fn rules() -> Vec<Rules> {
    let rules = |block, near: bool, max_bounces, clamp| Rules {
        block,
        bounce_solid: true,
        specular_env: false,
        printed: false,
        near: near.then(|| EYE.to_array()),
        max_bounces,
        clamp,
    };
    let front = Block::FrontFace { max_layers: 3, flip: false, within: EVERYWHERE };
    vec![
        rules(Block::Solid, false, 8, f32::MAX),
        rules(Block::Solid, false, 0, f32::MAX),
        rules(Block::Solid, false, 3, 0.05),
        Rules { bounce_solid: false, ..rules(front, false, 8, f32::MAX) },
        rules(front, false, 8, f32::MAX),
        rules(Block::Pass, false, 2, f32::MAX),
        rules(Block::Solid, true, 8, f32::MAX),
        rules(Block::Solid, true, 0, f32::MAX),
        rules(Block::Solid, true, 8, 0.05),
    ]
}

/// Camera rays and their hits on the receiver.
fn starts(receiver: &Receiver) -> Vec<(Points, u32, Ray, Hit)> {
    let start = |i: u32| {
        let points = Points::new(stream(4, i / 4, 0), i % 4);
        let ray = Ray::new(Vec3::new(0.2, -0.4, 1.6), direction(points.pair(0)));
        Some((points, hash(i, 5), ray, receiver.bvh.closest(ray, |_| true)?))
    };
    (0..3_000).filter_map(start).collect()
}

/// A path traced in a batch gives the same bits as the path alone, and casts as many rays. This test fails if
/// `first_pair(bounce)` in `ReceiverPaths::draw` is replaced with `first_pair(1)`, or if `rules.clamped` is left
/// out of `ReceiverPaths::advance_near`.
#[test]
fn a_path_in_a_batch_is_the_path_alone() {
    let (receiver, none) = (Receiver::new(&open_room(), DVec3::ZERO), Objects::new(None, &[], DVec3::ZERO));
    let (objects, sky) = (none.expect("no objects"), EnvironmentLight::new(&sunny()));
    for rules in &rules() {
        let scene = Traced { receiver: &receiver, objects: &objects, sky: &sky, rules, light_points: None };
        let starts = starts(&receiver);
        assert!(starts.len() > 10 * TOGETHER && !starts.len().is_multiple_of(TOGETHER));
        let mut draws = LightDraws::new(&sky, sky.lights, first_pair(0), {
            let vertex = |(points, _, _, hit): &(Points, u32, Ray, Hit)| {
                Some((*points, sky.distributions(Some(receiver.facing(hit)))))
            };
            starts.iter().map(vertex)
        });
        let (mut paths, mut together) = (ReceiverPaths::new(scene), Vec::new());
        for batch in starts.chunks(TOGETHER) {
            batch.iter().for_each(|(points, _, _, hit)| paths.push(*points, hit, draws.next_vertex()));
            together.extend_from_slice(paths.radiance());
        }
        let (mut rays, mut lit) = (Default::default(), 0);
        for ((points, key, ray, hit), together) in starts.iter().zip(&together) {
            let mut integrator = Integrator::new(scene, *key, Pass::new(*points, false));
            let alone = integrator.radiance(Vertex::Receiver(*hit), *ray);
            rays += integrator.tally.rays;
            assert_eq!(
                together.to_array().map(f32::to_bits),
                alone.to_array().map(f32::to_bits),
                "{rules:?}"
            );
            lit += u32::from(alone != Vec3::ZERO);
        }
        assert_eq!(paths.rays, rays, "{rules:?}");
        assert!(lit > 100, "{lit} paths with light: {rules:?}");
    }
}

/// Under near light, the change is the difference of two whole paths for every sample, also for those samples whose
/// light is not computed because they touch no object. This test fails if `light_sample` returns before `dimming`
/// for `touch_only` paths, if `lit_as_known` leaves out `dimming`, or if `known` in `scattering.rs` also serves rays
/// that hit an object.
#[test]
fn paths_that_touch_nothing_change_nothing() {
    let receiver = Receiver::new(&open_room(), DVec3::ZERO);
    let sky = EnvironmentLight::new(&sunny());
    let ball = ball(0.3, matte(0.6), DVec3::new(0.4, -0.6, 1.4));
    let objects = Objects::new(Some(&receiver), &[ball], DVec3::ZERO).expect("consistent");
    let light_points = LightPoints::new(&receiver, &sky, EYE);
    for rules in rules().iter().filter(|rules| rules.near.is_some()) {
        let light_points = Some(&light_points);
        let scene = Traced { receiver: &receiver, objects: &objects, sky: &sky, rules, light_points };
        let (low, high) = objects.bvh.bounds().expect("a ball");
        let (mut changed, mut same, mut open) = (0, 0, 0);
        for (points, key, ray, hit) in starts(&receiver) {
            let start = ray.origin + ray.direction * hit.t;
            let sampling = ChangeSampling {
                drawn: &[],
                known: None,
                probability: 1.0,
                start,
                objects: [low, high],
                rays: 0.0,
                lift: Vec3::ZERO,
            };
            let found = Integrator::new(scene, key, Pass::new(points, true)).change(hit, ray, &sampling);
            let whole = |objects| {
                Integrator::new(scene, key, Pass::new(points, objects)).radiance(Vertex::Receiver(hit), ray)
            };
            assert_eq!(found, whole(true) - whole(false), "{rules:?}");
            // Given what the path without objects finds at its first vertex, the change is the same up to rounding.
            let most = 1e-5 * (whole(true) + whole(false)).max_element();
            let mut paths = ReceiverPaths::new(scene);
            for whole_path in [true, false] {
                paths.push(points, &hit, &[]);
                let first = if whole_path {
                    paths.radiance();
                    paths.firsts()[0]
                } else {
                    paths.only_firsts()[0]
                };
                open += u32::from(first.light.is_none());
                let sampling = ChangeSampling { known: Some(&first), ..sampling };
                let known = Integrator::new(scene, key, Pass::new(points, true)).change(hit, ray, &sampling);
                assert!((known - found).abs().max_element() <= most, "{known} {found} {first:?}");
                assert!((known == Vec3::ZERO) || found != Vec3::ZERO, "{rules:?}");
            }
            if found == Vec3::ZERO { same += 1 } else { changed += 1 }
        }
        assert!(changed > 100 && same > 100, "{changed} of {same}");
        assert!(open > 10 || rules.max_bounces == 0, "{open} paths go on");
    }
}

/// Rays towards the objects, which are additional to the whole paths of near light, leave the mean of the change as it
/// is and reduce its variance. This test fails if `go_on` does not weight the hits of scattered rays by
/// `Towards::share`.
#[test]
fn rays_towards_objects_find_the_same_change_with_less_noise() {
    let receiver = Receiver::new(&open_room(), DVec3::ZERO);
    let sky = EnvironmentLight::new(&sunny());
    let ball = ball(0.3, matte(0.6), DVec3::new(0.4, -0.6, 1.4));
    let objects = Objects::new(Some(&receiver), &[ball], DVec3::ZERO).expect("consistent");
    let light_points = LightPoints::new(&receiver, &sky, EYE);
    let near = |rules: &&Rules| rules.near.is_some() && rules.max_bounces > 0 && rules.clamp == f32::MAX;
    for rules in rules().iter().filter(near) {
        let light_points = Some(&light_points);
        let scene = Traced { receiver: &receiver, objects: &objects, sky: &sky, rules, light_points };
        let (low, high) = objects.bvh.bounds().expect("a ball");
        let (mut sum, mut square, mut squares, mut n) = (0.0, 0.0, [0.0; 2], 0.0);
        for (_, key, ray, hit) in starts(&receiver) {
            for sample in 0..8 {
                let points = Points::new(stream(6, key, 0), sample);
                let change = |rays| {
                    let start = ray.origin + ray.direction * hit.t;
                    let (drawn, known, objects) = (&[][..], None, [low, high]);
                    let lift = Vec3::ZERO;
                    let sampling =
                        ChangeSampling { drawn, known, probability: 1.0, start, objects, rays, lift };
                    let mut integrator = Integrator::new(scene, key, Pass::new(points, true));
                    f64::from(luminance(integrator.change(hit, ray, &sampling).to_array()))
                };
                let [with, without] = [1.0, 0.0].map(change);
                let difference = with - without;
                sum += difference;
                square += difference * difference;
                // The light that the object throws onto the receiver; its shadow has more noise than that.
                squares[0] += with.max(0.0) * with.max(0.0);
                squares[1] += without.max(0.0) * without.max(0.0);
                n += 1.0;
            }
        }
        let z = sum / square.sqrt();
        assert!(z.abs() < 4.0 && square > 0.0, "{z}: {rules:?}");
        assert!(squares[0] < 0.9 * squares[1], "{squares:?} of {n}: {rules:?}");
    }
}

/// A tile has the same sums and counts with objects whether the rays that it shares with the receiver alone are
/// traced once or again. This test fails if `first_vertices` counts its rays, or if it takes the samples in another
/// order.
#[test]
fn shared_rays_are_the_rays_of_each() {
    let receiver = Receiver::new(&open_room(), DVec3::ZERO);
    let sky = EnvironmentLight::new(&sunny());
    let ball = ball(0.3, matte(0.6), DVec3::new(0.4, -0.6, 1.4));
    let objects = Objects::new(Some(&receiver), &[ball], DVec3::ZERO).expect("consistent");
    let light_points = LightPoints::new(&receiver, &sky, EYE);
    let (rig, range) = (inside(), (0, 4));
    let camera = &rig.cameras[0];
    let camera_rays = CameraRays::new(camera, DVec3::ZERO, 3, &objects.ground, 1);
    for rules in &rules() {
        let light_points = rules.near.map(|_| &light_points);
        let scene = Traced { receiver: &receiver, objects: &objects, sky: &sky, rules, light_points };
        let mut untouched = 0;
        for piece in Area::whole(camera).pieces(TILE) {
            let pixels: Vec<_> = piece.each().collect();
            let tile = Tile::new(scene, &camera_rays, &pixels, range);
            let (r0, firsts) = trace_r0(scene, &tile, 4);
            let bounds = r0.bounds.expect("bounds of a tile");
            let of_tile = PairTile { pixels: &pixels, range, r0: &r0.sums, bounds };
            let trace =
                |traced| TileSums::followed(true, || trace_pair(scene, &camera_rays, None, &of_tile, traced));
            let (together, again) = (trace(Some((tile, firsts))), trace(None));
            assert_eq!(together.sums, again.sums, "{rules:?}");
            assert_eq!(together.rays, again.rays, "{rules:?}");
            untouched += together.untouched;
        }
        assert!(untouched < Area::whole(camera).pixels() as u64, "{rules:?}");
    }
}
