//! Tests with small files of every format, written byte by byte, and with damaged versions of them.

mod build;
mod foreign;
mod hostile;
mod inria;
mod other_tools;
mod placed;
mod usd;

use std::io::{Read, Write};

use engine::{Context, InputFile, NodeError, Note, Notes, SourceRoot};

use super::*;
use crate::types::{SplatEncoding, Splats};
use build::{Packed, PlyRow};
use engine::Up;
use glam::DVec3;
use testing::{context, row};

fn read(bytes: &[u8]) -> Result<(Splats, Notes), NodeError> {
    from_bytes("a", bytes, Frame::ByFormat, &context())
}

fn counts(notes: &Notes) -> Vec<(String, String)> {
    let dropped = notes.iter().filter(|note| note.level == engine::Level::Count);
    dropped.map(|Note { id, text, .. }| (id.clone(), text.split(' ').next().unwrap().to_owned())).collect()
}

fn near(a: &[f32], b: &[f32], bar: f32) {
    assert_eq!(a.len(), b.len());
    for (x, y) in a.iter().zip(b) {
        assert!((x - y).abs() <= bar, "{a:?} {b:?}");
    }
}

#[test]
fn zero_quaternions_are_dropped_and_counted() {
    let mut rows = vec![PlyRow::default(); 5];
    rows[1].rotation = [0.0; 4];
    rows[4].rotation = [0.0; 4];
    let (splats, notes) = read(&build::ply(&rows, 0)).unwrap();
    assert_eq!(counts(&notes), [("zero-quaternion".to_owned(), "2".to_owned())]);
    let (others, _) = read(&build::ply(&[rows[0].clone(), rows[2].clone(), rows[3].clone()], 0)).unwrap();
    assert_eq!(splats, others);
}

#[test]
fn quaternions_of_any_length_become_units() {
    let rows = [1e-20, 1e20, 3e38, 1e-44].map(|length| PlyRow {
        rotation: [0.5 * length, -0.5 * length, 0.5 * length, 0.5 * length],
        ..PlyRow::default()
    });
    let (splats, _) = read(&build::ply(&rows, 0)).unwrap();
    assert_eq!(splats.len(), 4);
    for quat in splats.quats {
        let off = quat.iter().zip([0.5, -0.5, 0.5, 0.5]).map(|(a, b)| f64::from((a - b).abs()));
        row(2, "component off that of the unit", off.fold(0.0, f64::max), 1e-7);
    }
    // All components may be negative.
    let (splats, _) =
        read(&build::ply(&[PlyRow { rotation: [-2.0, 0.0, -2.0, 0.0], ..PlyRow::default() }], 0)).unwrap();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    near(&splats.quats[0], &[-half, 0.0, -half, 0.0], 1e-7);
}

/// A row with a non-finite value in any field is dropped or, with `strict`, named in an error.
#[test]
fn what_is_not_finite_is_dropped_or_named() {
    let fields = build::ply(&[PlyRow::default()], 3).len() - build::ply(&[], 3).len();
    for field in 0..fields / 4 {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut bytes = build::ply(&vec![PlyRow::default(); 3], 3);
            let at = bytes.len() - 2 * fields + field * 4;
            bytes[at..at + 4].copy_from_slice(&bad.to_le_bytes());
            let (splats, notes) = read(&bytes).unwrap();
            // Normals are not used. The rest has 45 fields; then an infinite opacity is 1 or 0, and a scale of -inf
            // is a thickness of 0.
            let opacity = field == 9 + 45 && bad.is_infinite();
            let thin = (55..58).contains(&field) && bad == f32::NEG_INFINITY;
            let kept = if (3..6).contains(&field) || opacity || thin { 3 } else { 2 };
            assert_eq!(splats.len(), kept, "field {field} {bad}");
            assert_eq!(counts(&notes).len(), 3 - kept);
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let mut rows = vec![PlyRow::default(); 40_000];
    rows[33_333].opacity = f32::NAN;
    std::fs::write(folder.path().join("a.ply"), build::ply(&rows, 0)).unwrap();
    let cx = Context::detached(
        engine::Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false },
        folder.path(),
    );
    let mut params = SplatFiles {
        path: InputFile("a.ply".into()),
        more: Vec::new(),
        strict: true,
        max_extent: 1e6,
        level: 0,
        frame: Frame::ByFormat,
        matrix: None,
    };
    let error = params.splats(&cx).err().unwrap();
    assert!(error.message().contains("splat 33333 "), "{error}");
    params.strict = false;
    assert_eq!(params.splats(&cx).unwrap().0.len(), 39_999);
}

