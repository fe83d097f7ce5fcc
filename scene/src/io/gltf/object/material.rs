//! Materials of a glTF file, with the supported KHR extensions.

use std::collections::BTreeSet;

use engine::Notes;
use serde_json::Value;

use crate::error::Error;
use crate::io::gltf::SUPPORTED;
use crate::io::gltf::specular_glossiness::{self, glossiness};
use crate::types::{
    AlphaMode, Anisotropy, Clearcoat, ColourMap, DiffuseTransmission, Iridescence, Map, Material, NormalMap,
    Sampler, Sheen, Specular, TextureRef, TextureTransform, Wrap,
};

/// Reader of the materials of a file, which also collects the images that they use.
pub struct Materials<'a> {
    name: &'a str,
    json: &'a Value,
    /// The images in use. [`TextureRef::texture`] is an index into this list.
    pub images: Vec<Picture>,
    clamped: u64,
    ignored: BTreeSet<String>,
    occluded: bool,
    glossy: u64,
}

/// An image that a material uses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Picture {
    /// Index of the image in the file.
    pub image: usize,
    /// If the alpha of the image is a glossiness, the factor that multiplies it. The texture then holds one minus
    /// the glossiness in its green channel.
    pub glossiness: Option<f64>,
}

/// Extensions that are not rendered, each with the effect on the picture.
const NOT_DRAWN: [(&str, &str); 5] = [
    ("KHR_lights_punctual", "the lights of the file are not used, but its emissive surfaces are"),
    ("KHR_materials_dispersion", "all colours are refracted equally"),
    ("KHR_materials_volume_scatter", "light is not scattered inside the object"),
    ("KHR_materials_variants", "variants are ignored; the default materials are used"),
    ("KHR_texture_basisu", "textures use the PNG or JPEG fallback"),
];

/// The effect on the picture of ignoring an extension.
fn effect(extension: &str) -> &'static str {
    let known = NOT_DRAWN.iter().find(|(name, _)| *name == extension);
    known.map_or("the extension is unknown", |(_, effect)| effect)
}

impl<'a> Materials<'a> {
    /// Creates a reader of the materials in `json`.
    pub fn new(name: &'a str, json: &'a Value) -> Self {
        Self {
            name,
            json,
            images: Vec::new(),
            clamped: 0,
            ignored: BTreeSet::new(),
            occluded: false,
            glossy: 0,
        }
    }

    /// Every material of the file, in order.
    pub fn read(&mut self, notes: &mut Notes) -> Result<Vec<Material>, Error> {
        let list = self.json["materials"].as_array().map(Vec::as_slice).unwrap_or_default();
        let materials = list.iter().map(|m| self.material(m)).collect::<Result<_, _>>()?;
        notes.count(
            "factors-clamped",
            self.clamped,
            "of the material factors had to be clamped to the permitted range",
        );
        for what in &self.ignored {
            notes.degraded("material-ignored", what.clone());
        }
        notes.count(
            "specular-glossiness",
            self.glossy,
            "of the materials had specular-glossiness parameters, which were converted to `KHR_materials_specular`",
        );
        self.report_others(notes);
        if self.occluded {
            let text = "occlusion maps are ignored, since path tracing computes occlusion from the shape";
            notes.decision("occlusion-traced", text);
        }
        Ok(materials)
    }

