//! Gradients compared with finite differences in f64 of a renderer written for this test.

use glam::{DMat4, DVec3};

use super::super::{Bounds, Precision, Settings, render_at};
use super::*;
use scene::math::num;
use testing::{context, levels};

/// A splat with the parameters that training changes, in f64.
#[derive(Clone)]
struct Free {
    mean: [f64; 3],
    quat: [f64; 4],
    log_scale: [f64; 3],
    logit: f64,
    sh: Vec<[f64; 3]>,
}

impl Free {
    /// Number of parameters without the harmonics.
    const SHAPE: usize = 11;

    fn len(&self) -> usize {
        Self::SHAPE + 3 * self.sh.len()
    }

    fn parameter(&mut self, k: usize) -> &mut f64 {
        match k {
            0..3 => &mut self.mean[k],
            3..7 => &mut self.quat[k - 3],
            7..10 => &mut self.log_scale[k - 7],
            10 => &mut self.logit,
            _ => &mut self.sh[(k - Self::SHAPE) / 3][(k - Self::SHAPE) % 3],
        }
    }

    fn opacity(&self) -> f64 {
        1.0 / (1.0 + num::f64::exp(-self.logit))
    }

    /// The parameters as the renderer stores them. The test uses values that f32 holds exactly where they are
    /// stored.
    fn stored(free: &[Self], sh_degree: u32) -> Splats {
        let mut splats = Splats { sh_degree, ..Splats::empty() };
        for one in free {
            splats.means.push(one.mean.map(|v| v as f32));
            splats.quats.push(one.quat.map(|v| v as f32));
            splats.scales.push(one.log_scale.map(|v| num::f64::exp(v) as f32));
            splats.opacities.push(one.opacity() as f32);
            splats.sh.extend(one.sh.iter().map(|c| c.map(|v| v as f32)));
        }
        splats
    }
}

/// Basis functions up to degree 3, in f64.
fn basis(x: f64, y: f64, z: f64) -> [f64; 16] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        -0.488_602_52 * y,
        0.488_602_52 * z,
        -0.488_602_52 * x,
        1.092_548_5 * x * y,
        -1.092_548_5 * y * z,
        0.315_391_57 * (2.0 * zz - xx - yy),
        -1.092_548_5 * x * z,
        0.546_274_24 * (xx - yy),
        -0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        -0.457_045_8 * y * (4.0 * zz - xx - yy),
        0.373_176_34 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_8 * x * (4.0 * zz - xx - yy),
        1.445_305_7 * z * (xx - yy),
        -0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}

/// The treatment of a splat at a pixel. Alpha jumps at the cutoff and at the end of a pixel, so finite differences
/// keep these decisions.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Decision {
    Left,
    Blended,
    Capped,
}

