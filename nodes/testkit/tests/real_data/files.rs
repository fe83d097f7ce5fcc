//! Tests of loaders on real files.

use engine::{InputFile, Kind, Notes, SourceRoot, Up};
use nodes::kinds::load_mesh::ColourEncoding;
use nodes::kinds::load_object::{self, LoadObject};
use scene::io::{exr, hdr};
use scene::types::Object;
use testkit::Data;

use super::data;

// README of bench-case: the brightest pixel, +Y in the middle, x to the right, +Z on top.
#[test]
fn sun_of_the_bench_case_is_where_it_should_be() {
    let (env, notes) = data().environment("bench-case/probe/truth_equirect.exr");
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
        let (env, _) = data().environment(&format!("hdri/{name}_1k.hdr"));
        let (mut sum, mut largest) = (0.0_f64, 0.0_f64);
        for y in 0..512 {
            let weight =
                scene::math::equirect::pixel_solid_angle(1024, 512, y) / (4.0 * std::f64::consts::PI);
            for x in 0..1024 {
                let l = f64::from(scene::math::color::luminance(env.image.rgb(x, y)));
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
    let radiance = hdr::read("a", &data().bytes("hdri/rooitou_park_1k.hdr")).unwrap();
    let planes = exr::read("b", &data().bytes("render-refs/sunny_plane/env.exr")).unwrap();
    let largest = |v: &[f32]| v.iter().copied().fold(0.0_f32, f32::max);
    let reference = largest(planes.find("R").unwrap());
    let red: Vec<f32> = radiance.rgb.iter().copied().step_by(3).collect();
    println!("{}x{} {} {}", planes.width, planes.height, largest(&red), reference);
    assert_eq!(largest(&red), reference);
}

fn triangles(object: &Object) -> usize {
    object.primitives.iter().map(|p| p.triangles.len()).sum()
}

fn ids(notes: &Notes) -> Vec<String> {
    notes.iter().map(|n| format!("{} ({})", n.id, n.text)).collect()
}

// README of gltf: triangles, parts and maps.
#[test]
fn objects_match_their_descriptions() {
    for (path, count, materials, textures) in [
        // Its fifth map is occlusion, which is traced and not read.
        ("gltf/DamagedHelmet.glb", 15452, 1, 4),
        ("gltf/FlightHelmet/FlightHelmet.gltf", 94722, 6, 15),
        ("gltf/Duck.glb", 4212, 1, 1),
        ("gltf/TransmissionRoughnessTest.glb", 77792, 0, 0),
        ("gltf/AlphaBlendModeTest.glb", 61, 0, 0),
        ("gltf/ClearCoatTest.glb", 37116, 19, 0),
        ("bench-case/object.glb", 0, 0, 0),
    ] {
        let start = std::time::Instant::now();
        let (object, notes) = data().object(path);
        println!(
            "{path}: {:.0?}, {} {} {} {:?}",
            start.elapsed(),
            triangles(&object),
            object.materials.len(),
            object.textures.len(),
            ids(&notes)
        );
        let lost: usize = notes
            .iter()
            .filter(|n| n.id == "triangles-dropped")
            .filter_map(|n| n.text.split(' ').next()?.parse::<usize>().ok())
            .sum();
        assert!(count == 0 || triangles(&object) + lost == count, "{path}: {}", triangles(&object));
        assert!(
            materials == 0 || object.materials.len() == materials,
            "{path}: {} materials",
            object.materials.len()
        );
        assert!(
            textures == 0 || object.textures.len() == textures,
            "{path}: {} textures",
            object.textures.len()
        );
        for p in &object.primitives {
            assert!(p.is_consistent());
            let unit = |v: &[f32]| (v.iter().map(|c| c * c).sum::<f32>().sqrt() - 1.0).abs() < 1e-3;
            assert!(p.normals.iter().all(|n| unit(n)), "{path}: normals");
            assert!(p.tangents.iter().all(|t| unit(&t[..3])), "{path}: tangents");
            let mapped = object.materials[p.material as usize].normal.is_some();
            assert!(!mapped || !p.tangents.is_empty(), "{path}: tangents of {}", p.material);
        }
    }
}

// The Duck's node scales by 0.01; the torus of the bench object, turned by its node, rises to 1.05 m.
#[test]
fn node_scales_apply() {
    let height = |path: &str| {
        let (object, _) = data().object(path);
        let y = object.primitives.iter().flat_map(|p| p.positions.iter().map(|v| v[1]));
        y.clone().fold(f32::MIN, f32::max) - y.fold(f32::MAX, f32::min)
    };
    assert!((height("gltf/Duck.glb") - 1.54).abs() < 0.01);
    assert!((height("bench-case/object.glb") - 1.052).abs() < 0.001);
}

#[test]
fn external_files_are_sources() {
    let root = SourceRoot::new(data().path("."));
    let p = LoadObject::of(InputFile("gltf/FlightHelmet/FlightHelmet.gltf".into()));
    let sources = LoadObject::sources(&p, &root).unwrap();
    assert_eq!(sources.len(), 17, "the file, a buffer and 15 pictures");
    assert!(sources.iter().all(|s| s.path.exists() && s.name.starts_with("gltf/FlightHelmet/")));
}

// READMEs of bench-case, render-refs and splats.
#[test]
fn receivers_match_their_descriptions() {
    for (path, vertices, triangles) in [
        ("bench-case/mesh_proxy.ply", 7472, None),
        ("render-refs/sunny_plane/receiver.ply", 81 * 81, Some(12800)),
        ("render-refs/closed_room/receiver.ply", 0, None),
        ("splats/garden_mesh/garden_proxy.glb", 160_401, Some(319_514)),
    ] {
        let start = std::time::Instant::now();
        let (mesh, notes) = data().mesh(path, ColourEncoding::Auto);
        println!(
            "{path}: {:.0?}, {} {} {:?}",
            start.elapsed(),
            mesh.positions.len(),
            mesh.triangles.len(),
            ids(&notes)
        );
        assert!(vertices == 0 || mesh.positions.len() == vertices, "{path}");
        assert!(
            triangles.is_none_or(|t| mesh.triangles.len() <= t && mesh.triangles.len() * 1000 > t * 999),
            "{path}"
        );
        assert_eq!(mesh.colours.len(), mesh.positions.len());
    }
}

// The helmet's file without any change, cut in many places and with flipped bits.
#[test]
fn cut_and_flipped_objects_are_errors_or_objects() {
    let folder = tempfile::tempdir().unwrap();
    let cx = Data::of(folder.path(), Up::PlusZ, 7).context();
    let p = LoadObject::of(InputFile("a.glb".into()));
    let bytes = data().bytes("gltf/Duck.glb");
    let text = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize + 20;
    for step in 0..300 {
        std::fs::write(folder.path().join("a.glb"), &bytes[..bytes.len() * step / 300]).unwrap();
        assert!(LoadObject::run(&p, load_object::In {}, &cx).is_err());
        let mut hurt = bytes.clone();
        // Three in four in the JSON, where every bit counts.
        let at = if step % 4 == 0 { bytes.len() * step / 300 } else { text * step / 300 };
        hurt[at] ^= 1 << (step % 8);
        std::fs::write(folder.path().join("a.glb"), &hurt).unwrap();
        drop(LoadObject::run(&p, load_object::In {}, &cx));
    }
}

// The case file is in lightharmony's own format. Its cube faces are at the probe, and its views look at the object.
#[test]
fn cameras_of_the_bench_case_load() {
    let views = &data().cameras("bench-case/case.json", "views", &[]).cameras;
    assert_eq!(views.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["view_0", "view_1", "view_2"]);
    for camera in views {
        let seen = camera.camera_from_world().transform_point3(glam::DVec3::new(0.4, 0.3, 0.4));
        let (x, y) = (seen.x / seen.z * camera.fx + camera.cx, seen.y / seen.z * camera.fy + camera.cy);
        assert!(
            seen.z > 0.0 && (x - 256.0).abs() < 100.0 && (y - 192.0).abs() < 100.0,
            "{}: {x} {y}",
            camera.name
        );
    }
    let faces = &data().cameras("bench-case/case.json", "cube_faces", &["*"]).cameras;
    assert_eq!(faces.len(), 6);
    assert!(faces.iter().all(|c| (c.eye() - glam::DVec3::new(0.4, 0.3, 0.45)).length() < 1e-6));
    assert_eq!(data().cameras("bench-case/case.json", "capture_views", &["0..100..8"]).cameras.len(), 5);
}

#[test]
fn inria_cameras_load() {
    let views = &data().cameras("splats/arkit-room.cameras.json", "views", &[]).cameras;
    println!("{} cameras, first {:?}", views.len(), views[0]);
    assert!(views.len() > 10);
}
