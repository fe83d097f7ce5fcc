//! Objects to insert: meshes with materials, in the frame of their file.

use std::sync::Arc;

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use glam::DMat4;

use super::material::{Material, Texture};
use super::mesh::grouped;
use super::rig::exactly;

/// A part of an object with one material. Node transforms are already applied. Attribute arrays are empty or have
/// one entry per vertex.
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
    /// Counter-clockwise triangles of vertex indices, each below the number of vertices.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Object::materials`].
    pub material: u32,
}

/// A mesh object to insert, in the frame of its file: right-handed, y up, metres.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Object {
    /// Parts of the object.
    pub primitives: Vec<Primitive>,
    /// Materials of the parts.
    pub materials: Vec<Material>,
    /// Textures of the materials.
    pub textures: Vec<Texture>,
}

/// An object and its placement in the world. Port type `placed`.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// The object.
    pub object: Arc<Object>,
    /// Affine transform from the frame of the object's file to the world, in world units.
    pub world_from_object: DMat4,
}

impl Object {
    /// The materials that at least one triangle uses.
    pub fn materials_in_use(&self) -> impl Iterator<Item = &Material> {
        let mut used = vec![false; self.materials.len()];
        for primitive in self.primitives.iter().filter(|primitive| !primitive.triangles.is_empty()) {
            used.get_mut(primitive.material as usize).into_iter().for_each(|used| *used = true);
        }
        self.materials.iter().zip(used).filter(|(_, used)| *used).map(|(material, _)| material)
    }
}

impl Artifact for Object {
    const TYPE: &'static str = "object";
    const FORMAT: u32 = 2;

    fn encode(&self, to: &mut Encoder) {
        to.u64(self.textures.len() as u64);
        for texture in &self.textures {
            to.u32(texture.width);
            to.u32(texture.height);
            to.u8s(&texture.rgba);
        }
        to.u64(self.materials.len() as u64);
        for m in &self.materials {
            m.encode(to);
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
                return Err(Corrupt("a texture does not have the size that it declares".to_owned()));
            }
            object.textures.push(texture);
        }
        let textures = object.textures.len();
        for _ in 0..from.length(64)? {
            object.materials.push(Material::decode(from, textures)?);
        }
        for _ in 0..from.length(60)? {
            let primitive = Primitive {
                positions: grouped(from.f32s()?)?,
                normals: grouped(from.f32s()?)?,
                tangents: grouped(from.f32s()?)?,
                uv0: grouped(from.f32s()?)?,
                uv1: grouped(from.f32s()?)?,
                colours: grouped(from.f32s()?)?,
                triangles: grouped(from.u32s()?)?,
                material: from.u32()?,
            };
            if !primitive.is_consistent() || primitive.material as usize >= object.materials.len() {
                return Err(Corrupt("a primitive refers to data that does not exist".to_owned()));
            }
            object.primitives.push(primitive);
        }
        Ok(object)
    }

    fn bytes(&self) -> usize {
        let textures: usize = self.textures.iter().map(|texture| texture.rgba.len()).sum();
        let vertices: usize =
            self.primitives.iter().map(|p| p.positions.len() * 72 + p.triangles.len() * 12).sum();
        textures + vertices + self.materials.len() * 1024
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let triangles = |object: &Self| object.primitives.iter().map(|p| p.triangles.len()).sum::<usize>();
        let (count, others) = (triangles(self), triangles(other));
        Difference::of(if count == others {
            format!("the numbers of triangles are equal ({count}), but other data differ")
        } else {
            format!("the numbers of triangles differ: {count} and {others}")
        })
    }
}

impl Primitive {
    /// True if every attribute array is empty or has one entry per vertex, and every index is in range.
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
    const FORMAT: u32 = 2;

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
        if self == other {
            Difference::none()
        } else {
            Difference::of("the same object with a different pose")
        }
    }
}
