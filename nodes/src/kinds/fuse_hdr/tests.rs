use super::*;
use engine::{Kind, Up};
use glam::DVec3;
use scene::math::color::srgb_from_linear;
use scene::types::{Cell, Data, Srgb};
use testing::context as cx;
use testing::row;

mod energy;
mod sky;

const W: usize = 64;
const H: usize = 32;

fn params() -> FuseHdr {
    FuseHdr {
        threshold: 0.9,
        blend: Blend::Ramp,
        transfer: Transfer::Srgb,
        gain: Gain::Direct,
        hue: Hue::Predicted,
        feather_deg: 0.0,
        ground_albedo: None,
    }
}

fn paper() -> FuseHdr {
    FuseHdr { blend: Blend::Hard, transfer: Transfer::Gamma24, gain: Gain::Brackets, ..params() }
}

fn encode(transfer: Transfer, linear: f32) -> f32 {
    match transfer {
        Transfer::Srgb => srgb_from_linear(linear),
        Transfer::Gamma24 => num::powf(linear, 1.0 / 2.4),
    }
}

/// Photographs of known light, at EV 0 and at `evs`, by a camera with the given transfer curve. Samples are rounded
/// to codes from 0 to `bits`, or not rounded if `bits` is `None`.
fn photograph(
    light: &dyn Fn(usize) -> [f32; 3],
    evs: &[f64],
    transfer: Transfer,
    bits: Option<f32>,
) -> (Arc<Panorama>, Arc<Brackets>) {
    let take = |ev: f64| {
        let scale = num::f64::exp2(ev) as f32;
        let sample = |v: f32| {
            let code = encode(transfer, (v * scale).min(1.0));
            bits.map_or(code, |top| (code * top).round() / top)
        };
        Image::<Srgb>::from_samples(W, H, 3, (0..W * H).flat_map(|at| light(at).map(sample)).collect())
    };
    let gain = |at: usize| {
        let (full, held) = (luminance(light(at)), luminance(light(at).map(|v| v.min(1.0))));
        num::f32::log2((full / held.max(1e-20)).max(1.0))
    };
    let pano = Panorama {
        image: take(0.0).into(),
        alpha: Image::from_samples(W, H, 1, vec![1.0; W * H]),
        up: Up::PlusZ,
        origin: Some(DVec3::new(1.0, 2.0, 3.0)),
        turned_deg: 0.0,
    };
    let brackets = Brackets {
        log2_gain: Image::<Data>::from_samples(W, H, 1, (0..W * H).map(gain).collect()),
        colour: None,
        evs: evs.to_vec(),
        exposures: evs.iter().map(|&ev| take(ev)).collect(),
        taken: Taken::Display,
        report: Report::default(),
    };
    (Arc::new(pano), Arc::new(brackets))
}

fn run(params: &FuseHdr, (base, brackets): (Arc<Panorama>, Arc<Brackets>)) -> (Out, Notes) {
    FuseHdr::run(params, In { base, brackets }, &cx()).expect("runs")
}

/// Grey that starts at 2^-6 and doubles every few pixels, followed by a lamp of radiance 40.
fn ramp(at: usize) -> [f32; 3] {
    let v = if at % W == 63 { 40.0 } else { num::f32::exp2((at % W) as f32 / 10.0 - 6.0) };
    [v, v, v]
}

// The paper's equations for one pixel, in f64.
fn paper_pixel(codes: &[[f64; 3]], evs: &[f64]) -> [f64; 3] {
    let linear: Vec<[f64; 3]> = codes.iter().map(|c| c.map(|v| num::pow(v, 2.4))).collect();
    let lum = |c: [f64; 3]| 0.21267 * c[0] + 0.71516 * c[1] + 0.07217 * c[2];
    let mut e = lum(linear[0]) * num::f64::exp2(-evs[0]);
    for i in 1..codes.len() {
        if lum(linear[i]) <= 0.9 {
            e = lum(linear[i]) * num::f64::exp2(-evs[i]);
        }
    }
    let last = linear[codes.len() - 1];
    last.map(|v| if lum(last) > 0.0 { e / lum(last) * v } else { 0.0 })
}

