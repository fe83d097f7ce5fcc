//! Tests of every splat format on real files and on test files of other programs.

use std::sync::Arc;

use engine::{Context, InputFile, Kind, Notes, Up};
use nodes::kinds::load_splats::{self, Frame, LoadSplats};
use scene::io::splats::from_bytes;
use scene::io::splats::save::{SaveFormat, encode};
use scene::types::Splats;
use testkit::Data;

use super::data;

fn cx() -> Context {
    Data::shared(Up::MinusY, 7).context()
}

fn load(path: &str, frame: Frame) -> (Arc<Splats>, Notes) {
    let path = InputFile(format!("splats/{path}"));
    let params =
        LoadSplats { path, more: Vec::new(), strict: true, max_extent: 1e6, level: 0, frame, matrix: None };
    let (out, notes) = LoadSplats::run(&params, load_splats::In {}, &cx()).unwrap();
    (out.splats, notes)
}

/// Largest absolute difference between corresponding elements of two lists.
fn off(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

/// Angle between the rotations of two Gaussians, in degrees. Half turns about an axis of the Gaussian are ignored,
/// since they do not change its shape.
fn turned(a: [f32; 4], [w, x, y, z]: [f32; 4]) -> f64 {
    let same = [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
    let dot = |b: [f32; 4]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(b)).sum::<f64>().abs();
    let nearest = same.into_iter().map(dot).fold(0.0, f64::max);
    2.0 * scene::math::num::f64::acos(nearest.min(1.0)).to_degrees()
}

// One object in two formats, written by different programs from one source, splat for splat in the same
// order. The SPZ file has +y up, as its format says; the PLY has -y up.
#[test]
fn biker_is_the_same_in_both_formats() {
    let (spz, notes) = load("biker.spz", Frame::ByFormat);
    let (ply, _) = load("biker.compressed.ply", Frame::ByFormat);
    assert_eq!((spz.len(), ply.len(), spz.sh_degree, ply.sh_degree), (152_746, 152_746, 0, 0));
    assert!(notes.iter().any(|note| note.id == "frame"));
    // SPZ steps by 1/4096; a chunk of the PLY is at most some 3 wide and has 1023 or 2047 steps.
    let centres = off(spz.means.as_flattened(), ply.means.as_flattened());
    // Bytes of 1/255 over 0.15 compared with bytes over the range of a chunk.
    let colours = off(spz.sh.as_flattened(), ply.sh.as_flattened());
    let opacities = off(&spz.opacities, &ply.opacities);
    // SPZ knows no smaller scale than e^-10, and steps by 1/16.
    let log = |v: &f32| scene::math::num::f32::ln(*v).max(-10.0);
    let logs = |s: &Splats| s.scales.as_flattened().iter().map(log).collect::<Vec<_>>();
    let scales = off(&logs(&spz), &logs(&ply));
    let mut turns: Vec<f64> = spz.quats.iter().zip(&ply.quats).map(|(a, b)| turned(*a, *b)).collect();
    turns.sort_by(f64::total_cmp);
    let (middle, largest) = (turns[turns.len() / 2], turns[turns.len() - 1]);
    println!(
        "centres {centres:.2e}, coefficients {colours:.3}, opacities {opacities:.4}, log scales {scales:.4}"
    );
    println!("rotations: median {middle:.3} degrees, largest {largest:.3}");
    assert!(centres < 1.5e-3);
    assert!(colours < 0.03);
    assert!(opacities < 1.5 / 255.0);
    assert!(scales < 0.06);
    assert!(middle < 0.2 && largest < 12.0);
}

// The fixtures of splat-transform (`create-fixtures.mjs`): four splats on a grid in the plane y = 0, sizes 0.1,
// opacity 230 / 255.
#[test]
fn fixtures_of_another_program_are_read() {
    for name in [
        "minimal-raw.spz",
        "minimal-v2.spz",
        "minimal-v3.spz",
        "minimal-v4.spz",
        "minimal.ksplat",
        "minimal.splat",
    ] {
        let (splats, _) = load(&format!("fixtures/{name}"), Frame::AsStored);
        assert_eq!((splats.len(), splats.sh_degree), (4, 0), "{name}");
        for i in 0..4 {
            // Newer fixtures were saved with z negated, by a library that turned them.
            let [x, y, z] = splats.means[i];
            assert_eq!(
                ([x, y, z.abs()], i % 2),
                ([[-1.0, 0.0][i % 2], 0.0, [1.0, 0.0][i / 2]], i % 2),
                "{name}"
            );
            assert!((splats.opacities[i] - 230.0 / 255.0).abs() < 1e-6, "{name}");
            // A step of the logarithm is 1/16.
            assert!(splats.scales[i].iter().all(|s| (s - 0.1).abs() < 0.0032), "{name}");
        }
    }
    // The old plain stream and its gzipped form.
    assert_eq!(
        load("fixtures/minimal-raw.spz", Frame::AsStored).0,
        load("fixtures/minimal-v2.spz", Frame::AsStored).0
    );
    assert_eq!(
        load("fixtures/minimal-v3.spz", Frame::AsStored).0,
        load("fixtures/minimal-v4.spz", Frame::AsStored).0
    );
}

#[test]
fn captures_have_the_counts_of_their_makers() {
    for (name, count, degree) in [
        ("arkit-room.splat", 116_906, 0),
        ("sh3-7k.inria.ply", 9_080, 3),
        ("train-1000.inria.ply", 1_000, 3),
        ("garden_sog", 843_068, 0),
        ("playbot_sog", 125_000, 2),
        ("playbot_sog/2_0", 125_000, 2),
    ] {
        let (splats, notes) = load(name, Frame::ByFormat);
        assert_eq!((splats.len(), splats.sh_degree), (count, degree), "{name}");
        assert!(notes.iter().all(|note| note.level != engine::Level::Count), "{name}: {notes:?}");
    }
}

// A real capture is the same after it has been written and read again.
#[test]
fn captures_survive_writing() {
    for name in ["train-1000.inria.ply", "playbot_sog", "biker.spz"] {
        let (splats, _) = load(name, Frame::ByFormat);
        let (bytes, _) = encode(&splats, SaveFormat::Ply, Some(Up::MinusY), &cx()).unwrap();
        let (back, _) = from_bytes("a", &bytes, Frame::ByFormat, &cx()).unwrap();
        assert_eq!((&back.means, &back.sh), (&splats.means, &splats.sh), "{name}");
        // Log scales to -12 in f32 carry 1e-6 of the scale, quaternions are normalised again.
        assert!(off(back.scales.as_flattened(), splats.scales.as_flattened()) < 2e-6, "{name}");
        assert!(off(back.quats.as_flattened(), splats.quats.as_flattened()) < 3e-7, "{name}");
        let (bytes, _) = encode(&splats, SaveFormat::Spz, Some(Up::MinusY), &cx()).unwrap();
        let (back, _) = from_bytes("a", &bytes, Frame::ByFormat, &cx()).unwrap();
        println!("{name}: {} splats in {} bytes of SPZ", splats.len(), bytes.len());
        assert!(off(back.means.as_flattened(), splats.means.as_flattened()) < 1e-5, "{name}");
        assert!(off(&back.opacities, &splats.opacities) < 0.502 / 255.0, "{name}");
    }
}

// Every real file cut off and changed in places: an error or a scene, never a panic.
#[test]
fn damaged_captures_are_survived() {
    for name in [
        "biker.spz",
        "biker.compressed.ply",
        "train-1000.inria.ply",
        "arkit-room.splat",
        "fixtures/minimal-v4.spz",
    ] {
        let bytes = data().bytes(&format!("splats/{name}"));
        for part in 1..8 {
            let length = bytes.len() * part / 8 + 1;
            let cut = from_bytes("a", &bytes[..length], Frame::ByFormat, &cx());
            assert!(cut.is_err(), "{name} cut at {length}");
            let mut changed = bytes.clone();
            (0..40).for_each(|i| changed[(length * 7919 + i * 104_729) % bytes.len()] ^= 1 << (i % 8));
            if let Ok((splats, _)) = from_bytes("a", &changed, Frame::ByFormat, &cx()) {
                assert!(splats.means.as_flattened().iter().all(|v| v.is_finite()));
            }
        }
    }
}
