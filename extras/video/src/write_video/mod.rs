//! `write-video`: frames as a film.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use engine::{Context, Cost, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use scene::io::quantise::{AlphaOutput, DisplaySpace, Lost, Shown, quantise};
use scene::math::color::view::View;
use scene::math::num;
use scene::types::{Images, Picture};

use crate::av1::{Encoding, Segment};
pub use crate::planes::Chroma;
use crate::planes::{Coding, Planes};
use crate::rate::Rate;
use crate::{VideoError, mp4};

engine::params! {
    /// Writes frames as a film: AV1 in MP4, which browsers and current players show.
    ///
    /// Linear light is scaled by `exposure`, changed by the view transform `view`, and encoded for `space`, as in
    /// `write-image`; transparent frames are shown on black. The file states its colour space. If frames have several
    /// views, each view is written to its own file. The same frames give the same bytes, on any number of threads.
    ///
    /// A film consists of segments of `segment` frames. Each begins with a key frame, to which players can jump, and is
    /// encoded by one thread.
    pub struct WriteVideo {
        /// The file: `.mp4`. Must contain `{view}` if there are several views.
        path: OutputFile, other("\"b.mp4\"");
        /// Frames per second. 23.976, 29.97 and 59.94 are written as 24000/1001, 30000/1001 and 60000/1001.
        fps: f64 = 24.0, range(0.1, 1000.0), unit("1/s"), other("25.0");
        /// Quality or rate.
        rate: Rate = Rate::Quality(75.0), other("Mbps(0.5)");
        /// Bits per sample: 8 or 10. Smooth skies show fewer steps with 10.
        bits: u32 = 8, range(8, 10), other("10");
        /// Resolution of chroma.
        chroma: Chroma = Chroma::Half, other("Full");
        /// Effort of the encoder, from 0 (smallest file) to 10 (fastest).
        speed: u32 = 8, range(0, 10), other("10");
        /// Number of frames of a segment.
        segment: u32 = 24, range(1, 1000), other("1");
        /// View transform of linear light.
        view: View = View::Standard, other("AgX"), inert("the fixture has display-encoded frames");
        /// Exposure of linear light before the view transform; 1 doubles the light.
        exposure: f64 = 0.0, range(-64, 64), unit("stops"), other("1.0"), inert("the fixture has display-encoded frames");
        /// Colour space of the film. Rec.709 and Rec.2020 are encoded for a display of gamma 2.4 (BT.1886).
        space: DisplaySpace = DisplaySpace::Srgb, other("DisplayP3");
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
    /// Outputs of [`WriteVideo`].
    pub struct Out {
        /// One file per view.
        files: Arc<Files>,
    }
}

/// Smallest and largest width and height of a film, in pixels.
const SIDES: std::ops::RangeInclusive<usize> = 16..=65_535;
/// Memory of the encoder for each thread in bytes per pixel, for 8 and for 10 bits with half chroma. Measured with
/// segments of 24 frames of 640x360 at `speed` 8: 393 and 567.
const ENCODER_BYTES: [u64; 2] = [420, 620];

impl Kind for WriteVideo {
    const NAME: &'static str = "write-video";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.extension() != "mp4" {
            return Err(NodeError::new(format!("cannot write a film as `.{}`", p.path.extension()))
                .at("path")
                .hint("end the path in `.mp4`; `write-animation` writes `.png`, and `write-image` single frames"));
        }
        if p.bits != 8 && p.bits != 10 {
            return Err(NodeError::new("`bits` must be 8 or 10").at("bits"));
        }
        p.rate.mistake().map_or(Ok(()), |mistake| Err(NodeError::new(mistake).at("rate")))
    }

    fn estimate(p: &Self, inputs: &In) -> Cost {
        let pixels = |images: &Images| -> u64 {
            let size = |picture: &Picture| (picture.size().0 * picture.size().1) as u64;
            images.0.iter().map(|image| size(&image.picture)).sum()
        };
        let all: u64 = inputs.frames.iter().map(|frame| pixels(frame)).sum();
        let frame = inputs.frames.first().map_or(0, |frame| pixels(frame) / frame.0.len().max(1) as u64);
        let segments = inputs.frames.len().div_ceil(p.segment as usize) as u64;
        // Planes of one view, and encoders that work at the same time; the files are small.
        let views = inputs.frames.first().map_or(1, |frame| frame.0.len().max(1)) as u64;
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64;
        let each = ENCODER_BYTES[usize::from(p.bits > 8)] * if p.chroma == Chroma::Full { 2 } else { 1 };
        Cost::of([(all / views, 6), (frame * segments.min(threads), each)])
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let Some(first) = inputs.frames.first() else {
            return Err(NodeError::new("there is no frame to write").at("frames"));
        };
        let (mut notes, mut files) = (Notes::none(), Vec::with_capacity(first.0.len()));
        let all = first.0.len() * inputs.frames.len();
        let done = AtomicUsize::new(0);
        let on_frame = || {
            cx.progress(done.fetch_add(1, Ordering::Relaxed) as f32 / all as f32);
            !cx.cancelled()
        };
        for view in &first.0 {
            let (width, height, _) = view.picture.size();
            if !SIDES.contains(&width) || !SIDES.contains(&height) {
                let text = format!(
                    "a film must have 16 pixels or more in both directions, but frames have {width}x{height}"
                );
                return Err(NodeError::new(text).at("frames"));
            }
            let planes = p.planes(&inputs.frames, &view.name, (width, height), &mut notes, cx)?;
            let encoding = p.encoding((width, height));
            let parts: Vec<&[Planes]> = planes.chunks(p.segment as usize).collect();
            let segments = cx.for_each_tile(parts.len(), |part| encoding.segment(parts[part], &on_frame))?;
            let segments = segments.into_iter().collect::<Result<Vec<Segment>, _>>().map_err(failed)?;
            let squared: f64 = segments.iter().map(|segment| segment.squared_error).sum();
            let samples: Vec<_> = segments.into_iter().flat_map(|segment| segment.samples).collect();
            let bytes = mp4::write(&encoding, &samples).map_err(failed)?;
            cx.count("frames_encoded", samples.len() as u64);
            let mean = squared / (width * height * samples.len()) as f64;
            notes.decision("video", report(&view.name, &encoding, (samples.len(), bytes.len()), mean));
            files.push(FileBytes { view: view.name.clone(), bytes });
        }
        Ok((Out { files: Arc::new(Files(files)) }, notes))
    }
}

