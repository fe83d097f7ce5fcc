use super::*;
use crate::equirect::pixel_solid_angle;
use crate::testing::row;
use crate::types::Srgb;
use engine::{Kind, Scene, Up};
use glam::DVec3;

fn cx() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7 }, ".")
}

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
    let params = PredictExposure { evs: evs.to_vec(), method, white: CLIPPED, weights: None, force: false };
    let (out, notes) = PredictExposure::run(&params, In { pano }, &cx()).expect("runs");
    (out.brackets, notes)
}

// What the check leaves out is nothing: asked all the same, no method gives light to a panorama in which nothing is
// clipped, be it black, grey, or a room whose window and lamp end just below.
#[test]
fn a_prediction_that_is_forced_where_nothing_is_clipped_changes_no_bit() {
    let mut room = (*room(128)).clone();
    if let Picture::Srgb(image) = &mut room.image {
        image.samples.iter_mut().for_each(|v| *v = v.min(0.97));
    }
    let flat = |value: f32| pano(64, move |_, _| [value; 3]);
    for source in [Arc::new(room), flat(0.0), flat(0.6)] {
        for method in METHODS {
            let run = |force: bool| {
                let params = PredictExposure {
                    evs: vec![-3.0, -6.0],
                    method: method.clone(),
                    white: CLIPPED,
                    weights: None,
                    force,
                };
                let (out, notes) =
                    PredictExposure::run(&params, In { pano: source.clone() }, &cx()).expect("runs");
                let note = notes.iter().find(|note| note.id == "nothing-clipped").map(|n| n.text.clone());
                (out.brackets, note.unwrap_or_default())
            };
            let ((left, told), (forced, why)) = (run(false), run(true));
            assert!(left.log2_gain == forced.log2_gain && left.exposures == forced.exposures, "{method:?}");
            assert!(told.ends_with("nothing is predicted") && why.ends_with("by `force`"), "{told}; {why}");
            let name = |brackets: &Brackets| brackets.report.tables[0].rows[0][0].clone();
            assert_eq!(name(&left), Cell::Text("skip".to_owned()));
            assert_ne!(name(&forced), name(&left), "the report says what was asked");
        }
    }
}

// Neither the grid nor sharing out what is found on it changes the light of the whole or of a lamp by more than rounding
// and the edges of pixels. Mutation: hidden light entered without `/ grid.solid_angle(..)`.
#[test]
fn the_books_of_a_prediction_agree() {
    let params = PredictExposure {
        evs: vec![-3.0],
        method: Method::Learned,
        white: CLIPPED,
        weights: None,
        force: false,
    };
    let (out, _) = PredictExposure::run(&params, In { pano: room(512) }, &cx()).expect("runs");
    let steps = out.report.tables.iter().find(|table| table.name == "steps").expect("has books");
    assert_eq!(steps.columns, ["", "panorama", "on the grid", "predicted on the grid", "predicted"]);
    assert_eq!(steps.rows.len(), 3 + 2, "a window and a lamp");
    for (i, within) in [(0, 1e-3), (3, 0.03), (4, 0.03)] {
        let number = |cell: &Cell| if let Cell::Number(v) = cell { *v } else { panic!("a number") };
        let row: Vec<f64> = steps.rows[i][1..].iter().map(number).collect();
        assert!((row[1] / row[0] - 1.0).abs() < within, "{row:?}");
        assert!((row[2] / row[3] - 1.0).abs() < within && row[3] > row[0], "{row:?}");
    }
}

/// A room with a window that lies across the seam and a lamp of a few pixels.
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

#[test]
fn gain_is_zero_outside_of_clipped_pixels_and_positive_within() {
    let pano = room(256);
    let (brackets, _) = run(pano.clone(), &[-3.0]);
    let mask = clip_mask(&pano, &linear_pixels(&pano.image, Transfer::Srgb), CLIPPED);
    for (gain, clipped) in brackets.log2_gain.samples.iter().zip(mask) {
        assert!(gain.is_finite() && (*gain > 0.0) == clipped, "{gain} {clipped}");
    }
    assert_eq!(brackets.report.tables[1].rows.len(), 2, "the window is one region across the seam");
}

// The stops are those of the published formula, evaluated by a separate program on the nine numbers of
// the two regions; the flux of each region must then have grown by as much.
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

