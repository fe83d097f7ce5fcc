//! Progress and cancellation for codecs: maps the progress of a codec to a range of the node's progress.
//!
//! Codecs of other crates cannot be cancelled. They read from [`TrackedReader`] and write to [`TrackedWriter`],
//! which check every few thousand bytes and fail once the run is cancelled; the engine then treats the node as
//! cancelled, whatever error the codec returns.

use std::io::{self, BufRead, Read, Seek, SeekFrom, Write};

use engine::Context;

use crate::error::Error;

/// Number of compressed bytes between two checks. Deflate expands them to at most 4 MB, which takes about 20 ms.
const STEP: usize = 4096;

/// Number of samples converted between two checks. It is a multiple of 12, so that a piece contains only whole
/// pixels if there are 1 to 4 channels.
const PIECE: usize = 12 << 16;

/// A range of a node's progress.
#[derive(Clone, Copy)]
pub struct Progress<'a> {
    cx: Option<&'a Context>,
    from: f32,
    to: f32,
}

impl<'a> Progress<'a> {
    /// Progress of work outside any run, without cancellation.
    pub const UNTRACKED: Progress<'static> = Progress { cx: None, from: 0.0, to: 1.0 };

    /// The range of a node's progress between `from` and `to`.
    pub fn of(cx: &'a Context, from: f32, to: f32) -> Self {
        Self { cx: Some(cx), from, to }
    }

    /// A part of this range, between two fractions of it.
    pub fn part(self, from: f32, to: f32) -> Self {
        let at = |done: f32| self.from + (self.to - self.from) * done;
        Self { from: at(from), to: at(to), ..self }
    }

    /// Part `index` of this range, if the range is divided into `count` equal parts.
    pub fn piece(self, index: usize, count: usize) -> Self {
        let at = |index: usize| index as f32 / count.max(1) as f32;
        self.part(at(index), at(index + 1))
    }

    /// Reports progress from 0 to 1 within the range.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled.
    pub fn report(&self, done: f32) -> Result<(), Error> {
        let Some(cx) = self.cx else { return Ok(()) };
        cx.progress(self.from + (self.to - self.from) * done.clamp(0.0, 1.0));
        if cx.cancelled() { Err(Error::Stopped) } else { Ok(()) }
    }

    /// Applies `f` to consecutive pieces of a slice, and checks for cancellation between them.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled.
    pub fn over<'s, T>(&self, slice: &'s [T], mut f: impl FnMut(&'s [T])) -> Result<(), Error> {
        for piece in slice.chunks(PIECE) {
            self.report(1.0)?;
            f(piece);
        }
        Ok(())
    }

    /// Applies `f` to every index below `n` and returns the results in the order of the indices. If this is
    /// progress of a run, the work is distributed over the threads of the run.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled.
    pub fn tiles<T: Send>(&self, n: usize, f: impl Fn(usize) -> T + Send + Sync) -> Result<Vec<T>, Error> {
        match self.cx {
            Some(cx) => cx.for_each_tile(n, f).map_err(|_| Error::Stopped),
            None => Ok((0..n).map(f).collect()),
        }
    }
}

/// Converts a cancellation to an error of a codec.
fn stopped(error: Error) -> io::Error {
    io::Error::other(error)
}

/// A reader of the bytes of a file that checks for cancellation.
pub struct TrackedReader<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Position in the file at which cancellation is checked next.
    asks: usize,
    progress: Progress<'a>,
}

impl<'a> TrackedReader<'a> {
    /// Creates a reader at the start of a file.
    pub fn new(bytes: &'a [u8], progress: Progress<'a>) -> Self {
        Self { bytes, at: 0, asks: 0, progress }
    }
}

impl BufRead for TrackedReader<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.at >= self.asks {
            self.progress.report(self.at as f32 / self.bytes.len().max(1) as f32).map_err(stopped)?;
            self.asks = self.at + STEP;
        }
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        Ok(&rest[..rest.len().min(STEP)])
    }

    fn consume(&mut self, count: usize) {
        self.at += count;
    }
}

impl Read for TrackedReader<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(to)?;
        self.consume(count);
        Ok(count)
    }
}

impl Seek for TrackedReader<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => i128::from(at),
            SeekFrom::End(by) => self.bytes.len() as i128 + i128::from(by),
            SeekFrom::Current(by) => self.at as i128 + i128::from(by),
        };
        self.at = usize::try_from(at).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.at as u64)
    }
}

