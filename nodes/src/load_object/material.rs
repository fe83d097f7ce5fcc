//! Materials of a glTF file, with the KHR extensions we know.

use std::collections::BTreeSet;

use engine::Notes;
use serde_json::Value;

use crate::Error;
use crate::types::{AlphaMode, Material, Sampler, TextureRef, TextureTransform, Wrap};

/// Reads materials, and finds which images they use.
pub struct Materials<'a> {
    name: &'a str,
    json: &'a Value,
    /// Indices of images in use, in the order of [`TextureRef::texture`].
    pub images: Vec<usize>,
    clamped: u64,
    ignored: BTreeSet<String>,
}

/// What a material may say and we do not draw. `true` where the picture is wrong without it.
const NOT_DRAWN: [(&str, &str); 10] = [
    ("KHR_materials_volume", "absorption inside"),
    ("KHR_materials_specular", "the strength of reflections"),
    ("KHR_materials_sheen", "sheen"),
    ("KHR_materials_anisotropy", "anisotropy"),
    ("KHR_materials_iridescence", "iridescence"),
    ("KHR_materials_dispersion", "dispersion"),
    ("KHR_materials_unlit", "being unlit"),
    ("KHR_materials_variants", "variants"),
    ("KHR_materials_pbrSpecularGlossiness", "specular-glossiness"),
    ("KHR_materials_diffuse_transmission", "diffuse transmission"),
];

impl<'a> Materials<'a> {
    /// A reader of the materials in `json`.
    pub fn new(name: &'a str, json: &'a Value) -> Self {
        Self { name, json, images: Vec::new(), clamped: 0, ignored: BTreeSet::new() }
    }

    /// Every material of the file, in order.
    pub fn read(&mut self, notes: &mut Notes) -> Result<Vec<Material>, Error> {
        let list = self.json["materials"].as_array().map(Vec::as_slice).unwrap_or_default();
        let materials = list.iter().map(|m| self.material(m)).collect::<Result<_, _>>()?;
        if self.clamped > 0 {
            notes.count(
                "factors-clamped",
                self.clamped,
                "material factors outside of their range were clamped",
            );
        }
        for what in &self.ignored {
            notes.degraded("material-ignored", what.clone());
        }
        Ok(materials)
    }

    fn material(&mut self, m: &Value) -> Result<Material, Error> {
        let pbr = &m["pbrMetallicRoughness"];
        let extension = |name: &str| &m["extensions"][name];
        let alpha_mode = match m["alphaMode"].as_str() {
            Some("MASK") => AlphaMode::Mask(self.factor(&m["alphaCutoff"], 0.5, 0.0, f64::MAX)),
            Some("BLEND") => AlphaMode::Blend,
            _ => AlphaMode::Opaque,
        };
        let strength =
            self.factor(&extension("KHR_materials_emissive_strength")["emissiveStrength"], 1.0, 0.0, 1e12);
        let emissive: [f32; 3] = self.factors(&m["emissiveFactor"], 0.0, 1.0);
        let coat = extension("KHR_materials_clearcoat");
        let transmission = extension("KHR_materials_transmission");
        for (part, texture) in [
            (coat, "clearcoatTexture"),
            (coat, "clearcoatRoughnessTexture"),
            (coat, "clearcoatNormalTexture"),
            (transmission, "transmissionTexture"),
        ] {
            if part.get(texture).is_some() {
                self.ignored
                    .insert(format!("{texture} is left out; its factor applies to the whole material"));
            }
        }
        for (name, what) in NOT_DRAWN {
            if m["extensions"].get(name).is_some() {
                self.ignored.insert(format!("{name} is left out, so {what} does not show"));
            }
        }
        let ior = self.factor(&extension("KHR_materials_ior")["ior"], 1.5, 0.0, 1e3);
        Ok(Material {
            name: m["name"].as_str().unwrap_or_default().to_owned(),
            base_colour: self.factors(&pbr["baseColorFactor"], 1.0, 1.0),
            base_colour_texture: self.texture(&pbr["baseColorTexture"])?,
            metallic: self.factor(&pbr["metallicFactor"], 1.0, 0.0, 1.0),
            roughness: self.factor(&pbr["roughnessFactor"], 1.0, 0.0, 1.0),
            metallic_roughness_texture: self.texture(&pbr["metallicRoughnessTexture"])?,
            normal_scale: self.factor(&m["normalTexture"]["scale"], 1.0, -1e6, 1e6),
            normal_texture: self.texture(&m["normalTexture"])?,
            occlusion_strength: self.factor(&m["occlusionTexture"]["strength"], 1.0, 0.0, 1.0),
            occlusion_texture: self.texture(&m["occlusionTexture"])?,
            emissive: emissive.map(|e| e * strength),
            emissive_texture: self.texture(&m["emissiveTexture"])?,
            alpha_mode,
            double_sided: m["doubleSided"].as_bool().unwrap_or(false),
            // The extension gives 0 the meaning of an infinite index; anything else below 1 is none.
            ior: if ior == 0.0 { 1e3 } else { ior.max(1.0) },
            transmission: self.factor(&transmission["transmissionFactor"], 0.0, 0.0, 1.0),
            clearcoat: self.factor(&coat["clearcoatFactor"], 0.0, 0.0, 1.0),
            clearcoat_roughness: self.factor(&coat["clearcoatRoughnessFactor"], 0.0, 0.0, 1.0),
        })
    }

    fn factor(&mut self, value: &Value, default: f64, low: f64, high: f64) -> f32 {
        let value = value.as_f64().unwrap_or(default);
        self.clamped += u64::from(!(low..=high).contains(&value));
        value.clamp(low, high.min(f64::from(f32::MAX))) as f32
    }

