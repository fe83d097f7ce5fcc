//! Tests of metrics against the values of published packages, and of regions against the bench case.

use std::sync::Arc;

use engine::{InputFile, Kind, Up};
use nodes::kinds::compare::{self, Compare, Space};
use nodes::kinds::load_image::{self, FileEncoding, LoadImage, Orientation};
use nodes::kinds::region_masks::{self, RegionMasks};
use nodes::kinds::score_env::{self, ScoreEnv};
use scene::math::metrics::{Exposures, PIXELS_PER_DEGREE, Plane, hdr_flip_map};
use scene::types::{Cell, Environment, Images, Picture, Report};

use super::data;

fn image(path: &str, encoding: FileEncoding) -> Arc<Images> {
    let p = LoadImage {
        path: InputFile(path.into()),
        encoding,
        orientation: Orientation::Upright,
        layer: String::new(),
        more: Vec::new(),
        names: vec!["v".into()],
    };
    LoadImage::run(&p, load_image::In {}, &data().context()).unwrap().0.image
}

fn table(report: &Report, row: usize, column: &str) -> f64 {
    let table = &report.tables[0];
    let column = table.columns.iter().position(|c| c.starts_with(column)).unwrap();
    match &table.rows[row][column] {
        Cell::Number(x) => *x,
        Cell::Text(t) if t == "inf" => f64::INFINITY,
        other => panic!("{other:?}"),
    }
}

fn number(v: &serde_json::Value) -> f64 {
    v.as_f64().unwrap_or_else(|| if v == "inf" { f64::INFINITY } else { panic!("{v}") })
}

fn plain() -> Compare {
    Compare {
        space: Space::Display,
        quantise: true,
        names: Vec::new(),
        gain: 1.0,
        pixels_per_degree: PIXELS_PER_DEGREE,
        lpips: None,
        lpips_scaled: true,
        scores: Vec::new(),
    }
}

// scikit-image, torch and torchmetrics in f64; the README suggests 1e-9.
#[test]
fn psnr_and_ssim_agree_with_published_packages() {
    let refs: serde_json::Value = data().json("metric-refs/refs.json");
    let mut largest = 0.0_f64;
    for (name, wanted) in refs["ldr"].as_object().unwrap() {
        let file = |part: &str, e| image(&format!("metric-refs/{name}_{part}.png"), e);
        let inputs = compare::In {
            image: file("test", FileEncoding::Auto),
            reference: file("ref", FileEncoding::Auto),
            mask: None,
            regions: vec![file("mask", FileEncoding::Data)],
            background: None,
            no_shadow: None,
        };
        let report = Compare::run(&plain(), inputs, &data().context()).unwrap().0.report;
        for (row, column, key) in [
            (0, "psnr", "psnr"),
            (0, "ssim_3dgs_zero_pad", "ssim_3dgs_zero_pad"),
            (0, "ssim_valid", "ssim_valid"),
            (0, "mean absolute", "mae"),
            (1, "psnr", "masked_psnr"),
            (1, "ssim_3dgs_zero_pad", "masked_ssim_3dgs_zero_pad"),
            (1, "share", "mask_fraction"),
        ] {
            let (ours, theirs) = (table(&report, row, column), number(&wanted[key]));
            let off = if ours == theirs { 0.0 } else { (ours - theirs).abs() };
            largest = largest.max(off);
            assert!(off < 1e-9, "{name} {key}: {ours} against {theirs}");
        }
    }
    println!("largest deviation {largest:e}");
}

#[test]
fn relative_mse_agrees_on_linear_light() {
    let refs: serde_json::Value = data().json("metric-refs/refs.json");
    for (name, wanted) in refs["hdr"].as_object().unwrap() {
        let file = |part: &str| image(&format!("metric-refs/{name}_{part}.exr"), FileEncoding::Auto);
        let inputs = compare::In {
            image: file("test"),
            reference: file("ref"),
            mask: None,
            regions: Vec::new(),
            background: None,
            no_shadow: None,
        };
        let p = Compare { space: Space::Linear, ..plain() };
        let report = Compare::run(&p, inputs, &data().context()).unwrap().0.report;
        let (ours, theirs) = (table(&report, 0, "relative mse"), number(&wanted["rel_mse_eps1e2"]));
        assert!((ours - theirs).abs() < 1e-9 * theirs.max(1.0), "{name}: {ours} against {theirs}");
        let (ours, theirs) =
            (table(&report, 0, "psnr"), -10.0 * scene::math::num::f64::log10(number(&wanted["mse"])));
        assert!((ours - theirs).abs() < 1e-9, "{name}: {ours} against {theirs}");
    }
}