/// A splat with a scale above `max_extent`, 1e6, is dropped and counted; a slightly smaller scale is kept.
#[test]
fn scales_that_overflow_are_dropped_and_counted() {
    let row = |scale: f32| PlyRow { scale: [-1.0, scale, -1.0], ..PlyRow::default() };
    let (splats, notes) = read(&build::ply(&[88.0, 200.0, 1e30, 13.8].map(row), 0)).unwrap();
    assert_eq!(counts(&notes), [("too-large".to_owned(), "3".to_owned())]);
    assert!(notes.iter().any(|note| note.id == "many-dropped"));
    assert!((splats.scales[0][1] / 984_609.1 - 1.0).abs() < 1e-6);
}

#[test]
fn scales_far_below_a_pixel_are_kept() {
    let row = PlyRow { scale: [-40.0; 3], ..PlyRow::default() };
    let (splats, notes) = read(&build::ply(&[row], 0)).unwrap();
    assert_eq!(notes.iter().count(), 0);
    for scale in splats.scales[0] {
        assert!((f64::from(scale) / 1.0_f64.exp_ref().powi_ref(-40) - 1.0).abs() < 1e-6, "{scale}");
    }
}

#[test]
fn logits_at_both_ends_are_1_and_0() {
    let row = |opacity: f32| PlyRow { opacity, ..PlyRow::default() };
    let (splats, _) = read(&build::ply(&[0.0, 1000.0, -1000.0, f32::MAX, f32::MIN].map(row), 0)).unwrap();
    assert_eq!(splats.opacities, [0.5, 1.0, 0.0, 1.0, 0.0]);
}

#[test]
fn wrong_headers_are_reported_with_numbers() {
    let bytes = build::ply(&vec![PlyRow::default(); 3], 0);
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let promise = |n: &str| {
        let at = text.find("vertex 3").unwrap() + 7;
        [&bytes[..at], n.as_bytes(), &bytes[at + 1..]].concat()
    };
    for n in ["4", "4294967296", "18446744073709551615", "9223372036854775808"] {
        let error = read(&promise(n)).err().unwrap();
        assert!(error.message().contains(&format!("promises {n} rows")), "{error}");
        assert!(error.message().contains("the file holds only 3"), "{error}");
    }
    for n in ["-1", "x", "18446744073709551616", "1.5"] {
        assert!(read(&promise(n)).is_err(), "{n}");
    }
    let (none, _) = read(&promise("0")).unwrap();
    assert_eq!(none.len(), 0);
}

