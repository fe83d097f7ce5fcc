//! Materials of objects: the metallic-roughness model of glTF, and the layers that its extensions add.

use engine::{Corrupt, Decoder, Encoder};

/// Continuation of a texture outside the range of its coordinates from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrap {
    /// The texture is repeated.
    Repeat,
    /// The texture is repeated, every other copy mirrored.
    Mirror,
    /// The edge texel is repeated.
    Clamp,
}

/// Wrapping and filtering of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sampler {
    /// Wrapping along u.
    pub wrap_u: Wrap,
    /// Wrapping along v.
    pub wrap_v: Wrap,
    /// True to use the texel that contains the point; false to interpolate bilinearly.
    pub nearest: bool,
}

/// A decoded picture: 8-bit RGBA as stored, row 0 at v = 0. The encoding depends on the use of the texture: colours
/// are sRGB-encoded, other data are linear.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// Width, in texels.
    pub width: u32,
    /// Height, in texels.
    pub height: u32,
    /// Four bytes per texel, row by row.
    pub rgba: Vec<u8>,
}

/// KHR_texture_transform: uv' = translation * rotation * scale * uv.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureTransform {
    /// Translation of the coordinates. 1 is the full width or height of the texture.
    pub offset: [f32; 2],
    /// Rotation in radians, counter-clockwise.
    pub rotation: f32,
    /// Scale.
    pub scale: [f32; 2],
}

/// A reference to a texture, with the way in which it is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureRef {
    /// Index into [`Object::textures`](super::Object::textures).
    pub texture: u32,
    /// Index of the set of texture coordinates, 0 or 1.
    pub uv_set: u32,
    /// Wrapping and filtering of the texture.
    pub sampler: Sampler,
    /// Transform of the texture coordinates.
    pub transform: Option<TextureTransform>,
}

/// A number, multiplied by one channel of a texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Map {
    /// The number.
    pub factor: f32,
    /// The texture, which holds linear values.
    pub texture: Option<TextureRef>,
}

impl Map {
    /// A map with the constant value `factor`, without a texture.
    pub const fn of(factor: f32) -> Self {
        Self { factor, texture: None }
    }
}

/// A linear colour, multiplied by a texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourMap {
    /// The colour, linear.
    pub factor: [f32; 3],
    /// The texture, which holds sRGB-encoded colours.
    pub texture: Option<TextureRef>,
}

impl ColourMap {
    /// A map with the constant value `factor` in all three channels, without a texture.
    pub const fn of(factor: f32) -> Self {
        Self { factor: [factor; 3], texture: None }
    }
}

/// A tangent-space normal map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalMap {
    /// The texture, which holds linear values.
    pub texture: TextureRef,
    /// Factor by which the x and y components are multiplied.
    pub scale: f32,
}

/// Effect of alpha.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AlphaMode {
    /// Alpha has no effect.
    Opaque,
    /// Texels with an alpha below this value are removed, and all other texels are opaque.
    Mask(f32),
    /// The surface is transparent in proportion to 1 - alpha.
    Blend,
}

/// KHR_materials_clearcoat: a clear layer with an index of refraction of 1.5, on top of all other layers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearcoat {
    /// Strength, 0 to 1, in the red channel of the texture.
    pub strength: Map,
    /// Perceptual roughness, 0 to 1, in the green channel of the texture.
    pub roughness: Map,
    /// Normal map of the layer, independent of the normal map of the layers below.
    pub normal: Option<NormalMap>,
}

/// KHR_materials_sheen: fibres that reflect at grazing angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sheen {
    /// Reflectance of the fibres; black if there is no sheen.
    pub colour: ColourMap,
    /// Perceptual roughness, 0 to 1, in the alpha channel of the texture.
    pub roughness: Map,
}

/// KHR_materials_specular: the reflectance of the dielectric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Specular {
    /// Factor that multiplies the reflectance, 0 to 1, in the alpha channel of the texture.
    pub strength: Map,
    /// Colour that multiplies the reflectance at normal incidence. It may exceed 1.
    pub colour: ColourMap,
}

