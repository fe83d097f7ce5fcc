//! Tests of reading and writing OpenEXR.

use std::io::Cursor;

use exr::image::read::layers::ReadChannels;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, ReadLayers, WritableImage,
    f16,
};

use super::compression::{ATTRIBUTE, refusal};
use super::*;
use crate::io::progress::Progress;
use crate::math::color::primaries::REC709;
use testing::row;

fn planes(depth: Depth) -> Vec<(Channel, Depth)> {
    let plane = |name: &str, k: f32| {
        let samples = (0..35).map(|i| i as f32 * k).collect();
        (Channel { name: name.to_owned(), samples }, depth)
    };
    vec![plane("R", 0.5), plane("G", 1.0), plane("B", -2.0), plane("R0.R", 0.25), plane("Z", 8.0)]
}

#[test]
fn named_planes_come_back_exactly_and_bytes_repeat() {
    for depth in [Depth::Float, Depth::Half] {
        let make =
            || write(7, 5, planes(depth), "R=linear", Some("(recipe)")).unwrap_or_else(|e| panic!("{e}"));
        let (bytes, clamped) = make();
        assert_eq!(clamped, 0);
        for _ in 0..4 {
            assert_eq!(make().0, bytes);
        }
        let back = read("a.exr", &bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((back.width, back.height, back.parts, back.cropped), (7, 5, 1, false));
        for (channel, _) in planes(depth) {
            assert_eq!(back.find(&channel.name), Some(channel.samples.as_slice()), "{}", channel.name);
        }
        assert!(bytes.windows(8).any(|w| w == b"(recipe)"));
    }
}

/// Blocks compressed in parallel equal those that the library writes sequentially.
#[test]
fn blocks_give_the_bytes_of_the_whole_picture() {
    let plane = |name: &str, k: usize| {
        let samples = (0..70 * 700).map(|i| ((i * 7919 * k) % 1013) as f32).collect();
        (Channel { name: name.to_owned(), samples }, Depth::Float)
    };
    let (bytes, _) = write(70, 700, vec![plane("R", 1), plane("Z", 3)], "", Some("a recipe"))
        .unwrap_or_else(|e| panic!("{e}"));
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(&bytes))
        .unwrap_or_else(|e| panic!("{e}"));
    let mut again = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut again).unwrap_or_else(|e| panic!("{e}"));
    assert!(again.into_inner() == bytes);
}

#[test]
fn halves_round_to_nearest_and_never_overflow_silently() {
    let samples = vec![65_504.0, 65_519.99, 65_520.0, 1e5, 6e-5, 6e-8, -1e9, f32::INFINITY];
    let (bytes, clamped) = write(8, 1, vec![(Channel { name: "R".into(), samples }, Depth::Half)], "", None)
        .unwrap_or_else(|e| panic!("{e}"));
    row(62, "finite values beyond a half that are not counted", 3.0 - clamped as f64, 0.0);
    let back = read("a.exr", &bytes).unwrap_or_else(|e| panic!("{e}"));
    let r = back.find("R").unwrap_or_default();
    row(62, "error of 6e-8, half of the least half", f64::from((r[5] - 6e-8).abs()), 3e-8);
    assert_eq!(r[..4], [65_504.0; 4]);
    assert_eq!(r[4], f16::from_f32(6e-5).to_f32());
    assert_eq!(r[6..], [-65_504.0, f32::INFINITY]);
}

/// One file may contain both 16-bit and 32-bit floats. NaN and infinity are kept, and a picture without pixels
/// is refused.
#[test]
fn types_mix_and_what_is_no_number_comes_through() {
    let odd = vec![f32::NAN, f32::INFINITY, -0.0, 1e-40];
    let channel = |name: &str, samples: &[f32]| Channel { name: name.into(), samples: samples.to_vec() };
    let channels =
        vec![(channel("Z", &odd), Depth::Float), (channel("A", &[0.5, 1.0, 0.25, 0.0]), Depth::Half)];
    let (bytes, _) = write(2, 2, channels, "", None).unwrap_or_else(|e| panic!("{e}"));
    let back = read("a.exr", &bytes).unwrap_or_else(|e| panic!("{e}"));
    let bits = |samples: &[f32]| samples.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(back.find("Z").map(bits), Some(bits(&odd)));
    assert_eq!(back.find("A"), Some(&[0.5, 1.0, 0.25, 0.0][..]));
    let none = write(0, 0, vec![(channel("Z", &[]), Depth::Float)], "", None);
    assert!(none.map_or(true, |(bytes, _)| read("a.exr", &bytes).is_err()));
}

