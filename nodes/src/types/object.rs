//! Objects to insert: meshes with materials, in the frame of their file.

use std::sync::Arc;

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use glam::DMat4;

use super::mesh::triples;
use super::rig::exactly;

/// How a texture continues beyond its edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrap {
    /// Tiles.
    Repeat,
    /// Tiles, every other one mirrored.
    Mirror,
    /// Repeats the edge texel.
    Clamp,
}

/// How texels become a value between them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sampler {
    /// Along u.
    pub wrap_u: Wrap,
    /// Along v.
    pub wrap_v: Wrap,
    /// The texel that the point lies in, instead of bilinear.
    pub nearest: bool,
}

/// A decoded picture: 8-bit RGBA as stored, row 0 at v = 0. Whether it is sRGB-encoded depends on what
/// refers to it: base colour and emissive are, the others are not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Four bytes a texel, row by row.
    pub rgba: Vec<u8>,
}

/// KHR_texture_transform: uv' = translation * rotation * scale * uv.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureTransform {
    /// Offset, in units of the texture.
    pub offset: [f32; 2],
    /// Rotation in radians, counter-clockwise.
    pub rotation: f32,
    /// Scale.
    pub scale: [f32; 2],
}

/// A use of a texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureRef {
    /// Index into [`Object::textures`].
    pub texture: u32,
    /// Which set of texture coordinates, 0 or 1.
    pub uv_set: u32,
    /// Wrapping and filtering.
    pub sampler: Sampler,
    /// Transform of the coordinates.
    pub transform: Option<TextureTransform>,
}

/// What alpha does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AlphaMode {
    /// Nothing.
    Opaque,
    /// Cuts away what lies below the cut-off.
    Mask(f32),
    /// Lets light through in proportion.
    Blend,
}

/// A glTF metallic-roughness material. Factors multiply textures; colours are linear.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the file.
    pub name: String,
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// sRGB texture of base colour and alpha.
    pub base_colour_texture: Option<TextureRef>,
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1.
    pub roughness: f32,
    /// Linear texture: green roughness, blue metallic.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Tangent-space normal map.
    pub normal_texture: Option<TextureRef>,
    /// Scale of its x and y.
    pub normal_scale: f32,
    /// Red channel darkens indirect light in rasterizers; a path tracer computes it instead.
    pub occlusion_texture: Option<TextureRef>,
    /// Strength of the occlusion texture.
    pub occlusion_strength: f32,
    /// Linear emitted radiance, with KHR_materials_emissive_strength multiplied in.
    pub emissive: [f32; 3],
    /// sRGB texture of emission.
    pub emissive_texture: Option<TextureRef>,
    /// What alpha does.
    pub alpha_mode: AlphaMode,
    /// Lit from both sides; else the back is culled for camera rays.
    pub double_sided: bool,
    /// KHR_materials_ior: index of refraction, 1.5 by default.
    pub ior: f32,
    /// KHR_materials_transmission factor, 0 to 1.
    pub transmission: f32,
    /// KHR_materials_clearcoat factor, 0 to 1.
    pub clearcoat: f32,
    /// Roughness of the clearcoat, 0 to 1.
    pub clearcoat_roughness: f32,
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
            normal_texture: None,
            normal_scale: 1.0,
            occlusion_texture: None,
            occlusion_strength: 1.0,
            emissive: [0.0; 3],
            emissive_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            ior: 1.5,
            transmission: 0.0,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
        }
    }
}

/// A part of an object with one material. Node transforms are already applied. Attribute arrays are
/// empty or have one entry a vertex.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Primitive {
    /// Positions in metres, in the frame of the file (glTF: y up).
    pub positions: Vec<[f32; 3]>,
    /// Unit shading normals.
    pub normals: Vec<[f32; 3]>,
    /// Unit tangents and the sign of the bitangent.
    pub tangents: Vec<[f32; 4]>,
    /// Texture coordinates of set 0.
    pub uv0: Vec<[f32; 2]>,
    /// Texture coordinates of set 1.
    pub uv1: Vec<[f32; 2]>,
    /// Linear vertex colours and alpha, multiplied into the base colour.
    pub colours: Vec<[f32; 4]>,
    /// Counter-clockwise triangles, indices below the number of vertices.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Object::materials`].
    pub material: u32,
}

