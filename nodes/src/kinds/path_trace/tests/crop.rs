//! Tests of the cropping of tiles that are too far from the objects.

use render::geometry::sampling::{hash, unit};
use scene::types::Image;

use super::*;

/// A scene seen from far away.
struct Afar {
    receiver: Mesh,
    object: Arc<Placed>,
    env: Environment,
    how: PathTrace,
}

/// Result of a trace.
struct Traced {
    /// Ratio S for each pixel and channel.
    ratio: Vec<f64>,
    /// Number of rays.
    rays: u64,
    /// Text of the note on cropping, if there is one.
    reported: Option<String>,
    /// All outputs of the node.
    out: Out,
}

impl Afar {
    fn new(env: Environment, material: Material) -> Self {
        let object = ball(0.4, material, DVec3::new(0.0, 0.0, 0.5));
        Self { receiver: plane(40.0), object, env, how: params(16, Surroundings::OPEN) }
    }

    fn trace(&self, crop: f64, with: bool) -> Traced {
        self.trace_in(crop, with, 64)
    }

    fn trace_in(&self, crop: f64, with: bool, size: u32) -> Traced {
        let camera = rig(DVec3::new(0.0, -10.0, 8.0), DVec3::ZERO, size, 0.9);
        let (cx, how) = (context(), PathTrace { crop, ..self.how.clone() });
        let objects = [self.object.clone()];
        let objects = if with { &objects[..] } else { &[] };
        let (out, notes) = render_in(&cx, &how, &self.receiver, objects, &camera, &self.env);
        let reported = notes.iter().find(|note| note.id == "cropped").map(|note| note.text.clone());
        let pairs = samples(&out.without).iter().zip(samples(&out.with));
        let ratio = pairs.map(|(a, b)| if *a > 0.0 { f64::from(b / a) } else { 1.0 }).collect();
        Traced { ratio, rays: cx.counts()["rays"], reported, out }
    }
}

/// S is exactly 1 where tiles are cropped, and only there. The omitted change is within the bound. The change is
/// measured with more samples and averaged over tiles, to reduce noise.
#[test]
fn what_is_left_out_is_within_the_bound() {
    let dark = Mesh { colours: vec![[0.02, 0.05, 0.4]; 4], ..plane(40.0) };
    let mirror = Material { metallic: 1.0, roughness: 0.0, base_colour: [1.0; 4], ..matte(1.0) };
    let scenes = [
        ("floor", Afar::new(white(), matte(0.5)), 0.002),
        ("floor in the sun", Afar::new(sunny(), matte(0.5)), 0.002),
        ("dark ground", Afar { receiver: dark, ..Afar::new(sunny(), matte(0.9)) }, 0.01),
        ("mirror under a sky", Afar::new(white(), mirror), 0.004),
    ];
    for (name, scene, limit) in scenes {
        // One chunk of samples, which is cropped independently, and more samples as the reference.
        let few = Afar { how: PathTrace { samples: 4, ..scene.how.clone() }, ..scene };
        let (cropped, full) = (few.trace(limit, true), few.trace(0.0, true));
        let truth = Afar { how: PathTrace { samples: 64, ..few.how.clone() }, ..few }.trace(0.0, true);
        assert_eq!(samples(&cropped.out.without), samples(&full.out.without));
        assert_eq!(samples(&cropped.out.object), samples(&full.out.object));
        assert!(cropped.reported.is_some() && full.reported.is_none(), "{name}");
        let (mut left_out, mut worst) = (0, 0.0_f64);
        for tile in 0..64 {
            let pixels = (0..64).map(|i| (tile / 8 * 8 + i / 8) * 64 + tile % 8 * 8 + i % 8);
            let values = |found: &Traced| -> Vec<f64> {
                pixels.clone().flat_map(|i| found.ratio[3 * i..3 * i + 3].to_vec()).collect()
            };
            let (mine, theirs) = (values(&cropped), values(&full));
            if mine == theirs {
                continue;
            }
            assert!(mine.iter().all(|&s| s == 1.0), "{name}: all of a tile or nothing");
            left_out += 1;
            let truth = values(&truth);
            worst = worst.max((truth.iter().sum::<f64>() / truth.len() as f64 - 1.0).abs());
        }
        assert!(left_out > 8, "{name}: {left_out} tiles");
        assert!(worst > 0.0 && worst < limit, "{name}: {worst}");
        assert!(cropped.rays < full.rays, "{name}");
    }
}

