//! Tests of panoramas against a textbook implementation that shares only the harmonics and the layout with
//! the renderer.

use std::f64::consts::{PI, TAU};

use engine::Up;
use scene::math::equirect;
use scene::types::Mesh;

use super::*;
use crate::splat::camera_model::Sphere;

const UPS: [Up; 3] = [Up::PlusZ, Up::PlusY, Up::MinusY];
const FAST: Settings = Settings { precision: Precision::F32, ..F64 };

/// Splats all around the origin.
fn shell(count: usize, seed: u64) -> Splats {
    let mut random = Random(seed);
    let mut splats = cloud(count, seed + 100);
    for mean in &mut splats.means {
        let d = loop {
            let d = DVec3::new(random.within(-1.0, 1.0), random.within(-1.0, 1.0), random.within(-1.0, 1.0));
            if (0.01..1.0).contains(&d.length_squared()) {
                break d.normalize();
            }
        };
        *mean = (d * random.within(0.1, 8.0)).to_array().map(|v| v as f32);
    }
    splats
}

fn around(splats: &Splats, up: Up, width: u32, settings: Settings) -> Rendered {
    panorama(splats, &origin(up, width), None, &settings, &context()).expect("renders")
}

fn origin(up: Up, width_px: u32) -> PanoramaCamera {
    PanoramaCamera { eye: DVec3::ZERO, up, width_px }
}

/// True for the rows that are drawn directly into the layout, because they are outside the caps.
fn in_the_belt(y: usize, width: u32) -> bool {
    let theta = (y as f64 + 0.5) * TAU / f64::from(width);
    (PI / 6.0..=5.0 * PI / 6.0).contains(&theta)
}

fn angles(up: Up, p: DVec3, width: f64) -> [f64; 2] {
    let (u, v) = equirect::uv(up, p);
    [u * width, v * 0.5 * width]
}

/// Textbook implementation of one pixel, with numerical derivatives, explicit covariance matrices, their inverses
/// and the exponential.
fn brute_force(splats: &Splats, up: Up, width: u32, x: usize, y: usize) -> [f64; 4] {
    let width = f64::from(width);
    let mut order: Vec<usize> = (0..splats.len()).collect();
    order.sort_by(|a, b| splats.mean(*a).length().total_cmp(&splats.mean(*b).length()));
    let mut pixel = TextbookPixel::CLEAR;
    for i in order {
        let p = splats.mean(i);
        let distance = p.length();
        let above = equirect::axes(up)[2];
        let rho = (p - above * p.dot(above)).length();
        // Cases below the clamp of the derivative are tested elsewhere.
        assert!(rho > 0.005 * distance);
        if distance <= 0.2 {
            continue;
        }
        let centre = angles(up, p, width);
        let h = 1e-6 * rho;
        let wrapped = |d: f64| d - width * (d / width).round();
        let by = |axis: DVec3| {
            let (a, b) = (angles(up, p + axis * h, width), angles(up, p - axis * h, width));
            [wrapped(a[0] - b[0]) / (2.0 * h), (a[1] - b[1]) / (2.0 * h)]
        };
        let columns = [by(DVec3::X), by(DVec3::Y), by(DVec3::Z)];
        let rows = [0, 1].map(|r| DVec3::new(columns[0][r], columns[1][r], columns[2][r]));
        let sigma = covariance(splats, i);
        let (xx, xy, yy) = (
            rows[0].dot(sigma * rows[0]) + 0.3,
            rows[0].dot(sigma * rows[1]),
            rows[1].dot(sigma * rows[1]) + 0.3,
        );
        let (dx, dy) = (wrapped(x as f64 + 0.5 - centre[0]), y as f64 + 0.5 - centre[1]);
        let power = -0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
        if !pixel.blend(splats, i, num::f64::exp(power), p.normalize()) {
            break;
        }
    }
    pixel.rgba()
}

