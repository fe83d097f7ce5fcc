//! `write-image`: pictures as PNG or JPEG, for display.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileBytes, Files, InputFile, Kind, NodeError, Notes, OutputFile, SourceFile,
    SourceRoot, ViewCount,
};
use scene::io::cube::CubeLut;
use scene::io::progress::Progress;
use scene::io::quantise::{Shown, quantise};
use scene::io::recipe::KEYWORD;
use scene::io::{jpeg, png};
use scene::math::color::space::Space;
use scene::types::{Images, NamedImage, Picture};

pub use scene::io::quantise::{AlphaOutput, DisplaySpace};
pub use scene::math::color::view::View;

engine::choices! {
    /// Compression effort of a PNG.
    pub enum Effort {
        /// Makes small files.
        Balanced,
        /// Takes a tenth of the time and makes larger files; used by `watch` for previews.
        Fast,
    }
}
engine::params! {
    /// Writes pictures as PNG or JPEG, depending on the extension of the path.
    ///
    /// Linear light is scaled by `exposure`, changed by the view transform `view`, and encoded for `space`.
    /// Display-encoded pictures, such as renders of splats, are converted to `space` and are otherwise unchanged.
    /// Values outside 0 to 1 are clamped and counted. Data (masks, ratios) is written unchanged. There is no
    /// dithering. The same picture gives the same bytes.
    pub struct WriteImage {
        /// The file: `.png`, `.jpg` or `.jpeg`. Must contain `{view}` if there are several views.
        path: OutputFile, other("\"b.jpg\"");
        /// Bits per sample: 8, or 16 for PNG.
        bits: u32 = 8, range(8, 16), other("16");
        /// Treatment of the alpha channel.
        alpha: AlphaOutput = AlphaOutput::Drop, other("Straight");
        /// View transform of linear light.
        view: View = View::Standard, other("AgX");
        /// Exposure of linear light before the view transform; 1 doubles the light.
        exposure: f64 = 0.0, range(-64, 64), unit("stops"), other("1.0");
        /// Lookup table of colours (`.cube`) for linear light, in place of `view`. Its inputs are encoded in
        /// `lut_space`, and its outputs are codes of `space`.
        lut: Option<InputFile> = None, other("Some(\"look.cube\")");
        /// Colour space of the inputs of `lut`.
        lut_space: Space = Space::Srgb, other("AcesCct");
        /// Colour space of the file. A PNG states it; JPEG is always sRGB.
        space: DisplaySpace = DisplaySpace::Srgb, other("DisplayP3");
        /// JPEG quality.
        quality: u32 = 92, range(1, 100), other("50"), inert("only JPEG has a quality");
        /// Compression effort of a PNG. It does not affect the pixels.
        effort: Effort = Effort::Balanced, other("Fast");
        /// True to write the graph that made the picture into its metadata. The inputs of the graph are identified
        /// by content, not by path.
        recipe: bool = true, other("false"), inert("outside a run there is no recipe");
    }
}
engine::inputs! {
    /// Pictures to write.
    pub struct In {
        /// One picture per view.
        image: Arc<Images>,
    }
}
engine::outputs! {
    /// Outputs of [`WriteImage`].
    pub struct Out {
        /// One file per view.
        files: Arc<Files>,
    }
}

