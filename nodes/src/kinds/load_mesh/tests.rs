use super::*;
use engine::{Scene, Up};
use scene::math::color::linear_from_srgb;

const BODY: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";

fn load(bytes: &[u8], p: &LoadMesh) -> Result<(Arc<Mesh>, Notes), NodeError> {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    std::fs::write(folder.path().join(&p.path.0), bytes).unwrap_or_else(|e| panic!("{e}"));
    let cx = Context::detached(
        Scene { up: Up::PlusZ, metres_per_unit: 0.5, seed: 0, exhaustive: false },
        folder.path(),
    );
    LoadMesh::run(p, In {}, &cx).map(|(out, notes)| (out.mesh, notes))
}
fn plain() -> LoadMesh {
    LoadMesh {
        path: InputFile("a.ply".into()),
        colours: ColourEncoding::Auto,
        frame: MeshFrame::World,
        matrix: None,
    }
}
fn good(bytes: &[u8]) -> (Arc<Mesh>, Notes) {
    load(bytes, &plain()).unwrap_or_else(|e| panic!("{e}"))
}

fn ascii() -> Vec<u8> {
    let rows = "0 0 0 0 128 255\n1 0 0 255 255 255\r\n1 1 0 0 0 0\n0 1 0.25 12 13 14\n4 0 1 2 3\n";
    format!("ply\nformat ascii 1.0\ncomment made here\n{BODY}{rows}").into_bytes()
}
fn binary(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut bytes = format!("ply\nformat binary_{order}_endian 1.0\n{BODY}").into_bytes();
    let rows = [
        ([0.0_f32, 0.0, 0.0], [0, 128, 255_u8]),
        ([1.0, 0.0, 0.0], [255; 3]),
        ([1.0, 1.0, 0.0], [0; 3]),
        ([0.0, 1.0, 0.25], [12, 13, 14]),
    ];
    for (position, colour) in rows {
        bytes.extend(position.iter().flat_map(|c| if big { c.to_be_bytes() } else { c.to_le_bytes() }));
        bytes.extend(colour);
    }
    bytes.push(4);
    bytes.extend([0_i32, 1, 2, 3].iter().flat_map(|c| if big { c.to_be_bytes() } else { c.to_le_bytes() }));
    bytes
}

// Headers whose lines end with carriage returns only, and a comment in Latin-1.
#[test]
fn headers_with_other_line_ends_and_encodings_are_read() {
    let (wanted, _) = good(&ascii());
    for bytes in [ascii(), binary(false), binary(true)] {
        let end = bytes.windows(11).position(|at| at == b"end_header\n").unwrap_or_default() + 11;
        let mut changed = bytes.clone();
        changed[..end].iter_mut().filter(|byte| **byte == b'\n').for_each(|byte| *byte = b'\r');
        assert_eq!(good(&changed).0, wanted);
        let latin = [&bytes[..4], b"comment cl\xe9ment\n", &bytes[4..]].concat();
        assert_eq!(good(&latin).0, wanted);
    }
}

/// A triangle with the given material, and optionally with vertex colours.
fn triangle(material: &str, colours: Option<[f32; 3]>) -> Vec<u8> {
    let mut floats = vec![0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    floats.extend(colours.iter().flat_map(|c| [*c; 3]).flatten());
    let bytes: Vec<u8> = floats.iter().flat_map(|v| v.to_le_bytes()).collect();
    let accessor =
        |at| format!(r#"{{"bufferView":0,"byteOffset":{at},"componentType":5126,"count":3,"type":"VEC3"}}"#);
    let (second, name) = match colours {
        Some(_) => (format!(",{}", accessor(36)), r#","COLOR_0":1"#),
        None => (String::new(), ""),
    };
    let length = bytes.len();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"materials":[{material}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0{name}}},"material":0}}]}}],"accessors":[{}{second}],"bufferViews":[{{"buffer":0,"byteLength":{length}}}],"buffers":[{{"byteLength":{length}}}]}}"#,
        accessor(0)
    );
    let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
    let mut glb = b"glTF".to_vec();
    for (word, chunk) in [(b"JSON", json.as_bytes()), (b"BIN\0", &bytes)] {
        if glb.len() == 4 {
            glb.extend(2_u32.to_le_bytes());
            glb.extend((12 + 8 + json.len() as u32 + 8 + length as u32).to_le_bytes());
        }
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(word);
        glb.extend(chunk);
    }
    glb
}