// Hidden light gets the predicted colour, and the light that the panorama shows keeps its own. The luminance does not
// depend on the colour. This test fails if `apply` ignores `colour`, or if `Hue::Base` does not.
#[test]
fn hidden_light_has_the_predicted_colour() {
    let light = |at: usize| if at == 100 { [40.0; 3] } else { [0.2, 0.3, 0.1] };
    let (base, brackets) = photograph(&light, &[-3.0], Transfer::Srgb, None);
    let warm = [2.0_f32, 1.0, 0.25];
    let warm = warm.map(|v| v / luminance(warm));
    let mut colour = Image::<Data>::new(W, H, 3);
    colour.samples[300..303].copy_from_slice(&warm);
    let brackets = Brackets { colour: Some(colour), taken: Taken::Derived, ..(*brackets).clone() };
    let brackets = Arc::new(brackets);
    for (hue, wanted) in [
        (Hue::Predicted, warm.map(|v| 1.0 + 39.0 * v)),
        (Hue::Exposures, warm.map(|v| 1.0 + 39.0 * v)),
        (Hue::Base, [40.0; 3]),
    ] {
        let (out, _) = run(&FuseHdr { hue, ..params() }, (base.clone(), brackets.clone()));
        let found = out.env.image.rgb(100 % W, 100 / W);
        assert!((0..3).all(|c| (found[c] / wanted[c] - 1.0).abs() < 1e-4), "{hue:?}: {found:?} {wanted:?}");
        assert!((luminance(found) / 40.0 - 1.0).abs() < 1e-4);
        let other = out.env.image.rgb(3, 4);
        assert!((0..3).all(|c| (other[c] - light(0)[c]).abs() < 1e-5), "{other:?}");
    }
    // Without a prediction, the colour of the panorama counts.
    let plain = Arc::new(Brackets { colour: None, ..(*brackets).clone() });
    let (out, _) = run(&params(), (base, plain));
    assert!(out.env.image.rgb(100 % W, 100 / W).iter().all(|v| (v / 40.0 - 1.0).abs() < 1e-4));
}

#[test]
fn paper_mode_is_the_papers_equations() {
    let light = |at: usize| {
        let v = ramp(at)[0];
        [v, 0.8 * v, if at.is_multiple_of(3) { 0.0 } else { 0.3 * v }]
    };
    let evs = [-6.0, -3.0];
    let (base, brackets) = photograph(&light, &evs, Transfer::Gamma24, Some(255.0));
    let (out, _) = run(&paper(), (base.clone(), brackets.clone()));
    for at in 0..W * H {
        let code = |picture: &[f32]| [0, 1, 2].map(|c| f64::from(picture[3 * at + c]));
        let codes = [
            code(&brackets.exposures[0].samples),
            code(&brackets.exposures[1].samples),
            code(base.image.samples()),
        ];
        let want = paper_pixel(&codes, &[-6.0, -3.0, 0.0]);
        for (found, want) in out.env.image.samples[3 * at..].iter().zip(want) {
            assert!((f64::from(*found) - want).abs() <= 1e-6 * want.max(1e-3), "{at}: {found} {want}");
        }
    }
    assert_eq!(out.env.origin, Some(DVec3::new(1.0, 2.0, 3.0)));
}

/// A real series of exposures recovers known light within half a code of the exposure that shows it.
#[test]
fn a_true_bracket_is_recovered_within_quantisation() {
    for gain in [Gain::Brackets, Gain::Direct] {
        let taken = photograph(&ramp, &[-6.0, -3.0], Transfer::Srgb, Some(255.0));
        let (out, notes) = run(&FuseHdr { gain, ..params() }, taken);
        let decode = |code: f64| f64::from(Transfer::Srgb.linear(code as f32));
        let errors = (0..W * H).map(|at| {
            let (found, want) = (f64::from(out.env.image.samples[3 * at]), f64::from(ramp(at)[0]));
            // Half a code, upwards, of the brightest exposure that shows it below the threshold.
            let shown =
                [1.0, 0.125, 1.0 / 64.0].into_iter().find(|scale| want * scale <= 0.9).expect("one does");
            let code = f64::from(srgb_from_linear((want * shown) as f32));
            (found - want).abs() * shown / (decode(code + 0.5 / 255.0) - decode(code))
        });
        let what = "error over that of half a code of the exposure that shows it, to 2^6";
        row(32, what, errors.fold(0.0, f64::max), 1.001);
        assert!(notes.iter().all(|note| note.id != "saturated-at-darkest"));
    }
}

