use glam::DVec3;

use super::*;
use crate::kinds::cube_rig::{Turn, cube};
use scene::types::{Camera, Cell, Rig};
use scene::types::{Data, Image, Srgb};
use testing::{context, row};

fn views(rig: Rig, colour: impl Fn(&Camera, usize, usize) -> [f32; 4]) -> Arc<Views> {
    let view = |camera: Camera| {
        let (w, h) = (camera.width_px as usize, camera.height_px as usize);
        let samples = (0..w * h).flat_map(|i| colour(&camera, i % w, i / w)).collect();
        let depth = Image::<Data>::new(w, h, 1);
        View { colour: Image::<Srgb>::from_samples(w, h, 4, samples).into(), depth, camera }
    };
    Arc::new(Views(rig.cameras.into_iter().map(view).collect()))
}

fn rig(size_px: u32, guard_deg: f64, turn: Turn) -> Rig {
    cube(DVec3::new(0.5, 1.0, -2.0), equirect::axes(Up::PlusZ), size_px, guard_deg, turn)
}

fn stitched(views: Arc<Views>, width_px: u32) -> Arc<Panorama> {
    let params = Stitch { width_px, holes: Holes::PushPull, hole_alpha: 0.25, as_views: false };
    Stitch::run(&params, In { views }, &context()).expect("stitches").0.pano
}

/// Faces of one colour give a constant panorama, for sizes down to a pixel, with and without a guard band.
#[test]
fn constant_faces_stay_constant() {
    let mut largest = 0.0_f64;
    for (size, guard) in [(1, 0.0), (2, 3.0), (7, 0.0), (33, 3.0), (64, 20.0)] {
        for alpha in [1.0_f32, 0.5] {
            let c = [0.25_f32, 0.6, 2.5];
            let pano = stitched(
                views(rig(size, guard, Turn::OffAxis), |_, _, _| {
                    [c[0] * alpha, c[1] * alpha, c[2] * alpha, alpha]
                }),
                66,
            );
            for (pixel, a) in pano.image.samples().as_chunks::<3>().0.iter().zip(&pano.alpha.samples) {
                let off = (0..3).map(|i| (pixel[i] - c[i]).abs() / c[i]).fold((a - alpha).abs(), f32::max);
                largest = largest.max(f64::from(off));
            }
        }
    }
    row(18, "off the colour and alpha of the faces, relative", largest, 1e-6);
}

/// The energy of a single lit pixel of each face is its solid angle, also at the poles and at the seam, where
/// `Aligned` puts the centres of faces.
#[test]
fn a_single_pixel_keeps_its_energy() {
    let sphere: f64 = (0..128).map(|y| 256.0 * equirect::pixel_solid_angle(256, 128, y)).sum();
    row(19, "solid angles off 4 pi", (sphere - 4.0 * PI).abs(), 1e-5);
    let size = 24;
    for (face, x, y) in
        (0..6).flat_map(|face| [(12, 12), (11, 11), (5, 9), (12, 3), (2, 3)].map(|(x, y)| (face, x, y)))
    {
        let rig = rig(size, 0.0, Turn::Aligned);
        let name = rig.cameras[face].name.clone();
        let lit = |camera: &Camera, px: usize, py: usize| {
            let on = camera.name == name && (px, py) == (x, y);
            if on { [1.0, 1.0, 1.0, 1.0] } else { [0.0, 0.0, 0.0, 1.0] }
        };
        let pano = stitched(views(rig.clone(), lit), 256);
        let mut energy = 0.0;
        for y in 0..128 {
            let pixels = &pano.image.samples()[y * 256 * 3..(y + 1) * 256 * 3];
            let sum: f64 = pixels.iter().step_by(3).map(|c| f64::from(color::linear_from_srgb(*c))).sum();
            energy += sum * equirect::pixel_solid_angle(256, 128, y);
        }
        // The bilinear pixel spreads over its neighbours, which are of nearly its solid angle.
        let f = rig.cameras[face].fx;
        let (dx, dy) = ((x as f64 + 0.5 - 12.0) / f, (y as f64 + 0.5 - 12.0) / f);
        let r2 = 1.0 + dx * dx + dy * dy;
        let expected = 1.0 / (f * f * r2 * r2.sqrt());
        row(19, "energy of a texel off its solid angle", (energy / expected - 1.0).abs(), 0.01);
    }
}

