//! Tests that compare path tracing with renders by independent programs.

use engine::Up;
use nodes::kinds::path_trace;
use nodes::kinds::path_trace::surroundings::Surroundings;
use scene::math::color::luminance;
use scene::types::Images;
use testkit::{Case, Data, block_scores, denoised, mean, relative_mse, rgb};

fn case(name: &str) -> Case {
    Case::load(&Data::shared(Up::PlusY, 7), name)
}

/// Traces with the object and without `crop`, and prints notes and cost.
fn trace(case: &Case, samples: u32, surroundings: Surroundings) -> path_trace::Out {
    let traced = case.cropped(7, samples, true, surroundings, 0.0);
    for note in traced.notes.iter() {
        println!("  {}: {}", note.id, note.text);
    }
    println!("  {samples} samples: {:.2} CPU-s, {:?}", traced.seconds, traced.counts);
    traced.out
}

/// Returns the ratio of the mean of `ours` to the mean of `reference`, and the relative mean squared error of
/// `ours`.
fn compare(name: &str, ours: &[f32], reference: &[f32]) -> (f64, f64) {
    let (ratio, relmse) = (mean(ours) / mean(reference), relative_mse(ours, reference));
    println!(
        "  {name}: mean {:.5} of {:.5}, ratio {ratio:.5}, relMSE {relmse:.3e}",
        mean(ours),
        mean(reference)
    );
    (ratio, relmse)
}

/// Compares the luminance of `without` with the luminance in a render by another program. The difference at each
/// pixel is divided by its standard error. Returns the mean of this score over the pixels, and the share of the
/// pixels whose score is above 3. As its notes state, the variance of the other render is `noise` times (squared
/// luminance + 0.01).
fn z_scores(out: &path_trace::Out, outside: &[f32], noise: f64) -> (f64, f64) {
    let y = |rgb: &[f32]| f64::from(luminance([rgb[0], rgb[1], rgb[2]]));
    let variance = out.variance.0[0].picture.samples().chunks(4).map(|v| f64::from(v[0]));
    let (ours, pairs) = (rgb(&out.without), outside.chunks(3).map(y).zip(variance));
    let z = |(a, (b, variance)): (f64, (f64, f64))| (a - b) / (variance + noise * (b * b + 0.01)).sqrt();
    let scores: Vec<f64> = ours.chunks(3).map(y).zip(pairs).map(z).collect();
    let beyond = scores.iter().filter(|z| z.abs() > 3.0).count() as f64;
    let n = scores.len() as f64;
    let reported = (scores.iter().sum::<f64>() / n, beyond / n);
    println!("  z scores: mean {:.3}, share above 3 {:.5}", reported.0, reported.1);
    reported
}

// Mitsuba, 4096 samples, own noise about 2e-5. Bounds: mean within 0.5 % and relMSE 1.9e-4, which Mitsuba's
// multijitter has at 64 samples.
#[test]
fn sunny_plane_agrees_with_mitsuba_and_cycles() {
    let case = case("sunny_plane");
    let out = trace(&case, 64, Surroundings::OPEN);
    let r0 = rgb(&out.without);
    let (ratio, relmse) = compare("R0 / Mitsuba", &r0, &case.reference("ref-mitsuba/R0.exr"));
    assert!((ratio - 1.0).abs() < 0.005 && relmse < 1.9e-4, "{ratio} {relmse}");
    // Within its own noise: of normal errors 0.0027 lie beyond 3. Mitsuba's panorama brings 0.1 to 0.2 % more light
    // than the sum of its texels, which is the mean.
    let (mean, beyond) = z_scores(&out, &case.reference("ref-mitsuba/R0.exr"), 2e-5);
    assert!(mean.abs() < 0.5 && beyond < 0.0027, "{mean} {beyond}");
    let (ratio, _) = compare("R0 / Cycles", &r0, &case.reference("ref-cycles/R0.exr"));
    assert!((ratio - 1.0).abs() < 0.005, "{ratio}");
    let r1 = rgb(&out.with);
    for (name, file) in [("R1 / prototype", "ref-proto/R1.exr"), ("R1 / Cycles", "ref-cycles/R1.exr")] {
        let (ratio, relmse) = compare(name, &r1, &case.reference(file));
        assert!((ratio - 1.0).abs() < 0.005 && relmse < 6e-4, "{name} {ratio} {relmse}");
    }
    let o = rgb(&out.object);
    for (name, file) in [("O / prototype", "ref-proto/O.exr"), ("O / Cycles", "ref-cycles/O.exr")] {
        let (ratio, relmse) = compare(name, &o, &case.reference(file));
        assert!((ratio - 1.0).abs() < 0.01 && relmse < 2e-3, "{name} {ratio} {relmse}");
    }
    // The ratio of converged renders is the prototype's R1 over Mitsuba's R0 to their noise.
    let (a, b) = (case.reference("ref-proto/R1.exr"), case.reference("ref-mitsuba/R0.exr"));
    let squares: f64 = (0..r0.len())
        .filter(|&i| b[i] > 0.02)
        .map(|i| f64::from((r1[i] / r0[i]).min(1.0) - (a[i] / b[i]).min(1.0)))
        .map(|d| d * d)
        .sum();
    let n = b.iter().filter(|v| **v > 0.02).count() as f64;
    println!("  RMSE of S {:.4}", (squares / n).sqrt());
}

