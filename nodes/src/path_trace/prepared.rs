//! The inputs in the form that rays want.

use std::sync::OnceLock;

use glam::DVec3;

use super::In;
use super::environment::EnvironmentLight;
use super::light_points::LightPoints;
use super::receiver::Receiver;

/// The inputs in the form that rays want. Trees are built when a part first needs them.
pub(super) struct PreparedScene<'a> {
    pub(super) inputs: &'a In,
    /// Where the coordinates of rays and triangles start, in the world.
    pub(super) origin: DVec3,
    receiver: OnceLock<Receiver>,
    sky: OnceLock<EnvironmentLight>,
    light_points: OnceLock<LightPoints>,
}

impl<'a> PreparedScene<'a> {
    pub(super) fn new(inputs: &'a In, origin: DVec3) -> Self {
        Self {
            inputs,
            origin,
            receiver: OnceLock::new(),
            sky: OnceLock::new(),
            light_points: OnceLock::new(),
        }
    }

    pub(super) fn receiver(&self) -> &Receiver {
        self.receiver.get_or_init(|| Receiver::new(&self.inputs.receiver, self.origin))
    }
    pub(super) fn sky(&self) -> &EnvironmentLight {
        self.sky.get_or_init(|| EnvironmentLight::new(&self.inputs.env))
    }
    /// Of the one point of capture.
    pub(super) fn light_points(&self, eye: [f32; 3]) -> &LightPoints {
        let new = || LightPoints::new(self.receiver(), self.sky(), eye.into());
        self.light_points.get_or_init(new)
    }
}