/// A mesh object to insert, in the frame of its file: right-handed, y up, metres.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Object {
    /// Its parts.
    pub primitives: Vec<Primitive>,
    /// Their materials.
    pub materials: Vec<Material>,
    /// Their textures.
    pub textures: Vec<Texture>,
}

/// An object that stands somewhere. Port type `placed`.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// The object.
    pub object: Arc<Object>,
    /// Affine transform from the frame of the object's file to the world, in world units.
    pub world_from_object: DMat4,
}

const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];

fn encode_ref(texture: Option<TextureRef>, to: &mut Encoder) {
    to.bool(texture.is_some());
    let Some(texture) = texture else { return };
    to.u32(texture.texture);
    to.u32(texture.uv_set);
    to.u8(texture.sampler.wrap_u as u8);
    to.u8(texture.sampler.wrap_v as u8);
    to.bool(texture.sampler.nearest);
    to.bool(texture.transform.is_some());
    if let Some(TextureTransform { offset, rotation, scale }) = texture.transform {
        to.f32s(&[offset[0], offset[1], rotation, scale[0], scale[1]]);
    }
}

fn decode_ref(from: &mut Decoder<'_>, textures: usize) -> Result<Option<TextureRef>, Corrupt> {
    if !from.bool()? {
        return Ok(None);
    }
    let (texture, uv_set) = (from.u32()?, from.u32()?);
    let wrap = |tag: u8| WRAPS.get(tag as usize).copied().ok_or_else(|| Corrupt(format!("wrap {tag}")));
    let sampler = Sampler { wrap_u: wrap(from.u8()?)?, wrap_v: wrap(from.u8()?)?, nearest: from.bool()? };
    let transform = if from.bool()? {
        let [a, b, rotation, c, d]: [f32; 5] =
            from.f32s()?.try_into().map_err(|_| Corrupt("texture transform".to_owned()))?;
        Some(TextureTransform { offset: [a, b], rotation, scale: [c, d] })
    } else {
        None
    };
    if texture as usize >= textures || uv_set > 1 {
        return Err(Corrupt(format!("texture {texture} of {textures}")));
    }
    Ok(Some(TextureRef { texture, uv_set, sampler, transform }))
}

fn array<const N: usize>(from: &mut Decoder<'_>) -> Result<[f32; N], Corrupt> {
    from.f32s()?.try_into().map_err(|v: Vec<f32>| Corrupt(format!("{} numbers where {N} belong", v.len())))
}

