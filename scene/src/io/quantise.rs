//! Conversion of pictures to display codes, with counts of clipped samples.

use engine::{Context, NodeError, Notes};

use super::cube::CubeLut;
use super::png::Raster;
use crate::math::color::space::{Conversion, Space};
use crate::math::color::view::{Display, View};
use crate::math::num;
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

engine::choices! {
    /// Colour space of a display.
    pub enum DisplaySpace {
        /// sRGB.
        Srgb,
        /// Display P3, for wide-gamut screens.
        DisplayP3,
        /// Rec.709 video, for a display of BT.1886 (gamma 2.4).
        Rec709,
        /// Rec.2020 video, for a display of BT.1886 (gamma 2.4).
        Rec2020,
    }
}
impl DisplaySpace {
    /// The colour space.
    pub fn space(self) -> Space {
        match self {
            DisplaySpace::Srgb => Space::Srgb,
            DisplaySpace::DisplayP3 => Space::DisplayP3,
            DisplaySpace::Rec709 => Space::Rec709,
            DisplaySpace::Rec2020 => Space::Rec2020,
        }
    }
}

/// How pictures are shown on a display.
#[derive(Debug, Clone)]
pub struct Shown {
    linear: Look,
    encoded: Conversion,
}

/// How linear light is shown.
#[derive(Debug, Clone)]
enum Look {
    View(Display),
    Lut { gain: f32, input: Conversion, lut: CubeLut },
}

impl Look {
    fn apply(&self, light: [f32; 3]) -> [f32; 3] {
        match self {
            Look::View(display) => display.apply(light),
            Look::Lut { gain, input, lut } => lut.apply(input.apply(light.map(|v| v * gain))),
        }
    }
}

impl Shown {
    /// On a display with the colour space `space`: linear light with a view transform after a gain of
    /// `2^exposure`, display-encoded colours as they are.
    pub fn on(space: Space, view: View, exposure: f64) -> Self {
        let linear = Look::View(Display::new(view, exposure, space));
        Self { linear, encoded: Conversion::new(Space::Srgb, space) }
    }

    /// On a display with the colour space `space`: linear light after a gain of `2^exposure` is encoded in `input`
    /// and passes a lookup table, display-encoded colours stay as they are.
    pub fn by(lut: CubeLut, input: Space, exposure: f64, space: Space) -> Self {
        let input = Conversion::new(Space::LinearRec709, input);
        let linear = Look::Lut { gain: num::f64::exp2(exposure) as f32, input, lut };
        Self { linear, encoded: Conversion::new(Space::Srgb, space) }
    }
}

impl Default for Shown {
    fn default() -> Self {
        Self::on(Space::Srgb, View::Standard, 0.0)
    }
}

/// Counts of samples that integer codes cannot represent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lost {
    above: u64,
    below: u64,
    not_a_number: u64,
}

impl Lost {
    /// Adds other counts.
    pub fn add(&mut self, other: Self) {
        self.above += other.above;
        self.below += other.below;
        self.not_a_number += other.not_a_number;
    }

    /// Adds a note for each kind of loss to the notes about a view.
    pub fn report(self, view: &str, notes: &mut Notes) {
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
pub fn quantise(
    picture: &Picture,
    wide: bool,
    alpha: AlphaOutput,
    shown: &Shown,
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
    // Linear light is encoded after division by alpha, since the curve is not linear. Display values and data on
    // black are not changed.
    let row = |y: usize| {
        let mut codes = Vec::with_capacity(width * (colours + usize::from(keep_alpha)));
        let mut lost = Lost::default();
        for x in 0..width {
            let at = (y * width + x) * channels;
            let pixel = &picture.samples()[at..at + channels];
            let a = if has_alpha { pixel[channels - 1] } else { 1.0 };
            let straight = |value: f32| if keep_alpha && a > 0.0 { value / a } else { value };
            let rgb = if colours == 3 { [pixel[0], pixel[1], pixel[2]] } else { [pixel[0]; 3] };
            let rgb = rgb.map(straight);
            let rgb = match picture {
                Picture::Linear(_) => shown.linear.apply(rgb),
                Picture::Srgb(_) => shown.encoded.apply(rgb),
                Picture::Data(_) => rgb,
            };
            codes.extend(rgb[..colours].iter().map(|value| code(*value, largest, &mut lost)));
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
    Ok((Raster { width, height, channels, largest, codes, ignored: Vec::new(), colour: None }, lost))
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
