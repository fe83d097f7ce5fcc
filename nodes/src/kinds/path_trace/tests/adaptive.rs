//! Tests of adaptive sampling and of the reported errors.

use scene::types::Cell;

use super::*;

fn until(error: f64, samples: u32) -> PathTrace {
    PathTrace { max_error: Some(error), ..params(samples, Surroundings::OPEN) }
}

/// The scene of [`shadowed`], seen from so far away that most of the view is outside the shadow.
fn far(size: u32) -> (Mesh, Vec<Arc<Placed>>, Arc<Rig>) {
    let (plane, objects, _) = shadowed();
    (plane, objects, rig(DVec3::new(0.0, -4.0, 2.5), DVec3::new(0.0, 0.0, 0.2), size, 2.0))
}

fn layers(out: &Out) -> [&[f32]; 4] {
    [&out.without, &out.with, &out.object, &out.variance].map(|images| samples(images))
}

/// Values of the report row that describes the samples of adaptive sampling.
fn plan(out: &Out) -> Vec<f64> {
    let table = out.report.tables.iter().find(|table| table.name == "samples").expect("a plan");
    let number = |cell: &Cell| match *cell {
        Cell::Number(v) => Some(v),
        Cell::Count(n) => Some(n as f64),
        _ => None,
    };
    table.rows[0].iter().filter_map(number).collect()
}

// If all samples do not reach the target error, the picture equals the picture of all samples, bit for bit. If the
// first samples reach it, the picture equals the picture of the first samples. In between, every pixel equals a
// pixel of one of the two.
#[test]
fn blocks_are_those_of_whole_pictures() {
    let (plane, objects, rig) = far(96);
    let render = |p: &PathTrace| render(p, &plane, &objects, &rig, &sunny());
    let (few, all) = (render(&params(4, Surroundings::OPEN)).0, render(&params(16, Surroundings::OPEN)).0);
    let (never, notes) = render(&until(1e-6, 16));
    let whole = samples(&never.with).chunks(3).zip(samples(&all.with).chunks(3));
    let same = whole.filter(|(a, b)| a == b).count();
    assert!(same > 96 * 96 * 9 / 10, "{same}: blocks that nothing touches have no error");
    assert!(notes.is_degraded() && notes.iter().any(|n| n.id == "error-not-reached"));
    let (at_once, notes) = render(&until(1.0, 16));
    assert_eq!(layers(&at_once), layers(&few));
    assert!(!notes.is_degraded());

    let (some, _) = render(&until(0.06, 16));
    let [mut first, mut more] = [0, 0];
    for ((some, few), all) in
        layers(&some)[1].chunks(3).zip(layers(&few)[1].chunks(3)).zip(layers(&all)[1].chunks(3))
    {
        assert!(some == few || some == all);
        first += usize::from(some == few && some != all);
        more += usize::from(some == all && some != few);
    }
    assert!(first > 1_000 && more > 1_000, "{first} {more}");
}

/// A noise threshold takes the same samples as `max_error`, and nothing is degraded if blocks end above it. If both
/// are set, `max_error` applies. This test fails if `report_plan` ignores `required`, or if `goal` prefers the
/// threshold.
#[test]
fn a_noise_threshold_saves_samples_and_requires_nothing() {
    let (plane, objects, rig) = far(96);
    let render = |p: &PathTrace| render(p, &plane, &objects, &rig, &sunny());
    let threshold = |error: f64, samples: u32| PathTrace {
        noise_threshold: Some(error),
        ..params(samples, Surroundings::OPEN)
    };
    let (required, bad) = render(&until(0.06, 16));
    let (found, notes) = render(&threshold(0.06, 16));
    assert_eq!(layers(&found), layers(&required));
    assert_eq!(plan(&found), plan(&required));
    assert!(plan(&found)[5] > 0.0 && bad.is_degraded(), "no block ends above the error: {:?}", plan(&found));
    assert!(!notes.is_degraded());
    let text = notes.iter().find(|n| n.id == "sample-plan").map(|n| n.text.clone()).expect("a note");
    assert!(text.contains("`noise_threshold` 0.06"), "{text}");
    let (both, notes) = render(&PathTrace { noise_threshold: Some(1.0), ..until(0.06, 16) });
    assert_eq!(layers(&both), layers(&required));
    assert!(notes.is_degraded());
    let few = render(&PathTrace { noise_threshold: Some(0.06), ..params(3, Surroundings::OPEN) }).0;
    assert_eq!(layers(&few), layers(&render(&params(3, Surroundings::OPEN)).0));
}