/// Renders premultiplied RGB and alpha. Decisions are recorded if the list is empty, and repeated otherwise.
fn reference(
    free: &[Free],
    camera: &Camera,
    settings: &Settings,
    decisions: &mut Vec<Decision>,
) -> Vec<[f64; 4]> {
    let (width, height) = (camera.width_px as usize, camera.height_px as usize);
    let view = camera.camera_from_world();
    let mut drawn = Vec::new();
    for one in free {
        let length = one.quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        let [w, x, y, z] = one.quat.map(|q| q / length);
        let turned = glam::DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w));
        let scales = glam::DMat3::from_diagonal(DVec3::from(one.log_scale.map(num::f64::exp)));
        let mean = DVec3::from(one.mean);
        let p = view.transform_point3(mean);
        let guard = |size: u32, f: f64, c: f64| {
            let size = f64::from(size);
            [-c / f - 0.15 * size / f, (size - c) / f + 0.15 * size / f]
        };
        let [low_x, high_x] = guard(camera.width_px, camera.fx, camera.cx);
        let [low_y, high_y] = guard(camera.height_px, camera.fy, camera.cy);
        let (sx, sy) = ((p.x / p.z).clamp(low_x, high_x), (p.y / p.z).clamp(low_y, high_y));
        let jacobian = [
            DVec3::new(camera.fx / p.z, 0.0, -camera.fx * sx / p.z),
            DVec3::new(0.0, camera.fy / p.z, -camera.fy * sy / p.z),
        ];
        let m = glam::DMat3::from_mat4(view) * turned * scales;
        let covariance = m * m.transpose();
        let of = |a: DVec3, b: DVec3| a.dot(covariance * b);
        let low = settings.low_pass_px2;
        let raw = [of(jacobian[0], jacobian[0]), of(jacobian[0], jacobian[1]), of(jacobian[1], jacobian[1])];
        let [a, b, c] = [raw[0] + low, raw[1], raw[2] + low];
        let det = a * c - b * b;
        let mut opacity = one.opacity();
        if settings.compensate {
            opacity *= ((raw[0] * raw[2] - raw[1] * raw[1]) / det).sqrt();
        }
        let d = (mean - camera.eye()).normalize();
        let functions = basis(d.x, d.y, d.z);
        let colour: [f64; 3] = std::array::from_fn(|k| {
            let sum: f64 = one.sh.iter().zip(functions).map(|(c, b)| c[k] * b).sum();
            (sum + 0.5).max(0.0)
        });
        let centre = [camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy];
        if p.z > settings.near {
            drawn.push((p.z, centre, [c / det, -b / det, a / det], opacity, colour));
        }
    }
    drawn.sort_by(|a, b| a.0.total_cmp(&b.0));
    let record = decisions.is_empty();
    let mut next = 0;
    let mut picture = Vec::new();
    for at in 0..width * height {
        let (px, py) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        let (mut transmittance, mut rgb, mut live) = (1.0, [0.0; 3], true);
        for (_, centre, [a, b, c], opacity, colour) in &drawn {
            let (dx, dy) = (px - centre[0], py - centre[1]);
            let raw = opacity * num::f64::exp(-0.5 * (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy));
            if record {
                let alpha = raw.min(settings.alpha_cap);
                let hit = live && raw >= settings.alpha_cut;
                let ends = hit && transmittance * (1.0 - alpha) < settings.stop;
                live &= !ends;
                decisions.push(match hit && !ends {
                    false => Decision::Left,
                    true if raw > settings.alpha_cap => Decision::Capped,
                    true => Decision::Blended,
                });
            }
            let decision = decisions[next];
            next += 1;
            let alpha = match decision {
                Decision::Left => continue,
                Decision::Blended => raw,
                Decision::Capped => settings.alpha_cap,
            };
            for (sum, c) in rgb.iter_mut().zip(colour) {
                *sum += transmittance * alpha * c;
            }
            transmittance *= 1.0 - alpha;
        }
        picture.push([rgb[0], rgb[1], rgb[2], 1.0 - transmittance]);
    }
    picture
}

/// Generator of reproducible random numbers in an interval.
struct Random(u64);

impl Random {
    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1_u64 << 53) as f64)
    }
}

/// A number that f32 holds exactly.
fn stored(value: f64) -> f64 {
    f64::from(value as f32)
}

fn camera() -> Camera {
    let turned = glam::DMat3::from_rotation_y(0.3) * glam::DMat3::from_rotation_x(-0.2);
    let eye = DVec3::new(0.25, -0.5, -4.0);
    let m = DMat4::from_cols(
        turned.x_axis.extend(0.0),
        turned.y_axis.extend(0.0),
        turned.z_axis.extend(0.0),
        eye.extend(1.0),
    );
    Camera {
        name: "test".to_owned(),
        width_px: 41,
        height_px: 27,
        fx: 38.0,
        fy: 36.5,
        cx: 21.0,
        cy: 12.5,
        lens: Default::default(),
        world_from_camera: m.to_cols_array(),
    }
}

