//! Tests of decoded pictures.

use super::*;
use crate::io::png::Raster;

fn load(bytes: &[u8], encoding: FileEncoding, layer: &str) -> (Picture, Notes) {
    let mut notes = Notes::none();
    (
        decode(encoding, layer, "a", bytes, &mut notes, Progress::UNTRACKED)
            .unwrap_or_else(|e| panic!("{e}")),
        notes,
    )
}
fn png_of(channels: usize, largest: u16, codes: Vec<u16>) -> Vec<u8> {
    let width = codes.len() / channels;
    let raster = Raster { width, height: 1, channels, largest, codes, ignored: Vec::new(), colour: None };
    png::write(&raster, false, &[]).unwrap_or_else(|e| panic!("{e}"))
}

/// Pixels of an OpenEXR file that are not square are reported.
#[test]
fn pixels_that_are_not_square_are_reported() {
    let plane = |name: &str| {
        let samples = vec![0.5];
        (exr::Channel { name: name.into(), samples }, exr::Depth::Float)
    };
    let channels = ["R", "G", "B"].map(plane).into_iter().collect();
    let (bytes, _) = exr::write(1, 1, channels, "", None).unwrap_or_else(|e| panic!("{e}"));
    let reported = |bytes: &[u8]| {
        let (_, notes) = load(bytes, FileEncoding::Auto, "");
        notes.iter().any(|note| note.id == "pixel-aspect-ignored")
    };
    assert!(!reported(&bytes));
    // The name of the attribute, its type and its length, then the number.
    let name = b"pixelAspectRatio\0float\0\x04\0\0\0";
    let at = bytes.windows(name.len()).position(|window| window == name).map(|at| at + name.len());
    let mut wide = bytes;
    let place = at.and_then(|at| wide.get_mut(at..at + 4)).expect("has the attribute");
    place.copy_from_slice(&2.0_f32.to_le_bytes());
    assert!(reported(&wide));
    let radiance = |more: &str| {
        let head = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{more}\n-Y 1 +X 1\n");
        reported(&[head.as_bytes(), &[128, 128, 128, 129][..]].concat())
    };
    assert_eq!(["", "PIXASPECT=1\n", "PIXASPECT= 0.5\n"].map(radiance), [false, false, true]);
}

/// PNGs of 8 and 16 bits, grey and with alpha, are decoded to premultiplied colour or, if the encoding says so,
/// to data.
#[test]
fn pngs_are_premultiplied_colour_or_data() {
    let rgba = png_of(4, 255, vec![255, 51, 0, 51]);
    let (picture, _) = load(&rgba, FileEncoding::Auto, "");
    assert_eq!((picture.encoding(), picture.samples()), ("srgb", &[0.2, 0.2 * 0.2, 0.0, 0.2][..]));
    assert_eq!(load(&rgba, FileEncoding::Data, "").0.samples(), [1.0, 0.2, 0.0, 0.2]);
    let grey = png_of(1, 65_535, vec![0, 13_107]);
    let (picture, _) = load(&grey, FileEncoding::Linear, "");
    assert_eq!((picture.encoding(), picture.size()), ("linear", (2, 1, 3)));
    assert_eq!(picture.samples()[3..], [0.2; 3]);
    assert_eq!(load(&grey, FileEncoding::Data, "").0.size(), (2, 1, 1));
}

