//! `shadow-ratio`: how much of the receiver's light the inserted objects leave.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes, ViewCount};

use crate::color::luminance;
use crate::layers::{linear, matching};
use crate::light::level::level;
use crate::num;
use crate::types::{Data, Image, Images, Linear, NamedImage};

engine::choices! {
    /// How the two renders become a ratio.
    pub enum RatioForm {
        /// (R1 + e) / (R0 + e) where e and the energy bound are fractions of the picture's median R0, the
        /// mask judged on a 3x3 mean: exactly 1 where nothing changed, the same at any exposure.
        Stable,
        /// R1 / (R0 + epsilon) with absolute bounds judged pixel by pixel, as the paper prints it.
        Paper,
        /// No ratio: the light that the objects take or give, R1 - R0, is `added` (Debevec 1998). Right only
        /// where the receiver's albedo is that of the place; keeps light where R0 is too dark for a ratio.
        Difference,
        /// `Stable` where light is taken, and what is given is `added`.
        Hybrid,
    }
}

engine::choices! {
    /// Of what the ratio is taken.
    pub enum Channels {
        /// Of each colour channel: shadows take the colour of the light that is left.
        Each,
        /// Of luminance: grey shadows, for comparison and for renders too noisy in colour.
        Luminance,
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
        /// One ratio for each channel, or one for all.
        channels: Channels = Channels::Each, other("Luminance");
        /// Added to the denominator; a fraction of the median of `without` for `Stable`, a radiance for `Paper`.
        epsilon: f64 = 1e-4, range(0.0, 1.0), other("0.05");
        /// Pixels with less light than this keep their brightness; in the unit of `epsilon`. Up to twice as much the
        /// ratio fades in, so that the bound draws no line (not with `Paper`).
        min_energy: f64 = 1e-3, range(0.0, 1e6), other("0.9");
        /// Largest ratio; above 1 keeps light that the object adds by reflection, below 1 darkens the whole picture.
        /// `Hybrid` takes 1 at most.
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
        /// Linear light to add to the background after that, for `composite`; 0 where the form has none.
        added: Arc<Images>,
    }
}

/// What became of the samples of one view.
#[derive(Default)]
struct Tally {
    samples: u64,
    dark: u64,
    clipped: u64,
    /// Of the ratios that are clipped the sums of what they are made of: with the objects and without.
    bright: [f64; 2],
    broken: u64,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.dark += other.dark;
        self.clipped += other.clipped;
        for (sum, more) in self.bright.iter_mut().zip(other.bright) {
            *sum += more;
        }
        self.broken += other.broken;
    }
}

impl ShadowRatio {
    /// The shaped factor of a raw ratio; the paper's parametric shadow shaping.
    fn shape(&self, ratio: f64) -> f64 {
        1.0 - self.lambda * (1.0 - self.powered(ratio).max(self.s_min))
    }

    /// The parameters that are set and shape a ratio where none is taken.
    fn idle(&self) -> Option<String> {
        let unset = Self::default();
        let set = [
            ("`channels`", self.channels != unset.channels),
            ("`epsilon`", self.epsilon != unset.epsilon),
            ("`min_energy`", self.min_energy != unset.min_energy),
            ("`s_max`", self.s_max != unset.s_max),
            ("`gamma`", self.gamma != unset.gamma),
            ("`s_min`", self.s_min != unset.s_min),
        ];
        let names: Vec<&str> = set.into_iter().filter(|(_, set)| *set).map(|(name, _)| name).collect();
        (self.form == RatioForm::Difference && !names.is_empty()).then(|| names.join(", "))
    }

