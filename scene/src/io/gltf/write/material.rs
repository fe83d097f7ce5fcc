//! Materials as JSON, with the extensions that they need.
//!
//! Numbers are written with all digits of their f32 value, so that they are read back unchanged.

use std::collections::BTreeSet;

use serde_json::{Map as Json, Value, json};

use super::check::{self, Bad};
use crate::math::num;
use crate::types::{
    AlphaMode, ColourMap, Map, Material, NormalMap, Sampler, Texture, TextureRef, TextureTransform, Wrap,
};

/// The fields of a JSON object.
#[derive(Default)]
pub(super) struct Fields(Json<String, Value>);

impl Fields {
    /// Adds a field.
    pub(super) fn set(&mut self, name: &str, value: Value) {
        self.0.insert(name.to_owned(), value);
    }

    /// Adds a field unless it has its default.
    pub(super) fn put<T: PartialEq + Into<Value>>(&mut self, name: &str, value: T, default: T) {
        if value != default {
            self.set(name, value.into());
        }
    }

    /// Adds a field if there is a value.
    fn some(&mut self, name: &str, value: Option<Value>) {
        if let Some(value) = value {
            self.set(name, value);
        }
    }

    /// The JSON object.
    pub(super) fn value(self) -> Value {
        Value::Object(self.0)
    }
}

/// Size of a body that absorbs light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Medium {
    /// Thickness of the body, in units of the object; above 0.
    pub(super) thickness: f32,
    /// Length in the file of one unit of the object.
    pub(super) scale: f64,
}

/// The materials of a file and what they refer to, each in the order of first use.
#[derive(Default)]
pub(super) struct Materials<'a> {
    /// The different pictures; the index of a picture is that of its image in the file.
    pub(super) images: Vec<&'a Texture>,
    materials: Vec<Value>,
    samplers: Vec<Sampler>,
    /// Image and sampler of each texture.
    textures: Vec<(usize, Option<usize>)>,
    extensions: BTreeSet<&'static str>,
}

impl<'a> Materials<'a> {
    /// Adds a material whose textures are indices into `pictures`. Returns its index.
    pub(super) fn add(
        &mut self,
        m: &Material,
        medium: Medium,
        pictures: &'a [Texture],
    ) -> Result<usize, Bad> {
        let value = Writer { all: self, pictures }.material(m, medium)?;
        check::finite(&value)?;
        self.materials.push(value);
        Ok(self.materials.len() - 1)
    }

    /// The lists of the document that the materials need, by name.
    pub(super) fn lists(&self) -> [(&'static str, Vec<Value>); 4] {
        let textures = self.textures.iter().map(|(image, sampler)| {
            let mut texture = Fields::default();
            texture.set("source", json!(image));
            texture.some("sampler", sampler.map(|index| json!(index)));
            texture.value()
        });
        [
            ("materials", self.materials.clone()),
            ("textures", textures.collect()),
            ("samplers", self.samplers.iter().map(sampler).collect()),
            ("extensionsUsed", self.extensions.iter().map(|name| json!(name)).collect()),
        ]
    }
}

fn sampler(sampler: &Sampler) -> Value {
    const REPEAT: u32 = 10_497;
    let wrap = |wrap: Wrap| match wrap {
        Wrap::Repeat => REPEAT,
        Wrap::Mirror => 33_648,
        Wrap::Clamp => 33_071,
    };
    let mut fields = Fields::default();
    fields.put("wrapS", wrap(sampler.wrap_u), REPEAT);
    fields.put("wrapT", wrap(sampler.wrap_v), REPEAT);
    // NEAREST. Without filters, viewers interpolate.
    fields.some("magFilter", sampler.nearest.then(|| json!(9728)));
    fields.value()
}

/// Index of an element of a list, which is added if it is new.
fn index_of<T>(list: &mut Vec<T>, new: T, same: impl Fn(&T, &T) -> bool) -> usize {
    list.iter().position(|known| same(known, &new)).unwrap_or_else(|| {
        list.push(new);
        list.len() - 1
    })
}

/// Writer of the materials of one object.
struct Writer<'w, 'a> {
    all: &'w mut Materials<'a>,
    pictures: &'a [Texture],
}

impl Writer<'_, '_> {
    fn material(&mut self, m: &Material, medium: Medium) -> Result<Value, Bad> {
        let plain = Material::default();
        let mut pbr = Fields::default();
        pbr.put("baseColorFactor", m.base_colour, plain.base_colour);
        pbr.some("baseColorTexture", self.texture(m.base_colour_texture)?);
        pbr.put("metallicFactor", m.metallic, plain.metallic);
        pbr.put("roughnessFactor", m.roughness, plain.roughness);
        pbr.some("metallicRoughnessTexture", self.texture(m.metallic_roughness_texture)?);
        let mut fields = Fields::default();
        fields.put("name", m.name.as_str(), "");
        fields.put("pbrMetallicRoughness", pbr.value(), json!({}));
        fields.some("normalTexture", self.normal(m.normal)?);
        let (emissive, strength) = emission(m.emissive);
        fields.put("emissiveFactor", emissive, plain.emissive);
        fields.some("emissiveTexture", self.texture(m.emissive_texture)?);
        match m.alpha_mode {
            AlphaMode::Opaque => {}
            AlphaMode::Mask(cutoff) => {
                fields.set("alphaMode", json!("MASK"));
                fields.put("alphaCutoff", cutoff, 0.5);
            }
            AlphaMode::Blend => fields.set("alphaMode", json!("BLEND")),
        }
        fields.put("doubleSided", m.double_sided, false);
        let mut extensions = Fields::default();
        for (name, extension) in self.extensions(m, &plain, strength, medium)? {
            if m.unlit && name == "KHR_materials_unlit" || !extension.0.is_empty() {
                self.all.extensions.insert(name);
                extensions.set(name, extension.value());
            }
        }
        fields.put("extensions", extensions.value(), json!({}));
        Ok(fields.value())
    }

