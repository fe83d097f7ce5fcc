//! `shadow-ratio`: the fraction of the receiver's light that remains with the inserted objects.

mod form;
mod shaping;
mod tally;

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes, ViewCount};
use render::light::level::level;
use scene::math::color::luminance;
use scene::types::layers::{linear, matching};
use scene::types::{Data, Image, Images, Linear, NamedImage};

use tally::Tally;

use form::Limits;
pub use form::{Channels, RatioForm};

engine::params! {
    /// The ratio of the receiver's light with and without the objects, per colour channel.
    ///
    /// Multiplied with a photograph of the same scene, it darkens the shadow of the objects. Pixels with too little
    /// light for a meaningful ratio keep a factor of 1. The factor is shaped by `gamma`, `s_min` and `lambda`: from
    /// a ratio `S` it becomes `1 - lambda * (1 - max(S^gamma, s_min))`.
    pub struct ShadowRatio {
        /// Formula of the ratio.
        form: RatioForm = RatioForm::Stable, other("Paper");
        /// One ratio per channel, or one ratio of luminance.
        channels: Channels = Channels::Each, other("Luminance");
        /// Offset of the denominator: a fraction of the median of `without` for `Stable`, a radiance for `Paper`.
        epsilon: f64 = 1e-4, range(0.0, 1.0), other("0.05");
        /// Light below which pixels keep their brightness, in the unit of `epsilon`. Between this value and twice
        /// this value the ratio fades in, so that no edge shows (except with `Paper`).
        min_energy: f64 = 1e-3, range(0.0, 1e6), other("0.9");
        /// Largest ratio. Values above 1 keep light that the object adds by reflection; values below 1 darken the
        /// whole picture. `Hybrid` limits `s_max` to 1.
        s_max: f64 = 1.0, range(0.0, 100.0), other("0.6");
        /// Exponent of the ratio; smaller values make the shadow lighter.
        gamma: f64 = 1.0, range(1e-3, 1.0), other("0.5");
        /// Smallest factor: no shadow is darker than this.
        s_min: f64 = 0.0, range(0.0, 1.0), other("0.8");
        /// Strength of the shadow; 0 leaves the background unchanged.
        lambda: f64 = 1.0, range(0.0, 1.0), other("0.5");
    }
}

engine::inputs! {
    /// Inputs of [`ShadowRatio`].
    pub struct In {
        /// Render of the receiver without the objects (R0).
        without: Arc<Images>,
        /// Render of the receiver with the objects, which are invisible to the camera (R1).
        with: Arc<Images>,
    }
}

engine::outputs! {
    /// Outputs of [`ShadowRatio`].
    pub struct Out {
        /// Factor by which each channel of the background is multiplied; 1 where there is no shadow.
        shadow: Arc<Images>,
        /// Linear light to add to the background after the shadow, for `composite`; 0 if the form adds none.
        added: Arc<Images>,
    }
}

impl ShadowRatio {
    /// Computes the shaped factors and added light of a view.
    fn view(
        &self,
        without: &Image<Linear>,
        with: &Image<Linear>,
        tally: &mut Tally,
        cx: &Context,
    ) -> Result<[Image<Data>; 2], NodeError> {
        let (width, height) = (without.width, without.height);
        let unit = match self.form {
            RatioForm::Paper => 1.0,
            _ => level(without.samples.chunks_exact(without.channels).flat_map(|pixel| &pixel[..3]).copied()),
        };
        let limits =
            Limits { epsilon: self.epsilon * unit, min_energy: self.min_energy * unit, s_max: self.s_max };
        let rows = cx.for_each_tile(height, |y| {
            let (mut shadow, mut added) = (Vec::with_capacity(3 * width), Vec::with_capacity(3 * width));
            let mut tally = Tally::default();
            let columns = self.columns(without, y);
            for x in 0..width {
                let pair = [without.rgb(x, y), with.rgb(x, y)].map(|rgb| rgb.map(f64::from));
                for c in 0..3 {
                    let [a, b] = pair.map(|rgb| self.of(rgb, c));
                    tally.samples += 1;
                    let (factor, extra) = if a.is_finite() && b.is_finite() {
                        let energy = || {
                            let about = lit(&columns, x, c);
                            let is_enough = about > 2.0 * ROUNDED * limits.min_energy && about.is_finite();
                            if is_enough { about } else { self.neighbourhood(without, x, y, c) }
                        };
                        let shone_on = || self.is_shone_on(without, with, x, y, c);
                        let factor = self.form.ratio(&limits, (a, b), energy, shone_on, &mut tally);
                        (factor, self.form.added(pair[0][c], pair[1][c]))
                    } else {
                        tally.broken += 1;
                        (1.0, 0.0)
                    };
                    shadow.push(self.shape(factor) as f32);
                    added.push((self.lambda * extra) as f32);
                }
            }
            (shadow, added, tally)
        })?;
        let (mut shadow, mut added) =
            (Vec::with_capacity(3 * width * height), Vec::with_capacity(3 * width * height));
        for (row, light, of_row) in rows {
            shadow.extend(row);
            added.extend(light);
            tally.add(&of_row);
        }
        Ok([shadow, added].map(|samples| Image::from_samples(width, height, 3, samples)))
    }