// Integers of 32 bits hold 8-bit codes, as written by programs without another integer type; with 16 bits, the
// largest value is 1. This test fails if the largest 32-bit value is mapped to 1, which makes all colours black.
#[test]
fn colours_of_wide_numbers_are_codes() {
    let text = String::from_utf8(ascii()).unwrap_or_default();
    let (bytes, _) = good(text.as_bytes());
    for wide in ["int", "uint", "int32", "uint32"] {
        let (mesh, notes) = good(text.replace("property uchar", &format!("property {wide}")).as_bytes());
        assert_eq!(mesh.colours, bytes.colours, "{wide}");
        assert!(notes.iter().all(|note| note.id != "colours-clamped"), "{wide}");
    }
    let (mesh, _) =
        good(text.replace("property uchar", "property ushort").replace("255", "65535").as_bytes());
    assert_eq!(mesh.colours[1], [1.0; 3]);
}

// The factor of glTF is linear and multiplies the colours; without them it is the colour, and white means no
// colour. This test fails if `raw.tints` is left empty, or if the tint is decoded as sRGB.
#[test]
fn the_factor_of_a_gltf_material_colours_its_vertices() {
    let factor = r#"{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,1.0,1.0]}}"#;
    let colours = |material: &str, vertex: Option<[f32; 3]>, colours: ColourEncoding| {
        let p = LoadMesh { path: InputFile("a.glb".into()), colours, frame: MeshFrame::World, matrix: None };
        load(&triangle(material, vertex), &p).unwrap_or_else(|e| panic!("{e}")).0.colours.clone()
    };
    let auto = ColourEncoding::Auto;
    assert_eq!(colours(factor, Some([0.2, 0.4, 0.6]), auto), [[0.1, 0.1, 0.6]; 3]);
    assert_eq!(colours(factor, None, auto), [[0.5, 0.25, 1.0]; 3]);
    assert_eq!(colours("{}", None, auto), [[0.0; 3]; 0]);
    let half = linear_from_srgb(0.5);
    assert_eq!(colours(factor, Some([0.5; 3]), ColourEncoding::Srgb), [[0.5 * half, 0.25 * half, half]; 3]);
}

/// Faces with colours keep sharp colour edges; existing vertex colours take precedence.
#[test]
fn colours_of_faces_are_those_of_their_corners() {
    let text = String::from_utf8(ascii()).unwrap_or_default();
    let faces = "element face 3\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n";
    let both = text.replace("element face 1\nproperty list uchar int vertex_indices\n", faces);
    let both = both.replace("4 0 1 2 3\n", "4 0 1 2 3 255 0 0\n3 0 3 2 0 255 0\n3 1 2 3 0 255 0\n");
    let alone = both.replacen("property uchar red\nproperty uchar green\nproperty uchar blue\n", "", 1);
    let alone = alone.replace(" 0 128 255\n", "\n").replace(" 255 255 255\r\n", "\n");
    let alone = alone.replace("1 1 0 0 0 0\n", "1 1 0\n").replace(" 12 13 14\n", "\n");
    let (mesh, notes) = good(alone.as_bytes());
    assert!(
        notes.iter().any(|note| note.id == "face-colours")
            && notes.iter().all(|note| note.id != "no-vertex-colours")
    );
    assert_eq!(mesh.positions.len(), 8, "each of the four is there in two colours");
    let places = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.25]];
    let expected = [[0, 1, 2], [0, 2, 3], [0, 3, 2], [1, 2, 3]];
    for (number, (triangle, corners)) in mesh.triangles.iter().zip(expected).enumerate() {
        for (&vertex, corner) in triangle.iter().zip(corners) {
            assert_eq!(mesh.positions[vertex as usize], places[corner]);
            let colour = if number < 2 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
            assert_eq!(mesh.colours[vertex as usize], colour, "{number}");
        }
    }
    let (mesh, notes) = good(both.as_bytes());
    assert!(mesh.positions.len() == 4 && notes.iter().all(|note| note.id != "face-colours"));
}

