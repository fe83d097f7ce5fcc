//! Decoded pictures with integer codes.

use super::progress::Progress;
use super::source_colour::SourceColour;
use crate::error::Error;

/// A decoded picture of integer codes, as stored: not linearised, with straight alpha.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Number of channels: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
    pub channels: usize,
    /// Largest code in the file: 255 or 65535.
    pub largest: u16,
    /// Codes, row by row.
    pub codes: Vec<u16>,
    /// How the file says that its colours are encoded; `None` for sRGB, and for files that do not say.
    pub colour: Option<SourceColour>,
    /// Metadata of the file that is not used, such as a gamma other than that of sRGB.
    pub ignored: Vec<String>,
}

impl Raster {
    /// The samples, scaled to the range 0 to 1.
    pub fn samples(&self) -> Vec<f32> {
        let largest = f32::from(self.largest);
        self.codes.iter().map(|&code| f32::from(code) / largest).collect()
    }

    /// The number of channels, and the samples as colours in the range 0 to 1: RGB, or RGBA premultiplied by alpha.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled.
    pub fn colours(&self, progress: Progress<'_>) -> Result<(usize, Vec<f32>), Error> {
        let alpha = self.channels.is_multiple_of(2);
        let channels = if alpha { 4 } else { 3 };
        let mut out = Vec::with_capacity(self.width * self.height * channels);
        let sample = |code: u16| f32::from(code) / f32::from(self.largest);
        progress.over(&self.codes, |codes| {
            for pixel in codes.chunks_exact(self.channels) {
                let rgb = match *pixel {
                    [y] | [y, _] => [y; 3],
                    [r, g, b, ..] => [r, g, b],
                    [] => [0; 3],
                };
                let a = if alpha { sample(pixel[self.channels - 1]) } else { 1.0 };
                out.extend(rgb.map(|code| sample(code) * a));
                if alpha {
                    out.push(a);
                }
            }
        })?;
        Ok((channels, out))
    }
}