/// Each exposure is darker than the next and than the panorama, black alone is black, extremes stay finite, and white is the most that an exposure holds.
#[test]
fn row_23_flat_panoramas_stay_monotone_and_finite() {
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
    assert_eq!(expose(&white, &[9.0], -3.0), [1.0; 3], "a light that outshines an exposure is white in it");
}

/// How far the gain of a turned panorama is off the gain turned by as many columns.
fn off_turned(plain: &Brackets, turned: &Brackets, shift: usize) -> f64 {
    let width = plain.log2_gain.width;
    let from = |at: usize| plain.log2_gain.pixel((at % width + shift) % width, at / width)[0];
    let off =
        turned.log2_gain.samples.iter().enumerate().map(|(at, gain)| f64::from((gain - from(at)).abs()));
    off.fold(0.0, f64::max)
}

/// A horizontal roll rolls the prediction, also of one pixel and of a sun on the seam.
#[test]
fn row_24_rolling_the_panorama_rolls_the_gain() {
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

/// Also of a panorama finer than the grid, by less than a cell.
#[test]
fn row_24_turning_by_part_of_a_cell_turns_the_gain() {
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

/// A mirrored panorama has the mirrored light, finer than the grid too. Mutation: `from_start` for `from_end` in
/// `Grid::new`, or edges read to the right alone.
#[test]
fn a_mirrored_panorama_gives_mirrored_light() {
    let scene = |width: usize| {
        move |x: usize, y: usize| {
            let at = (x * 300 / width, y * 300 / width);
            match at {
                (299 | 0, 50) | (201, 20..=22) => [1.0; 3],
                (100..=130, 30..=45) => [1.0, 1.0, 0.98],
                (_, 75..) => [0.3, 0.28, 0.2],
                _ => [0.4, 0.5, 0.5 + at.0 as f32 * 8e-4],
            }
        }
    };
    for (method, width) in METHODS.into_iter().flat_map(|m| [(m.clone(), 300), (m, 512)]) {
        let scene = scene(width);
        let plain = run_by(method.clone(), pano(width, scene), &[-3.0]).0;
        let mirrored = run_by(method, pano(width, |x, y| scene(width - 1 - x, y)), &[-3.0]).0;
        for (at, gain) in mirrored.log2_gain.samples.iter().enumerate() {
            let from = plain.log2_gain.pixel(width - 1 - at % width, at / width)[0];
            assert!((gain - from).abs() < 2e-4, "{width}: {at} {gain} {from}");
        }
    }
}

#[test]
fn recovered_light_does_not_depend_on_the_resolution() {
    let small = room(256);
    for method in METHODS {
        let want = flux(&run_by(method.clone(), small.clone(), &[-3.0]).0, &small, |_| true);
        for width in [512, 1024, 768] {
            let large = room(width);
            let found = flux(&run_by(method.clone(), large.clone(), &[-3.0]).0, &large, |_| true);
            assert!(num::f64::log2(found / want).abs() < 0.02, "{width}: {found} {want}");
        }
    }
}

// A panorama with fewer columns than the networks learned from is judged with as many: each pixel several times gives the
// same light. Mutation: `Enlarged::new` to `None`, or `gathered` of the first part alone.
#[test]
fn a_coarse_panorama_is_judged_on_the_same_grid() {
    let (fine, coarse) = (room(256), room(128));
    let by = |pano: &Arc<Panorama>| run_by(Method::Learned, pano.clone(), &[-3.0]).0;
    let [want, found] = [&fine, &coarse].map(|pano| flux(&by(pano), pano, |_| true));
    assert!((found / want - 1.0).abs() < 1e-4, "{found} {want}");
    let (a, b) = (by(&fine).report.clone(), by(&coarse).report.clone());
    assert_eq!(a.tables[1].rows, b.tables[1].rows, "the same regions");
}

// Glints, single pixels that clip on a finer panorama, hide the light of their pixels and not of the cells of the grid that
// they lie in: of a room with a glint in each fourth cell of the floor `Learned`, to which so many are as much white on the floor,
// tells at most half as much light again, `Region` less; and each cell keeps the share of it that is open.
// Mutation: `share` 1 for each cell that is clipped in part.
#[test]
fn glints_do_not_count_as_whole_cells() {
    let (width, plain) = (1024, room(1024));
    let glint = |x: usize, y: usize| y > 300 && x % 8 == 3 && y % 8 == 5;
    let source = |x: usize, y: usize| match &plain.image {
        Picture::Srgb(_) if glint(x, y) => [1.0; 3],
        Picture::Srgb(image) => image.rgb(x, y),
        _ => unreachable!(),
    };
    let glints = pano(width, source);
    for (method, most) in METHODS.into_iter().zip([0.3, 0.6]) {
        let [without, with] = [&plain, &glints].map(|pano| {
            let brackets = run_by(method.clone(), pano.clone(), &[-3.0]).0;
            let black = Brackets { log2_gain: Image::new(width, width / 2, 1), ..(*brackets).clone() };
            flux(&brackets, pano, |_| true) / flux(&black, pano, |_| true)
        });
        let more = num::f64::log2(with / without);
        assert!(more.abs() < most, "{method:?}: {more:+.3} stops");
    }
    let pixels = linear_pixels(&glints.image, Transfer::Srgb);
    let mask = clip_mask(&glints, &pixels, CLIPPED);
    let grid = Grid::new(&pixels, &mask, &glints.alpha.samples);
    let sum = |angle: &dyn Fn(usize) -> f64| (0..grid.rgb.len()).map(angle).sum::<f64>();
    let clipped = (0..mask.len()).filter(|at| mask[*at]);
    let clipped: f64 = clipped.map(|at| pixel_solid_angle(width, width / 2, at / width)).sum();
    assert!((sum(&|c| grid.clipped_angle(c)) / clipped - 1.0).abs() < 1e-9);
    let whole = sum(&|c| grid.open_angle(c) + grid.clipped_angle(c));
    assert!((whole / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-9);
}

// The learned light of a panorama is what the network says, whatever pixels it is shared out among; and the
// report tells how sure it is.
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
fn holes_are_not_clipped() {
    let mut pano = (*room(128)).clone();
    pano.alpha.samples.fill(0.0);
    let (brackets, notes) = run(Arc::new(pano), &[-3.0]);
    assert!(brackets.log2_gain.samples.iter().all(|&g| g == 0.0));
    assert!(notes.iter().any(|note| note.id == "nothing-clipped"));
}

// What a hole was filled with tells nothing of the light, also where a cell of the grid is part hole.
// Mutation: the two sums of `Grid::new` taken together, or alpha not asked in `first_column`.
#[test]
fn what_fills_a_hole_changes_no_gain() {
    for method in METHODS {
        let gain = |fill: [f32; 3]| {
            let mut pano = (*room(300)).clone();
            let Picture::Srgb(image) = &mut pano.image else { panic!("display colours") };
            for at in (0..300 * 150).filter(|at| at / 300 > 101 || (at % 300 > 250 && at / 300 > 30)) {
                pano.alpha.samples[at] = 0.0;
                image.samples[3 * at..][..3].copy_from_slice(&fill);
            }
            run_by(method.clone(), Arc::new(pano), &[-3.0]).0.log2_gain.clone()
        };
        let black = gain([0.0; 3]);
        assert!(black.samples.iter().any(|gain| *gain > 0.0));
        assert_eq!(black, gain([0.3, 0.8, 0.99]), "{method:?}");
    }
}

// White that is mostly transparent is told, and nothing contradicts it. Mutation: `tell_unseen` not asked.
#[test]
fn white_that_is_mostly_transparent_is_told() {
    let mut pano = (*pano(64, |x, y| if (x, y) == (5, 8) { [1.0; 3] } else { [0.5; 3] })).clone();
    pano.alpha.samples[8 * 64 + 5] = 0.4;
    let (_, notes) = run(Arc::new(pano), &[-3.0]);
    let text = |id: &str| notes.iter().find(|n| n.id == id).map(|n| n.text.clone()).unwrap_or_default();
    assert!(text("white-unseen").starts_with("1 white pixels"), "{notes:?}");
    assert!(text("nothing-clipped").contains("reaches 0.214 "), "{notes:?}");
}

// Mutation: `<` to `<=` in `tell_coarse`, or it not called.
#[test]
fn a_panorama_too_coarse_for_lamps_is_told() {
    for (width, told) in [(32, Some("a pixel of the panorama is 11.2 degrees wide")), (64, None)] {
        let (_, notes) = run(pano(width, |_, _| [0.5; 3]), &[-3.0]);
        let text = notes.iter().find(|note| note.id == "coarse").map(|note| note.text.clone());
        assert_eq!(text.is_some(), told.is_some(), "{text:?}");
        assert!(told.is_none_or(|told| text.is_some_and(|text| text.starts_with(told))));
    }
}

// Linear light that ends at white was clipped there; where it goes on above, what lies near white is what it is.
// Mutation: `pixels.ceiling` not asked in `clip_mask`.
#[test]
fn linear_light_is_clipped_at_white_unless_it_holds_more() {
    let mut pano = (*pano(64, |_, _| [0.5; 3])).clone();
    let mut image = Image::<crate::types::Linear>::from_samples(64, 32, 3, vec![0.2; 64 * 32 * 3]);
    image.pixel_mut(5, 8).fill(1.0);
    pano.image = image.clone().into();
    let (brackets, _) = run(Arc::new(pano.clone()), &[-3.0]);
    assert!(brackets.log2_gain.pixel(5, 8)[0] > 0.0);
    image.pixel_mut(20, 8).fill(90.0);
    pano.image = image.into();
    for method in METHODS {
        let (brackets, notes) = run_by(method, Arc::new(pano.clone()), &[-3.0]);
        assert!(brackets.log2_gain.samples.iter().all(|gain| *gain == 0.0));
        assert!(notes.iter().any(|note| note.id == "nothing-clipped" && note.text.contains("above white")));
    }
}

#[test]
fn row_35_exposures_are_sorted_and_listed_once() {
    assert_eq!(run(room(64), &[-3.0, -20.0, -6.0]).0.evs, [-20.0, -6.0, -3.0]);
    assert!(run(room(64), &[-20.0]).0.exposures[0].samples.iter().all(|v| v.is_finite()));
    let params = PredictExposure {
        evs: vec![-3.0, -6.0, -3.0],
        method: Method::Region,
        white: CLIPPED,
        weights: None,
        force: false,
    };
    assert!(PredictExposure::check(&params).is_err());
    let many = PredictExposure { evs: (1..=65).map(|ev| -0.1 * f64::from(ev)).collect(), ..params };
    assert!(PredictExposure::check(&many).expect_err("are too many").to_string().contains("65 exposures"));
}

// A clipped disc of a few pixels at 45 degrees is the sun where it stands in a clear sky, also in the white balance of a
// sunset, and no sun in a blue room, under a white ceiling over a brown floor, or in an overcast sky; where little of the
// sky is seen it gives a part.
// Mutation: `with_suns` without its loop; `clear` 1; either number of `CLEAR` 0.
#[test]
fn a_lone_small_light_in_a_sky_bluer_than_the_ground_is_taken_for_the_sun() {
    for method in METHODS {
        let seen = |columns: usize, colour: [f32; 3], ground: [f32; 3]| {
            let pano = pano(256, |x, y| match (x, y) {
                (60..=61, 32..=33) => [1.0; 3],
                (_, 64..) => ground,
                _ if (x + 68) % 256 < 128 + columns / 2 && (x + 68) % 256 >= 128 - columns / 2 => colour,
                _ => [0.5; 3],
            });
            let (brackets, notes) = run_by(method.clone(), pano.clone(), &[-3.0]);
            let sun = flux(&brackets, &pano, |at| brackets.log2_gain.samples[at] > 0.0);
            let rest = flux(&brackets, &pano, |at| brackets.log2_gain.samples[at] == 0.0);
            (sun / rest, notes.iter().any(|note| note.id == "sun"))
        };
        let share = |colour: [f32; 3], ground: [f32; 3]| seen(256, colour, ground);
        let grey = [0.3; 3];
        for (sky, ground) in [([0.3, 0.45, 0.7], grey), ([0.5, 0.5, 0.55], [0.4, 0.3, 0.2])] {
            let (sun, told) = share(sky, ground);
            assert!(told && (sun - 0.5).abs() < 0.02, "{method:?}: half of the rest, not {sun}");
        }
        let (ceiling, overcast) = (([0.6, 0.6, 0.58], [0.5, 0.36, 0.25]), ([0.6, 0.6, 0.64], grey));
        let rooms = [([0.5, 0.48, 0.45], grey), ([0.4, 0.45, 0.5], [0.4, 0.45, 0.5])];
        for (sky, ground) in rooms.into_iter().chain([ceiling, overcast]) {
            let (lamp, told) = share(sky, ground);
            assert!(!told && lamp < 0.35, "{method:?}: no sky, no sun: {lamp}");
        }
        // The sky is seen in 45 of 256 columns, between grey walls.
        let (part, told) = seen(45, [0.3, 0.45, 0.7], [0.5; 3]);
        assert!(told && part < 0.45, "{method:?}: {part}");
    }
}

// White pixels of the ground, glints or snow, take no sun away: what is clipped below the horizon is lit, no light.
// Mutation: `height(c) > 0.0` to `true` in `hues`.
#[test]
fn glints_on_the_ground_leave_the_sun_one() {
    for method in METHODS {
        let glints = |every: usize| {
            let source = pano(256, |x, y| match (x, y) {
                (60..=61, 32..=33) => [1.0; 3],
                (_, 80..) if every > 0 && x % every == 7 && y % 9 == 0 => [1.0; 3],
                (_, 64..) => [0.3; 3],
                _ => [0.3, 0.45, 0.7],
            });
            let (brackets, notes) = run_by(method.clone(), source.clone(), &[-3.0]);
            let sun = flux(&brackets, &source, |at| at / 256 < 64 && brackets.log2_gain.samples[at] > 0.0);
            let rest = flux(&brackets, &source, |at| brackets.log2_gain.samples[at] == 0.0);
            let below = brackets.log2_gain.samples[64 * 256..].iter().copied().fold(0.0, f32::max);
            (sun / rest, below, notes.iter().any(|note| note.id == "sun"))
        };
        for every in [64, 8] {
            let (sun, below, told) = glints(every);
            assert!(told && sun > 0.48, "{method:?}, {every}: {sun}");
            // No brighter than white paper in all that shines from above. Mutation: `lit_below` not asked.
            assert!(method == Method::Region || below < 1.0, "{below} stops on the ground");
        }
    }
}

// There is one sun: of two lights that may be it the larger. Mutation: the others kept in `suns`.
#[test]
fn there_is_one_sun() {
    for method in METHODS {
        let source = pano(256, |x, y| match (x, y) {
            (60..=61, 32..=33) | (160..=162, 32..=33) => [1.0; 3],
            (_, 64..) => [0.3; 3],
            _ => [0.3, 0.45, 0.7],
        });
        let (brackets, notes) = run_by(method.clone(), source, &[-3.0]);
        assert!(notes.iter().any(|note| note.id == "sun"));
        let suns: Vec<bool> = brackets.report.tables[1]
            .rows
            .iter()
            .map(|row| row[6] == Cell::Text("the sun".to_owned()))
            .collect();
        assert_eq!(suns, [false, true], "{method:?}");
    }
}

// A sun over water, which is as blue as the sky, is told to be one that may be missed; a lamp in a grey room is not.
// Mutation: `*blue > BLUE` to `false`, or to `true`.
#[test]
fn a_sun_over_water_is_told_to_be_doubtful() {
    for method in METHODS {
        let told = |colour: [f32; 3]| {
            let source = pano(256, |x, y| match (x, y) {
                (60..=61, 32..=33) => [1.0; 3],
                _ => colour,
            });
            let (_, notes) = run_by(method.clone(), source, &[-3.0]);
            assert!(notes.iter().all(|note| note.id != "sun"));
            notes.iter().any(|note| note.id == "sun-doubtful")
        };
        assert!(told([0.3, 0.45, 0.7]) && !told([0.5; 3]));
    }
}

// Whites may end early; from `white` on a channel is clipped, and lights that are stated for pixels below it are told.
// Mutation: `CLIPPED` for `white` in `clip_mask`; the warning dropped in `tell_nothing_clipped`.
#[test]
fn white_is_where_the_user_says() {
    let mut dull = (*room(128)).clone();
    let Picture::Srgb(image) = &mut dull.image else { panic!("display colours") };
    image.samples.iter_mut().for_each(|code| *code = code.min(0.96));
    let (dull, method) = (Arc::new(dull), Method::Manual { emitters: vec![[0.0, 0.0, 180.0, 5.0]] });
    let lit = |white: f32| {
        let params =
            PredictExposure { evs: vec![-3.0], method: method.clone(), white, weights: None, force: false };
        let (out, notes) = PredictExposure::run(&params, In { pano: dull.clone() }, &cx()).expect("runs");
        let lit = out.brackets.log2_gain.samples.iter().filter(|gain| **gain > 0.0).count();
        (lit, notes.iter().any(|note| note.id == "nothing-to-light"))
    };
    assert_eq!(lit(CLIPPED), (0, true));
    let (pixels, told) = lit(0.9);
    assert!(pixels > 0 && !told, "{pixels}");
}

// A file of weights is for the method that has any. Mutation: the warning dropped.
#[test]
fn weights_that_no_method_reads_are_told() {
    let weights = Some(InputFile("own.safetensors".to_owned()));
    let params = |method| PredictExposure {
        evs: vec![],
        method,
        white: CLIPPED,
        weights: weights.clone(),
        force: false,
    };
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
            force: false,
        };
        PredictExposure::check(&params)?;
        PredictExposure::run(&params, In { pano: source.clone() }, &cx())
    };
    let (out, _) = stated(vec![[azimuth, elevation, 10.0, 5.0]]).expect("runs");
    for (at, gain) in out.brackets.log2_gain.samples.iter().enumerate() {
        let lamp = (30..34).contains(&(at / 256)) && (100..104).contains(&(at % 256));
        assert_eq!(*gain, if lamp { 5.0 } else { 0.0 });
    }
    // A sun within a bright sky: the narrower one is stated of what both reach, whichever comes first.
    for order in [[0, 1], [1, 0]] {
        let both = [[azimuth, elevation, 180.0, 2.0], [azimuth - 1.0, elevation, 4.0, 8.0]];
        let (out, notes) = stated(order.map(|i| both[i]).to_vec()).expect("runs");
        let lamp = out.brackets.log2_gain.pixel(102, 32)[0];
        assert!(lamp == 8.0 && out.brackets.log2_gain.pixel(0, 50)[0] == 2.0, "{lamp}");
        assert!(notes.iter().all(|note| note.id != "nothing-to-light"));
    }
    let (out, notes) =
        stated(vec![[azimuth, elevation, 4.0, 3.0], [azimuth + 180.0, -80.0, 3.0, 5.0]]).expect("runs");
    let idle = notes.iter().find(|note| note.id == "nothing-to-light").expect("is told");
    assert!(idle.text.ends_with("do nothing: 2"), "{}", idle.text);
    // The report is of the window and the lamp that are there, whatever was stated.
    let report = &out.brackets.report;
    assert_eq!(report.tables[0].rows[0][3], Cell::Count(2));
    let gains: Vec<_> = report.tables[1].rows.iter().map(|row| [row[3].clone(), row[4].clone()]).collect();
    assert!(gains.contains(&[3.0, 3.0].map(Cell::Number)) && gains.contains(&[0.0, 0.0].map(Cell::Number)));
    // What no emitter reaches is told, as it is of `Skip`. Mutation: `Method::Manual` left out there.
    let mask = clip_mask(&source, &linear_pixels(&source.image, Transfer::Srgb), CLIPPED);
    let all = mask.iter().filter(|clipped| **clipped).count();
    let kept = |notes: &Notes| notes.iter().find(|n| n.id == "clipping-kept").map(|n| n.text.clone());
    let (_, none) = stated(Vec::new()).expect("runs");
    assert_eq!(kept(&none), Some(format!("{all} of {all} clipped pixels stay as they are")));
    assert_eq!(kept(&stated(vec![[0.0, 0.0, 180.0, 5.0]]).expect("runs").1), None);
    assert!(stated(vec![[1e300, 5.0, 3.0, 5.0]]).is_err());
    assert!(stated(vec![[0.0, 95.0, 3.0, 5.0]]).is_err() && stated(vec![[0.0, 5.0, 0.0, 5.0]]).is_err());
}

fn flux_kontext(files: [&str; 4], steps: u32, seed: u64) -> Method {
    let [transformer, vae, prompt, lora] = files.map(|file| InputFile(file.to_owned()));
    let (strength, guidance, width_px, seamless) = (1.0, 2.5, 64, true);
    Method::FluxKontext {
        transformer,
        vae,
        prompt,
        lora,
        strength,
        steps,
        guidance,
        width_px,
        seamless,
        seed,
    }
}

#[test]
fn files_of_the_diffusion_model_count_by_content_and_a_build_without_it_says_so() {
    use engine::ParamType;
    let method = flux_kontext(["a.gguf", "b", "c", "d"], 4, 0);
    assert_eq!(method.paths(), ["a.gguf", "b", "c", "d"]);
    let key = |method: &Method| method.key_text().expect("is canonical").expect("has a text");
    assert_eq!(key(&method), "FluxKontext(1.0,4,2.5,64,true,0) by candle 0.11 in f32");
    assert_eq!(key(&method), key(&flux_kontext(["z.gguf", "b", "c", "d"], 4, 0)));
    assert_ne!(key(&method), key(&flux_kontext(["a.gguf", "b", "c", "d"], 4, 1)));
    assert_eq!(key(&Method::Region), "Region");
    let numbers = |method: &Method| method.kontext().expect("is it").check_numbers();
    assert!(numbers(&method).is_ok());
    let error = numbers(&flux_kontext(["a", "b", "c", "d"], 0, 0)).expect_err("takes no steps").to_string();
    assert!(error.contains("`steps` of `FluxKontext` is 0; it lies between 1 and 200"), "{error}");
    let checked = PredictExposure::check(&PredictExposure {
        evs: vec![-3.0],
        method,
        white: CLIPPED,
        weights: None,
        force: false,
    });
    if cfg!(feature = "learned") {
        assert!(checked.is_ok());
    } else {
        assert!(checked.expect_err("is not built in").to_string().contains("feature `learned`"));
    }
}

/// The small model with random weights, through the kind: it predicts nothing sensible, but where it should and
/// the same each time.
#[cfg(all(feature = "learned", feature = "real-data"))]
#[test]
fn the_diffusion_model_fills_clipped_pixels_only() {
    use safetensors::SafeTensors;
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/flux-kontext-tiny");
    let at = |name: &str| format!("{fixture}/{name}");
    let bytes = std::fs::read(at("tensors.safetensors")).expect("is there");
    let tensors = SafeTensors::deserialize(&bytes).expect("is sound");
    let folder = tempfile::tempdir().expect("a folder");
    let prompt = folder.path().join("prompt.safetensors");
    let of = |name: &str| tensors.tensor(name).expect("is there");
    let named = [("t5", of("prompt_embeds")), ("clip", of("pooled_prompt_embeds"))];
    std::fs::write(&prompt, safetensors::serialize(named, None).expect("serializes")).expect("is written");
    let files = [
        &at("transformer/diffusion_pytorch_model.safetensors"),
        &at("vae/diffusion_pytorch_model.safetensors"),
        prompt.to_str().expect("is text"),
        &at("lora_kohya.safetensors"),
    ];
    let params = PredictExposure {
        evs: vec![-6.0, -3.0],
        method: flux_kontext(files, 2, 3),
        white: CLIPPED,
        weights: None,
        force: false,
    };
    let cx = cx();
    let sources = PredictExposure::sources(&params, &SourceRoot::new(".")).expect("are there");
    // The four files, and what stands beside two of them.
    assert_eq!(sources.len(), 6);
    let (out, notes) = PredictExposure::run(&params, In { pano: room(128) }, &cx).expect("runs");
    assert!(notes.iter().any(|note| note.id == "kontext" && note.text.contains("2 exposures at 64 x 32")));
    // Two exposures, two steps, each done twice.
    assert_eq!(cx.counts()["diffusion-steps"], 8);
    let gain = &out.brackets.log2_gain.samples;
    let (again, _) = PredictExposure::run(&params, In { pano: room(128) }, &cx).expect("runs");
    assert_eq!(*gain, again.brackets.log2_gain.samples);
    assert!(gain.iter().all(|v| v.is_finite() && (0.0..=24.0).contains(v)));
    let (skipped, _) = run(room(128), &[-3.0]);
    let clipped = |at: usize| skipped.log2_gain.samples[at] > 0.0;
    assert!(gain.iter().enumerate().all(|(at, v)| clipped(at) || *v == 0.0));
    let missing = PredictExposure { method: flux_kontext(["nowhere"; 4], 2, 3), ..params };
    let error = PredictExposure::sources(&missing, &SourceRoot::new(".")).expect_err("is missing");
    assert!(error.to_string().contains("cannot find `nowhere`"), "{error}");
}