// The error is estimated from the first chunk of samples, even if fewer samples are requested.
#[test]
fn fewer_samples_than_the_first_are_raised_to_it() {
    let (plane, objects, rig) = far(16);
    let render = |p: &PathTrace| render(p, &plane, &objects, &rig, &sunny());
    let raised = |notes: &Notes| notes.iter().any(|n| n.id == "first-samples");
    let (four, notes) = render(&until(1e-6, 4));
    assert!(!raised(&notes));
    for samples in [1, 3] {
        assert!(PathTrace::check(&until(1e-6, samples)).is_ok());
        let (out, notes) = render(&until(1e-6, samples));
        assert_eq!(layers(&out), layers(&four));
        assert!(raised(&notes) && notes.is_degraded(), "an error that 4 do not reach is reported");
        assert!(!raised(&render(&params(samples, Surroundings::OPEN)).1));
    }
}

// The target error is reached, according to the report, with fewer rays than with the same number of samples
// everywhere. The result does not depend on the number of threads.
#[test]
fn the_error_asked_for_is_reached() {
    let (plane, objects, rig) = far(96);
    let trace = |p: &PathTrace, threads| {
        let cx = context();
        let (out, notes) =
            rayon_pool(threads).install(|| render_in(&cx, p, &plane, &objects, &rig, &sunny()));
        (out, notes, cx.counts()["rays"])
    };
    let (out, notes, rays) = trace(&until(0.05, 256), 3);
    let [asked, predicted, reached, blocks, more, short, mean] = plan(&out)[..] else { panic!("a row") };
    assert!(!notes.is_degraded() && short == 0.0, "{reached} {short}");
    assert!(asked == 0.05 && reached <= asked && reached > 0.3 * asked, "{reached}");
    assert!(predicted > 0.5 * reached && predicted < 4.0 * reached, "{predicted} {reached}");
    assert!(blocks == 9.0 && (1.0..9.0).contains(&more), "{more}");
    assert!((4.0..128.0).contains(&mean));
    assert_eq!(layers(&trace(&until(0.05, 256), 1).0), layers(&out));
    let sixteenth = trace(&params(16, Surroundings::OPEN), 3).2;
    assert!(rays < 8 * sixteenth, "{rays} {sixteenth}");
}

/// Renders with `n` seeds. Returns, for each seed, the value of every pixel and its reported variance.
fn seeds(p: &PathTrace, n: u64, layer: usize) -> Vec<Vec<[f64; 2]>> {
    let (plane, objects, rig) = shadowed();
    let render = |seed| {
        let cx = Context::detached(
            Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 100 + seed, exhaustive: false },
            ".",
        );
        let (out, _) = render_in(&cx, p, &plane, &objects, &rig, &sunny());
        let of = |images: &Images, i: usize| {
            let channels = images.0[0].picture.size().2;
            f64::from(luminance(std::array::from_fn(|k| samples(images)[i * channels + k])))
        };
        let value = |i: usize| match layer {
            0 => of(&out.without, i),
            2 => of(&out.object, i),
            _ => of(&out.with, i) / of(&out.without, i),
        };
        (0..32 * 32).map(|i| [value(i), f64::from(samples(&out.variance)[i * 4 + layer])]).collect()
    };
    (0..n).map(render).collect()
}

// The reported variance equals the variance over twenty seeds, or is up to a few times as large, since stratified
// samples are treated as independent.
#[test]
fn variance_is_that_of_many_seeds() {
    for n in [2, 4, 16] {
        for layer in [0, 2, 3] {
            let outs = seeds(&params(n, Surroundings::OPEN), 20, layer);
            let (mut reported, mut is) = (0.0, 0.0);
            for i in 0..32 * 32 {
                let mean = outs.iter().map(|out| out[i][0]).sum::<f64>() / 20.0;
                is += outs.iter().map(|out| (out[i][0] - mean) * (out[i][0] - mean)).sum::<f64>() / 19.0;
                reported += outs.iter().map(|out| out[i][1]).sum::<f64>() / 20.0;
            }
            // Pixels without an edge are almost exact after four samples. The benefit of stratification grows with
            // the number of samples.
            let most = if layer == 3 { 3.0 + f64::from(n) } else { f64::INFINITY };
            assert!(
                is > 0.0 && reported >= 0.9 * is && reported <= most * is,
                "{n}, {layer}: {reported} of {is}"
            );
        }
    }
}

