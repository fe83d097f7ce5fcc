//! Tests of `compare`.

use super::table::COMMON;
use super::*;
use engine::InputFile;
use scene::math::num;
use scene::types::{Cell, Data, Image, Linear, Srgb};
use testing::context;

fn one(picture: impl Into<Picture>) -> Arc<Images> {
    Arc::new(Images::single("v", picture))
}
fn node() -> Compare {
    Compare::default()
}
fn inputs(image: Arc<Images>, reference: Arc<Images>) -> In {
    In { image, reference, mask: None, regions: Vec::new(), background: None, no_shadow: None }
}
fn flat(v: f32) -> Arc<Images> {
    one(Image::<Srgb>::from_samples(16, 12, 3, vec![v; 576]))
}
fn left_half() -> Arc<Images> {
    one(Image::<Data>::from_samples(16, 12, 1, (0..192).map(|i| f32::from(i % 16 < 8)).collect()))
}

// A view whose pixels are all half transparent, and the same view composited on nothing, in light.
#[test]
fn what_is_open_is_black_in_the_numbers_of_the_picture() {
    use crate::kinds::composite::{Composite, In as Layers};
    let view = one(Image::<Srgb>::from_samples(16, 12, 4, [0.3, 0.2, 0.1, 0.5].repeat(192)));
    let layers = Layers {
        background: view.clone(),
        object: one(Image::<Linear>::new(16, 12, 4)),
        shadow: None,
        added: None,
        front: None,
        variance: None,
    };
    let (made, _) = Composite::run(&Composite { backdrop: None, ..Composite::default() }, layers, &context())
        .expect("runs");
    let off = |space: Space| {
        let node = Compare { space, quantise: false, ..node() };
        let (out, notes) =
            Compare::run(&node, inputs(made.image.clone(), view.clone()), &context()).expect("runs");
        let found = notes.iter().find(|note| note.id == "alpha-on-black").expect("a note");
        assert!(found.text.contains("(count: 192)"), "{}", found.text);
        out.difference.0[0].picture.samples()[0]
    };
    assert_eq!(off(Space::Linear), 0.0);
    let light = 0.5 * scene::math::color::linear_from_srgb(0.6);
    let expected = (scene::math::color::srgb_from_linear(light) - 0.3).abs();
    assert!((off(Space::Display) - expected).abs() < 1e-6 && expected > 0.1);
    let opaque = one(Image::<Srgb>::from_samples(16, 12, 4, [0.3, 0.2, 0.1, 1.0].repeat(192)));
    let (_, notes) = Compare::run(&node(), inputs(opaque.clone(), opaque), &context()).expect("runs");
    assert!(notes.iter().all(|note| note.id != "alpha-on-black"));
}

#[test]
fn rows_for_baselines_and_regions() {
    let names = vec!["left".to_owned()];
    let all = In {
        regions: vec![left_half()],
        background: Some(flat(0.2)),
        no_shadow: Some(flat(0.6)),
        ..inputs(flat(0.8), flat(0.8))
    };
    let (out, notes) = Compare::run(&Compare { names, ..node() }, all, &context()).expect("runs");
    assert_eq!(notes.iter().count(), 0);
    let table = &out.report.tables[0];
    let rows: Vec<(&Cell, &Cell, &Cell)> = table.rows.iter().map(|r| (&r[1], &r[2], &r[3])).collect();
    let text = |t: &str| Cell::Text(t.to_owned());
    assert_eq!(rows[0], (&text("image"), &text("whole"), &Cell::Count(192)));
    assert_eq!(rows[1], (&text("image"), &text("left"), &Cell::Count(96)));
    assert_eq!(rows[3], (&text("nothing inserted"), &text("left"), &Cell::Count(96)));
    assert_eq!(rows[4].0, &text("no shadow"));
    assert_eq!(table.rows[0][5], text("inf"));
    assert!(
        matches!(table.rows[2][5], Cell::Number(db) if (db - 4.436_974_992).abs() < 1e-8),
        "{:?}",
        table.rows[2][5]
    );
    assert_eq!(table.rows[1][7], Cell::Missing, "ssim_valid of a region is not computed");
    assert!(table.rows.iter().all(|row| row.len() == table.columns.len()));
}

