//! Colours of a file: the conversion to linear light of Rec.709, or to sRGB.

use super::icc;
use super::progress::Progress;
use crate::error::Error;
use crate::math::color::primaries::{Matrix, Primaries, REC709, product_vector};
use crate::math::color::space::{Conversion, Reference, Space};
use crate::math::color::{linear_from_srgb, srgb_from_linear};

/// How a file encodes its colours.
#[derive(Debug, Clone, PartialEq)]
pub enum SourceColour {
    /// A colour space that has a name.
    Space(Space),
    /// Linear light with the given matrix to linear Rec.709.
    Linear(Matrix),
    /// The curve of sRGB, and light whose matrix to linear Rec.709 is given.
    Display(Matrix),
    /// An ICC profile with a curve for each channel and a matrix.
    Icc(Box<icc::Profile>),
}

impl SourceColour {
    /// Linear light with the given chromaticities: x and y of red, green, blue and white. `None` if they do not
    /// span a colour space: values that are not finite, a y of 0, or primaries on one line.
    pub fn linear(xy: [[f32; 2]; 4]) -> Option<Self> {
        to_rec709(xy).map(SourceColour::Linear)
    }

    /// Colours with the curve of sRGB and the given chromaticities, which are as in [`linear`](Self::linear).
    pub fn display(xy: [[f32; 2]; 4]) -> Option<Self> {
        to_rec709(xy).map(SourceColour::Display)
    }

    /// True if the colours become linear light, and false if they become sRGB.
    pub fn is_scene(&self) -> bool {
        match self {
            SourceColour::Space(space) => space.reference() == Reference::Scene,
            SourceColour::Linear(_) => true,
            SourceColour::Display(_) => false,
            SourceColour::Icc(profile) => profile.is_linear(),
        }
    }

    /// True if colours need no conversion: those of sRGB, and linear light of Rec.709.
    pub fn is_working(&self) -> bool {
        matches!(self, SourceColour::Space(Space::Srgb | Space::LinearRec709))
    }

    /// Converts interleaved samples of `channels` channels: grey or RGB, with or without alpha, premultiplied by
    /// it. Grey passes the curve only, since white stays white. Colours outside the gamut of Rec.709 get negative
    /// components.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled.
    pub fn convert(&self, samples: &mut [f32], channels: usize, progress: Progress<'_>) -> Result<(), Error> {
        let to = if self.is_scene() { Space::LinearRec709 } else { Space::Srgb };
        let named = match self {
            SourceColour::Space(space) => Some(Conversion::new(*space, to)),
            _ => None,
        };
        let one = |rgb: [f32; 3]| match (self, &named) {
            (_, Some(conversion)) => conversion.apply(rgb),
            (SourceColour::Icc(profile), _) => {
                let light = profile.light(rgb);
                if profile.is_linear() { light } else { light.map(srgb_from_linear) }
            }
            (SourceColour::Linear(matrix), _) => product_vector(matrix, rgb.map(f64::from)).map(|v| v as f32),
            (SourceColour::Display(matrix), _) => {
                let light = rgb.map(|code| f64::from(linear_from_srgb(code)));
                product_vector(matrix, light).map(|v| srgb_from_linear(v as f32))
            }
            (SourceColour::Space(_), None) => rgb,
        };
        let alpha = channels.is_multiple_of(2);
        let colours = channels - usize::from(alpha);
        if colours == 1 && matches!(self, SourceColour::Linear(_) | SourceColour::Display(_)) {
            return Ok(());
        }
        // A multiple of all numbers of channels.
        for piece in samples.chunks_mut(12 << 14) {
            progress.report(1.0)?;
            for pixel in piece.chunks_exact_mut(channels) {
                let a = if alpha { pixel[channels - 1] } else { 1.0 };
                if alpha && a <= 0.0 {
                    continue;
                }
                let rgb = if colours == 3 { [pixel[0], pixel[1], pixel[2]] } else { [pixel[0]; 3] };
                let converted = if a == 1.0 { one(rgb) } else { one(rgb.map(|v| v / a)).map(|v| v * a) };
                pixel[..colours].copy_from_slice(&converted[..colours]);
            }
        }
        Ok(())
    }
}

