mod sample;

use std::collections::BTreeSet;

use engine::{InputFile, Up};
use glam::{DQuat, DVec3};

use self::sample::{full, primitive, sample};
use super::*;
use crate::io::gltf::object::object;
use crate::io::gltf::{Want, parse};
use crate::io::splats::from_y_up;
use crate::types::Material;
use testing::context;

fn placed(object: &Arc<Object>, matrix: DMat4) -> Arc<Placed> {
    Arc::new(Placed { object: Arc::clone(object), world_from_object: matrix })
}

fn written(objects: &[Arc<Placed>], file_from_world: DMat3) -> Vec<u8> {
    encode(objects, file_from_world, &context()).unwrap_or_else(|e| panic!("{e}")).0
}

fn read(bytes: &[u8]) -> Object {
    let path = InputFile("a.glb".to_owned());
    object(&path, bytes, Want::Everything, (None, None), &context(), &mut Notes::none())
        .unwrap_or_else(|e| panic!("{e}"))
}

fn json_of(bytes: &[u8]) -> Value {
    parse("a.glb", bytes).unwrap_or_else(|e| panic!("{e}")).json
}

/// The object as it is read from a file with this matrix: transformed in f64 by a matrix in f32.
fn expected(object: &Object, matrix: DMat4, scale: f64) -> Object {
    let matrix = DMat4::from_cols_array(&matrix.to_cols_array().map(|v| f64::from(v as f32)));
    let mut all = bake::transformed(object, matrix);
    for volume in all.materials.iter_mut().filter_map(|m| m.volume.as_mut()) {
        *volume = volume.map(|a| (f64::from(a) / scale) as f32);
    }
    all
}

/// Compares objects: absorptions within rounding, everything else exactly.
fn assert_same(mut got: Object, want: Object) {
    for (a, b) in got.materials.iter_mut().zip(&want.materials) {
        if let (Some(a), Some(b)) = (&mut a.volume, b.volume) {
            assert!(a.iter().zip(b).all(|(a, b)| (*a - b).abs() < 1e-5 * b), "{a:?} {b:?}");
            *a = b;
        }
    }
    assert_eq!(got.materials, want.materials);
    for (a, b) in got.primitives.iter().zip(&want.primitives) {
        assert!(a == b, "{:?}\n{:?}", a.positions.first(), b.positions.first());
    }
    // Not printed: the textures are long.
    assert!(got == want, "the numbers of parts or the textures differ");
}

/// Writing and reading give the same object, bit for bit. This test fails if any two fields of a material are swapped or if one
/// is left out, and if an attribute, a sampler or a type of indices is wrong.
#[test]
fn an_object_comes_back_as_it_was() {
    let object = Arc::new(sample());
    let bytes = written(&[placed(&object, DMat4::IDENTITY)], DMat3::IDENTITY);
    assert_same(read(&bytes), sample());
    assert_eq!(bytes, written(&[placed(&object, DMat4::IDENTITY)], DMat3::IDENTITY));
    let json = json_of(&bytes);
    let used: Vec<&str> =
        json["extensionsUsed"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    assert_eq!(used.len(), 12, "{used:?}");
    assert_eq!(json["materials"][1], json!({}));
    assert!(json["nodes"][0].get("matrix").is_none());
    assert!(json.get("extensionsRequired").is_none());
}

/// Objects stand in the file where their transforms place them, also turned to +y, mirrored, and with a shear, which
/// nodes cannot have. This test fails if the rotation of the frame is transposed, or if absorption is not scaled.
#[test]
fn objects_stand_where_they_are_placed() {
    let object = Arc::new(sample());
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7);
    let uneven =
        DMat4::from_scale_rotation_translation(DVec3::new(1.5, 0.25, 2.0), turn, DVec3::new(5.0, -6.0, 7.0));
    let mirrored = uneven * DMat4::from_scale(DVec3::new(1.0, 1.0, -1.0));
    let mut sheared = DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0));
    sheared.y_axis.x = 0.5;
    for (column, row) in [(1, 0), (2, 1), (0, 2)] {
        let mut matrix = DMat4::IDENTITY;
        matrix.col_mut(column)[row] = 0.01;
        assert!(bake::is_sheared(matrix));
    }
    for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
        let frame = from_y_up(up).transpose();
        let turned = DMat4::from_mat3(frame);
        for matrix in [uneven, mirrored, sheared, sheared * DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))] {
            let scale = num::pow(DMat3::from_mat4(matrix).determinant().abs(), 1.0 / 3.0);
            let bytes = written(&[placed(&object, matrix)], frame);
            assert_eq!(json_of(&bytes)["nodes"][0].get("matrix").is_none(), matrix.y_axis.x == 0.5);
            let got = read(&bytes);
            let mut want = expected(&object, turned * matrix, scale);
            // The normals and tangents of a shear are rounded once, those of a node twice.
            for (got, want) in got.primitives.iter().zip(&mut want.primitives) {
                let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
                assert!(near(got.normals.as_flattened(), want.normals.as_flattened()));
                assert!(near(got.tangents.as_flattened(), want.tangents.as_flattened()));
                (want.normals, want.tangents) = (got.normals.clone(), got.tangents.clone());
            }
            assert_same(got, want);
        }
    }
}

