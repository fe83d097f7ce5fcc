//! Orientation of the pixels of a file: the turn that makes a photograph upright.

use image::metadata::Orientation;

use super::progress::Progress;
use crate::error::Error;

/// A turn by a multiple of 90 degrees, possibly mirrored: the values 1 to 8 of the tag `Orientation` of TIFF and EXIF
/// (CIPA DC-008, 4.6.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Turn(u16);

impl Turn {
    /// The orientation of a picture that is stored upright.
    pub(super) const UPRIGHT: Self = Self(1);

    /// The orientation with the value of the tag; upright for values that are not defined.
    pub(super) fn of_tag(value: u16) -> Self {
        if (1..=8).contains(&value) { Self(value) } else { Self::UPRIGHT }
    }

    /// The orientation that EXIF data state, with or without the prefix of JPEG; upright if they state none.
    pub(super) fn of_exif(exif: &[u8]) -> Self {
        let exif = exif.strip_prefix(b"Exif\0\0").unwrap_or(exif);
        let stated = Orientation::from_exif_chunk(exif).map(Orientation::to_exif);
        stated.map_or(Self::UPRIGHT, |value| Self::of_tag(value.into()))
    }

    /// True if the turn exchanges width and height.
    pub(super) fn is_quarter(self) -> bool {
        self.0 >= 5
    }

    /// Description of an orientation that a reader leaves as it is; `None` if the picture is upright.
    pub(super) fn ignored(self) -> Option<String> {
        (self != Self::UPRIGHT).then(|| "an orientation other than upright (EXIF)".to_owned())
    }

    /// The upright picture of interleaved samples: its width and height, and its samples.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled.
    pub(super) fn upright<T: Copy>(
        self,
        [width, height]: [usize; 2],
        channels: usize,
        samples: Vec<T>,
        progress: Progress<'_>,
    ) -> Result<([usize; 2], Vec<T>), Error> {
        if self == Self::UPRIGHT {
            return Ok(([width, height], samples));
        }
        let size = if self.is_quarter() { [height, width] } else { [width, height] };
        let mut turned = Vec::with_capacity(samples.len());
        for y in 0..size[1] {
            if y % 64 == 0 {
                progress.report(1.0)?;
            }
            for x in 0..size[0] {
                // Column and row of the file.
                let (column, row) = match self.0 {
                    2 => (width - 1 - x, y),
                    3 => (width - 1 - x, height - 1 - y),
                    4 => (x, height - 1 - y),
                    5 => (y, x),
                    6 => (y, height - 1 - x),
                    7 => (width - 1 - y, height - 1 - x),
                    8 => (width - 1 - y, x),
                    _ => (x, y),
                };
                let at = (row * width + column) * channels;
                turned.extend_from_slice(&samples[at..at + channels]);
            }
        }
        Ok((size, turned))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EXIF data with an orientation.
    fn exif(value: u16) -> Vec<u8> {
        let [low, high] = value.to_le_bytes();
        let mut bytes = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        bytes.extend([low, high, 0, 0, 0, 0, 0, 0]);
        bytes
    }

    /// The letter F in 3 x 4 pixels, upright and as cameras store it with each orientation. The standard defines an
    /// orientation by where row 0 and column 0 of the file are in the upright picture.
    #[test]
    fn the_letter_becomes_upright_from_each_orientation() {
        let upright = ["###", "#..", "##.", "#.."];
        let stored: [&[&str]; 8] = [
            &["###", "#..", "##.", "#.."],
            // Row 0 is the top, column 0 the right side.
            &["###", "..#", ".##", "..#"],
            // Row 0 is the bottom, column 0 the right side.
            &["..#", ".##", "..#", "###"],
            // Row 0 is the bottom, column 0 the left side.
            &["#..", "##.", "#..", "###"],
            // Row 0 is the left side, column 0 the top.
            &["####", "#.#.", "#..."],
            // Row 0 is the right side, column 0 the top.
            &["#...", "#.#.", "####"],
            // Row 0 is the right side, column 0 the bottom.
            &["...#", ".#.#", "####"],
            // Row 0 is the left side, column 0 the bottom.
            &["####", ".#.#", "...#"],
        ];
        for (index, rows) in stored.iter().enumerate() {
            let value = index as u16 + 1;
            let size = [rows[0].len(), rows.len()];
            let samples: Vec<u8> = rows.concat().bytes().flat_map(|v| [v, value as u8]).collect();
            let turn = Turn::of_exif(&exif(value));
            assert_eq!(turn, Turn::of_tag(value));
            let (found, turned) =
                turn.upright(size, 2, samples, Progress::UNTRACKED).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(found, [3, 4], "{value}");
            assert!(turned.iter().skip(1).step_by(2).all(|v| *v == value as u8));
            let turned: Vec<u8> = turned.into_iter().step_by(2).collect();
            assert_eq!(String::from_utf8_lossy(&turned), upright.concat(), "{value}");
            assert_eq!(turn.is_quarter(), size == [4, 3], "{value}");
        }
    }

    #[test]
    fn values_that_are_not_defined_are_upright() {
        for value in [0, 9, 300] {
            assert_eq!(Turn::of_tag(value), Turn::UPRIGHT);
            assert_eq!(Turn::of_exif(&exif(value)), Turn::UPRIGHT);
        }
        assert_eq!(Turn::of_exif(b"II"), Turn::UPRIGHT);
    }
}
