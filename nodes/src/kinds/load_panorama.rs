//! `load-panorama`: an equirectangular panorama from a file.

use std::f64::consts::PI;
use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
    Up,
};
use glam::DVec3;
use render::light::energy::Energy;
use render::light::exposure::ev0_scale;
use render::light::holes;
use render::light::whole_sphere::{self, growth, premultiplied, straight, turn};
use scene::io::picture::floats_of;
use scene::math::color::{code8, linear_from_srgb, luminance, srgb_from_linear};
use scene::math::equirect::pixel_solid_angle;
use scene::math::num;
use scene::types::{Environment, Image, Images, Linear, Panorama, Picture, Srgb};

pub use scene::io::picture::FileEncoding;

engine::params! {
    /// Loads an equirectangular panorama as a camera recorded it: PNG, JPEG, OpenEXR or Radiance HDR.
    ///
    /// It replaces a panorama that `stitch` makes from splats. Row 0 of the file is up, and its centre column looks
    /// forward: along +Y if `up` of the scene is +z, along -Z if it is +y, and along +Z if it is -y.
    ///
    /// PNG and JPEG hold display colours, in which lights are clipped at white. OpenEXR and Radiance hold linear
    /// light, which is not clipped unless `photograph_ev` is set. A partial sphere, as written by phones and
    /// stitching programs, is placed according to its metadata (Photo Sphere XMP, `GPano`); the rest is a hole.
    /// Holes (transparent pixels) are filled from their surroundings.
    pub struct LoadPanorama {
        /// The file: `.jpg`, `.png`, `.exr` or `.hdr`.
        path: InputFile, other("\"b.exr\"");
        /// Encoding of the numbers in the file. Spaces of scenes are converted to linear Rec.709, those of displays to
        /// sRGB.
        encoding: FileEncoding = FileEncoding::Auto, other("AcesCg");
        /// Layer of an OpenEXR file, such as `ViewLayer.Combined`, or a channel. The default is the unnamed layer.
        layer: String = String::new(), other("\"R\"");
        /// Exposes linear light as an 8-bit camera would, this many stops above EV 0. EV 0 is the exposure at which
        /// the median of the positive samples is 0.5 after it is raised to the power 1 / 2.4. If more than 15 % of
        /// the sphere would then be above white, EV 0 is the brightest exposure at which at most 15 % is. `None`
        /// keeps the light unclipped.
        photograph_ev: Option<f64> = None, range(-24, 24), unit("EV"), other("1.0");
        /// Rotation about the up axis, counter-clockwise seen from above. Linear light is interpolated between
        /// pixels; display colours rotate by the nearest whole number of columns, because interpolation would dim a
        /// clipped light of one pixel.
        rotation_deg: f64 = 0.0, range(-36000, 36000), unit("degrees"), other("90.0");
        /// Point where the panorama was taken, in world coordinates. Without it, its light is treated as infinitely
        /// far away.
        origin: Option<[f64; 3]> = None, other("(0.5, 0.0, 1.0)"), unit("world units");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadPanorama`].
    pub struct Out {
        /// The panorama, for `predict-exposure` and `fuse-hdr`.
        pano: Arc<Panorama>,
        /// Colours of the panorama, for `write-image`.
        image: Arc<Images>,
        /// Light of the panorama at the same exposure, without the clipping by `photograph_ev`. It can serve as the
        /// reference for `score-env`.
        env: Arc<Environment>,
    }
}

/// Alpha below which a pixel is a hole: half an 8-bit code. Other pixels keep their colour.
const HOLE_ALPHA: f32 = 0.5 / 255.0;

impl Kind for LoadPanorama {
    const NAME: &'static str = "load-panorama";
    const VERSION: u32 = 12;
    const READS: &'static [ContextField] = &[ContextField::Up];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(vec![root.file(&p.path)])
    }

    fn estimate_files(p: &Self, files: &[FileHead<'_>]) -> Cost {
        // Premultiplied colours before and after the rotation, rows while they rotate or the pyramid levels that
        // holes are filled from, the resulting layers, and for a photograph its luminance.
        let copies = 4 + 3 * u64::from(p.rotation_deg != 0.0) + u64::from(p.photograph_ev.is_some());
        let of = |file: &FileHead<'_>| {
            let [reading, floats] = floats_of(file);
            let whole = (floats as f64 * growth(file) * 4.0 / 3.0) as u64;
            reading.max(whole.saturating_mul(copies)).saturating_add(file.bytes)
        };
        Cost { bytes: files.iter().map(of).max().unwrap_or(0) }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let picture = whole_sphere::open(&p.path, p.encoding, &p.layer, &mut notes, cx)?;
        let (width, height, _) = picture.size();
        let linear = matches!(picture, Picture::Linear(_));
        let pixels = premultiplied(&picture, &mut notes).map_err(|e| NodeError::from(e).at("path"))?;
        drop(picture);
        let turned = if linear { p.rotation_deg } else { whole_columns(p.rotation_deg, width, &mut notes) };
        // Filled before the rotation, so that the rotation changes positions only.
        let filled = fill_holes(&pixels, width, linear, &mut notes, cx)?;
        let (mut samples, alpha) = straight(turn(&pixels, width, turned, cx)?);
        drop(pixels);
        if let Some(filled) = filled {
            let filled = turn(&filled, width, turned, cx)?;
            let pixels = samples.as_chunks_mut::<3>().0.iter_mut().zip(&alpha).zip(filled);
            for ((rgb, _), [r, g, b, _]) in pixels.filter(|((_, alpha), _)| **alpha < HOLE_ALPHA) {
                *rgb = [r, g, b];
            }
        }
        let (image, light) = match p.photograph_ev {
            Some(_) if !linear => {
                let error = NodeError::new(
                    "`photograph_ev` needs linear light, but the display colours of the file already have an exposure",
                );
                return Err(error
                    .at("photograph_ev")
                    .hint("remove `photograph_ev`, or load an OpenEXR or Radiance file"));
            }
            Some(ev) => photograph(Image::from_samples(width, height, 3, samples), ev, cx.up(), &mut notes),
            None if linear => {
                let light = Image::<Linear>::from_samples(width, height, 3, samples);
                (Picture::from(light.clone()), light)
            }
            None => {
                let light = samples.iter().map(|v| linear_from_srgb(*v)).collect();
                let codes = Image::<Srgb>::from_samples(width, height, 3, samples);
                (codes.into(), Image::from_samples(width, height, 3, light))
            }
        };
        let origin = p.origin.map(DVec3::from_array);
        let out = Out {
            image: Arc::new(Images::single("pano", image.clone())),
            pano: Arc::new(Panorama {
                image,
                alpha: Image::from_samples(width, height, 1, alpha),
                up: cx.up(),
                origin,
                turned_deg: turned,
            }),
            env: Arc::new(Environment { image: light.into(), up: cx.up(), origin }),
        };
        Ok((out, notes))
    }
}

/// Returns `degrees` rounded to a rotation by a whole number of columns, in degrees.
fn whole_columns(degrees: f64, width: usize, notes: &mut Notes) -> f64 {
    let column = 360.0 / width as f64;
    let whole = (degrees / column).round() * column;
    if (whole - degrees).abs() > 1e-6 * column {
        let text = format!(
            "display colours are rotated by whole columns: by {whole:.4} degrees instead of {degrees}"
        );
        notes.decision("turned-by-columns", text);
    }
    whole
}

/// Fills transparent pixels from their surroundings, as `stitch` does, and returns all pixels. `None` if no pixel
/// is transparent, or if all are.
fn fill_holes(
    pixels: &[[f32; 4]],
    width: usize,
    linear: bool,
    notes: &mut Notes,
    cx: &Context,
) -> Result<Option<Vec<[f32; 4]>>, NodeError> {
    let open: Vec<usize> = (0..pixels.len()).filter(|&at| pixels[at][3] < HOLE_ALPHA).collect();
    if open.is_empty() {
        return Ok(None);
    }
    let height = pixels.len() / width;
    if open.len() == pixels.len() {
        notes.warning("no-light", "all pixels of the panorama are transparent, so the panorama is black");
        return Ok(None);
    }
    let share = open.iter().map(|at| pixel_solid_angle(width, height, at / width)).sum::<f64>() / (4.0 * PI);
    notes.decision(
        "holes",
        format!("{:.2} % of the sphere is transparent and was filled from its surroundings", 100.0 * share),
    );
    // Pixels of additive light, as renderers write glows. Their content is lost here, which is reported.
    let lost = open.iter().filter(|at| pixels[**at][..3].iter().any(|v| *v > 0.0)).count();
    if lost > 0 {
        let text = format!(
            "the light of transparent pixels is ignored, since they are filled as holes (count: {lost}); to keep this light, save the file without alpha"
        );
        notes.warning("light-in-holes", text);
    }
    // Filling works in linear light.
    let light = |[r, g, b, a]: &[f32; 4]| {
        let [r, g, b] = [r, g, b].map(|v| if linear || *a <= 0.0 { *v } else { linear_from_srgb(v / a) * a });
        [r, g, b, *a]
    };
    let filled = holes::fill(&pixels.iter().map(light).collect::<Vec<_>>(), width, HOLE_ALPHA, cx)?;
    let code = |rgb: [f32; 3]| {
        let [r, g, b] = rgb.map(|v| if linear { v } else { srgb_from_linear(v) });
        [r, g, b, 1.0]
    };
    Ok(Some(filled.into_iter().map(code).collect()))
}

/// Returns the photograph that a camera would take of the light, and the light itself at the same exposure.
fn photograph(mut light: Image<Linear>, ev: f64, up: Up, notes: &mut Notes) -> (Picture, Image<Linear>) {
    let ev0 = ev0_scale(&light).unwrap_or_else(|| {
        notes.warning("no-light", "the panorama is black; its exposure cannot be measured");
        1.0
    });
    let scale = ev0 * num::f64::exp2(ev);
    for v in &mut light.samples {
        *v = (f64::from(*v) * scale).min(f64::from(f32::MAX)) as f32;
    }
    let energy = |most: f32| {
        let pixels = light.samples.as_chunks::<3>().0.iter();
        let luminance: Vec<f64> = pixels.map(|rgb| luminance(rgb.map(|v| v.min(most))).into()).collect();
        Energy::of(up, light.width, &luminance)
    };
    let (all, kept) = (energy(f32::MAX), energy(1.0));
    let percent = |part: f64, of: f64| if of > 0.0 { 100.0 * part / of } else { 100.0 };
    let text = format!(
        "light was scaled by {scale:.3e} and clipped at white, which keeps {:.1} % of its power and {:.1} % of the irradiance on the ground",
        percent(kept.power, all.power),
        percent(kept.ground, all.ground)
    );
    notes.decision("exposure", text);
    let codes =
        light.samples.iter().map(|v| f32::from(code8(srgb_from_linear(v.min(1.0)))) / 255.0).collect();
    (Image::<Srgb>::from_samples(light.width, light.height, 3, codes).into(), light)
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Scene;
    use scene::io::png::{self, Raster};

    fn load(bytes: &[u8], photograph_ev: Option<f64>) -> Result<(Out, Notes), NodeError> {
        turned(bytes, photograph_ev, 0.0)
    }

    fn turned(
        bytes: &[u8],
        photograph_ev: Option<f64>,
        rotation_deg: f64,
    ) -> Result<(Out, Notes), NodeError> {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("a"), bytes).expect("writes");
        let cx = Context::detached(
            Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false },
            folder.path(),
        );
        let p = LoadPanorama {
            path: InputFile("a".into()),
            encoding: FileEncoding::Auto,
            layer: String::new(),
            photograph_ev,
            rotation_deg,
            origin: Some([1.0, 2.0, 3.0]),
        };
        LoadPanorama::run(&p, In {}, &cx)
    }

    // A clipped light of one pixel stays one pixel at any rotation; linear light rotates by fractions of a pixel
    // and keeps its sum. This test fails if `whole_columns` is not called.
    #[test]
    fn a_turned_photograph_keeps_its_lights() {
        let mut codes = vec![40_u16; 16 * 8 * 3];
        codes[3 * 40..3 * 41].fill(255);
        let raster = Raster {
            width: 16,
            height: 8,
            channels: 3,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        let bytes = png::write(&raster, false, &[]).expect("writes");
        let light = |out: &Out| out.env.image.samples.iter().map(|v| f64::from(*v)).sum::<f64>();
        let (still, _) = turned(&bytes, None, 0.0).expect("loads");
        for (degrees, reported) in [(0.3, true), (29.0, true), (45.0, false), (-67.5, false), (719.9, true)] {
            let (out, notes) = turned(&bytes, None, degrees).expect("loads");
            let Picture::Srgb(image) = &out.pano.image else { panic!("display colours") };
            assert_eq!(image.samples.iter().filter(|v| **v == 1.0).count(), 3, "{degrees}");
            assert_eq!(light(&out), light(&still));
            assert_eq!(notes.iter().any(|note| note.id == "turned-by-columns"), reported, "{degrees}");
        }
        let mut rgb = vec![0.2_f32; 8 * 4 * 3];
        rgb[3 * 9..3 * 10].fill(900.0);
        let (out, notes) = turned(&hdr(rgb), None, 10.0).expect("loads");
        assert!(notes.iter().all(|note| note.id != "turned-by-columns"));
        let most = out.env.image.samples.iter().copied().fold(0.0, f32::max);
        assert!(most < 800.0 && (light(&out) / (31.0 * 0.6 + 2700.0) - 1.0).abs() < 1e-6, "{most}");
    }

    fn hdr(rgb: Vec<f32>) -> Vec<u8> {
        let mut planes: Vec<Vec<f32>> = vec![Vec::new(); 3];
        rgb.iter().enumerate().for_each(|(i, v)| planes[i % 3].push(*v));
        let channel = |(name, samples): (&str, Vec<f32>)| {
            (scene::io::exr::Channel { name: name.into(), samples }, scene::io::exr::Depth::Float)
        };
        let channels = ["R", "G", "B"].into_iter().zip(planes).map(channel).collect();
        scene::io::exr::write(8, 4, channels, "linear", None).expect("writes").0
    }

    #[test]
    fn a_photograph_of_light_clips_and_keeps_the_truth_beside_it() {
        let mut rgb = vec![0.2_f32; 8 * 4 * 3];
        rgb[3 * 9..3 * 10].fill(900.0);
        let (out, _) = load(&hdr(rgb.clone()), Some(1.0)).expect("loads");
        // EV 0 puts the median, raised to 1 / 2.4, at one half.
        let scale = 2.0 * num::pow(0.5, 2.4) / f64::from(0.2_f32);
        let Picture::Srgb(codes) = &out.pano.image else { panic!("display colours") };
        assert_eq!(codes.rgb(1, 1), [1.0; 3]);
        let seen = f64::from(linear_from_srgb(codes.rgb(0, 0)[0]));
        assert!((seen - 0.2 * scale).abs() < 0.005, "{seen}");
        assert!((f64::from(out.env.image.rgb(1, 1)[0]) / (900.0 * scale) - 1.0).abs() < 1e-6);
        assert_eq!(out.pano.origin, Some(DVec3::new(1.0, 2.0, 3.0)));
        // Without `photograph_ev` nothing clips.
        let (out, _) = load(&hdr(rgb), None).expect("loads");
        assert!(matches!(&out.pano.image, Picture::Linear(image) if image.rgb(1, 1) == [900.0; 3]));
    }

    /// If the panorama is rotated by a fraction of a pixel, a hole gets a soft edge that is not dark. This test
    /// fails if `straight` is called before `turn`.
    #[test]
    fn a_turn_mixes_what_is_seen() {
        let (seen, hole) = ([0.8, 0.4, 0.2, 1.0], [0.0; 4]);
        let pixels: Vec<[f32; 4]> = (0..32).map(|i| if i == 11 { hole } else { seen }).collect();
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, "");
        let (colours, alpha) = straight(turn(&pixels, 8, 15.0, &cx).expect("turns"));
        let alphas: Vec<f32> = alpha.into_iter().filter(|a| *a < 1.0).collect();
        assert!(alphas.len() == 2 && (alphas[0] + alphas[1] - 1.0).abs() < 1e-6, "{alphas:?}");
        for pixel in colours.chunks_exact(3) {
            assert!(pixel.iter().zip(seen).all(|(v, c)| (v - c).abs() < 1e-6), "{pixel:?}");
        }
    }

    // This test fails if `fill_holes` is not called.
    #[test]
    fn holes_of_a_file_are_filled_and_reported() {
        let codes = [[90, 128, 0, 255], [0, 0, 0, 0], [90, 128, 0, 255], [90, 128, 0, 60]].concat().repeat(2);
        let raster = Raster {
            width: 4,
            height: 2,
            channels: 4,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        let (out, notes) = load(&png::write(&raster, false, &[]).expect("writes"), None).expect("loads");
        let Picture::Srgb(image) = &out.pano.image else { panic!("display colours") };
        for x in 0..4 {
            let found = image.rgb(x, 1).map(|v| v * 255.0);
            assert!(found.iter().zip([90.0, 128.0, 0.0]).all(|(a, b)| (a - b).abs() < 0.1), "{x}: {found:?}");
        }
        assert_eq!(out.pano.alpha.samples[1], 0.0, "alpha still marks it");
        let reported = notes.iter().find(|note| note.id == "holes").map(|note| note.text.as_str());
        assert!(reported.is_some_and(|text| text.starts_with("25.00 % of the sphere")), "{reported:?}");
    }

    // If additive light with alpha 0 is treated as a hole, a warning is given. This test fails if `lost > 0` is
    // replaced by `false`.
    #[test]
    fn light_of_transparent_pixels_is_reported() {
        let file = |glow: f32| {
            let plane = |name: &str, other: f32, at: f32| {
                let samples = (0..8).map(|i| if i == 3 { at } else { other }).collect();
                (scene::io::exr::Channel { name: name.into(), samples }, scene::io::exr::Depth::Float)
            };
            let planes = vec![
                plane("R", 0.2, glow),
                plane("G", 0.2, glow),
                plane("B", 0.2, glow),
                plane("A", 1.0, 0.0),
            ];
            scene::io::exr::write(4, 2, planes, "linear", None).expect("writes").0
        };
        let reported = |glow: f32| {
            let (_, notes) = load(&file(glow), None).expect("loads");
            notes.iter().find(|note| note.id == "light-in-holes").map(|note| note.text.clone())
        };
        assert_eq!(reported(0.0), None);
        assert!(reported(50.0).is_some_and(|text| text.contains("(count: 1)")));
    }

    /// A photograph of the front half of the sphere, as written by phones, is placed according to its metadata, and
    /// the rest is a hole. This test fails if `laid` is not called.
    #[test]
    fn a_part_of_a_sphere_lies_where_its_metadata_says() {
        let codes = (0..8 * 4).flat_map(|i| [if i == 9 { 250 } else { 60 }; 3]).collect();
        let raster = Raster {
            width: 8,
            height: 4,
            channels: 3,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        let text = "GPano:FullPanoWidthPixels='1600' GPano:FullPanoHeightPixels='800' GPano:CroppedAreaImageWidthPixels='800' \
            GPano:CroppedAreaImageHeightPixels='400' GPano:CroppedAreaLeftPixels='400' GPano:CroppedAreaTopPixels='200'";
        let bytes = png::write(&raster, false, &[("XML:com.adobe.xmp", text)]).expect("writes");
        let (out, notes) = load(&bytes, None).expect("loads");
        let Picture::Srgb(image) = &out.pano.image else { panic!("display colours") };
        assert_eq!((image.width, image.height), (16, 8));
        assert!(image.rgb(5, 3)[0] > 0.9 && image.samples.iter().filter(|v| **v > 0.9).count() == 3);
        let seen = |x: usize, y: usize| (4..12).contains(&x) && (2..6).contains(&y);
        let alpha = |x: usize, y: usize| if seen(x, y) { 1.0 } else { 0.0 };
        assert!((0..128).all(|at| out.pano.alpha.samples[at] == alpha(at % 16, at / 16)));
        let reported = |id: &str| notes.iter().any(|note| note.id == id);
        assert!(reported("part-of-a-sphere") && reported("holes") && !reported("not-two-to-one"));
    }

    #[test]
    fn a_picture_is_taken_without_its_alpha_and_is_no_light() {
        let codes = [[255, 128, 0, 255], [200, 100, 50, 51]].concat().repeat(4);
        let raster = Raster {
            width: 4,
            height: 2,
            channels: 4,
            largest: 255,
            codes,
            ignored: Vec::new(),
            colour: None,
        };
        let bytes = png::write(&raster, false, &[]).expect("writes");
        let (out, _) = load(&bytes, None).expect("loads");
        let Picture::Srgb(image) = &out.pano.image else { panic!("display colours") };
        assert!(image.rgb(1, 0).iter().zip([200.0, 100.0, 50.0]).all(|(v, c)| (v * 255.0 - c).abs() < 1e-3));
        assert_eq!(out.pano.alpha.samples[..2], [1.0, 0.2]);
        let error = load(&bytes, Some(0.0)).map(|_| ()).expect_err("already has an exposure");
        assert!(error.to_string().contains("already have an exposure"), "{error}");
    }
}