#[test]
fn what_is_not_clipped_is_kept_to_the_bit() {
    let (base, brackets) = photograph(&ramp, &[-6.0], Transfer::Srgb, None);
    let want = linear_pixels(&base.image, Transfer::Srgb);
    let all = [(Blend::Hard, Gain::Direct), (Blend::Ramp, Gain::Brackets), (Blend::Ramp, Gain::Direct)];
    for (blend, gain) in all {
        let (out, _) = run(&FuseHdr { blend, gain, ..params() }, (base.clone(), brackets.clone()));
        for (at, rgb) in want.rgb.iter().enumerate().filter(|(_, rgb)| max3(**rgb) <= 0.9) {
            assert_eq!(out.env.image.samples[3 * at..3 * at + 3], rgb[..], "{blend:?} {gain:?}");
        }
    }
}

#[test]
fn black_is_black_and_broken_samples_are_reported() {
    let (base, brackets) = photograph(&|_| [0.0; 3], &[-3.0], Transfer::Srgb, None);
    let (out, _) = run(&paper(), (base.clone(), brackets.clone()));
    assert!(out.env.image.samples.iter().all(|&v| v == 0.0));
    let mut broken = (*base).clone();
    let mut samples = vec![0.0; W * H * 3];
    samples[..4].copy_from_slice(&[f32::NAN, f32::INFINITY, -0.5, 1e-12]);
    broken.image = Image::<Srgb>::from_samples(W, H, 3, samples).into();
    let (out, notes) = run(&params(), (Arc::new(broken), brackets));
    assert!(out.env.image.samples.iter().all(|v| v.is_finite() && *v >= 0.0));
    assert!(notes.iter().any(|n| n.id == "not-finite") && notes.iter().any(|n| n.id == "below-zero"));
}

/// Colours near black are kept bit for bit, whatever the exposures or gains, because values near black are never
/// divided.
#[test]
fn the_darkest_values_keep_their_colour() {
    let light = |at: usize| {
        let v = num::f32::exp2(-40.0 + (at % W) as f32 * 0.3);
        [v, 0.5 * v, 0.25 * v]
    };
    let (base, mut wrong) = photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None);
    let claims = Arc::make_mut(&mut wrong);
    claims.log2_gain.samples.fill(8.0);
    claims.exposures.iter_mut().for_each(|exposure| exposure.samples.fill(0.5));
    let want = linear_pixels(&base.image, Transfer::Srgb);
    for gain in [Gain::Direct, Gain::Brackets] {
        for blend in [Blend::Ramp, Blend::Hard] {
            let params = FuseHdr { gain, blend, ..params() };
            let (out, _) = run(&params, (base.clone(), wrong.clone()));
            assert!(out.env.image.samples.iter().zip(want.rgb.as_flattened()).all(|(a, b)| a == b));
        }
    }
}

/// The light of a pixel that is white in every exposure is a lower bound, which is reported.
#[test]
fn saturation_at_the_darkest_exposure_is_reported() {
    let taken =
        photograph(&|at| if at == 9 { [5000.0; 3] } else { [0.2; 3] }, &[-6.0, -3.0], Transfer::Srgb, None);
    let (out, notes) = run(&FuseHdr { gain: Gain::Brackets, ..params() }, taken);
    assert!((out.env.image.samples[27] - 64.0).abs() < 1e-3);
    assert!(notes.iter().any(|n| n.id == "saturated-at-darkest" && n.text.ends_with("(count: 1)")));
    assert!(matches!(out.report.tables[0].rows[0].last(), Some(Cell::Number(share)) if *share > 0.9));
}

