//! Mattes of objects by `object-mattes`, compared with the colours of objects that emit one colour each, traced by
//! `path-trace`: the red of a pixel is then the coverage of the red object.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::sync::Arc;

use engine::{Context, Kind, OutputFile, Scene, Up};
use glam::{DMat4, DVec3};
use nodes::kinds::object_mattes::{self, ObjectMattes};
use nodes::kinds::path_trace::{self, PathTrace};
use nodes::kinds::write_exr::{self, WriteExr};
use scene::io::exr;
use scene::types::{
    AlphaMode, Camera, Data, Environment, Image, Images, Linear, Material, Mattes, Mesh, Object, Placed,
    Primitive, Rig,
};

const PIXELS: u32 = 40;
const NAMES: [&str; 3] = ["red ball", "green", "veil"];

fn context() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 3, exhaustive: false }, ".")
}

/// A square that faces the camera, with its centre at `at`, which emits `light` and has the given alpha.
fn square(side: f32, at: DVec3, light: [f32; 3], alpha: f32) -> Arc<Placed> {
    let corners = [[-side, 0.0, -side], [side, 0.0, -side], [side, 0.0, side], [-side, 0.0, side]];
    let primitive = Primitive {
        positions: corners.to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Primitive::default()
    };
    let material = Material {
        base_colour: [0.0, 0.0, 0.0, alpha],
        metallic: 0.0,
        roughness: 1.0,
        ior: 1.0,
        emissive: light,
        double_sided: true,
        alpha_mode: if alpha < 1.0 { AlphaMode::Blend } else { AlphaMode::Opaque },
        ..Material::default()
    };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    let turn = DMat4::from_rotation_y(0.3);
    Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::from_translation(at) * turn })
}

/// A red square, a green one partly behind it, and a blue one of alpha 0.5 in front of both.
fn objects() -> Vec<Arc<Placed>> {
    vec![
        square(0.4, DVec3::new(-0.2, 0.0, 0.6), [1.0, 0.0, 0.0], 1.0),
        square(0.5, DVec3::new(0.3, 0.5, 0.5), [0.0, 1.0, 0.0], 1.0),
        square(0.3, DVec3::new(0.1, -0.5, 0.5), [0.0, 0.0, 1.0], 0.5),
    ]
}

fn rig() -> Arc<Rig> {
    let eye = DVec3::new(0.0, -4.0, 0.5);
    let camera = Camera::centred("v", [PIXELS; 2], 80.0, [DVec3::X, -DVec3::Z, DVec3::Y], eye);
    Arc::new(Rig { cameras: vec![camera] })
}

