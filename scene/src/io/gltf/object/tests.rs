use super::*;
use base64::Engine as _;
use engine::{Scene, Up};
use serde_json::{Value, json};

fn load_value(json: &Value, scene: Option<u32>) -> Result<(Object, Notes), NodeError> {
    load_bytes(json.to_string().as_bytes(), scene)
}

fn load_bytes(bytes: &[u8], scene: Option<u32>) -> Result<(Object, Notes), NodeError> {
    let cx =
        Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
    let mut notes = Notes::none();
    let path = InputFile("a.gltf".to_owned());
    object(&path, bytes, Want::Everything, (scene, None), &cx, &mut notes).map(|object| (object, notes))
}

fn base64(bytes: &[u8]) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// A document with one triangle, whose normal is +z, and the single node `node`.
fn triangle(node: Value) -> Value {
    let mut bytes: Vec<u8> = Vec::new();
    for v in [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        bytes.extend(v.iter().flat_map(|c| c.to_le_bytes()));
    }
    for v in [[0.0_f32, 0.0, 1.0]; 3] {
        bytes.extend(v.iter().flat_map(|c| c.to_le_bytes()));
    }
    for i in [0_u16, 1, 2, 0] {
        bytes.extend(i.to_le_bytes());
    }
    for uv in [[0.0_f32, 0.0], [1.0, 0.0], [0.0, 1.0]] {
        bytes.extend(uv.iter().flat_map(|c| c.to_le_bytes()));
    }
    json!({
        "asset": {"version": "2.0"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 3}, "indices": 2}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0.0, 0.0, 0.0], "max": [1.0, 1.0, 0.0]},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5123, "count": 3, "type": "SCALAR"},
            {"bufferView": 3, "componentType": 5126, "count": 3, "type": "VEC2"}
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 36},
            {"buffer": 0, "byteOffset": 72, "byteLength": 8}, {"buffer": 0, "byteOffset": 80, "byteLength": 24}
        ],
        "buffers": [{"byteLength": bytes.len(), "uri": format!("data:application/octet-stream;base64,{}", base64(&bytes))}]
    })
}

fn push(json: &mut Value, list: &str, value: Value) {
    if let Some(list) = json[list].as_array_mut() {
        list.push(value);
    }
}

fn good(json: &Value) -> (Object, Notes) {
    load_value(json, None).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn node_transforms_move_points_and_turn_normals_by_the_inverse_transpose() {
    let mut json = triangle(json!({"children": [1], "translation": [0.0, 0.0, 5.0]}));
    // A quarter turn about x, then a scale that shears nothing: z becomes -y.
    let node =
        json!({"mesh": 0, "rotation": [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()], "scale": [2.0, 3.0, 4.0]});
    push(&mut json, "nodes", node);
    let (object, notes) = good(&json);
    let p = &object.primitives[0];
    let near = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6);
    assert!(
        near(p.positions[1], [2.0, 0.0, 5.0]) && near(p.positions[2], [0.0, 0.0, 8.0]),
        "{:?}",
        p.positions
    );
    assert!(near(p.normals[0], [0.0, -1.0, 0.0]), "{:?}", p.normals[0]);
    assert_eq!(object.materials.len(), 1, "the default one");
    assert_eq!(notes.iter().count(), 0);
}

/// If the transform of a node mirrors its mesh, the winding of the triangles is reversed, so that they still face
/// along their normals.
#[test]
fn mirrors_flip_winding_and_keep_normals_outside() {
    let (object, notes) = good(&triangle(json!({"mesh": 0, "scale": [-1.0, 1.0, 1.0]})));
    let p = &object.primitives[0];
    assert_eq!(
        (p.triangles[0], p.normals[0], p.positions[1]),
        ([0, 2, 1], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0])
    );
    assert!(notes.iter().any(|n| n.id == "mirrored"));
}