/// A darker exposure that contradicts the panorama cannot make a light darker or negative.
#[test]
fn a_wrongly_dark_prediction_changes_nothing() {
    let (base, brackets) = photograph(&|_| [1.0; 3], &[-3.0], Transfer::Srgb, None);
    let mut wrong = (*brackets).clone();
    wrong.exposures[0].samples.fill(0.0);
    let (out, _) = run(&FuseHdr { gain: Gain::Brackets, ..params() }, (base, Arc::new(wrong)));
    assert!(out.env.image.samples.iter().all(|&v| v == 1.0));
    // For random exposures, brighter or darker: no unclipped pixel becomes darker than the panorama.
    let (base, brackets) = photograph(&ramp, &[-6.0, -3.0], Transfer::Srgb, Some(255.0));
    let own = linear_pixels(&base.image, Transfer::Srgb);
    let mut random = (0..)
        .map(|i: u32| render::geometry::sampling::Points::new(11, i).bits(0)[0] as f32 / 4_294_967_296.0);
    let mut wrong = (*brackets).clone();
    for exposure in &mut wrong.exposures {
        exposure.samples.iter_mut().zip(&mut random).for_each(|(v, number)| *v = number);
    }
    wrong.log2_gain.samples.iter_mut().zip(&mut random).for_each(|(v, number)| *v = 20.0 * number);
    let wrong = Arc::new(wrong);
    for (gain, hue) in
        [(Gain::Brackets, Hue::Base), (Gain::Brackets, Hue::Exposures), (Gain::Direct, Hue::Base)]
    {
        let (out, _) = run(&FuseHdr { gain, hue, ..params() }, (base.clone(), wrong.clone()));
        for (fused, own) in out.env.image.samples.as_chunks::<3>().0.iter().zip(&own.rgb) {
            assert!(fused.iter().all(|v| v.is_finite() && *v >= 0.0), "{fused:?}");
            assert!(luminance(*fused) >= luminance(*own) * (1.0 - 1e-6), "{fused:?} of {own:?}");
            assert!(max3(*own) > 0.9 || fused == own);
        }
    }
}

/// The result is continuous over the ramp, and switches at the threshold with `Hard`.
#[test]
fn the_ramp_is_continuous_and_the_step_is_strict() {
    let one = |value: f32, blend: Blend| {
        let own = Fused { luminance: value.into(), source: 1, saturated: false };
        let darker = Fused { luminance: 30.0, source: 0, saturated: false };
        merge(&FuseHdr { blend, ..params() }, darker, [value; 3], own, false).luminance
    };
    let mut before = one(0.85, Blend::Ramp);
    for i in 1..=20_000 {
        let now = one(0.85 + 0.15 * i as f32 / 20_000.0, Blend::Ramp);
        assert!(now >= before && now - before < 0.01, "{i}");
        before = now;
    }
    assert_eq!(before, 30.0);
    // Strict to the bit: at a luminance of the threshold and one ulp below it is kept, one ulp above it is not.
    let grey = 0.9 / luminance([1.0; 3]);
    let (threshold, own) = (luminance([grey; 3]), Fused { luminance: 1.0, source: 1, saturated: false });
    let darker = Fused { luminance: 30.0, source: 0, saturated: false };
    for (threshold, kept) in [(threshold.next_up(), true), (threshold, true), (threshold.next_down(), false)]
    {
        let merged =
            merge(&FuseHdr { blend: Blend::Hard, threshold, ..params() }, darker, [grey; 3], own, false);
        assert_eq!(merged.luminance == 1.0, kept, "{threshold}");
    }
}

/// A light of the same energy in one pixel or in five gives the same irradiance.
#[test]
fn energy_does_not_depend_on_how_many_pixels_hold_it() {
    let power = |n: usize| {
        let light =
            move |at: usize| if (at / W == 10) && at % W < n { [1e5 / n as f32; 3] } else { [0.1; 3] };
        let (out, _) = run(&params(), photograph(&light, &[], Transfer::Srgb, None));
        let Cell::Number(power) = out.report.tables[1].rows[1][1] else { panic!("a number") };
        power
    };
    row(33, "relative change of irradiance", (power(1) / power(5) - 1.0).abs(), 0.01);
}