impl Artifact for Object {
    const TYPE: &'static str = "object";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.u64(self.textures.len() as u64);
        for texture in &self.textures {
            to.u32(texture.width);
            to.u32(texture.height);
            to.u8s(&texture.rgba);
        }
        to.u64(self.materials.len() as u64);
        for m in &self.materials {
            to.str(&m.name);
            to.f32s(&m.base_colour);
            to.f32s(&[m.metallic, m.roughness, m.normal_scale, m.occlusion_strength]);
            to.f32s(&m.emissive);
            to.f32s(&[m.ior, m.transmission, m.clearcoat, m.clearcoat_roughness]);
            let (mode, cutoff) = match m.alpha_mode {
                AlphaMode::Opaque => (0, 0.0),
                AlphaMode::Mask(cutoff) => (1, cutoff),
                AlphaMode::Blend => (2, 0.0),
            };
            to.u8(mode);
            to.f32(cutoff);
            to.bool(m.double_sided);
            for texture in [
                m.base_colour_texture,
                m.metallic_roughness_texture,
                m.normal_texture,
                m.occlusion_texture,
                m.emissive_texture,
            ] {
                encode_ref(texture, to);
            }
        }
        to.u64(self.primitives.len() as u64);
        for p in &self.primitives {
            to.f32s(p.positions.as_flattened());
            to.f32s(p.normals.as_flattened());
            to.f32s(p.tangents.as_flattened());
            to.f32s(p.uv0.as_flattened());
            to.f32s(p.uv1.as_flattened());
            to.f32s(p.colours.as_flattened());
            to.u32s(p.triangles.as_flattened());
            to.u32(p.material);
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let mut object = Self::default();
        for _ in 0..from.length(16)? {
            let texture = Texture { width: from.u32()?, height: from.u32()?, rgba: from.u8s()? };
            if u64::from(texture.width) * u64::from(texture.height) * 4 != texture.rgba.len() as u64 {
                return Err(Corrupt("texture of another size".to_owned()));
            }
            object.textures.push(texture);
        }
        let textures = object.textures.len();
        for _ in 0..from.length(64)? {
            let name = from.str()?;
            let base_colour = array(from)?;
            let [metallic, roughness, normal_scale, occlusion_strength] = array(from)?;
            let emissive = array(from)?;
            let [ior, transmission, clearcoat, clearcoat_roughness] = array(from)?;
            let alpha_mode = match (from.u8()?, from.f32()?) {
                (0, _) => AlphaMode::Opaque,
                (1, cutoff) => AlphaMode::Mask(cutoff),
                (2, _) => AlphaMode::Blend,
                (other, _) => return Err(Corrupt(format!("alpha mode {other}"))),
            };
            object.materials.push(Material {
                name,
                base_colour,
                metallic,
                roughness,
                normal_scale,
                occlusion_strength,
                emissive,
                ior,
                transmission,
                clearcoat,
                clearcoat_roughness,
                alpha_mode,
                double_sided: from.bool()?,
                base_colour_texture: decode_ref(from, textures)?,
                metallic_roughness_texture: decode_ref(from, textures)?,
                normal_texture: decode_ref(from, textures)?,
                occlusion_texture: decode_ref(from, textures)?,
                emissive_texture: decode_ref(from, textures)?,
            });
        }
        for _ in 0..from.length(60)? {
            let primitive = Primitive {
                positions: triples(from.f32s()?)?,
                normals: triples(from.f32s()?)?,
                tangents: from.f32s()?.as_chunks::<4>().0.to_vec(),
                uv0: from.f32s()?.as_chunks::<2>().0.to_vec(),
                uv1: from.f32s()?.as_chunks::<2>().0.to_vec(),
                colours: from.f32s()?.as_chunks::<4>().0.to_vec(),
                triangles: triples(from.u32s()?)?,
                material: from.u32()?,
            };
            if !primitive.is_consistent() || primitive.material as usize >= object.materials.len() {
                return Err(Corrupt("a primitive that names what it does not have".to_owned()));
            }
            object.primitives.push(primitive);
        }
        Ok(object)
    }

    fn bytes(&self) -> usize {
        let textures: usize = self.textures.iter().map(|texture| texture.rgba.len()).sum();
        let vertices: usize =
            self.primitives.iter().map(|p| p.positions.len() * 72 + p.triangles.len() * 12).sum();
        textures + vertices + self.materials.len() * 256
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let triangles = |object: &Self| object.primitives.iter().map(|p| p.triangles.len()).sum::<usize>();
        Difference::of(format!("{} triangles against {}", triangles(self), triangles(other)))
    }
}

impl Primitive {
    /// True when every attribute array is empty or of one length and every index is in range.
    pub fn is_consistent(&self) -> bool {
        let n = self.positions.len();
        let fits = |len: usize| len == 0 || len == n;
        let attributes =
            [self.normals.len(), self.tangents.len(), self.uv0.len(), self.uv1.len(), self.colours.len()];
        attributes.into_iter().all(fits) && self.triangles.as_flattened().iter().all(|&v| (v as usize) < n)
    }
}

impl Artifact for Placed {
    const TYPE: &'static str = "placed";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.f64s(&self.world_from_object.to_cols_array());
        self.object.encode(to);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let world_from_object = DMat4::from_cols_array(&exactly(from.f64s()?)?);
        Ok(Self { world_from_object, object: Arc::new(Object::decode(from)?) })
    }

    fn bytes(&self) -> usize {
        self.object.bytes() + 128
    }

    fn difference(&self, other: &Self) -> Difference {
        if self.object != other.object {
            return self.object.difference(&other.object);
        }
        if self == other { Difference::none() } else { Difference::of("the same object elsewhere") }
    }
}