#[test]
fn degrees_extra_fields_and_filters() {
    for degree in 0..=4 {
        let rest = (0..sh_rest(degree) * 3).map(|i| i as f32 / 64.0).collect();
        let row = PlyRow { rest, ..PlyRow::default() };
        let (splats, _) = read(&build::ply(&[row.clone(), row], degree)).unwrap();
        assert_eq!((splats.sh_degree, splats.sh.len()), (degree, 2 * (sh_rest(degree) + 1)));
        // Channel by channel in the file, triple by triple here.
        for i in 0..sh_rest(degree) {
            let each = sh_rest(degree);
            assert_eq!(splats.sh[1 + i], [0, 1, 2].map(|c| (c * each + i) as f32 / 64.0));
        }
    }
    let row = PlyRow { scale: [0.0, -1.0, -2.0], opacity: 0.4, ..PlyRow::default() };
    let extra = [("base_occupancy_0", 7.0), ("filter_3D", 0.25), ("label", f32::NAN)];
    let (splats, notes) = read(&build::ply_with(&[row], 0, &extra)).unwrap();
    let sizes = [1.0, (-1.0_f64).exp_ref(), (-2.0_f64).exp_ref()];
    let wide = sizes.map(|s| (s * s + 0.0625).sqrt());
    near(&splats.scales[0], &wide.map(|s| s as f32), 1e-7);
    let kept: f64 = sizes.iter().zip(wide).map(|(s, w)| s / w).product();
    near(&splats.opacities, &[(kept / (1.0 + (-0.4_f32 as f64).exp_ref())) as f32], 1e-7);
    let ids: Vec<&str> = notes.iter().map(|note| note.id.as_str()).collect();
    assert_eq!(ids, ["filter-3d", "fields-passed-over"]);
    let (none, notes) = read(&build::ply_with(&[PlyRow::default()], 0, &[("filter_3D", -0.25)])).unwrap();
    assert!(none.is_empty() && counts(&notes)[0].0 == "negative-scale");
}

trait ExpRef {
    fn exp_ref(self) -> f64;
    fn powi_ref(self, n: i32) -> f64;
}
impl ExpRef for f64 {
    /// The series of e^x with 40 terms: an independent reference.
    fn exp_ref(self) -> f64 {
        (1..40)
            .fold((1.0, 1.0), |(sum, term), n| (sum + term * self / f64::from(n), term * self / f64::from(n)))
            .0
    }
    fn powi_ref(self, n: i32) -> f64 {
        let power = (0..n.unsigned_abs()).fold(1.0, |power, _| power * self);
        if n < 0 { 1.0 / power } else { power }
    }
}

#[test]
fn compressed_ply_is_unpacked() {
    let packed = Packed {
        position: 2047 << 21 | 511 << 11,
        rotation: 2 << 30 | 1023 << 20 | 512 << 10,
        scale: 0x7ff,
        colour: 0xff80_0033,
        rest: vec![0, 255, 127, 128, 1, 254, 100, 200, 64],
    };
    let (splats, _) = read(&build::compressed_ply(&vec![packed; 257], 1)).unwrap();
    assert_eq!((splats.len(), splats.sh_degree), (257, 1));
    // The second chunk lies 10 further on.
    let low = splats.means_low[256];
    near(&splats.means[0], &[2.0, -1.0 + 3.0 * 511.0 / 1023.0, -1.0], 1e-6);
    near(&splats.means[256], &[12.0, 9.0 + 3.0 * 511.0 / 1023.0, 9.0], 1e-5);
    assert!(low.iter().all(|v| v.abs() < 1e-6));
    near(&splats.scales[0], &[(-6.0_f64).exp_ref() as f32, (-6.0_f64).exp_ref() as f32, 1.0], 1e-6);
    near(&splats.opacities[..1], &[0.2], 1e-7);
    let half = std::f32::consts::SQRT_2;
    let (a, b, c) = (half / 2.0, (512.0 / 1023.0 - 0.5) * half, -half / 2.0);
    let left = (1.0 - a * a - b * b - c * c).max(0.0).sqrt();
    let length = (a * a + b * b + c * c + left * left).sqrt();
    near(&splats.quats[0], &[a, b, left, c].map(|q| q / length), 1e-6);
    // Colours between -0.5 and 1.5.
    let c0 = 0.282_094_8;
    near(&splats.sh[0], &[1.0 / c0, (-0.5 + 2.0 * 128.0 / 255.0 - 0.5) / c0, -1.0 / c0], 1e-5);
    let n = |byte: f32| {
        (match byte {
            0.0 => 0.0,
            255.0 => 1.0,
            b => (b + 0.5) / 256.0,
        } - 0.5)
            * 8.0
    };
    near(&splats.sh[1], &[n(0.0), n(128.0), n(100.0)], 1e-6);
    near(&splats.sh[3], &[n(127.0), n(254.0), n(64.0)], 1e-6);
}