// Without exposures the panorama is the darkest picture, and its white is a lower bound. This test fails with
// `kept(false)` in that case.
#[test]
fn a_bracket_of_no_exposures_is_reported() {
    let taken = photograph(&ramp, &[], Transfer::Srgb, Some(255.0));
    let (out, notes) = run(&FuseHdr { gain: Gain::Brackets, ..params() }, taken);
    let white = (0..W * H).filter(|&at| ramp(at)[0] >= 1.0).count();
    let reported =
        notes.iter().find(|n| n.id == "saturated-at-darkest").map(|n| n.text.clone()).unwrap_or_default();
    assert!(reported.ends_with(&format!("(count: {white})")), "{reported}");
    assert_eq!(out.report.tables[1].rows[1][4], Cell::Count(0));
}

// A threshold above the value at which a lamp clips leaves out the light predicted for it; so does a prediction for
// another panorama. This test fails if `!used[at]` is changed to `used[at]`.
#[test]
fn predicted_light_that_is_left_out_is_reported() {
    let (base, brackets) =
        photograph(&|at| if at == 9 { [0.97; 3] } else { [0.2; 3] }, &[], Transfer::Srgb, None);
    let mut gain = (*brackets).clone();
    gain.log2_gain.samples[9] = 5.0;
    for (threshold, reported) in [(0.9, false), (0.98, true)] {
        let params = FuseHdr { threshold, ..params() };
        let (out, notes) = run(&params, (base.clone(), Arc::new(gain.clone())));
        let note = notes.iter().find(|n| n.id == "prediction-unused").map(|n| n.text.clone());
        assert_eq!(note.is_some_and(|text| text.starts_with("100.0 %")), reported);
        // The report has the light as predicted, and the rest after fusion. This test fails without `&self.left` in
        // `groups`.
        let steps = &out.report.tables[2].rows[0];
        let power = |step: usize| if let Cell::Number(v) = steps[step] { v } else { panic!("a number") };
        assert!(power(2) > power(1), "{steps:?}");
        assert_eq!(power(3) == power(1), reported, "{steps:?}");
    }
}

// Where no light was predicted nothing changes, bit for bit, even if `threshold` is below the clipping value. This
// test fails without the arm for `Taken::Derived` in `fuse`, or without `fused == base` in `recolour`.
#[test]
fn what_got_no_light_is_kept_to_the_bit() {
    let light = |at: usize| {
        [0.90 + 0.1 * (at % W) as f32 / W as f32, 0.7, 0.5].map(|v| if at == 9 { 9.0 } else { v })
    };
    let (base, brackets) = photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None);
    let derived = Arc::new(Brackets { taken: Taken::Derived, ..(*brackets).clone() });
    let own = linear_pixels(&base.image, Transfer::Srgb).rgb;
    for (gain, brackets) in [(Gain::Direct, &derived), (Gain::Brackets, &derived), (Gain::Direct, &brackets)]
    {
        let params = FuseHdr { gain, hue: Hue::Exposures, ..params() };
        let (out, _) = run(&params, (base.clone(), brackets.clone()));
        assert!((0..W * H).all(|at| at == 9 || out.env.image.rgb(at % W, at / W) == own[at]), "{gain:?}");
        assert_eq!(out.report.tables[0].rows.len(), 1);
    }
}

