//! Conversion of the materials of an OBJ file to materials of glTF.

use std::collections::BTreeMap;

use engine::{NodeError, Notes};
use serde_json::json;

use super::glb::Builder;
use super::mtl::{self, Material};
use crate::io::colour_range::Range;
use crate::io::foreign::refuse_foreign;
use crate::math::num;

/// Adds the materials of all material files. Returns their indices by name, and whether all files could be used.
/// The last definition of a name counts.
pub(super) fn materials(
    bytes: &[u8],
    beside: &dyn Fn(&str) -> Result<Vec<u8>, NodeError>,
    builder: &mut Builder,
    notes: &mut Notes,
) -> (BTreeMap<String, usize>, bool) {
    let (mut by_name, mut complete) = (BTreeMap::new(), true);
    let mut read = |name: &str| beside(name).ok();
    let white = "the faces that use its materials are white";
    let mut parsed = Vec::new();
    for library in mtl::libraries(bytes, &mut read) {
        let path = &library.path;
        let Some(text) = &library.bytes else {
            complete = false;
            let what = format!("the material file `{path}` cannot be read; {white}");
            notes.degraded("materials-missing", what);
            continue;
        };
        let found = mtl::parse(text);
        if found.materials.is_empty() {
            complete = false;
            let why = refuse_foreign(path, text).err().map_or_else(
                || format!("the material file `{path}` defines no material"),
                |error| error.to_string(),
            );
            notes.degraded("materials-missing", format!("{why}; {white}"));
            continue;
        }
        if let Some((line, first)) = found.wrong.first() {
            let what = format!(
                "lines of the material file `{path}` cannot be read and are ignored (count: {}; the first is line {line}, `{first}`)",
                found.wrong.len()
            );
            notes.degraded("material-lines-ignored", what);
        }
        if !found.ignored.is_empty() {
            let named: Vec<&str> = found.ignored.iter().map(String::as_str).collect();
            let what = format!(
                "these keywords and options of the material file `{path}` are ignored: {}",
                named.join(", ")
            );
            notes.warning("material-ignored", what);
        }
        parsed.push((library, found.materials));
    }
    let all = || parsed.iter().flat_map(|(_, materials)| materials);
    let diffuse = all().filter_map(|material| material.diffuse).flatten().map(f64::from);
    let range = Range::of_floats(diffuse);
    if range.guessed {
        notes.warning("colour-range", format!("the colours `Kd` are assumed to range {}", range.words()));
    }
    for (library, list) in &parsed {
        for material in list {
            let texture = material.texture.as_ref().filter(|texture| {
                let path = library.sibling(&texture.path);
                let found = beside(&path).is_ok();
                if !found {
                    notes.degraded("texture-missing", format!("the texture `{path}` cannot be read"));
                }
                found
            });
            if material.opacity.is_some_and(|opacity| opacity <= 0.0) {
                let what = format!("the material `{}` is invisible: its opacity `d` is 0", material.name);
                notes.warning("material-invisible", what);
            }
            let texture = texture.map(|texture| {
                let index = builder.texture(&library.sibling(&texture.path));
                let ([u, v], [su, sv]) = (texture.offset, texture.scale);
                // v runs downwards in glTF.
                let moved = json!({"offset": [u, 1.0 - sv - v], "scale": [su, sv]});
                let info = json!({"index": index});
                if ([u, v], [su, sv]) == ([0.0; 2], [1.0; 2]) {
                    info
                } else {
                    json!({"index": index, "extensions": {"KHR_texture_transform": moved}})
                }
            });
            by_name.insert(material.name.clone(), builder.materials.len());
            builder.materials.push(as_json(material, texture, range.white as f32));
        }
    }
    (by_name, complete)
}

/// A material as JSON of glTF. `white` is the value of `Kd` that stands for white.
fn as_json(material: &Material, texture: Option<serde_json::Value>, white: f32) -> serde_json::Value {
    let colour =
        material.diffuse.filter(|_| texture.is_none()).map_or([1.0; 3], |rgb| rgb.map(|c| c / white));
    let opacity = material.opacity.unwrap_or(1.0).clamp(0.0, 1.0);
    // By the exponent of Blinn and Phong: alpha^2 = 2 / (n + 2), and alpha is the square of the roughness.
    let exponent = f64::from(material.exponent.unwrap_or(0.0).max(0.0));
    let roughness = material.roughness.map_or_else(|| num::pow(2.0 / (exponent + 2.0), 0.25), f64::from);
    let emissive = material.emissive.unwrap_or_default();
    // Factors of glTF are at most 1.
    let strength = emissive.iter().fold(1.0_f32, |most, e| most.max(*e));
    let [r, g, b] = colour;
    let mut made = json!({
        "name": material.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [r, g, b, opacity],
            "metallicFactor": material.metallic.unwrap_or(0.0),
            "roughnessFactor": roughness,
        },
        "emissiveFactor": emissive.map(|e| e / strength),
    });
    if strength > 1.0 {
        made["extensions"] = json!({"KHR_materials_emissive_strength": {"emissiveStrength": strength}});
    }
    if opacity < 1.0 {
        made["alphaMode"] = "BLEND".into();
    }
    if let Some(texture) = texture {
        made["pbrMetallicRoughness"]["baseColorTexture"] = texture;
    }
    made
}