/// Chromaticities of a file are read; those of sRGB, with usual rounding, do not count as different. This test
/// fails if `off` uses `all` instead of `any`.
#[test]
fn chromaticities_of_other_colours_are_distinguished() {
    use exr::meta::attribute::Chromaticities;
    let read_with = |green: Option<(f32, f32)>| {
        let at = |[x, y]: [f32; 2]| exr::math::Vec2(x, y);
        let srgb = [REC709.red, REC709.green, REC709.blue, REC709.white];
        let [red, own, blue, white] = srgb.map(|xy| at(xy.map(|v| v as f32)));
        let list = ["R", "G", "B"].map(|name| AnyChannel::new(name, FlatSamples::F32(vec![0.5; 2])));
        let layer = Layer::new(
            (2, 1),
            LayerAttributes::default(),
            Encoding::UNCOMPRESSED,
            AnyChannels::sort(list.into_iter().collect()),
        );
        let mut image = Image::from_layer(layer);
        image.attributes.chromaticities =
            green.map(|(x, y)| Chromaticities { red, green: at([own.0 + x, own.1 + y]), blue, white });
        let mut bytes = Cursor::new(Vec::new());
        image.write().non_parallel().to_buffered(&mut bytes).unwrap_or_else(|e| panic!("{e}"));
        read("a.exr", &bytes.into_inner()).unwrap_or_else(|e| panic!("{e}")).other_primaries()
    };
    assert!(!read_with(None) && !read_with(Some((0.0, 0.0))) && !read_with(Some((1e-3, -1e-3))));
    // Rec. ITU-R BT.2020 has its green at (0.170, 0.797).
    assert!(read_with(Some((-0.13, 0.197))) && read_with(Some((0.0, f32::NAN))));
}

/// If a file has several parts, the first flat part is read, with its channels of each type, and the number of
/// parts is reported.
#[test]
fn the_first_of_several_parts_is_read() {
    let part = |name: &str, size: (usize, usize), channels| {
        let attributes = LayerAttributes::named(name);
        Layer::new(size, attributes, Encoding::UNCOMPRESSED, AnyChannels::sort(channels))
    };
    let half = FlatSamples::F16([0.5, 2.0].map(f16::from_f32).to_vec());
    let first = [
        AnyChannel::new("R", half),
        AnyChannel::new("G", FlatSamples::F32(vec![0.1, -0.0])),
        AnyChannel::new("id", FlatSamples::U32(vec![7, 1 << 24])),
    ];
    let second = [AnyChannel::new("Z", FlatSamples::F32(vec![9.0; 6]))];
    let parts =
        vec![part("a", (2, 1), first.into_iter().collect()), part("b", (3, 2), second.into_iter().collect())];
    let window = exr::prelude::IntegerBounds::from_dimensions((2, 1));
    let image = Image::from_layers(exr::prelude::ImageAttributes::new(window), parts);
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).expect("writes");
    let back = read("a.exr", bytes.get_ref()).expect("reads");
    assert_eq!((back.width, back.height, back.parts, back.cropped), (2, 1, 2, false));
    assert_eq!(
        (back.part.as_str(), back.part_names.as_slice()),
        ("a", &["a".to_owned(), "b".to_owned()][..])
    );
    assert_eq!(back.find("R"), Some(&[0.5, 2.0][..]));
    assert_eq!(back.find("G"), Some(&[0.1, -0.0][..]));
    assert_eq!(back.find("id"), Some(&[7.0, 16_777_216.0][..]));
    assert_eq!(back.find("Z"), None);
}

/// A file with parts of two pixels; each part has a name and channels of one value.
fn with_parts(parts: &[(&str, &[(&str, f32)])]) -> Vec<u8> {
    let plane = |(name, v): &(&str, f32)| AnyChannel::new(*name, FlatSamples::F32(vec![*v; 2]));
    let part = |(name, list): &(&str, &[(&str, f32)])| {
        let channels = list.iter().map(plane).collect();
        Layer::new((2, 1), LayerAttributes::named(*name), Encoding::UNCOMPRESSED, AnyChannels::sort(channels))
    };
    let window = exr::prelude::IntegerBounds::from_dimensions((2, 1));
    let layers: exr::prelude::Layers<_> = parts.iter().map(part).collect();
    let image = Image::from_layers(exr::prelude::ImageAttributes::new(window), layers);
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).expect("writes");
    bytes.into_inner()
}

