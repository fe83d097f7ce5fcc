use super::*;
use scene::math::num;
use testing::{context, row};

fn image(values: &[f32]) -> Arc<Images> {
    let samples = values.iter().flat_map(|&v| [v; 3]).collect();
    Arc::new(Images::single("v", Image::<Linear>::from_samples(values.len(), 1, 3, samples)))
}

fn ratios(params: &ShadowRatio, r0: &[f32], r1: &[f32]) -> Vec<f32> {
    let inputs = In { without: image(r0), with: image(r1) };
    let (out, _) = ShadowRatio::run(params, inputs, &context()).expect("runs");
    out.shadow.0[0].picture.samples().chunks(3).map(|p| p[0]).collect()
}

// The sun in the picture does not affect how dark a shadow is, and clipped ratios are counted.
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
    let run = ShadowRatio::run(&p, In { without: image(&[1.0; 2]), with: image(&[0.5, 1.0]) }, &context());
    let reported =
        run.expect("runs").1.iter().find(|note| note.id == "too-dark").map(|note| note.text.clone());
    assert!(reported.is_some_and(|text| text.starts_with("6 of the samples (100.00 %)")));
}

/// `Difference` ignores the parameters that shape a ratio, and reports those that are set.
#[test]
fn what_shapes_no_difference_is_reported() {
    let difference = || ShadowRatio { form: RatioForm::Difference, ..ShadowRatio::default() };
    let set = ShadowRatio { gamma: 0.5, s_max: 2.0, ..difference() };
    let lambda = ShadowRatio { lambda: 0.5, ..difference() };
    for (params, expected) in [
        (difference(), None),
        (lambda, None),
        (ShadowRatio { form: RatioForm::Stable, ..set.clone() }, None),
        (set, Some("`form: Difference` has no ratio and ignores `s_max`, `gamma`; use `lambda`")),
    ] {
        let inputs = In { without: image(&[0.5; 4]), with: image(&[0.4; 4]) };
        let (_, notes) = ShadowRatio::run(&params, inputs, &context()).expect("runs");
        let reported = notes.iter().find(|note| note.id == "no-ratio").map(|note| note.text.as_str());
        assert_eq!(reported, expected);
    }
}

/// A few samples whose light without the objects is almost 0 do not dominate the reported brightness.
#[test]
fn how_much_brighter_is_reported_by_sums() {
    let (mut r0, mut r1) = ([1.0; 100], [1.2; 100]);
    (r0[0], r1[0]) = (0.002, 1.0);
    let inputs = In { without: image(&r0), with: image(&r1) };
    let params = ShadowRatio { min_energy: 0.0, ..ShadowRatio::default() };
    let (_, notes) = ShadowRatio::run(&params, inputs, &context()).expect("runs");
    let found = notes.iter().find(|note| note.id == "clipped").expect("a note");
    assert!(found.text.contains("1.210 times"), "{}", found.text);
}

/// A warning with a remedy is given if `s_max` clips the light of an inserted lamp. The reflection of a matte
/// object, noise and a firefly cause no warning. This test fails if `SHONE_ON` or `SEEN` is 1, or if `is_shone_on`
/// always returns true.
#[test]
fn light_that_is_kept_from_the_picture_is_reported() {
    let reported = |s_max: f64, bright: &[f32]| {
        let mut r1 = vec![1.002; 1000];
        r1[..bright.len()].copy_from_slice(bright);
        let p = ShadowRatio { s_max, ..ShadowRatio::default() };
        let inputs = In { without: image(&[1.0; 1000]), with: image(&r1) };
        let notes = ShadowRatio::run(&p, inputs, &context()).expect("runs").1;
        notes.iter().map(|note| note.id.clone()).collect::<Vec<_>>()
    };
    let lamp = [3.0; 50];
    assert!(reported(1.0, &lamp).iter().any(|id| id == "light-clipped"));
    assert!(!reported(8.0, &lamp).iter().any(|id| id == "light-clipped"));
    assert!(!reported(1.0, &[1.1; 50]).iter().any(|id| id == "light-clipped"));
    let fireflies: Vec<f32> = (0..50).map(|i| if i % 3 == 1 { 9.0 } else { 1.0 }).collect();
    assert!(!reported(1.0, &fireflies).iter().any(|id| id == "light-clipped"));
    assert!(reported(8.0, &[90.0; 50]).iter().any(|id| id == "light-clipped"));
    assert!(!reported(1.0, &[]).iter().any(|id| id == "clipped"), "noise");
}

// `Hybrid` adds light, so nothing is clipped.
#[test]
fn what_is_added_is_not_reported_as_clipped() {
    let clipped = |form, s_max| {
        let p = ShadowRatio { form, s_max, ..ShadowRatio::default() };
        let run = ShadowRatio::run(&p, In { without: image(&[1.0]), with: image(&[2.0]) }, &context());
        run.expect("runs").1.iter().any(|note| note.id == "clipped" && !note.text.starts_with("0 "))
    };
    assert!(clipped(RatioForm::Stable, 1.0) && !clipped(RatioForm::Stable, 3.0));
    assert!(!clipped(RatioForm::Hybrid, 100.0) && clipped(RatioForm::Hybrid, 0.5));
}