/// The panorama error of `score-env` agrees with a reference for the same pictures. This error is weighted by solid
/// angle and is relative to the mean of the truth.
#[test]
fn panoramas_are_weighed_as_the_reference_does() {
    for (name, wanted) in refs()["hdr"].as_object().unwrap() {
        let file = |part: &str| {
            let images = image(&format!("metric-refs/{name}_{part}.exr"), FileEncoding::Auto);
            let Picture::Linear(image) = images.0[0].picture.clone() else { panic!("is linear") };
            Arc::new(Environment { image: image.into(), up: Up::PlusZ, origin: None })
        };
        let (env, truth) = (file("test"), file("ref"));
        let (mut mean, mut sphere) = (0.0, 0.0);
        let (width, height) = (truth.image.width, truth.image.height);
        for i in 0..width * height {
            let weight = scene::math::equirect::pixel_solid_angle(width, height, i / width);
            sphere += 3.0 * weight;
            mean += weight * truth.image.rgb(i % width, i / width).map(f64::from).iter().sum::<f64>();
        }
        let report =
            ScoreEnv::run(&ScoreEnv { normals: 16 }, score_env::In { env, truth }, &data().context())
                .unwrap()
                .0
                .report;
        let row = report.tables[0]
            .rows
            .iter()
            .find(|row| matches!(&row[0], Cell::Text(t) if t.starts_with("panorama,")));
        let Cell::Number(ours) = row.unwrap()[1] else { panic!("is a number") };
        let theirs = number(&wanted["solid_angle_weighted_mae"]) / (mean / sphere);
        assert!((ours / theirs - 1.0).abs() < 1e-9, "{name}: {ours} against {theirs}");
    }
}

fn refs() -> serde_json::Value {
    data().json("metric-refs/refs.json")
}

fn pair(test: Arc<Images>, reference: Arc<Images>, regions: Vec<Arc<Images>>) -> compare::In {
    compare::In { image: test, reference, mask: None, regions, background: None, no_shadow: None }
}

// scikit-image in f64: 1e-9. The FLIP tool computes in f32 and rounds a matrix to six digits: 2e-4.
#[test]
fn flip_and_ciede2000_agree_with_published_tools() {
    let mut largest = [0.0_f64; 2];
    for (name, wanted) in refs()["ldr"].as_object().unwrap() {
        let file = |part: &str, e| image(&format!("metric-refs/{name}_{part}.png"), e);
        let inputs = || {
            let mask = file("mask", FileEncoding::Data);
            pair(file("test", FileEncoding::Auto), file("ref", FileEncoding::Auto), vec![mask])
        };
        let (out, _) = Compare::run(&plain(), inputs(), &data().context()).unwrap();
        let flip = &wanted["flip_ldr"];
        let far = Compare { pixels_per_degree: 32.0, ..plain() };
        let far = Compare::run(&far, inputs(), &data().context()).unwrap().0.report;
        let most = out.flip.0[0].picture.samples().iter().copied().fold(0.0, f32::max);
        for (ours, theirs) in [
            (table(&out.report, 0, "flip mean"), &flip["mean"]),
            (table(&out.report, 0, "flip p95"), &flip["map_p95"]),
            (table(&out.report, 1, "flip mean"), &flip["masked_mean"]),
            (f64::from(most), &flip["map_max"]),
            (table(&far, 0, "flip mean"), &wanted["flip_ldr_ppd32"]),
        ] {
            largest[0] = largest[0].max((ours - number(theirs)).abs());
        }
        let ours = table(&out.report, 0, "ciede2000");
        largest[1] = largest[1].max((ours - number(&wanted["ciede2000_mean"])).abs());
    }
    println!("largest deviations: FLIP {:e}, CIEDE2000 {:e}", largest[0], largest[1]);
    assert!(largest[0] < 2e-5 && largest[1] < 1e-9);
}