#[test]
fn splat_rows_are_read() {
    let (splats, _) = read(&build::splat(3)).unwrap();
    assert_eq!((splats.len(), splats.sh_degree), (3, 0));
    near(&splats.means[2], &[2.0, -2.0, 4.0], 0.0);
    near(&splats.scales[2], &[0.5, 0.25, 0.0], 0.0);
    near(&splats.opacities, &[51.0 / 255.0; 3], 1e-7);
    // Bytes 192, 64, 192, 64: half, minus a half, ..
    near(&splats.quats[0], &[0.5, -0.5, 0.5, -0.5], 1e-7);
    near(&splats.sh[0], &[0.5 / 0.282_094_8, -0.5 / 0.282_094_8, (128.0 / 255.0 - 0.5) / 0.282_094_8], 1e-5);
    // A negative size and a zero quaternion among good rows.
    let mut bytes = build::splat(8);
    bytes[12..16].copy_from_slice(&(-1.0_f32).to_le_bytes());
    bytes[32 + 28..64].copy_from_slice(&[128; 4]);
    let (splats, notes) = read(&bytes).unwrap();
    assert_eq!(splats.len(), 6);
    let ids = counts(&notes).into_iter().map(|(id, _)| id).collect::<Vec<_>>();
    assert_eq!(ids, ["zero-quaternion", "negative-scale"]);
}

#[test]
fn ksplat_of_every_level_is_the_same_scene() {
    let mut scenes = Vec::new();
    for level in 0..3 {
        let (splats, _) = read(&build::ksplat(level, 2)).unwrap();
        assert_eq!((splats.len(), splats.sh_degree), (5, 2));
        scenes.push(splats);
    }
    for (level, scene) in scenes.iter().enumerate() {
        for i in 0..5 {
            let v = i as f32;
            // 16 bits over buckets of 4 units: steps of 1/16384.
            near(&scene.means[i], &[v * 0.25, 1.0 - v, -v], if level == 0 { 0.0 } else { 1e-4 });
            near(&scene.scales[i], &[0.5, 0.25, 0.125], 0.0);
            near(&scene.quats[i], &[0.5, -0.5, 0.5, 0.5], 1e-7);
            near(&[scene.opacities[i]], &[102.0 / 255.0], 1e-7);
            for (j, triple) in scene.sh[i * 9 + 1..(i + 1) * 9].iter().enumerate() {
                let expected = [0, 1, 2].map(|c| build::harmonic(j, c));
                near(triple, &expected, if level == 2 { 2.0 / 255.0 * 0.51 } else { 1e-7 });
            }
        }
    }
}

#[test]
fn spz_of_every_version_is_the_same_scene() {
    let mut scenes = Vec::new();
    for version in 1..=4 {
        let bytes = build::spz(version, 1);
        let up = Frame::AsStored;
        let (splats, notes) = from_bytes("a", &bytes, up, &context()).unwrap();
        assert_eq!((splats.len(), splats.sh_degree, splats.antialiased), (3, 1, true));
        assert_eq!(notes.iter().any(|note| note.id == "coarse-rotations"), version <= 2);
        scenes.push(splats);
    }
    for (version, scene) in (1..).zip(&scenes) {
        near(&scene.means[1], &[1.5, -2.25, 0.125], 0.0);
        near(&scene.means[2], &[3.0, -4.5, 0.25], 0.0);
        near(&scene.scales[0], &[(-1.0_f64).exp_ref() as f32, 1.0, (-2.5_f64).exp_ref() as f32], 1e-6);
        near(&scene.opacities, &[0.0, 51.0 / 255.0, 1.0], 1e-7);
        // Half a step of 1/127.5, or of sqrt(1/2)/511.
        let bar = if version <= 2 { 0.008 } else { 0.0011 };
        near(&scene.quats[0], &[0.8, 0.0, 0.36, -0.48], bar);
        near(
            &scene.sh[0],
            &[0.0, 0.5 / 0.15, -0.5 / 0.15].map(|v| v + if v == 0.0 { 0.5 / 255.0 / 0.15 } else { 0.0 }),
            1e-5,
        );
        near(&scene.sh[1], &[-1.0, 0.0, 0.5], 0.0);
    }
    // From version 3 on only the packing differs.
    assert_eq!(scenes[2], scenes[3]);
    assert_eq!(scenes[0].means, scenes[3].means);
}