// Predicted exposures have the colour of the panorama, with any transfer curve: taking the colour from them changes
// no bit. This test fails if `Taken::Derived` is not checked for `hue`.
#[test]
fn the_hue_of_derived_exposures_changes_no_bit() {
    let light = |at: usize| match at {
        9 => [6.0, 3.0, 0.98],
        _ => [0.9 + 0.06 * (at % W) as f32 / W as f32, 0.7, 0.3],
    };
    for transfer in [Transfer::Srgb, Transfer::Gamma24] {
        let (base, brackets) = photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None);
        let mut brackets = Brackets { taken: Taken::Derived, ..(*brackets).clone() };
        for (gain, rgb) in
            brackets.log2_gain.samples.iter_mut().zip(linear_pixels(&base.image, Transfer::Srgb).rgb)
        {
            *gain = if max3(rgb) > 0.95 { 3.0 } else { 0.0 };
        }
        for gain in [Gain::Direct, Gain::Brackets] {
            let by = |hue: Hue| {
                let params = FuseHdr { gain, hue, transfer, ..params() };
                run(&params, (base.clone(), Arc::new(brackets.clone()))).0.env.image.samples.clone()
            };
            assert!(by(Hue::Base) == by(Hue::Exposures), "{gain:?} {transfer:?}");
        }
    }
}

// Light that is white in all photographs is a lower bound with either gain. This test fails if `bound` is always
// false.
#[test]
fn light_that_is_white_in_the_darkest_photograph_is_a_lower_bound() {
    let lit = |at: usize| if at == 500 { [4000.0; 3] } else { [0.2; 3] };
    let (base, brackets) = photograph(&lit, &[-6.0, -3.0], Transfer::Srgb, None);
    let derived = Arc::new(Brackets { taken: Taken::Derived, ..(*brackets).clone() });
    for (gain, brackets, bound) in
        [(Gain::Direct, &brackets, true), (Gain::Brackets, &brackets, true), (Gain::Direct, &derived, false)]
    {
        let (out, notes) = run(&FuseHdr { gain, ..params() }, (base.clone(), brackets.clone()));
        assert_eq!(notes.iter().any(|note| note.id == "saturated-at-darkest"), bound, "{gain:?}");
        let share = out.report.tables[0].rows[0].last().cloned();
        assert_eq!(matches!(share, Some(Cell::Number(share)) if share > 0.9), bound, "{share:?}");
    }
}

// Derived exposures are sRGB whatever the curve of the panorama, so a light is the same with either gain. This test
// fails if `brackets.taken` is not checked.
#[test]
fn derived_exposures_are_decoded_as_they_were_encoded() {
    let (base, brackets) = photograph(&ramp, &[-6.0], Transfer::Srgb, None);
    let derived = Arc::new(Brackets { taken: Taken::Derived, ..(*brackets).clone() });
    let peak = |gain| {
        let params = FuseHdr { gain, transfer: Transfer::Gamma24, ..params() };
        run(&params, (base.clone(), derived.clone())).0.env.image.samples[63 * 3]
    };
    assert!(
        (peak(Gain::Direct) / 40.0 - 1.0).abs() < 1e-3 && (peak(Gain::Brackets) / 40.0 - 1.0).abs() < 1e-3
    );
}

// The gain of photographs is measured with the sRGB curve, and then again with their own. This test fails if
// `by_own_curve` is not called.
#[test]
fn photographs_of_another_curve_give_the_same_light_by_either_gain() {
    let (base, brackets) = photograph(&ramp, &[-6.0], Transfer::Gamma24, None);
    let mut by_srgb = (*brackets).clone();
    by_srgb.log2_gain.samples.iter_mut().for_each(|gain| *gain *= 1.2);
    let peak = |gain| {
        let params = FuseHdr { gain, transfer: Transfer::Gamma24, ..params() };
        run(&params, (base.clone(), Arc::new(by_srgb.clone()))).0.env.image.samples[63 * 3]
    };
    assert!((peak(Gain::Direct) / 40.0 - 1.0).abs() < 1e-3, "{}", peak(Gain::Direct));
    assert!((peak(Gain::Brackets) / 40.0 - 1.0).abs() < 1e-3, "{}", peak(Gain::Brackets));
}

