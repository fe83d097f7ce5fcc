use glam::{DMat3, DMat4, DVec3};

use super::*;
use engine::Notes;
use scene::math::num;
use scene::types::{Data, Image};
use testing::{context, levels};

mod blocks;
mod distorted;
mod extremes;
mod groups;
mod modes;
mod panorama;
mod peaks;

/// Generator of reproducible random numbers in [0, 1).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

fn empty(sh_degree: u32) -> Splats {
    Splats { sh_degree, ..Splats::empty() }
}

/// Splats of all sizes and shapes, in front of and around a camera that is at the origin and looks along z.
fn cloud(count: usize, seed: u64) -> Splats {
    let mut random = Random(seed);
    let mut splats = empty(3);
    for _ in 0..count {
        let z = random.within(-0.5, 12.0);
        let mean = [random.within(-1.0, 1.0) * z, random.within(-1.0, 1.0) * z, z];
        splats.means.push(mean.map(|v| v as f32));
        let quat = [0; 4].map(|_| random.within(-1.0, 1.0));
        let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        splats.quats.push(quat.map(|q| (q / length) as f32));
        splats.scales.push([0; 3].map(|_| num::f64::exp(random.within(-7.0, -0.7)) as f32));
        splats.opacities.push(random.within(0.0, 1.0) as f32);
        splats.sh.push([0; 3].map(|_| random.within(-1.5, 2.0) as f32));
        for _ in 1..16 {
            splats.sh.push([0; 3].map(|_| random.within(-0.2, 0.2) as f32));
        }
    }
    splats
}

fn one(mean: [f32; 3], scale: [f32; 3], opacity: f32, dc: [f32; 3]) -> Splats {
    Splats {
        means: vec![mean],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        scales: vec![scale],
        opacities: vec![opacity],
        sh: vec![dc],
        ..empty(0)
    }
}

fn join(all: &[&Splats]) -> Splats {
    let mut sum = empty(all[0].sh_degree);
    for splats in all {
        sum.means.extend(&splats.means);
        sum.quats.extend(&splats.quats);
        sum.scales.extend(&splats.scales);
        sum.opacities.extend(&splats.opacities);
        sum.sh.extend(&splats.sh);
    }
    sum
}

fn camera(width_px: u32, height_px: u32, fov_x_deg: f64) -> Camera {
    let f = 0.5 * f64::from(width_px) / num::f64::tan((0.5 * fov_x_deg).to_radians());
    Camera {
        name: "test".to_owned(),
        width_px,
        height_px,
        fx: f,
        fy: f,
        cx: 0.5 * f64::from(width_px),
        cy: 0.5 * f64::from(height_px),
        lens: Default::default(),
        world_from_camera: DMat4::IDENTITY.to_cols_array(),
    }
}

fn draw(splats: &Splats, camera: &Camera, settings: Settings) -> Rendered {
    render(splats, camera, None, &settings, &context()).expect("renders")
}