    /// Reports unsupported content outside materials. Lights are reported only if a node has one.
    fn report_others(&self, notes: &mut Notes) {
        let cameras = self.json["cameras"].as_array().map_or(0, Vec::len);
        if cameras > 0 {
            let text =
                format!("the cameras of the file are left out (count: {cameras}): the graph defines its own");
            notes.decision("not-shown", text);
        }
        let lamps = self.json["nodes"].as_array().into_iter().flatten();
        let lamps = lamps.filter(|node| node["extensions"].get("KHR_lights_punctual").is_some()).count();
        if lamps > 0 {
            let text = format!(
                "KHR_lights_punctual is left out (lights: {lamps}): {}",
                effect("KHR_lights_punctual")
            );
            notes.degraded("lights-ignored", text);
        }
        let used = self.json["extensionsUsed"].as_array().into_iter().flatten().filter_map(Value::as_str);
        let reported = |name: &str| self.ignored.iter().any(|text| text.split(' ').next() == Some(name));
        let drawn = |name: &&str| SUPPORTED.contains(name) && *name != "KHR_materials_variants";
        for name in used.filter(|name| !drawn(name) && *name != "KHR_lights_punctual") {
            // Extensions of unused materials have no effect.
            let unused = name.starts_with("KHR_materials_") && name != "KHR_materials_variants";
            if !reported(name) && !unused {
                notes.warning("extension-ignored", format!("{name} is left out: {}", effect(name)));
            }
        }
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
        for name in m["extensions"].as_object().into_iter().flat_map(|all| all.keys()) {
            if !SUPPORTED.contains(&name.as_str()) {
                self.ignored.insert(format!("{name} is left out: {}", effect(name)));
            }
        }
        self.glossy += u64::from(m["extensions"].get(specular_glossiness::NAME).is_some());
        self.occluded |= m["occlusionTexture"].get("index").is_some();
        let ior = self.factor(&extension("KHR_materials_ior")["ior"], 1.5, 0.0, 1e3);
        let specular = extension("KHR_materials_specular");
        let transmission = extension("KHR_materials_transmission");
        Ok(Material {
            name: m["name"].as_str().unwrap_or_default().to_owned(),
            base_colour: self.factors(&pbr["baseColorFactor"], 1.0, 1.0),
            base_colour_texture: self.texture(&pbr["baseColorTexture"])?,
            metallic: self.factor(&pbr["metallicFactor"], 1.0, 0.0, 1.0),
            roughness: self.factor(&pbr["roughnessFactor"], 1.0, 0.0, 1.0),
            metallic_roughness_texture: self.roughness(m)?,
            normal: self.normal(&m["normalTexture"])?,
            emissive: emissive.map(|e| e * strength),
            emissive_texture: self.texture(&m["emissiveTexture"])?,
            alpha_mode,
            double_sided: m["doubleSided"].as_bool().unwrap_or(false),
            unlit: m["extensions"].get("KHR_materials_unlit").is_some(),
            // The extension defines 0 as an infinite index; other values below 1 are invalid.
            ior: if ior == 0.0 { 1e3 } else { ior.max(1.0) },
            transmission: self.map(transmission, "transmission", 0.0)?,
            volume: self.volume(extension("KHR_materials_volume")),
            specular: Specular {
                strength: self.map(specular, "specular", 1.0)?,
                colour: ColourMap {
                    factor: self.factors(&specular["specularColorFactor"], 1.0, 1e6),
                    texture: self.texture(&specular["specularColorTexture"])?,
                },
            },
            clearcoat: self.clearcoat(extension("KHR_materials_clearcoat"))?,
            sheen: self.sheen(extension("KHR_materials_sheen"))?,
            anisotropy: self.anisotropy(extension("KHR_materials_anisotropy"))?,
            iridescence: self.iridescence(extension("KHR_materials_iridescence"))?,
            diffuse_transmission: self.through(extension("KHR_materials_diffuse_transmission"))?,
        })
    }

    /// Absorption per metre, if the material has a volume.
    fn volume(&mut self, e: &Value) -> Option<[f32; 3]> {
        // The thickness is for rasterizers; here only whether it is above 0 matters.
        let thick = self.factor(&e["thicknessFactor"], 0.0, 0.0, f64::MAX) > 0.0;
        let colour: [f32; 3] = self.factors(&e["attenuationColor"], 1.0, 1.0);
        let distance = e["attenuationDistance"].as_f64().filter(|d| *d > 0.0);
        // colour = exp(-absorption * distance); a black channel is practically opaque.
        let absorption = |c: f32| {
            let depth = -crate::math::num::f64::ln(f64::from(c).max(1e-12));
            (depth / distance.unwrap_or(f64::INFINITY)).min(1e12) as f32
        };
        thick.then(|| colour.map(absorption))
    }

    fn clearcoat(&mut self, e: &Value) -> Result<Clearcoat, Error> {
        Ok(Clearcoat {
            strength: self.map(e, "clearcoat", 0.0)?,
            roughness: self.map(e, "clearcoatRoughness", 0.0)?,
            normal: self.normal(&e["clearcoatNormalTexture"])?,
        })
    }

    fn sheen(&mut self, e: &Value) -> Result<Sheen, Error> {
        let colour = ColourMap {
            factor: self.factors(&e["sheenColorFactor"], 0.0, 1.0),
            texture: self.texture(&e["sheenColorTexture"])?,
        };
        Ok(Sheen { colour, roughness: self.map(e, "sheenRoughness", 0.0)? })
    }

    fn anisotropy(&mut self, e: &Value) -> Result<Anisotropy, Error> {
        Ok(Anisotropy {
            strength: self.factor(&e["anisotropyStrength"], 0.0, 0.0, 1.0),
            rotation: self.factor(&e["anisotropyRotation"], 0.0, -1e6, 1e6),
            texture: self.texture(&e["anisotropyTexture"])?,
        })
    }

    fn iridescence(&mut self, e: &Value) -> Result<Iridescence, Error> {
        Ok(Iridescence {
            strength: self.map(e, "iridescence", 0.0)?,
            ior: self.factor(&e["iridescenceIor"], 1.3, 1.0, 1e3),
            thickness_nm: [
                self.factor(&e["iridescenceThicknessMinimum"], 100.0, 0.0, 1e6),
                self.factor(&e["iridescenceThicknessMaximum"], 400.0, 0.0, 1e6),
            ],
            thickness_texture: self.texture(&e["iridescenceThicknessTexture"])?,
        })
    }