/// KHR_materials_anisotropy: reflections that are stretched in one direction, as on brushed metal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anisotropy {
    /// Strength, 0 to 1, multiplied by the blue channel of `texture`.
    pub strength: f32,
    /// Direction in which the surface is brushed, in radians, counter-clockwise from the tangent.
    pub rotation: f32,
    /// Texture that holds the direction in its red and green channels, as components from -1 to 1, and the strength
    /// in its blue channel.
    pub texture: Option<TextureRef>,
}

/// KHR_materials_iridescence: a thin film on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iridescence {
    /// Strength, 0 to 1, in the red channel of the texture.
    pub strength: Map,
    /// Index of refraction of the film.
    pub ior: f32,
    /// Thickness in nanometres where the texture is 0 and where it is 1.
    pub thickness_nm: [f32; 2],
    /// Texture whose green channel interpolates between the two thicknesses. Without it, the film has the second
    /// thickness.
    pub thickness_texture: Option<TextureRef>,
}

/// KHR_materials_diffuse_transmission: diffuse light that passes through thin surfaces such as leaves, paper and
/// cloth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiffuseTransmission {
    /// Fraction of the diffuse light that leaves on the other side, 0 to 1, in the alpha channel of the texture.
    pub strength: Map,
    /// Colour of the light that leaves on the other side.
    pub colour: ColourMap,
}

/// A glTF metallic-roughness material. Factors multiply textures; colours are linear.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name of the material in the file.
    pub name: String,
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// sRGB texture of base colour and alpha.
    pub base_colour_texture: Option<TextureRef>,
    /// Metalness, from 0 (dielectric) to 1 (metal).
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1.
    pub roughness: f32,
    /// Linear texture with the roughness in its green channel and the metalness in its blue channel.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Normal map.
    pub normal: Option<NormalMap>,
    /// Linear emitted radiance, with KHR_materials_emissive_strength multiplied in.
    pub emissive: [f32; 3],
    /// sRGB texture of emission.
    pub emissive_texture: Option<TextureRef>,
    /// Effect of alpha.
    pub alpha_mode: AlphaMode,
    /// True if both sides are visible; otherwise back faces are culled for camera rays.
    pub double_sided: bool,
    /// KHR_materials_unlit: emits its base colour and reflects nothing.
    pub unlit: bool,
    /// KHR_materials_ior: index of refraction, 1.5 by default. With 1, light is neither refracted nor reflected.
    pub ior: f32,
    /// KHR_materials_transmission: fraction of the light entering the surface that is transmitted and not
    /// scattered, 0 to 1, in the red channel of the texture.
    pub transmission: Map,
    /// KHR_materials_volume: absorption coefficients, per metre, of a medium that the surface bounds and that
    /// refracts light. `None` for a thin wall.
    pub volume: Option<[f32; 3]>,
    /// Reflectance of the dielectric.
    pub specular: Specular,
    /// Clear coat on top of all other layers.
    pub clearcoat: Clearcoat,
    /// Layer of fibres.
    pub sheen: Sheen,
    /// Anisotropy of the reflection.
    pub anisotropy: Anisotropy,
    /// Thin film on the surface.
    pub iridescence: Iridescence,
    /// Diffuse light that passes through the surface.
    pub diffuse_transmission: DiffuseTransmission,
}

impl Default for Material {
    /// The default material of the glTF specification.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_colour: [1.0; 4],
            base_colour_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal: None,
            emissive: [0.0; 3],
            emissive_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
            ior: 1.5,
            transmission: Map::of(0.0),
            volume: None,
            specular: Specular { strength: Map::of(1.0), colour: ColourMap::of(1.0) },
            clearcoat: Clearcoat { strength: Map::of(0.0), roughness: Map::of(0.0), normal: None },
            sheen: Sheen { colour: ColourMap::of(0.0), roughness: Map::of(0.0) },
            anisotropy: Anisotropy { strength: 0.0, rotation: 0.0, texture: None },
            iridescence: Iridescence {
                strength: Map::of(0.0),
                ior: 1.3,
                thickness_nm: [100.0, 400.0],
                thickness_texture: None,
            },
            diffuse_transmission: DiffuseTransmission { strength: Map::of(0.0), colour: ColourMap::of(1.0) },
        }
    }
}