fn largest_difference(a: &Rendered, b: &Rendered) -> f64 {
    let pairs = a.rgba.iter().zip(&b.rgba);
    pairs.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

fn bits(seen: &Rendered) -> Vec<u32> {
    seen.rgba.iter().chain(&seen.depth).chain(&seen.spread).map(|v| v.to_bits()).collect()
}

const F64: Settings = Settings {
    bounds: Bounds::Exact,
    precision: Precision::F64,
    sort: Sort::Depth,
    sh_degree: 4,
    near: 0.2,
    low_pass_px2: 0.3,
    compensate: false,
    alpha_cut: 1.0 / 255.0,
    alpha_cap: 0.99,
    stop: 1e-4,
    depth: DepthMode::Expected,
    count_blends: false,
    skip_unseen: true,
    skip_harmonics: true,
    list_bytes: settings::LIST_BYTES,
};

/// State of a pixel of the textbook implementation, which blends splats front to back.
struct TextbookPixel {
    rgb: [f64; 3],
    transmittance: f64,
}

impl TextbookPixel {
    const CLEAR: Self = Self { rgb: [0.0; 3], transmittance: 1.0 };

    /// Blends splat `i`, with the value `weight` of its Gaussian at the pixel, seen along `direction`.
    /// Returns false if the pixel is finished.
    fn blend(&mut self, splats: &Splats, i: usize, weight: f64, direction: DVec3) -> bool {
        let alpha = (f64::from(splats.opacities[i]) * weight).min(0.99);
        if alpha < 1.0 / 255.0 {
            return true;
        }
        if self.transmittance * (1.0 - alpha) < 1e-4 {
            return false;
        }
        let each = splats.sh_len();
        let direction = direction.to_array().map(|v| v as f32);
        let colour = sh::colour(splats.sh_degree, &splats.sh[i * each..(i + 1) * each], direction);
        for (sum, c) in self.rgb.iter_mut().zip(colour) {
            *sum += self.transmittance * alpha * f64::from(c);
        }
        self.transmittance *= 1.0 - alpha;
        true
    }

    fn rgba(self) -> [f64; 4] {
        let [r, g, b] = self.rgb;
        [r, g, b, 1.0 - self.transmittance]
    }
}

/// The covariance of splat `i` in world coordinates.
fn covariance(splats: &Splats, i: usize) -> DMat3 {
    let [w, a, b, c] = splats.quats[i].map(f64::from);
    let r = DMat3::from_quat(glam::DQuat::from_xyzw(a, b, c, w).normalize());
    let s = DMat3::from_diagonal(DVec3::from(splats.scales[i].map(f64::from)));
    r * s * s * r.transpose()
}

/// Textbook implementation of one pixel, with explicit covariance matrices, their inverses and the exponential. It
/// shares only the harmonics with the renderer.
fn brute_force(splats: &Splats, camera: &Camera, x: usize, y: usize) -> [f64; 4] {
    let mut order: Vec<usize> = (0..splats.len()).collect();
    order.sort_by(|a, b| splats.means[*a][2].total_cmp(&splats.means[*b][2]));
    let mut pixel = TextbookPixel::CLEAR;
    let limit = 1.3 * 0.5 * f64::from(camera.width_px) / camera.fx;
    let limit_y = 1.3 * 0.5 * f64::from(camera.height_px) / camera.fy;
    for i in order {
        let p = DVec3::from(splats.means[i].map(f64::from));
        if p.z <= 0.2 {
            continue;
        }
        let sigma = covariance(splats, i);
        let (tx, ty) = ((p.x / p.z).clamp(-limit, limit) * p.z, (p.y / p.z).clamp(-limit_y, limit_y) * p.z);
        let jx = DVec3::new(camera.fx / p.z, 0.0, -camera.fx * tx / (p.z * p.z));
        let jy = DVec3::new(0.0, camera.fy / p.z, -camera.fy * ty / (p.z * p.z));
        let (xx, xy, yy) = (jx.dot(sigma * jx) + 0.3, jx.dot(sigma * jy), jy.dot(sigma * jy) + 0.3);
        let det = xx * yy - xy * xy;
        let dx = x as f64 + 0.5 - (camera.fx * p.x / p.z + camera.cx);
        let dy = y as f64 + 0.5 - (camera.fy * p.y / p.z + camera.cy);
        let power = -0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det;
        if !pixel.blend(splats, i, num::f64::exp(power), p.normalize()) {
            break;
        }
    }
    pixel.rgba()
}

#[test]
fn f64_is_the_textbook_and_f32_is_f64() {
    let splats = cloud(300, 1);
    // Sizes that no tile divides.
    let camera = camera(75, 53, 70.0);
    let reference = draw(&splats, &camera, F64);
    for (i, pixel) in reference.rgba.as_chunks::<4>().0.iter().enumerate() {
        let expected = brute_force(&splats, &camera, i % 75, i / 75);
        for c in 0..4 {
            // Opacities, transmittances and colours leave the renderer as f32.
            assert!((f64::from(pixel[c]) - expected[c]).abs() < 1e-6, "{i}: {pixel:?} against {expected:?}");
        }
    }
    let fast = draw(&splats, &camera, Settings { precision: Precision::F32, ..F64 });
    assert!(largest_difference(&fast, &reference) < 2e-6);
    for (a, b) in fast.depth.iter().zip(&reference.depth) {
        assert!(a == b || (a / b - 1.0).abs() < 1e-5, "{a} against {b}");
    }
    assert_eq!(fast.work.blends, reference.work.blends);
    assert!(fast.work.blends > 10_000);
}

// Exact bounds lose no pixel: the same bits as evaluating every splat everywhere.
#[test]
fn exact_bounds_equal_no_bounds() {
    for seed in 0..4 {
        let splats = cloud(400, 10 + seed);
        for camera in [camera(100, 61, 90.0), camera(33, 180, 20.0)] {
            for precision in [Precision::F32, Precision::F64] {
                let exact = draw(&splats, &camera, Settings { precision, ..F64 });
                let none = draw(&splats, &camera, Settings { precision, bounds: Bounds::None, ..F64 });
                assert_eq!(bits(&exact), bits(&none));
                assert!(exact.work.tile_pairs * 2 < none.work.tile_pairs);
            }
        }
    }
}

#[test]
fn every_instruction_set_and_thread_count_gives_the_same_bytes() {
    let splats = cloud(500, 3);
    let camera = camera(90, 70, 80.0);
    let settings = Settings { precision: Precision::F32, ..F64 };
    let expected = draw(&splats, &camera, settings);
    for level in levels() {
        for depth in [DepthMode::Expected, DepthMode::Median, DepthMode::RayMedian] {
            let settings = Settings { depth, ..settings };
            let here =
                render_at(&splats, &camera, None, &settings, &context(), (level, &|| 0.0)).expect("renders");
            let expected = draw(&splats, &camera, settings);
            assert_eq!(bits(&here), bits(&expected), "{level:?}");
            assert_eq!(here.work, expected.work);
        }
    }
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let here = pool.install(|| draw(&splats, &camera, settings));
        assert_eq!(bits(&here), bits(&expected), "{threads} threads");
    }
}

