//! Tests on a shadow with a soft edge on a floor, with sampling noise, and an object of two colours.

use super::*;
use render::geometry::sampling::{mix, unit};
use scene::types::Data;
use testing::{context, levels};

const SIZE: usize = 48;
const SAMPLES: u32 = 16;

/// Fraction of light that remains in a column: 1 outside the shadow, decreasing over eight pixels at its edge to
/// 0.5 in its core. It is always above 0.3, so every pixel of the shadow is noisy.
fn truth(x: usize) -> f32 {
    1.0 - 0.5 * ((x as f32 - 20.0) / 8.0).clamp(0.0, 1.0)
}

/// Output of a path tracer that uses the same random numbers for R0 and R1. In R1, each sample keeps either all of
/// its light or the fraction 0.3 of it.
fn noisy(seed: u32) -> In {
    let [mut without, mut with] = [3, 3].map(|c| Image::<Linear>::new(SIZE, SIZE, c));
    let mut object = Image::<Linear>::new(SIZE, SIZE, 4);
    let [mut depth, normal, mut variance] = [1, 3, 4].map(|c| Image::<Data>::new(SIZE, SIZE, c));
    depth.samples.fill(2.0);
    let random = |i: usize, s: u32, k: u32| unit(mix(mix(mix(seed ^ i as u32) ^ s) ^ k));
    for i in 0..SIZE * SIZE {
        let (x, y) = (i % SIZE, i / SIZE);
        let texture = if (x / 4 + y / 4) % 2 == 0 { 0.2 } else { 0.7 };
        let (mut r0, mut r1, mut o, mut square) = (0.0, 0.0, 0.0, 0.0);
        let lit = truth(x);
        for s in 0..SAMPLES {
            let light = texture * (0.5 + random(i, s, 0));
            r0 += light / SAMPLES as f32;
            r1 += if random(i, s, 1) < (1.0 - lit) / 0.7 { 0.3 * light } else { light } / SAMPLES as f32;
            let shade = if y < SIZE / 2 { 0.2 } else { 0.6 } * 2.0 * random(i, s, 2);
            o += shade / SAMPLES as f32;
            square += shade * shade / SAMPLES as f32;
        }
        without.pixel_mut(x, y).fill(r0);
        with.pixel_mut(x, y).fill(r1);
        let alpha = if x < 8 {
            1.0
        } else if x == 8 {
            0.5
        } else {
            0.0
        };
        object.pixel_mut(x, y).copy_from_slice(&[o * alpha, o * alpha, o * alpha, alpha]);
        let s = (r1 / r0).min(1.0);
        let spread = (s - 0.3) * (1.0 - s) / SAMPLES as f32;
        let shade = (square - o * o) / SAMPLES as f32 * alpha;
        variance.pixel_mut(x, y).copy_from_slice(&[0.0, 0.0, shade, if r0 == r1 { 0.0 } else { spread }]);
    }
    let one = |picture: Picture| Arc::new(Images::single("v", picture));
    In {
        points: None,
        without: one(without.into()),
        with: one(with.into()),
        object: one(object.into()),
        depth: one(depth.into()),
        normal: one(normal.into()),
        variance: one(variance.into()),
    }
}

fn samples(images: &Images) -> &[f32] {
    images.0[0].picture.samples()
}

fn samples_mut(images: &mut Arc<Images>) -> &mut [f32] {
    match &mut Arc::make_mut(images).0[0].picture {
        Picture::Linear(image) => &mut image.samples,
        Picture::Data(image) => &mut image.samples,
        Picture::Srgb(_) => unreachable!("linear"),
    }
}

fn run(strength: f64, inputs: In) -> Out {
    Denoise::run(&Denoise { strength, radius_px: 7, method: Method::Means }, inputs, &context())
        .unwrap_or_else(|e| panic!("{e}"))
        .0
}

