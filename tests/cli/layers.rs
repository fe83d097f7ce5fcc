//! Tests of layers for a compositing program.

use scene::io::exr::{self, Planes};

use crate::Place;

fn read(bytes: &[u8]) -> Planes {
    exr::read("file", bytes).unwrap_or_else(|e| panic!("{e}"))
}

/// The text of `graphs/files.ron`, changed to use a small generated place instead of files and to write the picture
/// in linear light as an additional output.
fn files() -> String {
    let text = include_str!("../../graphs/files.ron");
    let loaders = [
        ("scene:  LoadSplats(path: \"garden.ply\"),", "demo: DemoScene(place: Courtyard, splats: 4000),"),
        ("proxy:  LoadMesh(path: \"garden_mesh.ply\"),", ""),
        (
            "chair:  LoadObject(path: \"chair.glb\"),",
            "exact: WriteExr(image: \"final\", path: \"final.exr\"),",
        ),
        ("\"scene\"", "\"demo.splats\""),
        ("\"proxy\"", "\"demo.proxy\""),
        ("\"chair\"", "\"demo.object\""),
        ("width_px: 1280, height_px: 720", "width_px: 96, height_px: 54"),
        ("size_px: 512", "size_px: 32"),
        ("width_px: 2048", "width_px: 64"),
        ("samples: 64", "samples: 4"),
        ("method: Learned", "method: Region"),
    ];
    loaders.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "graphs/files.ron has no {from}");
        text.replace(from, to)
    })
}

// This test fails if `encoding: Linear` or `shadow: "shadow"` is removed from the graph, if alpha is decoded like
// colour, or if the formula takes its matte from `in_object`.
#[test]
fn layers_of_the_own_capture_compose_to_its_picture() {
    let place = Place::new(&files());
    let reported = place.run(&["--only", "layers,exact"]).good();
    for (node, id, text) in reported.notes() {
        assert!(!["no-shadow-known", "mixed-encodings"].contains(&&*id), "{node}: {text}");
    }
    let outputs = place.outputs();
    let (layers, picture) = (read(&outputs["layers.exr"]), read(&outputs["final.exr"]));
    let of = |name: &str| layers.find(name).unwrap_or_else(|| panic!("no {name}"));
    let alpha = of("O.A");
    assert!(alpha.iter().any(|a| *a > 0.99) && alpha.contains(&0.0));
    let mut darkened = 0;
    let front_alpha = of("F.A");
    for c in ["R", "G", "B"] {
        let [background, shadow, object, front] =
            ["B", "S", "O", "F"].map(|layer| of(&format!("{layer}.{c}")));
        for (i, found) in picture.find(c).unwrap().iter().enumerate() {
            let kept = front[i].min(background[i]);
            let under = (background[i] - kept) * shadow[i] + kept;
            let over = front[i] * alpha[i] + object[i] * (1.0 - front_alpha[i]);
            let wanted = under * (1.0 - alpha[i]) + over;
            assert!((found - wanted).abs() <= 1e-5 * wanted.abs().max(1.0), "{c} of {i}: {found}, {wanted}");
            darkened += usize::from(shadow[i] < 0.9);
        }
    }
    assert!(darkened > 100 && of("in_shadow").contains(&1.0) && of("in_object").contains(&1.0));
}
