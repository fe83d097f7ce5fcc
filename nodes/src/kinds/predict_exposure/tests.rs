//! Tests of `predict-exposure`.

mod clipped;
mod diffusion;
mod pixels;
mod suns;

use super::*;
use engine::InputFile;
use engine::{Kind, Scene, Up};
use render::light::hidden::clip::clip_mask;
use render::light::hidden::clipped::Clipped;
use render::light::hidden::grid::Grid;
use render::light::linear::{LinearPixels, Transfer, linear_pixels};
use scene::math::equirect::pixel_solid_angle;
use scene::types::Srgb;
use scene::types::{Panorama, Picture};
use testing::context as cx;
use testing::row;

fn pano(width: usize, colour: impl Fn(usize, usize) -> [f32; 3]) -> Arc<Panorama> {
    let height = width / 2;
    let samples = (0..width * height).flat_map(|i| colour(i % width, i / width)).collect();
    Arc::new(Panorama {
        image: Image::<Srgb>::from_samples(width, height, 3, samples).into(),
        alpha: Image::from_samples(width, height, 1, vec![1.0; width * height]),
        up: Up::PlusZ,
        origin: None,
        turned_deg: 0.0,
    })
}

fn run(pano: Arc<Panorama>, evs: &[f64]) -> (Arc<Brackets>, Notes) {
    run_by(Method::Region, pano, evs)
}

const METHODS: [Method; 2] = [Method::Region, Method::Learned];

fn run_by(method: Method, pano: Arc<Panorama>, evs: &[f64]) -> (Arc<Brackets>, Notes) {
    let params = PredictExposure { evs: evs.to_vec(), method, white: CLIPPED, weights: None };
    let (out, notes) = PredictExposure::run(&params, In { pano }, &cx()).expect("runs");
    (out.brackets, notes)
}

// Neither the grid nor the distribution of light changes the total light or the light of a lamp by more than
// rounding and the edges of pixels. This test fails if hidden light is recorded without `/ grid.solid_angle(..)`.
#[test]
fn the_sums_of_a_prediction_agree() {
    let params = PredictExposure { evs: vec![-3.0], method: Method::Learned, white: CLIPPED, weights: None };
    let (out, _) = PredictExposure::run(&params, In { pano: room(512) }, &cx()).expect("runs");
    let steps = out.report.tables.iter().find(|table| table.name == "steps").expect("has the table");
    assert_eq!(steps.columns, ["quantity", "panorama", "on the grid", "predicted on the grid", "predicted"]);
    assert_eq!(steps.rows.len(), 3 + 2, "a window and a lamp");
    for (i, within) in [(0, 1e-3), (3, 0.03), (4, 0.03)] {
        let number = |cell: &Cell| if let Cell::Number(v) = cell { *v } else { panic!("a number") };
        let row: Vec<f64> = steps.rows[i][1..].iter().map(number).collect();
        assert!((row[1] / row[0] - 1.0).abs() < within, "{row:?}");
        assert!((row[2] / row[3] - 1.0).abs() < within && row[3] > row[0], "{row:?}");
    }
}

/// Room with a window that lies across the seam, and a lamp of a few pixels.
fn room(width: usize) -> Arc<Panorama> {
    pano(width, move |x, y| {
        let (x, y) = (x * 256 / width, y * 256 / width);
        let window = (44..64).contains(&y) && !(14..246).contains(&x);
        let lamp = (30..34).contains(&y) && (100..104).contains(&x);
        if window || lamp { [1.0, 1.0, 0.99] } else { [0.5, 0.45, 0.4] }
    })
}

fn flux(brackets: &Brackets, pano: &Panorama, of: impl Fn(usize) -> bool) -> f64 {
    let (w, h) = (brackets.log2_gain.width, brackets.log2_gain.height);
    let pixels = linear_pixels(&pano.image, Transfer::Srgb);
    let light = |at: usize| {
        let gain = num::f64::exp2(brackets.log2_gain.samples[at].into());
        gain * f64::from(luminance(pixels.rgb[at])) * pixel_solid_angle(w, h, at / w)
    };
    (0..w * h).filter(|&at| of(at)).map(light).sum()
}

