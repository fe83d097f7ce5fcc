//! Tests of the influence of the resolution of a panorama and of the position of its pixels.

use super::*;

/// A mirrored panorama gives mirrored light, even if it is finer than the grid. This test fails if `Grid::new` uses
/// `from_start` in place of `from_end`, or if `first_column` reads the column sums only to the right.
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

// A panorama with fewer columns than in training is evaluated with the same number: repeating each pixel gives the
// same light. This test fails if `Enlarged::new` returns `None`, or if `gathered` uses only the first part.
#[test]
fn a_coarse_panorama_is_judged_on_the_same_grid() {
    let (fine, coarse) = (room(256), room(128));
    let by = |pano: &Arc<Panorama>| run_by(Method::Learned, pano.clone(), &[-3.0]).0;
    let [want, found] = [&fine, &coarse].map(|pano| flux(&by(pano), pano, |_| true));
    assert!((found / want - 1.0).abs() < 1e-4, "{found} {want}");
    let (a, b) = (by(&fine).report.clone(), by(&coarse).report.clone());
    assert_eq!(a.tables[1].rows, b.tables[1].rows, "the same regions");
}

// Glints, single pixels that clip in a finer panorama, hide the light of their pixels and not that of the grid
// cells around them: in a room with a glint in each fourth cell of the floor, `Learned`, which mistakes them for
// white on the floor, finds at most half as much light again, and `Region` less; and each cell keeps its unclipped
// share. This test fails if `share` is 1 for each cell that is clipped in part.
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

// This test fails if `<` is changed to `<=` in `report_coarse`, or if `report_coarse` is not called.
#[test]
fn a_panorama_too_coarse_for_lamps_is_reported() {
    for (width, reported) in [(32, Some("a pixel of the panorama is 11.2 degrees wide")), (64, None)] {
        let (_, notes) = run(pano(width, |_, _| [0.5; 3]), &[-3.0]);
        let text = notes.iter().find(|note| note.id == "coarse").map(|note| note.text.clone());
        assert_eq!(text.is_some(), reported.is_some(), "{text:?}");
        assert!(reported.is_none_or(|reported| text.is_some_and(|text| text.starts_with(reported))));
    }
}
