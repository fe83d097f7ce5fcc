//! Splat rendering against the float64 references.

use std::sync::Arc;

use engine::{Context, InputFile, Kind, Scene, Up};
use fearless_simd::Level;
use glam::{DMat3, DMat4, DVec3};
use nodes::kinds::load_splats::{self, LoadSplats};
use nodes::render::splat::{
    Blocks, Bounds, PanoramaCamera, Precision, Rendered, Settings, panorama, render, render_at, render_with,
};
use nodes::types::{Camera, Splats};

use super::data;

fn context() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive: false }, data(""))
}

pub fn load(path: &str, more: &[&str]) -> Arc<Splats> {
    let file = |path: &str| InputFile(path.to_owned());
    let params = LoadSplats {
        path: file(path),
        more: more.iter().map(|path| file(path)).collect(),
        strict: true,
        max_extent: 1e6,
        frame: load_splats::Frame::ByFormat,
    };
    LoadSplats::run(&params, load_splats::In {}, &context()).unwrap().0.splats
}

/// The samples of a little-endian float32 `.npy` file.
fn npy(path: &str) -> Vec<f32> {
    let bytes = std::fs::read(data(path)).unwrap();
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    assert!(std::str::from_utf8(&bytes[10..header]).unwrap().contains("'<f4'"));
    bytes[header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

struct Reference {
    name: String,
    camera: Camera,
    blended: u64,
}

fn references() -> Vec<Reference> {
    let text = std::fs::read(data("splat-refs/refs.json")).unwrap();
    let all: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let views = all.as_array().unwrap().iter().map(|view| {
        let camera = &view["camera"];
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let vector =
            |value: &serde_json::Value| DVec3::new(number(&value[0]), number(&value[1]), number(&value[2]));
        let rows = [0, 1, 2].map(|i| vector(&camera["R_w2c"][i]));
        let world_from_camera = DMat3::from_cols(rows[0], rows[1], rows[2]);
        let eye = -(world_from_camera * vector(&camera["t_w2c"]));
        Reference {
            name: view["name"].as_str().unwrap().to_owned(),
            camera: Camera {
                name: "view".to_owned(),
                width_px: camera["width"].as_u64().unwrap() as u32,
                height_px: camera["height"].as_u64().unwrap() as u32,
                fx: number(&camera["fx"]),
                fy: number(&camera["fy"]),
                cx: number(&camera["cx"]),
                cy: number(&camera["cy"]),
                world_from_camera: DMat4::from_cols(
                    world_from_camera.x_axis.extend(0.0),
                    world_from_camera.y_axis.extend(0.0),
                    world_from_camera.z_axis.extend(0.0),
                    eye.extend(1.0),
                )
                .to_cols_array(),
            },
            blended: view["stats"]["blended"].as_u64().unwrap(),
        }
    });
    views.collect()
}

/// (PSNR in dB with peak 1, largest deviation) of the colours.
fn against(seen: &Rendered, reference: &[f32]) -> (f64, f64) {
    let (mut squares, mut largest) = (0.0_f64, 0.0_f64);
    let colours = seen.rgba.as_chunks::<4>().0;
    for (pixel, expected) in colours.iter().zip(reference.as_chunks::<3>().0) {
        for c in 0..3 {
            let deviation = (f64::from(pixel[c]) - f64::from(expected[c])).abs();
            squares += deviation * deviation;
            largest = largest.max(deviation);
        }
    }
    assert_eq!(colours.len() * 3, reference.len());
    (-10.0 * nodes::math::num::f64::log10(squares / reference.len() as f64), largest)
}

// The bounds are those of `notes/splats.md`, section 4: rounding of the positions to f32 in a SOG file's decoding,
// and pairs that fall on the other side of the alpha cut, cause the rest.
#[test]
fn references_are_met() {
    let garden = load("splats/garden_sog/2_0/meta.json", &["splats/garden_sog/2_1/meta.json"]);
    let playbot = load("splats/playbot_sog/2_0/meta.json", &[]);
    assert_eq!((garden.len(), playbot.len(), playbot.sh_degree), (843_068, 125_000, 2));
    let cx = context();
    for view in references() {
        let scene = if view.name.starts_with("garden") { &garden } else { &playbot };
        let rgb = npy(&format!("splat-refs/{}.rgb.npy", view.name));
        let alpha = npy(&format!("splat-refs/{}.alpha.npy", view.name));
        let depth = npy(&format!("splat-refs/{}.depth.npy", view.name));
        for (bounds, precision, bar) in [
            (Bounds::Inria, Precision::F64, 120.0),
            (Bounds::Inria, Precision::F32, 90.0),
            (Bounds::Exact, Precision::F32, 60.0),
        ] {
            let settings = Settings { bounds, precision, ..Settings::default() };
            let seen = render(scene, &view.camera, None, &settings, &cx).unwrap();
            let (psnr, largest) = against(&seen, &rgb);
            let work = seen.work;
            println!("{} {bounds:?} {precision:?}: {psnr:.1} dB, largest {largest:.2e}, {work:?}", view.name);
            assert!(psnr >= bar, "{} {bounds:?} {precision:?}: {psnr:.1} dB, bar {bar}", view.name);
            if precision == Precision::F64 {
                // Scales, rotations and opacities stay f32: a pair or two falls across the cut.
                assert!(work.blends.abs_diff(view.blended) < 20, "{} blends, {}", work.blends, view.blended);
                // In the mean, since such a pair moves its pixel by up to 1/255.
                let (mut off_alpha, mut off_depth) = (0.0, 0.0);
                for (i, (a, sum)) in alpha.iter().zip(&depth).enumerate() {
                    off_alpha += f64::from((seen.rgba[i * 4 + 3] - a).abs());
                    if *a > 1e-3 {
                        off_depth += f64::from((seen.depth[i] * a - sum).abs() / sum);
                    }
                }
                let n = alpha.len() as f64;
                println!("mean deviation of alpha {:.1e}, of depth {:.1e}", off_alpha / n, off_depth / n);
                assert!(off_alpha / n < 1e-6 && off_depth / n < 1e-6);
            }
        }
    }
}

// One view of 843 thousand splats, 97 % of them tied in depth: the same bytes for any number of threads
// and on every instruction set of this machine.
#[test]
fn threads_and_instruction_sets_give_the_same_bytes() {
    let garden = load("splats/garden_sog/2_0/meta.json", &["splats/garden_sog/2_1/meta.json"]);
    let view = references().into_iter().find(|view| view.name == "garden_A").unwrap();
    let cx = context();
    let draw = |threads: usize, level: Level| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let seen = pool
            .install(|| render_at(&garden, &view.camera, None, &Settings::default(), &cx, (level, &|| 0.0)))
            .unwrap();
        (seen.rgba.iter().chain(&seen.depth).map(|v| v.to_bits()).collect::<Vec<_>>(), seen.work)
    };
    let best = Level::new();
    let expected = draw(1, best);
    assert!(draw(2, best) == expected && draw(5, best) == expected);
    let mut levels = vec![Level::baseline()];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_sse2().map(Level::Sse2));
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_avx512().map(Level::Avx512));
    }
    for level in levels {
        assert!(draw(2, level) == expected, "{level:?}");
    }
}