    fn through(&mut self, e: &Value) -> Result<DiffuseTransmission, Error> {
        let colour = ColourMap {
            factor: self.factors(&e["diffuseTransmissionColorFactor"], 1.0, 1.0),
            texture: self.texture(&e["diffuseTransmissionColorTexture"])?,
        };
        Ok(DiffuseTransmission { strength: self.map(e, "diffuseTransmission", 0.0)?, colour })
    }

    /// Reads the fields `{name}Factor`, clamped to 0..1, and `{name}Texture`.
    fn map(&mut self, e: &Value, name: &str, default: f64) -> Result<Map, Error> {
        let factor = self.factor(&e[format!("{name}Factor").as_str()], default, 0.0, 1.0);
        Ok(Map { factor, texture: self.texture(&e[format!("{name}Texture").as_str()])? })
    }

    fn normal(&mut self, info: &Value) -> Result<Option<NormalMap>, Error> {
        let scale = self.factor(&info["scale"], 1.0, -1e6, 1e6);
        Ok(self.texture(info)?.map(|texture| NormalMap { texture, scale }))
    }

    fn factor(&mut self, value: &Value, default: f64, low: f64, high: f64) -> f32 {
        let value = value.as_f64().unwrap_or(default);
        self.clamped += u64::from(!(low..=high).contains(&value));
        value.clamp(low, high.min(f64::from(f32::MAX))) as f32
    }

    fn factors<const N: usize>(&mut self, value: &Value, default: f64, high: f64) -> [f32; N] {
        std::array::from_fn(|i| self.factor(&value[i], default, 0.0, high))
    }

    /// The texture of the roughness, which specular-glossiness stores as a glossiness.
    fn roughness(&mut self, m: &Value) -> Result<Option<TextureRef>, Error> {
        let gloss = &m["extensions"][specular_glossiness::NAME];
        if gloss.is_null() {
            return self.texture(&m["pbrMetallicRoughness"]["metallicRoughnessTexture"]);
        }
        self.texture_as(&gloss["specularGlossinessTexture"], Some(glossiness(gloss)))
    }

    fn texture(&mut self, info: &Value) -> Result<Option<TextureRef>, Error> {
        self.texture_as(info, None)
    }