/// A JPEG of 2 x 1 pixels, left red and right blue, that is to be turned by 90 degrees clockwise. This test fails
/// if `upright_size` or the decoder ignores the metadata, or if `decode` does not.
#[test]
fn a_photograph_is_turned_upright_where_asked() {
    let codes = [[[250, 0, 0]; 8], [[0, 0, 250]; 8]].concat().concat().repeat(8);
    let raster =
        Raster { width: 16, height: 8, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None };
    let mut bytes = jpeg::write(&raster, 100, None).unwrap_or_else(|e| panic!("{e}"));
    let exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let length = (exif.len() as u16 + 2).to_be_bytes();
    bytes.splice(2..2, [&[0xff, 0xe1][..], &length, exif].concat());
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), &bytes).expect("it is written");
    assert_eq!((size(file.path()), upright_size(file.path())), (Some([16, 8]), Some([8, 16])));
    let (stored, notes) = load(&bytes, FileEncoding::Auto, "");
    assert_eq!(stored.size(), (16, 8, 3));
    assert!(notes.iter().any(|note| note.text.contains("other than upright (EXIF)")));
    let mut notes = Notes::none();
    let (encoding, upright) = (FileEncoding::Auto, Orientation::Upright);
    let turned = decode_turned(encoding, upright, "", "a", &bytes, &mut notes, Progress::UNTRACKED)
        .unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(notes.iter().map(|note| note.id.as_str()).collect::<Vec<_>>(), ["turned-upright"]);
    assert_eq!(turned.size(), (8, 16, 3));
    // The left side of the file is at the top.
    let (top, bottom) = (turned.samples().first_chunk::<3>(), turned.samples().last_chunk::<3>());
    let (Some([red, _, _]), Some([_, _, blue])) = (top, bottom) else { panic!("has pixels") };
    assert!(*red > 0.9 && *blue > 0.9, "{red}, {blue}");
}

/// TIFF of codes is sRGB with straight alpha unless it says otherwise; TIFF of floats is light.
#[test]
fn tiffs_are_premultiplied_colour_or_data() {
    use ::tiff::encoder::{TiffEncoder, colortype};
    let mut codes = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut codes).expect("a header");
    encoder.write_image::<colortype::RGBA8>(1, 1, &[255, 51, 0, 51]).expect("a picture");
    let codes = codes.into_inner();
    let (picture, notes) = load(&codes, FileEncoding::Auto, "");
    assert_eq!((picture.encoding(), picture.samples()), ("srgb", &[0.2, 0.2 * 0.2, 0.0, 0.2][..]));
    assert_eq!(notes, Notes::none());
    assert_eq!(load(&codes, FileEncoding::Data, "").0.samples(), [1.0, 0.2, 0.0, 0.2]);
    let mut grey = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut grey).expect("a header");
    encoder.write_image::<colortype::Gray32Float>(2, 1, &[0.5, 7.0]).expect("a picture");
    let (picture, _) = load(&grey.into_inner(), FileEncoding::Auto, "");
    assert_eq!((picture.encoding(), picture.size()), ("linear", (2, 1, 3)));
    assert_eq!(picture.samples()[3..], [7.0; 3]);
}

/// The pages of a TIFF after the first are reported with an id of their own. This test fails if the number of pages is
/// not looked at, or the first page is not the one that is read.
#[test]
fn pages_after_the_first_are_reported() {
    use ::tiff::encoder::{TiffEncoder, colortype};
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).expect("a header");
    for grey in [51, 255] {
        encoder.write_image::<colortype::Gray8>(1, 1, &[grey]).expect("a picture");
    }
    let (picture, notes) = load(&bytes.into_inner(), FileEncoding::Auto, "");
    assert_eq!(picture.samples(), [0.2; 3]);
    assert_eq!(notes.iter().map(|note| note.id.as_str()).collect::<Vec<_>>(), ["one-page-only"]);
}

// Used to be decoded as display colours, with 0.5 becoming 0.21.
#[test]
fn a_picture_with_a_linear_profile_is_linear_light() {
    let profile = crate::io::icc::tests::profile(
        "Linear sRGB",
        &moxcms::ColorProfile::new_srgb(),
        moxcms::ToneReprCurve::Lut(Vec::new()),
    );
    let file = png::tests::with_profile(&profile);
    let (picture, notes) = load(&file, FileEncoding::Auto, "");
    assert_eq!((picture.encoding(), picture.samples()[0]), ("linear", 128.0 / 255.0));
    assert!(notes.iter().any(|note| note.id == "linear-profile"));
    let (picture, notes) = load(&file, FileEncoding::Srgb, "");
    assert_eq!((picture.encoding(), notes.iter().count()), ("srgb", 0));
}

