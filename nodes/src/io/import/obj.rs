//! Wavefront OBJ, read by the crate `tobj`: shapes, normals, texture coordinates, vertex colours, and the diffuse
//! colours and textures of its materials.

use std::collections::BTreeSet;

use engine::{NodeError, Notes};
use serde_json::json;
use tobj::LoadOptions;

use super::glb::{Builder, GlbMesh};
use crate::error::Error;
use crate::io::foreign::{BYTE_ORDER_MARK, refuse_foreign};
use crate::math::num;

/// Converts backslashes, with which exporters on Windows separate folders, to slashes. Returns `None` unless the
/// result is a relative path.
fn relative(path: &str) -> Option<String> {
    let path = path.trim().trim_matches('"').replace('\\', "/");
    let drive = path.as_bytes().get(1) == Some(&b':');
    (!path.is_empty() && !path.starts_with('/') && !drive && !path.contains("://") && !path.contains('\0'))
        .then_some(path)
}

/// The rest of each line that begins with `word`.
fn values<'a>(bytes: &'a [u8], word: &'a str) -> impl Iterator<Item = String> + 'a {
    bytes.split(|b| *b == b'\n').filter_map(move |line| {
        let line = std::str::from_utf8(line).ok()?.trim();
        let rest = line.strip_prefix(word)?;
        rest.starts_with([' ', '\t']).then(|| rest.trim().to_owned())
    })
}

/// The file name in a texture statement, without the options before it, such as `-s 1 1 1`.
fn map_path(value: &str) -> Option<String> {
    let mut words = value.split_ascii_whitespace().peekable();
    while let Some(option) = words.peek().copied().filter(|word| word.starts_with('-')) {
        words.next();
        let count = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        for _ in 0..count {
            // Offsets and scales may have fewer numbers.
            if count == 1 || words.peek().is_some_and(|word| word.parse::<f32>().is_ok()) {
                words.next();
            }
        }
    }
    relative(&words.collect::<Vec<_>>().join(" "))
}

/// Names of the material files, followed by the names of the pictures to which they refer.
pub(super) fn other_files(bytes: &[u8], read: &mut impl FnMut(&str) -> Option<Vec<u8>>) -> Vec<String> {
    let libraries: BTreeSet<String> = values(bytes, "mtllib").filter_map(|name| relative(&name)).collect();
    let mut files = Vec::new();
    for library in libraries {
        let Some(text) = read(&library) else { continue };
        let folder = library.rsplit_once('/').map_or(String::new(), |(folder, _)| format!("{folder}/"));
        let maps: BTreeSet<String> = values(&text, "map_Kd").filter_map(|value| map_path(&value)).collect();
        files.push(library);
        for map in maps.into_iter().map(|map| format!("{folder}{map}")).filter(|map| read(map).is_some()) {
            if !files.contains(&map) {
                files.push(map);
            }
        }
    }
    files
}

/// Reads shapes and materials.
pub(super) fn read(
    name: &str,
    bytes: &[u8],
    read_file: &dyn Fn(&str) -> Result<Vec<u8>, NodeError>,
    builder: &mut Builder,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    refuse_foreign(name, bytes)?;
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let wrong = |e: tobj::LoadError| Error::format(name, format!("not a Wavefront OBJ file: {e}"));
    // All libraries as one text: names of materials are those of the whole file.
    let (mut text, mut folder) = (Vec::new(), String::new());
    let libraries: BTreeSet<String> = values(bytes, "mtllib").filter_map(|name| relative(&name)).collect();
    for library in libraries {
        match read_file(&library) {
            Ok(read) => {
                folder = library.rsplit_once('/').map_or(String::new(), |(folder, _)| format!("{folder}/"));
                text.extend_from_slice(read.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&read));
                text.push(b'\n');
            }
            Err(_) => {
                let what = format!(
                    "the material file `{library}` cannot be read; the faces that use its materials are white"
                );
                notes.degraded("materials-missing", what);
            }
        }
    }
    let options =
        LoadOptions { triangulate: true, single_index: true, ignore_lines: true, ignore_points: true };
    let (models, materials) =
        tobj::load_obj_buf(&mut &*bytes, &options, |_| tobj::load_mtl_buf(&mut &*text)).map_err(wrong)?;
    let materials = materials.unwrap_or_default();
    for material in &materials {
        let texture = material.diffuse_texture.as_deref().and_then(map_path);
        let texture = texture.map(|path| format!("{folder}{path}"));
        let texture = texture.filter(|path| {
            let found = read_file(path).is_ok();
            if !found {
                notes.degraded("texture-missing", format!("the texture `{path}` cannot be read"));
            }
            found
        });
        let colour = material.diffuse.filter(|_| texture.is_none()).unwrap_or([1.0; 3]);
        let opacity = material.dissolve.filter(|d| d.is_finite()).unwrap_or(1.0).clamp(0.0, 1.0);
        // By the exponent of Blinn and Phong: alpha^2 = 2 / (n + 2), and alpha is the square of the roughness.
        let exponent = f64::from(material.shininess.filter(|n| n.is_finite()).unwrap_or(0.0).max(0.0));
        let roughness = num::pow(2.0 / (exponent + 2.0), 0.25);
        let [r, g, b] = colour;
        let mut made = json!({
            "name": material.name,
            "pbrMetallicRoughness":
                {"baseColorFactor": [r, g, b, opacity], "metallicFactor": 0.0, "roughnessFactor": roughness},
            "emissiveFactor": material.emissive.unwrap_or_default(),
        });
        if opacity < 1.0 {
            made["alphaMode"] = "BLEND".into();
        }
        if let Some(path) = texture {
            let index = builder.texture(&path);
            made["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": index});
        }
        builder.materials.push(made);
    }
    for model in models {
        let mesh = model.mesh;
        let three = |list: &[f32]| list.as_chunks::<3>().0.to_vec();
        // Row 0 of a picture is at the top in glTF, and at the bottom here.
        let uv = mesh.texcoords.as_chunks::<2>().0.iter().map(|[u, v]| [*u, 1.0 - v]).collect();
        builder.add(&GlbMesh {
            positions: three(&mesh.positions),
            normals: three(&mesh.normals),
            uv,
            colours: three(&mesh.vertex_color),
            indices: mesh.indices,
            material: mesh.material_id,
        });
    }
    notes.decision(
        "frame-of-obj",
        "OBJ defines neither an up axis nor a unit; y is assumed to be up, and the unit to be the metre",
    );
    Ok(())
}