    fn powered(&self, ratio: f64) -> f64 {
        // Most of a picture is 1, as is every power of it.
        if self.gamma == 1.0 || ratio == 1.0 { ratio } else { num::pow(ratio, self.gamma) }
    }

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
            _ => level(
                without
                    .samples
                    .chunks_exact(without.channels)
                    .flat_map(|pixel| &pixel[..3])
                    .map(|v| f64::from(*v)),
            ),
        };
        let rows = cx.for_each_tile(height, |y| {
            let (mut shadow, mut added) = (Vec::with_capacity(3 * width), Vec::with_capacity(3 * width));
            let mut tally = Tally::default();
            for x in 0..width {
                let pair = [without.rgb(x, y), with.rgb(x, y)].map(|rgb| rgb.map(f64::from));
                for c in 0..3 {
                    let [a, b] = pair.map(|rgb| self.of(rgb, c));
                    tally.samples += 1;
                    let (mut factor, mut extra) = (1.0, 0.0);
                    if !(a.is_finite() && b.is_finite()) {
                        tally.broken += 1;
                    } else {
                        if self.form != RatioForm::Difference {
                            let energy = match self.form {
                                RatioForm::Paper => a,
                                _ => self.neighbourhood(without, x, y, c),
                            };
                            factor = self.ratio(a, b, energy, unit, &mut tally);
                        }
                        extra = match self.form {
                            RatioForm::Difference => pair[1][c] - pair[0][c],
                            RatioForm::Hybrid => (pair[1][c] - pair[0][c]).max(0.0),
                            RatioForm::Stable | RatioForm::Paper => 0.0,
                        };
                        extra = if extra.is_finite() { extra } else { 0.0 };
                    }
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

    /// The raw ratio of a channel, 1 where there is too little light for one.
    fn ratio(&self, a: f64, b: f64, energy: f64, unit: f64, tally: &mut Tally) -> f64 {
        let (epsilon, least) = (self.epsilon * unit, self.min_energy * unit);
        let (ratio, trust) = match self.form {
            RatioForm::Paper => (b / (a + epsilon), 1.0),
            _ => {
                let trust = if least > 0.0 { (energy / least - 1.0).clamp(0.0, 1.0) } else { 1.0 };
                ((b + epsilon) / (a + epsilon), trust)
            }
        };
        let trust = if energy > 0.0 && energy >= least && ratio.is_finite() { trust } else { 0.0 };
        tally.dark += u64::from(trust < 1.0);
        if trust == 0.0 {
            return 1.0;
        }
        // What is brighter with the objects is no ratio of `Hybrid`, which adds it.
        let (ratio, most) = match self.form {
            RatioForm::Hybrid => (ratio.min(1.0), self.s_max.min(1.0)),
            _ => (ratio, self.s_max),
        };
        if ratio > most {
            tally.clipped += 1;
            tally.bright[0] += b;
            tally.bright[1] += a;
        }
        1.0 + trust * (ratio.clamp(0.0, most) - 1.0)
    }

    /// What the ratio of a channel is taken of.
    fn of(&self, rgb: [f64; 3], c: usize) -> f64 {
        match self.channels {
            Channels::Each => rgb[c],
            Channels::Luminance => f64::from(luminance(rgb.map(|v| v as f32))),
        }
    }

    /// Mean of the finite values around a pixel: the mask must not be decided by the noise of one pixel.
    fn neighbourhood(&self, image: &Image<Linear>, x: usize, y: usize, c: usize) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for j in y.saturating_sub(1)..=(y + 1).min(image.height - 1) {
            for i in x.saturating_sub(1)..=(x + 1).min(image.width - 1) {
                let v = self.of(image.rgb(i, j).map(f64::from), c);
                if v.is_finite() {
                    sum += v;
                    count += 1.0;
                }
            }
        }
        sum / f64::max(count, 1.0)
    }
}

impl Kind for ShadowRatio {
    const NAME: &'static str = "shadow-ratio";
    const VERSION: u32 = 4;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["without"])
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        if params.s_min > params.powered(params.s_max) {
            let text = "`s_min` is above all that `s_max` lets through, so every pixel would be alike";
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
            let text = "`s_max` is below 1, so all of the picture is darkened, also where no object is near";
            notes.warning("darkened", text);
        }
        if let Some(idle) = params.idle() {
            let text = format!("`form: Difference` takes no ratio, so {idle} has no say; `lambda` has");
            notes.warning("no-ratio", text);
        }
        if tally.broken > 0 {
            notes
                .warning("not-finite", format!("{} samples are not finite and cast no shadow", tally.broken));
        }
        if tally.samples > 0 && tally.dark == tally.samples {
            let text = "no sample has light enough for a ratio, so the picture gets no shadow";
            notes.warning("all-dark", text);
        }
        let share = |n: u64| 100.0 * n as f64 / tally.samples.max(1) as f64;
        notes.count(
            "too-dark",
            tally.dark,
            format_args!("samples ({:.2} %) are too dark for a ratio, or for all of it", share(tally.dark)),
        );
        notes.count(
            "clipped",
            tally.clipped,
            format_args!(
                "samples ({:.2} %) are brighter with the objects than `s_max` = {} lets through: {:.3} times as bright in sum",
                share(tally.clipped),
                params.s_max,
                tally.bright[0] / tally.bright[1].max(f64::MIN_POSITIVE)
            ),
        );
        Ok((Out { shadow: Arc::new(Images(shadows)), added: Arc::new(Images(lights)) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{context, row};

    fn image(values: &[f32]) -> Arc<Images> {
        let samples = values.iter().flat_map(|&v| [v; 3]).collect();
        Arc::new(Images::single("v", Image::<Linear>::from_samples(values.len(), 1, 3, samples)))
    }

    fn ratios(params: &ShadowRatio, r0: &[f32], r1: &[f32]) -> Vec<f32> {
        let inputs = In { without: image(r0), with: image(r1) };
        let (out, _) = ShadowRatio::run(params, inputs, &context()).expect("runs");
        out.shadow.0[0].picture.samples().chunks(3).map(|p| p[0]).collect()
    }

    // What the camera sees of the sun says nothing of how dark a shadow is, and what is held back of a ratio is counted.
    #[test]
    fn the_sun_in_the_picture_puts_no_shadow_out() {
        let with_sun = |radiance: f32| {
            let (mut r0, mut r1) = ([0.05; 12], [0.05; 12]);
            (r0[11], r1[0], r1[11]) = (radiance, 0.02, radiance);
            ratios(&ShadowRatio::default(), &r0, &r1)
        };
        assert_eq!(with_sun(1e6), with_sun(0.05));
        assert!((with_sun(1e6)[0] - 0.4).abs() < 1e-3);
        let p = ShadowRatio { min_energy: 0.8, ..ShadowRatio::default() };
        let run =
            ShadowRatio::run(&p, In { without: image(&[1.0; 2]), with: image(&[0.5, 1.0]) }, &context());
        let told =
            run.expect("runs").1.iter().find(|note| note.id == "too-dark").map(|note| note.text.clone());
        assert!(told.is_some_and(|text| text.starts_with("6 samples (100.00 %)")));
    }

    /// A difference has no use for what shapes a ratio, and says so of what is set.
    #[test]
    fn what_shapes_no_difference_is_told() {
        let difference = || ShadowRatio { form: RatioForm::Difference, ..ShadowRatio::default() };
        let set = ShadowRatio { gamma: 0.5, s_max: 2.0, ..difference() };
        let lambda = ShadowRatio { lambda: 0.5, ..difference() };
        for (params, expected) in [
            (difference(), None),
            (lambda, None),
            (ShadowRatio { form: RatioForm::Stable, ..set.clone() }, None),
            (set, Some("`form: Difference` takes no ratio, so `s_max`, `gamma` has no say; `lambda` has")),
        ] {
            let inputs = In { without: image(&[0.5; 4]), with: image(&[0.4; 4]) };
            let (_, notes) = ShadowRatio::run(&params, inputs, &context()).expect("runs");
            let told = notes.iter().find(|note| note.id == "no-ratio").map(|note| note.text.as_str());
            assert_eq!(told, expected);
        }
    }

    /// A few samples on black do not rule how much brighter the others are.
    #[test]
    fn how_much_brighter_is_told_by_sums() {
        let (mut r0, mut r1) = ([1.0; 100], [1.2; 100]);
        (r0[0], r1[0]) = (0.002, 1.0);
        let inputs = In { without: image(&r0), with: image(&r1) };
        let params = ShadowRatio { min_energy: 0.0, ..ShadowRatio::default() };
        let (_, notes) = ShadowRatio::run(&params, inputs, &context()).expect("runs");
        let told = notes.iter().find(|note| note.id == "clipped").expect("told");
        assert!(told.text.contains("1.210 times"), "{}", told.text);
    }

    // `Hybrid` adds what is brighter, so that nothing is clipped.
    #[test]
    fn what_is_added_is_not_told_as_clipped() {
        let clipped = |form, s_max| {
            let p = ShadowRatio { form, s_max, ..ShadowRatio::default() };
            let run = ShadowRatio::run(&p, In { without: image(&[1.0]), with: image(&[2.0]) }, &context());
            run.expect("runs").1.iter().any(|note| note.id == "clipped" && !note.text.starts_with("0 "))
        };
        assert!(clipped(RatioForm::Stable, 1.0) && !clipped(RatioForm::Stable, 3.0));
        assert!(!clipped(RatioForm::Hybrid, 100.0) && clipped(RatioForm::Hybrid, 0.5));
    }

    /// A shadow that is one grey everywhere is refused, and a picture that is darkened everywhere is told.
    /// Mutation: `powered` left out of `check`.
    #[test]
    fn bounds_that_leave_no_shadow_are_told() {
        let of = |s_min, s_max, gamma| ShadowRatio { s_min, s_max, gamma, ..ShadowRatio::default() };
        for (s_min, s_max, gamma, good) in
            [(0.9, 0.5, 1.0, false), (0.6, 0.5, 0.5, true), (0.8, 0.5, 0.5, false), (1.0, 1.0, 1.0, true)]
        {
            let checked = ShadowRatio::check(&of(s_min, s_max, gamma));
            assert_eq!(checked.is_ok(), good, "{s_min} of {s_max}^{gamma}");
        }
        let told = |p: &ShadowRatio| {
            let run = ShadowRatio::run(p, In { without: image(&[1.0]), with: image(&[1.0]) }, &context());
            run.expect("runs").1.iter().any(|note| note.id == "darkened")
        };
        assert!(told(&of(0.0, 0.5, 1.0)) && !told(&ShadowRatio::default()) && !told(&of(0.0, 2.0, 1.0)));
        assert!(!told(&ShadowRatio { form: RatioForm::Difference, ..of(0.0, 0.5, 1.0) }));
    }

    #[test]
    fn row_49_nothing_over_nothing_is_one() {
        for form in [RatioForm::Stable, RatioForm::Paper, RatioForm::Hybrid] {
            let p = ShadowRatio { form, ..ShadowRatio::default() };
            assert_eq!(ratios(&p, &[0.0; 9], &[0.0; 9]), [1.0; 9]);
            let run = ShadowRatio::run(&p, In { without: image(&[0.0]), with: image(&[0.0]) }, &context());
            assert!(run.expect("runs").1.iter().any(|note| note.id == "all-dark"));
            assert_eq!(ratios(&p, &[0.0, 1.0], &[0.0, 1.0])[0], 1.0);
            // The noise of what is next to black, beside what is lit.
            let (r0, r1) = ([1.0, 1e-8, 1e-8, 1e-8_f32], [0.5, 1e-3, 1e-3, 1e-3_f32]);
            assert_eq!(ratios(&ShadowRatio { s_max: 100.0, ..p }, &r0, &r1)[2..], [1.0; 2]);
        }
    }

    #[test]
    fn row_52_exposure_does_not_change_the_ratio() {
        for exposure in [1e-6_f32, 1.0, 1e6] {
            let r: Vec<f32> = [0.0, 1e-8, 0.3, 1.0, 7e4].iter().map(|v| v * exposure).collect();
            assert_eq!(ratios(&ShadowRatio::default(), &r, &r), vec![1.0; 5]);
        }
        let (r0, r1) = ([0.5_f32, 0.2, 0.4, 0.1], [0.1_f32, 0.2, 0.3, 0.0]);
        let at = |k: f32| ratios(&ShadowRatio::default(), &r0.map(|v| v * k), &r1.map(|v| v * k));
        let change =
            |k: f32| at(1.0).iter().zip(at(k)).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        row(52, "change of the ratio at 1e-6 and 1e6 of the light", change(1e-6).max(change(1e6)), 1e-6);
    }

    /// They are counted, and add no light.
    #[test]
    fn row_53_dark_and_broken_samples_cast_no_shadow() {
        let r0 = [1.0, 1e-8, f32::NAN, f32::INFINITY, 1.0];
        let r1 = [0.5, 1e-3, 0.5, 0.5, f32::NAN];
        let paper = ShadowRatio { form: RatioForm::Paper, ..ShadowRatio::default() };
        assert_eq!(ratios(&paper, &r0, &r1)[1..], [1.0; 4]);
        let stable = ratios(&ShadowRatio::default(), &r0, &r1);
        assert_eq!(stable[2..], [1.0; 3]);
        assert!((stable[0] - 0.5).abs() < 1e-3);
        let difference = ShadowRatio { form: RatioForm::Difference, ..ShadowRatio::default() };
        let (out, notes) =
            ShadowRatio::run(&difference, In { without: image(&r0), with: image(&r1) }, &context())
                .expect("runs");
        assert!(notes.iter().any(|n| n.id == "not-finite" && n.text.starts_with("9 ")));
        assert_eq!(out.added.0[0].picture.samples()[6..], [0.0; 9]);
        // What surrounds a broken pixel is what it is without it, though neighbours decide together what is too dark.
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for (r0, r1) in [(bad, 0.5), (0.5, bad), (bad, bad)] {
                let (mut without, mut with) = ([0.5; 7], [0.2; 7]);
                (without[3], with[3]) = (r0, r1);
                let mut expected = ratios(&ShadowRatio::default(), &[0.5; 7], &[0.2; 7]);
                expected[3] = 1.0;
                assert_eq!(ratios(&ShadowRatio::default(), &without, &with), expected);
            }
        }
    }

    /// Monotone in each shaping parameter, and the ends are exact.
    #[test]
    fn row_54_shaping_follows_the_paper() {
        let p = ShadowRatio::default;
        assert_eq!(ShadowRatio { lambda: 0.0, ..p() }.shape(0.1), 1.0);
        assert_eq!(ShadowRatio { s_min: 1.0, ..p() }.shape(0.1), 1.0);
        let s = ShadowRatio { gamma: 0.8, s_min: 0.05, lambda: 0.5, ..p() };
        let expected = 1.0 - 0.5 * (1.0 - num::pow(0.3, 0.8));
        assert!((s.shape(0.3) - expected).abs() < 1e-15);
        assert_eq!(s.shape(0.0), 1.0 - 0.5 * 0.95);
        let steps = || (0..=100).map(|k| f64::from(k) / 100.0);
        for ratio in steps() {
            let falls = |of: &dyn Fn(f64) -> ShadowRatio| {
                let shaped: Vec<f64> = steps().map(|v| of(v).shape(ratio)).collect();
                assert!(shaped.iter().all(|s| (0.0..=1.0).contains(s)), "{ratio}: {shaped:?}");
                shaped.is_sorted_by(|a, b| a >= b)
            };
            assert!(falls(&|v| ShadowRatio { gamma: v.max(1e-3), ..p() }));
            assert!(falls(&|lambda| ShadowRatio { lambda, ..p() }));
            assert!(falls(&|v| ShadowRatio { s_min: 1.0 - v, ..p() }));
            assert!(steps().all(|other| other > ratio || s.shape(other) <= s.shape(ratio)));
            assert!(ShadowRatio { gamma: 1e-3, ..p() }.shape(ratio) >= if ratio > 0.0 { 0.995 } else { 0.0 });
        }
    }

    /// Without it, it is cut, and the share of it told.
    #[test]
    fn row_51_added_light_needs_s_max() {
        let inputs = In { without: image(&[1.0; 4]), with: image(&[1.3, 0.5, 1.0, 0.9]) };
        let (out, notes) = ShadowRatio::run(&ShadowRatio::default(), inputs, &context()).expect("runs");
        assert_eq!(out.shadow.0[0].picture.samples()[..3], [1.0; 3]);
        let told = notes.iter().find(|note| note.id == "clipped").map(|note| note.text.as_str());
        assert!(
            told.is_some_and(|text| text.starts_with("3 samples (25.00 %)") && text.contains("1.300")),
            "{told:?}"
        );
        let more =
            ratios(&ShadowRatio { s_max: 2.0, epsilon: 0.0, ..ShadowRatio::default() }, &[1.0], &[1.3]);
        row(51, "error of a ratio above 1", f64::from((more[0] - 1.3).abs()), 1e-6);
    }

    #[test]
    fn row_55_parameters_out_of_range_are_named() {
        for (field, values) in [
            ("epsilon", ["-1e-9", "1.1"]),
            ("min_energy", ["-1.0", "1e7"]),
            ("s_max", ["-0.1", "101.0"]),
            ("gamma", ["0.0", "1.01"]),
            ("s_min", ["-0.1", "1.01"]),
            ("lambda", ["-0.1", "1.01"]),
        ] {
            for value in values.into_iter().chain(["NaN", "inf"]) {
                let graph = format!(
                    "Graph(version: 1, scene: (up: \"+z\"), nodes: (\n\
                     a: LoadImage(path: \"a.exr\"),\n\
                     s: ShadowRatio(without: \"a\", with: \"a\", {field}: {value}),\n))"
                );
                let source = engine::Source::new("graph.ron", &*graph);
                let parsed = engine::Graph::parse(source, &crate::registry(), engine::SourceRoot::new("."));
                let told = parsed.err().map(|errors| errors.to_string()).unwrap_or_default();
                assert!(
                    told.contains(field) && told.contains("graph.ron:3"),
                    "{field}: {value} gives {told:?}"
                );
            }
        }
    }

    /// As the bound of energy is swept no ratio jumps by more than a part of the sweep.
    #[test]
    fn row_50_the_mask_has_no_edge() {
        let at = |least: f64| {
            ratios(&ShadowRatio { min_energy: least, ..ShadowRatio::default() }, &[0.5; 3], &[0.1; 3])[1]
        };
        let sweep: Vec<f32> = (0..200).map(|k| at(f64::from(k) / 100.0)).collect();
        assert!(sweep[0] < 0.21 && sweep[199] == 1.0);
        assert!(sweep.windows(2).all(|w| w[1] >= w[0]), "{sweep:?}");
        let jump = sweep.windows(2).map(|w| f64::from(w[1] - w[0])).fold(0.0, f64::max);
        row(50, "largest step of the ratio over 200 bounds of energy", jump, 0.04);
        // Nor does the noise of one pixel decide: among lit ones it has their ratio.
        let lit = ShadowRatio { epsilon: 0.0, ..ShadowRatio::default() };
        for ratio in ratios(&lit, &[0.5, 1e-5, 0.5], &[0.25, 5e-6, 0.25]) {
            assert!((ratio - 0.5).abs() < 1e-6, "{ratio}");
        }
    }

    #[test]
    fn difference_and_hybrid_add_light() {
        let (r0, r1) = ([0.5, 0.5, 0.0_f32], [0.2, 0.9, 0.3_f32]);
        let out = |form| {
            let inputs = In { without: image(&r0), with: image(&r1) };
            let (out, _) =
                ShadowRatio::run(&ShadowRatio { form, ..ShadowRatio::default() }, inputs, &context())
                    .expect("runs");
            let first = |images: &Images| -> Vec<f32> {
                images.0[0].picture.samples().chunks(3).map(|p| p[0]).collect()
            };
            (first(&out.shadow), first(&out.added))
        };
        assert_eq!(out(RatioForm::Stable).1, [0.0; 3]);
        let (shadow, added) = out(RatioForm::Difference);
        assert_eq!(shadow, [1.0; 3]);
        for (a, (x, y)) in added.iter().zip(r1.iter().zip(&r0)) {
            assert_eq!(*a, x - y);
        }
        let (shadow, added) = out(RatioForm::Hybrid);
        assert!((shadow[0] - 0.4).abs() < 1e-3 && shadow[1] == 1.0);
        assert!(added[0] == 0.0 && (added[1] - 0.4).abs() < 1e-6 && (added[2] - 0.3).abs() < 1e-6);
    }

    // A luminance ratio loses the colour of what is left and keeps its amount.
    #[test]
    fn luminance_is_grey() {
        let colour =
            |v: [f32; 3]| Arc::new(Images::single("v", Image::<Linear>::from_samples(1, 1, 3, v.to_vec())));
        let grey = ShadowRatio { channels: Channels::Luminance, epsilon: 0.0, ..ShadowRatio::default() };
        let inputs = In { without: colour([0.5, 0.5, 0.5]), with: colour([0.1, 0.2, 0.4]) };
        let (out, _) = ShadowRatio::run(&grey, inputs, &context()).expect("runs");
        let s = out.shadow.0[0].picture.samples();
        let expected = luminance([0.2, 0.4, 0.8]);
        assert!(s.iter().all(|v| (v - expected).abs() < 1e-6), "{s:?} {expected}");
    }
}
