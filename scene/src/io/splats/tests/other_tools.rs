//! Tests with files as other tools write them: encodings of PLY, infinities, flat splats, display colours, comments
//! of trainers, levels of streamed scenes.

use super::*;

const FIELDS: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// A PLY file with one element `vertex`. `encoding` is the format in the header; each of `fields` is a type and a
/// name.
fn table(encoding: &str, comments: &[&str], fields: &[(&str, &str)], rows: &[Vec<f64>]) -> Vec<u8> {
    let mut text = format!("ply\nformat {encoding} 1.0\n");
    comments.iter().for_each(|comment| text.push_str(&format!("comment {comment}\n")));
    text.push_str(&format!("element vertex {}\n", rows.len()));
    fields.iter().for_each(|(scalar, name)| text.push_str(&format!("property {scalar} {name}\n")));
    text.push_str("end_header\n");
    let mut out = text.into_bytes();
    for row in rows {
        if encoding == "ascii" {
            let words: Vec<String> = row.iter().map(|v| format!("{v}")).collect();
            out.extend(format!("{}\n", words.join(" ")).bytes());
            continue;
        }
        for ((scalar, _), value) in fields.iter().zip(row) {
            let mut word = match *scalar {
                "uchar" => vec![*value as u8],
                "ushort" => (*value as u16).to_le_bytes().to_vec(),
                "short" => (*value as i16).to_le_bytes().to_vec(),
                "double" => value.to_le_bytes().to_vec(),
                _ => (*value as f32).to_le_bytes().to_vec(),
            };
            if encoding == "binary_big_endian" {
                word.reverse();
            }
            out.extend(word);
        }
    }
    out
}

fn floats<'a>(names: &[&'a str]) -> Vec<(&'static str, &'a str)> {
    names.iter().map(|name| ("float", *name)).collect()
}

fn good(i: usize) -> Vec<f64> {
    let v = i as f64;
    vec![v, -v * 0.5, 3.0, 0.1, 0.25, -0.5, 0.75, -3.0, -2.5, -1.0, 1.0, 0.5, -0.5, 0.25 * v]
}

fn rows(count: usize) -> Vec<Vec<f64>> {
    (0..count).map(good).collect()
}

const ENCODINGS: [&str; 3] = ["binary_little_endian", "binary_big_endian", "ascii"];

