//! `write-animation`: frames as an animated PNG.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use scene::io::png::{self, Raster};
use scene::io::progress::Progress;
use scene::io::quantise::{AlphaOutput, Lost, Shown, quantise};
use scene::types::{Images, Picture};

engine::params! {
    /// Writes frames as an animated PNG (APNG), which every browser plays; other programs show the first frame.
    ///
    /// Frames are encoded like the pictures of `write-image`, in 8 bits without alpha. If frames have several
    /// views, each view is written to its own file. The same frames give the same bytes.
    pub struct WriteAnimation {
        /// The file: `.png` or `.apng`. Must contain `{view}` if there are several views.
        path: OutputFile, other("\"b.apng\"");
        /// Frames per second.
        fps: f64 = 12.0, range(0.02, 1000.0), unit("1/s"), other("25.0");
        /// Number of times the animation plays; 0 repeats for ever.
        plays: u32 = 0, range(0, 1_000_000), other("1");
        /// True to write the graph that made the frames into the metadata of the file. Its inputs are identified by
        /// content, not by path.
        recipe: bool = true, other("false"), inert("outside a run there is no recipe");
    }
}
engine::inputs! {
    /// Frames to write.
    pub struct In {
        /// The frames in order, all of the same size, such as the output of a `Gather`.
        frames: Vec<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`WriteAnimation`].
    pub struct Out {
        /// One file per view.
        files: Arc<Files>,
    }
}

impl Kind for WriteAnimation {
    const NAME: &'static str = "write-animation";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Recipe];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        match p.path.extension().as_str() {
            "png" | "apng" => Ok(()),
            other => Err(NodeError::new(format!("cannot write an animation as `.{other}`"))
                .at("path")
                .hint("end the path in `.png` or `.apng`; to write single frames, use `WriteImage` with `{frame}` in the path")),
        }
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        let samples = |images: &Images| -> u64 {
            images.0.iter().map(|image| image.picture.samples().len() as u64).sum()
        };
        let all: u64 = inputs.frames.iter().map(|frame| samples(frame)).sum();
        let views = inputs.frames.first().map_or(1, |frame| frame.0.len().max(1)) as u64;
        // Codes of two bytes for all frames of a view, and a file that grows to twice its content; then the files
        // of all views, and a copy while they are stored.
        Cost::of([(all / views, 4), (all - all / views, 2)])
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let Some(first) = inputs.frames.first() else {
            return Err(NodeError::new("there is no frame to write").at("frames"));
        };
        let texts = [("Software", "lightharmony")].into_iter();
        let recipe = cx.recipe().filter(|_| p.recipe);
        let texts: Vec<_> = texts.chain(recipe.map(|text| ("lightharmony:recipe", text))).collect();
        let mut notes = Notes::none();
        let mut files = Vec::with_capacity(first.0.len());
        for (place, view) in first.0.iter().enumerate() {
            let mut rasters: Vec<Raster> = Vec::with_capacity(inputs.frames.len());
            let mut lost = Lost::default();
            let progress = Progress::of(cx, 0.0, 1.0).piece(place, first.0.len());
            for (index, frame) in inputs.frames.iter().enumerate() {
                progress.report(0.1 * index as f32 / inputs.frames.len() as f32)?;
                let picture = picture_of(frame, &view.name, index)?;
                let (raster, missed) = quantise(picture, false, AlphaOutput::Drop, &Shown::default(), cx)?;
                lost.add(missed);
                let size = |raster: &Raster| (raster.width, raster.height, raster.channels);
                if let Some(start) = rasters.first().filter(|start| size(start) != size(&raster)) {
                    let (a, b) = (size(start), size(&raster));
                    let text = format!(
                        "frame 0 has the size {}x{}x{} (width, height, channels), but frame {index} has the size {}x{}x{}",
                        a.0, a.1, a.2, b.0, b.1, b.2
                    );
                    return Err(NodeError::new(text).at("frames").hint("all frames must have the same size"));
                }
                rasters.push(raster);
            }
            lost.report(&view.name, &mut notes);
            let srgb = !matches!(view.picture, Picture::Data(_));
            let packing = progress.part(0.1, 1.0);
            let bytes = png::write_frames(&rasters, delay(p.fps), p.plays, srgb, &texts, packing)?;
            files.push(FileBytes { view: view.name.clone(), bytes });
        }
        Ok((Out { files: Arc::new(Files(files)) }, notes))
    }
}

fn picture_of<'a>(frame: &'a Images, view: &str, index: usize) -> Result<&'a Picture, NodeError> {
    let missing = || NodeError::new(format!("frame {index} has no view `{view}`")).at("frames");
    frame.view(view).ok_or_else(missing)
}

/// Duration of a frame in seconds, as numerator and denominator. It is a whole number of milliseconds, or of tenths
/// of a millisecond for short frames.
fn delay(fps: f64) -> (u16, u16) {
    let unit: u16 = if fps > 100.0 { 10_000 } else { 1000 };
    (((f64::from(unit) / fps).round()).clamp(1.0, f64::from(u16::MAX)) as u16, unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};
    use scene::types::{Image, Srgb};

    fn write(frames: &[Images]) -> Result<Vec<FileBytes>, String> {
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        let p = WriteAnimation { path: OutputFile("a.png".into()), fps: 10.0, plays: 3, recipe: true };
        WriteAnimation::check(&p).map_err(|e| e.to_string())?;
        let frames = frames.iter().cloned().map(Arc::new).collect();
        let (out, _) = WriteAnimation::run(&p, In { frames }, &cx).map_err(|e| e.to_string())?;
        Ok(out.files.0.clone())
    }

    fn frame(width: usize, shade: f32) -> Images {
        Images::single("v", Image::<Srgb>::from_samples(width, 2, 3, vec![shade; width * 6]))
    }

    #[test]
    fn every_frame_comes_back_with_its_time() {
        let shades = [0.0, 0.2, 0.4];
        let frames: Vec<Images> = shades.iter().map(|shade| frame(3, *shade)).collect();
        let files = write(&frames).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(files, write(&frames).unwrap_or_default(), "the same bytes each time");
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&files[0].bytes))
            .read_info()
            .unwrap_or_else(|e| panic!("{e}"));
        let control = reader.info().animation_control.unwrap_or_else(|| panic!("no animation"));
        assert_eq!((control.num_frames, control.num_plays), (3, 3));
        for shade in shades {
            let mut codes = vec![0; 3 * 2 * 3];
            reader.next_frame(&mut codes).unwrap_or_else(|e| panic!("{e}"));
            assert!(codes.iter().all(|code| *code == (shade * 255.0) as u8), "{codes:?}");
            let control = reader.info().frame_control.unwrap_or_else(|| panic!("no frame"));
            assert_eq!((control.delay_num, control.delay_den), (100, 1000));
        }
    }

    #[test]
    fn times_fit_the_format() {
        assert_eq!([delay(24.0), delay(1000.0), delay(0.02)], [(42, 1000), (10, 10_000), (50_000, 1000)]);
    }

    #[test]
    fn frames_of_two_sizes_and_no_frame_are_refused() {
        let why = write(&[frame(3, 0.0), frame(4, 0.0)]).err().unwrap_or_default();
        assert!(
            why.contains(
                "frame 0 has the size 3x2x3 (width, height, channels), but frame 1 has the size 4x2x3"
            ),
            "{why}"
        );
        assert!(write(&[]).is_err());
        let p = WriteAnimation { path: OutputFile("a.gif".into()), fps: 10.0, plays: 0, recipe: true };
        assert!(WriteAnimation::check(&p).is_err());
    }
}
