//! Tests with extreme numerical values, for the rows of `docs/evidence/extremes.md` about rendering splats. Each
//! test compares the renderer with the textbook implementation in f64, with a formula or with an invariant. The
//! rows about files are tested in the modules of the loaders, and the rows about panoramas in the modules `stitch`
//! and `panorama`.

use engine::Up;

use super::*;
use scene::io::exr::{self, Channel, Depth};
use testing::row;

const FAST: Settings = Settings { precision: Precision::F32, ..F64 };

/// Alpha of one round splat at a pixel, computed directly from the formula of a projected Gaussian.
fn alpha_at(camera: &Camera, sigma: f64, z: f64, opacity: f64, x: usize, y: usize) -> f64 {
    let size = camera.fx * sigma / z;
    let variance = size * size + 0.3;
    let (dx, dy) = (x as f64 + 0.5 - camera.cx, y as f64 + 0.5 - camera.cy);
    let alpha = (opacity * num::f64::exp(-0.5 * (dx * dx + dy * dy) / variance)).min(0.99);
    if alpha < 1.0 / 255.0 { 0.0 } else { alpha }
}

/// Largest deviation of rendered alphas from [`alpha_at`].
fn off_the_formula(sigma: f32, opacity: f32) -> f64 {
    let camera = camera(31, 31, 50.0);
    let splat = one([0.0, 0.0, 3.0], [sigma; 3], opacity, [1.0; 3]);
    let mut largest = 0.0_f64;
    for settings in [F64, FAST] {
        let seen = draw(&splat, &camera, settings);
        for i in 0..31 * 31 {
            let expected = alpha_at(&camera, f64::from(sigma), 3.0, f64::from(opacity), i % 31, i / 31);
            let found = f64::from(seen.rgba[i * 4 + 3]);
            largest = largest.max((found - expected).abs());
        }
    }
    largest
}

/// Invisible splats do not change a bit of the picture.
#[test]
fn what_cannot_be_seen_changes_no_bit() {
    let splats = cloud(200, 51);
    let mut more = empty(3);
    for i in 0..splats.len() {
        let ghost = one([0.1, 0.2, i as f32 * 0.05], [0.3; 3], 0.003, [1.0; 3]);
        let behind = one([0.1, 0.2, -1.0 - i as f32], [0.3; 3], 0.9, [1.0; 3]);
        for extra in [ghost, behind] {
            more.means.extend(&extra.means);
            more.quats.extend(&extra.quats);
            more.scales.extend(&extra.scales);
            more.opacities.extend(&extra.opacities);
            more.sh.extend([[1.0; 3]; 16]);
        }
        more.means.push(splats.means[i]);
        more.quats.push(splats.quats[i]);
        more.scales.push(splats.scales[i]);
        more.opacities.push(splats.opacities[i]);
        more.sh.extend(&splats.sh[i * 16..(i + 1) * 16]);
    }
    let camera = camera(60, 45, 70.0);
    for settings in [F64, FAST] {
        assert_eq!(bits(&draw(&splats, &camera, settings)), bits(&draw(&more, &camera, settings)));
    }
}

/// A huge splat, up to the largest scale in f32, is evaluated at most once per pixel. It covers all pixels, or is
/// counted as degenerate.
#[test]
fn huge_splats_cost_one_evaluation_a_pixel() {
    let camera = camera(64, 48, 60.0);
    for scale in [1e6_f32, 1e15, f32::MAX] {
        let splat = one([0.0, 0.0, 3.0], [scale; 3], 0.5, [1.0; 3]);
        for settings in [F64, FAST] {
            let seen = draw(&splat, &camera, settings);
            assert!(seen.rgba.iter().all(|v| v.is_finite()) && seen.work.evaluations <= 64 * 48);
            // In f64 no scale of a file overflows: the splat is drawn, or counted.
            assert!(
                seen.work.degenerate == 1
                    || seen.rgba.as_chunks::<4>().0.iter().all(|p| (p[3] - 0.5).abs() < 1e-3)
            );
            let around = PanoramaCamera { eye: DVec3::ZERO, up: Up::PlusZ, width_px: 64 };
            let around = panorama(&splat, &around, None, &settings, &context()).expect("renders");
            assert!(around.rgba.iter().all(|v| v.is_finite()));
            // Once in the belt and once in the caps, which overlap a little and are finer.
            assert!(around.work.evaluations <= 2 * 64 * 32, "{:?}", around.work);
        }
    }
}