/// The same numbers give the same splats in every encoding. This test fails if `Rows::packed` does not reverse
/// bytes.
#[test]
fn every_encoding_of_ply_is_the_same_scene() {
    let fields = floats(&FIELDS);
    let of = |encoding: &str| table(encoding, &["made here"], &fields, &rows(70));
    let (wanted, _) = read(&of("binary_little_endian")).unwrap();
    assert_eq!(wanted.len(), 70);
    let text = String::from_utf8(of("ascii")).unwrap();
    let marked = [&b"\xef\xbb\xbf"[..], text.as_bytes()].concat();
    for (name, bytes) in [
        ("big", of("binary_big_endian")),
        ("ascii", of("ascii")),
        ("ascii of Windows", text.replace('\n', "\r\n").into_bytes()),
        ("ascii with tabs and doubled blanks", text.replace("0.75 ", "0.75 \t ").into_bytes()),
        ("ascii with a byte-order mark", marked),
        ("ascii without a last line end", text.trim_end().as_bytes().to_vec()),
    ] {
        let (splats, notes) = read(&bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(splats == wanted, "{name}");
        assert_eq!(notes.iter().count(), 0, "{name}");
    }
    // A list that another program added is skipped. Compressed files may be big-endian, too.
    let listed = text.replace("end_header\n", "element extra 2\nproperty list uchar int ids\nend_header\n");
    let (splats, _) = read(format!("{listed}2 7 8\n0\n").as_bytes()).unwrap();
    assert!(splats == wanted);
    let short = text.lines().take(60).collect::<Vec<_>>().join("\n");
    let error = read(short.as_bytes()).err().unwrap();
    assert!(error.message().contains("the file ends early"), "{error}");
    let (_, notes) = read(format!("{text}1 2 3").as_bytes()).unwrap();
    assert!(notes.iter().any(|note| note.id == "bytes-left-over"));
}

#[test]
fn compressed_ply_may_be_big_endian() {
    let packed = Packed { position: 7, rotation: 9 << 28, scale: 5, colour: 0x0102_0304, rest: vec![3; 9] };
    let little = build::compressed_ply(&[packed.clone(), packed], 1);
    let header = crate::io::ply::header("a", &little).unwrap();
    let (head, mut body) = little.split_at(header.body);
    let mut big = String::from_utf8(head.to_vec()).unwrap().replace("little", "big").into_bytes();
    for element in &header.elements {
        for _ in 0..element.rows {
            for property in &element.properties {
                let (word, rest) = body.split_at(property.scalar.size());
                big.extend(word.iter().rev());
                body = rest;
            }
        }
    }
    assert!(read(&big).unwrap().0 == read(&little).unwrap().0);
}

/// Infinite logits and log scales have a meaning; a row with NaN is dropped and counted. This holds for every
/// encoding.
#[test]
fn infinities_are_opaque_absent_or_flat() {
    let row = |at: usize, value: f64| {
        let mut row = good(1);
        row[at] = value;
        row
    };
    let (inf, nan) = (f64::INFINITY, f64::NAN);
    let list = [row(6, inf), row(6, -inf), row(7, -inf), row(9, -inf), row(6, nan), row(8, nan), row(8, inf)];
    for (encoding, scalar) in ENCODINGS.into_iter().flat_map(|e| [(e, "float"), (e, "double")]) {
        let fields: Vec<_> = FIELDS.iter().map(|name| (scalar, *name)).collect();
        let (splats, notes) = read(&table(encoding, &[], &fields, &list)).unwrap();
        assert_eq!(splats.opacities[..2], [1.0, 0.0], "{encoding}");
        assert_eq!((splats.scales[2][0], splats.scales[3][2], splats.len()), (0.0, 0.0, 4));
        let dropped = [("not-finite", "2"), ("too-large", "1")].map(|(id, n)| (id.to_owned(), n.to_owned()));
        assert_eq!(counts(&notes), dropped);
    }
    // As C libraries of Windows print them.
    let text = String::from_utf8(table("ascii", &[], &floats(&FIELDS), &list)).unwrap();
    let windows = text.replace("inf", "1.#INF").replace("NaN", "-nan(ind)");
    assert_ne!(windows, text);
    assert!(read(windows.as_bytes()).unwrap().0 == read(text.as_bytes()).unwrap().0);
    // A filter widens what has no thickness, and takes its opacity.
    let fields = floats(&[&FIELDS[..], &["filter_3D"]].concat());
    let mut flat = row(7, -inf);
    flat.push(0.5);
    let (splats, _) = read(&table(ENCODINGS[0], &[], &fields, &[flat])).unwrap();
    assert_eq!((splats.scales[0][0], splats.opacities[0]), (0.5, 0.0));
}

/// A missing third scale means a thickness of 0. This test fails if `NEG_INFINITY` in `Layout::row` is replaced
/// with 0.
#[test]
fn splats_of_two_scales_are_flat() {
    let names: Vec<&str> = FIELDS.iter().copied().filter(|name| *name != "scale_2").collect();
    let two: Vec<Vec<f64>> = rows(5).into_iter().map(|row| [&row[..9], &row[10..]].concat()).collect();
    let (wanted, _) = read(&build::ply(&[PlyRow::default()], 0)).unwrap();
    assert!(wanted.scales[0][2] > 0.0);
    for encoding in ENCODINGS {
        let (splats, notes) = read(&table(encoding, &[], &floats(&names), &two)).unwrap();
        assert_eq!(splats.len(), 5);
        assert!(splats.scales.iter().all(|s| s[0] > 0.0 && s[1] > 0.0 && s[2] == 0.0));
        assert!(notes.iter().any(|note| note.id == "two-scales"));
    }
    // Isotropic trainings write one scale. An earlier version took such files for meshes.
    let names: Vec<&str> =
        FIELDS.iter().copied().filter(|name| !matches!(*name, "scale_1" | "scale_2")).collect();
    let one: Vec<Vec<f64>> = rows(3).into_iter().map(|row| [&row[..8], &row[10..]].concat()).collect();
    let (splats, notes) = read(&table(ENCODINGS[0], &[], &floats(&names), &one)).unwrap();
    assert!(splats.scales.iter().all(|[x, y, z]| x == y && y == z && *x > 0.0), "{:?}", splats.scales);
    assert!(notes.iter().any(|note| note.id == "one-scale"));
}

/// Display colours of each type replace coefficients.
#[test]
fn colours_as_codes_replace_coefficients() {
    let shown = [[204.0, 0.0, 255.0], [3.0, 2.0, 1.0], [128.0, 64.0, 32.0]];
    for encoding in ENCODINGS {
        for (scalar, white) in
            [("uchar", 255.0), ("ushort", 65_535.0), ("float", 1.0), ("float", 255.0), ("double", 255.0)]
        {
            let mut fields = floats(&FIELDS);
            for (at, name) in ["red", "green", "blue"].into_iter().enumerate() {
                fields[3 + at] = (scalar, name);
            }
            let list: Vec<Vec<f64>> = shown
                .iter()
                .map(|rgb| {
                    let mut row = good(1);
                    row[3..6].copy_from_slice(&rgb.map(|c| c / 255.0 * white));
                    row
                })
                .collect();
            let (splats, notes) = read(&table(encoding, &[], &fields, &list)).unwrap();
            assert!(notes.iter().any(|note| note.id == "display-colours"));
            assert!(notes.iter().all(|note| note.id != "fields-passed-over"));
            for (sh, rgb) in splats.sh.iter().zip(shown) {
                near(sh, &rgb.map(|c: f64| ((c / 255.0 - 0.5) / 0.282_094_791_773_878_14) as f32), 1e-4);
            }
        }
    }
    // Where both are there, the coefficients count, as other programs read it.
    let fields = floats(&[&FIELDS[..], &["red", "green", "blue"]].concat());
    let (splats, _) = read(&table(ENCODINGS[0], &[], &fields, &[[good(1), vec![9.0; 3]].concat()])).unwrap();
    near(&splats.sh[0], &[0.1, 0.25, -0.5], 1e-7);
    // Another type of a field is named as that.
    let mut fields = floats(&FIELDS);
    fields[6].0 = "uchar";
    let error = read(&table(ENCODINGS[0], &[], &fields, &rows(1))).err().unwrap();
    assert!(error.message().contains("`opacity` that holds floats, but one of the type `uchar`"), "{error}");
}

/// Display codes of 8 bits in integers of 16 bits give the splats of the same file with bytes, with a warning. This
/// test fails if `Range::of` does not look at the values of 16-bit integers.
#[test]
fn codes_of_8_bits_in_16_bits_are_display_colours() {
    let of = |encoding: &str, scalar: &'static str, shown: &[[f64; 3]]| {
        let mut fields = floats(&FIELDS);
        for (at, name) in ["red", "green", "blue"].into_iter().enumerate() {
            fields[3 + at] = (scalar, name);
        }
        let row = |rgb: &[f64; 3]| [&good(1)[..3], rgb, &good(1)[6..]].concat();
        let list: Vec<Vec<f64>> = shown.iter().map(row).collect();
        let (splats, notes) = read(&table(encoding, &[], &fields, &list)).unwrap();
        let level = notes.iter().find(|note| note.id == "display-colours").unwrap().level;
        (splats, level == engine::Level::Warning)
    };
    for shown in [&[[204.0, 0.0, 255.0], [128.0, 64.0, 32.0]][..], &[[0.0, 0.0, 9.0], [0.0; 3]], &[[2.0; 3]]]
    {
        for encoding in ENCODINGS {
            let (wanted, warned) = of(encoding, "uchar", shown);
            assert!(!warned);
            for scalar in ["ushort", "short"] {
                let (splats, warned) = of(encoding, scalar, shown);
                assert!(splats == wanted && warned, "{encoding} {scalar} {shown:?}");
            }
        }
    }
    for shown in [[[0.0; 3], [0.0; 3]], [[255.0, 256.0, 0.0], [0.0; 3]], [[1.0; 3], [0.0; 3]]] {
        let (splats, warned) = of(ENCODINGS[0], "ushort", &shown);
        assert!(!warned && splats.sh.iter().flatten().all(|c| *c < -1.75), "black: {shown:?}");
    }
}