// The tool rounds its exposures to f32, and takes them from a luminance of six digits: 5e-5 stops.
#[test]
fn hdr_flip_agrees_with_the_published_tool() {
    for (name, wanted) in refs()["hdr"].as_object().unwrap() {
        let file = |part: &str| image(&format!("metric-refs/{name}_{part}.exr"), FileEncoding::Auto);
        let plane = |images: &Images| {
            let picture = &images.0[0].picture;
            let (width, height, channels) = picture.size();
            let samples = picture.samples().iter().map(|v| f64::from(*v)).collect();
            Plane { width, height, channels, samples }
        };
        let theirs = &wanted["flip_hdr_ACES"];
        let exposures = Exposures::of(&plane(&file("ref"))).unwrap();
        assert_eq!(exposures.count as f64, number(&theirs["n"]), "{name}");
        assert!((exposures.start_ev - number(&theirs["start"])).abs() < 5e-5, "{name}");
        assert!((exposures.stop_ev - number(&theirs["stop"])).abs() < 5e-5, "{name}");
        let linear = Compare { space: Space::Linear, ..plain() };
        let (out, _) =
            Compare::run(&linear, pair(file("test"), file("ref"), Vec::new()), &data().context()).unwrap();
        let off = table(&out.report, 0, "hdr-flip mean") - number(&theirs["mean"]);
        let fixed = Exposures { start_ev: -4.0, stop_ev: 2.0, count: 3 };
        let map = hdr_flip_map(
            &plane(&file("ref")),
            &plane(&file("test")),
            fixed,
            PIXELS_PER_DEGREE,
            &data().context(),
        );
        let map = map.unwrap();
        let mean = map.iter().sum::<f64>() / map.len() as f64;
        let off_fixed = mean - number(&wanted["flip_hdr_fixed_m4_2_3"]);
        println!("{name}: {off:e} {off_fixed:e}");
        assert!(off.abs() < 2e-5 && off_fixed.abs() < 2e-5, "{name}: {off} {off_fixed}");
    }
}

// The packages compute in f32 or, as these references, in f64; our features are f32: 1e-5 relative.
#[test]
fn lpips_agrees_with_the_published_graph_on_random_weights() {
    let mut largest = 0.0_f64;
    for (name, wanted) in refs()["ldr"].as_object().unwrap() {
        for (network, wanted) in wanted["lpips_random"].as_object().unwrap() {
            let file = |part: &str| image(&format!("metric-refs/{name}_{part}.png"), FileEncoding::Auto);
            for (key, lpips_scaled) in [("value", true), ("value_inputs_0_1", false)] {
                let weights = InputFile(format!("metric-refs/lpips_random_{network}.safetensors"));
                let p = Compare { lpips: Some(weights), lpips_scaled, ..plain() };
                let (out, notes) =
                    Compare::run(&p, pair(file("test"), file("ref"), Vec::new()), &data().context()).unwrap();
                assert_eq!(notes.iter().count(), 0);
                let (ours, theirs) = (table(&out.report, 0, "lpips"), number(&wanted[key]));
                largest = largest.max((ours - theirs).abs() / theirs.max(1e-12));
            }
        }
    }
    println!("largest relative deviation {largest:e}");
    assert!(largest < 1e-5, "{largest}");
}

// README of bench-case: baselines "nothing inserted" and the shadow region it ships.
#[test]
fn bench_case_regions_and_baselines() {
    let read = |v: usize, part: &str, e| image(&format!("bench-case/gt/view_{v}_{part}.png"), e);
    for (view, whole, shadow, object) in [(0, 33.1, 22.3, 16.8), (1, 33.8, 17.4, 17.7), (2, 30.7, 17.7, 16.0)]
    {
        let p =
            RegionMasks { object_threshold: 0.5, edge_threshold: 0.0, shadow_threshold: 0.02, contact: 0.05 };
        let inputs = region_masks::In {
            object: read(view, "object_alpha", FileEncoding::Data),
            shadow: None,
            without: Some(read(view, "without", FileEncoding::Auto)),
            with: Some(read(view, "with", FileEncoding::Auto)),
        };
        let masks = RegionMasks::run(&p, inputs, &data().context()).unwrap().0;
        let truth = read(view, "shadow_region", FileEncoding::Data);
        let (a, b) = (masks.shadow.0[0].picture.samples(), truth.0[0].picture.samples());
        let channels = truth.0[0].picture.size().2;
        let (mut both, mut either) = (0, 0);
        for (x, y) in a.iter().zip(b.chunks_exact(channels)) {
            both += u32::from(*x > 0.5 && y[0] > 0.5);
            either += u32::from(*x > 0.5 || y[0] > 0.5);
        }
        let p = Compare { names: vec!["shadow".into(), "object".into()], ..plain() };
        let inputs = compare::In {
            image: read(view, "without", FileEncoding::Auto),
            reference: read(view, "with", FileEncoding::Auto),
            mask: None,
            regions: vec![truth.clone(), masks.object],
            background: None,
            no_shadow: None,
        };
        let report = Compare::run(&p, inputs, &data().context()).unwrap().0.report;
        let found = [0, 1, 2].map(|row| table(&report, row, "psnr"));
        println!("view {view}: overlap {both} of {either}; {found:.2?}");
        // Printed with one digit, of the float pictures; ours are of the 8-bit ones. Their object region
        // has its own threshold.
        assert!((found[0] - whole).abs() < 0.1 && (found[1] - shadow).abs() < 0.1, "{found:?}");
        assert!((found[2] - object).abs() < 0.8, "{found:?}");
        assert!(f64::from(both) > 0.85 * f64::from(either), "{both} of {either}");
    }
}
