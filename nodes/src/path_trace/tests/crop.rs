//! What is left out where the objects are too far to matter.

use super::*;

/// A place seen from afar.
struct Afar {
    receiver: Mesh,
    object: Arc<Placed>,
    env: Environment,
    how: PathTrace,
}

/// What a trace gave: S by pixels and channels, rays, and the note.
struct Traced {
    ratio: Vec<f64>,
    rays: u64,
    told: Option<String>,
    out: Out,
}

impl Afar {
    fn new(env: Environment, material: Material) -> Self {
        let object = ball(0.4, material, DVec3::new(0.0, 0.0, 0.5));
        Self { receiver: plane(40.0), object, env, how: params(16, EnvBlock::Solid) }
    }

    fn trace(&self, crop: f64, with: bool) -> Traced {
        let camera = rig(DVec3::new(0.0, -10.0, 8.0), DVec3::ZERO, 64, 0.9);
        let (cx, how) = (context(), PathTrace { crop, ..self.how.clone() });
        let objects = [self.object.clone()];
        let objects = if with { &objects[..] } else { &[] };
        let (out, notes) = render_in(&cx, &how, &self.receiver, objects, &camera, &self.env);
        let told = notes.iter().find(|note| note.id == "cropped").map(|note| note.text.clone());
        let pairs = samples(&out.without).iter().zip(samples(&out.with));
        let ratio = pairs.map(|(a, b)| if *a > 0.0 { f64::from(b / a) } else { 1.0 }).collect();
        Traced { ratio, rays: cx.counts()["rays"], told, out }
    }
}

/// Where nothing is asked, and only there, S is 1 bit for bit, and what was left out is within the bound: the mean of what
/// more samples find there, over tiles, for their noise.
#[test]
fn what_is_left_out_is_within_the_bound() {
    let dark = Mesh { colours: vec![[0.02, 0.05, 0.4]; 4], ..plane(40.0) };
    let mirror = Material { metallic: 1.0, roughness: 0.0, base_colour: [1.0; 4], ..matte(1.0) };
    let scenes = [
        ("floor", Afar::new(white(), matte(0.5)), 0.002),
        ("floor in the sun", Afar::new(sunny(), matte(0.5)), 0.002),
        ("dark ground", Afar { receiver: dark, ..Afar::new(sunny(), matte(0.9)) }, 0.01),
        ("mirror under a sky", Afar::new(white(), mirror), 0.004),
        (
            "overhead",
            Afar {
                object: ball(2.0, matte(0.5), DVec3::new(0.0, 0.0, 30.0)),
                ..Afar::new(white(), matte(0.5))
            },
            0.03,
        ),
    ];
    for (name, scene, limit) in scenes {
        // Samples of one chunk, which decides for itself, and more of them for the truth.
        let few = Afar { how: PathTrace { samples: 4, ..scene.how.clone() }, ..scene };
        let (cropped, full) = (few.trace(limit, true), few.trace(0.0, true));
        let truth = Afar { how: PathTrace { samples: 64, ..few.how.clone() }, ..few }.trace(0.0, true);
        assert_eq!(samples(&cropped.out.without), samples(&full.out.without));
        assert_eq!(samples(&cropped.out.object), samples(&full.out.object));
        assert!(cropped.told.is_some() && full.told.is_none(), "{name}");
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
        ("the receiver is the light", {
            Afar { env: near, how: PathTrace { near_field: NearField::On, ..floor().how }, ..floor() }
        }),
    ] {
        // Where a mirror throws the sun as far as this, it changes little.
        let found = scene.trace(if name.contains("mirrors") { 2e-4 } else { 0.004 }, true);
        assert_eq!(found.told, None, "{name}");
        assert_eq!(found.ratio, scene.trace(0.0, true).ratio, "{name}");
    }
    // What scattered rays do not meet throws nothing back.
    let how = PathTrace { bounce: Bounce::Env, ..floor().how };
    let scene = Afar { receiver: merge(plane(40.0), wall), how, ..floor() };
    assert!(scene.trace(0.004, true).told.is_some());
}

/// An object far from all that the camera sees costs no ray beside those that may see it.
#[test]
fn no_ray_asks_an_object_that_is_far_from_all() {
    let mut scene = Afar::new(sunny(), matte(0.5));
    scene.object = ball(0.4, matte(0.6), DVec3::new(0.0, 300.0, 20.0));
    let (found, none) = (scene.trace(0.001, true), scene.trace(0.001, false));
    // One a pixel looks for what is in front.
    assert_eq!(found.rays, none.rays + 64 * 64);
    assert_eq!(samples(&found.out.with), samples(&found.out.without));
    assert!(found.told.is_some());
}
