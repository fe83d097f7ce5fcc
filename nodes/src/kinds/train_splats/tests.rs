//! Trainings on the demo scene.

use std::sync::LazyLock;

use super::*;
use crate::kinds::demo_scene::{self, DemoScene};
use render::splat::render;
use scene::math::color::srgb_from_linear;
use scene::types::Cell;
use testing::context;

/// The first photographs of the demo scene, of 96x64 pixels.
fn photographs(count: usize) -> Arc<Photos> {
    static ALL: LazyLock<Photos> = LazyLock::new(|| all_photographs(14));
    let all = &*ALL;
    Arc::new(Photos { photos: all.photos[..count].to_vec(), points: all.points.clone() })
}

fn all_photographs(count: u32) -> Photos {
    let params = DemoScene {
        splats: 8000,
        width_px: 96,
        height_px: 64,
        truth_width_px: 16,
        capture: count,
        capture_width_px: 96,
        ..DemoScene::default()
    };
    let out = DemoScene::run(&params, demo_scene::In {}, &context()).expect("runs").0;
    let photo = |camera: &Camera| {
        let rendered = render(&out.splats, camera, None, &Settings::default(), &context()).expect("renders");
        let code = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let pixels = rendered.rgba.as_chunks::<4>().0.iter();
        Photo {
            camera: camera.clone(),
            pixels: pixels.map(|[r, g, b, _]| [code(*r), code(*g), code(*b), 255]).collect(),
        }
    };
    let points = out.proxy.positions.iter().zip(&out.proxy.colours).step_by(5);
    let points = points
        .map(|(position, rgb)| scene::types::Point { position: *position, rgb: rgb.map(srgb_from_linear) });
    Photos { photos: out.capture.cameras.iter().map(photo).collect(), points: points.collect() }
}

fn held_out(report: &Report) -> f64 {
    let table = report.tables.iter().find(|table| table.name == "held-out").expect("is there");
    let Some(Cell::Number(psnr)) = table.rows.last().map(|row| row[1].clone()) else {
        panic!("no mean: {table:?}");
    };
    psnr
}

fn run(p: &TrainSplats, photos: &Arc<Photos>) -> Result<(Out, Notes), NodeError> {
    TrainSplats::run(p, In { photos: photos.clone(), splats: None }, &context())
}

/// Training on twelve photographs, with two held out, 1,000 splats and 200 iterations reaches a held-out PSNR that
/// is not reached without the gradients of the centres or of the colours. The PSNR before training is far lower. A
/// second training run that starts from the result continues to improve it.
#[test]
fn a_short_training_finds_the_demo_scene() {
    let photos = photographs(14);
    let p = TrainSplats {
        iterations: 200,
        max_splats: 1000,
        start_splats: 1000,
        sh_degree: 1,
        sh_every: 100,
        ..TrainSplats::default()
    };
    let (out, notes) = run(&p, &photos).expect("trains");
    assert!(!notes.iter().any(|note| note.id == "random-start"));
    let trained = held_out(&out.report);
    let start = held_out(&run(&TrainSplats { iterations: 1, ..p }, &photos).expect("trains").0.report);
    assert!(trained > 17.0 && trained > start + 3.0, "{start} {trained}");
    assert!(out.splats.len() > 500 && out.splats.len() <= 1000);
    let inputs = In { photos, splats: Some(out.splats) };
    let more = TrainSplats::run(&p, inputs, &context()).expect("trains").0;
    assert!(held_out(&more.report) > trained - 0.2);
}

#[test]
fn unusable_photographs_are_refused() {
    let photos = photographs(6);
    let p = TrainSplats { iterations: 2, ..TrainSplats::default() };
    let few = Arc::new(Photos { photos: photos.photos[..2].to_vec(), points: Vec::new() });
    let error = run(&p, &few).err().expect("is refused");
    assert!(error.to_string().contains("at least 2 photographs"), "{error}");
    let mut still = Photos::clone(&photos);
    for photo in &mut still.photos {
        photo.camera.world_from_camera = photos.photos[0].camera.world_from_camera;
    }
    let error = run(&p, &Arc::new(still)).err().expect("is refused");
    assert!(error.to_string().contains("same position"), "{error}");
    // Photographs of another place, far away from the start.
    let far = Splats {
        means: vec![[1e5; 3]; 4],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
        scales: vec![[0.1; 3]; 4],
        opacities: vec![0.001; 4],
        sh: vec![[0.0; 3]; 4],
        ..Splats::empty()
    };
    let inputs = In { photos, splats: Some(Arc::new(far)) };
    let (_, notes) = TrainSplats::run(&p, inputs, &context()).expect("trains");
    assert!(notes.iter().any(|note| note.id == "no-splats"));
}

/// Ranges of a short training are ranges of a longer one.
#[test]
fn longer_trainings_continue_shorter_ones() {
    assert_eq!(ends(1), [1]);
    assert_eq!(ends(1000), [1000]);
    assert_eq!(ends(7000), [1000, 2000, 3000, 5000, 7000]);
    assert_eq!(ends(15_000), [1000, 2000, 3000, 5000, 7000, 10_000, 15_000]);
    assert_eq!(ends(45_000)[6..], [15_000, 20_000, 30_000, 40_000, 45_000]);
}

/// A cancelled training stops within an iteration.
#[test]
fn training_stops_when_it_is_cancelled() {
    let photos = photographs(4);
    let cx = context().stopping_at(0.003);
    let p = TrainSplats { iterations: 1000, test_every: 0, start_splats: 500, ..TrainSplats::default() };
    let result = TrainSplats::run(&p, In { photos, splats: None }, &cx);
    assert!(result.err().expect("stops").is_cancelled());
}