/// Masks and vectors in front of the colours do not replace them, and are read if nothing else has colours. This test
/// fails if `choose_part` takes the first part that has any of these channels.
#[test]
fn masks_and_vectors_in_front_of_the_colours_are_not_read() {
    let rgb = [("R", 1.0), ("G", 2.0), ("B", 3.0)];
    let own = [("rgb.R", 1.0), ("rgb.G", 2.0), ("rgb.B", 3.0)];
    let (mask, vectors) =
        (("mask", &[("Y", 9.0)][..]), ("N", &[("N.R", 7.0), ("N.G", 7.0), ("N.B", 7.0)][..]));
    let plain = ("Normal", &[("R", 8.0), ("G", 8.0), ("B", 8.0)][..]);
    let place = ("view.P01", &[("r", 6.0), ("g", 6.0), ("b", 6.0)][..]);
    for (parts, part, layer) in [
        (&[mask, ("rgb", &rgb[..])][..], "rgb", ""),
        (&[vectors, ("rgb", &rgb)], "rgb", ""),
        (&[plain, place, mask, ("rgb", &rgb)], "rgb", ""),
        (&[mask, vectors, ("rgb", &own)], "rgb", "rgb"),
        (&[("a", &rgb), mask, ("b", &rgb)], "a", ""),
        (&[("albedo", &rgb), mask, ("beauty", &rgb)], "beauty", ""),
        (&[("albedo", &rgb), ("shot", &rgb), ("ViewLayer.Combined", &rgb)], "ViewLayer.Combined", ""),
        (&[("ViewLayer.DiffCol", &rgb), ("shot", &rgb)], "shot", ""),
        (&[("diffuse_color", &rgb), ("Combined", &rgb)], "Combined", ""),
        (&[plain, ("diffuse", &rgb), ("specular", &rgb)], "diffuse", ""),
        (&[("a", &[("a.R", 1.0), ("a.G", 2.0), ("a.B", 3.0)]), ("b", &rgb)], "b", ""),
        (&[vectors, mask], "mask", ""),
        (&[("id", &[("I", 1.0)]), vectors, plain], "Normal", ""),
        (&[("id", &[("I", 1.0)]), vectors], "N", "N"),
    ] {
        let read = read("a.exr", &with_parts(parts)).expect("reads");
        assert_eq!((read.part.as_str(), read.layer.as_str()), (part, layer), "{parts:?}");
    }
    // A part that is named is read, whatever it holds.
    let bytes = with_parts(&[("rgb", &rgb), vectors, mask]);
    for (name, layer) in [("N", "N"), ("mask", "Y")] {
        let read = read_layer("a.exr", &bytes, name, Progress::UNTRACKED).expect("reads");
        assert_eq!((read.part.as_str(), read.layer.as_str()), (name, layer));
    }
}

/// If the first part of a file is a depth, the colours of a later part are read by default, and any part can be
/// selected by name.
#[test]
fn colours_of_a_later_part_are_read_and_parts_can_be_named() {
    let rgb = |v: f32| [("R", v), ("G", v + 1.0), ("B", v + 2.0)];
    let bytes = with_parts(&[
        ("depth", &[("Z", 9.0)]),
        ("beauty", &rgb(1.0)),
        ("light", &[("key.R", 5.0), ("key.G", 6.0), ("key.B", 7.0)]),
        ("left", &rgb(20.0)),
    ]);
    let of = |layer: &str| {
        let read = read_layer("a.exr", &bytes, layer, Progress::UNTRACKED).expect("reads");
        (read.part, read.layer, read.channels[0].samples[0])
    };
    let is = |part: &str, layer: &str, first: f32| (part.to_owned(), layer.to_owned(), first);
    // Channels are sorted: B comes first.
    assert_eq!(of(""), is("beauty", "", 3.0));
    assert_eq!(of("left"), is("left", "", 22.0));
    assert_eq!(of("depth"), is("depth", "Z", 9.0));
    assert_eq!(of("Z"), is("depth", "Z", 9.0));
    assert_eq!(of("key"), is("light", "key", 7.0));
    assert_eq!((of("light.key"), of("light/key")), (is("light", "key", 7.0), is("light", "key", 7.0)));
    assert_eq!(of("left.R"), is("left", "R", 22.0));
    // For an unknown name the first part is read, and the caller lists the existing names.
    assert_eq!(of("right"), is("depth", "right", 9.0));
    // The layers of all parts. An earlier version listed those of the first part only.
    let layers: Vec<String> = open("a.exr", &bytes, "right").expect("opens").layers().into_iter().collect();
    let wanted = ["beauty.B", "beauty.G", "beauty.R", "depth.Z", "left.B", "left.G", "left.R", "light.key"];
    assert_eq!(layers, wanted);
    // Channels that carry the name of their part.
    let named = with_parts(&[
        ("depth", &[("depth.Z", 9.0)]),
        ("beauty", &[("beauty.R", 1.0), ("beauty.G", 2.0), ("beauty.B", 3.0)]),
    ]);
    let of_named = |layer: &str| {
        let read = read_layer("a.exr", &named, layer, Progress::UNTRACKED).expect("reads");
        (read.part, read.layer, read.channels[0].samples[0])
    };
    assert_eq!(of_named(""), is("beauty", "beauty", 3.0));
    assert_eq!(of_named("beauty"), is("beauty", "beauty", 3.0));
    // Colours of another layer are not chosen by default.
    let other = with_parts(&[("depth", &[("Z", 9.0)]), ("a", &[("b.R", 1.0), ("b.G", 2.0), ("b.B", 3.0)])]);
    assert_eq!(read("a.exr", &other).map(|read| read.part).expect("reads"), "depth");
    let grey = with_parts(&[("id", &[("I", 1.0)]), ("plate", &[("Y", 4.0)])]);
    assert_eq!(read("a.exr", &grey).map(|read| read.part).expect("reads"), "plate");
    let none = with_parts(&[("id", &[("I", 1.0)]), ("more", &[("J", 4.0)])]);
    assert_eq!(read("a.exr", &none).map(|read| read.part).expect("reads"), "id");
}