    /// Light of channel `c`, or luminance, depending on the parameter `channels`.
    fn of(&self, rgb: [f64; 3], c: usize) -> f64 {
        match self.channels {
            Channels::Each => rgb[c],
            Channels::Luminance => f64::from(luminance(rgb.map(|v| v as f32))),
        }
    }

    /// True if the objects brighten most of the pixels around a pixel, and not only a single pixel, as a firefly
    /// does.
    fn is_shone_on(
        &self,
        without: &Image<Linear>,
        with: &Image<Linear>,
        x: usize,
        y: usize,
        c: usize,
    ) -> bool {
        let (mut bright, mut count) = (0, 0);
        for (i, j) in around(without, x, y) {
            let [a, b] = [without, with].map(|image| self.of(image.rgb(i, j).map(f64::from), c));
            bright += u32::from(b > tally::SHONE_ON * self.s_max * a);
            count += 1;
        }
        2 * bright > count
    }

    /// Sum of the light of each pixel column over a row and its neighbours, and the number of these rows.
    fn columns(&self, image: &Image<Linear>, y: usize) -> (Vec<[f64; 3]>, usize) {
        let rows = y.saturating_sub(1)..=(y + 1).min(image.height - 1);
        let sum = |x: usize| {
            let mut sum = [0.0; 3];
            for y in rows.clone() {
                let rgb = image.rgb(x, y).map(f64::from);
                (0..3).for_each(|c| sum[c] += self.of(rgb, c));
            }
            sum
        };
        ((0..image.width).map(sum).collect(), rows.clone().count())
    }

    /// Mean of the finite values around a pixel, so that the test against `min_energy` does not depend on the noise
    /// of one pixel.
    fn neighbourhood(&self, image: &Image<Linear>, x: usize, y: usize, c: usize) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (i, j) in around(image, x, y) {
            let v = self.of(image.rgb(i, j).map(f64::from), c);
            if v.is_finite() {
                sum += v;
                count += 1.0;
            }
        }
        sum / f64::max(count, 1.0)
    }
}

/// Factor above 1 by which rounding may change a mean of nine values, and far more.
const ROUNDED: f64 = 1.0 + 1e-6;

/// About the mean light of channel `c` around a pixel, from the sums of [`ShadowRatio::columns`]. Above twice
/// `min_energy`, where most pixels are, the exact mean does not matter. NaN or infinite if a value is not finite.
fn lit((columns, rows): &(Vec<[f64; 3]>, usize), x: usize, c: usize) -> f64 {
    let near = &columns[x.saturating_sub(1)..=(x + 1).min(columns.len() - 1)];
    near.iter().map(|column| column[c]).sum::<f64>() / (near.len() * rows) as f64
}

/// A pixel and its neighbours, row by row.
fn around(image: &Image<Linear>, x: usize, y: usize) -> impl Iterator<Item = (usize, usize)> {
    let columns = x.saturating_sub(1)..=(x + 1).min(image.width - 1);
    let rows = y.saturating_sub(1)..=(y + 1).min(image.height - 1);
    rows.flat_map(move |j| columns.clone().map(move |i| (i, j)))
}

impl Kind for ShadowRatio {
    const NAME: &'static str = "shadow-ratio";
    const VERSION: u32 = 6;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["without"])
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        if params.s_min > params.powered(params.s_max) {
            let text = "`s_min` exceeds the largest ratio that `s_max` allows, so all pixels would have the same factor";
            return Err(NodeError::new(text).at("s_min").hint("set `s_min` below `s_max`"));
        }
        Ok(())
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut tally = Tally::default();
        let (mut shadows, mut lights) = (Vec::new(), Vec::new());
        for view in &inputs.without.0 {
            cx.check()?;
            let without = linear(&view.picture, "without")?;
            let size = (without.width, without.height);
            let with = linear(matching(&inputs.with, "with", &view.name, size)?, "with")?;
            let [shadow, added] = params.view(&without, &with, &mut tally, cx)?;
            shadows.push(NamedImage { name: view.name.clone(), picture: shadow.into() });
            lights.push(NamedImage { name: view.name.clone(), picture: added.into() });
        }
        let mut notes = Notes::none();
        if params.form != RatioForm::Difference && params.shape(params.s_max) < 1.0 {
            let text = "`s_max` is below 1, which darkens the whole picture, even far from objects";
            notes.warning("darkened", text);
        }
        if let Some(idle) = params.idle() {
            let text = format!("`form: Difference` has no ratio and ignores {idle}; use `lambda`");
            notes.warning("no-ratio", text);
        }
        tally.report(params.s_max, &mut notes);
        Ok((Out { shadow: Arc::new(Images(shadows)), added: Arc::new(Images(lights)) }, notes))
    }
}

#[cfg(test)]
mod tests;
