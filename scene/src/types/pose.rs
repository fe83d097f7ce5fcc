//! Poses of objects.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use glam::{DMat4, DVec3};

use super::rig::exactly;

/// The pose of an object: an affine transform from a local frame to the world. The local frame has its origin at
/// the foot of the object, and its axes are parallel to the axes of the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// Transform from the local frame to the world, in world units.
    pub world_from_local: DMat4,
}

impl Pose {
    /// The foot of the object, in world units.
    pub fn translation(&self) -> DVec3 {
        self.world_from_local.w_axis.truncate()
    }
}

impl Artifact for Pose {
    const TYPE: &'static str = "pose";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.f64s(&self.world_from_local.to_cols_array());
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        Ok(Self { world_from_local: DMat4::from_cols_array(&exactly(from.f64s()?)?) })
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        Difference::of(format!("moved by {:.4} units", (self.translation() - other.translation()).length()))
    }
}