/// Splats of every sort: a needle, a disc, a large one, one that is opaque, one near the near plane, one whose
/// centre is beyond the guard of the projection, a stack that ends pixels, one that is barely above the cutoff, and
/// clamped colours.
fn scene(sh_degree: u32) -> Vec<Free> {
    let camera = camera();
    let world = camera.world_from_camera();
    let mut random = Random(11);
    let mut splats = Vec::new();
    let mut add = |local: [f64; 3], scales: [f64; 3], opacity: f64| {
        let mean = world.transform_point3(DVec3::from(local)).to_array().map(stored);
        let quat = [0; 4].map(|_| random.within(-1.0, 1.0));
        let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        let count = ((sh_degree + 1) * (sh_degree + 1)) as usize;
        let mut sh = vec![[0; 3].map(|_| stored(random.within(-1.0, 2.0)))];
        sh.extend((1..count).map(|_| [0; 3].map(|_| stored(random.within(-0.4, 0.4)))));
        splats.push(Free {
            mean,
            quat: quat.map(|q| stored(q / length)),
            log_scale: scales.map(num::f64::ln),
            logit: num::f64::ln(opacity / (1.0 - opacity)),
            sh,
        });
    };
    add([0.0, 0.1, 3.0], [0.2, 0.15, 0.3], 0.6);
    add([-0.6, 0.2, 3.5], [0.9, 0.01, 0.01], 0.8);
    add([0.5, -0.3, 4.0], [0.5, 0.4, 0.001], 0.7);
    add([0.3, 0.2, 6.0], [3.0, 2.0, 2.5], 0.5);
    add([0.9, 0.3, 3.2], [0.6, 0.5, 0.7], 0.9999);
    add([0.05, -0.05, 0.35], [0.02, 0.03, 0.02], 0.4);
    add([-2.6, 0.4, 2.9], [0.9, 0.5, 0.6], 0.8);
    add([0.2, 1.9, 2.8], [0.4, 0.8, 0.3], 0.8);
    for i in 0..5 {
        add([0.9, 0.3, 3.41 + 0.1 * f64::from(i)], [0.4, 0.3, 0.2], 0.96);
    }
    add([-0.5, -0.5, 5.0], [0.5, 0.5, 0.5], 0.006);
    add([-0.9, 0.5, 3.05], [0.003, 0.004, 0.002], 0.9);
    splats
}

/// Analytic gradients of the sum of `weights` times the picture, one list of parameters per splat.
fn analytic(
    free: &[Free],
    camera: &Camera,
    settings: &Settings,
    weights: &[[f32; 4]],
    level: Level,
) -> Vec<Vec<f64>> {
    let sh_degree = (free[0].sh.len() as f64).sqrt() as u32 - 1;
    let splats = Free::stored(free, sh_degree);
    let plane = |c: usize| weights.iter().map(|w| w[c]).collect::<Vec<f32>>();
    let back = backward(&splats, camera, settings, &context(), (level, &|| 0.0), |_| {
        Ok(PictureGradient { rgb: [plane(0), plane(1), plane(2)], alpha: plane(3) })
    });
    let back = back.expect("renders");
    let chain = Chain::new(camera, settings, sh_degree);
    let mut out: Vec<Vec<f64>> = free.iter().map(|one| vec![0.0; one.len()]).collect();
    for row in (0..back.chunks()).flat_map(|chunk| back.rows(chunk)) {
        let (one, each) = (&free[row.splat], splats.sh_len());
        let values = SplatValues {
            mean: splats.mean(row.splat),
            quat: one.quat,
            scale: one.log_scale.map(num::f64::exp),
            opacity: one.opacity(),
            sh: &splats.sh[row.splat * each..(row.splat + 1) * each],
        };
        let by = chain.gradient(&row, &values);
        let shape = by.mean.into_iter().chain(by.quat).chain(by.log_scale).chain([by.logit]);
        let sh = by.sh[..each].as_flattened().iter().map(|v| f64::from(*v));
        out[row.splat] = shape.chain(sh).collect();
    }
    out
}

fn weights(count: usize) -> Vec<[f32; 4]> {
    let mut random = Random(5);
    (0..count).map(|_| [0; 4].map(|_| random.within(-1.0, 1.0) as f32)).collect()
}

/// Settings whose backward pass is compared: the default, compensated opacity, a large low-pass filter and cutoff,
/// and the tiles of the INRIA rasterizer.
fn variants() -> [Settings; 4] {
    [
        Settings::default(),
        Settings { compensate: true, low_pass_px2: 0.1, ..Settings::default() },
        Settings { alpha_cut: 0.05, low_pass_px2: 2.0, alpha_cap: 0.7, stop: 0.02, ..Settings::default() },
        Settings { bounds: Bounds::Inria, ..Settings::default() },
    ]
}

