//! Motion blur: moments of a shutter, traced by `path-trace` and averaged by `average-images`.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::sync::Arc;

use engine::{Context, Kind, Scene, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::average_images::{self, AverageImages};
use nodes::kinds::path_trace::{self, PathTrace};
use nodes::kinds::shadow_ratio::{self, ShadowRatio};
use scene::types::{Camera, Environment, Images, Material, Mesh, Object, Placed, Primitive, Rig};

const PIXELS: u32 = 32;
/// Number of pixels per unit in the plane of the object.
const SCALE: f64 = 8.0;

fn context() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 3, exhaustive: false }, ".")
}

/// A horizontal square of 1 unit at the height 0.5, with its centre at `x`, which emits `emissive`.
fn square(x: f64, emissive: f32) -> Arc<Placed> {
    let primitive = Primitive {
        positions: [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[x, y]| [x, y, 0.0]).into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Primitive::default()
    };
    let material = Material {
        base_colour: [0.0, 0.0, 0.0, 1.0],
        metallic: 0.0,
        roughness: 1.0,
        ior: 1.0,
        emissive: [emissive; 3],
        double_sided: true,
        ..Material::default()
    };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    let world_from_object = DMat4::from_translation(DVec3::new(x, 0.0, 0.5));
    Arc::new(Placed { object: Arc::new(object), world_from_object })
}

/// A camera far above that looks straight down.
fn rig() -> Arc<Rig> {
    let up = 2000.0;
    let camera = Camera::centred(
        "v",
        [PIXELS; 2],
        SCALE * up,
        [DVec3::X, -DVec3::Y, -DVec3::Z],
        DVec3::Z * (up + 0.5),
    );
    Arc::new(Rig { cameras: vec![camera] })
}

fn floor() -> Arc<Mesh> {
    Arc::new(Mesh {
        positions: vec![[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    })
}

/// The render without objects, the one with them, and the object at `x`. `lights` are the radiances of the sky and of the
/// object.
fn traced(x: f64, samples: u32, skip_samples: u32, lights: [f32; 2]) -> [Arc<Images>; 3] {
    let params =
        PathTrace { samples, skip_samples, contact_metres: Some(0.0), crop: 0.0, ..PathTrace::default() };
    let env = Arc::new(Environment::constant(Up::PlusZ, [lights[0]; 3], 16));
    let inputs = path_trace::In {
        receiver: floor(),
        objects: vec![square(x, lights[1])],
        rig: rig(),
        env,
        points: None,
    };
    let out = PathTrace::run(&params, inputs, &context()).unwrap().0;
    [out.without, out.with, out.object]
}

fn average(images: Vec<Arc<Images>>) -> Arc<Images> {
    let params = AverageImages { how: average_images::Combination::Mean };
    AverageImages::run(&params, average_images::In { images }, &context()).unwrap().0.image
}

/// The averages of `moments` renders with `samples` samples each while the square moves from -0.75 to 0.75.
fn moved(moments: u32, samples: u32, lights: [f32; 2]) -> [Arc<Images>; 3] {
    let at = |moment| -0.75 + 1.5 * (f64::from(moment) + 0.5) / f64::from(moments);
    let each: Vec<_> =
        (0..moments).map(|moment| traced(at(moment), samples, moment * samples, lights)).collect();
    [0, 1, 2].map(|output| average(each.iter().map(|images| images[output].clone()).collect()))
}

fn pixels(images: &Images, channels: usize) -> Vec<&[f32]> {
    images.0[0].picture.samples().chunks_exact(channels).collect()
}

/// Without movement, the average of the moments is the render with all samples, in object and receiver to rounding. This test fails if moments take the same
/// samples, or if the first chunk is not moved.
#[test]
fn moments_of_a_still_object_are_one_render() {
    let whole = traced(0.1, 64, 0, [0.7, 2.0]);
    // The chunks of a render begin at 0, 4, 16 and 64.
    let parts: Vec<_> =
        [(16, 0), (16, 16), (16, 32), (16, 48)].map(|(n, skip)| traced(0.1, n, skip, [0.7, 2.0])).into();
    // The change of the receiver is sampled by tile and chunk, so it has other random numbers.
    for (output, channels, most) in [(0, 3, 2e-6), (1, 3, 0.01), (2, 4, 2e-6)] {
        let mean = average(parts.iter().map(|images| images[output].clone()).collect());
        let pairs =
            pixels(&mean, channels).concat().into_iter().zip(pixels(&whole[output], channels).concat());
        let off = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < most, "output {output}: {off}");
    }
    assert_ne!(parts[0][1], parts[1][1]);
}

/// Alpha and light of a moving square are the share of the time in which it covers a pixel. This test fails if alpha is
/// averaged with other weights than colours.
#[test]
fn a_moving_square_covers_pixels_for_a_share_of_the_time() {
    let [_, _, object] = moved(48, 4, [0.0, 1.0]);
    let middle = (PIXELS / 2) as usize;
    let row = &pixels(&object, 4)[middle * PIXELS as usize..][..PIXELS as usize];
    let mut largest = 0.0_f64;
    for (x, pixel) in row.iter().enumerate() {
        // The square covers x while its centre is within half a unit of it.
        let at = |edge: f64| (x as f64 + edge - f64::from(PIXELS) / 2.0) / SCALE;
        let steps = 64;
        let share = (0..steps).map(|step| {
            let x = at((f64::from(step) + 0.5) / f64::from(steps));
            ((x + 0.5).min(0.75) - (x - 0.5).max(-0.75)).max(0.0) / 1.5
        });
        let expected = share.sum::<f64>() / f64::from(steps);
        largest = largest.max((f64::from(pixel[3]) - expected).abs());
        assert!((pixel[0] - pixel[3]).abs() < 1e-6, "the square emits 1: {pixel:?}");
    }
    // One moment of 48, and the noise of 4 samples.
    assert!(largest < 0.03, "{largest}");
}

/// The shadow of the average is that of the average light, not the average of shadows, and is blurred along the movement.
/// This test fails if the ratio is taken before the average.
#[test]
fn the_shadow_of_a_moving_object_is_the_ratio_of_averages() {
    let [without, with, _] = moved(8, 8, [1.0, 0.0]);
    let inputs = shadow_ratio::In { without, with };
    let shadow = ShadowRatio::run(&ShadowRatio::default(), inputs, &context()).unwrap().0.shadow;
    let still = traced(0.0, 64, 0, [1.0, 0.0]);
    let inputs = shadow_ratio::In { without: still[0].clone(), with: still[1].clone() };
    let sharp = ShadowRatio::run(&ShadowRatio::default(), inputs, &context()).unwrap().0.shadow;
    let at = |images: &Images, x: usize, y: usize| pixels(images, 3)[y * PIXELS as usize + x][0];
    // Beyond the ends of the still shadow along x, the moving one is darker; in its middle it is lighter.
    assert!(at(&shadow, 8, 16) < at(&sharp, 8, 16) - 0.02, "{} {}", at(&shadow, 8, 16), at(&sharp, 8, 16));
    assert!(
        at(&shadow, 16, 16) > at(&sharp, 16, 16) + 0.05,
        "{} {}",
        at(&shadow, 16, 16),
        at(&sharp, 16, 16)
    );
}
