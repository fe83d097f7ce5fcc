//! Values with a position in space: splats, meshes, objects and cameras.

use std::sync::Arc;

use cache::Digest;
use engine::{Engine, Graph, Wire};
use scene::types::{Mesh, Object, Placed, Rig, Splats};

use crate::values::{Weight, stored_or_computed};

/// Types of values that the place view reads.
pub const TYPES: [&str; 5] = ["splats", "mesh", "object", "placed", "rig"];

/// A decoded value with a position in space.
pub enum Thing {
    /// A captured place.
    Splats(Arc<Splats>),
    /// A mesh of the place.
    Mesh(Arc<Mesh>),
    /// An object in the frame of its file.
    Object(Arc<Object>),
    /// An object in the world.
    Placed(Arc<Placed>),
    /// Cameras.
    Rig(Arc<Rig>),
}

impl Thing {
    /// Gets a value of type `type_name` from memory or from the store, or computes it again from `wire`, the output
    /// that has the value now. `None` if the value is gone or has no position in space.
    pub fn read(
        engine: &Engine,
        type_name: &str,
        digest: &Digest,
        wire: Option<(&Graph, Wire)>,
    ) -> Option<Self> {
        macro_rules! value {
            ($type:ident) => {
                engine
                    .in_memory::<$type>(digest)
                    .or_else(|| stored_or_computed(engine, digest, wire).map(Arc::new))
                    .map(Self::$type)
            };
        }
        match type_name {
            "splats" => value!(Splats),
            "mesh" => value!(Mesh),
            "object" => value!(Object),
            "placed" => value!(Placed),
            "rig" => value!(Rig),
            _ => None,
        }
    }

    /// The mesh of an object, whether it is placed or not.
    pub fn object(&self) -> Option<&Object> {
        match self {
            Self::Object(object) => Some(object.as_ref()),
            Self::Placed(placed) => Some(placed.object.as_ref()),
            _ => None,
        }
    }
}

impl Weight for Thing {
    fn bytes(&self) -> usize {
        match self {
            Self::Splats(splats) => splats.len() * (44 + 12 * splats.sh_len()),
            Self::Mesh(mesh) => (mesh.positions.len() * 3 + mesh.triangles.len()) * 12,
            Self::Object(_) | Self::Placed(_) => self.object().map_or(0, |object| {
                let textures: usize = object.textures.iter().map(|texture| texture.rgba.len()).sum();
                let parts = object.primitives.iter();
                textures
                    + parts.map(|part| part.positions.len() * 72 + part.triangles.len() * 12).sum::<usize>()
            }),
            Self::Rig(rig) => rig.cameras.len() * 256,
        }
    }
}