#[test]
fn a_mask_restricts_everything_and_empty_regions_are_reported() {
    let half =
        one(Image::<Srgb>::from_samples(16, 12, 3, (0..576).map(|i| f32::from(i % 48 < 24)).collect()));
    let masked = In { mask: Some(left_half()), ..inputs(half.clone(), flat(1.0)) };
    let (out, notes) = Compare::run(&node(), masked, &context()).expect("runs");
    assert!(notes.iter().any(|note| note.id == "masked" && note.text.contains("`whole` and all regions")));
    assert_eq!(out.report.tables[0].rows[0][5], Cell::Text("inf".to_owned()));
    let nothing = one(Image::<Data>::new(16, 12, 1));
    let empty = In { regions: vec![nothing], ..inputs(half, flat(1.0)) };
    let (out, notes) = Compare::run(&node(), empty, &context()).expect("runs");
    assert!(notes.iter().any(|n| n.id == "empty-region"));
    assert_eq!(out.report.tables[0].rows[1][5], Cell::Missing);
}

#[test]
fn spaces_and_rounding_differ_as_they_should() {
    let dim = one(Image::<Linear>::from_samples(16, 12, 3, vec![0.5; 576]));
    let bright = one(Image::<Linear>::from_samples(16, 12, 3, vec![2.0; 576]));
    let psnr = |p: &Compare| {
        let (out, _) = Compare::run(p, inputs(dim.clone(), bright.clone()), &context()).expect("runs");
        match out.report.tables[0].rows[0][5] {
            Cell::Number(db) => db,
            _ => f64::NAN,
        }
    };
    let linear = psnr(&Compare { space: Space::Linear, ..node() });
    assert!((linear + 20.0 * libm::log10(1.5)).abs() < 1e-9);
    // The display clamps 2 to 1, and 0.5 is shown as code 187.5.
    let exact = psnr(&Compare { quantise: false, ..node() });
    assert!((exact + 20.0 * libm::log10(1.0 - 0.735_356_98)).abs() < 1e-5);
    assert!((psnr(&node()) + 20.0 * libm::log10(1.0 - 188.0 / 255.0)).abs() < 1e-9);
}

#[test]
fn difference_has_gain_and_mismatches_are_refused() {
    let p = Compare { gain: 2.0, ..node() };
    let (out, _) = Compare::run(&p, inputs(flat(0.2), flat(0.6)), &context()).expect("runs");
    assert!(out.difference.0[0].picture.samples().iter().all(|v| (v - 0.8).abs() < 1e-6));
    let small = one(Image::<Srgb>::new(4, 4, 3));
    assert!(Compare::run(&node(), inputs(flat(0.1), small), &context()).is_err());
    let (out, _) = Compare::run(&node(), inputs(flat(0.8), flat(0.8)), &context()).expect("runs");
    let bare = &out.report.tables[0].rows;
    assert!(
        bare.len() == 3 && bare[2][1] == Cell::Text("no shadow".to_owned()) && bare[2][5] == Cell::Missing,
        "{bare:?}"
    );
    assert!(Compare::run(&node(), inputs(flat(0.1), left_half()), &context()).is_err());
    let named = Compare { names: vec!["a".into()], ..node() };
    assert!(Compare::run(&named, inputs(flat(0.1), flat(0.1)), &context()).is_err());
}

#[test]
fn the_mean_of_shares_is_not_the_share_of_sums() {
    let p = Compare { scores: vec![[0.6, 0.2], [0.0, 0.0], [1.0, 3.0]], ..node() };
    let (out, _) = Compare::run(&p, inputs(flat(0.5), flat(0.5)), &context()).expect("runs");
    let table = &out.report.tables[1];
    let shares: Vec<&Cell> = table.rows.iter().map(|row| &row[3]).collect();
    let number = |cell: &Cell, want: f64| matches!(cell, Cell::Number(v) if (v - want).abs() < 1e-12);
    assert!(number(shares[0], 0.75) && *shares[1] == Cell::Missing && number(shares[2], 0.25));
    assert!(number(&table.rows[3][1], 0.8) && number(&table.rows[3][2], 1.6), "of the two that have one");
    assert!(number(shares[3], 0.5) && number(shares[4], 1.6 / 4.8), "{shares:?}");
}