// The stops are those of the published formula, evaluated by a separate program on the nine numbers of the two
// regions; the flux of each region must then have increased by that.
#[test]
fn the_flux_of_a_region_is_what_the_regression_says() {
    let pano = room(256);
    let (brackets, _) = run(pano.clone(), &[-3.0]);
    let plain = Brackets { log2_gain: Image::new(256, 128, 1), ..(*brackets).clone() };
    let lamp = |at: usize| brackets.log2_gain.samples[at] > 0.0 && (20..240).contains(&(at % 256));
    let window = |at: usize| brackets.log2_gain.samples[at] > 0.0 && !(20..240).contains(&(at % 256));
    let stops =
        |of: &dyn Fn(usize) -> bool| num::f64::log2(flux(&brackets, &pano, of) / flux(&plain, &pano, of));
    assert!((stops(&window) - 2.515).abs() < 1e-3, "{}", stops(&window));
    assert!((stops(&lamp) - 2.203).abs() < 1e-3, "{}", stops(&lamp));
}

/// In a uniform panorama, no pixel is brighter in an exposure than in a brighter exposure or in the panorama. Only
/// black gives black, extreme values stay finite, and no value of an exposure is above white.
#[test]
fn flat_panoramas_stay_monotone_and_finite() {
    for method in METHODS {
        for value in [0.0, 0.5, 1.0, 40.0, f32::NAN, f32::INFINITY, -1.0] {
            let (brackets, notes) = run_by(method.clone(), pano(64, |_, _| [value; 3]), &[-3.0, -9.0, -6.0]);
            assert_eq!(brackets.evs, [-9.0, -6.0, -3.0]);
            let base = pano(64, |_, _| [if value.is_finite() { value.max(0.0) } else { 0.0 }; 3]);
            let base = base.image.samples();
            let [darkest, darker, dark] = [0, 1, 2].map(|i| brackets.exposures[i].samples.as_slice());
            for (fewer, more) in [(darkest, darker), (darker, dark), (dark, base)] {
                for (a, b) in fewer.iter().zip(more) {
                    assert!(
                        (0.0..=1.0).contains(a) && a <= b && (*b > 0.0) == (*a > 0.0),
                        "{value}: {a} {b}"
                    );
                }
            }
            if value <= 0.5 {
                assert!(brackets.log2_gain.samples.iter().all(|&g| g == 0.0));
                assert!(notes.iter().any(|note| note.id == "nothing-clipped"));
                assert_eq!(brackets.report.tables[0].rows[0][0], Cell::Text("skip".to_owned()));
            } else if value.is_finite() {
                assert!(notes.iter().any(|note| note.id == "nothing-visible"));
            }
            assert_eq!(notes.iter().any(|note| note.id == "not-finite"), !value.is_finite());
        }
    }
    let white =
        LinearPixels { width: 1, height: 1, rgb: vec![[1.0; 3]], broken: 0, negative: 0, ceiling: true };
    assert_eq!(
        expose(&white, &[9.0], None, -3.0),
        [1.0; 3],
        "a light that outshines an exposure is white in it"
    );
}

/// Largest difference between the gain of a rotated panorama and the gain of the original panorama after the same
/// rotation.
fn off_turned(plain: &Brackets, turned: &Brackets, shift: usize) -> f64 {
    let width = plain.log2_gain.width;
    let from = |at: usize| plain.log2_gain.pixel((at % width + shift) % width, at / width)[0];
    let off =
        turned.log2_gain.samples.iter().enumerate().map(|(at, gain)| f64::from((gain - from(at)).abs()));
    off.fold(0.0, f64::max)
}

/// Rolling the panorama horizontally rolls the prediction, even if a window lies across the seam or a single
/// clipped pixel lies at the seam.
#[test]
fn rolling_the_panorama_rolls_the_gain() {
    let dot = |x: usize, y: usize| if (x, y) == (0, 40) { [1.0; 3] } else { [0.4, 0.5, 0.6] };
    for (method, source) in METHODS.into_iter().flat_map(|m| [(m.clone(), room(256)), (m, pano(256, dot))]) {
        let plain = run_by(method.clone(), source.clone(), &[-3.0]).0;
        let shift = 77;
        let rolled = pano(256, |x, y| match &source.image {
            Picture::Srgb(image) => image.rgb((x + shift) % 256, y),
            _ => unreachable!(),
        });
        let rolled = run_by(method.clone(), rolled, &[-3.0]).0;
        row(24, "stops that a roll by 77 columns changes", off_turned(&plain, &rolled, shift), 2e-4);
    }
}

