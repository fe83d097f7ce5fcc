//! Loaders on real files.

use engine::{Context, InputFile, Kind, Scene, Up};
use nodes::io::{exr, hdr};
use nodes::load_environment::{self, LoadEnvironment};

use super::data;

fn cx() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0 }, data("."))
}

fn environment(path: &str) -> (std::sync::Arc<nodes::types::Environment>, engine::Notes) {
    let p = LoadEnvironment { path: InputFile(path.into()), rotation_deg: 0.0, scale: 1.0 };
    let (out, notes) = LoadEnvironment::run(&p, load_environment::In {}, &cx()).unwrap();
    (out.env, notes)
}

// README of bench-case: the brightest pixel, +Y in the middle, x to the right, +Z on top.
#[test]
fn sun_of_the_bench_case_is_where_it_should_be() {
    let (env, notes) = environment("bench-case/probe/truth_equirect.exr");
    assert_eq!((env.image.width, env.image.height), (768, 384));
    assert_eq!(notes.iter().count(), 0);
    let sum = |p: &[f32]| p.iter().sum::<f32>();
    let pixels = env.image.samples.chunks_exact(3).enumerate();
    let (at, _) = pixels.max_by(|a, b| sum(a.1).total_cmp(&sum(b.1))).unwrap();
    let (x, y) = ((at % 768) as i64, (at / 768) as i64);
    assert!((x - 272).abs() <= 1 && (y - 80).abs() <= 1, "({x}, {y})");
}

// README of hdri: mean and largest luminance, to the digits printed there.
#[test]
fn radiance_files_match_their_statistics() {
    for (name, mean, max) in [
        ("rooitou_park", 0.756, 64890.0),
        ("royal_esplanade", 0.790, 40964.0),
        ("studio_small_03", 2.219, 3352.0),
        ("st_fagans_interior", 0.826, 1111.0),
        ("kiara_1_dawn", 0.839, 46.0),
    ] {
        let (env, _) = environment(&format!("hdri/{name}_1k.hdr"));
        let (mut sum, mut largest) = (0.0_f64, 0.0_f64);
        for y in 0..512 {
            let weight = nodes::equirect::pixel_solid_angle(1024, 512, y) / (4.0 * std::f64::consts::PI);
            for x in 0..1024 {
                let l = f64::from(nodes::color::luminance(env.image.rgb(x, y)));
                sum += l * weight;
                largest = largest.max(l);
            }
        }
        assert!((sum - mean).abs() < 6e-4, "{name}: mean {sum}");
        // Their luminance weights differ from ours in the fifth digit; the small ones are printed rounded.
        assert!((largest - max).abs() < max * 1e-4 + 0.5, "{name}: largest {largest}");
    }
}

// The environments of render-refs were made from the same files by another program.
#[test]
fn radiance_decodes_as_other_programs_do() {
    let radiance = hdr::read("a", &std::fs::read(data("hdri/rooitou_park_1k.hdr")).unwrap()).unwrap();
    let planes = exr::read("b", &std::fs::read(data("render-refs/sunny_plane/env.exr")).unwrap()).unwrap();
    let largest = |v: &[f32]| v.iter().copied().fold(0.0_f32, f32::max);
    let reference = largest(planes.find("R").unwrap());
    let red: Vec<f32> = radiance.rgb.iter().copied().step_by(3).collect();
    println!("{}x{} {} {}", planes.width, planes.height, largest(&red), reference);
    assert_eq!(largest(&red), reference);
}
