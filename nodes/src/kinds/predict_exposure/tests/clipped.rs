//! Tests of the set of pixels that count as clipped. All other pixels get no light.

use super::*;

// Skipping the method changes nothing: when forced, no method adds light to a panorama in which nothing is clipped,
// whether black, grey, or a room whose window and lamp end just below white.
#[test]
fn a_prediction_that_is_forced_where_nothing_is_clipped_changes_no_bit() {
    let mut room = (*room(128)).clone();
    if let Picture::Srgb(image) = &mut room.image {
        image.samples.iter_mut().for_each(|v| *v = v.min(0.97));
    }
    let flat = |value: f32| pano(64, move |_, _| [value; 3]);
    for source in [Arc::new(room), flat(0.0), flat(0.6)] {
        for method in METHODS {
            let run = |exhaustive: bool| {
                let params = PredictExposure {
                    evs: vec![-3.0, -6.0],
                    method: method.clone(),
                    white: CLIPPED,
                    weights: None,
                };
                let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive };
                let cx = Context::detached(scene, ".");
                let (out, notes) =
                    PredictExposure::run(&params, In { pano: source.clone() }, &cx).expect("runs");
                let note = notes.iter().find(|note| note.id == "nothing-clipped").map(|n| n.text.clone());
                (out.brackets, note.unwrap_or_default())
            };
            let ((left, reported), (forced, why)) = (run(false), run(true));
            assert!(left.log2_gain == forced.log2_gain && left.exposures == forced.exposures, "{method:?}");
            assert!(
                reported.ends_with("nothing is predicted") && why.ends_with("because of `--exhaustive`"),
                "{reported}; {why}"
            );
            let name = |brackets: &Brackets| brackets.report.tables[0].rows[0][0].clone();
            assert_eq!(name(&left), Cell::Text("skip".to_owned()));
            assert_ne!(name(&forced), name(&left), "the report says what was asked");
        }
    }
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

#[test]
fn holes_are_not_clipped() {
    let mut pano = (*room(128)).clone();
    pano.alpha.samples.fill(0.0);
    let (brackets, notes) = run(Arc::new(pano), &[-3.0]);
    assert!(brackets.log2_gain.samples.iter().all(|&g| g == 0.0));
    assert!(notes.iter().any(|note| note.id == "nothing-clipped"));
}

// The fill of a hole has no influence on the light, even if a cell of the grid is partly a hole. This test fails if
// `Grid::new` adds filled pixels to the visible ones, or if `first_column` does not check alpha.
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

// White that is mostly transparent is reported, without a contradiction. This test fails if `report_unseen` is not
// called.
#[test]
fn white_that_is_mostly_transparent_is_reported() {
    let mut pano = (*pano(64, |x, y| if (x, y) == (5, 8) { [1.0; 3] } else { [0.5; 3] })).clone();
    pano.alpha.samples[8 * 64 + 5] = 0.4;
    let (_, notes) = run(Arc::new(pano), &[-3.0]);
    let text = |id: &str| notes.iter().find(|n| n.id == id).map(|n| n.text.clone()).unwrap_or_default();
    assert!(text("white-unseen").ends_with("(count: 1)"), "{notes:?}");
    assert!(text("nothing-clipped").contains("reaches 0.214 of white"), "{notes:?}");
}

// Linear light that ends at white was clipped there; with values above white, values near white are unclipped. This
// test fails if `clip_mask` does not check `pixels.ceiling`.
#[test]
fn linear_light_is_clipped_at_white_unless_it_holds_more() {
    let mut pano = (*pano(64, |_, _| [0.5; 3])).clone();
    let mut image = Image::<scene::types::Linear>::from_samples(64, 32, 3, vec![0.2; 64 * 32 * 3]);
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

// The white level may be below 1: a channel is clipped from `white` on, and given lights for pixels below it are
// reported. This test fails if `clip_mask` uses `CLIPPED` for `white`, or without the warning in
// `report_nothing_clipped`.
#[test]
fn white_is_where_the_user_says() {
    let mut dull = (*room(128)).clone();
    let Picture::Srgb(image) = &mut dull.image else { panic!("display colours") };
    image.samples.iter_mut().for_each(|code| *code = code.min(0.96));
    let (dull, method) = (Arc::new(dull), Method::Manual { emitters: vec![[0.0, 0.0, 180.0, 5.0]] });
    let lit = |white: f32| {
        let params = PredictExposure { evs: vec![-3.0], method: method.clone(), white, weights: None };
        let (out, notes) = PredictExposure::run(&params, In { pano: dull.clone() }, &cx()).expect("runs");
        let lit = out.brackets.log2_gain.samples.iter().filter(|gain| **gain > 0.0).count();
        (lit, notes.iter().any(|note| note.id == "nothing-to-light"))
    };
    assert_eq!(lit(CLIPPED), (0, true));
    let (pixels, reported) = lit(0.9);
    assert!(pixels > 0 && !reported, "{pixels}");
}