/// Every derivative agrees with central differences. The error is relative to the largest derivative of the same
/// group of parameters of the splat; f32 sums over up to a thousand pixels reach 2e-5. Parameters are those of all
/// splats, at cutoffs, caps, ends of pixels, clamped slopes and clamped colours. This test fails if a factor or a
/// sign in `chain.rs` or `blend.rs` changes.
#[test]
fn gradients_are_those_of_finite_differences() {
    let camera = camera();
    let pixels = (camera.width_px * camera.height_px) as usize;
    let weights = weights(pixels);
    let objective = |picture: &[[f64; 4]]| -> f64 {
        let one = |(p, w): (&[f64; 4], &[f32; 4])| (0..4).map(|c| p[c] * f64::from(w[c])).sum::<f64>();
        picture.iter().zip(&weights).map(one).sum()
    };
    let (mut worst, mut compared) = (0.0_f64, 0);
    for (variant, settings) in variants().iter().enumerate().take(3) {
        for sh_degree in [0, 1, 2, 3] {
            let mut free = scene(sh_degree);
            let found = analytic(&free, &camera, settings, &weights, Level::new());
            let mut decisions = Vec::new();
            reference(&free, &camera, settings, &mut decisions);
            assert!(decisions.contains(&Decision::Capped) && decisions.contains(&Decision::Left));
            for splat in 0..free.len() {
                let mut differences = Vec::new();
                for k in 0..free[splat].len() {
                    let value = *free[splat].parameter(k);
                    let step = 1e-5 * if k < 3 { 0.1 } else { 1.0 };
                    let mut at = |value: f64| {
                        *free[splat].parameter(k) = value;
                        objective(&reference(&free, &camera, settings, &mut decisions))
                    };
                    differences.push((at(value + step) - at(value - step)) / (2.0 * step));
                    at(value);
                }
                for group in [0..3, 3..7, 7..10, 10..11, 11..differences.len()] {
                    let largest = differences[group.clone()].iter().fold(1e-3_f64, |m, d| m.max(d.abs()));
                    for k in group {
                        let error = (found[splat][k] - differences[k]).abs() / largest;
                        worst = worst.max(error);
                        compared += 1;
                        assert!(
                            error < 3e-4,
                            "variant {variant} degree {sh_degree} splat {splat} parameter {k}: {} and {} (largest {largest})",
                            found[splat][k],
                            differences[k],
                        );
                    }
                }
            }
        }
    }
    assert!(compared > 3 * 15 * 4 * 20, "{compared}");
    assert!(worst > 1e-9, "{worst}");
}

/// The reference of this test renders the same picture as the f64 renderer, so it takes the same decisions.
#[test]
fn the_reference_is_the_renderer() {
    let camera = camera();
    for settings in variants() {
        let free = scene(3);
        let picture = reference(&free, &camera, &settings, &mut Vec::new());
        let settings = Settings { precision: Precision::F64, ..settings };
        let splats = Free::stored(&free, 3);
        let rendered = render_at(&splats, &camera, None, &settings, &context(), (Level::new(), &|| 0.0))
            .expect("renders");
        // INRIA's tiles leave out pixels beyond three standard deviations.
        let bound = if settings.bounds == Bounds::Inria { 0.05 } else { 2e-6 };
        for (a, b) in picture.iter().flatten().zip(&rendered.rgba) {
            assert!((a - f64::from(*b)).abs() < bound, "{a} {b}");
        }
    }
}

/// Gradients have the same bits for every instruction set and number of threads, and INRIA's tiles give nearly the
/// same gradients as exact bounds.
#[test]
fn gradients_do_not_depend_on_the_machine() {
    let camera = camera();
    let weights = weights((camera.width_px * camera.height_px) as usize);
    let free = scene(2);
    for settings in variants() {
        let expected = analytic(&free, &camera, &settings, &weights, Level::new());
        for level in levels() {
            assert_eq!(analytic(&free, &camera, &settings, &weights, level), expected);
        }
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("starts threads");
            assert_eq!(
                pool.install(|| analytic(&free, &camera, &settings, &weights, Level::new())),
                expected
            );
        }
    }
}
