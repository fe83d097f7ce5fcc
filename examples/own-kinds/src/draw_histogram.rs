//! `draw-histogram`: a picture of a histogram.

use std::sync::Arc;

use lightharmony::engine::{self, Context, Kind, NodeError, Notes};
use lightharmony::scene::types::{Image, Images, Linear};

use crate::histogram::Histogram;

engine::choices! {
    /// Scale of the heights.
    pub enum Heights {
        /// The height is proportional to the number of pixels.
        Pixels,
        /// The height is proportional to the square root of the number of pixels, so that small bins are visible.
        Root,
    }
}
engine::params! {
    /// Draws a histogram as bars, the darkest on the left.
    pub struct DrawHistogram {
        /// Width of a bar.
        bar_px: u32 = 16, range(1, 256), unit("px"), other("5");
        /// Height of the largest bar.
        height_px: u32 = 96, range(1, 4096), unit("px"), other("40");
        /// Scale of the heights.
        heights: Heights = Heights::Pixels, other("Root");
    }
}
engine::inputs! {
    /// Inputs of [`DrawHistogram`].
    pub struct In {
        /// The histogram.
        histogram: Arc<Histogram>,
    }
}
engine::outputs! {
    /// Outputs of [`DrawHistogram`].
    pub struct Out {
        /// The picture, linear.
        image: Arc<Images>,
    }
}

impl Kind for DrawHistogram {
    const NAME: &'static str = "draw-histogram";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        cx.check()?;
        let scaled = |count: f64| match params.heights {
            Heights::Pixels => count,
            Heights::Root => count.sqrt(),
        };
        let bars: Vec<f64> = inputs.histogram.counts.iter().map(|count| scaled(*count)).collect();
        let largest = bars.iter().copied().fold(0.0, f64::max);
        if largest == 0.0 {
            let what = "every pixel is darker than the first bin, so there is nothing to draw";
            return Err(NodeError::new(what).at("histogram").hint("lower `first` of `measure-histogram`"));
        }
        let (bar, height) = (params.bar_px as usize, params.height_px as usize);
        let mut picture = Image::<Linear>::new(bars.len() * bar, height, 3);
        for (index, value) in bars.iter().enumerate() {
            let top = ((1.0 - value / largest) * height as f64).round() as usize;
            // Bars become lighter from left to right; the space between them is black.
            let grey = 0.1 + 0.9 * (index + 1) as f32 / bars.len() as f32;
            for y in top..height {
                for x in index * bar..(index + 1) * bar - usize::from(bar > 1) {
                    picture.pixel_mut(x, y).fill(grey);
                }
            }
        }
        Ok((Out { image: Arc::new(Images::single("histogram", picture)) }, Notes::none()))
    }
}
