//! Photographs from folders and from the graph.

use glam::DVec3;

use super::*;
use scene::io::png::{Raster, write};
use scene::types::{Image, NamedImage, Srgb};
use testing::context;

fn camera(name: &str, size: [u32; 2]) -> Camera {
    Camera::centred(name, size, 4.0, [DVec3::X, DVec3::Y, DVec3::Z], DVec3::ZERO)
}

fn inputs(cameras: Vec<Camera>, image: Option<Images>) -> In {
    In { rig: Arc::new(Rig { cameras }), image: image.map(Arc::new) }
}

fn of_graph(size: (usize, usize), samples: Vec<f32>) -> Images {
    Images(vec![NamedImage {
        name: "a".to_owned(),
        picture: Image::<Srgb>::from_samples(size.0, size.1, samples.len() / size.0 / size.1, samples).into(),
    }])
}

#[test]
fn pictures_of_the_graph_become_photographs() {
    let image = of_graph((2, 1), vec![0.0, 0.5, 1.0, 0.2, 0.2, 0.2]);
    let (out, _) =
        LoadPhotos::run(&LoadPhotos::default(), inputs(vec![camera("a", [2, 1])], Some(image)), &context())
            .expect("loads");
    assert_eq!(out.photos.photos[0].pixels, [[0, 128, 255, 255], [51, 51, 51, 255]]);
    assert!(out.photos.points.is_empty());
    let clear = of_graph((2, 1), vec![0.0; 8]);
    let result =
        LoadPhotos::run(&LoadPhotos::default(), inputs(vec![camera("a", [2, 1])], Some(clear)), &context());
    assert!(result.err().expect("is refused").to_string().contains("no pixel"));
}

/// Photographs in a folder are scaled to the size of their cameras and masked. Photographs that are missing, that
/// are too small or that have another aspect ratio are refused.
#[test]
fn folders_are_read_by_name() {
    let folder = tempfile::tempdir().expect("is made");
    std::fs::create_dir_all(folder.path().join("photos")).expect("is made");
    std::fs::create_dir_all(folder.path().join("masks")).expect("is made");
    let write = |name: &str, codes: Vec<u16>| {
        let channels = codes.len() / 32;
        let raster =
            Raster { width: 8, height: 4, channels, largest: 255, codes, colour: None, ignored: Vec::new() };
        let bytes = write(&raster, channels == 3, &[]).expect("encodes");
        std::fs::write(folder.path().join(name), bytes).expect("is written");
    };
    write("photos/a.png", vec![102; 8 * 4 * 3]);
    write("photos/b.png", vec![204; 8 * 4 * 3]);
    write("masks/a.png", (0..8 * 4).map(|i| if i % 8 < 4 { 255 } else { 0 }).collect());
    let scene = engine::Scene { up: engine::Up::PlusZ, metres_per_unit: 1.0, seed: 1, exhaustive: false };
    let p = LoadPhotos {
        path: Some(InputFile("photos".to_owned())),
        masks: Some(InputFile("masks".to_owned())),
        points: None,
    };
    let run = |cameras: Vec<Camera>| {
        let files = LoadPhotos::sources(&p, &SourceRoot::new(folder.path()))?;
        let cx = Context::detached(scene, folder.path()).having_listed(&files);
        LoadPhotos::run(&p, inputs(cameras, None), &cx)
    };
    let (out, notes) = run(vec![camera("a", [4, 2])]).expect("loads");
    assert_eq!(
        out.photos.photos[0].pixels,
        [[102, 102, 102, 255], [102, 102, 102, 255], [102, 102, 102, 0], [102, 102, 102, 0]].repeat(2)
    );
    assert!(notes.iter().any(|note| note.id == "photos-unused"));
    for (cameras, text) in [
        (vec![camera("c", [4, 2])], "no picture of the camera `c`"),
        (vec![camera("a", [16, 8])], "has 8x4 pixels"),
        (vec![camera("a", [4, 4])], "has 8x4 pixels"),
    ] {
        let error = run(cameras).err().expect("is refused");
        assert!(error.to_string().contains(text), "{error}");
    }
}