/// glTF is y-up by specification, but meshes of captures usually use world axes. If the coordinates of a glTF file
/// are used as world coordinates, this is reported; with `frame: Gltf` it is not.
#[test]
fn axes_of_gltf_are_reported() {
    for (frame, reported) in [(MeshFrame::World, true), (MeshFrame::Gltf, false)] {
        let p =
            LoadMesh { path: InputFile("a.glb".into()), colours: ColourEncoding::Auto, frame, matrix: None };
        let notes = load(&triangle("{}", None), &p).unwrap_or_else(|e| panic!("{e}")).1;
        assert_eq!(notes.iter().any(|note| note.id == "mesh-frame"), reported);
    }
    assert!(good(&ascii()).1.iter().all(|note| note.id != "mesh-frame"));
}

#[test]
fn three_ways_to_write_one_mesh() {
    let (mesh, notes) = good(&ascii());
    assert_eq!(mesh, good(&binary(false)).0);
    assert_eq!(mesh, good(&binary(true)).0);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]], "a fan");
    assert_eq!(mesh.positions[3], [0.0, 1.0, 0.25]);
    assert_eq!(mesh.colours[0], [0.0, linear_from_srgb(128.0 / 255.0), 1.0]);
    assert!(notes.iter().any(|n| n.id == "colour-encoding") && notes.iter().any(|n| n.id == "faces-fanned"));
}

// Survey coordinates: millimetres at a distance of a thousand kilometres, which f32 rounds to sixteenths of a
// metre. This test fails if `area_is_zero` gets rounded corners, or without the low parts of the positions.
#[test]
fn doubles_far_from_the_origin_keep_their_millimetres() {
    let at = [1_048_576.001, -524_288.5, 262_144.004];
    let text = String::from_utf8(ascii()).unwrap_or_default().replace("property float", "property double");
    let (head, body) = text.split_once("end_header\n").unwrap_or_default();
    let moved = body.lines().map(|line| {
        let words: Vec<&str> = line.split(' ').collect();
        let [x, y, z, rest @ ..] = words.as_slice() else { panic!("{line}") };
        if rest.len() != 3 {
            return line.to_owned();
        }
        let place =
            [x, y, z].into_iter().zip(at).map(|(word, at)| word.parse::<f64>().unwrap_or(0.0) / 1e3 + at);
        let place: Vec<String> = place.map(|c| format!("{c:?}")).collect();
        format!("{} {}", place.join(" "), rest.join(" "))
    });
    let moved = format!("{head}end_header\n{}\n", moved.collect::<Vec<_>>().join("\n"));
    let ((mesh, notes), (near, _)) = (good(moved.as_bytes()), good(&ascii()));
    assert!(notes.iter().all(|note| note.id != "triangles-without-area"));
    assert_eq!(mesh.triangles, near.triangles);
    for vertex in 0..4 {
        let off = mesh.position(vertex) - DVec3::from(at) - near.position(vertex) / 1e3;
        assert!(off.abs().max_element() < 1e-9, "{off}");
    }
    assert!(near.positions_low.is_empty());
}

#[test]
fn parameters_change_what_they_say() {
    let linear = load(&ascii(), &LoadMesh { colours: ColourEncoding::Linear, ..plain() });
    assert_eq!(linear.map(|m| m.0.colours[0][1]).ok(), Some((128.0 / 255.0) as f32));
    let turned = load(&ascii(), &LoadMesh { frame: MeshFrame::Gltf, ..plain() });
    assert_eq!(turned.map(|m| m.0.positions[3]).ok(), Some([0.0, -0.5, 2.0]), "(x, -z, y) / 0.5");
}