// White in a JPEG may be a code or two below white: a pixel that is white in one photograph is taken from the next
// darker photograph, with either gain. This test fails if `measured` is false in the fold of `fuse`.
#[test]
fn whites_of_a_jpeg_hide_what_the_next_photograph_shows() {
    let (base, brackets) = photograph(&ramp, &[-9.0, -6.0, -3.0], Transfer::Srgb, None);
    let (mut base, mut brackets) = ((*base).clone(), (*brackets).clone());
    let held = |samples: &mut Vec<f32>| samples.iter_mut().for_each(|code| *code = code.min(250.0 / 255.0));
    let Picture::Srgb(shown) = &mut base.image else { panic!("display colours") };
    held(&mut shown.samples);
    brackets.exposures.iter_mut().for_each(|exposure| held(&mut exposure.samples));
    // The gain is relative to the panorama.
    let shown = Transfer::Srgb.linear(250.0 / 255.0);
    for at in 0..W * H {
        brackets.log2_gain.samples[at] =
            if ramp(at)[0] > shown { num::f32::log2(ramp(at)[0] / shown) } else { 0.0 };
    }
    let taken = (Arc::new(base), Arc::new(brackets));
    for gain in [Gain::Direct, Gain::Brackets] {
        let (out, _) = run(&FuseHdr { gain, ..params() }, taken.clone());
        for at in 0..W * H {
            let (found, want) = (out.env.image.samples[3 * at], ramp(at)[0]);
            assert!((found / want - 1.0).abs() < 1e-3, "{gain:?} {at}: {found} {want}");
        }
    }
}

// A photograph in linear light holds the light and colour of a lamp below, at and above white. This test fails if
// `Taken::Linear` is not checked in `fuse`, `exposure` or `recolour`.
#[test]
fn a_photograph_of_linear_light_has_no_ceiling() {
    for lamp in [[24.0, 15.0, 6.0], [8.0, 4.0, 1.6], [7.6, 4.0, 1.6]] {
        let light = |at: usize| if at % W == 63 { lamp } else { [0.2; 3] };
        let (base, brackets) = photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None);
        let codes = |ev: f32| (0..W * H).flat_map(|at| light(at).map(|v| srgb_from_linear(v * ev))).collect();
        let exposures = [1.0 / 64.0, 1.0 / 8.0].map(|ev| Image::from_samples(W, H, 3, codes(ev))).to_vec();
        let linear = Brackets { exposures, taken: Taken::Linear, ..(*brackets).clone() };
        for (gain, blend) in
            [(Gain::Direct, Blend::Ramp), (Gain::Brackets, Blend::Ramp), (Gain::Brackets, Blend::Hard)]
        {
            let params = FuseHdr { gain, blend, hue: Hue::Exposures, ..params() };
            let (out, notes) = run(&params, (base.clone(), Arc::new(linear.clone())));
            let found = out.env.image.rgb(63, 2);
            assert!(found.iter().zip(lamp).all(|(a, b)| (a / b - 1.0).abs() < 1e-3), "{found:?} {lamp:?}");
            assert!(notes.iter().all(|note| note.id != "saturated-at-darkest"), "{notes:?}");
        }
    }
}

// Linear light with values above white is not clipped, so it is kept bit for bit, whatever was predicted for it.
// This test fails if `pixels.ceiling` is not checked in `fuse`.
#[test]
fn light_above_white_is_kept_to_the_bit() {
    let (base, brackets) = photograph(&ramp, &[-6.0, -3.0], Transfer::Srgb, None);
    let mut pano = (*base).clone();
    let light = Image::<Linear>::from_samples(W, H, 3, (0..W * H).flat_map(ramp).collect());
    pano.image = light.clone().into();
    let pano = Arc::new(pano);
    for gain in [Gain::Direct, Gain::Brackets] {
        for (hue, blend) in
            [(Hue::Base, Blend::Ramp), (Hue::Exposures, Blend::Ramp), (Hue::Base, Blend::Hard)]
        {
            let (out, notes) =
                run(&FuseHdr { gain, hue, blend, ..params() }, (pano.clone(), brackets.clone()));
            assert_eq!(*out.env.image, light);
            // The prediction was made for the photograph, and cannot be used here.
            assert!(notes.iter().all(|n| n.id == "prediction-unused"));
        }
    }
}