#[test]
fn panoramas_are_the_textbook() {
    let splats = shell(250, 1);
    // Widths below a tile, not divisible by tiles, and of several tiles.
    for (up, width) in [(UPS[0], 74), (UPS[1], 130), (UPS[2], 10), (UPS[0], 16), (UPS[1], 2), (UPS[2], 36)] {
        let reference = around(&splats, up, width, F64);
        let mut off = 0;
        for (i, pixel) in reference.rgba.as_chunks::<4>().0.iter().enumerate() {
            let (x, y) = (i % width as usize, i / width as usize);
            if !in_the_belt(y, width) {
                continue;
            }
            let expected = brute_force(&splats, up, width, x, y);
            let error = (0..4).map(|c| (f64::from(pixel[c]) - expected[c]).abs()).fold(0.0, f64::max);
            // The derivative by differences carries 1e-9; a pair at the cut may fall on its other side.
            assert!(error < 8e-3, "{up:?} {width} ({x}, {y}): {pixel:?} against {expected:?}");
            off += usize::from(error > 2e-6);
        }
        assert!(off * 1000 <= reference.rgba.len(), "{off} pixels off");
        let fast = around(&splats, up, width, FAST);
        assert!(largest_difference(&fast, &reference) < 8e-3);
        let pairs = fast.rgba.iter().zip(&reference.rgba);
        let off = pairs.filter(|(a, b)| (**a - **b).abs() > 2e-5).count();
        assert!(off <= 4 + fast.rgba.len() / 1000, "{width}: {off} samples off");
        assert!(fast.work.blends.abs_diff(reference.work.blends) <= 2);
    }
}

#[test]
fn exact_bounds_lose_nothing_around_the_seam() {
    for seed in 0..3 {
        let splats = shell(300, 40 + seed);
        for width in [6, 18, 34, 100, 192] {
            for precision in [Precision::F32, Precision::F64] {
                let exact = around(&splats, Up::PlusZ, width, Settings { precision, ..F64 });
                let none = Settings { precision, bounds: Bounds::None, ..F64 };
                let none = around(&splats, Up::PlusZ, width, none);
                assert_eq!(bits(&exact), bits(&none), "{width} {precision:?}");
            }
        }
    }
}

/// If the world is rotated about the up axis by a whole number of columns, the picture is shifted by that number of
/// columns, so there is no seam.
#[test]
fn turning_the_world_rolls_the_picture() {
    let (width, height) = (96_usize, 48);
    let mut splats = shell(300, 7);
    // Harmonics would have to be rotated too.
    splats.sh_degree = 0;
    splats.sh = splats.sh.iter().step_by(16).copied().collect();
    let expected = around(&splats, Up::PlusZ, width as u32, F64);
    for columns in [1, 17, 48, 95] {
        let angle = TAU * columns as f64 / width as f64;
        let (sin, cos) = num::sin_cos(angle);
        let mut turned = splats.clone();
        turned.means_low = vec![[0.0; 3]; turned.len()];
        for i in 0..turned.len() {
            let p = splats.mean(i);
            // Columns grow clockwise from above.
            let q = DVec3::new(p.x * cos + p.y * sin, p.y * cos - p.x * sin, p.z);
            turned.means[i] = q.to_array().map(|v| v as f32);
            let low = q - DVec3::from(turned.means[i].map(f64::from));
            turned.means_low[i] = low.to_array().map(|v| v as f32);
            let (half_sin, half_cos) = num::sin_cos(-0.5 * angle);
            let [w, x, y, z] = splats.quats[i].map(f64::from);
            turned.quats[i] = [
                half_cos * w - half_sin * z,
                half_cos * x - half_sin * y,
                half_cos * y + half_sin * x,
                half_cos * z + half_sin * w,
            ]
            .map(|v| v as f32);
        }
        let seen = around(&turned, Up::PlusZ, width as u32, F64);
        let (mut sum, mut largest) = (0.0_f32, 0.0_f32);
        for y in (0..height).filter(|y| in_the_belt(*y, width as u32)) {
            for x in 0..width {
                for c in 0..4 {
                    let a = expected.rgba[(y * width + x) * 4 + c];
                    let b = seen.rgba[(y * width + (x + columns) % width) * 4 + c];
                    sum += (a - b).abs();
                    largest = largest.max((a - b).abs());
                }
            }
        }
        // Rotations are rounded to f32, and a pair at the cut may fall on its other side.
        assert!(largest < 1e-2 && sum / ((width * height * 4) as f32) < 1e-5, "{columns}: {largest} {sum}");
    }
}

