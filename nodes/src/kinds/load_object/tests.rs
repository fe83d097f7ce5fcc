use engine::{Context, Kind, Level, Scene, SourceRoot, Up};

use super::*;
use scene::types::Object;
use crate::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use crate::kinds::load_object::{self, LoadObject};

/// A unit square in the xz plane, in two triangles.
const OBJ: &str = "# made here\nmtllib sub\\a.mtl\nv 0 0 0\nv 1 0 0\nv 1 0 -1\nv 0 0 -1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
    vn 0 1 0\nusemtl red\nf 1/1/1 2/2/1 3/3/1 4/4/1\n";
const MTL: &str = "newmtl red\nKd 0.8 0.2 0.1\nNs 0\nd 1\n";

fn object(files: &[(&str, &[u8])]) -> Result<(Object, Notes, usize), NodeError> {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    for (name, bytes) in files {
        let path = folder.path().join(name);
        path.parent().map(std::fs::create_dir_all).transpose().unwrap_or_else(|e| panic!("{e}"));
        std::fs::write(path, bytes).unwrap_or_else(|e| panic!("{e}"));
    }
    let p = LoadObject::of(InputFile(files[0].0.to_owned()));
    let sources = LoadObject::sources(&p, &SourceRoot::new(folder.path()))?;
    let scene = Scene { up: Up::PlusY, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let cx = Context::detached(scene, folder.path());
    let (out, notes) = LoadObject::run(&p, load_object::In {}, &cx)?;
    Ok(((*out.object).clone(), notes, sources.len()))
}

fn mesh(name: &str, bytes: &[u8]) -> Result<scene::types::Mesh, NodeError> {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    std::fs::write(folder.path().join(name), bytes).unwrap_or_else(|e| panic!("{e}"));
    let path = InputFile(name.to_owned());
    let p = LoadMesh { path, colours: ColourEncoding::Auto, frame: MeshFrame::World, matrix: None };
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let (out, _) = LoadMesh::run(&p, load_mesh::In {}, &Context::detached(scene, folder.path()))?;
    Ok((*out.mesh).clone())
}

#[test]
fn obj_files_have_shapes_materials_and_textures() {
    let raster = scene::io::png::Raster {
        width: 2,
        height: 1,
        channels: 3,
        largest: 255,
        codes: vec![255, 0, 0, 0, 0, 255],
        ignored: Vec::new(),
        colour: None,
    };
    let png = scene::io::png::write(&raster, false, &[]).unwrap_or_else(|e| panic!("{e}"));
    let (found, _, sources) =
        object(&[("a.obj", OBJ.as_bytes()), ("sub/a.mtl", MTL.as_bytes())]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(sources, 2);
    assert_eq!(found.primitives[0].triangles.len(), 2);
    let material = &found.materials[found.primitives[0].material as usize];
    assert_eq!(
        (material.base_colour, material.metallic, material.roughness),
        ([0.8, 0.2, 0.1, 1.0], 0.0, 1.0)
    );
    let textured = MTL.replace("d 1", "map_Kd -s 1 1 1 maps\\my c.png");
    let files =
        [("a.obj", OBJ.as_bytes()), ("sub/a.mtl", textured.as_bytes()), ("sub/maps/my c.png", &png[..])];
    let (found, notes, sources) = object(&files).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((sources, found.textures.len(), notes.is_degraded()), (3, 1, false));
    // The first corner is the lower left of the picture.
    assert_eq!(found.primitives[0].uv0[0], [0.0, 1.0]);
    // Materials and pictures that are not there are reported.
    for files in [&files[..2], &files[..1]] {
        let (_, notes, _) = object(files).unwrap_or_else(|e| panic!("{e}"));
        assert!(notes.iter().any(|note| note.level == Level::Degraded));
    }
    // Negative indices, other line ends, polygons with many corners, no normals.
    let relative = "v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0.5 2 0\r\nv 0 1 0\r\nf -5 -4 -3 -2 -1\r\n";
    let (found, ..) = object(&[("a.obj", relative.as_bytes())]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(found.primitives[0].triangles.len(), 3);
}

#[test]
fn receivers_are_read_from_obj_and_stl() {
    let coloured = "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\n";
    let found = mesh("a.OBJ", coloured.as_bytes()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((found.triangles.len(), found.colours[0]), (1, [1.0, 0.0, 0.0]));
    assert_eq!(found.positions[2], [0.0, 1.0, 0.0], "coordinates of the world, as stored");
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n\
        facet normal 0 0 1\nouter loop\nvertex 1 0 0\nvertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
    let words = mesh("a.stl", text.as_bytes()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((words.triangles.len(), words.positions.len()), (2, 4));
    for header in [&b"made here"[..], b"solid as some programs write"] {
        let mut bytes = header.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(2_u32.to_le_bytes());
        for triangle in [
            [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        ] {
            bytes.extend([0.0_f32, 0.0, 1.0].iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend(triangle.iter().flatten().flat_map(|v| v.to_le_bytes()));
            bytes.extend([0, 0]);
        }
        assert_eq!(mesh("a.stl", &bytes).unwrap_or_else(|e| panic!("{e}")), words);
        assert!(mesh("a.stl", &bytes[..bytes.len() - 1]).is_err());
        // Values after triangles, where some programs store colours, are reported.
        let ids = |bytes: &[u8]| {
            let (_, notes, _) = object(&[("a.stl", bytes)]).unwrap_or_else(|e| panic!("{e}"));
            notes.iter().filter(|note| note.id == "colours-ignored").count()
        };
        assert_eq!(ids(&bytes), 0);
        *bytes.last_mut().unwrap_or_else(|| unreachable!()) = 0x80;
        assert_eq!(ids(&bytes), 1);
    }
}

/// The base colour of the first part of an object of one triangle whose material file is `mtl`, and the notes that
/// are warnings or worse.
fn coloured(obj: &[u8], mtl: Option<(&str, &[u8])>) -> ([f32; 4], Vec<String>) {
    let mut files = vec![("a.obj", obj)];
    files.extend(mtl);
    let (found, notes, _) = object(&files).unwrap_or_else(|e| panic!("{e}"));
    let ids = notes.iter().filter(|note| note.level >= Level::Warning).map(|note| note.id.clone()).collect();
    (found.materials[found.primitives[0].material as usize].base_colour, ids)
}

const FACE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n";
const RED: [f32; 4] = [0.8, 0.2, 0.1, 1.0];

// Byte-order marks, Latin-1, absolute paths, continued lines and unusual numbers lose no material. In an earlier
// version they gave white, or a panic.
#[test]
fn materials_survive_unusual_files() {
    let with = |head: &str| format!("{head}\n{FACE}").into_bytes();
    let red = b"newmtl red\nKd 0.8 0.2 0.1\n";
    let latin = b"# gr\xfcn\nnewmtl red\nKd 0.8 0.2 0.1\n";
    let marked = b"\xef\xbb\xbfnewmtl red\r\nkd 0.8 0.2 0.1\r\n";
    for (obj, mtl) in [
        (with("\u{feff}mtllib a.mtl"), &red[..]),
        (with("mtllib C:\\x\\a.mtl"), red),
        (with("mtllib /home/x/a.mtl"), red),
        (with("mtllib \\\na.mtl"), red),
        (with("mtllib b.mtl a.mtl"), red),
        (with("mtllib a.mtl"), latin),
        (with("mtllib a.mtl"), marked),
        ([&b"# gr\xfcn\n"[..], &with("mtllib a.mtl")].concat(), red),
        (with("mtllib a.mtl").iter().map(|b| if *b == b'\n' { b'\r' } else { *b }).collect(), red),
    ] {
        let (colour, ids) = coloured(&obj, Some(("a.mtl", mtl)));
        let partly = obj.windows(5).any(|at| at == b"b.mtl");
        assert_eq!((colour, ids.len()), (RED, usize::from(partly)), "{}", String::from_utf8_lossy(&obj));
    }
    for (mtl, colour, reported) in [
        ("Kd 0.8", [0.8, 0.8, 0.8, 1.0], &[][..]),
        ("Ka 0.8\nKs 0.1\nKd 0.8 0.2 0.1", RED, &[]),
        ("Kd 0.8 0.2 0.1\nd -halo 0.5", [0.8, 0.2, 0.1, 0.5], &[]),
        ("Kd 204 51 25.5", RED, &["colour-range"]),
    ] {
        let mtl = format!("newmtl red\n{mtl}\n");
        let (found, ids) = coloured(&with("mtllib a.mtl"), Some(("a.mtl", mtl.as_bytes())));
        assert!(found.iter().zip(colour).all(|(a, b)| (a - b).abs() < 1e-6), "{mtl} {found:?}");
        assert_eq!(ids, reported, "{mtl}");
    }
}

// What cannot be used is reported: a result that is white for another reason looks like one that is right.
#[test]
fn lost_materials_are_reported() {
    let with = |head: &str| format!("{head}\n{FACE}").into_bytes();
    let lfs = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n";
    for (head, mtl, id) in [
        ("mtllib a.mtl", lfs, "materials-missing"),
        ("mtllib a.mtl", "nothing\n", "materials-missing"),
        ("mtllib a.mtl", "newmtl blue\nKd 0 0 1\n", "materials-missing"),
        ("", "", "materials-missing"),
        ("mtllib C:\\x\\none.mtl", "", "materials-missing"),
        ("mtllib a.mtl", "newmtl red\nKd 0,8 0,2 0,1\n", "material-lines-ignored"),
        ("mtllib a.mtl", "newmtl red\nKd 0.8 0.2\n", "material-lines-ignored"),
        ("mtllib a.mtl", "newmtl red\nNs x\n", "material-lines-ignored"),
        ("mtllib a.mtl", "newmtl red\nmap_d d.png\n", "material-ignored"),
        ("mtllib a.mtl", "newmtl red\nmap_kd C:\\x\\t.png\n", "texture-missing"),
        ("mtllib a.mtl", "newmtl red\nd 0\n", "material-invisible"),
    ] {
        let (_, ids) = coloured(&with(head), Some(("a.mtl", mtl.as_bytes())));
        assert_eq!(ids, [id], "{head} {mtl}");
    }
    let named = object(&[("a.obj", &with("mtllib a.mtl")), ("a.mtl", lfs.as_bytes())]);
    let (_, notes, _) = named.unwrap_or_else(|e| panic!("{e}"));
    assert!(notes.iter().any(|note| note.text.contains("git lfs pull")));
}

#[test]
fn a_bad_line_of_obj_is_named() {
    for (text, says) in [
        ("v 0 0 0\nv 0,5 0 0\n", "line 2 cannot be read as Wavefront OBJ: `v 0,5 0 0`"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "line 4"),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n",
            "the face in line 4 refers to vertex 4, which does not exist (number in the file: 3)",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 3/1\n",
            "texture coordinate 1, which does not exist (number in the file: 0)",
        ),
        ("hello\n", "it has no vertices"),
        ("ply\nformat ascii 1.0\n", "PLY"),
        ("v 0 0 0\nv 1 0 0\nl 1 2\n", "triangle"),
    ] {
        let error = object(&[("a.obj", text.as_bytes())]).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{text}: {error}");
    }
}

/// Texture options move and scale the texture; v runs upwards in OBJ.
#[test]
fn texture_options_of_obj_move_the_texture() {
    let raster = scene::io::png::Raster {
        width: 1,
        height: 1,
        channels: 1,
        largest: 255,
        codes: vec![9],
        ignored: Vec::new(),
        colour: None,
    };
    let png = scene::io::png::write(&raster, false, &[]).unwrap_or_else(|e| panic!("{e}"));
    let mtl = b"newmtl red\nmap_Kd -s 2 4 1 -o 0.5 0.25 0 t.png\n";
    let obj = format!("mtllib a.mtl\nvt 0 0\n{}", FACE.replace("f 1 2 3", "f 1/1 2/1 3/1"));
    let files = [("a.obj", obj.as_bytes()), ("a.mtl", &mtl[..]), ("t.png", &png[..])];
    let (found, ..) = object(&files).unwrap_or_else(|e| panic!("{e}"));
    let texture = found.materials[0].base_colour_texture.unwrap_or_else(|| panic!("a texture"));
    let moved = texture.transform.unwrap_or_else(|| panic!("a transform"));
    assert_eq!((moved.offset, moved.scale), ([0.5, 1.0 - 4.0 - 0.25], [2.0, 4.0]));
}

// Vertex colours as floats to 255, in receivers and objects.
#[test]
fn vertex_colours_of_obj_to_255_are_scaled() {
    let text = "v 0 0 0 255 51 0\nv 1 0 0 255 51 0\nv 0 1 0 255 51 0\nf 1 2 3\n";
    let one = text.replace("255 51 0", "1 0.2 0");
    let (wanted, found) = (mesh("a.obj", one.as_bytes()), mesh("a.obj", text.as_bytes()));
    let (wanted, found) = (wanted.unwrap_or_else(|e| panic!("{e}")), found.unwrap_or_else(|e| panic!("{e}")));
    for (a, b) in wanted.colours.as_flattened().iter().zip(found.colours.as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{found:?}");
    }
    let (object, notes, _) = object(&[("a.obj", text.as_bytes())]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(object.primitives[0].colours[0], [1.0, (51.0_f64 / f64::from(255.0_f32)) as f32, 0.0, 1.0]);
    assert!(notes.iter().any(|note| note.id == "colour-range"));
    assert!(notes.iter().all(|note| note.id != "colours-clamped"));
}

// Several solids, other cases of letters, byte-order marks and blanks. In an earlier version only the first solid
// was read.
#[test]
fn texts_of_stl_are_read_in_all_forms() {
    let solid = |z: &str| {
        format!(
            "solid part {z}\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 {z}\n   vertex 1 0 {z}\n   vertex 0 1 {z}\n  endloop\n \
             endfacet\nendsolid part {z}\n"
        )
    };
    let two = format!("{}{}", solid("0"), solid("1"));
    let wanted = mesh("a.stl", two.as_bytes()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((wanted.triangles.len(), wanted.positions[3]), (2, [0.0, 0.0, 1.0]));
    for text in [
        two.to_uppercase(),
        format!("\u{feff}{two}"),
        format!("\n  {two}"),
        two.replace('\n', "\r\n"),
        two.replace('\n', "\r"),
        two.replace("normal 0 0 1", "normal nan nan -nan(ind)"),
    ] {
        assert_eq!(mesh("a.stl", text.as_bytes()).unwrap_or_else(|e| panic!("{e}")), wanted, "{text}");
    }
    for (text, says) in [
        (two.replace("vertex 0 1 1", "vertex 0,5 1 1"), "`vertex 0,5 1 1`"),
        (two.replace("   vertex 0 1 1\n", ""), "`endfacet`"),
        (two.trim_end().trim_end_matches("endsolid part 1").to_owned(), "ends before `endsolid`"),
    ] {
        let error = mesh("a.stl", text.as_bytes()).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{error}");
    }
    let (_, notes, _) = object(&[("a.stl", two.as_bytes())]).unwrap_or_else(|e| panic!("{e}"));
    let ids: Vec<&str> = notes.iter().map(|note| note.id.as_str()).collect();
    assert!(ids.contains(&"solids") && ids.contains(&"frame-of-stl"), "{ids:?}");
}

/// A file that is cut off anywhere, or in which any byte is changed, gives an error or a shape, never a panic.
#[test]
fn damaged_files_are_survived() {
    let text = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n";
    for (name, bytes) in [("a.obj", OBJ.as_bytes()), ("a.stl", &text[..])] {
        let mut seed = 1_u64;
        for turn in 0..3000 {
            let mut hurt = bytes.to_vec();
            for _ in 0..=turn % 4 {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let at = (seed >> 33) as usize % hurt.len().max(1);
                match seed >> 61 {
                    0 if !hurt.is_empty() => hurt[at] ^= 1 << (seed >> 40 & 7),
                    1 => hurt.truncate(at),
                    2 => drop(hurt.splice(at..at, b"4294967296".iter().copied())),
                    3 => drop(hurt.splice(at..at, b"-1 ".iter().copied())),
                    4 => drop(hurt.splice(at..at, b"nan\n".iter().copied())),
                    _ if !hurt.is_empty() => hurt[at] = (seed >> 48) as u8,
                    _ => {}
                }
            }
            let scene = Scene { up: Up::PlusY, metres_per_unit: 1.0, seed: 0, exhaustive: false };
            let cx = Context::detached(scene, "nowhere");
            let path = InputFile(name.to_owned());
            if let Ok(made) = as_gltf(&path, &hurt, &cx, &mut Notes::none()) {
                drop(scene::io::gltf::parse(name, &made).map(|file| file.buffers(|_| Err(Error::Stopped))));
            }
        }
    }
}

use crate::error::Error;