/// Equal objects share a mesh, and equal pictures of different objects an image. Objects without triangles, and
/// materials without triangles, are left out.
#[test]
fn what_is_equal_is_written_once() {
    let mut object = Object { materials: vec![Material { volume: None, ..full() }], ..sample() };
    object.primitives.iter_mut().for_each(|p| p.material = 0);
    let mut other = object.clone();
    other.materials.splice(0..0, [Material::default(), Material::default()]);
    other.primitives.iter_mut().for_each(|p| p.material = 2);
    other.primitives.push(Primitive::default());
    let (same, object, other) = (Arc::new(object.clone()), Arc::new(object), Arc::new(other));
    let at = |x: f64| DMat4::from_translation(DVec3::new(x, 0.0, 0.0));
    let empty = placed(&Arc::default(), DMat4::IDENTITY);
    let list = [
        placed(&object, at(1.0)),
        empty.clone(),
        placed(&same, at(2.0)),
        placed(&object, DMat4::from_scale(DVec3::splat(3.0))),
        placed(&other, at(4.0)),
    ];
    let (bytes, notes) = encode(&list, DMat3::IDENTITY, &context()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(notes.iter().map(|note| note.id.as_str()).collect::<Vec<_>>(), ["objects-empty"]);
    let json = json_of(&bytes);
    let count = |list: &str| json[list].as_array().map_or(0, Vec::len);
    assert_eq!((count("nodes"), count("meshes"), count("materials"), count("images")), (4, 2, 2, 17));
    let meshes: Vec<_> = (0..4).map(|i| json["nodes"][i]["mesh"].as_u64()).collect();
    assert_eq!(meshes, [Some(0), Some(0), Some(0), Some(1)]);
    assert_eq!(json["nodes"][3]["name"], "object 4");
    let materials: Vec<u32> = read(&bytes).primitives.iter().map(|p| p.material).collect();
    assert_eq!(materials, [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1]);
    // A body that absorbs light has its own material for each size.
    let glass = Arc::new(sample());
    let bytes = written(
        &[placed(&glass, at(1.0)), placed(&glass, DMat4::from_scale(DVec3::splat(2.0)))],
        DMat3::IDENTITY,
    );
    let volumes: Vec<_> = read(&bytes).materials.iter().filter_map(|m| m.volume).collect();
    assert!((volumes[0][1] - 3.0).abs() < 1e-5 && (volumes[1][1] - 1.5).abs() < 1e-5, "{volumes:?}");
    let error = encode(&[empty], DMat3::IDENTITY, &context()).expect_err("is refused");
    assert!(error.to_string().contains("no triangles to write"), "{error}");
}

/// The parts of the file lie where the document says: chunks and views without gaps, at multiples of four bytes, with
/// the bounds of the positions and the shortest indices. This test fails if padding is left out.
#[test]
fn the_parts_of_the_file_are_in_their_places() {
    for (vertices, component) in [(255, 5121), (256, 5123), (65_535, 5123), (65_536, 5125)] {
        let object = Object { primitives: vec![primitive(vertices, 0)], materials: vec![full()], ..sample() };
        let bytes = written(&[placed(&Arc::new(object.clone()), DMat4::IDENTITY)], DMat3::IDENTITY);
        let word = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|k| bytes[at + k])) as usize;
        assert_eq!(
            (&bytes[..4], word(4), word(8), &bytes[16..20]),
            (&b"glTF"[..], 2, bytes.len(), &b"JSON"[..])
        );
        let binary = 20 + word(12);
        assert_eq!(
            (binary % 4, word(binary) + binary + 8, &bytes[binary + 4..binary + 8]),
            (0, bytes.len(), &b"BIN\0"[..])
        );
        let json: Value = serde_json::from_slice(&bytes[20..binary]).expect("is JSON");
        assert_eq!(json["buffers"][0]["byteLength"], word(binary));
        let mut end = 0;
        for view in json["bufferViews"].as_array().expect("a list") {
            let [from, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap_or(1));
            assert_eq!((from % 4, from), (0, end));
            end = (from + length).next_multiple_of(4);
        }
        assert_eq!(end as usize, word(binary));
        let part = &json["meshes"][0]["primitives"][0];
        let accessor = |index: &Value| json["accessors"][index.as_u64().unwrap_or(99) as usize].clone();
        let indices = accessor(&part["indices"]);
        assert_eq!(
            (indices["componentType"].as_u64(), indices["count"].as_u64()),
            (Some(component), Some(3 * (vertices as u64 - 2)))
        );
        let places = accessor(&part["attributes"]["POSITION"]);
        for k in 0..3 {
            let along = || object.primitives[0].positions.iter().map(|v| f64::from(v[k]));
            assert_eq!(places["min"][k].as_f64(), along().min_by(f64::total_cmp));
            assert_eq!(places["max"][k].as_f64(), along().max_by(f64::total_cmp));
        }
        let view = |accessor: &Value| {
            json["bufferViews"][accessor["bufferView"].as_u64().unwrap_or(99) as usize]["target"].clone()
        };
        assert_eq!((view(&indices), view(&places)), (json!(34_963), json!(34_962)));
        let shapes: BTreeSet<&str> =
            json["accessors"].as_array().expect("a list").iter().filter_map(|a| a["type"].as_str()).collect();
        assert_eq!(shapes.into_iter().collect::<Vec<_>>(), ["SCALAR", "VEC2", "VEC3", "VEC4"]);
    }
}