impl WriteVideo {
    /// The frames of a view as luma and chroma.
    fn planes(
        &self,
        frames: &[Arc<Images>],
        view: &str,
        size: (usize, usize),
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Vec<Planes>, NodeError> {
        let shown = Shown::on(self.space.space(), self.view, self.exposure);
        let (mut planes, mut lost) = (Vec::with_capacity(frames.len()), Lost::default());
        for (index, frame) in frames.iter().enumerate() {
            cx.check()?;
            let missing = || NodeError::new(format!("frame {index} has no view `{view}`")).at("frames");
            let picture = frame.view(view).ok_or_else(missing)?;
            let (width, height, _) = picture.size();
            if (width, height) != size {
                let text = format!(
                    "frame 0 has {}x{} pixels, but frame {index} has {width}x{height}",
                    size.0, size.1
                );
                return Err(NodeError::new(text).at("frames").hint("all frames must have the same size"));
            }
            let (raster, missed) = quantise(picture, true, AlphaOutput::Drop, &shown, cx)?;
            lost.add(missed);
            planes.push(Planes::of(&raster, self.coding()));
        }
        lost.report(view, notes);
        Ok(planes)
    }

    fn coding(&self) -> Coding {
        Coding { bits: self.bits, chroma: self.chroma, space: self.space }
    }

    fn encoding(&self, size: (usize, usize)) -> Encoding {
        Encoding {
            size,
            coding: self.coding(),
            fps: rational(self.fps),
            rate: self.rate,
            speed: self.speed as u8,
            segment: self.segment as usize,
        }
    }
}

/// Summary of a written film, with the accuracy of luma.
fn report(view: &str, encoding: &Encoding, (frames, bytes): (usize, usize), squared_error: f64) -> String {
    let seconds = frames as f64 * f64::from(encoding.fps.1) / f64::from(encoding.fps.0);
    let peak = f64::from((1_u32 << encoding.coding.bits) - 1);
    let accuracy = if squared_error > 0.0 {
        format!("PSNR of luma {:.1} dB", 10.0 * num::f64::log10(peak * peak / squared_error))
    } else {
        "luma without loss".to_owned()
    };
    let rate = 8e-6 * bytes as f64 / seconds;
    format!(
        "`{view}`: {frames} frames, {seconds:.2} s, {:.1} kB, {rate:.2} Mbit/s, {accuracy}",
        1e-3 * bytes as f64
    )
}

/// A frame rate as numerator and denominator: exact for the rates of television, otherwise in thousandths.
fn rational(fps: f64) -> (u32, u32) {
    let television = (fps * 1.001).round();
    if (television / 1.001 - fps).abs() < 2e-3 && (fps - fps.round()).abs() > 2e-3 && television >= 1.0 {
        return ((1000.0 * television) as u32, 1001);
    }
    if fps == fps.round() { (fps as u32, 1) } else { ((1000.0 * fps).round() as u32, 1000) }
}

fn failed(error: VideoError) -> NodeError {
    match error {
        VideoError::Stopped => NodeError::cancelled(),
        other => NodeError::new(other.to_string()),
    }
}

#[cfg(test)]
mod tests;
