//! Objects that no file can store.

use engine::NodeError;
use glam::{DMat3, DMat4, DVec4};
use serde_json::Value;

use crate::types::{Object, Primitive, Texture};

/// Error in an object, and advice.
#[derive(Debug)]
pub(super) struct Bad {
    what: String,
    hint: &'static str,
}

impl Bad {
    /// An error in the data of an object.
    pub(super) fn data(what: impl Into<String>) -> Self {
        Self { what: what.into(), hint: "check the file of the object, and the node that changes it" }
    }

    /// The error of a node, which names the object by its index in the list.
    pub(super) fn of(self, index: usize) -> NodeError {
        NodeError::new(format!("object {index} {}", self.what)).hint(self.hint)
    }
}

/// Checks that a file can store the shape of an object and its transform, and that all indices are in range.
pub(super) fn checked(object: &Object, matrix: DMat4) -> Result<(), Bad> {
    let hint = "check the scale and the `matrix` of the pose of the object";
    let bad = |what: &str| Err(Bad { what: what.to_owned(), hint });
    // Readers hold matrices in single precision.
    let single = matrix.as_mat4();
    if !(matrix.is_finite() && single.is_finite()) {
        return bad("has a transform that is not finite in single precision");
    }
    if matrix.row(3) != DVec4::W || DMat3::from_mat4(matrix).determinant() == 0.0 {
        return bad("has a transform that is not affine, or that makes the object flat");
    }
    object.primitives.iter().filter(|p| !p.triangles.is_empty()).try_for_each(|p| primitive(p, object))
}

fn primitive(p: &Primitive, object: &Object) -> Result<(), Bad> {
    if !p.is_consistent() || p.material as usize >= object.materials.len() {
        return Err(Bad::data("refers to a vertex or a material that does not exist"));
    }
    for (name, numbers) in [
        ("a position", p.positions.as_flattened()),
        ("a normal", p.normals.as_flattened()),
        ("a tangent", p.tangents.as_flattened()),
        ("a texture coordinate", p.uv0.as_flattened()),
        ("a texture coordinate", p.uv1.as_flattened()),
        ("a vertex colour", p.colours.as_flattened()),
    ] {
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(Bad::data(format!("has {name} that is not finite")));
        }
    }
    Ok(())
}

/// Checks that a texture has texels, as many as its size requires.
pub(super) fn texture(texture: &Texture) -> Result<(), Bad> {
    let bytes = 4 * u64::from(texture.width) * u64::from(texture.height);
    if bytes > 0 && bytes == texture.rgba.len() as u64 {
        return Ok(());
    }
    let (width, height, bytes) = (texture.width, texture.height, texture.rgba.len());
    Err(Bad::data(format!("has a texture of {width} x {height} texels with {bytes} bytes")))
}

/// Checks that all numbers of a material are finite: JSON has `null` instead of other numbers.
pub(super) fn finite(material: &Value) -> Result<(), Bad> {
    fn absent(value: &Value) -> bool {
        match value {
            Value::Null => true,
            Value::Array(list) => list.iter().any(absent),
            Value::Object(fields) => fields.values().any(absent),
            _ => false,
        }
    }
    if !absent(material) {
        return Ok(());
    }
    let name = material["name"].as_str().unwrap_or_default();
    Err(Bad::data(format!("has the material `{name}`, in which a number is not finite")))
}