/// The colour of hidden light has a luminance of 1 on clipped pixels, is 0 elsewhere, is shown by the exposures, and
/// rolls with the panorama. This test fails if `exposed` ignores `colour`, or if the pixels of two regions are
/// exchanged.
#[test]
fn hidden_light_has_a_colour_where_pixels_are_clipped() {
    for width in [128, 256, 512] {
        let source = room(width);
        let brackets = run_by(Method::Learned, source.clone(), &[-12.0]).0;
        let pixels = linear_pixels(&source.image, Transfer::Srgb);
        let mask = clip_mask(&source, &pixels, CLIPPED);
        let colour = brackets.colour.as_ref().expect("is predicted");
        for (at, clipped) in mask.iter().enumerate() {
            let rgb = colour.rgb(at % width, at / width);
            if !clipped {
                assert_eq!(rgb, [0.0; 3]);
                continue;
            }
            assert!((luminance(rgb) - 1.0).abs() < 1e-4, "{rgb:?}");
            let gain = num::f32::exp2(brackets.log2_gain.samples[at]);
            let hidden = luminance(pixels.rgb[at]) * (gain - 1.0);
            for (c, of_light) in rgb.into_iter().enumerate() {
                let light = (pixels.rgb[at][c] + of_light * hidden) / 4096.0;
                let shown = Transfer::Srgb.linear(brackets.exposures[0].samples[3 * at + c]);
                assert!((shown - light.min(1.0)).abs() < 1e-5, "{at} {c}: {shown} {light}");
            }
        }
        let shift = 77;
        let rolled = pano(width, |x, y| match &source.image {
            Picture::Srgb(image) => image.rgb((x + shift) % width, y),
            _ => unreachable!(),
        });
        let rolled = run_by(Method::Learned, rolled, &[-3.0]).0.colour.clone().expect("is predicted");
        let from = |at: usize| colour.rgb((at % width + shift) % width, at / width);
        for at in 0..mask.len() {
            let (found, wanted) = (rolled.rgb(at % width, at / width), from(at));
            assert!(
                (0..3).all(|c| (found[c] - wanted[c]).abs() < 1e-4),
                "{width} {at}: {found:?} {wanted:?}"
            );
        }
    }
    assert!(run_by(Method::Region, room(256), &[-3.0]).0.colour.is_none());
}

/// If a panorama that is finer than the grid is rotated, its gain rotates with it, even if the rotation is smaller
/// than the width of a cell.
#[test]
fn turning_by_part_of_a_cell_turns_the_gain() {
    let width = 300;
    let scene = |x: usize, y: usize| match (x, y) {
        (299 | 0, 50) => [1.0; 3],
        (100..=130, 30..=45) => [1.0, 1.0, 0.98],
        (_, 75..) => [0.3, 0.28, 0.2],
        _ => [0.4, 0.5, 0.5 + x as f32 * 8e-4],
    };
    for method in METHODS {
        let plain = run_by(method.clone(), pano(width, scene), &[-3.0]).0;
        for shift in [1, 151] {
            let turned = pano(width, |x, y| scene((x + shift) % width, y));
            let turned = run_by(method.clone(), turned, &[-3.0]).0;
            row(24, "stops that a turn by part of a cell changes", off_turned(&plain, &turned, shift), 2e-4);
        }
    }
}

// The learned light of a panorama is the output of the network, whatever pixels it is distributed over, and the
// report gives its uncertainty.
#[test]
fn learned_flux_is_what_the_network_says() {
    for width in [256, 1024] {
        let pano = room(width);
        let pixels = linear_pixels(&pano.image, Transfer::Srgb);
        let mask = clip_mask(&pano, &pixels, CLIPPED);
        let clipped = Clipped::new(pano.up, &pano.alpha.samples, (&pixels, &mask, 1.0));
        let scene = network::Scene::new(&clipped.grid, clipped.up, &clipped.labels, 1.0);
        let network = network::parse("w", network::WEIGHTS).expect("is sound");
        let want: f64 = network::hidden(&network, &scene, clipped.labels.count).cells.iter().sum();
        let (brackets, _) = run_by(Method::Learned, pano.clone(), &[-3.0]);
        let plain = Brackets { log2_gain: Image::new(width, width / 2, 1), ..(*brackets).clone() };
        let found = flux(&brackets, &pano, |_| true) - flux(&plain, &pano, |_| true);
        assert!((found / want - 1.0).abs() < 1e-4, "{found} {want}");
        let sure = |row: &Vec<Cell>| matches!(row[5], Cell::Number(stops) if stops > 0.0 && stops < 8.0);
        assert!(brackets.report.tables[1].rows.iter().all(sure));
    }
}

#[test]
fn exposures_are_sorted_and_listed_once() {
    assert_eq!(run(room(64), &[-3.0, -20.0, -6.0]).0.evs, [-20.0, -6.0, -3.0]);
    assert!(run(room(64), &[-20.0]).0.exposures[0].samples.iter().all(|v| v.is_finite()));
    let params = PredictExposure {
        evs: vec![-3.0, -6.0, -3.0],
        method: Method::Region,
        white: CLIPPED,
        weights: None,
    };
    assert!(PredictExposure::check(&params).is_err());
    let many = PredictExposure { evs: (1..=65).map(|ev| -0.1 * f64::from(ev)).collect(), ..params };
    assert!(PredictExposure::check(&many).expect_err("are too many").to_string().contains("65 exposures"));
}