#[test]
fn layers_of_an_exr_are_found_by_name_and_hold_numbers() {
    let plane =
        |name: &str, v: f32| (exr::Channel { name: name.into(), samples: vec![v] }, exr::Depth::Float);
    let channels = vec![
        plane("R", 1.0),
        plane("G", f32::NAN),
        plane("B", f32::INFINITY),
        plane("R0.R", 4.0),
        plane("R0.G", 5.0),
        plane("R0.B", 6.0),
        plane("R0.A", 1.0),
        plane("Z", f32::INFINITY),
        plane("depth.Z", 3.0),
        plane("N.X", 0.0),
        plane("N.Y", 0.0),
        plane("N.Z", 1.0),
    ];
    let (bytes, _) = exr::write(1, 1, channels, "", None).unwrap_or_else(|e| panic!("{e}"));
    let (picture, notes) = load(&bytes, FileEncoding::Auto, "");
    assert_eq!((picture.encoding(), picture.samples()), ("linear", &[1.0, 0.0, 65_504.0][..]));
    assert_eq!(notes.iter().count(), 2);
    assert_eq!(load(&bytes, FileEncoding::Auto, "R0").0.samples(), [4.0, 5.0, 6.0, 1.0]);
    assert_eq!(load(&bytes, FileEncoding::Data, "Z").0.samples(), [f32::INFINITY]);
    assert_eq!(load(&bytes, FileEncoding::Data, "N").0.samples(), [0.0, 0.0, 1.0]);
    assert_eq!(load(&bytes, FileEncoding::Data, "depth").0.samples(), [3.0]);
    let refused = |bytes: &[u8], layer: &str| {
        let read = decode(FileEncoding::Auto, layer, "a", bytes, &mut Notes::none(), Progress::UNTRACKED);
        read.err().map(|error| error.to_string()).unwrap_or_default()
    };
    let reported = refused(&bytes, "S");
    assert!(
        reported.contains("no layer `S`")
            && reported.contains("one of `B`, `G`, `N`, `R`, `R0`, `Z`, `depth`"),
        "{reported}"
    );

    // Data is not mistaken for colour, and the channels of the file are listed.
    let of = |names: &[&str]| {
        let channels = names.iter().map(|name| plane(name, 0.5)).collect();
        exr::write(1, 1, channels, "", None).unwrap_or_else(|e| panic!("{e}")).0
    };
    assert_eq!(load(&of(&["r", "g", "b"]), FileEncoding::Auto, "").0.size(), (1, 1, 3));
    let reported = refused(&of(&["variance.R", "variance.G", "variance.B"]), "");
    assert!(
        reported.contains("neither channels R, G and B nor a channel Y; `layer` may be one of `variance`"),
        "{reported}"
    );
    for more in [&["Y", "RY", "BY"][..], &["Y", "RY", "BY", "A"]] {
        assert!(refused(&of(more), "").contains("luminance and chroma"));
        assert_eq!(load(&of(more), FileEncoding::Auto, "Y").0.size(), (1, 1, 1));
    }
    assert!(refused(&of(&["R", "G"]), "").contains("the channels of the file are G, R"));
}

/// Light that is declared as a log has no finite value above the range of the log. An earlier version gave infinite and NaN
/// samples, and another node failed.
#[test]
fn light_declared_as_a_log_is_reported() {
    let plane = |name: &str, v: f32| {
        (exr::Channel { name: name.to_owned(), samples: vec![v, 0.5] }, exr::Depth::Float)
    };
    let planes = vec![plane("R", 900.0), plane("G", 0.25), plane("B", 0.25)];
    let (bytes, _) = exr::write(2, 1, planes, "", None).unwrap_or_else(|e| panic!("{e}"));
    let (picture, notes) = load(&bytes, FileEncoding::LogC4, "");
    assert!(picture.samples().iter().all(|v| v.is_finite()), "{:?}", picture.samples());
    assert!(notes.iter().any(|note| note.id == "beyond-colour-space"), "{notes:?}");
    let (_, notes) = load(&bytes, FileEncoding::AcesCg, "");
    assert!(notes.iter().all(|note| note.id != "beyond-colour-space"));
}