/// A quaternion of any length rotates and does not scale; a matrix may shear, and a normal stays perpendicular to
/// the sheared surface.
#[test]
fn quaternions_of_any_length_turn_and_normals_stay_upright_under_shear() {
    for length in [1e-6, 1.0, 7.0] {
        let turn = [0.0, 0.0, length * 0.5_f64.sqrt(), length * 0.5_f64.sqrt()];
        let (object, _) = good(&triangle(json!({"mesh": 0, "rotation": turn})));
        let corner = object.primitives[0].positions[1];
        assert!(
            corner.iter().zip([0.0, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6),
            "{length}: {corner:?}"
        );
    }
    // In column-major order: z grows with x, so the triangle leans and its normal with it.
    let shear = [1.0, 0.0, 2.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let (object, _) = good(&triangle(json!({"mesh": 0, "matrix": shear})));
    let p = &object.primitives[0];
    let [a, b, c] = p.triangles[0].map(|i| glam::Vec3::from_array(p.positions[i as usize]));
    let upright = (b - a).cross(c - a).normalize();
    for normal in &p.normals {
        assert!((glam::Vec3::from_array(*normal) - upright).length() < 1e-6, "{normal:?} {upright}");
    }
}

#[test]
fn modes_become_triangles() {
    for (mode, expected) in [(5, Some([0, 1, 2])), (6, Some([0, 1, 2])), (4, Some([0, 1, 2])), (1, None)] {
        let mut json = triangle(json!({"mesh": 0}));
        json["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        let triangles = load_value(&json, None).ok().map(|(object, _)| object.primitives[0].triangles[0]);
        assert_eq!(triangles, expected, "mode {mode}");
    }
}

#[test]
fn normal_maps_get_tangents_even_without_normals() {
    let mut json = triangle(json!({"mesh": 0}));
    let picture = Raster {
        width: 1,
        height: 1,
        channels: 3,
        largest: 65_535,
        codes: vec![32_768, 32_768, 65_535],
        ignored: vec![],
        colour: None,
    };
    let png = crate::io::png::write(&picture, false, &[]).unwrap_or_else(|e| panic!("{e}"));
    json["images"] = json!([{"uri": format!("data:image/png;base64,{}", base64(&png))}]);
    json["textures"] = json!([{"source": 0}]);
    json["materials"] = json!([{"normalTexture": {"index": 0}}]);
    json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let (object, notes) = good(&json);
    // Its v runs along y, so that up the picture is against y.
    assert_eq!(object.primitives[0].tangents, [[1.0, 0.0, 0.0, -1.0]; 3]);
    assert_eq!(object.textures, [Texture { width: 1, height: 1, rgba: vec![128, 128, 255, 255] }]);
    assert!(
        notes.iter().any(|n| n.id == "textures-narrowed") && notes.iter().any(|n| n.id == "tangents-made")
    );
    if let Some(a) = json["meshes"][0]["primitives"][0]["attributes"].as_object_mut() {
        a.remove("NORMAL");
    }
    let (flat, _) = good(&json);
    assert_eq!(flat.primitives[0].normals, [[0.0, 0.0, 1.0]; 3]);
    assert_eq!(flat.primitives[0].tangents, [[1.0, 0.0, 0.0, -1.0]; 3]);
}

#[test]
fn skins_follow_their_joints_alone() {
    let mut json = triangle(json!({"mesh": 0, "skin": 0, "translation": [9.0, 9.0, 9.0]}));
    push(&mut json, "nodes", json!({"translation": [0.0, 2.0, 0.0]}));
    json["scenes"][0]["nodes"] = json!([0, 1]);
    json["skins"] = json!([{"joints": [1]}]);
    push(
        &mut json,
        "accessors",
        json!({"bufferView": 4, "byteOffset": 48, "componentType": 5121, "count": 3, "type": "VEC4"}),
    );
    push(&mut json, "accessors", json!({"bufferView": 4, "componentType": 5126, "count": 3, "type": "VEC4"}));
    let mut weights: Vec<u8> =
        [[1.0_f32, 0.0, 0.0, 0.0]; 3].as_flattened().iter().flat_map(|w| w.to_le_bytes()).collect();
    weights.extend([0; 12]); // joint 0 for all
    push(
        &mut json,
        "buffers",
        json!({"byteLength": 60, "uri": format!("data:;base64,{}", base64(&weights))}),
    );
    push(&mut json, "bufferViews", json!({"buffer": 1, "byteLength": 60}));
    json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(4);
    json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(5);
    let (object, _) = good(&json);
    assert_eq!(object.primitives[0].positions[1], [1.0, 2.0, 0.0]);
}

// EXT_mesh_gpu_instancing: one copy of the mesh per instance, within the frame of the node.
#[test]
fn instances_stand_where_their_attributes_say() {
    let mut json = triangle(json!({"mesh": 0, "translation": [0.0, 0.0, 5.0]}));
    let numbers: Vec<u8> = [1.0_f32, 0.0, 0.0, 2.0, 0.0, 0.0, 3.0, 3.0, 3.0, 1.0, 1.0, 1.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let uri = format!("data:;base64,{}", base64(&numbers));
    push(&mut json, "buffers", json!({"byteLength": 48, "uri": uri}));
    push(&mut json, "bufferViews", json!({"buffer": 1, "byteLength": 48}));
    let triples = |offset, count| json!({"bufferView": 4, "byteOffset": offset, "componentType": 5126, "count": count, "type": "VEC3"});
    push(&mut json, "accessors", triples(0, 2));
    push(&mut json, "accessors", triples(24, 2));
    push(&mut json, "accessors", triples(24, 1));
    json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    json["nodes"][0]["extensions"] =
        json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 4, "SCALE": 5}}});
    let (object, notes) = good(&json);
    let second = |i: usize| object.primitives[i].positions[1];
    assert_eq!((object.primitives.len(), second(0), second(1)), (2, [4.0, 0.0, 5.0], [3.0, 0.0, 5.0]));
    assert!(notes.iter().any(|n| n.id == "instances"));
    json["nodes"][0]["extensions"] =
        json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 4, "SCALE": 6}}});
    assert!(load_value(&json, None).is_err(), "two places and one scale");
    json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 9}}});
    assert!(load_value(&json, None).is_err(), "no such accessor");
}