impl Material {
    /// Index of the set of texture coordinates from which tangents are generated. `None` for a material with
    /// neither a normal map nor anisotropy, which needs no tangents.
    pub fn tangent_set(&self) -> Option<u32> {
        let bumps = self.normal.or(self.clearcoat.normal).map(|map| map.texture.uv_set);
        let brush = (self.anisotropy.strength > 0.0).then(|| self.anisotropy.texture.map_or(0, |t| t.uv_set));
        bumps.or(brush)
    }

    /// True if the material emits light.
    pub fn shines(&self) -> bool {
        self.unlit || self.emissive != [0.0; 3]
    }

    /// Writes the canonical encoding.
    pub(super) fn encode(&self, to: &mut Encoder) {
        to.str(&self.name);
        // Writing never fails.
        self.clone().walk(&mut Write(to)).ok();
    }

    /// Reads a material that [`encode`](Self::encode) wrote, for an object with `textures` textures.
    pub(super) fn decode(from: &mut Decoder<'_>, textures: usize) -> Result<Self, Corrupt> {
        let mut material = Self { name: from.str()?, ..Self::default() };
        material.walk(&mut Read { from, textures })?;
        Ok(material)
    }

    /// Visits every field in the order of the encoding. Encoding and decoding share this function, so that they
    /// always agree.
    fn walk(&mut self, f: &mut impl Fields) -> Result<(), Corrupt> {
        f.numbers(&mut self.base_colour)?;
        f.texture(&mut self.base_colour_texture)?;
        f.number(&mut self.metallic)?;
        f.number(&mut self.roughness)?;
        f.texture(&mut self.metallic_roughness_texture)?;
        f.normal(&mut self.normal)?;
        f.numbers(&mut self.emissive)?;
        f.texture(&mut self.emissive_texture)?;
        let (mut mode, mut cutoff) = match self.alpha_mode {
            AlphaMode::Opaque => (0, 0.0),
            AlphaMode::Mask(cutoff) => (1, cutoff),
            AlphaMode::Blend => (2, 0.0),
        };
        f.tag(&mut mode, 2)?;
        f.number(&mut cutoff)?;
        self.alpha_mode = match mode {
            0 => AlphaMode::Opaque,
            1 => AlphaMode::Mask(cutoff),
            _ => AlphaMode::Blend,
        };
        f.flag(&mut self.double_sided)?;
        f.flag(&mut self.unlit)?;
        f.number(&mut self.ior)?;
        f.map(&mut self.transmission)?;
        f.option(&mut self.volume, [0.0; 3], |f, volume| f.numbers(volume))?;
        f.map(&mut self.specular.strength)?;
        f.colour(&mut self.specular.colour)?;
        f.map(&mut self.clearcoat.strength)?;
        f.map(&mut self.clearcoat.roughness)?;
        f.normal(&mut self.clearcoat.normal)?;
        f.colour(&mut self.sheen.colour)?;
        f.map(&mut self.sheen.roughness)?;
        f.number(&mut self.anisotropy.strength)?;
        f.number(&mut self.anisotropy.rotation)?;
        f.texture(&mut self.anisotropy.texture)?;
        f.map(&mut self.iridescence.strength)?;
        f.number(&mut self.iridescence.ior)?;
        f.numbers(&mut self.iridescence.thickness_nm)?;
        f.texture(&mut self.iridescence.thickness_texture)?;
        f.map(&mut self.diffuse_transmission.strength)?;
        f.colour(&mut self.diffuse_transmission.colour)
    }
}

/// Visitor of the fields of a material, with one method for each type of field.
trait Fields: Sized {
    fn numbers(&mut self, v: &mut [f32]) -> Result<(), Corrupt>;
    fn tag(&mut self, v: &mut u8, largest: u8) -> Result<(), Corrupt>;
    fn texture_index(&mut self, v: &mut TextureRef) -> Result<(), Corrupt>;

    fn number(&mut self, v: &mut f32) -> Result<(), Corrupt> {
        self.numbers(std::slice::from_mut(v))
    }