/// Splats far smaller than a pixel, down to size 0, have the shape of the low-pass filter alone.
#[test]
fn scales_of_nothing_show_the_filter() {
    for scale in [num::f64::exp(-40.0) as f32, 1e-30, 1e-45, 0.0] {
        row(5, "alpha off the filter alone", off_the_formula(scale, 0.8), 1e-6);
    }
}

/// Opacity 1 is capped at exactly 0.99, and splats with an opacity below `alpha_cut` are not drawn.
#[test]
fn opacities_at_both_ends() {
    row(6, "alpha off the capped formula", off_the_formula(0.2, 1.0), 1e-6);
    let camera = camera(31, 31, 50.0);
    for settings in [F64, FAST] {
        let full = draw(&one([0.0, 0.0, 3.0], [0.5; 3], 1.0, [1.0; 3]), &camera, settings);
        assert!((full.rgba[(15 * 31 + 15) * 4 + 3] - 0.99).abs() < 1e-6);
        let faint = draw(&one([0.0, 0.0, 3.0], [0.5; 3], 1.0 / 256.0, [1.0; 3]), &camera, settings);
        assert!(faint.rgba.iter().all(|v| *v == 0.0) && faint.work.projected == 0);
        let none = draw(
            &one([0.0, 0.0, 3.0], [0.5; 3], 0.0, [1.0; 3]),
            &camera,
            Settings { alpha_cut: 0.0, ..settings },
        );
        assert!(none.rgba.iter().all(|v| *v == 0.0));
    }
}

/// A scene without splats is an empty picture.
#[test]
fn an_empty_scene_is_background() {
    let seen = draw(&empty(0), &camera(8, 8, 60.0), F64);
    assert!(seen.rgba == [0.0; 256] && seen.depth == [f32::INFINITY; 64]);
}

/// Splats at the eye, behind it or not beyond the near plane are not drawn, and all values are finite.
#[test]
fn the_near_plane_culls() {
    let at = |z: f32| one([0.0, 0.0, z], [0.5; 3], 0.9, [1.0; 3]);
    let camera = camera(20, 20, 90.0);
    let splats = cloud(300, 8);
    for settings in [F64, FAST] {
        let settings = Settings { near: 0.25, ..settings };
        let behind = [-1.0, -0.0, 0.0, 1e-40, 1e-6, 0.1, 0.25_f32.next_down(), 0.25];
        let seen = draw(&join(&behind.map(at).each_ref()), &camera, settings);
        assert!(seen.rgba.iter().all(|v| *v == 0.0) && seen.depth.iter().all(|d| *d == f32::INFINITY));
        assert_eq!(seen.work.behind, behind.len() as u64);
        let first = draw(&at(0.25_f32.next_up()), &camera, settings);
        assert!(first.work.behind == 0 && first.rgba.iter().all(|v| v.is_finite()));
        assert!((first.rgba[(10 * 20 + 10) * 4 + 3] - 0.9).abs() < 1e-3);
        let culled = [0.01, 0.2, 1.0, 5.0].map(|near| Settings { near, ..settings });
        assert!(culled.map(|settings| draw(&splats, &camera, settings).work.behind).is_sorted());
    }
}

/// A needle a million times longer than wide agrees with the textbook implementation in f64, whether it lies across
/// the picture, points into it or is seen end-on.
#[test]
fn needles_are_exact() {
    let camera = camera(200, 150, 60.0);
    let (sin, cos) = num::sin_cos(0.5 * 0.7);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for quat in [[cos, 0.0, 0.0, sin], [cos, 0.0, sin, 0.0], [half, 0.0, half, 0.0]] {
        let mut needle = one([0.1, 0.0, 3.0], [3000.0, 0.003, 0.003], 0.95, [1.0, 0.5, 0.0]);
        needle.quats[0] = quat.map(|q| q as f32);
        let (seen, reference) = (draw(&needle, &camera, FAST), draw(&needle, &camera, F64));
        row(10, "F32 off F64", largest_difference(&seen, &reference), 1e-5);
        assert!(seen.rgba.iter().all(|v| v.is_finite()) && seen.work.blends > 0);
        let off = (0..200 * 150).map(|i| {
            let expected = brute_force(&needle, &camera, i % 200, i / 200);
            (f64::from(seen.rgba[i * 4]) - expected[0]).abs()
        });
        row(10, "off the textbook", off.fold(0.0, f64::max), 1e-3);
    }
}

