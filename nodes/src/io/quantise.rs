//! Conversion of pictures to display codes, with counts of clipped samples.

use engine::{Context, NodeError, Notes};

use super::png::Raster;
use crate::math::color::srgb_from_linear;
use crate::types::Picture;

engine::choices! {
    /// Treatment of the alpha channel.
    pub enum AlphaOutput {
        /// No alpha: the premultiplied picture is written on black.
        Drop,
        /// Straight alpha: the file has alpha, and colours are divided by it.
        Straight,
    }
}

/// Counts of samples that integer codes cannot represent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Lost {
    above: u64,
    below: u64,
    not_a_number: u64,
}

impl Lost {
    pub fn add(&mut self, other: Self) {
        self.above += other.above;
        self.below += other.below;
        self.not_a_number += other.not_a_number;
    }

    pub fn tell(self, view: &str, notes: &mut Notes) {
        if self.not_a_number > 0 {
            notes.degraded(
                "not-a-number",
                format!(
                    "{} of the samples of `{view}` had the value NaN, which was written as 0",
                    self.not_a_number
                ),
            );
        }
        for (id, count, what) in [
            ("clipped-above", self.above, "above 1, which was reduced to 1"),
            ("clipped-below", self.below, "below 0, which was raised to 0"),
        ] {
            notes.count(id, count, format!("of the samples of `{view}` had a value {what}"));
        }
    }
}

/// Converts a picture to display codes, rounded to the nearest code.
pub(crate) fn quantise(
    picture: &Picture,
    wide: bool,
    alpha: AlphaOutput,
    cx: &Context,
) -> Result<(Raster, Lost), NodeError> {
    let (width, height, channels) = picture.size();
    let colours = if channels >= 3 { 3 } else { 1 };
    let has_alpha = matches!(channels, 2 | 4);
    if !matches!(channels, 1..=4) || width == 0 || height == 0 {
        return Err(NodeError::new(format!(
            "a {width}x{height} picture with {channels} channels cannot be converted to display codes"
        ))
        .at("image"));
    }
    let keep_alpha = has_alpha && alpha == AlphaOutput::Straight;
    let largest = if wide { 65_535_u16 } else { 255 };
    let linear = matches!(picture, Picture::Linear(_));
    // Linear light is encoded after division by alpha, since the curve is not linear. Display values and data on
    // black are not changed.
    let row = |y: usize| {
        let mut codes = Vec::with_capacity(width * (colours + usize::from(keep_alpha)));
        let mut lost = Lost::default();
        for x in 0..width {
            let at = (y * width + x) * channels;
            let pixel = &picture.samples()[at..at + channels];
            let a = if has_alpha { pixel[channels - 1] } else { 1.0 };
            for &value in &pixel[..colours] {
                let value = if keep_alpha && a > 0.0 { value / a } else { value };
                let shown = if linear { srgb_from_linear(value) } else { value };
                codes.push(code(shown, largest, &mut lost));
            }
            if keep_alpha {
                codes.push(code(a, largest, &mut lost));
            }
        }
        (codes, lost)
    };
    let rows = cx.for_each_tile(height, row)?;
    let mut lost = Lost::default();
    let mut codes = Vec::with_capacity(width * height * (colours + usize::from(keep_alpha)));
    for (row, row_lost) in rows {
        codes.extend(row);
        lost.add(row_lost);
    }
    let channels = colours + usize::from(keep_alpha);
    Ok((Raster { width, height, channels, largest, codes, ignored: Vec::new(), linear: false }, lost))
}

fn code(value: f32, largest: u16, lost: &mut Lost) -> u16 {
    let scaled = f64::from(value) * f64::from(largest) + 0.5;
    if value.is_nan() {
        lost.not_a_number += 1;
        0
    } else if scaled >= f64::from(largest) + 1.0 {
        lost.above += 1;
        largest
    } else if scaled < 0.0 {
        lost.below += 1;
        0
    } else {
        scaled as u16
    }
}