impl Kind for WriteImage {
    const NAME: &'static str = "write-image";
    const VERSION: u32 = 3;
    const READS: &'static [ContextField] = &[ContextField::Recipe];
    const PREVIEW: engine::Preview =
        engine::Preview { rough: &[("effort", "Fast")], ..engine::Preview::NONE };
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        let jpeg = match p.path.extension().as_str() {
            "png" => false,
            "jpg" | "jpeg" => true,
            other => {
                return Err(NodeError::new(format!("cannot write pictures as `.{other}`"))
                    .at("path")
                    .hint("end the path in `.png` or `.jpg`; for float data use WriteExr"));
            }
        };
        if p.bits != 8 && p.bits != 16 {
            return Err(NodeError::new("`bits` must be 8 or 16").at("bits"));
        }
        if jpeg && p.bits == 16 {
            return Err(NodeError::new("`bits` is 16, but a JPEG has 8 bits per sample")
                .at("bits")
                .hint("end the path in `.png`"));
        }
        if p.lut.is_some() && p.view != View::Standard {
            return Err(NodeError::new("`view` and `lut` cannot both be given")
                .at("lut")
                .hint("a lookup table contains the view transform; remove `view`"));
        }
        if jpeg && p.space != DisplaySpace::Srgb {
            return Err(NodeError::new("a JPEG cannot state a colour space other than sRGB")
                .at("space")
                .hint("end the path in `.png`"));
        }
        if jpeg && p.alpha == AlphaOutput::Straight {
            return Err(NodeError::new("`alpha` is `Straight`, but a JPEG cannot store alpha")
                .at("alpha")
                .hint("end the path in `.png`"));
        }
        Ok(())
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(p.lut.iter().map(|file| root.file(file)).collect())
    }

    fn views(_: &Self, _: &SourceRoot) -> ViewCount {
        ViewCount::As(&["image"])
    }

    fn estimate(p: &Self, inputs: &In) -> Cost {
        let samples = |image: &NamedImage| image.picture.samples().len() as u64;
        let pictures = || inputs.image.0.iter().map(samples);
        let (all, one) = (pictures().sum::<u64>(), pictures().max().unwrap_or(0));
        let packed = if p.bits == 16 { 2 } else { 1 };
        // For one view, codes of two bytes in rows and in one piece, then these and the packed bytes (at most as
        // long as the picture) as data and as a file. The files of all views are kept, and copied while they are
        // stored.
        let (writing, storing) =
            (Cost::of([(one, 2 + 2 * packed), (all - one, packed)]), Cost::of([(all, 2 * packed)]));
        Cost { bytes: writing.bytes.max(storing.bytes) }
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let mut files = Vec::new();
        let views = &inputs.image.0;
        if views.is_empty() {
            return Err(NodeError::new("there is no view to write").at("image"));
        }
        let recipe = cx.recipe().filter(|_| p.recipe);
        let space = p.space.space();
        let shown = match &p.lut {
            None => Shown::on(space, p.view, p.exposure),
            Some(file) => {
                let bytes = cx.read(file).map_err(|e| e.at("lut"))?;
                let lut = CubeLut::read(&file.0, &bytes).map_err(|e| NodeError::from(e).at("lut"))?;
                Shown::by(lut, p.lut_space, p.exposure, space)
            }
        };
        let graded = p.view != View::Standard || p.lut.is_some() || p.exposure != 0.0;
        if graded && views.iter().any(|view| matches!(view.picture, Picture::Srgb(_))) {
            notes.warning(
                "view-ignored",
                "the picture is display-encoded already, so `view`, `lut` and `exposure` do not change it; wire \
                 linear light instead",
            );
        }
        for (index, view) in views.iter().enumerate() {
            let progress = Progress::of(cx, 0.0, 1.0).piece(index, views.len());
            progress.report(0.0)?;
            let (raster, lost) = quantise(&view.picture, p.bits == 16, p.alpha, &shown, cx)?;
            lost.report(&view.name, &mut notes);
            let space = (!matches!(view.picture, Picture::Data(_))).then_some(space);
            let bytes = if p.path.extension() == "png" {
                let software = ("Software", "lightharmony");
                let texts: Vec<_> = std::iter::once(software).chain(recipe.map(|r| (KEYWORD, r))).collect();
                let packing = match p.effort {
                    Effort::Balanced => png::Packing::Small,
                    Effort::Fast => png::Packing::Fast,
                };
                png::write_for(&raster, packing, space, &texts, progress)?
            } else {
                jpeg::write_for(&raster, p.quality as u8, recipe, progress)?
            };
            files.push(FileBytes { view: view.name.clone(), bytes });
        }
        Ok((Out { files: Arc::new(Files(files)) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::math::color::linear_from_srgb;
    use scene::types::{Data, Image, Linear, Srgb};
    use testing::context as cx;

    fn node(path: &str) -> WriteImage {
        WriteImage {
            path: OutputFile(path.into()),
            bits: 8,
            alpha: AlphaOutput::Drop,
            view: View::Standard,
            exposure: 0.0,
            lut: None,
            lut_space: Space::Srgb,
            space: DisplaySpace::Srgb,
            quality: 92,
            effort: Effort::Balanced,
            recipe: true,
        }
    }
    fn write(p: &WriteImage, picture: impl Into<Picture>) -> (Vec<u8>, Notes) {
        WriteImage::check(p).unwrap_or_else(|e| panic!("{e}"));
        let image = Arc::new(Images::single("v", picture));
        let (out, notes) = WriteImage::run(p, In { image }, &cx()).unwrap_or_else(|e| panic!("{e}"));
        (out.files.0[0].bytes.clone(), notes)
    }

    // Every code survives a round trip, as a display value and through linear light, in 8 and 16 bits.
    #[test]
    fn every_code_survives() {
        for (bits, largest) in [(8, 255_u32), (16, 65_535)] {
            let p = WriteImage { bits, ..node("a.png") };
            let shown: Vec<f32> = (0..=largest).map(|c| c as f32 / largest as f32).collect();
            let linear: Vec<f32> = shown.iter().map(|v| linear_from_srgb(*v)).collect();
            let n = shown.len();
            for picture in [
                Picture::from(Image::<Srgb>::from_samples(n, 1, 1, shown.clone())),
                Image::<Linear>::from_samples(n, 1, 1, linear).into(),
                Image::<Data>::from_samples(n, 1, 1, shown).into(),
            ] {
                let back = png::read("a.png", &write(&p, picture).0).unwrap_or_else(|e| panic!("{e}"));
                assert!(back.codes.iter().enumerate().all(|(i, c)| i == usize::from(*c)));
                assert_eq!(u32::from(back.largest), largest);
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_cut_off_and_counted() {
        let samples = vec![f32::NAN, -0.5, 1.5, f32::INFINITY, 0.5, 1.0];
        let (bytes, notes) = write(&node("a.png"), Image::<Data>::from_samples(2, 1, 3, samples));
        let back = png::read("a.png", &bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(back.codes, [0, 0, 255, 255, 128, 255]);
        assert!(notes.is_degraded());
        assert!(notes.iter().any(|n| n.id == "clipped-above" && n.text.starts_with("2 ")));
        assert!(notes.iter().any(|n| n.id == "clipped-below" && n.text.starts_with("1 ")));
    }

    /// Less compression effort changes the bytes and keeps the pixels.
    #[test]
    fn less_effort_gives_other_bytes_and_the_same_pixels() {
        let samples = (0..64 * 64 * 3).map(|i| ((i * 37) % 101) as f32 / 100.0).collect();
        let picture = Image::<Srgb>::from_samples(64, 64, 3, samples);
        let fast = WriteImage { effort: Effort::Fast, ..node("a.png") };
        let [slow, fast] = [node("a.png"), fast].map(|p| write(&p, picture.clone()).0);
        assert_ne!(slow, fast);
        let read = |bytes: &[u8]| png::read("a.png", bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(read(&slow), read(&fast));
    }

    // A file with straight alpha, composited over black, equals the picture on black.
    #[test]
    fn alpha_is_dropped_or_made_straight() {
        let picture = Image::<Srgb>::from_samples(2, 1, 4, vec![0.25, 0.1, 0.0, 0.5, 0.2, 0.0, 0.0, 0.0]);
        let dropped =
            png::read("a.png", &write(&node("a.png"), picture.clone()).0).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((dropped.channels, &dropped.codes[..3]), (3, &[64, 26, 0][..]));
        let p = WriteImage { alpha: AlphaOutput::Straight, ..node("a.png") };
        let straight = png::read("a.png", &write(&p, picture).0).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(straight.codes, [128, 51, 0, 128, 51, 0, 0, 0]);
    }

    /// A file of another display space states it, and is read back as the colours that were written.
    #[test]
    fn display_spaces_are_stated_and_read_back() {
        let codes = [0.9, 0.2, 0.1, 0.3, 0.6, 0.4];
        let picture = Image::<Srgb>::from_samples(2, 1, 3, codes.to_vec());
        let plain = write(&node("a.png"), picture.clone()).0;
        for space in [DisplaySpace::DisplayP3, DisplaySpace::Rec709, DisplaySpace::Rec2020] {
            let (bytes, notes) = write(&WriteImage { bits: 16, space, ..node("a.png") }, picture.clone());
            assert_eq!(notes.iter().count(), 0);
            assert_ne!(bytes, plain);
            let back = scene::io::picture::of_bytes("a.png", &bytes).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(back.encoding(), "srgb");
            for (a, b) in back.samples().iter().zip(codes) {
                assert!((a - b).abs() < 1e-4, "{space:?}: {:?}", back.samples());
            }
        }
    }

    /// A view transform changes linear light, and leaves display colours alone with a warning.
    #[test]
    fn views_and_exposure_are_for_linear_light() {
        let p = WriteImage { view: View::AgX, exposure: 1.0, ..node("a.png") };
        let light = Image::<Linear>::from_samples(1, 1, 3, vec![8.0; 3]);
        let codes = |bytes: &[u8]| png::read("a.png", bytes).unwrap_or_else(|e| panic!("{e}")).codes;
        let (bytes, notes) = write(&p, light.clone());
        // Blender 4.5 shows light of 16 as 0.9985 with AgX.
        assert_eq!((codes(&bytes), notes.iter().count()), (vec![255; 3], 0));
        let (bytes, _) = write(&WriteImage { exposure: -3.0, ..p.clone() }, light);
        // And light of 1 as 0.771.
        assert_eq!(codes(&bytes), [197; 3]);
        let (bytes, notes) = write(&p, Image::<Srgb>::from_samples(1, 1, 3, vec![0.5; 3]));
        assert_eq!(codes(&bytes), [128; 3]);
        assert!(notes.iter().any(|note| note.id == "view-ignored"));
    }

    /// A lookup table replaces the view transform: light is encoded in `lut_space`, and entries are codes.
    #[test]
    fn a_lookup_table_is_applied_to_encoded_light() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let inverted = CubeLut::write("", 2, |code| code.map(|v| 1.0 - v));
        std::fs::write(folder.path().join("look.cube"), inverted).unwrap_or_else(|e| panic!("{e}"));
        let p = WriteImage {
            lut: Some(InputFile("look.cube".into())),
            lut_space: Space::LinearRec709,
            exposure: 1.0,
            ..node("a.png")
        };
        assert!(WriteImage::check(&WriteImage { view: View::AgX, ..p.clone() }).is_err());
        let scene = engine::Scene { up: engine::Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        let cx = Context::detached(scene, folder.path());
        let light = Image::<Linear>::from_samples(1, 1, 3, vec![0.1, 0.2, 0.4]);
        let image = Arc::new(Images::single("v", light));
        let (out, _) = WriteImage::run(&p, In { image }, &cx).unwrap_or_else(|e| panic!("{e}"));
        let back = png::read("a.png", &out.files.0[0].bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(back.codes, [204, 153, 51]);
    }

    #[test]
    fn jpeg_by_ending_and_refusals() {
        let picture = Image::<Srgb>::from_samples(16, 16, 3, vec![0.5; 768]);
        let (bytes, _) = write(&node("a.JPG"), picture.clone());
        let back = jpeg::read("a.jpg", &bytes).unwrap_or_else(|e| panic!("{e}"));
        assert!(back.codes.iter().all(|c| c.abs_diff(128) <= 2));
        let low = write(&WriteImage { quality: 10, ..node("a.jpg") }, picture).0;
        assert_ne!(low, bytes);
        for p in [
            node("a.gif"),
            WriteImage { bits: 12, ..node("a.png") },
            WriteImage { bits: 16, ..node("a.jpg") },
            WriteImage { space: DisplaySpace::DisplayP3, ..node("a.jpg") },
        ] {
            assert!(WriteImage::check(&p).is_err());
        }
    }
}