/// Lists of an element before the splats, or of the splats themselves, are skipped in every encoding. This test fails
/// if `is_converted` does not look for lists.
#[test]
fn lists_before_the_splats_are_skipped() {
    let fields = floats(&FIELDS);
    for encoding in ENCODINGS {
        let bytes = table(encoding, &[], &fields, &rows(40));
        let (wanted, _) = read(&bytes).unwrap();
        let at = bytes.windows(14).position(|w| w == b"element vertex").unwrap();
        let body = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let faces: Vec<u8> = match encoding {
            "ascii" => b"3 0 1 2 7\n0 8\n".to_vec(),
            "binary_big_endian" => vec![3, 0, 0, 0, 1, 0, 2, 7, 0, 8],
            _ => vec![3, 0, 0, 1, 0, 2, 0, 7, 0, 8],
        };
        let element = b"element face 2\nproperty list uchar ushort vertex_indices\nproperty uchar flags\n";
        let before = [&bytes[..at], element, &bytes[at..body], &faces, &bytes[body..]].concat();
        let (splats, notes) = read(&before).unwrap_or_else(|e| panic!("{encoding}: {e}"));
        assert!(splats == wanted && notes.iter().count() == 0, "{encoding}");
        let error = read(&before[..before.len() - 60]).err().unwrap();
        assert!(error.message().contains("follow") || error.message().contains("ends early"), "{error}");
        // Lists after the splats are not read.
        let end = &bytes[body - 11..];
        let after = [&bytes[..body - 11], &element[..], end, &faces].concat();
        assert!(read(&after).unwrap().0 == wanted, "{encoding}");
    }
    // A list among the fields of the splats.
    let bytes = table(ENCODINGS[0], &[], &fields, &rows(1));
    let (wanted, _) = read(&bytes).unwrap();
    let text = b"property list uchar uchar ids\nend_header\n";
    let at = bytes.len() - 14 * 4;
    let listed = [&bytes[..at - 11], &text[..], &bytes[at..], &[2, 5, 6]].concat();
    assert!(read(&listed).unwrap().0 == wanted);
}