// The prototype with 512 independent samples per pixel: means of the receiver within 0.5 %, of the object, whose
// smooth normals treat light below the horizon differently, within 1 %; relMSE is nearly all the prototype's own
// noise, with a margin of a third over the measured values (1.5e-3 to 1.8e-3 where walls reflect no light, 6.2e-3
// to 7.0e-3 where they do).
#[test]
fn closed_room_agrees_with_the_prototype_in_every_mode() {
    let case = case("closed_room");
    for (tag, surroundings) in [
        ("solid-solid", Surroundings::OPEN),
        ("pass-env", Surroundings::TRANSPARENT),
        ("frontface-env", Surroundings::ROOM),
        ("pass-solid", Surroundings::Transparent { bounces: true }),
        ("frontface-solid", Surroundings::Room { layers: 3, bounces: true }),
    ] {
        println!("{tag}");
        let out = trace(&case, 16, surroundings);
        let noise = if tag.ends_with("env") { 2.4e-3 } else { 9e-3 };
        for (layer, images) in [("R0", &out.without), ("R1", &out.with), ("O", &out.object)] {
            let ours = rgb(images);
            let reference = case.reference(&format!("ref-proto/{layer}-{tag}.exr"));
            if tag == "solid-solid" {
                // The prototype leaks 4e-7 through its shell; ours is watertight.
                assert!(ours.iter().all(|&v| v == 0.0), "{layer}");
                continue;
            }
            let (ratio, relmse) = compare(layer, &ours, &reference);
            let off = if layer == "O" { 0.01 } else { 0.005 };
            assert!((ratio - 1.0).abs() < off && relmse < noise, "{tag} {layer}: {ratio} {relmse}");
            if layer != "O" {
                let (mean, beyond) = block_scores(&ours, &reference, 192);
                println!("  z scores of the blocks: mean {mean:.3}, share above 3 {beyond:.4}");
                assert!(mean.abs() < 0.5 && beyond < 0.02, "{tag} {layer}: {mean} {beyond}");
            }
        }
    }
}

/// Root mean square errors of the ratio `with` / `without`. The first is over the pixels that no object covers, the
/// second over the pixels that are partly covered. The reference ratio is computed from two renders that use the
/// same random numbers.
fn ratio_error(out: &path_trace::Out, pair: [&Images; 2], reference: [&[f32]; 2]) -> [f64; 2] {
    let ratio = |without: &[f32], with: &[f32], i: usize| f64::from(with[i] / without[i]).min(1.0);
    let alpha: Vec<f32> = out.object.0[0].picture.samples().chunks(4).map(|p| p[3]).collect();
    let [r0, r1] = pair.map(rgb);
    [false, true].map(|rim| {
        let inside = |a: f32| if rim { a > 0.0 && a < 1.0 } else { a == 0.0 };
        let squares: Vec<f64> = (0..r0.len())
            .filter(|&i| inside(alpha[i / 3]) && reference[0][i] > 0.02)
            .map(|i| ratio(&r0, &r1, i) - ratio(reference[0], reference[1], i))
            .map(|e| e * e)
            .collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    })
}

// The first bound is the error of the shadow catcher of Cycles with a denoiser at 4 samples, 0.0103. The second,
// 0.02, is the aim at the rim of the object at 16 samples, where Cycles has 0.119. Both are already met at 4
// samples.
#[test]
fn the_ratio_raw_and_denoised_is_within_its_bars() {
    let case = case("sunny_plane");
    let reference = ["R0", "R1"].map(|layer| case.reference(&format!("ref-cycles/{layer}.exr")));
    let reference = [reference[0].as_slice(), reference[1].as_slice()];
    for (samples, bars) in [(4, [0.0103, 0.02]), (16, [0.0103, 0.02]), (64, [0.0075, 0.013])] {
        let out = trace(&case, samples, Surroundings::OPEN);
        let (clean, seconds) = denoised(&out, &Data::shared(Up::PlusY, 7));
        let raw = ratio_error(&out, [&out.without, &out.with], reference);
        let left = ratio_error(&out, [&clean.without, &clean.with], reference);
        println!("  RMSE of S and of its rim: raw {raw:.4?}, denoised {left:.4?} in {seconds:.2} CPU-s");
        assert!(left[0] < bars[0] && left[1] < bars[1], "{samples} samples: {left:?}");
        assert!(left[0] < raw[0] && left[1] < raw[1], "{samples} samples: {left:?} of {raw:?}");
    }
}

/// Trees of ten million triangles are built and traced, both for triangles that all lie at one position and for
/// rough ground. This test fails if `most_in_one_place` always returns 0.
#[test]
fn ten_million_triangles_are_built_and_met() {
    use glam::Vec3;
    use render::geometry::bvh::{Bvh, Ray};
    use render::geometry::sampling::{mix, unit};

    let down = |x: f32, y: f32| Ray::new(Vec3::new(x, y, 2.0), Vec3::NEG_Z);
    let crowd = Bvh::build(&vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 10_000_000]);
    assert_eq!(crowd.closest(down(0.2, 0.2), |_| true).map(|hit| hit.triangle), Some(0));
    drop(crowd);
    let side = 2237_u32;
    let at = |i: u32, j: u32| Vec3::new(i as f32, j as f32, unit(mix(i * 4096 + j)));
    let squares = (0..side * side).map(|k| (k / side, k % side));
    let halves = |(i, j)| {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    let ground = Bvh::build(&squares.flat_map(halves).collect::<Vec<_>>());
    for k in 0..10_000 {
        // Away from the edges of the squares, where either neighbour may be hit.
        let [x, y] =
            [2 * k, 2 * k + 1].map(|k| (unit(mix(k)) * side as f32).floor() + 0.1 + 0.8 * unit(mix(!k)));
        let hit = ground.closest(down(x, y), |_| true).expect("ground");
        assert_eq!(hit.triangle / 2, x as u32 * side + y as u32);
    }
}