#[test]
fn an_accessor_without_numbers_is_zeros() {
    // As Blender writes a shape key without displacements.
    let mut json = triangle(json!({"mesh": 0}));
    push(&mut json, "accessors", json!({"componentType": 5126, "count": 3, "type": "VEC3"}));
    json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": 4}]);
    json["meshes"][0]["weights"] = json!([1.0]);
    assert_eq!(good(&json).0.primitives[0].positions[1], [1.0, 0.0, 0.0]);
    // An index of 0 for every corner leaves no triangle with an area.
    json["meshes"][0]["primitives"][0]["indices"] = json!(5);
    push(&mut json, "accessors", json!({"componentType": 5123, "count": 3, "type": "SCALAR"}));
    let reported = load_value(&json, None).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(reported.contains("with a nonzero area"), "{reported}");
}

#[test]
fn other_formats_are_named() {
    for (name, bytes, format) in [
        ("chair.obj", &b"v 0 0 0"[..], "Wavefront OBJ"),
        ("chair.OBJ", b"# made by hand", "Wavefront OBJ"),
        ("chair.bin", b"Kaydara FBX Binary  ", "FBX"),
        ("chair.stl", b"\x00\x01", "STL"),
        ("chair.glb", b"ply\nformat ascii 1.0", "PLY"),
    ] {
        let reported = parse(name, bytes).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(reported.contains(&format!("{format}, where glTF, OBJ or STL is expected")), "{reported}");
    }
    let reported = parse("a.gltf", b"{").err().map(|e| e.to_string()).unwrap_or_default();
    assert!(reported.contains("JSON cannot be parsed"), "{reported}");
}

/// A document whose material has the picture `bytes` as its texture `pointer`.
fn pictured(bytes: &[u8], material: Value) -> Value {
    let mut json = triangle(json!({"mesh": 0}));
    json["images"] = json!([{"uri": format!("data:image/png;base64,{}", base64(bytes))}]);
    json["textures"] = json!([{"source": 0}]);
    json["materials"] = json!([material]);
    json["meshes"][0]["primitives"][0]["material"] = json!(0);
    json
}

fn png_of(codes: Vec<u16>) -> Vec<u8> {
    let raster =
        Raster { width: 1, height: 1, channels: 4, largest: 255, codes, ignored: vec![], colour: None };
    crate::io::png::write(&raster, false, &[]).unwrap_or_else(|e| panic!("{e}"))
}