/// The matrix from linear light with the given chromaticities to linear Rec.709; see [`SourceColour::linear`].
fn to_rec709([red, green, blue, white]: [[f32; 2]; 4]) -> Option<Matrix> {
    let [red, green, blue, white] = [red, green, blue, white].map(|xy| xy.map(f64::from));
    let area = (green[0] - red[0]) * (blue[1] - red[1]) - (blue[0] - red[0]) * (green[1] - red[1]);
    // The green of AP0 has x = 0, and its blue has y < 0; only y = 0 has no tristimulus values.
    let spans = area.abs() > 1e-4 && [red, green, blue, white].iter().all(|xy| xy[1].abs() > 1e-6);
    let matrix = Primaries { red, green, blue, white }.to(&REC709);
    let finite = matrix.iter().flatten().all(|v| v.is_finite() && v.abs() < 1e4);
    (spans && finite).then_some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::color::primaries::{AP0, AP1, P3_D65};

    fn converted(from: &SourceColour, samples: &[f32], channels: usize) -> Vec<f32> {
        let mut samples = samples.to_vec();
        from.convert(&mut samples, channels, Progress::UNTRACKED).unwrap_or_else(|e| panic!("{e}"));
        samples
    }

    /// Pure red of AP1 has the components (1.70505, -0.13026, -0.02400) in Rec.709 (OpenColorIO 2.6.0), alone and
    /// premultiplied. White and grey stay as they are.
    #[test]
    fn chromaticities_of_a_file_are_applied() {
        let of = |p: &Primaries| {
            let xy = [p.red, p.green, p.blue, p.white].map(|xy| xy.map(|v| v as f32));
            SourceColour::linear(xy).expect("spans a space")
        };
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-6);
        let red = [1.705_051, -0.130_256, -0.024_003];
        assert!(near(&converted(&of(&AP1), &[1.0, 0.0, 0.0], 3), &red));
        let half = [red[0] / 2.0, red[1] / 2.0, red[2] / 2.0, 0.5];
        assert!(near(&converted(&of(&AP1), &[0.5, 0.0, 0.0, 0.5], 4), &half));
        for space in [&AP0, &AP1, &P3_D65] {
            assert!(near(&converted(&of(space), &[0.25; 3], 3), &[0.25; 3]));
            assert!(near(&converted(&of(space), &[0.25], 1), &[0.25]));
        }
        assert!(converted(&of(&AP1), &[], 3).is_empty());
    }

    #[test]
    fn chromaticities_that_span_nothing_are_refused() {
        let good = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]];
        for (index, bad) in [
            (0, [f32::NAN, 0.3]),
            (1, [0.3, 0.0]),
            (2, [0.47, 0.465]),
            (3, [0.0, 0.0]),
            (3, [f32::INFINITY; 2]),
        ] {
            let mut xy = good;
            xy[index] = bad;
            assert_eq!(SourceColour::linear(xy), None, "{xy:?}");
        }
        assert!(SourceColour::linear(good).is_some());
    }

    /// Codes of Display P3 become codes of sRGB, outside 0 to 1 where sRGB cannot show the colour.
    #[test]
    fn display_colours_become_srgb() {
        let p3 = SourceColour::Space(Space::DisplayP3);
        assert!(!p3.is_scene());
        let red = converted(&p3, &[1.0, 0.0, 0.0], 3);
        // From the published matrix of linear P3 to linear sRGB: 1.22494, -0.04206, -0.01964.
        let expected = [1.224_94, -0.042_06, -0.019_64].map(srgb_from_linear);
        assert!(red.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{red:?}");
        // The same by chromaticities. Grey stays as it is.
        let xy = [P3_D65.red, P3_D65.green, P3_D65.blue, P3_D65.white].map(|xy| xy.map(|v| v as f32));
        let stated = SourceColour::display(xy).expect("spans a space");
        assert!(!stated.is_scene() && !stated.is_working());
        let red = converted(&stated, &[1.0, 0.0, 0.0], 3);
        assert!(red.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{red:?}");
        assert_eq!(converted(&stated, &[0.25], 1), [0.25]);
    }
}
