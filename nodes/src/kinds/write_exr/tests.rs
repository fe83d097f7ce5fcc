//! Tests of layers, encodings, cameras and plates in files.

use super::*;
use engine::{Scene, Up};
use scene::math::color::linear_from_srgb;
use scene::types::{Camera, Data, Image, NamedImage, Srgb};

fn run(p: &WriteExr, inputs: In) -> Result<(Vec<FileBytes>, Notes), NodeError> {
    WriteExr::check(p)?;
    let cx =
        Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
    WriteExr::run(p, inputs, &cx).map(|(out, notes)| (out.files.0.clone(), notes))
}
fn node(names: &[&str]) -> WriteExr {
    let names = names.iter().map(|n| (*n).to_owned()).collect();
    let encoding = WrittenEncoding::Keep;
    WriteExr { path: OutputFile("a.exr".into()), names, half: false, encoding, recipe: true }
}
fn of_layers(layers: Vec<Arc<Images>>) -> In {
    In { image: None, layers, rig: None, plate: None, stored: None, mattes: Vec::new() }
}
fn colour() -> Arc<Images> {
    let samples = (0..24).map(|i| i as f32 * 10_000.0).collect();
    Arc::new(Images::single("v", Image::<Linear>::from_samples(3, 2, 4, samples)))
}
fn depth() -> Arc<Images> {
    Arc::new(Images::single("v", Image::<Data>::from_samples(3, 2, 1, vec![f32::INFINITY; 6])))
}

#[test]
fn layers_are_named_and_exact() {
    let layers = vec![colour(), depth(), Arc::new(Images::single("v", Image::<Srgb>::new(3, 2, 3)))];
    let (files, notes) = run(&node(&["O", "Z", "B"]), of_layers(layers)).unwrap_or_else(|e| panic!("{e}"));
    let reported: Vec<&str> = notes.iter().map(|note| &*note.id).collect();
    assert_eq!(reported, ["mixed-encodings"]);
    let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
    let names: Vec<&str> = back.channels.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["B.B", "B.G", "B.R", "O.A", "O.B", "O.G", "O.R", "Z"]);
    assert_eq!(back.find("O.G").map(|c| c[5]), Some(210_000.0));
    assert_eq!(back.find("Z"), Some(&[f32::INFINITY; 6][..]));
    let text = b"O=linear Z=data B=srgb";
    assert!(files[0].bytes.windows(text.len()).any(|w| w == text));
}

// This test fails if alpha is decoded too, if premultiplied colours are decoded directly, if linear light is
// decoded again, or if the attribute is not changed.
#[test]
fn linear_decodes_what_is_display_encoded_and_nothing_else() {
    let of = |channels, samples: &[f32]| {
        Arc::new(Images::single("v", Image::<Srgb>::from_samples(1, 2, channels, samples.to_vec())))
    };
    let layers = vec![
        of(4, &[0.2, 0.1, -0.05, 0.5, 0.3, 0.3, 0.3, 0.0]),
        of(3, &[0.5, 1.5, 0.0, 1.0, 0.25, 0.75]),
        of(2, &[0.1, 0.5, 1.0, 1.0]),
        Arc::new(Images::single("v", Image::<Linear>::from_samples(1, 2, 1, vec![0.5, 7.0]))),
        Arc::new(Images::single("v", Image::<Data>::from_samples(1, 2, 3, vec![0.25; 6]))),
    ];
    for half in [false, true] {
        let encoding = WrittenEncoding::Linear;
        let p = WriteExr { half, encoding, ..node(&["B", "C", "G", "R0", "S"]) };
        let (files, notes) = run(&p, of_layers(layers.clone())).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(notes, Notes::none());
        let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
        let lin = linear_from_srgb;
        for (name, wanted) in [
            ("B.R", [lin(0.4) * 0.5, 0.0]),
            ("B.G", [lin(0.2) * 0.5, 0.0]),
            ("B.B", [lin(-0.1) * 0.5, 0.0]),
            ("B.A", [0.5, 0.0]),
            ("C.G", [lin(1.5), lin(0.25)]),
            ("G.Y", [lin(0.2) * 0.5, 1.0]),
            ("G.A", [0.5, 1.0]),
            ("R0", [0.5, 7.0]),
            ("S.B", [0.25; 2]),
        ] {
            let found = back.find(name).unwrap_or_else(|| panic!("{name}"));
            for (found, wanted) in found.iter().zip(wanted) {
                let off = (found - wanted).abs();
                assert!(off <= if half { 1e-3 * wanted.abs() } else { 1e-7 }, "{name}: {found}, {wanted}");
            }
        }
        let text = b"B=linear C=linear G=linear R0=linear S=data";
        assert!(files[0].bytes.windows(text.len()).any(|w| w == text));
    }
}

