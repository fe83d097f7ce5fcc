//! Conversion of display codes to luma and chroma.

use scene::io::png::Raster;
use scene::io::quantise::DisplaySpace;

engine::choices! {
    /// Resolution of chroma.
    pub enum Chroma {
        /// Half in both directions (4:2:0), which every player shows.
        Half,
        /// Full (4:4:4), for sharp coloured edges. Browsers and desktop players show it; many televisions do not.
        Full,
    }
}

/// How colours are coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Coding {
    /// Bits per sample: 8 or 10.
    pub bits: u32,
    /// Resolution of chroma.
    pub chroma: Chroma,
    /// Colour space of the codes.
    pub space: DisplaySpace,
}

impl Coding {
    /// Shares of red and blue in luma: Rec. ITU-R BT.2020 for [`DisplaySpace::Rec2020`], BT.709 for all others.
    fn shares(self) -> [f32; 2] {
        if self.space == DisplaySpace::Rec2020 { [0.2627, 0.0593] } else { [0.2126, 0.0722] }
    }
}

/// A frame as luma and two chroma planes, row by row, in limited range (luma 16 to 235, chroma 16 to 240, for 8 bits).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Planes {
    /// Luma, blue difference and red difference.
    pub samples: [Vec<u16>; 3],
}

impl Planes {
    /// Converts display codes, grey or RGB. With half resolution, chroma is averaged over two rows, and over three
    /// columns with the weights 1, 2, 1 around every second one, where decoders expect it (left siting).
    pub fn of(raster: &Raster, coding: Coding) -> Self {
        let (width, height, channels) = (raster.width, raster.height, raster.channels);
        let [red, blue] = coding.shares();
        let scale = f32::from(1_u16 << (coding.bits - 8));
        let luma_of = |code: f32| (scale * (16.0 + 219.0 * code) + 0.5) as u16;
        let chroma_of = |code: f32| (scale * (128.0 + 224.0 * code) + 0.5) as u16;
        let mut luma = Vec::with_capacity(width * height);
        let mut chroma = [Vec::with_capacity(width * height), Vec::with_capacity(width * height)];
        for codes in raster.codes.chunks_exact(channels) {
            let code = |c: usize| f32::from(codes[c.min(channels - 1)]) / f32::from(raster.largest);
            let [r, g, b] = [code(0), code(1), code(2)];
            let y = red * r + (1.0 - red - blue) * g + blue * b;
            luma.push(luma_of(y));
            chroma[0].push((b - y) / (2.0 * (1.0 - blue)));
            chroma[1].push((r - y) / (2.0 * (1.0 - red)));
        }
        let [u, v] = chroma.map(|plane| match coding.chroma {
            Chroma::Full => plane.into_iter().map(chroma_of).collect(),
            Chroma::Half => halved((width, height), &plane).into_iter().map(chroma_of).collect(),
        });
        Self { samples: [luma, u, v] }
    }
}

/// A plane at half the width and height, rounded up.
fn halved((width, height): (usize, usize), plane: &[f32]) -> Vec<f32> {
    let mut out = Vec::with_capacity(width.div_ceil(2) * height.div_ceil(2));
    for top in (0..height).step_by(2) {
        let bottom = (top + 1).min(height - 1);
        for middle in (0..width).step_by(2) {
            let (left, right) = (middle.saturating_sub(1), (middle + 1).min(width - 1));
            let of_row = |row: usize| {
                let at = |column: usize| plane[row * width + column];
                0.25 * (at(left) + 2.0 * at(middle) + at(right))
            };
            out.push(0.5 * (of_row(top) + of_row(bottom)));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(width: usize, codes: &[u16], coding: Coding) -> [Vec<u16>; 3] {
        let height = codes.len() / 3 / width;
        let raster = Raster {
            width,
            height,
            channels: 3,
            largest: 65_535,
            codes: codes.to_vec(),
            ignored: Vec::new(),
            colour: None,
        };
        Planes::of(&raster, coding).samples
    }

    /// The codes of the primaries of BT.709 and BT.2020, computed from the definitions in the recommendations.
    #[test]
    fn primaries_have_the_codes_of_the_standards() {
        let coding = |bits, space| Coding { bits, chroma: Chroma::Full, space };
        let full = 65_535;
        let pixels = [0, 0, 0, full, full, full, full, 0, 0, 0, full, 0, 0, 0, full];
        let [y, u, v] = of(5, &pixels, coding(8, DisplaySpace::Srgb));
        assert_eq!(y, [16, 235, 63, 173, 32]);
        assert_eq!(u, [128, 128, 102, 42, 240]);
        assert_eq!(v, [128, 128, 240, 26, 118]);
        let [y, u, v] = of(5, &pixels, coding(10, DisplaySpace::Rec2020));
        assert_eq!(y, [64, 940, 294, 658, 116]);
        assert_eq!(u, [512, 512, 387, 189, 960]);
        assert_eq!(v, [512, 512, 960, 100, 476]);
    }

    /// A red column in a black frame, and frames of odd size.
    #[test]
    fn chroma_is_averaged_around_even_columns() {
        let coding = Coding { bits: 8, chroma: Chroma::Half, space: DisplaySpace::Srgb };
        let mut codes = vec![0; 3 * 5 * 3];
        for row in 0..3 {
            codes[3 * (row * 5 + 2)] = 65_535;
        }
        let [y, u, v] = of(5, &codes, coding);
        assert_eq!((y.len(), u.len(), v.len()), (15, 6, 6));
        // Half of the chroma of red at its own column, none at the others.
        assert_eq!(v, [128, 184, 128, 128, 184, 128]);
        let one = of(1, &[0, 0, 65_535], coding);
        assert_eq!(one[1], [240]);
    }
}