/// Compares two renders over the pixels whose reported variance is not 0. Returns the share of these pixels that
/// differ by more than two standard errors, the share that differ by more than three, and the number of these
/// pixels.
fn beyond(a: &[[f64; 2]], b: &[[f64; 2]]) -> ([f64; 2], f64) {
    let pairs = a.iter().zip(b).filter(|([_, v], [_, w])| v + w > 0.0);
    let z: Vec<f64> = pairs.map(|([a, v], [b, w])| (a - b).abs() / (v + w).sqrt()).collect();
    let share = |k: f64| z.iter().filter(|&&z| z > k).count() as f64 / z.len() as f64;
    ([share(2.0), share(3.0)], z.len() as f64)
}

// A z-test between two seeds: the number of pixels that are far apart is at most the number that their errors
// allow, plus three standard deviations. Enough pixels differ to show that the errors are real.
#[test]
fn two_seeds_agree_to_their_errors() {
    for layer in [0, 2, 3] {
        let outs = seeds(&params(16, Surroundings::OPEN), 2, layer);
        let (shares, n) = beyond(&outs[0], &outs[1]);
        for (share, expected) in shares.into_iter().zip([0.0455_f64, 0.0027]) {
            let most = expected + 3.0 * (expected * (1.0 - expected) / n).sqrt();
            assert!(share <= most, "layer {layer}: {share} beyond, at most {most}");
        }
        let moved = outs[0].iter().zip(&outs[1]).filter(|(a, b)| a[0] != b[0]).count() as f64;
        assert!(moved >= 0.9 * n);
    }
}

// Adaptive stopping does not bias the reported errors: the interval of two standard errors around a pixel contains
// the mean of other seeds as often as it should.
#[test]
fn intervals_cover_where_samples_are_adapted() {
    let outs = seeds(&until(0.03, 64), 20, 3);
    let truth = seeds(&params(256, Surroundings::OPEN), 4, 3);
    let (mut within, mut all, mut bias) = (0.0, 0.0, 0.0);
    for i in 0..32 * 32 {
        let mean = truth.iter().map(|out| out[i][0]).sum::<f64>() / 4.0;
        for [value, variance] in outs.iter().map(|out| out[i]).filter(|[_, variance]| *variance > 0.0) {
            within += f64::from(u8::from((value - mean).abs() <= 2.0 * variance.sqrt()));
            bias += value - mean;
            all += 1.0;
        }
    }
    assert!(within / all > 0.91, "{}", within / all);
    assert!((bias / all).abs() < 2e-3, "{}", bias / all);
}

/// If the target error is not reached, the note gives the number of samples that would reach it, since errors
/// fall with the square root of that number.
#[test]
fn what_would_reach_the_error_is_reported() {
    use crate::kinds::path_trace::reporting::report_plan;
    use render::transport::picture::accumulator::{ReachedError, TargetError};
    let reported = |asked: f64, worst: f64| {
        let asked = TargetError { error: asked, required: true };
        let reached = ReachedError { asked, worst, predicted: worst, blocks: [4, 3, 2], samples: 16.0 };
        let mut notes = Notes::none();
        report_plan("v", &reached, 16, &mut notes);
        assert!(notes.is_degraded());
        notes.iter().find(|n| n.id == "error-not-reached").map(|n| n.text.clone()).expect("a note")
    };
    let text = reported(0.01, 0.051);
    assert!(text.contains("after 16 samples per pixel") && text.contains("above 0.01 in 2 of 4 blocks"));
    assert!(text.contains("`samples` to about 420") && text.contains("`max_error` to 5.10e-2"), "{text}");
    assert!(reported(1e-6, 0.05).contains("more samples than the maximum of `samples`"));
}
