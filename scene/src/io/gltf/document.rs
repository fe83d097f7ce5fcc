//! The document of a glTF file as the crate `gltf` reads it.

use gltf::Document;
use serde_json::{Value, json};

use crate::error::Error;

/// Fills in what a file may leave out, but the crate requires.
pub fn repair(json: &mut Value) {
    if let Some(top) = json.as_object_mut() {
        // The supported extensions are checked before; the crate knows fewer of them.
        top.remove("extensionsRequired");
    }
    // A scene may be empty, which the crate does not support.
    for scene in json.get_mut("scenes").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(scene) = scene.as_object_mut() {
            scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
        }
    }
    // A texture may have its picture in the extension alone, which the crate does not support.
    for texture in json.get_mut("textures").and_then(Value::as_array_mut).into_iter().flatten() {
        let webp = texture["extensions"]["EXT_texture_webp"]["source"].clone();
        if let Some(texture) = texture.as_object_mut().filter(|texture| !texture.contains_key("source")) {
            texture.insert("source".to_owned(), webp);
        }
    }
    let views = json["bufferViews"].as_array().is_some_and(|views| !views.is_empty());
    for accessor in json.get_mut("accessors").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(accessor) = accessor.as_object_mut() {
            // Bounds of positions, which the crate requires, are often missing and never needed.
            for bound in ["min", "max"] {
                accessor.entry(bound).or_insert_with(|| Value::from(vec![0.0; 3]));
            }
            // An accessor without data and sparse values is all 0 (glTF 2.0, 3.6.2.3), which the crate treats as an
            // error.
            if views && !accessor.contains_key("bufferView") {
                accessor.entry("sparse").or_insert_with(|| {
                    json!({"count": 0, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}})
                });
            }
        }
    }
}

/// Reads the document. Animations are left out, since the crate requires a node for each channel, but channels of
/// extensions have no node; they are read from the JSON.
pub fn document(name: &str, json: &mut Value) -> Result<Document, Error> {
    let invalid = |text: String| {
        let text = text.trim().trim_end_matches(';').trim_start_matches("invalid glTF: ");
        Error::format(name, format!("not valid glTF: {text}"))
    };
    let animations = json.as_object_mut().and_then(|top| top.remove("animations"));
    let text = serde_json::to_vec(&json);
    if let (Some(top), Some(animations)) = (json.as_object_mut(), animations) {
        top.insert("animations".to_owned(), animations);
    }
    let text = text.map_err(|e| Error::format(name, e.to_string()))?;
    let root = gltf::json::deserialize::from_slice(&text).map_err(|e| invalid(e.to_string()))?;
    Document::from_json(root).map_err(|e| invalid(e.to_string()))
}