/// Stopping early changes the colour of a pixel with many splats by less than the remaining transmittance. The
/// splat that would reduce the transmittance of a pixel below `stop` is left out, as in the renderers that captures
/// are trained with.
#[test]
fn stopping_early_costs_what_it_says() {
    let mut random = Random(4);
    let mut pile = empty(0);
    for i in 0..100_000 {
        pile.means.push([0.0, 0.0, 1.0 + i as f32 * 1e-4]);
        pile.quats.push([1.0, 0.0, 0.0, 0.0]);
        pile.scales.push([1e-3; 3]);
        pile.opacities.push(0.999);
        pile.sh.push([0; 3].map(|_| random.within(-1.7, 1.7) as f32));
    }
    let camera = camera(5, 5, 40.0);
    let settings = Settings { precision: Precision::F32, ..F64 };
    let stopped = draw(&pile, &camera, settings);
    let all = draw(&pile, &camera, Settings { stop: 0.0, ..settings });
    // Colours reach 1; with the cap at 0.99 at most 1e-2 of the light is still to come.
    row(11, "with a cap of 0.99 (stop / (1 - cap))", largest_difference(&stopped, &all), 1e-2);
    assert!(stopped.work.blends * 10 < all.work.blends);
    let soft = Settings { alpha_cap: 0.5, ..settings };
    let (stopped, all) = (draw(&pile, &camera, soft), draw(&pile, &camera, Settings { stop: 0.0, ..soft }));
    row(11, "with a cap of 0.5 (stop / (1 - cap))", largest_difference(&stopped, &all), 2.1e-4);
}

/// Splats with equal depths are drawn in file order. Other splats are drawn by depth, whatever their order in the
/// file.
#[test]
fn ties_follow_the_file_and_nothing_else_does() {
    let red = one([0.0, 0.0, 2.0], [0.3; 3], 0.9, [1.7, -1.7, -1.7]);
    let blue = one([0.05, 0.0, 2.0], [0.3; 3], 0.9, [-1.7, -1.7, 1.7]);
    // At another depth, so that there is something to sort.
    let far = one([0.0, 0.0, 4.0], [0.3; 3], 0.9, [-1.7, 1.7, -1.7]);
    let camera = camera(32, 32, 40.0);
    let middle = (16 * 32 + 16) * 4;
    for precision in [Precision::F32, Precision::F64] {
        let settings = Settings { precision, ..F64 };
        let a = draw(&join(&[&far, &red, &blue]), &camera, settings);
        let b = draw(&join(&[&far, &blue, &red]), &camera, settings);
        assert!(a.rgba[middle] > 0.8 && a.rgba[middle + 2] < 0.2);
        assert!(b.rgba[middle] < 0.2 && b.rgba[middle + 2] > 0.8);
        let splats = cloud(200, 5);
        let backwards = Splats {
            means: splats.means.iter().rev().copied().collect(),
            quats: splats.quats.iter().rev().copied().collect(),
            scales: splats.scales.iter().rev().copied().collect(),
            opacities: splats.opacities.iter().rev().copied().collect(),
            sh: splats.sh.chunks(16).rev().flatten().copied().collect(),
            ..splats.clone()
        };
        assert_eq!(bits(&draw(&splats, &camera, settings)), bits(&draw(&backwards, &camera, settings)));
    }
}