/// A comment marks splats as trained with antialiasing, in plain and in compressed files. When the splats are
/// written, the comment is kept.
#[test]
fn comments_of_trainers_set_the_compensation() {
    let of = |comments: &[&str]| read(&table("ascii", comments, &floats(&FIELDS), &rows(3))).unwrap();
    let (mip, notes) = of(&["Exported from Brush", "SH degree: 0", "SplatRenderMode: mip"]);
    assert!(mip.antialiased && notes.iter().any(|note| note.id == "antialiased"));
    assert!(of(&["antialiased 1"]).0.antialiased);
    assert!(!of(&["SplatRenderMode: default"]).0.antialiased && !of(&[]).0.antialiased);
    let packed = Packed { position: 7, rotation: 9 << 28, scale: 5, colour: 0x0102_0304, rest: vec![] };
    let compressed = build::compressed_ply(&[packed], 0);
    assert!(!read(&compressed).unwrap().0.antialiased);
    let at = compressed.windows(9).position(|w| w == b"made here").unwrap();
    let marked = [&compressed[..at], b"SplatRenderMode: mip", &compressed[at + 9..]].concat();
    assert!(read(&marked).unwrap().0.antialiased);
    let cx = context();
    for scene in [&mip, &of(&[]).0] {
        let (bytes, notes) = save::encode(scene, save::SaveFormat::Ply, None, &cx).unwrap();
        assert_eq!(notes.iter().count(), 0);
        assert_eq!(read(&bytes).unwrap().0.antialiased, scene.antialiased);
    }
}