#[test]
fn sog_versions_and_wrappings_agree() {
    let folder = tempfile::tempdir().unwrap();
    for (name, version) in [("two", 2), ("one", 1)] {
        let chunk = folder.path().join(name);
        std::fs::create_dir(&chunk).unwrap();
        for (file, bytes) in build::sog(version) {
            std::fs::write(chunk.join(file), bytes).unwrap();
        }
    }
    std::fs::write(folder.path().join("three.sog"), build::zip("inner/", &build::sog(2), false)).unwrap();
    std::fs::write(folder.path().join("zour.sog"), build::zip("", &build::sog(2), true)).unwrap();
    std::fs::write(folder.path().join("readme.txt"), "no splats").unwrap();
    let cx = Context::detached(
        engine::Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false },
        folder.path(),
    );
    let root = SourceRoot::new(folder.path());
    let load = |path: &str| {
        let params = SplatFiles {
            path: InputFile(path.to_owned()),
            more: Vec::new(),
            strict: true,
            max_extent: 1e6,
            level: 0,
            frame: Frame::ByFormat,
            matrix: None,
        };
        let sources = params.sources(&root).unwrap();
        (params.splats(&cx).unwrap().0, sources)
    };
    let (two, sources) = load("two/meta.json");
    assert_eq!(sources.len(), 8);
    assert!(sources.iter().all(|source| source.path.is_file() && source.name.starts_with("two/")));
    near(&two.means[3], &[19.0, -0.5, 0.0], 1e-3);
    near(&two.opacities[3..4], &[1.0], 1e-6);
    assert_eq!(two.sh_degree, 1);
    for (path, count) in [("two", 8), ("three.sog", 1), ("zour.sog", 1)] {
        let (other, sources) = load(path);
        assert_eq!((&other, sources.len()), (&two, count), "{path}");
    }
    let (one, _) = load("one");
    near(one.means.as_flattened(), two.means.as_flattened(), 0.0);
    near(one.scales.as_flattened(), two.scales.as_flattened(), 1e-6);
    near(one.sh.as_flattened(), two.sh.as_flattened(), 1e-6);
    // Version 1 spaces logits evenly, here from -1 to 20.
    near(&one.opacities[1..2], &[(1.0 / (1.0 + (1.0 - 21.0 * 30.0 / 255.0_f64).exp_ref())) as f32], 1e-6);
    // The folder of all: one, three, two, zour.
    let (all, sources) = load(".");
    assert_eq!((all.len(), sources.len()), (4 * two.len(), 8 + 1 + 8 + 1));
    assert_eq!(all.opacities[..one.len()], one.opacities[..]);
}

// For truncated files, the error describes the damage, not an unknown format.
#[test]
fn files_that_were_cut_off_are_reported_as_what_they_were() {
    let reported = |name: &str, bytes: &[u8]| {
        from_bytes(name, bytes, Frame::ByFormat, &context()).err().unwrap().message().to_owned()
    };
    let splat = build::splat(3);
    assert!(reported("a", &splat[..90]).contains("complete splats of 32 bytes: 2; further bytes: 26"));
    assert!(reported("a.splat", &splat[..20]).contains("the file (20 bytes) begins neither like a `.splat`"));
    let mut ksplat = build::ksplat(1, 1);
    // Some writers leave out the number in use and the capacity.
    ksplat[8..16].fill(0);
    assert_eq!(read(&ksplat).unwrap().0.len(), 5);
    assert!(
        reported("a", &ksplat[..30])
            .contains("the header: 4096 bytes at offset 0 are needed, but the file has 30")
    );
    assert!(reported("a", &ksplat[..5000]).contains("the headers of sections"));
    assert!(reported("a", &ksplat[..ksplat.len() - 1]).contains("the splats of a section"));
    assert!(reported("a.ksplat", &ksplat[..16]).contains("begins neither like a `.ksplat`"));
}

