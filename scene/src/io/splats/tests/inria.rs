//! Tests of INRIA PLY: activation, extremes, fields, several files.

use engine::{InputFile, Scene};

use super::*;

/// A binary little-endian PLY of float rows, whose header declares `promised` rows.
fn ply(fields: &[&str], rows: &[Vec<f32>], promised: u64) -> Vec<u8> {
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {promised}\n");
    for field in fields {
        text.push_str(&format!("property float {field}\n"));
    }
    text.push_str("end_header\n");
    let mut bytes = text.into_bytes();
    for value in rows.iter().flatten() {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes
}

const PLAIN: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

fn good(x: f32) -> Vec<f32> {
    vec![x, 2.0, 3.0, 0.1, 0.2, 0.3, 0.5, -3.0, -2.0, -1.0, 1.0, 0.5, -0.5, 0.25]
}

fn with(mut row: Vec<f32>, field: &str, value: f32) -> Vec<f32> {
    let at = PLAIN.iter().position(|name| *name == field).expect("a field");
    row[at] = value;
    row
}

fn read(bytes: &[u8], strict: bool) -> Result<(Splats, Notes), NodeError> {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("a.ply"), bytes).expect("writes");
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive: false };
    let params = SplatFiles {
        path: InputFile("a.ply".to_owned()),
        more: Vec::new(),
        strict,
        max_extent: 1e6,
        level: 0,
        frame: Frame::ByFormat,
        matrix: None,
    };
    params.splats(&Context::detached(scene, folder.path()))
}

fn counted(notes: &Notes, id: &str) -> Option<String> {
    notes.iter().find(|note| note.id == id).map(|note| note.text.clone())
}

#[test]
fn activates_what_the_optimiser_stores() {
    let (splats, _) = read(&ply(&PLAIN, &[good(1.0)], 1), true).expect("reads");
    assert_eq!(splats.means, [[1.0, 2.0, 3.0]]);
    assert!(splats.means_low.is_empty());
    assert!((splats.opacities[0] - 0.622_459_35).abs() < 1e-6);
    for (scale, expected) in splats.scales[0].iter().zip([0.049_787_07, 0.135_335_28, 0.367_879_44]) {
        assert!((scale - expected).abs() < 1e-7);
    }
    let length = 1.5625_f32.sqrt();
    assert_eq!(splats.quats[0], [1.0, 0.5, -0.5, 0.25].map(|q| q / length));
    assert_eq!((splats.sh_degree, splats.sh.as_slice()), (0, &[[0.1, 0.2, 0.3]][..]));
}

#[test]
fn broken_rows_are_dropped_and_counted_by_reason() {
    let zero = ["rot_0", "rot_1", "rot_2", "rot_3"].iter().fold(good(9.0), |row, name| with(row, name, 0.0));
    let rows = vec![
        good(1.0),
        zero,
        with(good(9.0), "f_dc_1", f32::NAN),
        with(good(9.0), "y", f32::INFINITY),
        with(good(9.0), "scale_1", 88.0),
        with(good(9.0), "scale_1", 200.0),
        with(good(9.0), "scale_2", f32::NAN),
        good(2.0),
    ];
    let bytes = ply(&PLAIN, &rows, 8);
    let (splats, notes) = read(&bytes, false).expect("reads");
    assert_eq!(splats, read(&ply(&PLAIN, &[good(1.0), good(2.0)], 2), true).expect("reads").0);
    assert!(counted(&notes, "zero-quaternion").is_some_and(|text| text.starts_with("1 ")));
    assert!(counted(&notes, "not-finite").is_some_and(|text| text.starts_with("3 ")));
    assert!(counted(&notes, "too-large").is_some_and(|text| text.starts_with("2 ")));
    assert!(counted(&notes, "many-dropped").is_some());
    let stopped = read(&bytes, true).expect_err("strict");
    assert!(stopped.message().contains("splat 1 "), "{stopped}");
}

// Surveyed frames have centres in f64; f32 alone would round them to decimetres.
#[test]
fn centres_in_f64_keep_their_digits() {
    let text =
        "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty double x\nproperty double y\n\
                property double z\n"
            .to_owned()
            + &PLAIN[3..].iter().map(|name| format!("property float {name}\n")).collect::<String>()
            + "end_header\n";
    let mut bytes = text.into_bytes();
    let centre = [4_512_345.123_456_7, 5.0, -1e7 - 0.001];
    centre.iter().for_each(|v: &f64| bytes.extend_from_slice(&v.to_le_bytes()));
    good(1.0)[3..].iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
    let (splats, _) = read(&bytes, true).expect("reads");
    let off = splats.mean(0) - DVec3::from(centre);
    assert!(off.length() < 1e-7, "{off}");
}

#[test]
fn files_of_a_scene_are_appended_at_the_higher_degree() {
    let folder = tempfile::tempdir().expect("a folder");
    let names: Vec<String> = (0..9).map(|i| format!("f_rest_{i}")).collect();
    let mut fields = PLAIN.to_vec();
    fields.extend(names.iter().map(String::as_str));
    let mut row = good(2.0);
    row.extend([7.0; 9]);
    std::fs::write(folder.path().join("a.ply"), ply(&PLAIN, &[good(1.0)], 1)).expect("writes");
    std::fs::write(folder.path().join("b.ply"), ply(&fields, &[row], 1)).expect("writes");
    let file = |name: &str| InputFile(name.to_owned());
    let params = SplatFiles {
        path: file("a.ply"),
        more: vec![file("b.ply")],
        strict: true,
        max_extent: 1e6,
        level: 0,
        frame: Frame::ByFormat,
        matrix: None,
    };
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive: false };
    let cx = Context::detached(scene, folder.path());
    let splats = params.splats(&cx).expect("reads").0;
    assert_eq!((splats.len(), splats.sh_degree, splats.sh.len()), (2, 1, 8));
    assert_eq!(splats.sh[1..4], [[0.0; 3]; 3]);
    assert_eq!(splats.sh[5..8], [[7.0; 3]; 3]);
    let bytes = engine::encode_to_vec(&splats);
    assert_eq!(engine::decode_all::<Splats>(&bytes).expect("decodes"), splats);
}

#[test]
fn sog_meta_of_other_versions_and_wrong_codebooks_are_refused() {
    let says = |text: &str| sog::Meta::read("meta.json", text.as_bytes()).err().expect("refused").to_string();
    assert!(says("{}").contains("missing field"));
    assert!(says("{\"version\": 9}").contains("version 9"));
    assert!(says("{\"version\": 2}").contains("missing field"));
    assert!(says("[").contains("not a SOG"));
}

/// An untrusted scene reads only files in its own folder. This test fails if the check of the names is removed.
#[test]
fn sog_meta_names_only_what_lies_beside_it() {
    let files = build::sog(2);
    let (_, meta) = files.iter().find(|(name, _)| name == "meta.json").expect("is there");
    let meta = String::from_utf8(meta.clone()).expect("is text");
    assert!(sog::Meta::read("meta.json", meta.as_bytes()).is_ok());
    for name in ["/etc/passwd", "../quats.webp", "a/../../b.webp"] {
        let text = meta.replace("quats.webp", name);
        assert_ne!(text, meta);
        let error = sog::Meta::read("meta.json", text.as_bytes()).err().expect("refused").to_string();
        assert!(error.contains(&format!("`{name}`")), "{error}");
    }
}