/// Reads the finest of two levels of one scene, given the folder or its description, and never both levels.
#[test]
fn one_level_of_a_streamed_scene_is_read() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["0_0", "1_0"] {
        std::fs::create_dir_all(folder.path().join("s").join(name)).unwrap();
        for (file, bytes) in build::sog(2) {
            std::fs::write(folder.path().join("s").join(name).join(file), bytes).unwrap();
        }
    }
    let cx = || {
        let scene = engine::Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        Context::detached(scene, folder.path())
    };
    let load = |path: &str| {
        let params = SplatFiles {
            path: InputFile(path.to_owned()),
            more: Vec::new(),
            strict: true,
            max_extent: 1e6,
            level: 0,
            matrix: None,
            frame: Frame::ByFormat,
        };
        let sources = params.sources(&SourceRoot::new(folder.path()))?;
        let cx = cx().having_listed(&sources);
        params.splats(&cx).map(|(splats, notes)| (splats, notes, sources.len()))
    };
    // Without a description, they may be tiles as well: joined, with a warning.
    let (both, notes, _) = load("s").unwrap();
    assert!(notes.iter().any(|note| note.id == "levels-joined"));
    let (one, ..) = load("s/0_0").unwrap();
    assert_eq!(both.len(), 2 * one.len());
    let write = |lods: &str| {
        let text = format!(
            r#"{{"lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"], "tree": {{"children": [{lods}]}}}}"#
        );
        std::fs::write(folder.path().join("s/lod-meta.json"), text).unwrap();
    };
    let all = one.len();
    let levels = |from: usize, count: usize| {
        format!(
            r#"{{"lods": {{"0": {{"file": 0, "offset": {from}, "count": {count}}}, "1": {{"file": 1, "offset": 0, "count": {all}}}}}}}"#
        )
    };
    write(&levels(0, all));
    for path in ["s", "s/lod-meta.json"] {
        let (splats, notes, sources) = load(path).unwrap();
        assert!(splats == one, "{path}");
        assert_eq!(sources, 1 + 8);
        assert!(notes.iter().any(|note| note.id == "streamed-level" && note.text.contains("levels: 2")));
    }
    // Places in any order, and a place that takes a part of the rows.
    let place = |from: usize, count: usize| {
        format!(r#"{{"lods": {{"0": {{"file": 0, "offset": {from}, "count": {count}}}}}}}"#)
    };
    write(&format!("{},{}", place(3, all - 3), place(0, 3)));
    assert!(load("s").unwrap().0 == one);
    write(&place(2, 3));
    let (part, ..) = load("s").unwrap();
    assert_eq!((&part.means[..], part.len()), (&one.means[2..5], 3));
    write(&place(2, all));
    let error = load("s").err().unwrap();
    assert!(error.message().contains("refers to splats 2"), "{error}");
    // The description by itself, and an archive of it, are named as what they are.
    let error = read(br#"{"filenames": [], "tree": {}}"#).err().unwrap();
    assert!(error.message().contains("streamed SOG"), "{error}");
    let files = vec![("lod-meta.json".to_owned(), b"{}".to_vec())];
    let error = read(&build::zip("", &files, false)).err().unwrap();
    assert!(error.message().contains("unpack it"), "{error}");
}

/// The bytes with a carriage return in place of each line feed before the end of the header, and its line end.
fn old_macintosh(bytes: &[u8]) -> Vec<u8> {
    let end = bytes.windows(11).position(|at| at == b"end_header\n").unwrap() + 11;
    let head = bytes[..end].iter().map(|byte| if *byte == b'\n' { b'\r' } else { *byte });
    head.chain(bytes[end..].iter().copied()).collect()
}

// Lines that end with carriage returns only, and comments in Latin-1. An earlier version refused both, the first with
// misleading messages.
#[test]
fn headers_with_other_line_ends_and_encodings_are_read() {
    let fields = floats(&FIELDS);
    let (wanted, _) = read(&table("ascii", &[], &fields, &rows(70))).unwrap();
    for encoding in ENCODINGS {
        let bytes = table(encoding, &["made here"], &fields, &rows(70));
        let (splats, notes) = read(&old_macintosh(&bytes)).unwrap_or_else(|e| panic!("{encoding}: {e}"));
        assert!(splats == wanted && notes.iter().count() == 0, "{encoding}");
        // `é` in Latin-1.
        let at = bytes.windows(9).position(|at| at == b"made here").unwrap();
        let latin = [&bytes[..at], b"mad\xe9 here", &bytes[at + 9..]].concat();
        let (splats, _) = read(&latin).unwrap_or_else(|e| panic!("{encoding}: {e}"));
        assert!(splats == wanted, "{encoding}");
    }
    let text = String::from_utf8(table("ascii", &[], &fields, &rows(70))).unwrap();
    for ends in ["\r", "\r\n", "\r\r\n"] {
        assert!(read(text.replace('\n', ends).as_bytes()).unwrap().0 == wanted, "{ends:?}");
    }
}