    fn flag(&mut self, v: &mut bool) -> Result<(), Corrupt> {
        let mut tag = u8::from(*v);
        self.tag(&mut tag, 1)?;
        *v = tag == 1;
        Ok(())
    }

    fn option<T>(
        &mut self,
        v: &mut Option<T>,
        empty: T,
        inner: impl FnOnce(&mut Self, &mut T) -> Result<(), Corrupt>,
    ) -> Result<(), Corrupt> {
        let mut some = v.is_some();
        self.flag(&mut some)?;
        if !some {
            *v = None;
            return Ok(());
        }
        inner(self, v.get_or_insert(empty))
    }

    fn reference(&mut self, v: &mut TextureRef) -> Result<(), Corrupt> {
        self.texture_index(v)?;
        for wrap in [&mut v.sampler.wrap_u, &mut v.sampler.wrap_v] {
            let mut tag = *wrap as u8;
            self.tag(&mut tag, 2)?;
            *wrap = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp][tag as usize];
        }
        self.flag(&mut v.sampler.nearest)?;
        let none = TextureTransform { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] };
        self.option(&mut v.transform, none, |f, t| {
            f.numbers(&mut t.offset)?;
            f.number(&mut t.rotation)?;
            f.numbers(&mut t.scale)
        })
    }

    fn texture(&mut self, v: &mut Option<TextureRef>) -> Result<(), Corrupt> {
        self.option(v, NOTHING, Self::reference)
    }

    fn normal(&mut self, v: &mut Option<NormalMap>) -> Result<(), Corrupt> {
        self.option(v, NormalMap { texture: NOTHING, scale: 1.0 }, |f, map| {
            f.reference(&mut map.texture)?;
            f.number(&mut map.scale)
        })
    }

    fn map(&mut self, v: &mut Map) -> Result<(), Corrupt> {
        self.number(&mut v.factor)?;
        self.texture(&mut v.texture)
    }

    fn colour(&mut self, v: &mut ColourMap) -> Result<(), Corrupt> {
        self.numbers(&mut v.factor)?;
        self.texture(&mut v.texture)
    }
}

/// Placeholder for a reference to a texture, which the decoder overwrites.
const NOTHING: TextureRef = TextureRef {
    texture: 0,
    uv_set: 0,
    sampler: Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false },
    transform: None,
};

struct Write<'a>(&'a mut Encoder);

impl Fields for Write<'_> {
    fn numbers(&mut self, v: &mut [f32]) -> Result<(), Corrupt> {
        self.0.f32s(v);
        Ok(())
    }
    fn tag(&mut self, v: &mut u8, _largest: u8) -> Result<(), Corrupt> {
        self.0.u8(*v);
        Ok(())
    }
    fn texture_index(&mut self, v: &mut TextureRef) -> Result<(), Corrupt> {
        self.0.u32(v.texture);
        self.0.u32(v.uv_set);
        Ok(())
    }
}

struct Read<'a, 'b> {
    from: &'a mut Decoder<'b>,
    textures: usize,
}

impl Fields for Read<'_, '_> {
    fn numbers(&mut self, v: &mut [f32]) -> Result<(), Corrupt> {
        let read = self.from.f32s()?;
        if read.len() != v.len() {
            return Err(Corrupt(format!(
                "a field of a material has {} numbers instead of {}",
                read.len(),
                v.len()
            )));
        }
        v.copy_from_slice(&read);
        Ok(())
    }
    fn tag(&mut self, v: &mut u8, largest: u8) -> Result<(), Corrupt> {
        *v = self.from.u8()?;
        if *v <= largest { Ok(()) } else { Err(Corrupt(format!("a material has the unknown tag {v}"))) }
    }
    fn texture_index(&mut self, v: &mut TextureRef) -> Result<(), Corrupt> {
        (v.texture, v.uv_set) = (self.from.u32()?, self.from.u32()?);
        if v.texture as usize >= self.textures || v.uv_set > 1 {
            return Err(Corrupt(format!("a material refers to texture {}, which does not exist", v.texture)));
        }
        Ok(())
    }
}
