//! Acceleration structures and sampling tables of a scene.

use std::sync::Arc;

use engine::{Context, NodeError, Part};
use glam::DVec3;
use scene::types::{Environment, Mesh};

use crate::transport::path::light_points::LightPoints;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::environment::EnvironmentLight;

/// The receiver and the environment, prepared for rays. Images of the same place and light share them.
pub struct PreparedScene<'a> {
    /// Origin of the frame of the scene, in the world.
    pub origin: DVec3,
    cx: &'a Context,
    receiver: Arc<Receiver>,
    sky: Arc<EnvironmentLight>,
}

impl<'a> PreparedScene<'a> {
    /// Prepares the receiver and the environment, or takes them from memory.
    ///
    /// # Errors
    /// If the mesh is not valid, or the run was cancelled.
    pub fn new(mesh: &Mesh, env: &Environment, origin: DVec3, cx: &'a Context) -> Result<Self, NodeError> {
        let part = Part { name: "receiver", version: 1, inputs: &["receiver"] };
        let new = || Receiver::new_in(mesh, origin, cx);
        let receiver = cx.in_memory(part, &origin.to_array(), Receiver::bytes, new)?;
        let part = Part { name: "sky", version: 1, inputs: &["env"] };
        let new = || Ok(EnvironmentLight::new(env));
        let sky = cx.in_memory(part, &(), EnvironmentLight::bytes, new)?;
        Ok(Self { origin, cx, receiver, sky })
    }

    /// The receiver.
    pub fn receiver(&self) -> &Receiver {
        &self.receiver
    }

    /// The environment.
    pub fn sky(&self) -> &EnvironmentLight {
        &self.sky
    }

    /// Virtual lights that are visible from a point of capture.
    pub(crate) fn light_points(&self, eye: [f32; 3]) -> Result<Arc<LightPoints>, NodeError> {
        let part = Part { name: "light-points", version: 1, inputs: &["receiver", "env"] };
        let new = || Ok(LightPoints::new(&self.receiver, &self.sky, eye.into()));
        self.cx.in_memory(part, &(self.origin.to_array(), eye), LightPoints::bytes, new)
    }
}