/// An offset of the world changes the picture only by the rounding of coordinates in f64, because the position of
/// the camera is subtracted before anything is rounded to f32.
#[test]
fn pictures_do_not_depend_on_where_the_world_is() {
    let splats = cloud(300, 6);
    let here = camera(64, 48, 70.0);
    let [expected, exact] = [FAST, F64].map(|settings| draw(&splats, &here, settings));
    for far in [1e3, 1e6, 1e7] {
        let mut moved = splats.clone();
        let mut there = here.clone();
        let offset = DVec3::new(far, -far, 0.5 * far);
        moved.means_low = vec![[0.0; 3]; moved.len()];
        for i in 0..moved.len() {
            let mean = splats.mean(i) + offset;
            moved.means[i] = mean.to_array().map(|v| v as f32);
            let low = mean - DVec3::from(moved.means[i].map(f64::from));
            moved.means_low[i] = low.to_array().map(|v| v as f32);
        }
        there.world_from_camera = DMat4::from_translation(offset).to_cols_array();
        let off = largest_difference(&draw(&moved, &there, FAST), &expected);
        let off = off.max(largest_difference(&draw(&moved, &there, F64), &exact));
        row(13, &format!("moved by {far:e}"), off, 1e-3);
    }
}

/// The size of the world does not change the picture, if `near`, which is in world units, is scaled with it.
#[test]
fn pictures_do_not_depend_on_how_large_the_world_is() {
    let splats = cloud(300, 6);
    let camera = camera(64, 48, 70.0);
    let expected = draw(&splats, &camera, FAST);
    for factor in [1e-6_f32, 1e6] {
        let mut scaled = splats.clone();
        scaled.means.iter_mut().flatten().for_each(|v| *v *= factor);
        scaled.scales.iter_mut().flatten().for_each(|v| *v *= factor);
        let seen = draw(&scaled, &camera, Settings { near: FAST.near * f64::from(factor), ..FAST });
        row(14, &format!("scaled by {factor:e}"), largest_difference(&seen, &expected), 1e-4);
    }
}

/// Colours are clamped at 0 and have no upper limit: a colour of 3 is 3 in the picture and in a file of floats.
#[test]
fn colours_are_cut_at_0_and_nowhere_else() {
    let coefficient = |colour: f64| ((colour - 0.5) / 0.282_094_791_773_878_14) as f32;
    let bright =
        one([0.0, 0.0, 1.0], [0.5; 3], 1.0, [coefficient(3.0), coefficient(-2.0), coefficient(0.25)]);
    let seen = draw(&bright, &camera(9, 9, 40.0), Settings { alpha_cap: 1.0, stop: 0.0, ..FAST });
    let middle = (4 * 9 + 4) * 4;
    for (value, expected) in seen.rgba[middle..].iter().zip([3.0, 0.0, 0.25, 1.0]) {
        row(15, &format!("off {expected}"), f64::from((value - expected).abs()), 1e-5);
    }
    let plane = |c: usize| seen.rgba.iter().skip(c).step_by(4).copied().collect::<Vec<_>>();
    let channel =
        |(name, c): (&str, usize)| (Channel { name: name.to_owned(), samples: plane(c) }, Depth::Float);
    let channels = [("R", 0), ("G", 1), ("B", 2)].map(channel).to_vec();
    let (file, _) = exr::write(9, 9, channels, "srgb", None).expect("writes");
    let back = exr::read("a", &file).expect("reads");
    assert_eq!(back.find("R"), Some(&plane(0)[..]));
}

/// If a sum of finite coefficients overflows, the colour is clamped and reported. The splat is at the edge of a
/// tile, so that it covers only some pixels of a vector.
#[test]
fn colours_that_overflow_are_capped_and_reported() {
    let mut splats = one([0.0, 0.0, 1.0], [0.03; 3], 0.9, [3.3e38; 3]);
    splats.sh_degree = 2;
    splats.sh.extend([[3.3e38; 3]; 8]);
    for precision in [Precision::F32, Precision::F64] {
        let settings = Settings { precision, ..F64 };
        let around = PanoramaCamera { eye: DVec3::ZERO, up: Up::PlusY, width_px: 64 };
        let everything = panorama(&splats, &around, None, &settings, &context()).expect("renders");
        for seen in [draw(&splats, &camera(40, 30, 60.0), settings), everything] {
            assert!(seen.rgba.iter().all(|v| v.is_finite()), "{precision:?}");
            assert!(seen.rgba.iter().any(|v| *v > 1e14), "{precision:?}");
            let mut notes = Notes::none();
            seen.work.report(1, &settings, &context(), &mut notes);
            assert!(notes.iter().any(|note| note.id == "colours-held"), "{precision:?}");
        }
    }
}