/// Unusable vertices and faces are dropped and counted.
#[test]
fn unusable_parts_are_dropped_and_counted() {
    let text = String::from_utf8(ascii()).unwrap_or_default();
    let text = text.replace("1 0 0 255", "nan 0 0 255").replace("element face 1", "element face 4");
    let (mesh, notes) = good(format!("{text}3 2 2 3\n3 0 2 3\n3 0 1 3\n").as_bytes());
    assert_eq!(mesh.positions.len(), 3);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 2]]);
    let count = |id: &str| notes.iter().find(|n| n.id == id).map(|n| n.text.clone());
    assert!(count("vertices-not-finite").is_some_and(|t| t.starts_with("1 ")));
    assert!(count("faces-of-dropped-vertices").is_some_and(|t| t.starts_with("2 ")));
    assert!(count("triangles-without-area").is_some_and(|t| t.starts_with("1 ")));
}

#[test]
fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
    let cx =
        Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
    let read = |bytes: &[u8]| {
        from_ply("a.ply", bytes, &cx, &mut Notes::none())
            .and_then(|raw| clean("a.ply", raw, true, &cx, &mut Notes::none()))
    };
    for bytes in [ascii(), binary(false), binary(true)] {
        // The last bytes of ASCII are a digit and a line end, which may be missing.
        for end in 0..bytes.len() - 3 {
            assert!(read(&bytes[..end]).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() {
            let mut hurt = bytes.clone();
            hurt[at] ^= 1 << (at % 8);
            drop(read(&hurt));
        }
    }
    let bomb =
        String::from_utf8(ascii()).unwrap_or_default().replace("vertex 4", "vertex 18446744073709551615");
    assert!(load(bomb.as_bytes(), &plain()).is_err());
    let points = String::from_utf8(ascii()).unwrap_or_default().replace("element face 1", "element face 0");
    assert!(load(points.as_bytes(), &plain()).is_err());
    let far = String::from_utf8(ascii()).unwrap_or_default().replace("4 0 1 2 3", "4 0 1 2 4");
    assert!(load(far.as_bytes(), &plain()).is_err());
}

// Files of other programs are named with what to do, under any name.
#[test]
fn other_formats_are_named() {
    for (name, bytes, says) in [
        ("a.fbx", &b"Kaydara FBX Binary  \0\x1a\0"[..], "FBX"),
        ("a.dae", b"<?xml version=\"1.0\"?><COLLADA>", "COLLADA"),
        ("a.abc", b"Ogawa\xff", "Alembic"),
        ("a.usdc", b"PXR-USDC\0", "USD"),
        ("a.blend", b"BLENDER_v300", "Blender"),
        ("a.ply", b"BLENDER_v300", "Blender"),
        ("a.glb", b"glTF\x01\0\0\0\x14\0\0\0", "glTF 2.0"),
        ("a.gltf", b"{\"asset\": {\"version\": \"1.0\"}}", "glTF 2.0"),
        ("a.bin", b"glTF\x02\0\0\0", "`.glb` or `.gltf`"),
        ("a.bin", b"solid a\nfacet normal 0 0 1", "`.stl`"),
        ("a.ply", b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    ] {
        let p = LoadMesh { path: InputFile(name.into()), ..plain() };
        let error = load(bytes, &p).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says) && !error.contains("not a PLY file"), "{name}: {error}");
    }
}