/// Renders the only pixel of a camera that looks along `direction`. The resolution is the resolution of the picture
/// of a cap.
fn single(splats: &Splats, direction: DVec3, width: u32) -> [f32; 4] {
    let right = direction.cross(direction.any_orthonormal_vector()).normalize();
    let axes = [right, direction.cross(right), direction].map(|axis| axis.extend(0.0));
    let mut camera = camera(1, 1, 60.0);
    camera.fx = 1.5 * f64::from(width) / TAU;
    camera.fy = camera.fx;
    camera.world_from_camera = DMat4::from_cols(axes[0], axes[1], axes[2], glam::DVec4::W).to_cols_array();
    let seen = draw(splats, &camera, Settings { sort: Sort::Distance, ..F64 });
    [seen.rgba[0], seen.rgba[1], seen.rgba[2], seen.rgba[3]]
}

// Near the poles the layout is curved over a splat: there the picture is that of a camera, not an ellipse in the
// layout.
#[test]
fn poles_show_what_a_camera_sees() {
    let mut splats = shell(4000, 77);
    // Broad and soft, so that one pixel represents a splat, and far from the near plane.
    for (mean, scale) in splats.means.iter_mut().zip(&mut splats.scales) {
        let p = DVec3::from(mean.map(f64::from)).normalize() * 6.0;
        *mean = p.to_array().map(|v| v as f32);
        *scale = scale.map(|s| s.clamp(0.15, 0.45));
    }
    splats.opacities.iter_mut().for_each(|o| *o *= 0.3);
    let width = 180;
    for settings in [F64, FAST] {
        let seen = around(&splats, Up::PlusY, width, settings);
        let layout = Sphere::new(DVec3::ZERO, Up::PlusY, width, 0..90);
        let as_belt = Settings { sort: Sort::Distance, ..settings };
        let how = (Level::new(), &(|| 0.0) as Clock<'_>);
        let straight =
            crate::splat::draw(&splats, None, &layout, None, &as_belt, &context(), how).expect("renders");
        let (mut squares, mut squares_straight, mut count) = (0.0_f64, 0.0_f64, 0.0);
        // Caps and the transition to them.
        for y in (0..90).filter(|y| !in_the_belt(*y, width)) {
            for x in (0..180).step_by(7) {
                let direction =
                    equirect::direction(Up::PlusY, (x as f64 + 0.5) / 180.0, (y as f64 + 0.5) / 90.0);
                let expected = single(&splats, direction, width);
                for (c, expected) in expected.into_iter().enumerate() {
                    let off = |seen: &Rendered| f64::from(seen.rgba[(y * 180 + x) * 4 + c] - expected);
                    squares += off(&seen) * off(&seen);
                    squares_straight += off(&straight) * off(&straight);
                    count += 1.0;
                }
            }
        }
        let [caps, straight] = [squares, squares_straight].map(|sum| -10.0 * num::f64::log10(sum / count));
        assert!(caps > 34.0 && caps > straight + 3.0, "{caps:.1} dB; without the caps {straight:.1} dB");
    }
}

/// Splats on the axis through the poles, next to it and on the seam appear in the right direction.
#[test]
fn poles_and_the_seam_are_where_they_belong() {
    for up in UPS {
        let [_, forward, above] = equirect::axes(up);
        for d in [above, -above, above + forward * 1e-9, above - forward * 1e-3, -forward] {
            let splat = one((d * 3.0).to_array().map(|v| v as f32), [0.05; 3], 0.9, [1.0; 3]);
            for precision in [Precision::F32, Precision::F64] {
                let seen = around(&splat, up, 128, Settings { precision, ..F64 });
                assert!(seen.rgba.iter().all(|v| v.is_finite()));
                let brightest = (0..128 * 64).max_by(|a, b| seen.rgba[a * 4].total_cmp(&seen.rgba[b * 4]));
                let at = brightest.expect("a pixel");
                let found = equirect::direction(
                    up,
                    ((at % 128) as f64 + 0.5) / 128.0,
                    ((at / 128) as f64 + 0.5) / 64.0,
                );
                assert!(found.dot(d.normalize()) > num::f64::cos(2.0 * PI / 64.0), "{up:?} {d}");
                let depth = seen.depth[at];
                assert!((depth - 3.0).abs() < 1e-5, "{depth}");
            }
        }
        // Both ends of the middle row show the splat behind equally.
        let behind = one((-forward * 3.0).to_array().map(|v| v as f32), [0.3; 3], 0.9, [1.0; 3]);
        let seen = around(&behind, up, 128, FAST);
        let red = |x: usize| seen.rgba[(32 * 128 + x) * 4];
        for x in 0..20 {
            assert!((red(x) - red(127 - x)).abs() < 1e-6);
        }
        assert!(red(0) > 0.5 && red(64) == 0.0);
    }
}

// A splat that fills the zenith hides what is behind it in every column.
#[test]
fn a_wide_splat_over_the_pole_covers_all_columns() {
    let wide = one([0.0, 0.0, 2.0], [1.0, 1.0, 0.1], 0.95, [1.0; 3]);
    let seen = around(&wide, Up::PlusZ, 128, FAST);
    assert!((0..128).all(|x| seen.rgba[x * 4 + 3] > 0.9));
}

// A wall at x = 2, visible in the belt and in both caps: everything behind it is hidden, nothing next to it is, and
// splats in front of it stay.
#[test]
fn a_surface_in_front_hides_what_is_behind_it() {
    let splats = shell(600, 13);
    let corners = [[2.0, -50.0, -50.0], [2.0, 50.0, -50.0], [2.0, 50.0, 50.0], [2.0, -50.0, 50.0]];
    let wall = Mesh { positions: corners.to_vec(), triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
    let wall = Surface::new(&wall, DVec3::ZERO);
    let before = |up: Up, splats: &Splats, settings: Settings| {
        panorama(splats, &origin(up, 128), Some(&wall), &settings, &context()).expect("renders")
    };
    for up in UPS {
        for settings in [F64, FAST] {
            let (open, cut) = (around(&splats, up, 128, settings), before(up, &splats, settings));
            for (i, depth) in cut.depth.iter().enumerate() {
                let (u, v) = ((i % 128) as f64 + 0.5, (i / 128) as f64 + 0.5);
                let d = equirect::direction(up, u / 128.0, v / 64.0);
                // Pictures of the caps are resampled between their pixels.
                if d.x < -0.05 {
                    assert_eq!(cut.rgba[i * 4..i * 4 + 4], open.rgba[i * 4..i * 4 + 4]);
                } else if d.x > 0.05 && *depth < f32::INFINITY {
                    assert!(f64::from(*depth) * d.x < 2.2, "{up:?} {i}: {depth}");
                }
            }
            assert!(cut.work.blends < open.work.blends);
            let near = one([1.0, 0.0, 0.0], [0.3; 3], 0.9, [1.0; 3]);
            // Small, since its distance counts, and the wall is farther at its edges.
            let far = one([3.0, 0.0, 0.0], [0.2; 3], 0.9, [-1.0; 3]);
            let both = before(up, &join(&[&far, &near]), settings);
            assert!(bits(&both) == bits(&around(&near, up, 128, settings)));
        }
    }
}

#[test]
fn instruction_sets_and_threads_do_not_show_in_panoramas() {
    let splats = shell(400, 3);
    let expected = around(&splats, Up::MinusY, 118, FAST);
    for level in levels() {
        let here = panorama_at(&splats, &origin(Up::MinusY, 118), None, &FAST, &context(), level);
        let here = here.expect("renders");
        assert_eq!(bits(&here), bits(&expected), "{level:?}");
    }
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let here = pool.install(|| around(&splats, Up::MinusY, 118, FAST));
        assert_eq!(bits(&here), bits(&expected), "{threads} threads");
    }
}
