use engine::{Context, Scene, Up};

use super::*;
use crate::io::splats::{Frame, from_bytes, spz_rotation, unit};
use testing::context;

/// `count` splats of this degree, with values of all kinds.
pub fn scene(count: usize, degree: u32) -> Splats {
    let unit = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 1008.0;
    let spread = |i: usize, k: usize| unit(i, k) * 2.0 - 1.0;
    let quat = |i: usize| {
        let q = [0, 1, 2, 3].map(|k| spread(i, k + 20) + 0.01);
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        q.map(|v| v / length)
    };
    let width = sh_len(degree);
    Splats {
        means: (0..count).map(|i| [0, 1, 2].map(|k| spread(i, k) * 30.0)).collect(),
        means_low: Vec::new(),
        quats: (0..count).map(quat).collect(),
        scales: (0..count).map(|i| [3, 4, 5].map(|k| 0.001 + unit(i, k) * unit(i, 9))).collect(),
        opacities: (0..count).map(|i| unit(i, 6)).collect(),
        sh_degree: degree,
        sh: (0..count * width)
            .map(|j| [0, 1, 2].map(|k| if j % width == 0 { spread(j, k) * 3.0 } else { spread(j, k) * 0.9 }))
            .collect(),
        encoding: SplatEncoding::Srgb,
        antialiased: false,
    }
}

