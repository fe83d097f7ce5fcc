//! `shadow-ratio`: how much of the receiver's light the inserted objects leave.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes};

use crate::layers::{linear, matching};
use crate::num;
use crate::types::{Data, Image, Images, Linear, NamedImage};

engine::choices! {
    /// How the two renders become a ratio.
    pub enum RatioForm {
        /// (R1 + e) / (R0 + e) where e and the energy bound are fractions of the picture's mean R0, the
        /// mask judged on a 3x3 mean: exactly 1 where nothing changed, the same at any exposure.
        Stable,
        /// R1 / (R0 + epsilon) with absolute bounds judged pixel by pixel, as the paper prints it.
        Paper,
    }
}

engine::params! {
    /// The ratio of the receiver's light with and without the objects, per colour channel.
    ///
    /// Multiplied onto a photograph of the same place it darkens what lies in the object's shadow. Pixels
    /// with too little light for a ratio to mean anything are left alone (1). `gamma`, `s_min` and
    /// `lambda` shape the shadow: `1 - lambda * (1 - max(S^gamma, s_min))`.
    pub struct ShadowRatio {
        /// Which formula.
        form: RatioForm = RatioForm::Stable, other("Paper");
        /// Added to the denominator; a fraction of the mean of `without` for `Stable`, a radiance for `Paper`.
        epsilon: f64 = 1e-4, range(0.0, 1.0), other("0.05");
        /// Pixels with less light than this keep their brightness; in the unit of `epsilon`.
        min_energy: f64 = 1e-3, range(0.0, 1e6), other("0.9");
        /// Largest ratio; above 1 keeps light that the object adds by reflection.
        s_max: f64 = 1.0, range(0.0, 100.0), other("0.6");
        /// Exponent of the ratio; smaller is softer.
        gamma: f64 = 1.0, range(1e-3, 1.0), other("0.5");
        /// Darkest shadow that is let through.
        s_min: f64 = 0.0, range(0.0, 1.0), other("0.8");
        /// Strength of the shadow; 0 leaves the background as it is.
        lambda: f64 = 1.0, range(0.0, 1.0), other("0.5");
    }
}

engine::inputs! {
    /// Inputs of [`ShadowRatio`].
    pub struct In {
        /// The receiver without the objects (R0).
        without: Arc<Images>,
        /// The receiver with the objects, which the camera does not see (R1).
        with: Arc<Images>,
    }
}

engine::outputs! {
    /// Outputs of [`ShadowRatio`].
    pub struct Out {
        /// Factor of the background for each channel, 1 where there is no shadow.
        shadow: Arc<Images>,
    }
}

/// What became of the samples of one view.
#[derive(Default)]
struct Tally {
    samples: u64,
    dark: u64,
    clipped: u64,
    broken: u64,
}

impl ShadowRatio {
    /// The shaped factor of a raw ratio; the paper's parametric shadow shaping.
    fn shape(&self, ratio: f64) -> f64 {
        let powered = if self.gamma == 1.0 { ratio } else { num::pow(ratio, self.gamma) };
        1.0 - self.lambda * (1.0 - powered.max(self.s_min))
    }

    fn view(&self, without: &Image<Linear>, with: &Image<Linear>, tally: &mut Tally) -> Image<Data> {
        let (width, height) = (without.width, without.height);
        let mut shadow = Image::new(width, height, 3);
        // The level that fractions refer to: the mean over channels of every finite sample.
        let (mut sum, mut count) = (0.0_f64, 0_u64);
        for pixel in without.samples.chunks_exact(without.channels) {
            for &v in pixel[..3].iter().filter(|v| v.is_finite()) {
                sum += f64::from(v);
                count += 1;
            }
        }
        let unit = match self.form {
            RatioForm::Stable => sum / count.max(1) as f64,
            RatioForm::Paper => 1.0,
        };
        let (epsilon, least) = (self.epsilon * unit, self.min_energy * unit);
        for y in 0..height {
            for x in 0..width {
                let (r0, r1) = (without.rgb(x, y), with.rgb(x, y));
                for c in 0..3 {
                    tally.samples += 1;
                    let (a, b) = (f64::from(r0[c]), f64::from(r1[c]));
                    let ratio = if !(a.is_finite() && b.is_finite()) {
                        tally.broken += 1;
                        1.0
                    } else {
                        let (energy, ratio) = match self.form {
                            RatioForm::Stable => {
                                (neighbourhood(without, x, y, c), (b + epsilon) / (a + epsilon))
                            }
                            RatioForm::Paper => (a, b / (a + epsilon)),
                        };
                        if !(energy > 0.0 && energy >= least && ratio.is_finite()) {
                            tally.dark += 1;
                            1.0
                        } else {
                            tally.clipped += u64::from(ratio > self.s_max);
                            ratio.clamp(0.0, self.s_max)
                        }
                    };
                    shadow.pixel_mut(x, y)[c] = self.shape(ratio) as f32;
                }
            }
        }
        shadow
    }
}

/// Mean of the finite samples of one channel around a pixel.
fn neighbourhood(image: &Image<Linear>, x: usize, y: usize, c: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for j in y.saturating_sub(1)..=(y + 1).min(image.height - 1) {
        for i in x.saturating_sub(1)..=(x + 1).min(image.width - 1) {
            let v = image.pixel(i, j)[c];
            if v.is_finite() {
                sum += f64::from(v);
                count += 1.0;
            }
        }
    }
    sum / f64::max(count, 1.0)
}