// Vertex colours of glTF as floats to 255.
#[test]
fn colours_of_gltf_to_255_are_scaled() {
    let colour = |rgb: [f32; 3]| {
        let p = LoadMesh { path: InputFile("a.glb".into()), ..plain() };
        let (mesh, notes) = load(&triangle("{}", Some(rgb)), &p).unwrap_or_else(|e| panic!("{e}"));
        (mesh.colours[0], notes.iter().any(|note| note.id == "colour-range"))
    };
    assert_eq!(colour([255.0, 51.0, 0.0]), ([1.0, (51.0_f64 / 255.0) as f32, 0.0], true));
    assert_eq!(colour([1.0, 0.2, 0.0]), ([1.0, 0.2, 0.0], false));
    assert_eq!(colour([1000.0, 0.0, 0.0]), ([1.0, 0.0, 0.0], false), "another range");
}

// Photogrammetry programs write floats up to 255. In an earlier version they became white.
#[test]
fn colours_as_floats_to_255_are_display_colours() {
    let of = |rows: [&str; 3]| {
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             property float red\nproperty float green\nproperty float blue\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n0 0 0 {}\n1 0 0 {}\n0 1 0 {}\n3 0 1 2\n",
            rows[0], rows[1], rows[2]
        );
        good(text.as_bytes())
    };
    let (wanted, _) = of(["0.8 0.2 0", "1 0.4 0.2", "0.6 0 0"]);
    let (mesh, notes) = of(["204 51 0", "255 102 51", "153 0 0"]);
    for (a, b) in mesh.colours.as_flattened().iter().zip(wanted.colours.as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{mesh:?}");
    }
    assert!(notes.iter().any(|note| note.id == "colour-range"));
    assert!(notes.iter().all(|note| note.id != "colours-clamped"));
    // Beyond any range of bytes: clamped, as before.
    let (_, notes) = of(["1000 0 0", "0.5 0.5 0.5", "0 0 0"]);
    assert!(notes.iter().any(|note| note.id == "colours-clamped"));
}

/// Codes of 8 bits in integers of 16 bits, of vertices and of faces, are the colours of the same file with integers of
/// 8 bits. This test fails if `to_unit` does not look at the values.
#[test]
fn codes_of_8_bits_in_16_bits_are_display_colours() {
    let text = |scalar: &str, rows: [&str; 3]| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             property {scalar} red\nproperty {scalar} green\nproperty {scalar} blue\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n0 0 0 {}\n1 0 0 {}\n0 1 0 {}\n3 0 1 2\n",
            rows[0], rows[1], rows[2]
        )
    };
    let warned = |notes: &Notes| notes.iter().any(|note| note.id == "colour-range");
    let bits = |mesh: &Mesh| mesh.colours.iter().map(|c| c.map(f32::to_bits)).collect::<Vec<_>>();
    for rows in [["204 51 0", "255 102 51", "153 0 0"], ["0 0 0", "0 7 0", "0 0 0"], ["2 3 4"; 3]] {
        let (wanted, notes) = good(text("uchar", rows).as_bytes());
        assert!(!warned(&notes));
        for scalar in ["ushort", "short", "uint16"] {
            let (mesh, notes) = good(text(scalar, rows).as_bytes());
            assert!(bits(&mesh) == bits(&wanted) && warned(&notes), "{scalar} {rows:?}: {mesh:?}");
        }
    }
    for rows in [["0 0 0"; 3], ["255 256 0", "0 0 0", "0 0 0"], ["1 1 0", "1 0 1", "0 0 0"]] {
        let (mesh, notes) = good(text("ushort", rows).as_bytes());
        assert!(!warned(&notes) && mesh.colours.as_flattened().iter().all(|c| *c < 0.001), "{rows:?}");
    }
    let face = |scalar: &str| {
        let colours =
            format!("property {scalar} red\nproperty {scalar} green\nproperty {scalar} blue\nend_header");
        let plain = text("uchar", [""; 3]);
        let plain = plain.replace("property uchar red\nproperty uchar green\nproperty uchar blue\n", "");
        good(plain.replace("end_header", &colours).replace("3 0 1 2", "3 0 1 2 200 100 0").as_bytes())
    };
    let ((wanted, _), (mesh, notes)) = (face("uchar"), face("ushort"));
    assert!(bits(&mesh) == bits(&wanted) && warned(&notes), "{mesh:?}");
}