#[test]
fn nothing_is_left_out_that_no_bound_is_known_of() {
    let lamp = Material { emissive: [0.01; 3], ..matte(0.5) };
    let mirror = Material { metallic: 1.0, roughness: 0.0, base_colour: [1.0; 4], ..matte(1.0) };
    let wall = box_mesh([-40.0, 12.0, 0.0], [40.0, 13.0, 30.0], false);
    let floor = || Afar::new(sunny(), matte(0.5));
    let near = Environment { origin: Some(DVec3::new(0.0, 0.0, 2.0)), ..sunny() };
    for (name, scene) in [
        ("it shines", Afar::new(sunny(), lamp)),
        ("it mirrors the sun", Afar::new(sunny(), mirror)),
        ("a wall throws light back", Afar { receiver: merge(plane(40.0), wall.clone()), ..floor() }),
        ("near light from a wall", {
            let receiver = merge(plane(40.0), wall.clone());
            Afar {
                receiver,
                env: near,
                how: PathTrace { surroundings: Surroundings::Projected, ..floor().how },
                ..floor()
            }
        }),
    ] {
        // A mirror that reflects the sun this far changes little.
        let found = scene.trace(if name.contains("mirrors") { 2e-4 } else { 0.004 }, true);
        assert_eq!(found.reported, None, "{name}");
        assert_eq!(found.ratio, scene.trace(0.0, true).ratio, "{name}");
    }
    // Surfaces that scattered rays do not hit reflect nothing.
    let how = PathTrace { surroundings: Surroundings::Open { bounces: false }, ..floor().how };
    let scene = Afar { receiver: merge(plane(40.0), wall), how, ..floor() };
    assert!(scene.trace(0.004, true).reported.is_some());
}

/// The change does not exceed the bound in synthetic scenes that are designed to make it large: mirrors, lenses,
/// brushed and coated objects, near and far, standing, hovering and below the floor, over floors and steps, under
/// skies of strong contrast.
#[test]
fn no_scene_changes_more_than_the_bound() {
    let mut left_out = 0;
    for scene in 0..48 {
        let mut drawn = 0;
        let mut random = || {
            drawn += 1;
            f64::from(unit(hash(scene, drawn)))
        };
        let contrast = 1.0 + 30.0 * random() * random();
        let texels = (0..16 * 8 * 3).map(|_| (1.0 + (contrast - 1.0) * random() * random()) as f32).collect();
        let image = Image::from_samples(16, 8, 3, texels);
        // If the receiver emits the light, objects also dim its points.
        let near = scene % 3 == 1;
        let origin = near.then(|| DVec3::new(4.0 * random() - 2.0, 3.0 * random(), 1.0 + random()));
        let env = Environment { image: image.into(), up: Up::PlusZ, origin };
        let base = [0.3 + 0.7 * random() as f32, 0.9, 1.0, 1.0];
        let material = match scene % 6 {
            0 => Material { base_colour: base, ..matte(1.0) },
            1 => Material { metallic: 1.0, roughness: 0.0, base_colour: [1.0; 4], ..matte(1.0) },
            2 => materials::clear(1.0, Some([0.0; 3]), 1.5),
            3 => {
                Material { metallic: 1.0, roughness: 0.3 * random() as f32, base_colour: base, ..matte(1.0) }
            }
            4 => Material { roughness: 0.1, ior: 1.5, base_colour: base, ..matte(1.0) },
            _ => materials::clear(0.9, None, 1.3),
        };
        let at = DVec3::new(4.0 * random() - 2.0, 6.0 * random() - 3.0, 2.5 * random() - 0.5);
        let object = ball((0.1 + 0.4 * random()) as f32, material, at);
        let step = [-6.0 + 3.0 * random() as f32, 2.0, 0.0];
        let receiver = match scene % 4 {
            3 => merge(plane(30.0), box_mesh(step, [step[0] + 2.0, 3.0, 0.3 * random() as f32], false)),
            _ => plane(30.0),
        };
        let block = if scene % 5 == 4 { Surroundings::TRANSPARENT } else { Surroundings::OPEN };
        let how = params(4, if near { Surroundings::Projected } else { block });
        let few = Afar { receiver, object, env, how };
        let limit = 0.01 + 0.09 * random();
        let (cropped, full) = (few.trace_in(limit, true, 24), few.trace_in(0.0, true, 24));
        let truth = Afar { how: PathTrace { samples: 32, ..few.how.clone() }, ..few }.trace_in(0.0, true, 24);
        let [mine, theirs] = [&cropped, &full].map(|found| samples(&found.out.with));
        let [without, with] = [&truth.out.without, &truth.out.with].map(|images| samples(images));
        for tile in 0..9 {
            let pixels = (0..64).map(|i| (tile / 3 * 8 + i / 8) * 24 + tile % 3 * 8 + i % 8);
            if pixels.clone().all(|i| mine[3 * i..3 * i + 3] == theirs[3 * i..3 * i + 3]) {
                continue;
            }
            left_out += 1;
            for c in 0..3 {
                let sum = |of: &[f32]| pixels.clone().map(|i| f64::from(of[3 * i + c])).sum::<f64>();
                let change = (sum(with) / sum(without) - 1.0).abs();
                assert!(change < limit, "scene {scene}, tile {tile}: {change} of {limit}");
            }
        }
    }
    assert!(left_out > 40, "{left_out} tiles");
}