// The specular colour of specular-glossiness is kept, and its glossiness becomes a texture of roughness. In an earlier
// version gold became black.
#[test]
fn specular_glossiness_keeps_metals() {
    let gold = json!({"extensions": {"KHR_materials_pbrSpecularGlossiness":
        {"diffuseFactor": [0.0, 0.0, 0.0, 1.0], "specularFactor": [0.9, 0.6, 0.2], "glossinessFactor": 0.75}}});
    let (object, _) = good(&pictured(&png_of(vec![1, 2, 3, 4]), gold));
    let m = &object.materials[0];
    assert_eq!((m.base_colour, m.metallic, m.roughness), ([0.0, 0.0, 0.0, 1.0], 0.0, 0.25));
    assert_eq!(m.specular.strength.factor, 1.0);
    let root = (m.ior - 1.0) / (m.ior + 1.0);
    for (c, wanted) in m.specular.colour.factor.iter().zip([0.9, 0.6, 0.2]) {
        assert!((root * root * c - wanted).abs() < 1e-5, "{m:?}");
    }
    assert!(object.textures.is_empty());
    let mapped = json!({"extensions": {"KHR_materials_pbrSpecularGlossiness":
        {"specularGlossinessTexture": {"index": 0}, "glossinessFactor": 0.5}}});
    let (object, _) = good(&pictured(&png_of(vec![200, 100, 50, 102]), mapped));
    let m = &object.materials[0];
    let texel = |texture: Option<crate::types::TextureRef>| {
        object.textures[texture.unwrap_or_else(|| panic!("a texture")).texture as usize].rgba.clone()
    };
    assert_eq!(texel(m.specular.colour.texture), [200, 100, 50, 102]);
    assert_eq!((texel(m.metallic_roughness_texture), m.roughness), (vec![0, 204, 0, 255], 1.0));
}

// Profiles, which glTF ignores, are reported.
#[test]
fn profiles_of_textures_are_reported() {
    let decoded = |ignored: &[&str]| {
        let ignored = ignored.iter().map(|&text| text.to_owned()).collect();
        Decoded::of(
            Raster { width: 1, height: 1, channels: 1, largest: 255, codes: vec![7], ignored, colour: None },
            None,
        )
    };
    let mut notes = Notes::none();
    report_profiles(
        &[decoded(&["an ICC profile (`P3`)"]), decoded(&[]), decoded(&["an ICC profile (`P3`)"])],
        &mut notes,
    );
    let all: Vec<_> = notes.iter().map(|note| (note.id.as_str(), note.text.as_str())).collect();
    assert_eq!(all.len(), 1);
    assert!(all[0].0 == "profile-ignored" && all[0].1.contains("(`P3`) (number: 2)"), "{all:?}");
    // A PNG with a chunk that declares another gamma.
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 1, 1);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_source_gamma(png::ScaledFloat::new(1.0));
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&[9, 9, 9]))
        .unwrap_or_else(|e| panic!("{e}"));
    let (_, notes) = good(&pictured(&bytes, json!({"emissiveTexture": {"index": 0}})));
    assert!(notes.iter().any(|note| note.id == "profile-ignored"));
}

// Placeholders and formats of phones inside a file are named.
#[test]
fn foreign_buffers_and_textures_are_named() {
    let lfs = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n";
    let reported = |json: &Value| load_value(json, None).err().map(|e| e.to_string()).unwrap_or_default();
    let text = reported(&pictured(lfs, json!({"emissiveTexture": {"index": 0}})));
    assert!(text.contains("git lfs pull"), "{text}");
    let text = reported(&pictured(b"\0\0\0\x18ftypheic\0\0\0\0", json!({"emissiveTexture": {"index": 0}})));
    assert!(text.contains("HEIC"), "{text}");
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
    std::fs::write(folder.path().join("a.bin"), lfs).unwrap_or_else(|e| panic!("{e}"));
    let mut json = triangle(json!({"mesh": 0}));
    json["buffers"][0]["uri"] = json!("a.bin");
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let (cx, path) = (Context::detached(scene, folder.path()), InputFile("a.gltf".to_owned()));
    let read =
        object(&path, json.to_string().as_bytes(), Want::Everything, (None, None), &cx, &mut Notes::none());
    let text = read.err().map(|e| e.to_string()).unwrap_or_default();
    assert!(text.contains("a.bin") && text.contains("git lfs pull"), "{text}");
}