// All 843 thousand splats around a point: f32 equals f64 but for pairs at the cut, and the number of threads has no
// effect.
#[test]
fn panoramas_of_a_capture_are_exact() {
    let garden = load("splats/garden_sog/2_0/meta.json", &["splats/garden_sog/2_1/meta.json"]);
    let cx = context();
    let draw = |threads: usize, precision: Precision| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let settings = Settings { precision, ..Settings::default() };
        let around = PanoramaCamera { eye: DVec3::new(4.02, -31.3, 0.2), up: Up::PlusZ, width_px: 512 };
        pool.install(|| panorama(&garden, &around, None, &settings, &cx)).unwrap()
    };
    let fast = draw(2, Precision::F32);
    let again = draw(1, Precision::F32);
    assert!(fast.rgba == again.rgba && fast.depth == again.depth && fast.work == again.work);
    let truth = draw(2, Precision::F64);
    let rgb: Vec<f32> = truth.rgba.as_chunks::<4>().0.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    let (psnr, largest) = against(&fast, &rgb);
    println!("panorama, F32 against F64: {psnr:.1} dB, largest {largest:.1e}, {:?}", fast.work);
    // As for cameras: 90 dB against the same constants in f64.
    assert!(psnr >= 90.0, "{psnr:.1} dB");
}