#[test]
fn what_follows_the_splats_is_reported() {
    for (name, mut bytes) in [
        ("ply", build::ply(&[PlyRow::default()], 0)),
        ("ksplat", build::ksplat(1, 1)),
        ("spz in gzip", build::spz(3, 1)),
        ("spz 4", build::spz(4, 1)),
    ] {
        let (whole, notes) = read(&bytes).unwrap();
        assert!(notes.iter().all(|note| note.id != "bytes-left-over"), "{name}");
        bytes.extend_from_slice(b"more of it");
        let (splats, notes) = read(&bytes).unwrap();
        let reported = notes.iter().find(|note| note.id == "bytes-left-over").unwrap();
        assert!(splats == whole && reported.text.contains("count: 10"), "{name}: {reported:?}");
    }
    // Inside the gzip stream. An earlier version refused these files, which the reference implementation reads.
    let (whole, _) = read(&build::spz(3, 1)).unwrap();
    let packed = build::spz(3, 1);
    let mut plain = Vec::new();
    flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut plain).unwrap();
    plain.extend_from_slice(b"more of it");
    let mut again = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    again.write_all(&plain).unwrap();
    let (splats, notes) = read(&again.finish().unwrap()).unwrap();
    let reported = notes.iter().find(|note| note.id == "bytes-left-over").unwrap();
    assert!(splats == whole && reported.text.contains("count: 10"), "{reported:?}");
}

#[test]
fn unknown_content_is_refused_in_words() {
    for (bytes, says) in [
        (&b""[..], "empty"),
        (b"\x89PNG\r\n\x1a\n rest of a picture, not a scene", "not in a known splat format"),
        (b"{\"frames\": []}", "neither glTF nor"),
        (b"ply\nformat ascii 1.0\nend_header\n", "no element `vertex`"),
        (b"ply\nformat binary_little_endian 1.0\nelement face 0\nend_header\n", "no element `vertex`"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\nend_header\n",
            "no field",
        ),
        (b"{\"version\": 7, \"means\": {}}", "SOG version 7"),
        (b"{\"asset\": {\"version\": \"2.0\"}}", "is the file a mesh"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty half x\nend_header\n",
            "`half` is not a property type",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\nproperty int x\nend_header\n",
            "two properties named `x`",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nelement vertex 1\nend_header\n",
            "two elements `vertex`",
        ),
        // A mesh is reported as a mesh, in ASCII or binary.
        (
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
              element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
            "a mesh (faces: 1)",
        ),
        (b"NGSP\x05\0\0\0\0\0\0\0\0\0\0\0", "version 5"),
    ] {
        let error = read(bytes).err().unwrap();
        assert!(error.message().contains(says), "{error}");
    }
}

// A chunk that appears or disappears between the listing of the folder and the run.
#[test]
fn chunks_that_come_and_go_while_it_runs_ask_for_another_run() {
    let folder = tempfile::tempdir().unwrap();
    let chunk = build::zip("", &build::sog(2), false);
    let write = |name: &str| std::fs::write(folder.path().join(name), &chunk).unwrap();
    write("one.sog");
    write("two.sog");
    let params = SplatFiles {
        path: InputFile(".".to_owned()),
        more: Vec::new(),
        strict: true,
        max_extent: 1e6,
        level: 0,
        frame: Frame::ByFormat,
        matrix: None,
    };
    let sources = params.sources(&SourceRoot::new(folder.path())).unwrap();
    let scene = engine::Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let cx = Context::detached(scene, folder.path()).having_listed(&sources);
    let error = || params.splats(&cx).err().map(|e| e.to_string()).unwrap_or_default();
    assert_eq!(error(), "");
    write("three.sog");
    assert!(error().contains("three.sog` changed while the graph was running"), "{}", error());
    for name in ["one.sog", "three.sog"] {
        std::fs::remove_file(folder.path().join(name)).unwrap();
    }
    assert!(error().contains("one.sog` changed while the graph was running"), "{}", error());
}