#[test]
fn no_two_rows_of_a_view_have_one_name() {
    let twice = |names: [&str; 2]| {
        let names = names.map(str::to_owned).to_vec();
        let all = In { regions: vec![left_half(), left_half()], ..inputs(flat(0.2), flat(0.6)) };
        Compare::run(&Compare { names, ..node() }, all, &context()).map(|_| ())
    };
    assert!(twice(["left", "right"]).is_ok());
    for names in [["left", "left"], ["left", "whole"]] {
        let error = twice(names).expect_err("is refused");
        assert!(error.to_string().contains(names[1]), "{error}");
    }
}

#[test]
fn ratios_have_their_own_table() {
    let map = |dark: f32| {
        one(Image::<Data>::from_samples(
            16,
            12,
            1,
            (0..192).map(|i| if i % 16 < 8 { dark } else { 1.0 }).collect(),
        ))
    };
    let (out, _) = Compare::run(&node(), inputs(map(0.25), map(0.5)), &context()).expect("runs");
    let table = &out.report.tables[0];
    assert_eq!((out.report.tables.len(), &*table.name), (1, "ratio"));
    let value = |c: &str| {
        let at = table.columns.iter().position(|column| column.starts_with(c));
        table.rows[0][at.expect("is a column")].clone()
    };
    // Half of the pixels are off by a factor of two, and both have the same half in shadow.
    assert!(matches!(value("mean |ln"), Cell::Number(v) if (v - 0.5 * num::f64::ln(2.0)).abs() < 1e-12));
    assert_eq!(value("shadow IoU"), Cell::Number(1.0));
    let (out, _) = Compare::run(&node(), inputs(map(1.0), map(0.5)), &context()).expect("runs");
    assert_eq!(out.report.tables[0].rows[0].last(), Some(&Cell::Number(0.0)));
    assert!(out.flip.0.is_empty());
}

// Half of the pixels are black where the reference is one half. Infinite values differ from all finite ones.
#[test]
fn what_is_pitch_black_or_infinite_is_off() {
    let map = |dark: f32| one(Image::<Data>::from_samples(2, 1, 1, vec![dark, 1.0]));
    let row = |dark: f32| {
        let (out, _) = Compare::run(&node(), inputs(map(dark), map(0.5)), &context()).expect("runs");
        let table = &out.report.tables[0];
        let at = |name: &str| table.columns.iter().position(|c| c.starts_with(name)).expect("is a column");
        [at("psnr"), at("mean |ln")].map(|at| table.rows[0][at].clone())
    };
    let want = 0.5 * num::f64::ln(500.0);
    for dark in [0.0, -1.0, 1e-4] {
        assert!(matches!(row(dark)[1], Cell::Number(v) if (v - want).abs() < 1e-12), "{dark}");
    }
    assert_eq!(row(f32::INFINITY), [Cell::Text("-inf".to_owned()), Cell::Text("inf".to_owned())]);
    assert_eq!(row(0.5)[0], Cell::Text("inf".to_owned()));
    assert_eq!(row(f32::NAN)[1], Cell::Missing);
}

