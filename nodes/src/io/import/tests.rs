use engine::{Context, Kind, Level, Scene, SourceRoot, Up};

use super::*;
use crate::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use crate::kinds::load_object::{self, LoadObject};
use crate::types::Object;

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
    let p = LoadObject { path: InputFile(files[0].0.to_owned()), scene: None };
    let sources = LoadObject::sources(&p, &SourceRoot::new(folder.path()))?;
    let scene = Scene { up: Up::PlusY, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let cx = Context::detached(scene, folder.path());
    let (out, notes) = LoadObject::run(&p, load_object::In {}, &cx)?;
    Ok(((*out.object).clone(), notes, sources.len()))
}

fn mesh(name: &str, bytes: &[u8]) -> Result<crate::types::Mesh, NodeError> {
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
    let raster = crate::io::png::Raster {
        width: 2,
        height: 1,
        channels: 3,
        largest: 255,
        codes: vec![255, 0, 0, 0, 0, 255],
        ignored: Vec::new(),
        colour: None,
    };
    let png = crate::io::png::write(&raster, false, &[]).unwrap_or_else(|e| panic!("{e}"));
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
    }
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
                drop(crate::io::gltf::parse(name, &made).map(|file| file.buffers(|_| Err(Error::Stopped))));
            }
        }
    }
}

use crate::error::Error;