    fn factors<const N: usize>(&mut self, value: &Value, default: f64, high: f64) -> [f32; N] {
        std::array::from_fn(|i| self.factor(&value[i], default, 0.0, high))
    }

    fn texture(&mut self, info: &Value) -> Result<Option<TextureRef>, Error> {
        let Some(index) = info["index"].as_u64() else { return Ok(None) };
        let texture = &self.json["textures"][index as usize];
        let Some(image) = texture["source"].as_u64() else {
            return Err(Error::format(self.name, format!("no texture {index}")));
        };
        let image = image as usize;
        let slot = self.images.iter().position(|known| *known == image).unwrap_or_else(|| {
            self.images.push(image);
            self.images.len() - 1
        });
        let sampler =
            texture["sampler"].as_u64().map_or(&Value::Null, |s| &self.json["samplers"][s as usize]);
        let wrap = |key: &str| match sampler[key].as_u64() {
            Some(33_071) => Wrap::Clamp,
            Some(33_648) => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        let moved = &info["extensions"]["KHR_texture_transform"];
        let mut uv_set = info["texCoord"].as_u64().unwrap_or(0);
        let transform = moved.as_object().map(|_| {
            uv_set = moved["texCoord"].as_u64().unwrap_or(uv_set);
            let pair =
                |key: &str, default: f64| [0, 1].map(|i| moved[key][i].as_f64().unwrap_or(default) as f32);
            let rotation = moved["rotation"].as_f64().unwrap_or(0.0) as f32;
            TextureTransform { offset: pair("offset", 0.0), rotation, scale: pair("scale", 1.0) }
        });
        if uv_set > 1 {
            return Err(Error::unsupported(
                self.name,
                format!("texture coordinates of set {uv_set}; sets 0 and 1 are"),
            ));
        }
        let finite = |t: &TextureTransform| {
            [t.offset[0], t.offset[1], t.rotation, t.scale[0], t.scale[1]].iter().all(|v| v.is_finite())
        };
        if transform.is_some_and(|t| !finite(&t)) {
            return Err(Error::format(self.name, "a texture transform is not finite"));
        }
        Ok(Some(TextureRef {
            texture: slot as u32,
            uv_set: uv_set as u32,
            // 9728 is NEAREST. The filter for minifying is left to the renderer.
            sampler: Sampler {
                wrap_u: wrap("wrapS"),
                wrap_v: wrap("wrapT"),
                nearest: sampler["magFilter"] == 9728,
            },
            transform,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_field_reaches_the_material() {
        let json = json!({
            "samplers": [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}],
            "textures": [{"source": 4, "sampler": 0}, {"source": 2}, {"source": 4}],
            "materials": [{}, {
                "name": "glass",
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.25,
                    "baseColorTexture": {"index": 0, "texCoord": 1},
                    "metallicRoughnessTexture": {"index": 1, "extensions": {"KHR_texture_transform":
                        {"offset": [0.5, 0.25], "rotation": 1.5, "scale": [2.0, 3.0], "texCoord": 1}}}
                },
                "normalTexture": {"index": 2, "scale": 0.5},
                "occlusionTexture": {"index": 1, "strength": 0.75},
                "emissiveFactor": [1.0, 0.5, 0.0], "emissiveTexture": {"index": 1},
                "alphaMode": "MASK", "alphaCutoff": 0.2, "doubleSided": true,
                "extensions": {
                    "KHR_materials_emissive_strength": {"emissiveStrength": 4.0},
                    "KHR_materials_ior": {"ior": 1.3},
                    "KHR_materials_transmission": {"transmissionFactor": 1.5},
                    "KHR_materials_clearcoat": {"clearcoatFactor": 0.6, "clearcoatRoughnessFactor": 0.1},
                    "KHR_materials_sheen": {}
                }
            }]
        });
        let mut notes = Notes::none();
        let mut reader = Materials::new("a", &json);
        let materials = reader.read(&mut notes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(materials[0], Material::default());
        assert_eq!(reader.images, [4, 2]);
        let m = &materials[1];
        assert_eq!((m.base_colour, m.metallic, m.roughness), ([0.1, 0.2, 0.3, 0.4], 0.5, 0.25));
        assert_eq!((m.emissive, m.alpha_mode, m.double_sided), ([4.0, 2.0, 0.0], AlphaMode::Mask(0.2), true));
        assert_eq!((m.ior, m.transmission, m.clearcoat, m.clearcoat_roughness), (1.3, 1.0, 0.6, 0.1));
        let sampler = Sampler { wrap_u: Wrap::Clamp, wrap_v: Wrap::Mirror, nearest: true };
        assert_eq!(
            m.base_colour_texture,
            Some(TextureRef { texture: 0, uv_set: 1, sampler, transform: None })
        );
        let rough = m.metallic_roughness_texture.unwrap_or_else(|| panic!("none"));
        assert_eq!((rough.texture, rough.uv_set), (1, 1));
        let transform = TextureTransform { offset: [0.5, 0.25], rotation: 1.5, scale: [2.0, 3.0] };
        assert_eq!(rough.transform, Some(transform));
        assert_eq!((m.normal_scale, m.occlusion_strength), (0.5, 0.75));
        let ids: Vec<&str> = notes.iter().map(|n| n.id.as_str()).collect();
        assert_eq!(ids, ["factors-clamped", "material-ignored"]);
    }

    #[test]
    fn a_third_set_of_coordinates_is_refused() {
        let json = json!({"textures": [{"source": 0}],
            "materials": [{"emissiveTexture": {"index": 0, "texCoord": 2}}]});
        assert!(Materials::new("a", &json).read(&mut Notes::none()).is_err());
    }
}