// A depth compared with itself: the background is infinite in both. Data of other channel counts is refused.
#[test]
fn what_is_infinite_alike_is_no_difference() {
    let depth = |channels: usize, values: &[f32]| {
        one(Image::<Data>::from_samples(values.len() / channels, 1, channels, values.to_vec()))
    };
    let row = |a: Arc<Images>, b: Arc<Images>| {
        let (out, notes) = Compare::run(&node(), inputs(a, b), &context()).expect("runs");
        let row = out.report.tables[0].rows[0][COMMON.len()..].to_vec();
        (row, notes.iter().map(|note| note.text.clone()).collect::<Vec<_>>().join("; "))
    };
    let far = [2.0, f32::INFINITY, 4.0, f32::NEG_INFINITY];
    let (own, notes) = row(depth(1, &far), depth(1, &far));
    let text = |text: &str| Cell::Text(text.to_owned());
    let zero = Cell::Number(0.0);
    assert_eq!(own, [text("inf"), zero.clone(), zero.clone(), zero, Cell::Number(1.0)]);
    assert_eq!(notes, "");
    let (off, _) = row(depth(1, &far), depth(1, &[2.5, f32::INFINITY, 4.0, f32::NEG_INFINITY]));
    assert_eq!(off[1], Cell::Number(0.125));
    assert_eq!(row(depth(1, &far), depth(1, &[2.0, 3.0, 4.0, 0.0])).0[1], text("inf"));
    let (_, notes) = row(depth(1, &[1.0, f32::NAN]), depth(1, &[1.0, 1.0]));
    assert!(notes.contains("1 of the samples had the value NaN"), "{notes}");
    let other = inputs(depth(1, &[1.0]), depth(3, &[1.0; 3]));
    let Err(reported) = Compare::run(&node(), other, &context()) else { panic!("is compared") };
    assert!(reported.to_string().contains("(picture: 1, reference: 3)"), "{reported}");
}

#[test]
fn luminance_alone_is_grey() {
    let light =
        |channels: usize, values: Vec<f32>| one(Image::<Linear>::from_samples(16, 12, channels, values));
    let ramp = |v: usize| v as f32 / 192.0;
    let grey = light(1, (0..192).map(ramp).collect());
    let clear = light(2, (0..192).flat_map(|v| [ramp(v), 1.0]).collect());
    let colour = light(3, (0..192).flat_map(|v| [ramp(v); 3]).collect());
    for other in [grey, clear] {
        let (out, _) = Compare::run(&node(), inputs(other, colour.clone()), &context()).expect("runs");
        assert_eq!(out.report.tables[0].rows[0][COMMON.len()], Cell::Text("inf".to_owned()));
    }
}

#[test]
fn what_a_viewer_sees_has_a_map_and_what_is_missing_is_reported() {
    let (out, notes) = Compare::run(&node(), inputs(flat(0.2), flat(0.6)), &context()).expect("runs");
    let map = out.flip.0[0].picture.samples();
    let table = &out.report.tables[0];
    let at = table.columns.iter().position(|c| c == "flip mean").expect("is a column");
    assert!(matches!(table.rows[0][at], Cell::Number(v) if (v - f64::from(map[0])).abs() < 1e-6 && v > 0.2));
    assert_eq!(table.rows[0][at + 3], Cell::Missing, "LPIPS without weights");
    assert_eq!(notes.iter().count(), 0, "nobody asked for LPIPS");
    let linear = Compare { space: Space::Linear, ..node() };
    let (hdr, _) = Compare::run(&linear, inputs(flat(0.2), flat(0.6)), &context()).expect("runs");
    let columns = &hdr.report.tables[0].columns;
    assert_eq!(columns[at..at + 2], ["hdr-flip mean", "hdr-flip p95"], "another measure has another name");
    assert_eq!(columns[..at], table.columns[..at]);
    // Weights that were not fetched.
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n";
    std::fs::write(folder.path().join("w"), pointer).unwrap_or_else(|e| panic!("{e}"));
    let scene = engine::Scene { up: engine::Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let cx = Context::detached(scene, folder.path());
    let unfetched = Compare { lpips: Some(InputFile("w".into())), ..node() };
    let error = Compare::run(&unfetched, inputs(flat(0.2), flat(0.6)), &cx).err().map(|e| e.to_string());
    assert!(error.is_some_and(|e| e.contains("git lfs pull")));
    let broken = Compare { lpips: Some(InputFile("none".into())), ..node() };
    assert!(Compare::run(&broken, inputs(flat(0.2), flat(0.6)), &context()).is_err());
}
