//! The inputs in the form that rays want.

use std::sync::Arc;

use engine::{Context, NodeError, Part};
use glam::DVec3;

use super::In;
use super::environment::EnvironmentLight;
use super::light_points::LightPoints;
use super::receiver::Receiver;

/// The inputs in the form that rays want. Pictures of the same place and light share them.
pub(super) struct PreparedScene<'a> {
    pub(super) inputs: &'a In,
    /// Where the coordinates of rays and triangles start, in the world.
    pub(super) origin: DVec3,
    cx: &'a Context,
    receiver: Arc<Receiver>,
    sky: Arc<EnvironmentLight>,
}

impl<'a> PreparedScene<'a> {
    pub(super) fn new(inputs: &'a In, origin: DVec3, cx: &'a Context) -> Result<Self, NodeError> {
        let part = Part { name: "receiver", version: 1, inputs: &["receiver"] };
        let new = || Receiver::new(&inputs.receiver, origin);
        let receiver = cx.in_memory(part, &origin.to_array(), Receiver::bytes, new)?;
        let part = Part { name: "sky", version: 1, inputs: &["env"] };
        let new = || EnvironmentLight::new(&inputs.env);
        let sky = cx.in_memory(part, &(), EnvironmentLight::bytes, new)?;
        Ok(Self { inputs, origin, cx, receiver, sky })
    }

    pub(super) fn receiver(&self) -> &Receiver {
        &self.receiver
    }

    pub(super) fn sky(&self) -> &EnvironmentLight {
        &self.sky
    }

    /// Of a point of capture.
    pub(super) fn light_points(&self, eye: [f32; 3]) -> Result<Arc<LightPoints>, NodeError> {
        let part = Part { name: "light-points", version: 1, inputs: &["receiver", "env"] };
        let new = || LightPoints::new(&self.receiver, &self.sky, eye.into());
        self.cx.in_memory(part, &(self.origin.to_array(), eye), LightPoints::bytes, new)
    }
}