/// Cameras with the widest and the narrowest angle, with one pixel, or with one row of pixels agree with the
/// textbook implementation.
#[test]
fn odd_cameras_are_the_textbook() {
    let splats = cloud(200, 61);
    let mut largest = 0.0_f64;
    for camera in [camera(20, 15, 1.0), camera(20, 15, 179.0), camera(1, 1, 60.0), camera(16_384, 1, 100.0)] {
        let seen = draw(&splats, &camera, F64);
        let width = camera.width_px as usize;
        let mut off = 0;
        for (i, pixel) in seen.rgba.as_chunks::<4>().0.iter().enumerate() {
            let expected = brute_force(&splats, &camera, i % width, i / width);
            let error = (0..4).map(|c| (f64::from(pixel[c]) - expected[c]).abs()).fold(0.0, f64::max);
            // The textbook's own inverse of a needle's covariance cancels; a pair may fall across the cut.
            largest = largest.max(error);
            off += usize::from(error > 1e-5);
        }
        assert!(off * 50 <= seen.rgba.len() / 4, "{off}");
    }
    row(16, "off the textbook", largest, 8e-3);
}

#[test]
fn odd_cameras_are_finite_and_match_f64() {
    let splats = cloud(300, 9);
    for camera in [camera(40, 30, 1.0), camera(40, 30, 179.0), camera(1, 1, 60.0), camera(16_384, 1, 100.0)] {
        let seen = draw(&splats, &camera, Settings { precision: Precision::F32, ..F64 });
        assert!(seen.rgba.iter().all(|v| v.is_finite()) && seen.depth.iter().all(|d| *d > 0.0));
        // One pair on the other side of the cut moves a pixel by 1/255 of a splat.
        row(16, "F32 off F64", largest_difference(&seen, &draw(&splats, &camera, F64)), 8e-3);
    }
    let huge = Camera { width_px: u32::MAX, height_px: u32::MAX, ..camera(1, 1, 60.0) };
    assert!(render(&splats, &huge, None, &F64, &context()).is_err());
}

/// Coverage lies between 0 and 1, no pixel exceeds the largest colour of a splat times its coverage, and farther
/// splats only increase coverage.
#[test]
fn coverage_grows_and_colours_are_convex_sums() {
    for seed in 0..4 {
        let splats = cloud(2000, 20 + seed);
        let seen = draw(&splats, &camera(60, 60, 80.0), Settings { precision: Precision::F32, ..F64 });
        let most = 0.5
            + splats
                .sh
                .chunks(16)
                .map(|sh| sh.iter().flatten().map(|c| c.abs()).sum::<f32>())
                .fold(0.0, f32::max);
        for [r, g, b, a] in seen.rgba.as_chunks::<4>().0 {
            assert!((0.0..=1.0).contains(a));
            assert!([r, g, b].iter().all(|c| **c >= 0.0 && **c <= most * a * (1.0 + 1e-5)));
        }
        // With one colour, a pixel is that colour times its coverage.
        let plain =
            Splats { sh_degree: 0, sh: vec![[0.25 / 0.282_094_8; 3]; splats.len()], ..splats.clone() };
        let plain = draw(&plain, &camera(60, 60, 80.0), FAST);
        let off = plain.rgba.as_chunks::<4>().0.iter().map(|[r, _, _, a]| f64::from((r - 0.75 * a).abs()));
        row(17, "colour off the one colour times alpha", off.fold(0.0, f64::max), 1e-5);
        let camera = camera(60, 60, 80.0);
        let before = |depth: f32| {
            let limit = Image::<Data>::from_samples(60, 60, 1, vec![depth; 60 * 60]);
            render(&splats, &camera, Some(Limit { depth: &limit, sigmas: 0.0 }), &FAST, &context())
                .expect("renders")
        };
        let nearer = [0.5, 1.0, 2.0, 4.0, 8.0, f32::INFINITY].map(before);
        for pair in nearer.windows(2) {
            let alphas = pair[0].rgba.iter().zip(&pair[1].rgba).skip(3).step_by(4);
            assert!(alphas.into_iter().all(|(fewer, more)| fewer <= more));
        }
    }
}
