use std::sync::Arc;

use engine::{Kind, Scene, Up};
use scene::io::exr::{self, Channel, Depth};
use scene::io::png::{self, Raster};
use scene::math::color::{code8, linear_from_srgb};
use tempfile::TempDir;

use super::super::{CLIPPED, In, Method, Out, PredictExposure};
use super::*;
use crate::kinds::fuse_hdr::{self, FuseHdr, Gain};

const W: usize = 64;
const H: usize = 32;

/// Light in a column. The columns repeat in groups of four: a lamp, a sun, a moon and a dim column. Dim columns
/// become brighter to the right.
fn light(x: usize) -> f32 {
    [3.0, 30.0, 900.0, 0.2 + 0.01 * x as f32][x % 4]
}

/// Folder with photographs of the light that [`light`] defines.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().expect("a folder"));
        place.take("a.png", -3.0, (W, H), None);
        place.take("b.png", -6.0, (W, H), None);
        place
    }

    /// Writes an 8-bit photograph. `alpha` holds the alpha of the pixels, and a flag: if it is set, the alpha of
    /// column 0 is 0 instead.
    fn take(&self, name: &str, ev: f32, (width, height): (usize, usize), alpha: Option<(u16, bool)>) {
        let code = |x: usize| u16::from(code8(srgb_from_linear((light(x) * num::f32::exp2(ev)).min(1.0))));
        let pixel = |at: usize| {
            let x = at % width;
            let a = alpha.map(|(alpha, hole)| if hole && x == 0 { 0 } else { alpha });
            [code(x); 3].into_iter().chain(a)
        };
        let codes = (0..width * height).flat_map(pixel).collect();
        let channels = if alpha.is_some() { 4 } else { 3 };
        let raster =
            Raster { width, height, channels, largest: 255, codes, ignored: Vec::new(), colour: None };
        self.write(name, &png::write(&raster, false, &[]).expect("packs"));
    }

    /// Writes a photograph as linear light.
    fn take_linear(&self, name: &str, ev: f32) {
        let samples: Vec<f32> = (0..W * H).map(|at| light(at % W) * num::f32::exp2(ev)).collect();
        let planes = ["R", "G", "B"]
            .map(|name| (Channel { name: name.to_owned(), samples: samples.clone() }, Depth::Float));
        self.write(name, &exr::write(W, H, planes.into(), "", None).expect("packs").0);
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.0.path().join(name), bytes).expect("writes");
    }

    fn measure(&self, pano: Panorama, files: &[&str], evs: &[f64]) -> Result<(Out, Notes), NodeError> {
        let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive: false };
        let files = files.iter().map(|file| InputFile((*file).to_owned())).collect();
        let params = PredictExposure {
            evs: evs.to_vec(),
            method: Method::Photographs { files },
            white: CLIPPED,
            weights: None,
        };
        PredictExposure::check(&params)?;
        let pano = Arc::new(pano);
        PredictExposure::run(&params, In { pano }, &Context::detached(scene, self.0.path()))
    }

    /// Gains of the first four columns.
    fn gains(&self, files: &[&str], evs: &[f64]) -> (Vec<f32>, Notes) {
        let (out, notes) = self.measure(pano(0), files, evs).expect("runs");
        (out.brackets.log2_gain.samples[..4].to_vec(), notes)
    }
}

/// Panorama of the light that [`light`] defines, rotated to the left by `turned` columns.
fn pano(turned: usize) -> Panorama {
    let codes = |at: usize| [srgb_from_linear(light((at + turned) % W).min(1.0)); 3];
    Panorama {
        image: Image::<Srgb>::from_samples(W, H, 3, (0..W * H).flat_map(codes).collect()).into(),
        alpha: Image::from_samples(W, H, 1, vec![1.0; W * H]),
        up: Up::PlusZ,
        origin: None,
        turned_deg: 360.0 * turned as f64 / W as f64,
    }
}

fn assert_near(found: &[f32], wanted: [f32; 4]) {
    assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 0.02), "{found:?}, not {wanted:?}");
}

/// Texts of the notes with an id.
fn reported<'a>(notes: &'a Notes, id: &str) -> Vec<&'a str> {
    notes.iter().filter(|note| note.id == id).map(|note| note.text.as_str()).collect()
}

/// The gain of each clipped pixel comes from the brightest file in which it is unclipped, whatever the order of the
/// files. This test fails without `.rev()` in `Photographs::gains`.
#[test]
fn photographs_tell_the_gain_and_are_the_exposures() {
    let place = Folder::new();
    let (out, notes) = place.measure(pano(0), &["a.png", "b.png"], &[-3.0, -6.0]).expect("runs");
    assert_near(&out.brackets.log2_gain.samples[..4], [1.585, 4.907, 6.0, 0.0]);
    // The sun is white at EV -6 too.
    assert!(reported(&notes, "still-clipped")[0].contains("(count: 512)"), "{notes:?}");
    assert_eq!(reported(&notes, "photograph-disagrees").len(), 0, "{notes:?}");
    assert_eq!(out.brackets.evs, [-6.0, -3.0]);
    assert!((out.brackets.exposures[0].rgb(0, 0)[0] - srgb_from_linear(3.0 / 64.0)).abs() < 0.003);
    let (other, _) = place.measure(pano(0), &["b.png", "a.png"], &[-6.0, -3.0]).expect("runs");
    assert_eq!(other.brackets, out.brackets);
    assert!(place.measure(pano(0), &["a.png"], &[-3.0, -6.0]).is_err());
    assert!(place.measure(pano(0), &[], &[]).is_err());
}