impl Kind for ShadowRatio {
    const NAME: &'static str = "shadow-ratio";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut tally = Tally::default();
        let mut views = Vec::with_capacity(inputs.without.0.len());
        for view in &inputs.without.0 {
            cx.check()?;
            let without = linear(&view.picture, "without")?;
            let size = (without.width, without.height);
            let with = linear(matching(&inputs.with, "with", &view.name, size)?, "with")?;
            let shadow = params.view(&without, &with, &mut tally);
            views.push(NamedImage { name: view.name.clone(), picture: shadow.into() });
        }
        let mut notes = Notes::none();
        if tally.broken > 0 {
            notes
                .warning("not-finite", format!("{} samples are not finite and cast no shadow", tally.broken));
        }
        let share = |n: u64| 100.0 * n as f64 / tally.samples.max(1) as f64;
        notes.count(
            "too-dark",
            tally.dark,
            format_args!("samples ({:.2} %) are too dark for a ratio", share(tally.dark)),
        );
        notes.count(
            "clipped",
            tally.clipped,
            format_args!("samples ({:.2} %) exceed s_max", share(tally.clipped)),
        );
        Ok((Out { shadow: Arc::new(Images(views)) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;

    fn plain() -> ShadowRatio {
        ShadowRatio {
            form: RatioForm::Stable,
            epsilon: 1e-4,
            min_energy: 1e-3,
            s_max: 1.0,
            gamma: 1.0,
            s_min: 0.0,
            lambda: 1.0,
        }
    }

    fn image(values: &[f32]) -> Arc<Images> {
        let samples = values.iter().flat_map(|&v| [v; 3]).collect();
        Arc::new(Images::single("v", Image::<Linear>::from_samples(values.len(), 1, 3, samples)))
    }

    fn ratios(params: &ShadowRatio, r0: &[f32], r1: &[f32]) -> Vec<f32> {
        let inputs = In { without: image(r0), with: image(r1) };
        let (out, _) = ShadowRatio::run(params, inputs, &context()).expect("runs");
        out.shadow.0[0].picture.samples().chunks(3).map(|p| p[0]).collect()
    }

    // Rows 49 to 53 of the table of extremes.
    #[test]
    fn nothing_changed_gives_exactly_one_at_any_exposure() {
        for exposure in [1e-6_f32, 1.0, 1e6] {
            let r: Vec<f32> = [0.0, 1e-8, 0.3, 1.0, 7e4].iter().map(|v| v * exposure).collect();
            assert_eq!(ratios(&plain(), &r, &r), vec![1.0; 5]);
        }
    }

    #[test]
    fn exposure_does_not_change_the_ratio() {
        let (r0, r1) = ([0.5_f32, 0.2, 0.4, 0.1], [0.1_f32, 0.2, 0.3, 0.0]);
        let at = |k: f32| ratios(&plain(), &r0.map(|v| v * k), &r1.map(|v| v * k));
        for (a, b) in at(1.0).iter().zip(at(1024.0)) {
            assert!((a - b).abs() < 1e-6);
        }
    }

    #[test]
    fn dark_and_broken_samples_cast_no_shadow() {
        let r0 = [1.0, 1e-8, f32::NAN, f32::INFINITY, 1.0];
        let r1 = [0.5, 1e-3, 0.5, 0.5, f32::NAN];
        let paper = ShadowRatio { form: RatioForm::Paper, ..plain() };
        assert_eq!(ratios(&paper, &r0, &r1)[1..], [1.0; 4]);
        let stable = ratios(&plain(), &r0, &r1);
        assert_eq!(stable[2..], [1.0; 3]);
        assert!((stable[0] - 0.5).abs() < 1e-3);
    }

    // Row 54: monotone in each shaping parameter, and the ends are exact.
    #[test]
    fn shaping_follows_the_paper() {
        let p = plain;
        assert_eq!(ShadowRatio { lambda: 0.0, ..p() }.shape(0.1), 1.0);
        assert_eq!(ShadowRatio { s_min: 1.0, ..p() }.shape(0.1), 1.0);
        let s = ShadowRatio { gamma: 0.8, s_min: 0.05, lambda: 0.5, ..p() };
        let expected = 1.0 - 0.5 * (1.0 - num::pow(0.3, 0.8));
        assert!((s.shape(0.3) - expected).abs() < 1e-15);
        assert_eq!(s.shape(0.0), 1.0 - 0.5 * 0.95);
        for (low, high) in [(0.001, 0.5), (0.5, 1.0)] {
            assert!(
                ShadowRatio { gamma: low, ..p() }.shape(0.3) > ShadowRatio { gamma: high, ..p() }.shape(0.3)
            );
            assert!(
                ShadowRatio { lambda: low, ..p() }.shape(0.3)
                    > ShadowRatio { lambda: high, ..p() }.shape(0.3)
            );
        }
    }

    #[test]
    fn added_light_needs_s_max() {
        assert_eq!(ratios(&plain(), &[1.0], &[1.3]), [1.0]);
        let more = ratios(&ShadowRatio { s_max: 2.0, epsilon: 0.0, ..plain() }, &[1.0], &[1.3]);
        assert!((more[0] - 1.3).abs() < 1e-6);
    }
}