// Captures are stored along a curve through space, so blocks of them are small: around a point most are skipped,
// and no bit changes.
#[test]
fn what_no_view_shows_is_not_looked_at() {
    let garden = load("splats/garden_sog/2_0/meta.json", &["splats/garden_sog/2_1/meta.json"]);
    let (view, cx) = (references().remove(0), context());
    let blocks = Blocks::of(&garden, &cx).unwrap();
    let mut skipped = 0;
    for turn in [0.0, 1.3, 2.6, 3.9, 5.2] {
        let placed = DMat4::from_cols_array(&view.camera.world_from_camera) * DMat4::from_rotation_y(turn);
        let camera = Camera { world_from_camera: placed.to_cols_array(), ..view.camera.clone() };
        let draw = |blocks| render_with(&garden, blocks, &camera, None, &Settings::default(), &cx).unwrap();
        let (with, without) = (draw(Some(&blocks)), draw(None));
        assert!(with.rgba == without.rgba && with.depth == without.depth);
        assert_eq!(with.work.skipped + with.work.visited, garden.len() as u64);
        skipped += with.work.skipped;
    }
    assert!(skipped * 2 > 5 * garden.len() as u64, "{skipped}");
}

#[test]
fn inria_files_are_read() {
    for (path, count, degree) in [
        ("splats/train-1000.inria.ply", 1000, 3),
        ("splats/sh3-7k.inria.ply", 9080, 3),
        ("bench-case/point_cloud.ply", 53_408, 3),
    ] {
        let splats = load(path, &[]);
        assert_eq!((splats.len(), splats.sh_degree), (count, degree), "{path}");
        for quat in &splats.quats {
            let length: f32 = quat.iter().map(|q| q * q).sum();
            assert!((length - 1.0).abs() < 1e-5);
        }
        assert!(splats.opacities.iter().all(|o| (0.0..=1.0).contains(o)));
    }
}

// The bench case's README gives 23.4 / 24.4 / 31.0 dB for its own splatter against the true background:
// a wrong axis, activation or colour convention would lose more than the half decibel allowed here.
#[test]
fn the_bench_case_looks_as_its_splatter_says() {
    let splats = load("bench-case/point_cloud.ply", &[]);
    let case: serde_json::Value =
        serde_json::from_slice(&std::fs::read(data("bench-case/case.json")).unwrap()).unwrap();
    for (i, bar) in [23.4, 24.4, 31.0].into_iter().enumerate() {
        let view = &case["views"][i];
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let m: Vec<f64> = (0..16).map(|k| number(&view["c2w_opencv"][k % 4][k / 4])).collect();
        let camera = Camera {
            name: format!("view_{i}"),
            width_px: number(&view["w"]) as u32,
            height_px: number(&view["h"]) as u32,
            fx: number(&view["fx"]),
            fy: number(&view["fy"]),
            cx: number(&view["cx"]),
            cy: number(&view["cy"]),
            world_from_camera: m.try_into().unwrap(),
        };
        let seen = render(&splats, &camera, None, &Settings::default(), &context()).unwrap();
        let file = std::fs::File::open(data(&format!("bench-case/gt/view_{i}_without.png"))).unwrap();
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
        let mut truth = vec![0; reader.output_buffer_size().unwrap()];
        let channels = reader.next_frame(&mut truth).unwrap().color_type.samples();
        let mut squares = 0.0;
        for (pixel, expected) in seen.rgba.as_chunks::<4>().0.iter().zip(truth.chunks_exact(channels)) {
            for c in 0..3 {
                let off = f64::from(pixel[c].clamp(0.0, 1.0)) - f64::from(expected[c]) / 255.0;
                squares += off * off / (truth.len() / channels * 3) as f64;
            }
        }
        let psnr = -10.0 * nodes::math::num::f64::log10(squares);
        println!("view {i}: {psnr:.2} dB, README {bar}");
        assert!(psnr > bar - 0.5, "view {i}: {psnr:.2} dB");
    }
}
