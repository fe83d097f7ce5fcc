//! A stretch of a node's work, for codecs: how far it is told, and whether it is to go on asked.
//!
//! Codecs of others know nothing of runs. They get their bytes from [`Fed`] and put them into [`Sunk`], which ask
//! every few thousand bytes and fail once the run is to stop; the engine then takes the node as stopped, whatever
//! the codec makes of that.

use std::io::{self, BufRead, Read, Seek, SeekFrom, Write};

use engine::Context;

use crate::error::Error;

/// Packed bytes between two questions. Deflate makes 4 MB of them at most, some 20 ms of work.
const STEP: usize = 4096;

/// Numbers that are turned into others between two questions: whole pixels of 1 to 4 channels.
const PIECE: usize = 12 << 16;

/// A part of a node's work, from some of its progress to some.
#[derive(Clone, Copy)]
pub struct Stretch<'a> {
    cx: Option<&'a Context>,
    from: f32,
    to: f32,
}

impl<'a> Stretch<'a> {
    /// Work that nobody waits for and nobody stops: outside of any run.
    pub const ALONE: Stretch<'static> = Stretch { cx: None, from: 0.0, to: 1.0 };

    /// Work that brings a node from one progress to another.
    pub fn of(cx: &'a Context, from: f32, to: f32) -> Self {
        Self { cx: Some(cx), from, to }
    }

    /// What of it lies between two progresses of its own.
    pub fn part(self, from: f32, to: f32) -> Self {
        let at = |done: f32| self.from + (self.to - self.from) * done;
        Self { from: at(from), to: at(to), ..self }
    }

    /// The `index`-th of `count` equal pieces.
    pub fn piece(self, index: usize, count: usize) -> Self {
        let at = |index: usize| index as f32 / count.max(1) as f32;
        self.part(at(index), at(index + 1))
    }

    /// Tells how far it is, from 0 to 1.
    ///
    /// # Errors
    /// [`Error::Stopped`].
    pub fn reach(&self, done: f32) -> Result<(), Error> {
        let Some(cx) = self.cx else { return Ok(()) };
        cx.progress(self.from + (self.to - self.from) * done.clamp(0.0, 1.0));
        if cx.cancelled() { Err(Error::Stopped) } else { Ok(()) }
    }

    /// `f` of a slice, some of its elements at a time.
    ///
    /// # Errors
    /// [`Error::Stopped`].
    pub fn over<'s, T>(&self, slice: &'s [T], mut f: impl FnMut(&'s [T])) -> Result<(), Error> {
        for piece in slice.chunks(PIECE) {
            self.reach(1.0)?;
            f(piece);
        }
        Ok(())
    }

    /// `f` of every index below `n`, in that order, on the shared threads where there are some.
    ///
    /// # Errors
    /// [`Error::Stopped`].
    pub fn tiles<T: Send>(&self, n: usize, f: impl Fn(usize) -> T + Send + Sync) -> Result<Vec<T>, Error> {
        match self.cx {
            Some(cx) => cx.for_each_tile(n, f).map_err(|_| Error::Stopped),
            None => Ok((0..n).map(f).collect()),
        }
    }
}

/// That a codec is to stop, as it understands it.
fn stopped(error: Error) -> io::Error {
    io::Error::other(error)
}

/// The bytes of a file, a few at a time.
pub struct Fed<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Where to ask next.
    asks: usize,
    stretch: Stretch<'a>,
}

impl<'a> Fed<'a> {
    /// From the start of a file.
    pub fn new(bytes: &'a [u8], stretch: Stretch<'a>) -> Self {
        Self { bytes, at: 0, asks: 0, stretch }
    }
}

impl BufRead for Fed<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.at >= self.asks {
            self.stretch.reach(self.at as f32 / self.bytes.len().max(1) as f32).map_err(stopped)?;
            self.asks = self.at + STEP;
        }
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        Ok(&rest[..rest.len().min(STEP)])
    }

    fn consume(&mut self, count: usize) {
        self.at += count;
    }
}

impl Read for Fed<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(to)?;
        self.consume(count);
        Ok(count)
    }
}

impl Seek for Fed<'_> {
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

/// A file in the making.
pub struct Sunk<'a> {
    /// What was written.
    pub bytes: Vec<u8>,
    asks: usize,
    /// About how many there will be.
    expected: usize,
    stretch: Stretch<'a>,
}

impl<'a> Sunk<'a> {
    /// Nothing yet, of about so many bytes.
    pub fn new(expected: usize, stretch: Stretch<'a>) -> Self {
        Self { bytes: Vec::with_capacity(expected), asks: 0, expected, stretch }
    }
}

impl Write for Sunk<'_> {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        if self.bytes.len() >= self.asks {
            self.stretch.reach(self.bytes.len() as f32 / self.expected.max(1) as f32).map_err(stopped)?;
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

    fn cx() -> Context {
        Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".")
    }

    #[test]
    fn pieces_follow_each_other() {
        let cx = cx();
        let all = Stretch::of(&cx, 0.0, 1.0);
        let ends = |stretch: Stretch<'_>| (stretch.from, stretch.to);
        assert_eq!(ends(all.piece(1, 4)), (0.25, 0.5));
        assert_eq!(ends(all.part(0.5, 1.0).piece(0, 2)), (0.5, 0.75));
    }

    /// Asked to stop a tenth or four fifths on the way, each format stops, and none has to come to its end for it.
    /// Mutation: `check` left away in `reach`, and `Stretch::ALONE` in place of the given one in each codec.
    #[test]
    fn every_codec_stops_half_way() {
        let (width, height) = (512, 600);
        let noise = |i: usize| ((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u16;
        let codes = (0..width * height * 3).map(noise).collect();
        let raster =
            Raster { width, height, channels: 3, largest: 255, codes, ignored: Vec::new(), linear: false };
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
        type Work<'a> = Box<dyn Fn(Stretch<'_>) -> bool + 'a>;
        let works: [(&str, Work<'_>); 9] = [
            ("read PNG", Box::new(|s| png::read_for("a", &png_bytes, s).is_ok())),
            ("read JPEG", Box::new(|s| jpeg::read_for("a", &jpeg_bytes, s).is_ok())),
            ("read EXR", Box::new(|s| exr::read_for("a", &exr_bytes, s).is_ok())),
            ("read HDR", Box::new(|s| hdr::read_for("a", &radiance, s).is_ok())),
            ("pack PNG", Box::new(|s| png::write_for(&raster, Packing::Small, true, &[], s).is_ok())),
            ("pack PNG fast", Box::new(|s| png::write_for(&raster, Packing::Fast, true, &[], s).is_ok())),
            ("pack JPEG", Box::new(|s| jpeg::write_for(&raster, 80, None, s).is_ok())),
            ("pack EXR", Box::new(|s| exr::write_for(width, height, planes().into(), "", None, s).is_ok())),
            (
                "pack frames",
                Box::new(|s| {
                    png::write_frames(&[raster.clone(), raster.clone()], (1, 9), 0, true, &[], s).is_ok()
                }),
            ),
        ];
        for (what, work) in works {
            assert!(work(Stretch::of(&cx(), 0.0, 1.0)), "{what}");
            for fraction in [0.1, 0.4] {
                assert!(!work(Stretch::of(&cx().stopping_at(fraction), 0.0, 1.0)), "{what} at {fraction}");
            }
        }
    }
}
