//! Writes meshes as PLY, GLB or OBJ files, for `LoadMesh` and other programs.

use engine::Up;
use glam::{DMat4, DVec3};
use serde_json::json;

use crate::math::color::{code8, srgb_from_linear};
use crate::types::Mesh;
use crate::types::frame::world_from_gltf;

/// Formats of files with meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeshFormat {
    /// Binary PLY, in the coordinates of the world, with display colours in 8 bits.
    Ply,
    /// Binary glTF 2, with linear colours in f32.
    Glb,
    /// Wavefront OBJ, in the coordinates of the world, with display colours after the coordinates of each vertex.
    Obj,
}

impl MeshFormat {
    /// The format according to the extension of a path.
    pub fn of_path(path: &str) -> Option<Self> {
        match path.rsplit_once('.')?.1.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "glb" => Some(Self::Glb),
            "obj" => Some(Self::Obj),
            _ => None,
        }
    }
}

/// Returns the bytes of a file that contains the mesh. If `gltf_frame` is the up axis of the world and its metres
/// per unit, a GLB is converted to y up and metres. If it is `None`, coordinates are written unchanged. PLY and OBJ
/// are never converted.
pub fn encode(mesh: &Mesh, format: MeshFormat, gltf_frame: Option<(Up, f64)>) -> Vec<u8> {
    match format {
        MeshFormat::Ply => ply(mesh),
        MeshFormat::Obj => obj(mesh),
        MeshFormat::Glb => {
            let frame =
                gltf_frame.map_or(DMat4::IDENTITY, |(up, metres)| world_from_gltf(up, metres).inverse());
            glb(mesh, frame)
        }
    }
}

fn display(colour: &[f32; 3]) -> [u8; 3] {
    colour.map(|c| code8(srgb_from_linear(c)))
}

fn ply(mesh: &Mesh) -> Vec<u8> {
    // f64 only where f32 would lose something.
    let fine = !mesh.positions_low.is_empty();
    let number = if fine { "double" } else { "float" };
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len());
    for axis in ["x", "y", "z"] {
        head += &format!("property {number} {axis}\n");
    }
    if !mesh.colours.is_empty() {
        head += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    }
    head += &format!(
        "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.triangles.len()
    );
    let mut bytes = head.into_bytes();
    for (index, position) in mesh.positions.iter().enumerate() {
        if fine {
            mesh.position(index as u32).to_array().iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        } else {
            position.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        }
        bytes.extend(mesh.colours.get(index).map(display).iter().flatten());
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        triangle.iter().for_each(|index| bytes.extend((*index as i32).to_le_bytes()));
    }
    bytes
}

fn obj(mesh: &Mesh) -> Vec<u8> {
    let mut text = String::new();
    for index in 0..mesh.positions.len() {
        let [x, y, z] = match mesh.positions_low.is_empty() {
            // The shortest text that reads back to the same f32.
            true => mesh.positions[index].map(|v| v.to_string()),
            false => mesh.position(index as u32).to_array().map(|v| v.to_string()),
        };
        text += &format!("v {x} {y} {z}");
        if let Some(colour) = mesh.colours.get(index) {
            let [r, g, b] = colour.map(|c| srgb_from_linear(c.clamp(0.0, 1.0)));
            text += &format!(" {r:.5} {g:.5} {b:.5}");
        }
        text.push('\n');
    }
    for [a, b, c] in &mesh.triangles {
        text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
    }
    text.into_bytes()
}

/// A GLB with one node at the middle of the mesh, so that coordinates relative to it are precise in f32.
fn glb(mesh: &Mesh, frame: DMat4) -> Vec<u8> {
    let places: Vec<DVec3> =
        (0..mesh.positions.len() as u32).map(|index| frame.transform_point3(mesh.position(index))).collect();
    let fine = !mesh.positions_low.is_empty();
    let middle = if fine { places.iter().sum::<DVec3>() / places.len().max(1) as f64 } else { DVec3::ZERO };
    let local: Vec<[f32; 3]> = places.iter().map(|place| (*place - middle).as_vec3().to_array()).collect();
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in &local {
        low = std::array::from_fn(|k| low[k].min(position[k]));
        high = std::array::from_fn(|k| high[k].max(position[k]));
    }
    let mut binary = Vec::new();
    let mut views = Vec::new();
    let mut view = |bytes: Vec<u8>, target: u32| {
        views.push(
            json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len(), "target": target }),
        );
        binary.extend(bytes);
    };
    let floats =
        |rows: &[[f32; 3]]| rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    view(floats(&local), 34962);
    let indices = mesh.triangles.as_flattened();
    view(indices.iter().flat_map(|v| v.to_le_bytes()).collect(), 34963);
    let count = local.len();
    let mut accessors = vec![
        json!({ "bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3", "min": low, "max": high }),
        json!({ "bufferView": 1, "componentType": 5125, "count": indices.len(), "type": "SCALAR" }),
    ];
    let mut attributes = json!({ "POSITION": 0 });
    if !mesh.colours.is_empty() {
        view(floats(&mesh.colours), 34962);
        accessors.push(json!({ "bufferView": 2, "componentType": 5126, "count": count, "type": "VEC3" }));
        attributes["COLOR_0"] = json!(2);
    }
    let mut node = json!({ "mesh": 0 });
    if fine {
        node["translation"] = json!(middle.to_array());
    }
    let document = json!({
        "asset": { "version": "2.0", "generator": "lightharmony" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": 1, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 } }],
        "buffers": [{ "byteLength": binary.len() }],
        "bufferViews": views,
        "accessors": accessors,
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = Vec::with_capacity(28 + text.len() + binary.len());
    bytes.extend(b"glTF");
    for number in [2, 28 + text.len() + binary.len(), text.len()] {
        bytes.extend((number as u32).to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(binary);
    bytes
}