/// The files show the scene, not the rotated panorama. This test fails if `turned_deg` is 0 in `read`.
#[test]
fn photographs_are_turned_with_their_panorama() {
    let place = Folder::new();
    let measure = |turned| {
        let (out, notes) = place.measure(pano(turned), &["a.png", "b.png"], &[-3.0, -6.0]).expect("runs");
        assert!(reported(&notes, "photograph-disagrees").is_empty(), "{notes:?}");
        out.brackets
    };
    let still = measure(0);
    for turned in [1, 13, 63] {
        let brackets = measure(turned);
        let from = |at: usize| at / W * W + (at % W + turned) % W;
        assert!((0..W * H).all(|at| brackets.log2_gain.samples[at] == still.log2_gain.samples[from(at)]));
        assert_eq!(brackets.exposures[1].rgb(5, 9), still.exposures[1].rgb((5 + turned) % W, 9));
    }
    let half = Panorama { turned_deg: 0.4 * 360.0 / W as f64, ..pano(0) };
    let (_, notes) = place.measure(half, &["a.png", "b.png"], &[-3.0, -6.0]).expect("runs");
    assert_eq!(reported(&notes, "photographs-between-pixels").len(), 1);
}

/// Colours do not depend on alpha. In the hole of a photograph, another photograph is used. This test fails if
/// `alpha` is not checked in `Photograph::shown`.
#[test]
fn alpha_takes_no_light() {
    let place = Folder::new();
    place.take("half.png", -3.0, (W, H), Some((128, false)));
    place.take("hole.png", -3.0, (W, H), Some((255, true)));
    assert_near(&place.gains(&["half.png", "b.png"], &[-3.0, -6.0]).0, [1.585, 4.907, 6.0, 0.0]);
    let (gains, notes) = place.gains(&["hole.png", "b.png"], &[-3.0, -6.0]);
    assert_near(&gains, [1.585, 4.907, 6.0, 0.0]);
    assert_eq!(reported(&notes, "photographs-have-holes").len(), 0);
    let (out, notes) = place.measure(pano(0), &["hole.png"], &[-3.0]).expect("runs");
    assert_eq!(out.brackets.log2_gain.samples[0], 0.0);
    assert!(reported(&notes, "photographs-have-holes")[0].ends_with("(count: 32)"), "{notes:?}");
    // White at EV -3 and a hole at -6: the darkest photograph of it is the white one.
    place.take("white.png", -0.1, (W, H), None);
    place.take("hole-6.png", -6.0, (W, H), Some((255, true)));
    let (_, notes) = place.gains(&["white.png", "hole-6.png"], &[-0.1, -6.0]);
    let still = reported(&notes, "still-clipped")[0];
    assert!(still.contains("in the darkest exposure that shows them"), "{still}");
    // The exposure is not black there: it shows the known light.
    assert!((out.brackets.exposures[0].rgb(0, 3)[0] - srgb_from_linear(0.125)).abs() < 1e-6);
}

/// Linear files are never clipped. This test fails if `Photograph::shown` treats them like display-encoded files.
#[test]
fn linear_light_has_no_ceiling() {
    let place = Folder::new();
    place.take_linear("a.exr", -3.0);
    let (out, notes) = place.measure(pano(0), &["a.exr"], &[-3.0]).expect("runs");
    assert_near(&out.brackets.log2_gain.samples[..4], [1.585, 4.907, 9.814, 0.0]);
    assert_eq!(notes.iter().map(|note| note.id.as_str()).collect::<Vec<_>>(), ["clipped-regions"]);
    let code = out.brackets.exposures[0].rgb(2, 0)[0];
    assert!((linear_from_srgb(code) / 112.5 - 1.0).abs() < 1e-5, "{code}");
    assert_eq!(out.brackets.taken, Taken::Linear, "its codes are sRGB, whatever the curve of the panorama");
    let error = place.measure(pano(0), &["a.exr", "b.png"], &[-3.0, -6.0]).map(|_| ()).expect_err("differ");
    assert!(error.to_string().contains("`b.png` holds display colours"), "{error}");
}