// A smooth function of direction comes back at every pixel, seams, poles and wrap included.
#[test]
fn a_smooth_sky_is_reproduced() {
    let sky = |d: DVec3| 0.5 + 0.3 * d.x + 0.2 * d.y * d.z;
    for turn in [Turn::OffAxis, Turn::Aligned] {
        let pano = stitched(
            views(rig(128, 3.0, turn), |camera, x, y| {
                let c = sky(camera.direction(x as f64 + 0.5, y as f64 + 0.5)) as f32;
                [c, c, c, 1.0]
            }),
            256,
        );
        for y in 0..128 {
            for x in 0..256 {
                let d = equirect::direction(Up::PlusZ, (x as f64 + 0.5) / 256.0, (y as f64 + 0.5) / 128.0);
                let seen = f64::from(pano.image.samples()[(y * 256 + x) * 3]);
                // A pixel shows the mean over its area, which at the poles lies 0.004 rad off its centre.
                assert!((seen - sky(d)).abs() < 1.5e-3, "({x}, {y}): {seen} against {}", sky(d));
            }
        }
    }
}

// A hole keeps alpha 0 and is filled from its surroundings, not black, also across the wrap.
#[test]
fn holes_take_the_colour_around_them() {
    let hole = DVec3::new(0.05, -1.0, 0.1).normalize();
    let scene = views(rig(96, 3.0, Turn::OffAxis), |camera, x, y| {
        let d = camera.direction(x as f64 + 0.5, y as f64 + 0.5);
        if d.dot(hole) > 0.9 { [0.0; 4] } else { [0.7, 0.4, 0.2, 1.0] }
    });
    let (out, notes) = Stitch::run(
        &Stitch { width_px: 128, holes: Holes::PushPull, hole_alpha: 0.25, as_views: false },
        In { views: scene },
        &context(),
    )
    .expect("stitches");
    assert!(notes.iter().any(|note| note.id == "holes"));
    assert!(out.pano.alpha.samples.iter().filter(|a| **a == 0.0).count() > 100);
    for pixel in out.pano.image.samples().as_chunks::<3>().0 {
        for (c, expected) in pixel.iter().zip([0.7, 0.4, 0.2]) {
            assert!((c - expected).abs() < 1e-4, "{pixel:?}");
        }
    }
}

// A very small alpha is not the same as none.
#[test]
fn a_panorama_of_next_to_nothing_is_reported_from_one_of_nothing() {
    for (alpha, id) in [(0.0, "nothing-seen"), (0.155, "little-seen")] {
        let scene = views(rig(8, 3.0, Turn::OffAxis), |camera, x, y| {
            let up = camera.direction(x as f64 + 0.5, y as f64 + 0.5).z > 0.9;
            if up { [alpha; 4] } else { [0.0; 4] }
        });
        let params = Stitch { width_px: 32, holes: Holes::PushPull, hole_alpha: 0.25, as_views: false };
        let (_, notes) = Stitch::run(&params, In { views: scene }, &context()).expect("stitches");
        let reported: Vec<_> = notes.iter().map(|note| note.id.to_string()).collect();
        assert_eq!(reported, [id]);
    }
}