/// An object far from all visible surfaces, to the side or overhead, causes no rays except the camera rays
/// that may see it.
#[test]
fn no_ray_asks_an_object_that_is_far_from_all() {
    for (at, env) in
        [([0.0, 300.0, 20.0], sunny()), ([0.0, 0.0, 3000.0], white()), ([2000.0, 0.0, 2000.0], white())]
    {
        let mut scene = Afar::new(env, matte(0.5));
        scene.object = ball(0.4, matte(0.6), DVec3::from(at));
        let (found, none) = (scene.trace(0.001, true), scene.trace(0.001, false));
        // One ray per pixel finds the front surface where the camera may see the object.
        assert!(found.rays <= none.rays + 64 * 64, "{at:?}");
        assert_eq!(samples(&found.out.with), samples(&found.out.without));
        assert!(found.reported.is_some());
    }
}

/// If the receiver emits the light, cropping avoids at least three quarters of the additional rays of the render
/// with the object when the object is high above rough ground or far to the side. For an object just above a flat
/// floor, distant tiles are cropped.
#[test]
fn near_light_is_not_asked_for_what_is_far() {
    let rough = || {
        let bump = |i: u32| 0.02 * unit(hash(i, 3));
        let side = 41_u32;
        let positions = (0..side * side).map(|i| {
            let [x, y] = [i % side, i / side].map(|k| k as f32 - 20.0);
            [x, y, bump(i)]
        });
        let cells = (0..side * (side - 1)).filter(|i| i % side + 1 < side);
        let triangles = cells.flat_map(|i| [[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]);
        Mesh { positions: positions.collect(), triangles: triangles.collect(), ..Mesh::default() }
    };
    let scene = |receiver: Mesh, at: DVec3| {
        let env = Environment { origin: Some(DVec3::new(0.0, 0.0, 2.0)), ..sunny() };
        let how = params(4, Surroundings::Projected);
        Afar { receiver, object: ball(0.4, matte(0.5), at), env, how }
    };
    for at in [DVec3::Z * 300.0, DVec3::new(900.0, 0.0, 10.0)] {
        let far = scene(rough(), at);
        let (cropped, full, without) =
            (far.trace(0.001, true), far.trace(0.0, true), far.trace(0.001, false));
        // No ray hits the object, so cropping must not change a bit.
        assert_eq!(samples(&cropped.out.with), samples(&full.out.with), "{at}");
        let [cropped, full] = [&cropped, &full].map(|found| found.rays - without.rays);
        assert!(4 * cropped < full, "{at}: {cropped} of {full} rays");
    }
    let floor = scene(plane(40.0), DVec3::new(0.0, 0.0, 0.4));
    let (cropped, full) = (floor.trace(0.002, true), floor.trace(0.0, true));
    assert!(cropped.reported.is_some() && cropped.rays < full.rays);
    // A black roof over almost black ground reflects nearly nothing, but hides a large part of the sky from
    // everything under it. This assertion fails if `near_bound` leaves out `hidden_light`.
    let mut dark = rough();
    dark.colours = vec![[0.01; 3]; dark.positions.len()];
    let mut roof =
        Afar { object: placed(&plane(25.0), matte(0.0), DVec3::Z * 80.0), ..scene(dark, DVec3::Z) };
    roof.env = Environment { origin: roof.env.origin, ..white() };
    let (width, height) = (roof.env.image.width, roof.env.image.height);
    for (x, y) in (height / 2..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        roof.env.image.pixel_mut(x, y).fill(1e-4);
    }
    assert_eq!(roof.trace(0.1, true).reported, None);
}