/// RMSE of the ratio over some columns.
fn error(without: &Images, with: &Images, columns: std::ops::Range<usize>) -> f64 {
    let pairs = samples(without).chunks(3).zip(samples(with).chunks(3)).enumerate();
    let errors: Vec<f64> = pairs
        .filter(|(i, _)| columns.contains(&(i % SIZE)))
        .map(|(i, (a, b))| f64::from(b[0] / a[0] - truth(i % SIZE)))
        .map(|e| e * e)
        .collect();
    (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn noise_goes_and_the_edge_stays() {
    let (before, after) = (noisy(1), run(1.0, noisy(1)));
    for (columns, gain) in [(20..28, 2.0), (28..48, 1.5), (0..48, 2.0)] {
        let raw = error(&before.without, &before.with, columns.clone());
        let left = error(&after.without, &after.with, columns.clone());
        assert!(left * gain < raw, "{columns:?}: {left} of {raw}");
    }
}

/// In a place that is almost dark except for one lamp, the light of the lamp keeps its gradient and loses its noise. In
/// an earlier version all ratios above 8 counted as equal, so that a pool of light became a plateau with a rim.
#[test]
fn bright_ratios_are_distinguished() {
    let lit = |x: usize| scene::math::num::f32::exp(x as f32 * 0.15 - 1.0);
    let mut inputs = noisy(5);
    let before = samples(&inputs.without).to_vec();
    for spread in [0.001, 0.05_f32] {
        let random = |i: usize| unit(mix(mix(77) ^ i as u32)) + unit(mix(mix(78) ^ i as u32)) - 1.0;
        for (i, pixel) in samples_mut(&mut inputs.with).chunks_exact_mut(3).enumerate() {
            let ratio = lit(i % SIZE) * (1.0 + spread * random(i));
            (0..3).for_each(|k| pixel[k] = before[3 * i + k] * ratio);
        }
        for (i, pixel) in samples_mut(&mut inputs.variance).chunks_exact_mut(4).enumerate() {
            let sigma = lit(i % SIZE) * spread;
            pixel[3] = sigma * sigma / 6.0;
        }
        let off = |without: &Images, with: &Images| -> f64 {
            let pairs = samples(without).chunks(3).zip(samples(with).chunks(3)).enumerate();
            let squares =
                pairs.map(|(i, (a, b))| f64::from(b[0] / a[0] / lit(i % SIZE) - 1.0)).map(|e| e * e);
            (squares.sum::<f64>() / (SIZE * SIZE) as f64).sqrt()
        };
        let raw = off(&inputs.without, &inputs.with);
        let out = run(1.0, inputs);
        let left = off(&out.without, &out.with);
        inputs = noisy(5);
        assert!(left < raw, "{left} for {raw}");
    }
}

// Where no object affects anything nearby, nothing changes, bit for bit.
#[test]
fn what_no_object_touches_stays() {
    let (before, after) = (noisy(2), run(1.0, noisy(2)));
    let left = |images: &Images| -> Vec<f32> {
        samples(images).chunks(3 * SIZE).flat_map(|row| row[..3 * 16].to_vec()).collect()
    };
    assert_eq!(left(&before.without), left(&after.without));
    assert_eq!(left(&before.with), left(&after.with));
    let off = run(0.0, noisy(2));
    assert_eq!(samples(&before.with), samples(&off.with));
    assert_eq!(samples(&before.object), samples(&off.object));
}

// The sky behind a floor stays the sky, however noisy the floor next to it is.
#[test]
fn the_sky_stays() {
    let mut inputs = noisy(7);
    let sky = 10 * SIZE;
    samples_mut(&mut inputs.without)[..sky * 3].fill(0.01);
    samples_mut(&mut inputs.with)[..sky * 3].fill(0.01);
    samples_mut(&mut inputs.depth)[..sky].fill(f32::INFINITY);
    (0..sky).for_each(|i| samples_mut(&mut inputs.variance)[i * 4 + 3] = 0.0);
    let out = run(1.0, inputs);
    for images in [&out.without, &out.with] {
        assert!(samples(images)[..sky * 3].iter().all(|v| *v == 0.01));
    }
}

#[test]
fn objects_are_averaged_within_their_alpha() {
    let (before, after) = (noisy(3), run(1.0, noisy(3)));
    let (raw, clean) = (samples(&before.object), samples(&after.object));
    let mut errors = [0.0_f64; 2];
    for (i, (a, b)) in raw.chunks(4).zip(clean.chunks(4)).enumerate() {
        assert_eq!(a[3], b[3]);
        if a[3] == 0.0 {
            assert_eq!(b, [0.0; 4]);
            continue;
        }
        let shade = if i / SIZE < SIZE / 2 { 0.2 } else { 0.6 };
        for (error, pixel) in errors.iter_mut().zip([a, b]) {
            *error += f64::from((pixel[0] / pixel[3] - shade) * (pixel[0] / pixel[3] - shade));
        }
    }
    assert!(errors[1] * 4.0 < errors[0], "{errors:?}");
}

// One pixel is lit by an improbable path, far brighter than its surroundings. This test fails if `Tile::add`
// ignores `self.doubts`.
#[test]
fn a_lucky_path_does_not_splash() {
    let lit = |light: f32, noise: f32| {
        let mut inputs = noisy(3);
        let at = 10 * SIZE + 4;
        samples_mut(&mut inputs.object)[4 * at..4 * at + 3].fill(light);
        samples_mut(&mut inputs.variance)[4 * at + 2] = noise;
        let before = samples(&inputs.object).to_vec();
        (before, samples(&run(1.0, inputs).object).to_vec(), at)
    };
    let (_, calm, at) = lit(0.2, 0.001);
    let (before, after, _) = lit(16.0, 230.0);
    let others = (0..SIZE * SIZE).filter(|i| *i != at);
    let splash = others.map(|i| (after[4 * i] - calm[4 * i]).abs()).fold(0.0, f32::max);
    assert!(splash < 0.02, "{splash}");
    let sum = |object: &[f32]| object.chunks(4).map(|o| f64::from(o[0])).sum::<f64>();
    assert!((sum(&after) / sum(&before) - 1.0).abs() < 0.01, "{} of {}", sum(&after), sum(&before));
}

#[test]
fn instruction_sets_do_not_show() {
    let inputs = noisy(8);
    let [without, with, object] =
        [&inputs.without, &inputs.with, &inputs.object].map(|images| linear(&images.0[0].picture, "v"));
    let [without, with, object] =
        [without, with, object].map(|image| image.unwrap_or_else(|e| panic!("{e}")));
    let [depth, normal, variance] =
        [&inputs.depth, &inputs.normal, &inputs.variance].map(|images| &images.0[0].picture);
    let view = ViewLayers { without: &without, with: &with, object: &object, depth, normal, variance };
    let (field, reach) =
        (view.receiver().0, Denoise { strength: 1.0, radius_px: 7, method: Method::Means }.reach(0));
    let average = |level| field.average_at(level, reach, &context()).unwrap_or_else(|e| panic!("{e}"));
    let bits = |averages: Vec<[f32; VALUES]>| averages.into_iter().flatten().map(f32::to_bits).collect();
    let all: Vec<Vec<u32>> = levels().into_iter().map(average).map(bits).collect();
    assert!(all.windows(2).all(|two| two[0] == two[1]));
}

// Non-finite pixels stay unchanged and do not spread.
#[test]
fn what_is_not_finite_does_not_spread() {
    let mut inputs = noisy(4);
    let Picture::Linear(image) = &inputs.with.0[0].picture else { unreachable!("linear") };
    let mut image = image.clone();
    image.pixel_mut(30, 30)[1] = f32::NAN;
    image.pixel_mut(24, 10)[0] = f32::INFINITY;
    inputs.with = Arc::new(Images::single("v", image));
    let out = run(1.0, inputs);
    assert_eq!(samples(&out.with).iter().filter(|v| !v.is_finite()).count(), 2);
}

// One firefly leaves the shadow next to it as it is without the firefly; a pixel that is equally bright in every
// chunk of samples stays.
#[test]
fn fireflies_are_taken_out_and_highlights_stay() {
    let at = 24 * SIZE + 32;
    let lit = |variance: f32| {
        let mut inputs = noisy(6);
        let change =
            |images: &mut Arc<Images>, i: usize, v: f32| match &mut Arc::make_mut(images).0[0].picture {
                Picture::Linear(image) => image.samples[i] = v,
                Picture::Data(image) => image.samples[i] = v,
                Picture::Srgb(_) => unreachable!("linear"),
            };
        let r0 = samples(&inputs.without)[at * 3];
        (0..3).for_each(|k| change(&mut inputs.with, at * 3 + k, 20.0 * r0));
        change(&mut inputs.variance, at * 4 + 3, variance);
        let run =
            Denoise::run(&Denoise { strength: 1.0, radius_px: 7, method: Method::Means }, inputs, &context());
        run.unwrap_or_else(|e| panic!("{e}"))
    };
    let calm = run(1.0, noisy(6));
    let (out, notes) = lit(400.0);
    assert!(notes.iter().any(|note| note.id == "fireflies" && note.text.starts_with("1 ")));
    let largest = samples(&out.with).iter().zip(samples(&calm.with)).map(|(a, b)| (a - b).abs() / b);
    assert!(largest.clone().fold(0.0, f32::max) < 0.2, "{}", largest.fold(0.0, f32::max));
    let (out, notes) = lit(1e-3);
    assert!(notes.iter().next().is_none());
    assert!(samples(&out.with)[at * 3] > 10.0 * samples(&calm.with)[at * 3]);
}

#[test]
fn other_layers_are_refused() {
    let inputs = In { variance: noisy(5).normal, ..noisy(5) };
    let error =
        Denoise::run(&Denoise { strength: 1.0, radius_px: 7, method: Method::Means }, inputs, &context())
            .err();
    assert!(error.expect("three channels").message().contains("4"));
}

/// Filtering does not depend on the unit of light: scaling by a power of two changes only the exponents.
#[test]
fn light_of_any_strength_is_filtered_alike() {
    let object = |exponent: i32| {
        let scale = f32::from_bits(((127 + exponent) << 23) as u32);
        let mut input = noisy(3);
        let scaled = |images: &mut Arc<Images>, by: &dyn Fn(usize) -> f32| {
            let Picture::Linear(image) = &mut Arc::make_mut(images).0[0].picture else { panic!("is linear") };
            for (i, v) in image.samples.iter_mut().enumerate() {
                *v *= by(i);
            }
        };
        scaled(&mut input.object, &|i| if i % 4 < 3 { scale } else { 1.0 });
        scaled(&mut input.with, &|_| scale);
        scaled(&mut input.without, &|_| scale);
        let Picture::Data(variance) = &mut Arc::make_mut(&mut input.variance).0[0].picture else {
            panic!("is data")
        };
        for reported in variance.samples.chunks_exact_mut(4) {
            (0..3).for_each(|k| reported[k] *= scale * scale);
        }
        let (out, notes) =
            Denoise::run(&Denoise { strength: 1.0, radius_px: 5, method: Method::Means }, input, &context())
                .expect("runs");
        assert_eq!(notes.iter().filter(|note| note.id == "no-variance").count(), 0);
        let of = |images: &Images, k: usize| -> Vec<f32> {
            let samples = images.0[0].picture.samples().iter().enumerate();
            samples.map(|(i, v)| if k == 4 && i % 4 == 3 { *v } else { *v / scale }).collect()
        };
        [of(&out.object, 4), of(&out.with, 3), of(&out.without, 3)].concat()
    };
    let plain = object(0);
    for exponent in [-40, -17, 30] {
        let off = object(exponent).iter().zip(&plain).filter(|(a, b)| a != b).count();
        testing::row(
            48,
            "denoised values that differ at 2^-40, 2^-17 and 2^30 of the light",
            off as f64,
            0.0,
        );
    }
}

// Without a variance nothing is filtered, which is reported; without an object there is nothing to report.
#[test]
fn a_variance_of_nothing_is_reported() {
    let mut input = noisy(1);
    let Picture::Data(variance) = &mut Arc::make_mut(&mut input.variance).0[0].picture else {
        panic!("is data")
    };
    variance.samples.fill(0.0);
    let reported = |input: In| {
        let (_, notes) =
            Denoise::run(&Denoise { strength: 1.0, radius_px: 3, method: Method::Means }, input, &context())
                .expect("runs");
        notes.iter().any(|note| note.id == "no-variance")
    };
    let Picture::Linear(object) = input.object.0[0].picture.clone() else { panic!("is linear") };
    let none = Image::<Linear>::new(object.width, object.height, 4);
    let bare = In {
        points: None,
        with: input.without.clone(),
        without: input.without.clone(),
        object: Arc::new(Images::single("v", Picture::from(none))),
        depth: input.depth.clone(),
        normal: input.normal.clone(),
        variance: input.variance.clone(),
    };
    assert!(reported(input) && !reported(bare) && !reported(noisy(1)));
}

/// Light near the largest float stays finite, although sums of many such pixels would overflow. This test fails if
/// `scale` is always 1 in `Field::average_at`.
#[test]
fn the_brightest_light_stays_finite() {
    let bright = |scale: f32| {
        let mut inputs = noisy(9);
        for images in [&mut inputs.without, &mut inputs.with] {
            samples_mut(images).iter_mut().for_each(|v| *v *= scale);
        }
        let alpha = |i: usize| i % 4 == 3;
        let object = samples_mut(&mut inputs.object).iter_mut().enumerate();
        object.filter(|(i, _)| !alpha(*i)).for_each(|(_, v)| *v *= scale);
        samples_mut(&mut inputs.variance).chunks_exact_mut(4).for_each(|reported| reported[2] = f32::MAX);
        run(1.0, inputs)
    };
    // The largest of R0 is 1.05, that of the object 1.2.
    let (plain, bright) = (bright(1.0), bright(f32::MAX / 2.0));
    let pairs = [(&plain.without, &bright.without), (&plain.with, &bright.with)];
    for (a, b) in pairs.into_iter().flat_map(|(a, b)| samples(a).iter().zip(samples(b))) {
        assert!((b / (f32::MAX / 2.0) / a - 1.0).abs() < 1e-6, "{a} became {b}");
    }
    assert!(samples(&bright.object).iter().all(|v| v.is_finite()));
}

fn oidn() -> Denoise {
    Denoise { strength: 1.0, radius_px: 7, method: Method::Oidn }
}

#[test]
fn oidn_is_refused_where_it_cannot_run() {
    let refused = Denoise::check(&oidn()).err().map(|error| error.to_string());
    // Either it is installed, or the error says where it was looked for.
    assert!(refused.is_none_or(|text| text.contains("`libOpenImageDenoise.so.2` was not found in `/")));
}

/// If Open Image Denoise is installed, it satisfies the conditions of `noise_goes_and_the_edge_stays` and
/// `what_no_object_touches_stays`.
#[test]
#[allow(clippy::print_stderr, reason = "a skipped test is reported")]
fn where_oidn_is_installed_it_filters_what_is_noisy() {
    if let Err(missing) = Denoise::check(&oidn()) {
        return eprintln!("where_oidn_is_installed_it_filters_what_is_noisy: left out, {missing}");
    }
    let before = noisy(1);
    let (after, notes) = Denoise::run(&oidn(), noisy(1), &context()).expect("runs");
    assert!(notes.iter().any(|note| note.id == "oidn" && note.text.contains("Open Image Denoise 2.")));
    let raw = error(&before.without, &before.with, 0..SIZE);
    let left = error(&after.without, &after.with, 0..SIZE);
    assert!(left * 1.5 < raw, "{left} of {raw}");
    assert_eq!(samples(&before.without), samples(&after.without));
    for (a, b) in samples(&before.with).chunks(3 * SIZE).zip(samples(&after.with).chunks(3 * SIZE)) {
        assert_eq!(a[..3 * 16], b[..3 * 16]);
    }
    for (a, b) in samples(&before.object).chunks(4).zip(samples(&after.object).chunks(4)) {
        assert_eq!(a[3], b[3]);
        assert!(a[3] > 0.0 || b == [0.0; 4]);
    }
    assert_ne!(samples(&before.object), samples(&after.object));
}