/// The results of the jobs of the projection are joined in file order, for any number of threads. The picture
/// equals the picture without bounds, for which all footprints are sorted as a single row.
#[test]
fn scenes_of_several_jobs_are_one_picture() {
    let splats = cloud(20_000, 6);
    let camera = camera(40, 70, 60.0);
    let settings = Settings { precision: Precision::F32, stop: 0.0, ..F64 };
    let none = draw(&splats, &camera, Settings { bounds: Bounds::None, ..settings });
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let exact = pool.install(|| draw(&splats, &camera, settings));
        assert_eq!(bits(&exact), bits(&none), "{threads} threads");
        assert_eq!(exact.work.blends, none.work.blends);
    }
    assert!(none.work.blends > 500_000, "{:?}", none.work);
}

#[test]
fn depth_is_planar_and_modes_differ_as_they_say() {
    let near = one([0.0, 0.0, 2.0], [0.4; 3], 0.4, [1.0; 3]);
    let far = one([0.0, 0.0, 6.0], [2.0; 3], 0.9, [1.0; 3]);
    let camera = camera(33, 33, 60.0);
    let middle = 16 * 33 + 16;
    for precision in [Precision::F32, Precision::F64] {
        let alone = draw(&near, &camera, Settings { precision, ..F64 });
        let corner = alone.depth[0];
        assert!((alone.depth[middle] - 2.0).abs() < 1e-6);
        assert!(corner == f32::INFINITY || (corner - 2.0).abs() < 1e-6);
        let both = join(&[&far, &near]);
        let expected = draw(&both, &camera, Settings { precision, ..F64 });
        let (w0, w1) = (0.4, 0.6 * 0.9);
        assert!((f64::from(expected.depth[middle]) - (w0 * 2.0 + w1 * 6.0) / (w0 + w1)).abs() < 1e-2);
        let median = draw(&both, &camera, Settings { precision, depth: DepthMode::Median, ..F64 });
        assert_eq!(median.depth[middle], 6.0);
        let none = draw(&near, &camera, Settings { precision, depth: DepthMode::Median, ..F64 });
        assert_eq!(none.depth[middle], f32::INFINITY);
    }
}

#[test]
fn compensation_keeps_the_energy_of_small_splats() {
    // A splat far smaller than the filter: its integral over the image is visible, not its peak.
    let splats = one([0.0, 0.0, 4.0], [0.01; 3], 1.0, [1.0; 3]);
    let camera = camera(64, 64, 40.0);
    let sum = |compensate: bool| {
        let seen = draw(&splats, &camera, Settings { compensate, alpha_cut: 1e-9, ..F64 });
        seen.rgba.as_chunks::<4>().0.iter().map(|p| f64::from(p[3])).sum::<f64>()
    };
    let sigma = camera.fx * 0.01 / 4.0;
    let energy = std::f64::consts::TAU * sigma * sigma;
    assert!((sum(true) / energy - 1.0).abs() < 0.02, "{} against {energy}", sum(true));
    assert!(sum(false) > 1.5 * energy);
}