#[test]
fn views_from_two_points_are_refused() {
    let mut rig = rig(4, 3.0, Turn::OffAxis);
    rig.cameras[3].world_from_camera[12] += 0.1;
    let params = Stitch { width_px: 8, holes: Holes::Black, hole_alpha: 0.25, as_views: false };
    let refused = Stitch::run(&params, In { views: views(rig, |_, _, _| [0.0; 4]) }, &context());
    assert!(refused.is_err_and(|e| e.message().contains("apart")));
}

/// Faces of any shape are sampled within their edges: a strip of 4096 pixels, a face of a single pixel, a face of a
/// single column, and a face of 4096 x 4096 among faces of one pixel. Every direction of a fine grid is
/// defined, and directions outside the views are holes.
#[test]
fn faces_of_any_shape_are_sampled_within_their_edges() {
    for (width, height, focal) in
        [(4096, 3, 600.0), (1, 1, 0.5), (1, 4096, 2000.0), (5, 3, 0.01), (3, 5, 1e6)]
    {
        let mut rig = rig(1, 0.0, Turn::Aligned);
        for camera in &mut rig.cameras {
            (camera.width_px, camera.height_px) = (width, height);
            (camera.fx, camera.fy) = (focal, focal);
            (camera.cx, camera.cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
        }
        if width == 1 && height == 1 {
            let large = &mut rig.cameras[0];
            (large.width_px, large.height_px) = (4096, 4096);
            (large.fx, large.fy, large.cx, large.cy) = (2048.0, 2048.0, 2048.0, 2048.0);
        }
        let pano = stitched(views(rig, |_, _, _| [0.5, 0.25, 2.0, 1.0]), 128);
        for (pixel, alpha) in pano.image.samples().as_chunks::<3>().0.iter().zip(&pano.alpha.samples) {
            assert!((0.0..=1.0).contains(alpha));
            for (c, expected) in pixel.iter().zip([0.5, 0.25, 2.0]) {
                assert!(c.is_finite() && *c <= expected * 1.000_01, "{width}x{height}: {pixel:?}");
                assert!(*alpha < 0.25 || (c / expected - 1.0).abs() < 1e-5, "{width}x{height}: {pixel:?}");
            }
        }
    }
}

/// The seam between the last and the first column is as smooth as any other pair of columns, and the rows at the
/// poles approach a constant colour as the width grows.
#[test]
fn the_wrap_is_smooth_and_poles_grow_constant() {
    let sky = |d: DVec3| 0.5 + 0.3 * d.x + 0.2 * d.y * d.z;
    let mut last = f32::INFINITY;
    for width in [32_usize, 64, 128] {
        let faces = views(rig(96, 3.0, Turn::OffAxis), |camera, x, y| {
            let c = sky(camera.direction(x as f64 + 0.5, y as f64 + 0.5)) as f32;
            [c, c, c, 1.0]
        });
        let pano = stitched(faces, width as u32);
        let red = |x: usize, y: usize| pano.image.samples()[(y * width + x) * 3];
        let above = |y: usize| {
            let steps = (0..width - 1).map(|x| (red(x, y) - red(x + 1, y)).abs());
            (red(width - 1, y) - red(0, y)).abs() - steps.fold(0.0, f32::max)
        };
        let seam = (0..width / 2).map(above).fold(0.0, f32::max);
        row(
            21,
            &format!("step at the wrap above the largest of its row, {width} columns"),
            seam.into(),
            1e-4,
        );
        let polar = (0..width).map(|x| red(x, 0));
        let spread = polar.clone().fold(0.0, f32::max) - polar.fold(1.0, f32::min);
        if last.is_finite() {
            let what = format!("spread of the polar row, {width} columns over half as many");
            row(21, &what, (spread / last).into(), 0.6);
        }
        last = spread;
    }
}

/// Every point of a panorama maps to a unit direction, and every direction, however short, long or close to
/// an axis, maps to a point inside the panorama.
#[test]
fn directions_are_never_degenerate() {
    let mut state = 3_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    for i in 0..20_000 {
        let up = [Up::PlusZ, Up::PlusY, Up::MinusY][i % 3];
        let edge = |v: f64| [0.0, 1.0, 0.5, v, v, v][i / 3 % 6];
        let (u, v) = (edge(next()), edge(next()));
        let d = equirect::direction(up, u, v);
        assert!((d.length() - 1.0).abs() < 1e-14);
        for d in [d * 1e-150, d * 1e150, d, DVec3::new(0.0, -0.0, d.z), DVec3::ZERO] {
            let (u, v) = equirect::uv(up, d);
            assert!((0.0..1.0).contains(&u) && (0.0..=1.0).contains(&v), "{d}: ({u}, {v})");
        }
    }
}

/// The three energies in a row of the table `steps`: in the views, after resampling, and after the holes are
/// filled.
fn steps(report: &Report, row: usize) -> [f64; 3] {
    let table = report.tables.iter().find(|table| table.name == "steps").expect("is there");
    [1, 2, 3].map(|column| match table.rows[row][column] {
        Cell::Number(v) => v,
        ref other => panic!("{other:?}"),
    })
}

// Each direction counts once where views overlap, and a light has the same irradiance before and after, for any
// orientation and overlap of the faces. This test fails without `/ all`, with `length` twice instead of thrice, or
// with a margin of 0.
#[test]
fn the_books_of_a_light_agree() {
    let sun = DVec3::new(0.6, 0.5, 0.62).normalize();
    let sky = |d: DVec3| if d.dot(sun) > 0.996 { 1.0 } else { 0.25 + 0.1 * d.z };
    let code = |d: DVec3| color::srgb_from_linear(sky(d) as f32);
    for (guard, turn) in [(0.0, Turn::Aligned), (3.0, Turn::OffAxis), (20.0, Turn::Aligned)] {
        let seen = views(rig(96, guard, turn), |camera, x, y| {
            let c = code(camera.direction(x as f64 + 0.5, y as f64 + 0.5));
            [c, c, c, 1.0]
        });
        let params = Stitch { width_px: 256, holes: Holes::PushPull, hole_alpha: 0.25, as_views: false };
        let report = Stitch::run(&params, In { views: seen }, &context()).expect("stitches").0.report;
        // The sky, its mirror image below, and the cap of the sun.
        let power = PI + 2.0 * PI * (1.0 - 0.996) * (0.75 - 0.1 * sun.z);
        let [views, resampled, filled] = steps(&report, 0);
        assert!((views / power - 1.0).abs() < 2e-3, "{guard}: {views} {power}");
        assert!((resampled / views - 1.0).abs() < 2e-3 && (filled / resampled - 1.0).abs() < 1e-5);
        let [views, resampled, _] = steps(&report, 3);
        assert!((resampled / views - 1.0).abs() < 0.02, "{guard}: {views} {resampled}");
        assert_eq!(report.tables[0].rows.len(), 1, "one light");
    }
}

// The fill of a hole is light that no view contains; black adds none. This test fails if `filled` is taken before
// the holes are filled.
#[test]
fn the_books_tell_what_fills_holes() {
    for (holes, more) in [(Holes::PushPull, 2.0), (Holes::Black, 1.0)] {
        let seen = views(rig(64, 0.0, Turn::Aligned), |camera, x, y| {
            let above = camera.direction(x as f64 + 0.5, y as f64 + 0.5).z > 0.0;
            if above { [0.5, 0.5, 0.5, 1.0] } else { [0.0; 4] }
        });
        let params = Stitch { width_px: 128, holes, hole_alpha: 0.25, as_views: false };
        let report = Stitch::run(&params, In { views: seen }, &context()).expect("stitches").0.report;
        let [views, resampled, filled] = steps(&report, 0);
        assert!((resampled / views - 1.0).abs() < 0.01, "{views} {resampled}");
        assert!((filled / resampled - more).abs() < 0.03, "{filled} {resampled}");
    }
}