/// Tests data windows that equal, partly overlap, miss or lie inside the display window, read both as separate
/// planes and as interleaved pixels of selected channels.
#[test]
fn a_cropped_data_window_lands_in_its_place() {
    let file = |position: (i32, i32), window: (usize, usize)| {
        let plane = |name: &str, k: f32| {
            AnyChannel::new(name, FlatSamples::F32([1.0, 2.0, 3.0, 4.0].map(|v| v * k).to_vec()))
        };
        let list = [plane("B", 1.0), plane("G", 10.0), plane("Z", 100.0)];
        let attributes = LayerAttributes {
            layer_position: exr::math::Vec2(position.0, position.1),
            ..LayerAttributes::named("a")
        };
        let channels = AnyChannels::sort(list.into_iter().collect());
        let layer = Layer::new((2, 2), attributes, Encoding::SMALL_LOSSLESS, channels);
        let window = exr::prelude::IntegerBounds::from_dimensions(window);
        let image = Image::new(exr::prelude::ImageAttributes::new(window), layer);
        let mut bytes = Cursor::new(Vec::new());
        image.write().non_parallel().to_buffered(&mut bytes).unwrap_or_else(|e| panic!("{e}"));
        bytes.into_inner()
    };
    for (position, window, wanted) in [
        ((0, 0), (2, 2), vec![1.0, 2.0, 3.0, 4.0]),
        ((1, 0), (3, 2), vec![0.0, 1.0, 2.0, 0.0, 3.0, 4.0]),
        ((-1, -1), (2, 2), vec![4.0, 0.0, 0.0, 0.0]),
        ((5, 0), (2, 2), vec![0.0; 4]),
    ] {
        let bytes = file(position, window);
        let opened = open("a.exr", &bytes, "").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(opened.cropped(), position != (0, 0));
        let planes = opened.planes(Progress::UNTRACKED).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(planes.find("B"), Some(&wanted[..]));
        let pixels = opened
            .interleaved(&["Z".to_owned(), "B".to_owned()], Progress::UNTRACKED)
            .unwrap_or_else(|e| panic!("{e}"));
        let both: Vec<f32> = wanted.iter().flat_map(|v| [100.0 * v, *v]).collect();
        assert_eq!(pixels, both);
        assert!(opened.interleaved(&["A".to_owned()], Progress::UNTRACKED).is_err());
    }
}

#[test]
fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
    let (bytes, _) = write(7, 5, planes(Depth::Float), "R=linear", None).unwrap_or_else(|e| panic!("{e}"));
    for end in 0..bytes.len() {
        assert!(read("a.exr", &bytes[..end]).is_err(), "cut at {end}");
    }
    for at in 0..bytes.len() * 8 {
        let mut hurt = bytes.clone();
        hurt[at / 8] ^= 1 << (at % 8);
        drop(read("a.exr", &hurt));
    }
}

/// Each compression that is not read is named, those that the library knows and those that it does not. This test
/// fails if `open` does not call `refusal`.
#[test]
fn compressions_that_are_not_read_are_named() {
    let plane = Channel { name: "Y".to_owned(), samples: vec![0.5; 6] };
    let (bytes, _) = write(3, 2, vec![(plane, Depth::Half)], "", None).expect("writes");
    assert!(read("a.exr", &bytes).is_ok() && refusal("a.exr", &bytes).is_none());
    let at = bytes.windows(ATTRIBUTE.len()).position(|w| w == ATTRIBUTE).expect("has the attribute");
    for (number, says) in [(10, "HTJ2K256"), (11, "HTJ2K32"), (12, "LJ2K"), (13, "ZSTD"), (77, "number 77")] {
        let mut other = bytes.clone();
        other[at + ATTRIBUTE.len()] = number;
        let error = read("a.exr", &other).expect_err("is not read").to_string();
        let wanted = format!("the compression {says}; save the picture with ZIP or PIZ");
        assert!(error.contains(&wanted) && error.contains("a.exr"), "{error}");
    }
}
