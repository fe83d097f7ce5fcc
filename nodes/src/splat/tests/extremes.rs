//! Rows of `users-metrics.md`, section 5, that loaders let through and the renderer must bear; those of
//! the file formats are tested beside the loaders.

use engine::Up;

use super::*;

const FAST: Settings = Settings { precision: Precision::F32, ..F64 };

/// Alpha of one round splat at a pixel, by the formula alone.
fn alpha_at(camera: &Camera, sigma: f64, z: f64, opacity: f64, x: usize, y: usize) -> f64 {
    let size = camera.fx * sigma / z;
    let variance = size * size + 0.3;
    let (dx, dy) = (x as f64 + 0.5 - camera.cx, y as f64 + 0.5 - camera.cy);
    let alpha = (opacity * num::f64::exp(-0.5 * (dx * dx + dy * dy) / variance)).min(0.99);
    if alpha < 1.0 / 255.0 { 0.0 } else { alpha }
}

fn is_the_formula(sigma: f32, opacity: f32) {
    let camera = camera(31, 31, 50.0);
    let splat = one([0.0, 0.0, 3.0], [sigma; 3], opacity, [1.0; 3]);
    for settings in [F64, FAST] {
        let seen = draw(&splat, &camera, settings);
        for i in 0..31 * 31 {
            let expected = alpha_at(&camera, f64::from(sigma), 3.0, f64::from(opacity), i % 31, i / 31);
            let found = f64::from(seen.rgba[i * 4 + 3]);
            assert!((found - expected).abs() < 1e-6, "{sigma} {opacity}: {found} against {expected}");
        }
    }
}

// Row 5: what is far below a pixel, down to nothing at all, shows as the low-pass filter alone.
#[test]
fn scales_of_nothing_show_the_filter() {
    for scale in [num::f64::exp(-40.0) as f32, 1e-30, 1e-45, 0.0] {
        is_the_formula(scale, 0.8);
    }
}

// Row 6: opacity 1 is capped at 0.99, exactly; below the cut there is nothing.
#[test]
fn opacities_at_both_ends() {
    is_the_formula(0.2, 1.0);
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

// Row 4: a splat as large as a file may hold covers all pixels, once each, at once.
#[test]
fn huge_splats_cost_one_evaluation_a_pixel() {
    let camera = camera(64, 48, 60.0);
    for scale in [1e6_f32, 1e15, f32::MAX] {
        let splat = one([0.0, 0.0, 3.0], [scale; 3], 0.5, [1.0; 3]);
        for settings in [F64, FAST] {
            let seen = draw(&splat, &camera, settings);
            assert!(seen.rgba.iter().all(|v| v.is_finite()) && seen.work.evaluations <= 64 * 48);
            // In f64 no scale of a file overflows: it is drawn, or counted.
            assert!(
                seen.work.degenerate == 1
                    || seen.rgba.as_chunks::<4>().0.iter().all(|p| (p[3] - 0.5).abs() < 1e-3)
            );
            let around = panorama(&splat, DVec3::ZERO, Up::PlusZ, 64, &settings, &context());
            let around = around.expect("renders");
            assert!(around.rgba.iter().all(|v| v.is_finite()));
            // Once in the belt and once in the caps, which overlap a little and are finer.
            assert!(around.work.evaluations <= 2 * 64 * 32, "{:?}", around.work);
        }
    }
}

// Rows 1 and 3: what a loader drops is as if it had never been in the file; here, what it cannot drop
// because it is only invisible.
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

// Row 16: the widest and the narrowest angle, one pixel and a strip, against the textbook.
#[test]
fn odd_cameras_are_the_textbook() {
    let splats = cloud(200, 61);
    for camera in [camera(20, 15, 1.0), camera(20, 15, 179.0), camera(1, 1, 60.0), camera(300, 1, 100.0)] {
        let seen = draw(&splats, &camera, F64);
        let width = camera.width_px as usize;
        let mut off = 0;
        for (i, pixel) in seen.rgba.as_chunks::<4>().0.iter().enumerate() {
            let expected = brute_force(&splats, &camera, i % width, i / width);
            let error = (0..4).map(|c| (f64::from(pixel[c]) - expected[c]).abs()).fold(0.0, f64::max);
            // The textbook's own inverse of a needle's covariance cancels; a pair may fall across the cut.
            assert!(error < 8e-3, "{width} {i}: {pixel:?} against {expected:?}");
            off += usize::from(error > 1e-5);
        }
        assert!(off * 50 <= seen.rgba.len() / 4, "{off}");
    }
}
