use crate::exposure::{Network, Scale};
use scene::math::num;

use super::truth::{Shot, Truth};
use super::*;
use render::light::hidden::network::LIMITS;

#[test]
fn files_of_one_place_go_together() {
    assert_eq!(place("brown_photostudio_03"), place("brown_photostudio_07"));
    assert_eq!(place("kloppenheim_01_puresky"), place("kloppenheim_07"));
    assert_ne!(place("snowy_field"), place("snow_field_puresky"));
    assert_eq!(place("kiara_1_dawn"), "kiara_1_dawn");
}

// A short training on procedural panoramas gives the same bytes again, both in one run and resumed from stored
// networks, and the forward pass can read the file.
#[test]
fn a_training_repeats_and_resumes() {
    let folder = tempfile::tempdir().expect("a folder");
    let recipe = Recipe { steps: 4, batch: 4, ..Recipe::default() };
    let plan = Plan { seed: 3, members: 2, folds: 2, procedural: 6, recipe };
    let panoramas =
        || (0..4).map(|i| (format!("place{i}_x"), procedural::panorama(9, i))).collect::<Vec<_>>();
    let run = |parts: &Path, stop: usize| {
        let mut reported = 0;
        train(panoramas(), &plan, parts, &mut |progress| {
            reported += usize::from(matches!(progress, Progress::Step { .. }));
            reported < stop
        })
        .expect("trains")
    };
    assert!(run(folder.path(), 6).is_none(), "stopped");
    let resumed = run(folder.path(), 1000).expect("is done");
    let fresh = run(tempfile::tempdir().expect("a folder").path(), 1000).expect("is done");
    assert!(resumed.weights == fresh.weights && resumed.scores.len() == 4);
    assert!(Forward::parse("w", &fresh.weights, [OVERVIEW, CELL, COLOUR]).is_ok());
    assert!(fresh.regions.starts_with(judge::COLUMNS) && fresh.regions == resumed.regions);
    assert!(fresh.regions.lines().all(|line| line.split(',').count() == 9), "{}", fresh.regions);
}

// If one fold has all the places, the others leave nothing to learn from, which is reported before training. This
// test fails if `chosen.is_empty()` is not checked (candle then reports an error of its own).
#[test]
fn too_few_places_to_part_are_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let recipe = Recipe { steps: 1, batch: 1, ..Recipe::default() };
    let plan = Plan { seed: 3, members: 1, folds: 2, procedural: 0, recipe };
    let panoramas = vec![("place_x".to_owned(), procedural::panorama(9, 0))];
    let error = train(panoramas, &plan, folder.path(), &mut |_| true).err().expect("is refused");
    assert!(error.to_string().contains("--folds"), "{error}");
}

// Visible and hidden light add up to the truth in pictures without softening.
#[test]
fn an_example_keeps_the_books() {
    for index in 0..6 {
        let truth = Truth::new(procedural::panorama(5, index)).expect("has light");
        let example = truth.example(Shot::plain(0.5)).expect("photographs");
        let hidden: f64 = example.hidden.iter().sum();
        let sum = example.visible[0] + hidden;
        assert!((sum / example.truth[0] - 1.0).abs() < 0.02, "{index}: {sum} {:?}", example.truth);
    }
}

// Repeating each pixel four times is the same light: a finer photograph hides as much, and the sums are those of
// cells. With glints a cell is clipped in part, and hides no more than the glints hold. This test fails if
// `of_cell` counts only the last pixel of a cell, or if `real` leaves out the glints.
#[test]
fn a_finer_photograph_of_the_same_light_hides_as_much() {
    for index in 0..4 {
        let coarse = procedural::panorama(5, index);
        let samples = (0..FINE * FINE / 2).flat_map(|at| coarse.rgb(at % FINE / 2, at / FINE / 2));
        let fine = Image::from_samples(FINE, FINE / 2, 3, samples.collect());
        let truth = Truth::new(fine).expect("has light");
        let of = |shot: Shot| {
            let example = truth.example(shot).expect("photographs");
            [example.visible[0], example.truth[0], example.hidden.iter().sum(), example.scene.open_flux]
        };
        let plain = of(Shot::plain(0.5));
        let finer = Shot { fine: true, ..Shot::plain(0.5) };
        let found = of(finer);
        assert!(plain.iter().zip(&found).all(|(a, b)| (a / b - 1.0).abs() < 1e-4), "{plain:?} {found:?}");
        let glints = of(Shot { glints: 60, ..finer });
        let pixel = 2.0 * std::f64::consts::PI * std::f64::consts::PI / (FINE * FINE / 2) as f64;
        let more = glints[2] - found[2];
        assert!(more > 0.0 && more < 60.0 * 2.0 * pixel, "{more} {pixel}");
        assert!(glints[3] > found[3] - 60.0 * pixel, "cells stay open but for glints");
    }
}

// The built-in forward pass compared with that of candle, and the amount with float64, with the built-in weights.
#[test]
fn the_forward_pass_agrees_with_candle() {
    let weights =
        scene::math::nn::Weights::parse("w", render::light::hidden::network::WEIGHTS).expect("is sound");
    let tensor = |name: &str| weights.tensor(name).expect("is there");
    let scale = |name: &str| Scale {
        mean: tensor(&format!("{name}.mean")).1,
        spread: tensor(&format!("{name}.spread")).1,
    };
    let forward = Forward::parse("w", render::light::hidden::network::WEIGHTS, [OVERVIEW, CELL, COLOUR])
        .expect("is sound");
    let members = tensor("score.out").0[0];
    for index in 0..4 {
        let truth = Truth::new(procedural::panorama(2, index)).expect("has light");
        let scene = truth.example(Shot::plain(0.3)).expect("photographs").scene;
        let features: Vec<&[f32]> = scene.cells.iter().map(|cell| cell.features.as_slice()).collect();
        let flux: Vec<f64> = scene.cells.iter().map(|cell| cell.flux).collect();
        let ours = forward.predict(&scene.overview, &features, &flux);
        let (mut overview, mut flat) = (scene.overview.to_vec(), features.concat());
        scale("overview").apply(&mut overview, LIMITS[0]);
        scale("cell").apply(&mut flat, LIMITS[1]);
        let log_flux: Vec<f32> = flux.iter().map(|v| num::f64::ln(*v) as f32).collect();
        let (weight, bias) = (tensor("amount.linear").1, f64::from(tensor("amount.bias").1[0]));
        let products = overview.iter().zip(&weight).map(|(v, w)| f64::from(*v) * f64::from(*w));
        let wanted = products.sum::<f64>() + bias;
        assert!((wanted - ours.amount).abs() < 1e-5, "{wanted} {}", ours.amount);
        for (member, ours) in ours.shares.iter().enumerate() {
            let one = |name: &'static str| {
                let (shape, values) = tensor(name);
                let each = values.len() / members;
                (name, shape[1..].to_vec(), values[member * each..][..each].to_vec())
            };
            let network = Network { tensors: weights::TENSORS.map(one).to_vec() };
            let shares = exposure::predict(&network, &overview, &flat, &log_flux).expect("runs");
            for (a, b) in shares.iter().zip(ours) {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{a} {b}");
            }
        }
    }
}