// A weights file that the method does not use is reported. This test fails without the warning.
#[test]
fn weights_that_no_method_reads_are_reported() {
    let weights = Some(InputFile("own.safetensors".to_owned()));
    let params = |method| PredictExposure { evs: vec![], method, white: CLIPPED, weights: weights.clone() };
    let run = |method| PredictExposure::run(&params(method), In { pano: room(64) }, &cx());
    let (_, notes) = run(Method::Region).expect("runs");
    assert!(notes.iter().any(|note| note.id == "weights-unused" && note.text.contains("own.safetensors")));
    assert!(run(Method::Learned).err().expect("is not there").to_string().contains("own.safetensors"));
}

#[test]
fn emitters_act_where_the_user_states_them() {
    let source = room(256);
    // The lamp of the room, at columns 100 to 104 and rows 30 to 34 of 256x128.
    let (azimuth, elevation) = (360.0 * (102.0 / 256.0 - 0.5), 90.0 - 180.0 * 32.0 / 128.0);
    let stated = |emitters: Vec<[f64; 4]>| {
        let params = PredictExposure {
            evs: vec![-3.0],
            method: Method::Manual { emitters },
            white: CLIPPED,
            weights: None,
        };
        PredictExposure::check(&params)?;
        PredictExposure::run(&params, In { pano: source.clone() }, &cx())
    };
    let (out, _) = stated(vec![[azimuth, elevation, 10.0, 5.0]]).expect("runs");
    for (at, gain) in out.brackets.log2_gain.samples.iter().enumerate() {
        let lamp = (30..34).contains(&(at / 256)) && (100..104).contains(&(at % 256));
        assert_eq!(*gain, if lamp { 5.0 } else { 0.0 });
    }
    // A sun within a bright sky: the narrower light is used where both cover a pixel, whichever comes first.
    for order in [[0, 1], [1, 0]] {
        let both = [[azimuth, elevation, 180.0, 2.0], [azimuth - 1.0, elevation, 4.0, 8.0]];
        let (out, notes) = stated(order.map(|i| both[i]).to_vec()).expect("runs");
        let lamp = out.brackets.log2_gain.pixel(102, 32)[0];
        assert!(lamp == 8.0 && out.brackets.log2_gain.pixel(0, 50)[0] == 2.0, "{lamp}");
        assert!(notes.iter().all(|note| note.id != "nothing-to-light"));
    }
    let (out, notes) =
        stated(vec![[azimuth, elevation, 4.0, 3.0], [azimuth + 180.0, -80.0, 3.0, 5.0]]).expect("runs");
    let idle = notes.iter().find(|note| note.id == "nothing-to-light").expect("a note");
    assert!(idle.text.starts_with("emitters without effect") && idle.text.ends_with(": 2"), "{}", idle.text);
    // The report lists the window and the lamp of the panorama, whatever lights were given.
    let report = &out.brackets.report;
    assert_eq!(report.tables[0].rows[0][3], Cell::Count(2));
    let gains: Vec<_> = report.tables[1].rows.iter().map(|row| [row[3].clone(), row[4].clone()]).collect();
    assert!(gains.contains(&[3.0, 3.0].map(Cell::Number)) && gains.contains(&[0.0, 0.0].map(Cell::Number)));
    // Pixels that no emitter covers are reported, as with `Skip`. This test fails if the report ignores
    // `Method::Manual`.
    let mask = clip_mask(&source, &linear_pixels(&source.image, Transfer::Srgb), CLIPPED);
    let all = mask.iter().filter(|clipped| **clipped).count();
    let kept = |notes: &Notes| notes.iter().find(|n| n.id == "clipping-kept").map(|n| n.text.clone());
    let (_, none) = stated(Vec::new()).expect("runs");
    assert_eq!(kept(&none), Some(format!("clipped pixels that are not changed: {all} of {all}")));
    assert_eq!(kept(&stated(vec![[0.0, 0.0, 180.0, 5.0]]).expect("runs").1), None);
    assert!(stated(vec![[1e300, 5.0, 3.0, 5.0]]).is_err());
    assert!(stated(vec![[0.0, 95.0, 3.0, 5.0]]).is_err() && stated(vec![[0.0, 5.0, 0.0, 5.0]]).is_err());
}