/// Emission is exact whatever its strength, up to the largest that is read; so is a medium without absorption.
#[test]
fn emission_and_clear_media_are_exact() {
    for emissive in
        [[0.0, 1.0, 0.3], [1.000_000_1, 0.1, 0.2], [7.3, 1e-3, 0.1], [1.94, 5.76, 7.25], [3e11, 5.5e11, 0.7]]
    {
        let material = Material { emissive, volume: Some([0.0; 3]), ..Material::default() };
        let object =
            Object { primitives: vec![primitive(3, 0)], materials: vec![material], textures: vec![] };
        let got = read(&written(&[placed(&Arc::new(object.clone()), DMat4::IDENTITY)], DMat3::IDENTITY));
        assert_eq!(got.materials, object.materials);
    }
    let largest = Object {
        primitives: vec![primitive(3, 0)],
        materials: vec![Material { emissive: [1e12, 2.0, 0.0], ..Material::default() }],
        textures: vec![],
    };
    let got = read(&written(&[placed(&Arc::new(largest), DMat4::IDENTITY)], DMat3::IDENTITY));
    assert_eq!(got.materials[0].emissive, [1e12, 2.0, 0.0]);
}

/// Objects that no file can store are errors with advice.
#[test]
fn unusable_objects_are_refused() {
    fn refused(change: impl FnOnce(&mut Object, &mut DMat4)) -> String {
        let (mut object, mut matrix) = (sample(), DMat4::IDENTITY);
        change(&mut object, &mut matrix);
        let good = placed(&Arc::new(sample()), DMat4::IDENTITY);
        let list = [good, placed(&Arc::new(object), matrix)];
        let error = encode(&list, DMat3::IDENTITY, &context()).expect_err("is refused");
        assert!(error.advice().is_some(), "{error}");
        error.to_string()
    }
    for (text, says) in [
        (refused(|o, _| o.primitives[2].positions[7][1] = f32::NAN), "object 1 has a position"),
        (refused(|o, _| o.primitives[0].normals[0][2] = f32::INFINITY), "object 1 has a normal"),
        (refused(|o, _| o.primitives[0].uv1[0][0] = f32::NAN), "object 1 has a texture coordinate"),
        (refused(|o, _| o.primitives[0].colours[0][3] = f32::NAN), "object 1 has a vertex colour"),
        (refused(|o, _| o.primitives[0].triangles[0][1] = 5), "does not exist"),
        (refused(|o, _| o.primitives[0].material = 3), "does not exist"),
        (refused(|o, _| o.materials[0].ior = f32::NAN), "the material `all`, in which a number"),
        (refused(|o, _| o.materials[0].emissive[1] = f32::INFINITY), "the material `all`, in which a number"),
        (refused(|o, _| o.textures.truncate(17)), "a texture that does not exist"),
        (refused(|o, _| o.textures[3].width += 1), "a texture of 5 x 3 texels with 48 bytes"),
        (refused(|_, m| m.x_axis.x = f64::NAN), "not finite"),
        (refused(|_, m| m.w_axis.x = 1e39), "not finite in single precision"),
        (refused(|_, m| m.x_axis.x = 0.0), "makes the object flat"),
        (refused(|_, m| m.x_axis.w = 0.1), "not affine"),
    ] {
        assert!(text.contains(says), "{text}");
    }
    let error = binary::words([4, u64::from(u32::MAX) - 31]).expect_err("is too long");
    assert!(error.to_string().contains("4294967296 bytes") && error.advice().is_some(), "{error}");
    assert!(binary::words([4, u64::from(u32::MAX) - 32]).is_ok());
}
