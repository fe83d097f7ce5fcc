//! The inputs in the form that rays want.

use std::sync::OnceLock;

use glam::DVec3;

use super::In;
use super::environment::EnvironmentLight;
use super::receiver::Receiver;

/// The inputs in the form that rays want. Trees are built when a part first needs them.
pub(super) struct PreparedScene<'a> {
    pub(super) inputs: &'a In,
    /// Where the coordinates of rays and triangles start, in the world.
    pub(super) origin: DVec3,
    receiver: OnceLock<Receiver>,
    sky: OnceLock<EnvironmentLight>,
}

impl<'a> PreparedScene<'a> {
    pub(super) fn new(inputs: &'a In, origin: DVec3) -> Self {
        Self { inputs, origin, receiver: OnceLock::new(), sky: OnceLock::new() }
    }

    pub(super) fn receiver(&self) -> &Receiver {
        self.receiver.get_or_init(|| Receiver::new(&self.inputs.receiver, self.origin))
    }
    pub(super) fn sky(&self) -> &EnvironmentLight {
        self.sky.get_or_init(|| EnvironmentLight::new(&self.inputs.env))
    }
}
