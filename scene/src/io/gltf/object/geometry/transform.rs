//! Transforms of the instances of a mesh.

use glam::{DMat4, DVec3};
use gltf::Node;

use super::Geometry;
use super::matrix::rotation;
use crate::error::Error;

impl Geometry<'_> {
    /// Transforms of the instances of a node's mesh (EXT_mesh_gpu_instancing), in the frame of the node. Without
    /// the extension there is one instance, with the identity.
    pub(super) fn instances(&mut self, node: &Node<'_>) -> Result<Vec<DMat4>, Error> {
        let attributes =
            &self.file.json["nodes"][node.index()]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
        let mut count = None;
        let mut read = |semantic: &str, width: usize| -> Result<Vec<f64>, Error> {
            let Some(index) = attributes[semantic].as_u64() else { return Ok(Vec::new()) };
            let accessor = self.file.document.accessors().nth(index as usize);
            let accessor = accessor.ok_or_else(|| {
                self.bad(format!(
                    "the attribute {semantic} of the instances refers to an accessor that does not exist"
                ))
            })?;
            let numbers = self.numbers(&accessor)?;
            if numbers.width != width || *count.get_or_insert(accessor.count()) != accessor.count() {
                return Err(self.bad(format!(
                    "the attribute {semantic} of the instances has the wrong type, or not as many values as the others"
                )));
            }
            Ok(numbers.values)
        };
        let (places, turns) = (read("TRANSLATION", 3)?, read("ROTATION", 4)?);
        let scales = read("SCALE", 3)?;
        let Some(count) = count else { return Ok(vec![DMat4::IDENTITY]) };
        self.tally.instances += count as u64;
        let triple = |values: &[f64], i: usize, default: f64| {
            values.as_chunks::<3>().0.get(i).map_or(DVec3::splat(default), |v| DVec3::from_array(*v))
        };
        let instance = |i: usize| {
            let turn = turns.as_chunks::<4>().0.get(i).copied().unwrap_or([0.0, 0.0, 0.0, 1.0]);
            let (scale, place) = (triple(&scales, i, 1.0), triple(&places, i, 0.0));
            DMat4::from_scale_rotation_translation(scale, rotation(turn), place)
        };
        let instances: Vec<DMat4> = (0..count).map(instance).collect();
        match instances.iter().position(|m| !m.is_finite()) {
            Some(bad) => {
                Err(self
                    .bad(format!("the transform of instance {bad} of node {} is not finite", node.index())))
            }
            None => Ok(instances),
        }
    }
}
