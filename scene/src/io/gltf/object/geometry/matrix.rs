//! Matrices of nodes, and of normals and tangents.

use glam::{DMat3, DMat4, DQuat, DVec3};
use gltf::scene::Transform;

/// The transform from the frame of a node to the frame of its parent.
pub fn local(transform: &Transform) -> DMat4 {
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
pub(super) fn rotation(q: [f64; 4]) -> DQuat {
    let q = DQuat::from_array(q);
    if q.length() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
}

/// The matrix that transforms normals, up to a positive factor.
pub(in crate::io::gltf) fn inverse_transpose(m: DMat3) -> DMat3 {
    // Cofactors: the inverse transpose times the determinant, so a singular matrix causes no division by 0. The
    // sign of the determinant gives normals of a mirror the right orientation.
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let sign = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

/// Transforms a unit vector and normalises the result. Returns the zero vector if the result has length 0.
pub(in crate::io::gltf) fn turned(m: DMat3, v: DVec3) -> [f32; 3] {
    let unit = (m * v).try_normalize().unwrap_or(DVec3::ZERO);
    unit.as_vec3().to_array()
}