// This test fails if data is treated as linear light, if layers are listed that are not display-encoded, or if
// `Linear` causes a warning too.
#[test]
fn unlike_encodings_are_reported_by_layer_and_like_ones_are_not() {
    let encoded = || Arc::new(Images::single("v", Image::<Srgb>::new(3, 2, 3)));
    let reported = |encoding, names: &[&str], layers| {
        let p = WriteExr { encoding, ..node(names) };
        let (_, notes) = run(&p, of_layers(layers)).unwrap_or_else(|e| panic!("{e}"));
        notes.iter().map(|note| note.text.clone()).collect::<Vec<_>>()
    };
    let all = ["B", "R0", "R1", "Z"];
    let layers = || vec![encoded(), colour(), colour(), depth()];
    assert_eq!(
        reported(WrittenEncoding::Keep, &all, layers()),
        [
            "display-encoded layers (`B`) are mixed with linear layers (`R0`, `R1`), and other programs treat all \
          layers as linear; `encoding: Linear` decodes them"
        ]
    );
    assert!(reported(WrittenEncoding::Linear, &all, layers()).is_empty());
    assert!(reported(WrittenEncoding::Keep, &["B", "Z"], vec![encoded(), depth()]).is_empty());
    assert!(reported(WrittenEncoding::Keep, &["R", "Z"], vec![colour(), depth()]).is_empty());
}

#[test]
fn half_counts_what_overflows_and_spares_data() {
    let p = WriteExr { half: true, ..node(&["O", "Z"]) };
    let (files, notes) = run(&p, of_layers(vec![colour(), depth()])).unwrap_or_else(|e| panic!("{e}"));
    assert!(notes.iter().any(|n| n.id == "half-overflow" && n.text.starts_with("17 ")));
    let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(back.find("O.A").map(|c| c[5]), Some(65_504.0));
    assert_eq!(back.find("Z").map(|c| c[0]), Some(f32::INFINITY));
}

#[test]
fn what_does_not_fit_together_is_refused() {
    let other = Arc::new(Images::single("v", Image::<Data>::new(2, 2, 1)));
    let nan = Arc::new(Images::single("v", Image::<Data>::from_samples(1, 1, 1, vec![f32::NAN])));
    let pair = |a: &str, b: &str| {
        let named = |n: &str| NamedImage { name: n.to_owned(), picture: Image::<Data>::new(3, 2, 1).into() };
        Arc::new(Images(vec![named(a), named(b)]))
    };
    let rigs = of_layers(vec![pair("x", "y"), pair("x", "z")]);
    let Err(reported) = run(&node(&["a", "b"]), rigs) else { panic!("layers of different rigs") };
    assert_eq!(reported.message(), "layer `b` has no view `y`; its views are x, z");
    assert_eq!(reported.advice(), Some("all layers of a file must come from one rig"));
    for (p, inputs) in [
        (node(&[]), of_layers(vec![])),
        (node(&["a"]), of_layers(vec![colour(), depth()])),
        (node(&["a", "b"]), In { image: Some(depth()), ..of_layers(vec![depth()]) }),
        (node(&["Y"]), In { image: Some(depth()), ..of_layers(vec![depth()]) }),
        (node(&["a", "b"]), of_layers(vec![colour(), other])),
        (node(&["a", "b"]), of_layers(vec![pair("x", "y"), pair("x", "z")])),
        (node(&["a", "a"]), of_layers(vec![colour(), depth()])),
        (node(&[]), In { image: Some(nan), ..of_layers(vec![]) }),
    ] {
        assert!(run(&p, inputs).is_err());
    }
    assert!(run(&node(&["a", "b"]), of_layers(vec![pair("x", "y"), depth()])).is_ok());
}

/// Viewers show the default layer; the others have the names that other programs know. This test fails if `image` is
/// refused next to `layers`, or if `names` counts it.
#[test]
fn a_default_layer_stands_next_to_named_ones() {
    let normal = Arc::new(Images::single("v", Image::<Data>::from_samples(3, 2, 3, vec![0.5; 18])));
    let layers = vec![colour(), depth(), normal];
    let p = node(&["object", "depth", "normal"]);
    let image = Some(colour());
    let (files, _) =
        run(&p, In { image: image.clone(), ..of_layers(layers.clone()) }).unwrap_or_else(|e| panic!("{e}"));
    let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
    let names: Vec<&str> = back.channels.iter().map(|c| c.name.as_str()).collect();
    let wanted = [
        "A", "B", "G", "R", "depth.Z", "normal.X", "normal.Y", "normal.Z", "object.A", "object.B",
        "object.G", "object.R",
    ];
    assert_eq!(names, wanted);
    assert_eq!(back.find("G"), back.find("object.G"));
    let few = run(&node(&["object"]), In { image, ..of_layers(layers) }).expect_err("names");
    assert!(few.message().contains("names: 1, layers: 3"), "{few}");
}