/// A writer of a file that checks for cancellation.
pub struct TrackedWriter<'a> {
    /// The bytes written.
    pub bytes: Vec<u8>,
    asks: usize,
    /// Approximate final length, in bytes.
    expected: usize,
    progress: Progress<'a>,
}

impl<'a> TrackedWriter<'a> {
    /// Creates a writer of a file whose final length is approximately `expected` bytes.
    pub fn new(expected: usize, progress: Progress<'a>) -> Self {
        Self { bytes: Vec::with_capacity(expected), asks: 0, expected, progress }
    }
}

impl Write for TrackedWriter<'_> {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        if self.bytes.len() >= self.asks {
            self.progress.report(self.bytes.len() as f32 / self.expected.max(1) as f32).map_err(stopped)?;
            self.asks = self.bytes.len() + STEP;
        }
        self.bytes.extend_from_slice(from);
        Ok(from.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use engine::{Scene, Up};

    use super::*;
    use crate::io::png::{Packing, Raster};
    use crate::io::{exr, hdr, jpeg, png};
    use crate::math::color::primaries::REC709;

    fn cx() -> Context {
        Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".")
    }

    #[test]
    fn pieces_follow_each_other() {
        let cx = cx();
        let all = Progress::of(&cx, 0.0, 1.0);
        let ends = |progress: Progress<'_>| (progress.from, progress.to);
        assert_eq!(ends(all.piece(1, 4)), (0.25, 0.5));
        assert_eq!(ends(all.part(0.5, 1.0).piece(0, 2)), (0.5, 0.75));
    }

    /// Each codec, cancelled at a tenth or at two fifths of its progress, stops before its end. This test fails if
    /// `reach` does not call `check`, or if any codec uses `Progress::UNTRACKED` in place of its argument.
    #[test]
    fn every_codec_stops_half_way() {
        let (width, height) = (512, 600);
        let noise = |i: usize| ((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u16;
        let codes = (0..width * height * 3).map(noise).collect();
        let raster =
            Raster { width, height, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None };
        let planes = || {
            let samples: Vec<f32> = (0..width * height).map(|i| f32::from(noise(i))).collect();
            ["R", "G", "B"].map(|name| {
                (exr::Channel { name: name.to_owned(), samples: samples.clone() }, exr::Depth::Float)
            })
        };
        let mut radiance = b"#?RADIANCE\n\n-Y 600 +X 512\n".to_vec();
        radiance.extend((0..width * height).flat_map(|i| [noise(i) as u8, 9, 200, 128]));
        let png_bytes = png::write(&raster, true, &[]).expect("packs");
        let jpeg_bytes = jpeg::write(&raster, 80, None).expect("packs");
        let exr_bytes = exr::write(width, height, planes().into(), "", None).expect("packs").0;
        let attributes =
            exr::Attributes { encoding: "", recipe: None, primaries: &REC709, camera: None, more: &[] };
        type Work<'a> = Box<dyn Fn(Progress<'_>) -> bool + 'a>;
        let works: [(&str, Work<'_>); 9] = [
            ("read PNG", Box::new(|s| png::read_for("a", &png_bytes, s).is_ok())),
            ("read JPEG", Box::new(|s| jpeg::read_for("a", &jpeg_bytes, s).is_ok())),
            ("read EXR", Box::new(|s| exr::read_for("a", &exr_bytes, s).is_ok())),
            ("read HDR", Box::new(|s| hdr::read_for("a", &radiance, s).is_ok())),
            ("pack PNG", Box::new(|s| png::write_for(&raster, Packing::Small, None, &[], s).is_ok())),
            ("pack PNG fast", Box::new(|s| png::write_for(&raster, Packing::Fast, None, &[], s).is_ok())),
            ("pack JPEG", Box::new(|s| jpeg::write_for(&raster, 80, None, s).is_ok())),
            ("pack EXR", Box::new(|s| exr::write_for(width, height, planes().into(), attributes, s).is_ok())),
            (
                "pack frames",
                Box::new(|s| {
                    png::write_frames(&[raster.clone(), raster.clone()], (1, 9), 0, true, &[], s).is_ok()
                }),
            ),
        ];
        for (what, work) in works {
            assert!(work(Progress::of(&cx(), 0.0, 1.0)), "{what}");
            for fraction in [0.1, 0.4] {
                assert!(!work(Progress::of(&cx().stopping_at(fraction), 0.0, 1.0)), "{what} at {fraction}");
            }
        }
    }
}