fn sh_len(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

fn off(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

fn off_rotation(a: &[[f32; 4]], b: &[[f32; 4]]) -> f32 {
    let angle = |(a, b): (&[f32; 4], &[f32; 4])| {
        // |a - b| and |a + b|: both signs are the same rotation.
        let chord = |s: f32| a.iter().zip(b).map(|(a, b)| (a - s * b) * (a - s * b)).sum::<f32>().sqrt();
        chord(1.0).min(chord(-1.0))
    };
    a.iter().zip(b).map(angle).fold(0.0, f32::max)
}

#[test]
fn ply_gives_back_what_it_was_given() {
    for degree in 0..=4 {
        let mut scene = scene(1500, degree);
        scene.opacities[..2].copy_from_slice(&[0.0, 1.0]);
        scene.scales[0] = [0.0, 1e-20, 1e5];
        let (bytes, notes) = encode(&scene, SaveFormat::Ply, Some(Up::PlusZ), &context()).unwrap();
        assert_eq!(notes.iter().count(), 0);
        let (back, _) = from_bytes("a.ply", &bytes, Frame::ByFormat, &context()).unwrap();
        assert_eq!((&back.means, &back.sh, back.sh_degree), (&scene.means, &scene.sh, degree));
        assert!(off(&back.opacities, &scene.opacities) < 3e-7);
        assert_eq!(back.opacities[..2], [0.0, 1.0]);
        for (a, b) in back.scales.as_flattened().iter().zip(scene.scales.as_flattened()) {
            // A logarithm of 46 in f32 carries 2e-6.
            assert!((a - b).abs() <= b * 4e-6, "{a} {b}");
        }
        assert!(off_rotation(&back.quats, &scene.quats) < 3e-7);
    }
}

#[test]
fn spz_gives_back_within_its_steps() {
    for (degree, up) in [(0, Up::PlusY), (1, Up::MinusY), (3, Up::PlusZ), (4, Up::MinusY)] {
        let mut scene = scene(1500, degree);
        scene.antialiased = degree == 3;
        let cx = Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
        let (bytes, notes) = encode(&scene, SaveFormat::Spz, Some(up), &cx).unwrap();
        assert!(notes.iter().all(|note| ["frame", "spz-version"].contains(&&*note.id)), "{notes:?}");
        // Only version 4 has harmonics of degree 4; the content is the same.
        assert_eq!(bytes.starts_with(b"NGSP"), degree == 4);
        assert_eq!(notes.iter().any(|note| note.id == "spz-version"), degree == 4);
        let (four, _) = encode(&scene, SaveFormat::Spz4, Some(up), &cx).unwrap();
        assert!(four.starts_with(b"NGSP\x04"));
        let (from_four, _) = from_bytes("a.spz", &four, Frame::ByFormat, &cx).unwrap();
        let (back, _) = from_bytes("a.spz", &bytes, Frame::ByFormat, &cx).unwrap();
        assert_eq!(back, from_four);
        assert_eq!((back.sh_degree, back.antialiased), (degree, scene.antialiased));
        let low = back.means_low.as_flattened().iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(low < 1e-5);
        assert!(off(back.means.as_flattened(), scene.means.as_flattened()) <= 0.51 / 65_536.0 + 2e-6);
        assert!(off(&back.opacities, &scene.opacities) <= 0.501 / 255.0);
        for (a, b) in back.scales.as_flattened().iter().zip(scene.scales.as_flattened()) {
            let log = crate::math::num::f64::ln(f64::from(*a) / f64::from(*b));
            assert!(log.abs() <= 0.501 / 16.0, "{a} {b}");
        }
        assert!(off_rotation(&back.quats, &scene.quats) < 0.004);
        let width = scene.sh_len();
        for (i, (a, b)) in back.sh.iter().zip(&scene.sh).enumerate() {
            // Constant: half a step of 1/255 over 0.15. Others: half a step of 1/128 in each of the up to nine
            // numbers that a rotation mixes, with weights whose squares sum to 1.
            let bar = if i % width == 0 { 0.0131 } else { 0.5 / 128.0 * 3.0 };
            assert!(off(a, b) <= bar, "{i} {a:?} {b:?}");
        }
    }
}

#[test]
fn what_does_not_fit_is_counted() {
    let mut scene = scene(40, 1);
    scene.scales[3] = [1000.0; 3];
    scene.sh[1] = [5.0, -5.0, 0.0];
    scene.sh[4] = [9.0, 0.0, 0.0];
    scene.means[7] = [1e6, 0.0, 0.0];
    scene.encoding = SplatEncoding::Linear;
    let (_, notes) = encode(&scene, SaveFormat::Spz, None, &context()).unwrap();
    let ids: Vec<&str> = notes.iter().map(|note| note.id.as_str()).collect();
    assert_eq!(ids, ["encoding-not-stored", "coarse-centres", "scales-cut", "colours-cut", "harmonics-cut"]);
    assert!(notes.iter().all(|note| note.level == engine::Level::Warning));
    for (id, says, count, loss) in [
        // The largest step, 255, is e^5.9375 units.
        ("scales-cut", "splat axes longer", "(3 of 120)", "divided by 2.639"),
        // 9 - 0.5 / 0.15 of the coefficient.
        ("colours-cut", "constant coefficients", "(1 of 120)", "by up to 1.599"),
        // 5 - 127 / 128.
        ("harmonics-cut", "other coefficients", "(2 of 360)", "by up to 4.008"),
    ] {
        let text = &notes.iter().find(|note| note.id == id).unwrap().text;
        assert!(text.starts_with(says) && text.contains(count) && text.contains(loss), "{text}");
    }
    scene.means[7] = [1e9, 0.0, 0.0];
    assert!(encode(&scene, SaveFormat::Spz, None, &context()).is_err());
}

// Centres move by no more than a 32nd of the median splat as long as 24 bits allow; otherwise it is reported.
#[test]
fn centres_are_as_fine_as_the_splats_ask_for() {
    let coarse = |width: f32, size: f32| {
        let mut scene = scene(300, 0);
        scene.means.iter_mut().flatten().for_each(|v| *v *= width / 30.0);
        scene.scales.fill([size; 3]);
        let (bytes, notes) = encode(&scene, SaveFormat::Spz, None, &context()).unwrap();
        let (back, _) = from_bytes("a.spz", &bytes, Frame::AsStored, &context()).unwrap();
        let reported = notes.iter().any(|note| note.id == "coarse-centres");
        (off(back.means.as_flattened(), scene.means.as_flattened()) / size, reported)
    };
    for (width, size, bar) in
        [(30.0, 0.01, 0.001), (1.0, 1e-3, 0.01), (1.0, 1e-4, 0.032), (1000.0, 0.01, 0.01)]
    {
        let (moved, reported) = coarse(width, size);
        assert!(moved < bar && !reported, "{width} {size}: {moved}");
    }
    for (width, size) in [(1e4, 1e-3), (1e6, 0.1)] {
        let (moved, reported) = coarse(width, size);
        assert!(moved > 0.12 && reported, "{width} {size}: {moved}");
    }
}

#[test]
fn equal_scenes_give_equal_files() {
    let scene = scene(40_000, 0);
    let one = encode(&scene, SaveFormat::Spz, None, &context()).unwrap().0;
    assert_eq!(one, encode(&scene, SaveFormat::Spz, None, &context()).unwrap().0);
    // No time: bytes 4 to 7 of a gzip header.
    assert_eq!(one[4..8], [0; 4]);
}

/// Rotations that were read from a file are written unchanged, even if the largest components of a rotation are
/// equal up to rounding, or if a component that rounds to zero is negative. If two codes decode to exactly the same
/// rotation, the first code is written. This test fails if the value of `AS_LARGE` is 1e-7.
#[test]
fn rotations_of_spz_come_back_as_they_were() {
    let sizes = [0_u32, 1, 2, 87, 208, 294, 295, 296, 360, 361, 362, 417, 509, 510, 511];
    let (mut valid, mut twins) = (0, 0);
    for which in 0..4 {
        for code in 0..sizes.len().pow(3) {
            let [a, b, c] = [1, 15, 225].map(|digit| sizes[code / digit % sizes.len()]);
            let signs = (a * 5 + b * 3 + c) % 8;
            let part = |size: u32, bit: u32| (signs >> bit & 1) << 9 | size;
            let word = which << 30 | part(a, 2) << 20 | part(b, 1) << 10 | part(c, 0);
            let step = std::f64::consts::FRAC_1_SQRT_2 / 511.0;
            let others = [a, b, c].map(|size| f64::from(size) * step);
            let left = (1.0 - others.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
            // Writers omit only the largest component, except for rounding.
            if others.iter().any(|v| *v > left + 2.0 * step) {
                continue;
            }
            let read = |word| unit(spz_rotation(word)).unwrap().map(f32::to_bits);
            let written = spz::rotation(read(word).map(f32::from_bits));
            assert_eq!(read(written), read(word), "{word:x} {written:x}");
            (valid, twins) = (valid + 1, twins + u32::from(written != word));
        }
    }
    assert!(valid > 4000 && twins * 200 < valid, "{twins} of {valid}");

    let mut scene = scene(2000, 1);
    for (i, quat) in scene.quats.iter_mut().enumerate() {
        let small = [0.0, 1e-4, -1e-4, 1e-3][i % 4];
        let tie = [[0.5, -0.5, 0.5, 0.5], [0.7, 0.7, small, -small], [small, 0.6, -0.6, 0.5]][i % 3];
        if i % 2 == 0 {
            *quat = unit(tie.map(f64::from)).unwrap();
        }
    }
    let written = |scene: &Splats| encode(scene, SaveFormat::Spz, None, &context()).unwrap().0;
    let first = written(&scene);
    let (back, _) = from_bytes("a.spz", &first, Frame::AsStored, &context()).unwrap();
    assert!(written(&back) == first);
}

/// Thin axes are lengthened and reported even if the other axes of the splat are long.
#[test]
fn every_axis_that_grows_is_reported() {
    let mut scene = scene(40, 0);
    scene.scales[3] = [0.1, 1e-6, 0.2];
    scene.scales[7] = [1e-7, 1e-8, 0.2];
    let (_, notes) = encode(&scene, SaveFormat::Spz, Some(Up::PlusY), &context()).unwrap();
    let reported: Vec<_> =
        notes.iter().filter(|note| note.id == "splats-grown").map(|note| &note.text).collect();
    assert!(
        reported.len() == 1
            && reported[0].starts_with("splat axes shorter")
            && reported[0].contains("(3 of 120)")
            && reported[0].contains("1.0e-8"),
        "{reported:?}"
    );
}
