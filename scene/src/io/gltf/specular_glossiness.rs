//! Materials of the extension `KHR_materials_pbrSpecularGlossiness`, converted to metallic-roughness.

use serde_json::{Value, json};

/// Name of the extension for specular-glossiness, which the crate `gltf` does not read.
pub(crate) const NAME: &str = "KHR_materials_pbrSpecularGlossiness";

/// Replaces specular-glossiness with metallic-roughness and two extensions, as Blender does: the diffuse colour
/// becomes the base colour of a dielectric, and the specular colour its reflectance at normal incidence
/// (`KHR_materials_ior`, `KHR_materials_specular`). Roughness is one minus glossiness; `Materials` derives its
/// texture from the alpha of the texture.
pub(super) fn replace(json: &mut Value) {
    for material in json.get_mut("materials").and_then(Value::as_array_mut).into_iter().flatten() {
        let Some(gloss) = material["extensions"].get(NAME).cloned() else { continue };
        let mapped = gloss.get("specularGlossinessTexture");
        // The texture then holds the roughness.
        let roughness = if mapped.is_some() { 1.0 } else { 1.0 - glossiness(&gloss) };
        let mut plain = json!({"metallicFactor": 0.0, "roughnessFactor": roughness});
        for (from, to) in [("diffuseFactor", "baseColorFactor"), ("diffuseTexture", "baseColorTexture")] {
            if let Some(value) = gloss.get(from) {
                plain[to] = value.clone();
            }
        }
        let (ior, colour) =
            reflectance([0, 1, 2].map(|k| gloss["specularFactor"][k].as_f64().unwrap_or(1.0)));
        let mut specular = json!({"specularColorFactor": colour});
        if let Some(texture) = mapped {
            specular["specularColorTexture"] = texture.clone();
        }
        material["pbrMetallicRoughness"] = plain;
        material["extensions"]["KHR_materials_ior"] = json!({"ior": ior});
        material["extensions"]["KHR_materials_specular"] = specular;
    }
}

/// Index of refraction and specular colour of a dielectric whose reflectance at normal incidence is `specular`. The
/// index, as `KHR_materials_ior` defines it, gives the largest of the three numbers; 0 means infinite.
fn reflectance(specular: [f64; 3]) -> (f64, [f64; 3]) {
    let specular = specular.map(|c| c.clamp(0.0, 1.0));
    let most = specular.iter().fold(0.0_f64, |most, c| most.max(*c));
    if most > 0.99 {
        return (0.0, specular);
    }
    let root = most.sqrt();
    ((1.0 + root) / (1.0 - root), specular.map(|c| if most > 0.0 { c / most } else { 0.0 }))
}

/// The factor of the glossiness, from 0 to 1, of the extension [`NAME`].
pub(crate) fn glossiness(gloss: &Value) -> f64 {
    gloss["glossinessFactor"].as_f64().unwrap_or(1.0).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::gltf::parse;

    #[test]
    fn specular_glossiness_keeps_diffuse_and_specular_colour() {
        let of = |gloss: &str| {
            let text = format!(
                r#"{{"asset":{{"version":"2.0"}},"extensionsRequired":["KHR_materials_pbrSpecularGlossiness"],
                "images":[{{"uri":"a.png"}}],"textures":[{{"source":0}}],"materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[1,1,1,1]}},
                "extensions":{{"KHR_materials_pbrSpecularGlossiness":{gloss}}}}}, {{"name": "other"}}]}}"#
            );
            let json = parse("a.gltf", text.as_bytes()).unwrap_or_else(|e| panic!("{e}")).json;
            assert!(json["materials"][1].get("pbrMetallicRoughness").is_none());
            let made = &json["materials"][0];
            assert!(made["extensions"]["KHR_materials_ior"]["ior"].is_number());
            (made["pbrMetallicRoughness"].clone(), made["extensions"]["KHR_materials_specular"].clone())
        };
        let red =
            r#"{"diffuseFactor":[0.8,0.2,0.1,1],"glossinessFactor":0.25,"specularFactor":[1,0.75,0.3]}"#;
        let (plain, specular) = of(red);
        assert_eq!(
            plain,
            json!({"baseColorFactor": [0.8, 0.2, 0.1, 1], "metallicFactor": 0.0, "roughnessFactor": 0.75})
        );
        assert_eq!(specular, json!({"specularColorFactor": [1.0, 0.75, 0.3]}));
        let (plain, specular) = of("{}");
        assert_eq!(plain, json!({"metallicFactor": 0.0, "roughnessFactor": 0.0}));
        assert_eq!(specular, json!({"specularColorFactor": [1.0, 1.0, 1.0]}));
        let (plain, _) = of(r#"{"diffuseTexture":{"index":0},"glossinessFactor":7}"#);
        assert_eq!(plain["baseColorTexture"]["index"], 0);
        let (plain, specular) = of(r#"{"specularGlossinessTexture":{"index":0},"glossinessFactor":0.5}"#);
        assert_eq!(
            (&plain["roughnessFactor"], &specular["specularColorTexture"]["index"]),
            (&json!(1.0), &json!(0))
        );
    }

    #[test]
    fn specular_colours_are_reflectances() {
        assert_eq!(reflectance([1.0, 0.75, 0.3]), (0.0, [1.0, 0.75, 0.3]));
        assert_eq!(reflectance([0.0; 3]), (1.0, [0.0; 3]));
        // That of a usual dielectric.
        let (ior, colour) = reflectance([0.04; 3]);
        assert!((ior - 1.5).abs() < 1e-12 && colour == [1.0; 3]);
        let (ior, colour) = reflectance([0.9, 0.6, 0.2]);
        let f0 = (ior - 1.0) / (ior + 1.0) * ((ior - 1.0) / (ior + 1.0));
        for (c, wanted) in colour.iter().zip([0.9, 0.6, 0.2]) {
            assert!((f0 * c - wanted).abs() < 1e-12);
        }
    }
}