    fn texture_as(&mut self, info: &Value, glossiness: Option<f64>) -> Result<Option<TextureRef>, Error> {
        let Some(index) = info["index"].as_u64() else { return Ok(None) };
        let texture = &self.json["textures"][index as usize];
        // A WebP picture in addition to a plain one is the better copy.
        let webp = &texture["extensions"]["EXT_texture_webp"]["source"];
        let Some(image) = webp.as_u64().or_else(|| texture["source"].as_u64()) else {
            return Err(Error::format(
                self.name,
                format!("a material refers to texture {index}, which does not exist"),
            ));
        };
        let picture = Picture { image: image as usize, glossiness };
        let slot = self.images.iter().position(|known| *known == picture).unwrap_or_else(|| {
            self.images.push(picture);
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
                format!("texture coordinates of set {uv_set}; only sets 0 and 1 are supported"),
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
                    "KHR_materials_clearcoat": {"clearcoatFactor": 0.6, "clearcoatRoughnessFactor": 0.1,
                        "clearcoatTexture": {"index": 1}, "clearcoatNormalTexture": {"index": 1, "scale": 2.0}},
                    "KHR_materials_sheen": {"sheenColorFactor": [0.1, 0.2, 0.3], "sheenRoughnessFactor": 0.7},
                    "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationDistance": 0.5,
                        "attenuationColor": [1.0, 0.36787944, 0.0]},
                    "KHR_materials_specular": {"specularFactor": 0.4, "specularColorFactor": [2.0, 1.0, 0.5]},
                    "KHR_materials_anisotropy": {"anisotropyStrength": 0.3, "anisotropyRotation": -1.0},
                    "KHR_materials_iridescence": {"iridescenceFactor": 0.9, "iridescenceIor": 1.8,
                        "iridescenceThicknessMinimum": 50.0, "iridescenceThicknessTexture": {"index": 0}},
                    "KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.8,
                        "diffuseTransmissionColorFactor": [0.5, 0.6, 0.7]},
                    "KHR_materials_unlit": {},
                    "KHR_materials_dispersion": {"dispersion": 0.1}
                }
            }]
        });
        let mut notes = Notes::none();
        let mut reader = Materials::new("a", &json);
        let materials = reader.read(&mut notes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(materials[0], Material::default());
        assert_eq!(reader.images.iter().map(|picture| picture.image).collect::<Vec<_>>(), [4, 2]);
        let m = &materials[1];
        assert_eq!((m.base_colour, m.metallic, m.roughness), ([0.1, 0.2, 0.3, 0.4], 0.5, 0.25));
        assert_eq!((m.emissive, m.alpha_mode, m.double_sided), ([4.0, 2.0, 0.0], AlphaMode::Mask(0.2), true));
        assert_eq!((m.ior, m.transmission, m.unlit), (1.3, Map::of(1.0), true));
        let [clear, tinted, black] = m.volume.unwrap_or_else(|| panic!("thick"));
        assert!(clear == 0.0 && (tinted - 2.0).abs() < 1e-5 && black > 50.0 && black.is_finite());
        let sampler = Sampler { wrap_u: Wrap::Clamp, wrap_v: Wrap::Mirror, nearest: true };
        assert_eq!(
            m.base_colour_texture,
            Some(TextureRef { texture: 0, uv_set: 1, sampler, transform: None })
        );
        let rough = m.metallic_roughness_texture.unwrap_or_else(|| panic!("none"));
        assert_eq!((rough.texture, rough.uv_set), (1, 1));
        let transform = TextureTransform { offset: [0.5, 0.25], rotation: 1.5, scale: [2.0, 3.0] };
        assert_eq!(rough.transform, Some(transform));
        assert_eq!(m.normal.map(|map| map.scale), Some(0.5));
        let coat = m.clearcoat;
        assert_eq!((coat.strength.factor, coat.roughness), (0.6, Map::of(0.1)));
        assert_eq!(
            (coat.strength.texture.map(|t| t.texture), coat.normal.map(|n| n.scale)),
            (Some(1), Some(2.0))
        );
        assert_eq!((m.sheen.colour.factor, m.sheen.roughness), ([0.1, 0.2, 0.3], Map::of(0.7)));
        assert_eq!((m.specular.strength, m.specular.colour.factor), (Map::of(0.4), [2.0, 1.0, 0.5]));
        assert_eq!((m.anisotropy.strength, m.anisotropy.rotation), (0.3, -1.0));
        assert_eq!((m.iridescence.strength, m.iridescence.ior), (Map::of(0.9), 1.8));
        assert_eq!(m.iridescence.thickness_nm, [50.0, 400.0]);
        assert_eq!(m.iridescence.thickness_texture.map(|t| t.texture), Some(0));
        assert_eq!(m.diffuse_transmission.strength, Map::of(0.8));
        assert_eq!(m.diffuse_transmission.colour.factor, [0.5, 0.6, 0.7]);
        let ids: Vec<&str> = notes.iter().map(|n| n.id.as_str()).collect();
        assert_eq!(ids, ["factors-clamped", "material-ignored", "occlusion-traced"]);
        assert!(notes.iter().any(|n| n.text.starts_with("KHR_materials_dispersion")));
    }

    // Unsupported features are reported, wherever they appear in the file.
    #[test]
    fn what_is_not_known_is_named() {
        let json = json!({
            "extensionsUsed": ["KHR_lights_punctual", "MSFT_lod", "KHR_materials_ior", "KHR_materials_dispersion",
                "KHR_materials_variants", "KHR_texture_basisu"],
            "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
            "nodes": [{"extensions": {"KHR_lights_punctual": {"light": 0}}}, {}]
        });
        let mut notes = Notes::none();
        assert!(Materials::new("a", &json).read(&mut notes).is_ok());
        let reported: Vec<_> = notes.iter().map(|n| (n.id.as_str(), n.text.as_str())).collect();
        assert_eq!(reported[0].0, "lights-ignored");
        assert!(
            reported[0].1.contains("(lights: 1)") && reported[1].1.starts_with("MSFT_lod is left out"),
            "{reported:?}"
        );
        assert!(reported[2].1.contains("variants are ignored; the default materials are used"));
        assert!(reported[3].1.ends_with("the PNG or JPEG fallback"));
        assert_eq!(reported.len(), 4);
    }

    #[test]
    fn cameras_are_reported() {
        let json = json!({"cameras": [{}]});
        let mut notes = Notes::none();
        assert!(Materials::new("a", &json).read(&mut notes).is_ok());
        let reported: Vec<_> = notes.iter().map(|n| n.text.clone()).collect();
        assert!(reported[0].starts_with("the cameras of the file are left out (count: 1)"), "{reported:?}");
        assert_eq!(reported.len(), 1);
    }

    #[test]
    fn a_third_set_of_coordinates_is_refused() {
        let json = json!({"textures": [{"source": 0}],
            "materials": [{"emissiveTexture": {"index": 0, "texCoord": 2}}]});
        assert!(Materials::new("a", &json).read(&mut Notes::none()).is_err());
    }
}
