//! Transforms of nodes and their instances, and of normals and tangents.

use glam::{DMat3, DMat4, DQuat, DVec3};
use gltf::Node;
use gltf::scene::Transform;

use super::Geometry;
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
            Some(bad) => Err(self.bad(format!("instance {bad} of node {} is not finite", node.index()))),
            None => Ok(instances),
        }
    }
}

/// The transform from the frame of a node to the frame of its parent.
pub(crate) fn local(transform: &Transform) -> DMat4 {
    match transform {
        Transform::Matrix { matrix } => {
            DMat4::from_cols_array(&std::array::from_fn(|i| f64::from(matrix[i / 4][i % 4])))
        }
        Transform::Decomposed { translation, rotation, scale } => {
            let [t, s] = [translation, scale].map(|v| DVec3::from_array(v.map(f64::from)));
            DMat4::from_scale_rotation_translation(s, self::rotation(rotation.map(f64::from)), t)
        }
    }
}

/// Converts a quaternion to a rotation after normalising it. A quaternion of length 0 gives the identity.
fn rotation(q: [f64; 4]) -> DQuat {
    let q = DQuat::from_array(q);
    if q.length() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
}

/// The matrix that transforms normals, up to a positive factor.
pub(super) fn inverse_transpose(m: DMat3) -> DMat3 {
    // Cofactors: the inverse transpose times the determinant, so a singular matrix causes no division by 0. The
    // sign of the determinant gives normals of a mirror the right orientation.
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let sign = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

/// Transforms a unit vector and normalises the result. Returns the zero vector if the result has length 0.
pub(super) fn turned(m: DMat3, v: DVec3) -> [f32; 3] {
    let unit = (m * v).try_normalize().unwrap_or(DVec3::ZERO);
    unit.as_vec3().to_array()
}