/// A wall in front of the lower part of the objects.
fn wall() -> Arc<Mesh> {
    Arc::new(Mesh {
        positions: vec![[-9.0, -1.0, -9.0], [9.0, -1.0, -9.0], [9.0, -1.0, 0.33], [-9.0, -1.0, 0.33]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    })
}

fn traced(samples: u32) -> Arc<Images> {
    let params = PathTrace { samples, max_bounces: 0, ..PathTrace::default() };
    let env = Arc::new(Environment::constant(Up::PlusZ, [0.0; 3], 16));
    let inputs = path_trace::In { receiver: wall(), objects: objects(), rig: rig(), env, points: None };
    PathTrace::run(&params, inputs, &context()).unwrap().0.object
}

fn params(samples: u32) -> ObjectMattes {
    ObjectMattes { names: NAMES.map(str::to_owned).into(), samples, ..ObjectMattes::default() }
}

fn inputs(object: Arc<Images>) -> object_mattes::In {
    object_mattes::In { object, objects: objects(), rig: rig(), receiver: Some(wall()), front: None }
}

fn mattes(samples: u32, object: Arc<Images>) -> Arc<Mattes> {
    ObjectMattes::run(&params(samples), inputs(object), &context()).unwrap().0.mattes
}

/// Coverage of each of the three objects in a pixel.
fn coverages(mattes: &Mattes, pixel: usize) -> [f32; 3] {
    let mut all = [0.0; 3];
    mattes.views[0].pairs(pixel).for_each(|(index, coverage)| all[index as usize] = coverage);
    all
}

/// Compares with `path-trace` to rounding, in all pixels: edges, blending and the wall in front. This test fails if the
/// random number that chooses among blended surfaces is another one, or if the receiver hides nothing.
#[test]
fn coverages_are_those_of_the_traced_colours() {
    let object = traced(16);
    let mattes = mattes(16, object.clone());
    let (mut mixed, mut largest) = (0, 0.0_f32);
    for (at, pixel) in object.0[0].picture.samples().chunks_exact(4).enumerate() {
        let found = coverages(&mattes, at);
        mixed += usize::from(found.iter().filter(|coverage| **coverage > 0.0).count() > 1);
        let off = found.iter().zip(pixel).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        largest = largest.max(off).max((found.iter().sum::<f32>() - pixel[3]).abs());
    }
    assert!(mixed > 100, "{mixed}");
    assert!(largest <= 1e-6, "{largest}");
}

/// Coverages sum to alpha whatever its number of samples is. This test fails if they are not scaled to alpha.
#[test]
fn coverages_sum_to_alpha_of_other_samples() {
    let object = traced(5);
    for samples in [1, 64] {
        let mattes = mattes(samples, object.clone());
        for (at, pixel) in object.0[0].picture.samples().chunks_exact(4).enumerate() {
            let sum: f32 = coverages(&mattes, at).iter().sum();
            assert!((sum - pixel[3]).abs() <= 1e-6, "{samples}, {at}: {sum} and {}", pixel[3]);
        }
    }
}

/// This test fails if the front layer is left out.
#[test]
fn splats_in_front_hide_objects() {
    let object = traced(4);
    let front = Image::<Linear>::from_samples(
        PIXELS as usize,
        PIXELS as usize,
        4,
        [0.1, 0.1, 0.1, 0.25].repeat((PIXELS * PIXELS) as usize),
    );
    let free = mattes(4, object.clone());
    let inputs = object_mattes::In { front: Some(Arc::new(Images::single("v", front))), ..inputs(object) };
    let hidden = ObjectMattes::run(&params(4), inputs, &context()).unwrap().0.mattes;
    for pixel in 0..(PIXELS * PIXELS) as usize {
        let [free, hidden] = [&free, &hidden].map(|mattes| coverages(mattes, pixel));
        free.iter().zip(hidden).for_each(|(free, hidden)| assert!((free * 0.75 - hidden).abs() < 1e-6));
    }
}

/// This test fails if a layer is written as 16-bit floats, or if attributes are in the order of a hash.
#[test]
fn a_file_is_the_same_for_any_number_of_threads() {
    let file = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let object = traced(8);
            let mattes = mattes(8, object.clone());
            let p = WriteExr {
                path: OutputFile("a.exr".into()),
                names: Vec::new(),
                half: true,
                encoding: write_exr::WrittenEncoding::Linear,
                recipe: false,
            };
            let inputs = write_exr::In {
                image: Some(object),
                layers: Vec::new(),
                rig: None,
                plate: None,
                stored: None,
                mattes: vec![mattes.clone()],
            };
            (WriteExr::run(&p, inputs, &context()).unwrap().0.files.0[0].bytes.clone(), mattes)
        })
    };
    let (bytes, mattes) = file(1);
    for _ in 0..3 {
        assert!(file(3).0 == bytes);
    }
    let planes = exr::read("a.exr", &bytes).unwrap();
    for expected in exr::cryptomatte::channels(&mattes, &mattes.views[0]) {
        assert_eq!(planes.find(&expected.name), Some(expected.samples.as_slice()), "{}", expected.name);
    }
    let manifest = exr::cryptomatte::attributes(&mattes).remove(3).1;
    assert!(bytes.windows(manifest.len()).any(|window| window == manifest.as_bytes()));
}

/// Errors name the input that is wrong.
#[test]
fn wrong_inputs_are_named() {
    let object = traced(1);
    let wrong = |inputs: object_mattes::In, p: &ObjectMattes| {
        ObjectMattes::run(p, inputs, &context()).err().unwrap().to_string()
    };
    let small = Images::single("v", Image::<Linear>::new(2, 2, 4));
    let opaque = Images::single("v", Image::<Data>::new(PIXELS as usize, PIXELS as usize, 3));
    let p = params(1);
    assert_eq!(wrong(inputs(Arc::new(small)), &p), "`v` of `object` is 2x2 pixels, but its camera has 40x40");
    assert_eq!(wrong(inputs(Arc::new(opaque)), &p), "`object` has no alpha channel (channels: 3)");
    let two = ObjectMattes { names: vec!["a".to_owned()], ..p };
    assert_eq!(wrong(inputs(object), &two), "`names` must list one name per object (names: 1, objects: 3)");
}