#[test]
fn webp_pictures_are_read_and_preferred() {
    let mut json = triangle(json!({"mesh": 0}));
    let mut picture = Vec::new();
    image_webp::WebPEncoder::new(&mut picture)
        .encode(&[10, 20, 30, 40], 1, 1, image_webp::ColorType::Rgba8)
        .unwrap_or_else(|e| panic!("{e}"));
    json["images"] =
        json!([{"uri": "absent.png"}, {"uri": format!("data:image/webp;base64,{}", base64(&picture))}]);
    json["textures"] = json!([{"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}}]);
    json["materials"] = json!([{"emissiveTexture": {"index": 0}}]);
    let (object, _) = good(&json);
    let decoded = [Texture { width: 1, height: 1, rgba: vec![10, 20, 30, 40] }];
    assert_eq!(object.textures, decoded);
    // As in files that require the extension: without a picture for readers that do not support it.
    json["images"].as_array_mut().expect("a list").remove(0);
    json["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 0}}}]);
    json["extensionsRequired"] = json!(["EXT_texture_webp"]);
    json["materials"] = json!([{"emissiveTexture": {"index": 0, "texCoord": 1}}]);
    json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let (object, notes) = good(&json);
    assert_eq!(object.textures, decoded);
    assert!(notes.iter().any(|n| n.id == "no-coordinates"), "there is no second set");
    json["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 7}}}]);
    assert!(load_value(&json, None).is_err(), "no such picture");
    json["textures"] = json!([{"extensions": {"EXT_texture_webp": 1}}]);
    assert!(load_value(&json, None).is_err(), "not an extension");
}

#[test]
fn what_makes_no_triangle_is_reported() {
    let mut json = triangle(json!({"mesh": 0}));
    let reported = |json: &Value| load_value(json, None).err().map(|e| e.to_string()).unwrap_or_default();
    json["meshes"][0]["primitives"][0]["mode"] = json!(0);
    assert!(reported(&json).contains("only points or lines (primitives: 1)"), "{}", reported(&json));
    json["meshes"][0]["primitives"][0]["mode"] = json!(4);
    json["nodes"][0]["scale"] = json!([1.0, 0.0, 0.0]);
    assert!(reported(&json).contains("were dropped (number: 1)"), "{}", reported(&json));
}

#[test]
fn scenes_are_chosen_and_cycles_refused() {
    let mut json = triangle(json!({"mesh": 0}));
    push(&mut json, "nodes", json!({"mesh": 0, "translation": [7.0, 0.0, 0.0]}));
    json["scenes"] = json!([{"nodes": [0]}, {"nodes": [1]}]);
    let (first, notes) = good(&json);
    assert!(notes.iter().any(|n| n.id == "scene"));
    assert_eq!(first.primitives[0].positions[0], [0.0; 3]);
    let second = load_value(&json, Some(1)).unwrap_or_else(|e| panic!("{e}")).0;
    assert_eq!(second.primitives[0].positions[0], [7.0, 0.0, 0.0]);
    assert!(load_value(&json, Some(2)).is_err());
    json["nodes"][0]["children"] = json!([1]);
    json["nodes"][1]["children"] = json!([0]);
    assert!(load_value(&json, None).is_err());
}

#[test]
fn hostile_documents_are_errors() {
    let base = triangle(json!({"mesh": 0}));
    let edits: [(&str, Value); 9] = [
        ("/accessors/0/count", json!(4_000_000_000_u64)),
        ("/accessors/0/byteOffset", json!(4)),
        ("/accessors/1/count", json!(2)),
        ("/accessors/2/componentType", json!(5125)),
        ("/bufferViews/0/byteOffset", json!(u64::MAX)),
        ("/bufferViews/0/byteLength", json!(u64::MAX)),
        ("/bufferViews/0/byteStride", json!(4)),
        ("/buffers/0/byteLength", json!(1000)),
        ("/nodes/0/mesh", json!(5)),
    ];
    for (pointer, value) in edits {
        let mut json = base.clone();
        match json.pointer_mut(pointer) {
            Some(slot) => *slot = value,
            None => {
                let (parent, key) = pointer.rsplit_once('/').unwrap_or_default();
                json.pointer_mut(parent)
                    .and_then(Value::as_object_mut)
                    .map(|o| o.insert(key.to_owned(), value));
            }
        }
        assert!(load_value(&json, None).is_err(), "{pointer}");
    }
}

#[test]
fn no_cut_or_flip_of_a_glb_panics_and_every_cut_is_an_error() {
    let json = triangle(json!({"mesh": 0}));
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((text.len() as u32 + 20).to_le_bytes());
    glb.extend((text.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(&text);
    assert_eq!(load_bytes(&glb, None).map(|o| o.0).ok(), Some(good(&json).0));
    for end in (0..glb.len()).step_by(3) {
        assert!(load_bytes(&glb[..end], None).is_err(), "cut at {end}");
    }
    for at in 0..glb.len() {
        {
            let mut hurt = glb.clone();
            hurt[at] ^= 1 << (at % 8);
            drop(load_bytes(&hurt, None));
        }
    }
}
