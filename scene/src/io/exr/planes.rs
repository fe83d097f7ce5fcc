//! The decoded channels of a file.

use crate::math::color::primaries::REC709;

/// A channel of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// Full name in the file: `R`, `R0.G`, `Z`.
    pub name: String,
    /// `width * height` numbers, row by row.
    pub samples: Vec<f32>,
}

/// A decoded file, cropped or padded with zeros to its display window.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes {
    /// Columns of the display window.
    pub width: usize,
    /// Rows of the display window.
    pub height: usize,
    /// Channels, sorted by name as the format requires.
    pub channels: Vec<Channel>,
    /// Number of parts in the file; one of them is read.
    pub parts: usize,
    /// Name of the part that was read; empty if it has no name.
    pub part: String,
    /// Names of all flat parts that have a name.
    pub part_names: Vec<String>,
    /// Name of the layer within the part; empty for channels whose names have no layer.
    pub layer: String,
    /// True if the data window differs from the display window.
    pub cropped: bool,
    /// The chromaticities: x and y of red, green, blue and white; `None` if the file has none.
    pub primaries: Option<[[f32; 2]; 4]>,
}

/// True if chromaticities (x and y of red, green, blue and white) differ from those of sRGB, which are the default
/// for files without chromaticities, by more than rounding; false for `None`.
pub fn differ_from_srgb(primaries: Option<&[[f32; 2]; 4]>) -> bool {
    let srgb = [REC709.red, REC709.green, REC709.blue, REC709.white];
    let off = |own: &[[f32; 2]; 4]| {
        own.as_flattened()
            .iter()
            .zip(srgb.as_flattened())
            .any(|(a, b)| (f64::from(*a) - b).abs().total_cmp(&2e-3).is_gt())
    };
    primaries.is_some_and(off)
}

impl Planes {
    /// True if the chromaticities of the file differ from those of sRGB by more than rounding.
    pub fn other_primaries(&self) -> bool {
        differ_from_srgb(self.primaries.as_ref())
    }

    /// Returns a channel by its full name.
    pub fn find(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.name == name).map(|channel| channel.samples.as_slice())
    }
}
