//! Tests of layers for a compositing program.

use scene::io::exr::{self, Planes};

use crate::Place;
use crate::nuke::Script;

fn read(bytes: &[u8]) -> Planes {
    exr::read("file", bytes).unwrap_or_else(|e| panic!("{e}"))
}

/// The text of `graphs/files.ron`, changed to use a small generated place instead of files and to write the picture
/// in linear light as an additional output. The blur is given, since a picture of this size has too few edges to
/// measure it.
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
        ("samples: 64", "samples: 16"),
        ("method: Learned", "method: Region"),
        ("sharpness: Match", "sharpness: Blur, blur_px: 0.5"),
    ];
    loaders.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "graphs/files.ron has no {from}");
        text.replace(from, to)
    })
}

/// The formula of the graph and the template for Nuke rebuild the picture from the layers, although the object and its
/// shadow are blurred. This test fails if `encoding: Linear` or `shadow: "shadow"` is removed from the graph, if alpha is
/// decoded like colour, if the layers are `clean.object` and `shadow` in place of `final.object` and `final.shadow`, or if
/// a sign in the template is changed.
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
    let alpha = of("object.A");
    assert!(alpha.iter().any(|a| *a > 0.99) && alpha.contains(&0.0));
    let script = Script::new(include_str!("../../graphs/composite.nk"));
    let mut darkened = 0;
    let front_alpha = of("front.A");
    for (index, c) in ["R", "G", "B"].into_iter().enumerate() {
        let [background, shadow, object, front] =
            ["background", "shadow", "object", "front"].map(|layer| of(&format!("{layer}.{c}")));
        let by_nuke = script.channel(index, &layers);
        // The default layer is the picture.
        assert_eq!(layers.find(c), picture.find(c));
        for (i, found) in picture.find(c).unwrap().iter().enumerate() {
            let kept = front[i].min(background[i]);
            let under = (background[i] - kept) * shadow[i] + kept;
            let over = front[i] * alpha[i] + object[i] * (1.0 - front_alpha[i]);
            let wanted = under * (1.0 - alpha[i]) + over;
            let near = |wanted: f32| (found - wanted).abs() <= 1e-5 * wanted.abs().max(1.0);
            assert!(near(wanted), "{c} of {i}: {found}, {wanted}");
            assert!(near(by_nuke[i] as f32), "{c} of {i}: {found}, {} in Nuke", by_nuke[i]);
            darkened += usize::from(shadow[i] < 0.9);
        }
    }
    assert!(darkened > 100 && of("in_shadow").contains(&1.0) && of("in_object").contains(&1.0));
    // The edge of the object is soft.
    assert!(alpha.iter().filter(|a| (0.01..0.99).contains(*a)).count() > 30);
    for name in ["depth.Z", "normal.X", "normal.Y", "normal.Z"] {
        of(name);
    }
    for name in [&b"worldToCamera\0m44f"[..], b"worldToNDC\0m44f"] {
        assert!(outputs["layers.exr"].windows(name.len()).any(|window| window == name));
    }
}