/// The only exposure is the light itself, bit for bit, whatever EVs were requested.
#[test]
fn one_exposure_is_the_light() {
    let dim = |at: usize| ramp(at).map(|v| v.min(0.89));
    for evs in [&[][..], &[-20.0]] {
        let (base, brackets) = photograph(&dim, evs, Transfer::Srgb, Some(255.0));
        for gain in [Gain::Direct, Gain::Brackets] {
            let (out, _) = run(&FuseHdr { gain, ..params() }, (base.clone(), brackets.clone()));
            let own = linear_pixels(&base.image, Transfer::Srgb);
            assert_eq!(out.env.image.samples.as_chunks::<3>().0, own.rgb);
        }
    }
}

/// A display value of 0.5 is decoded to 0.189 with the power curve, and to 0.214 with sRGB.
#[test]
fn transfers_differ_as_published() {
    assert!((Transfer::Gamma24.linear(0.5) - 0.1895).abs() < 1e-4);
    assert!((Transfer::Srgb.linear(0.5) - 0.2140).abs() < 1e-4);
}

#[test]
fn a_prediction_of_another_size_is_refused() {
    let (base, brackets) = photograph(&|_| [0.1; 3], &[], Transfer::Srgb, None);
    let mut other = (*brackets).clone();
    other.log2_gain = Image::new(8, 4, 1);
    let Err(error) = FuseHdr::run(&params(), In { base, brackets: Arc::new(other) }, &cx()) else {
        panic!("accepted")
    };
    assert!(error.message().contains("8x4"));
}

// A warm lamp whose channels are all clipped is white in the panorama; its colour comes from the exposure that
// still shows it, at the same luminance. Unclipped pixels do not change by a bit. This test fails if `wanted / own`
// is replaced by 1 in `recolour`.
#[test]
fn the_hue_of_a_clipped_lamp_comes_from_its_exposure() {
    let light = |at: usize| if at == 700 { [40.0, 20.0, 5.0] } else { [0.3, 0.5 + 1e-4 * at as f32, 0.1] };
    for (gain, blend) in
        [(Gain::Direct, Blend::Ramp), (Gain::Brackets, Blend::Ramp), (Gain::Brackets, Blend::Hard)]
    {
        let plain = FuseHdr { gain, blend, ..params() };
        let taken = || photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None);
        let (white, _) = run(&plain, taken());
        let (warm, _) = run(&FuseHdr { hue: Hue::Exposures, ..plain }, taken());
        for (at, (a, b)) in
            white.env.image.samples.chunks(3).zip(warm.env.image.samples.chunks(3)).enumerate()
        {
            if at == 700 {
                assert!(a[0] == a[2], "{a:?}");
                for (found, want) in b.iter().zip(light(at)) {
                    assert!((found / want - 1.0).abs() < 1e-3, "{gain:?} {blend:?} {b:?}");
                }
            } else if max3([a[0], a[1], a[2]]) <= 0.9 {
                assert_eq!(a, b);
            }
        }
    }
}

// Rotating panorama and prediction rotates the light: pixels move, and none changes. This test fails if `keep_flux`
// leaves out a column at the seam.
#[test]
fn turning_the_panorama_turns_the_light() {
    let (shift, light) = (23, |at: usize| {
        let (x, y) = (at % W, at / W);
        if (x + 3) % W < 6 && (10..14).contains(&y) { [9.0, 7.0, 5.0] } else { [0.2, 0.01 * y as f32, 0.3] }
    });
    let turned = |at: usize| light(at / W * W + (at % W + shift) % W);
    for hue in [Hue::Base, Hue::Exposures] {
        let by = FuseHdr { hue, ..params() };
        let plain = run(&by, photograph(&light, &[-6.0, -3.0], Transfer::Srgb, None)).0;
        let moved = run(&by, photograph(&turned, &[-6.0, -3.0], Transfer::Srgb, None)).0;
        for at in 0..W * H {
            let from = at / W * W + (at % W + shift) % W;
            for c in 0..3 {
                let (a, b) = (moved.env.image.samples[3 * at + c], plain.env.image.samples[3 * from + c]);
                assert!((a - b).abs() <= 1e-5 * b, "{at} {c}: {a} {b}");
            }
        }
    }
}