/// Files that were swapped, or taken elsewhere, are detected by comparison with the panorama. This test fails if
/// `middle`, `apart` or `short` is always 0.
#[test]
fn photographs_that_contradict_the_panorama_are_reported() {
    let place = Folder::new();
    let (_, notes) = place.gains(&["b.png", "a.png"], &[-3.0, -6.0]);
    let found = reported(&notes, "photograph-disagrees");
    assert!(found.len() == 2 && found[0].starts_with("in `b.png`, taken at EV -3, "));
    // The same median, but of another place: light and dark pixels are mixed up.
    let code = |at: usize| u16::from(code8(srgb_from_linear([0.002_f32, 0.04, 0.9][at * 7 % 3])));
    let codes = (0..W * H).flat_map(|at| [code(at); 3]).collect();
    let raster =
        Raster { width: W, height: H, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None };
    place.write("elsewhere.png", &png::write(&raster, false, &[]).expect("packs"));
    let (_, notes) = place.gains(&["elsewhere.png"], &[-3.0]);
    assert_eq!(reported(&notes, "photograph-disagrees").len(), 1, "{notes:?}");
    // All dim pixels are as expected, but a third of the white ones are dim.
    let other = |x: usize| if x.is_multiple_of(4) { 0.3 } else { light(x) };
    let code = |at: usize| u16::from(code8(srgb_from_linear((other(at % W) / 8.0).min(1.0))));
    let codes = (0..W * H).flat_map(|at| [code(at); 3]).collect();
    let raster =
        Raster { width: W, height: H, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None };
    place.write("lamps.png", &png::write(&raster, false, &[]).expect("packs"));
    let (_, notes) = place.gains(&["lamps.png"], &[-3.0]);
    let found = reported(&notes, "photograph-disagrees");
    assert!(found.len() == 1 && found[0].contains("512 of the 1536 pixels that are white"), "{notes:?}");
    // Nothing of the panorama is visible at EV -15.
    place.take("night.png", -15.0, (W, H), None);
    let (_, notes) = place.gains(&["night.png"], &[-15.0]);
    assert_eq!(reported(&notes, "photograph-unchecked").len(), 1, "{notes:?}");
}

/// Files are read and checked even if nothing is clipped. This test fails if photographs are read only if `clipped
/// > 0`.
#[test]
fn files_are_read_where_nothing_is_clipped() {
    let place = Folder::new();
    place.take("small.png", -6.0, (32, 16), None);
    let dim = || {
        let mut pano = pano(0);
        let Picture::Srgb(image) = &mut pano.image else { panic!("display colours") };
        image.samples.iter_mut().for_each(|v| *v = v.min(0.7));
        pano
    };
    let error =
        place.measure(dim(), &["a.png", "small.png"], &[-3.0, -6.0]).map(|_| ()).expect_err("differs");
    assert!(error.to_string().contains("small.png") && error.to_string().contains("32x16"), "{error}");
    let (out, notes) = place.measure(dim(), &["a.png"], &[-3.0]).expect("runs");
    assert_eq!(reported(&notes, "nothing-clipped").len(), 1);
    assert_eq!(reported(&notes, "photograph-disagrees").len(), 1, "{notes:?}");
    assert_eq!(out.brackets.exposures[0].rgb(1, 0), [1.0; 3], "a photograph is what was taken");
}

/// A panorama whose white level is code 246 of 255 loses no light that photographs show: pixels that are brighter
/// in the photographs count as clipped, with either gain, and pixels that are equal do not. This test fails if
/// `add_clipped` is not called, if `BRIGHTER` is 0, or if `measured` is false in `fuse`.
#[test]
fn light_that_photographs_show_above_an_early_white_is_found() {
    let place = Folder::new();
    let early = |white: f32| {
        let plain = pano(0);
        let Picture::Srgb(image) = &plain.image else { panic!("display colours") };
        let samples = image.samples.iter().map(|code| code.min(white)).collect();
        Arc::new(Panorama { image: Image::<Srgb>::from_samples(W, H, 3, samples).into(), ..pano(0) })
    };
    for code in [255, 250, 246] {
        let base = early(code as f32 / 255.0);
        let (out, notes) = place
            .measure((*base).clone(), &["a.png", "b.png"], &[-3.0, -6.0])
            .unwrap_or_else(|e| panic!("{e}"));
        let own = linear_from_srgb(code as f32 / 255.0);
        for gain in [Gain::Direct, Gain::Brackets] {
            let fuse = FuseHdr { gain, ..FuseHdr::default() };
            let input = fuse_hdr::In { base: base.clone(), brackets: out.brackets.clone() };
            let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive: false };
            let (lit, _) = FuseHdr::run(&fuse, input, &Context::detached(scene, ".")).expect("runs");
            for (x, light) in [(0, 3.0), (1, 30.0)] {
                let found = lit.env.image.rgb(x, 5)[0];
                assert!((found / light - 1.0).abs() < 0.02, "{code} {gain:?} {x}: {found}");
            }
            let Picture::Srgb(shown) = &base.image else { panic!("display colours") };
            let dim = shown.rgb(3, 5)[0];
            assert_eq!(lit.env.image.rgb(3, 5)[0], linear_from_srgb(dim));
        }
        let early = notes.iter().any(|note| note.id == "white-early");
        assert_eq!(early, own < CLIPPED, "{code}: {notes:?}");
    }
}
