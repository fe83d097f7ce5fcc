//! `measure-histogram`: the histogram of a picture.

use std::sync::Arc;

use lightharmony::engine::{self, Context, Kind, NodeError, Notes};
use lightharmony::scene::math::color::luminance;
use lightharmony::scene::types::Images;
use lightharmony::scene::types::layers::linear;

use crate::histogram::Histogram;

engine::params! {
    /// Counts the pixels of pictures by their luminance, in bins of one stop. A luminance of 1 is white.
    pub struct MeasureHistogram {
        /// The darkest bin; a luminance of 2^-8 is 8 stops below white.
        first: i32 = -8, range(-64, 63), unit("EV"), other("-4");
        /// Number of bins.
        bins: u32 = 12, range(1, 128), other("3");
    }
}
engine::inputs! {
    /// Inputs of [`MeasureHistogram`].
    pub struct In {
        /// Pictures in linear light or display colours; all views are counted together.
        image: Arc<Images>,
    }
}
engine::outputs! {
    /// Outputs of [`MeasureHistogram`].
    pub struct Out {
        /// The histogram.
        histogram: Arc<Histogram>,
    }
}

impl Kind for MeasureHistogram {
    const NAME: &'static str = "measure-histogram";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let bins = params.bins as usize;
        let mut found = Histogram { first: f64::from(params.first), counts: vec![0.0; bins], darker: 0.0 };
        let mut brighter = 0_u64;
        for view in &inputs.image.0 {
            cx.check()?;
            let picture = linear(&view.picture, "image")?;
            for pixel in picture.samples.chunks_exact(picture.channels) {
                let light = luminance([pixel[0], pixel[1], pixel[2]]);
                // The exponent of a number is exact on every machine, unlike a logarithm.
                let stops = exponent(light) - params.first;
                match usize::try_from(stops) {
                    Err(_) => found.darker += 1.0,
                    Ok(bin) => {
                        brighter += u64::from(bin >= bins);
                        found.counts[bin.min(bins - 1)] += 1.0;
                    }
                }
            }
        }
        let mut notes = Notes::none();
        notes.count("brighter", brighter, "of the pixels are brighter than the last bin, which counts them");
        Ok((Out { histogram: Arc::new(found) }, notes))
    }
}

/// The largest whole number `n` for which `2^n` is at most `light`; a very small number if `light` is 0 or less.
fn exponent(light: f32) -> i32 {
    if light > 0.0 { (f64::from(light).to_bits() >> 52) as i32 - 1023 } else { -2000 }
}

#[cfg(test)]
mod tests {
    use super::exponent;

    #[test]
    fn bins_begin_at_powers_of_two() {
        let below = f32::from_bits(1.0_f32.to_bits() - 1);
        assert_eq!([1.0, below, 0.5, 3.0, 0.0, -1.0].map(exponent), [0, -1, -1, 1, -2000, -2000]);
    }
}