    /// All extensions of materials, with the fields that differ from their defaults.
    fn extensions(
        &mut self,
        m: &Material,
        plain: &Material,
        emissive_strength: f32,
        medium: Medium,
    ) -> Result<[(&'static str, Fields); 11], Bad> {
        let mut strength = Fields::default();
        strength.put("emissiveStrength", emissive_strength, 1.0);
        let mut ior = Fields::default();
        ior.put("ior", m.ior, plain.ior);
        let mut transmission = Fields::default();
        self.map(&mut transmission, "transmission", &m.transmission, &plain.transmission)?;
        let mut specular = Fields::default();
        self.map(&mut specular, "specular", &m.specular.strength, &plain.specular.strength)?;
        self.colour(&mut specular, "specularColor", &m.specular.colour, &plain.specular.colour)?;
        let (coat, bare) = (&m.clearcoat, &plain.clearcoat);
        let mut clearcoat = Fields::default();
        self.map(&mut clearcoat, "clearcoat", &coat.strength, &bare.strength)?;
        self.map(&mut clearcoat, "clearcoatRoughness", &coat.roughness, &bare.roughness)?;
        clearcoat.some("clearcoatNormalTexture", self.normal(coat.normal)?);
        let mut sheen = Fields::default();
        self.colour(&mut sheen, "sheenColor", &m.sheen.colour, &plain.sheen.colour)?;
        self.map(&mut sheen, "sheenRoughness", &m.sheen.roughness, &plain.sheen.roughness)?;
        let (brush, none) = (&m.anisotropy, &plain.anisotropy);
        let mut anisotropy = Fields::default();
        anisotropy.put("anisotropyStrength", brush.strength, none.strength);
        anisotropy.put("anisotropyRotation", brush.rotation, none.rotation);
        anisotropy.some("anisotropyTexture", self.texture(brush.texture)?);
        let (film, none) = (&m.iridescence, &plain.iridescence);
        let mut iridescence = Fields::default();
        self.map(&mut iridescence, "iridescence", &film.strength, &none.strength)?;
        iridescence.put("iridescenceIor", film.ior, none.ior);
        iridescence.put("iridescenceThicknessMinimum", film.thickness_nm[0], none.thickness_nm[0]);
        iridescence.put("iridescenceThicknessMaximum", film.thickness_nm[1], none.thickness_nm[1]);
        iridescence.some("iridescenceThicknessTexture", self.texture(film.thickness_texture)?);
        let (through, none) = (&m.diffuse_transmission, &plain.diffuse_transmission);
        let mut diffuse = Fields::default();
        self.map(&mut diffuse, "diffuseTransmission", &through.strength, &none.strength)?;
        self.colour(&mut diffuse, "diffuseTransmissionColor", &through.colour, &none.colour)?;
        Ok([
            ("KHR_materials_emissive_strength", strength),
            ("KHR_materials_unlit", Fields::default()),
            ("KHR_materials_ior", ior),
            ("KHR_materials_transmission", transmission),
            ("KHR_materials_volume", m.volume.map_or_else(Fields::default, |v| volume(v, medium))),
            ("KHR_materials_specular", specular),
            ("KHR_materials_clearcoat", clearcoat),
            ("KHR_materials_sheen", sheen),
            ("KHR_materials_anisotropy", anisotropy),
            ("KHR_materials_iridescence", iridescence),
            ("KHR_materials_diffuse_transmission", diffuse),
        ])
    }

    /// Adds the fields `{name}Factor` and `{name}Texture`.
    fn map(&mut self, to: &mut Fields, name: &str, map: &Map, plain: &Map) -> Result<(), Bad> {
        to.put(&format!("{name}Factor"), map.factor, plain.factor);
        to.some(&format!("{name}Texture"), self.texture(map.texture)?);
        Ok(())
    }

    /// Adds the fields `{name}Factor` and `{name}Texture` of a colour.
    fn colour(&mut self, to: &mut Fields, name: &str, map: &ColourMap, plain: &ColourMap) -> Result<(), Bad> {
        to.put(&format!("{name}Factor"), map.factor, plain.factor);
        to.some(&format!("{name}Texture"), self.texture(map.texture)?);
        Ok(())
    }

    fn normal(&mut self, map: Option<NormalMap>) -> Result<Option<Value>, Bad> {
        let Some(map) = map else { return Ok(None) };
        let mut info = self.info(&map.texture)?;
        info.put("scale", map.scale, 1.0);
        Ok(Some(info.value()))
    }

    fn texture(&mut self, reference: Option<TextureRef>) -> Result<Option<Value>, Bad> {
        reference.map(|reference| self.info(&reference).map(Fields::value)).transpose()
    }

    /// The fields of a reference to a texture. Adds the texture, its picture and its sampler if they are new.
    fn info(&mut self, reference: &TextureRef) -> Result<Fields, Bad> {
        let Some(picture) = self.pictures.get(reference.texture as usize) else {
            return Err(Bad::data("refers to a texture that does not exist"));
        };
        check::texture(picture)?;
        let image = index_of(&mut self.all.images, picture, |a, b| std::ptr::eq(*a, *b) || a == b);
        // Repeated and interpolated, as without a sampler.
        let usual = Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
        let sampler = (reference.sampler != usual)
            .then(|| index_of(&mut self.all.samplers, reference.sampler, PartialEq::eq));
        let texture = index_of(&mut self.all.textures, (image, sampler), PartialEq::eq);
        let mut info = Fields::default();
        info.set("index", json!(texture));
        info.put("texCoord", reference.uv_set, 0);
        if let Some(transform) = reference.transform {
            const NAME: &str = "KHR_texture_transform";
            self.all.extensions.insert(NAME);
            info.set("extensions", json!({ NAME: moved(transform) }));
        }
        Ok(info)
    }
}

fn moved(transform: TextureTransform) -> Value {
    let mut fields = Fields::default();
    fields.put("offset", transform.offset, [0.0; 2]);
    fields.put("rotation", transform.rotation, 0.0);
    fields.put("scale", transform.scale, [1.0; 2]);
    fields.value()
}

/// Factor from 0 to 1 and strength, whose product is the emission. The strength is a power of two where possible, so
/// that the product is exact.
fn emission(emissive: [f32; 3]) -> ([f32; 3], f32) {
    let largest = emissive.iter().copied().fold(0.0, f32::max);
    if largest <= 1.0 {
        return (emissive, 1.0);
    }
    // Rounds up to a power of two, by the bits of the mantissa. The largest strength that is read is 1e12.
    let power = f32::from_bits((largest.to_bits() + 0x007f_ffff) & 0xff80_0000);
    let strength = if power <= 1e12 { power } else { largest };
    (emissive.map(|e| e / strength), strength)
}

/// The medium inside a body. The strongest absorption leaves 1/e of the light at the attenuation distance.
fn volume(absorption: [f32; 3], medium: Medium) -> Fields {
    let largest = absorption.iter().copied().fold(0.0, f32::max);
    let mut fields = Fields::default();
    fields.set("thicknessFactor", json!(medium.thickness));
    if largest > 0.0 {
        fields.set("attenuationDistance", json!(medium.scale / f64::from(largest)));
        let left = |a: f32| num::f64::exp(-f64::from(a) / f64::from(largest)) as f32;
        fields.set("attenuationColor", json!(absorption.map(left)));
    }
    fields
}
