//! The inputs in the form that rays want.

use std::sync::OnceLock;

use glam::DVec3;

use super::In;
use super::light::Sky;
use super::scene::Receiver;
use crate::types::Mesh;

/// The inputs in the form that rays want. Trees are built when a part first needs them.
pub(super) struct Stage<'a> {
    pub(super) inputs: &'a In,
    pub(super) origin: DVec3,
    receiver: OnceLock<Receiver>,
    sky: OnceLock<Sky>,
}

impl<'a> Stage<'a> {
    pub(super) fn new(inputs: &'a In, origin: DVec3) -> Self {
        Self { inputs, origin, receiver: OnceLock::new(), sky: OnceLock::new() }
    }

    pub(super) fn receiver(&self) -> &Receiver {
        self.receiver.get_or_init(|| Receiver::new(&self.inputs.receiver, self.origin))
    }
    pub(super) fn sky(&self) -> &Sky {
        self.sky.get_or_init(|| Sky::new(&self.inputs.env))
    }
}

/// The middle of the box around a mesh.
pub(super) fn middle(mesh: &Mesh) -> Option<DVec3> {
    let finite = mesh.positions.iter().map(|p| DVec3::from_array(p.map(f64::from))).filter(|p| p.is_finite());
    let (low, high) = finite.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))?;
    Some((low + high) * 0.5)
}
