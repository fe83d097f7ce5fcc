//! Transforms that a node of glTF cannot have.

use glam::{DMat3, DMat4, DVec3};

use crate::io::gltf::object::{inverse_transpose, turned};
use crate::types::Object;

/// Largest cosine of the angle between two axes that counts as a right angle. Matrices are often rounded to six
/// digits.
const SKEW: f64 = 1e-5;

/// True if the matrix is not a translation, a rotation and a scale along the axes of the object. glTF requires these
/// parts of the matrix of a node: viewers decompose the matrix, and a shear would be lost.
pub(super) fn is_sheared(matrix: DMat4) -> bool {
    let linear = DMat3::from_mat4(matrix);
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
    [(x, y), (y, z), (z, x)].iter().any(|(a, b)| a.dot(*b).abs() > SKEW * a.length() * b.length())
}

/// The object with the transform applied to its vertices. The winding of a mirrored object is reversed, so that its
/// triangles are counter-clockwise again.
pub(super) fn transformed(object: &Object, matrix: DMat4) -> Object {
    let linear = DMat3::from_mat4(matrix);
    let (of_normals, mirrored) = (inverse_transpose(linear), linear.determinant() < 0.0);
    let vec3 = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let mut made = object.clone();
    for p in &mut made.primitives {
        p.positions.iter_mut().for_each(|v| *v = matrix.transform_point3(vec3(*v)).as_vec3().to_array());
        p.normals.iter_mut().for_each(|v| *v = turned(of_normals, vec3(*v)));
        for [x, y, z, sign] in &mut p.tangents {
            [*x, *y, *z] = turned(linear, vec3([*x, *y, *z]));
            *sign = if mirrored { -*sign } else { *sign };
        }
        if mirrored {
            p.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }
    made
}