fn rig(width: u32) -> Arc<Rig> {
    let axes = [glam::DVec3::X, -glam::DVec3::Z, glam::DVec3::Y];
    let camera = Camera::centred("v", [width, 2], 4.0, axes, glam::DVec3::new(1.0, -2.0, 3.0));
    Arc::new(Rig { cameras: vec![camera] })
}

#[test]
fn the_camera_is_in_the_header() {
    let inputs = In { rig: Some(rig(3)), ..of_layers(vec![colour()]) };
    let (files, _) = run(&node(&["O"]), inputs).unwrap_or_else(|e| panic!("{e}"));
    // The name of the attribute, its type and its length, then 16 numbers.
    let name = b"worldToNDC\0m44f\0\x40\0\0\0";
    let bytes = &files[0].bytes;
    let at = bytes.windows(name.len()).position(|window| window == name).expect("has the attribute");
    let numbers = bytes[at + name.len()..].as_chunks::<4>().0.iter().take(16);
    let numbers: Vec<f32> = numbers.map(|number| f32::from_le_bytes(*number)).collect();
    assert_eq!(numbers, CameraMatrices::of(&rig(3).cameras[0]).world_to_ndc);
    let inputs = In { rig: Some(rig(4)), ..of_layers(vec![colour()]) };
    let wrong = run(&node(&["O"]), inputs).expect_err("another size");
    assert!(wrong.message().contains("4x2 pixels, but the pictures have 3x2"), "{wrong}");
    let mut other = Arc::unwrap_or_clone(rig(3));
    other.cameras = vec![
        Camera { name: "a".to_owned(), ..other.cameras[0].clone() },
        Camera { name: "b".to_owned(), ..other.cameras[0].clone() },
    ];
    let inputs = In { rig: Some(Arc::new(other)), ..of_layers(vec![colour()]) };
    let wrong = run(&node(&["O"]), inputs).expect_err("another name");
    assert!(wrong.message().contains("no camera `v`; its cameras are a, b"), "{wrong}");
}

/// Pixels that equal the plate have the numbers of its file, the others those of the conversion. This test fails if
/// the conversion is used everywhere: it changes the last bit of some of these numbers.
#[test]
fn a_plate_returns_with_the_numbers_of_its_file() {
    let count = 400;
    let numbers: Vec<f32> = (0..3 * count).map(|i| ((i * 7919) % 1009) as f32 / 331.0 - 0.1).collect();
    let conversion = Conversion::new(Space::AcesCg, Space::LinearRec709);
    let linear: Vec<f32> = numbers.as_chunks::<3>().0.iter().flat_map(|rgb| conversion.apply(*rgb)).collect();
    let of = |samples: &[f32]| {
        Arc::new(Images::single("v", Image::<Linear>::from_samples(20, 20, 3, samples.to_vec())))
    };
    let data = |samples: &[f32]| {
        Arc::new(Images::single("v", Image::<Data>::from_samples(20, 20, 3, samples.to_vec())))
    };
    let mut edited = linear.clone();
    edited[3 * 7 + 1] += 0.25;
    let p = WriteExr { encoding: WrittenEncoding::AcesCg, ..node(&[]) };
    let written = |image: &[f32], plate: Option<(&[f32], &[f32])>| {
        let inputs = In {
            image: Some(of(image)),
            plate: plate.map(|(plate, _)| of(plate)),
            stored: plate.map(|(_, stored)| data(stored)),
            ..of_layers(vec![])
        };
        run(&p, inputs).map(|(files, notes)| {
            let back = exr::read("a", &files[0].bytes).unwrap_or_else(|e| panic!("{e}"));
            let rgb = ["R", "G", "B"].map(|c| back.find(c).expect("has it").to_vec());
            let pixels = (0..count).flat_map(|at| [0, 1, 2].map(|c| rgb[c][at].to_bits()));
            (pixels.collect::<Vec<_>>(), notes)
        })
    };
    let bits: Vec<u32> = numbers.iter().map(|v| v.to_bits()).collect();
    let (plain, _) = written(&linear, None).unwrap_or_else(|e| panic!("{e}"));
    assert!(plain != bits);
    let (exact, notes) =
        written(&linear, Some((&linear[..], &numbers[..]))).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(exact, bits);
    assert!(notes.iter().any(|note| note.text.ends_with("plate: 400")));
    let (found, notes) =
        written(&edited, Some((&linear[..], &numbers[..]))).unwrap_or_else(|e| panic!("{e}"));
    let differ = found.chunks(3).zip(bits.chunks(3)).filter(|(a, b)| a != b).count();
    assert!(differ == 1 && found[21..24] != bits[21..24]);
    assert!(notes.iter().any(|note| note.text.ends_with("plate: 399")));
    // The numbers of another space.
    let wrong = written(&linear, Some((&linear[..], &linear[..]))).expect_err("another space");
    assert!(wrong.message().contains("but `stored` is"), "{wrong}");
}