/// Bounds that give the same factor everywhere are refused, and bounds that darken the whole picture are reported.
/// This test fails if `check` does not apply `powered`.
#[test]
fn bounds_that_leave_no_shadow_are_reported() {
    let of = |s_min, s_max, gamma| ShadowRatio { s_min, s_max, gamma, ..ShadowRatio::default() };
    for (s_min, s_max, gamma, good) in
        [(0.9, 0.5, 1.0, false), (0.6, 0.5, 0.5, true), (0.8, 0.5, 0.5, false), (1.0, 1.0, 1.0, true)]
    {
        let checked = ShadowRatio::check(&of(s_min, s_max, gamma));
        assert_eq!(checked.is_ok(), good, "{s_min} of {s_max}^{gamma}");
    }
    let reported = |p: &ShadowRatio| {
        let run = ShadowRatio::run(p, In { without: image(&[1.0]), with: image(&[1.0]) }, &context());
        run.expect("runs").1.iter().any(|note| note.id == "darkened")
    };
    assert!(
        reported(&of(0.0, 0.5, 1.0)) && !reported(&ShadowRatio::default()) && !reported(&of(0.0, 2.0, 1.0))
    );
    assert!(!reported(&ShadowRatio { form: RatioForm::Difference, ..of(0.0, 0.5, 1.0) }));
}

#[test]
fn nothing_over_nothing_is_one() {
    for form in [RatioForm::Stable, RatioForm::Paper, RatioForm::Hybrid] {
        let p = ShadowRatio { form, ..ShadowRatio::default() };
        assert_eq!(ratios(&p, &[0.0; 9], &[0.0; 9]), [1.0; 9]);
        let run = ShadowRatio::run(&p, In { without: image(&[0.0]), with: image(&[0.0]) }, &context());
        assert!(run.expect("runs").1.iter().any(|note| note.id == "all-dark"));
        assert_eq!(ratios(&p, &[0.0, 1.0], &[0.0, 1.0])[0], 1.0);
        // The noise of an almost dark area, next to a lit one.
        let (r0, r1) = ([1.0, 1e-8, 1e-8, 1e-8_f32], [0.5, 1e-3, 1e-3, 1e-3_f32]);
        assert_eq!(ratios(&ShadowRatio { s_max: 100.0, ..p }, &r0, &r1)[2..], [1.0; 2]);
    }
}

#[test]
fn exposure_does_not_change_the_ratio() {
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

/// Dark and non-finite samples are counted, and cast no shadow.
#[test]
fn dark_and_broken_samples_cast_no_shadow() {
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
    assert!(notes.iter().any(|n| n.id == "not-finite" && n.text.ends_with("(count: 9)")));
    assert_eq!(out.added.0[0].picture.samples()[6..], [0.0; 9]);
    // The neighbours of a broken pixel are the same as without it, though neighbours decide together what is too
    // dark.
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

/// The shaping is monotone in each parameter, and exact at the ends of the range of each parameter.
#[test]
fn shaping_follows_the_paper() {
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

/// Added light is clipped unless `s_max` is raised, and the clipped share is reported.
#[test]
fn added_light_needs_s_max() {
    let inputs = In { without: image(&[1.0; 4]), with: image(&[1.3, 0.5, 1.0, 0.9]) };
    let (out, notes) = ShadowRatio::run(&ShadowRatio::default(), inputs, &context()).expect("runs");
    assert_eq!(out.shadow.0[0].picture.samples()[..3], [1.0; 3]);
    let reported = notes.iter().find(|note| note.id == "clipped").map(|note| note.text.as_str());
    assert!(
        reported.is_some_and(|text| text.starts_with("3 of the samples (25.00 %)") && text.contains("1.300")),
        "{reported:?}"
    );
    let more = ratios(&ShadowRatio { s_max: 2.0, epsilon: 0.0, ..ShadowRatio::default() }, &[1.0], &[1.3]);
    row(51, "error of a ratio above 1", f64::from((more[0] - 1.3).abs()), 1e-6);
}

#[test]
fn parameters_out_of_range_are_named() {
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
            let reported = parsed.err().map(|errors| errors.to_string()).unwrap_or_default();
            assert!(
                reported.contains(field) && reported.contains("graph.ron:3"),
                "{field}: {value} gives {reported:?}"
            );
        }
    }
}

/// If `min_energy` increases in small steps, the ratios change in small steps too.
#[test]
fn the_mask_has_no_edge() {
    let at = |least: f64| {
        ratios(&ShadowRatio { min_energy: least, ..ShadowRatio::default() }, &[0.5; 3], &[0.1; 3])[1]
    };
    let sweep: Vec<f32> = (0..200).map(|k| at(f64::from(k) / 100.0)).collect();
    assert!(sweep[0] < 0.21 && sweep[199] == 1.0);
    assert!(sweep.windows(2).all(|w| w[1] >= w[0]), "{sweep:?}");
    let jump = sweep.windows(2).map(|w| f64::from(w[1] - w[0])).fold(0.0, f64::max);
    row(50, "largest step of the ratio over 200 bounds of energy", jump, 0.04);
    // Nor does the noise of one pixel decide: a pixel among lit ones has their ratio.
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
        let (out, _) = ShadowRatio::run(&ShadowRatio { form, ..ShadowRatio::default() }, inputs, &context())
            .expect("runs");
        let first =
            |images: &Images| -> Vec<f32> { images.0[0].picture.samples().chunks(3).map(|p| p[0]).collect() };
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

// A luminance ratio drops the colour of the remaining light and keeps its amount.
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
