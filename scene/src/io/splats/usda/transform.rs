//! Transforms of prims: `xformOpOrder` and its operations (OpenUSD, `UsdGeomXformOp`).

use glam::{DMat3, DMat4, DVec3};

use crate::math::num;

/// Prefix of an operation that is inverted.
const INVERTED: &str = "!invert!";
/// Name in the order of operations after which the transforms of the parents are ignored.
pub(super) const RESET: &str = "!resetXformStack!";

/// Name of the attribute of an operation in `xformOpOrder`.
pub(super) fn attribute(operation: &str) -> &str {
    operation.strip_prefix(INVERTED).unwrap_or(operation)
}

/// The matrix of the operation `name`, such as `xformOp:rotateXYZ:pivot`, with `values`. Points are columns. `None`
/// if the operation is unknown, does not have as many values, or has no inverse but is inverted.
pub(super) fn matrix(name: &str, values: &[f64]) -> Option<DMat4> {
    let kind = attribute(name).split(':').nth(1).unwrap_or_default();
    let axes = [("X", DVec3::X), ("Y", DVec3::Y), ("Z", DVec3::Z)];
    let along = |letter: &str| axes.iter().find(|(axis, _)| *axis == letter).map(|(_, axis)| *axis);
    let matrix = match (kind, values) {
        // Rows of a matrix that is multiplied from the left are the columns of one from the right.
        ("transform", m) => DMat4::from_cols_array(m.try_into().ok()?),
        ("translate", &[x, y, z]) => DMat4::from_translation(DVec3::new(x, y, z)),
        ("scale", &[x, y, z]) => DMat4::from_scale(DVec3::new(x, y, z)),
        ("orient", &[w, x, y, z]) => rotation_of([w, x, y, z])?,
        (kind, &[amount]) => {
            if let Some(axis) = kind.strip_prefix("translate").and_then(along) {
                DMat4::from_translation(axis * amount)
            } else if let Some(axis) = kind.strip_prefix("scale").and_then(along) {
                DMat4::from_scale(DVec3::ONE + axis * (amount - 1.0))
            } else {
                turn(kind.strip_prefix("rotate").and_then(along)?, amount)
            }
        }
        (kind, &[_, _, _]) => {
            // The angles are listed by axis, the letters in the order in which the axes turn.
            let letters = kind.strip_prefix("rotate")?;
            let mut sorted: Vec<char> = letters.chars().collect();
            sorted.sort_unstable();
            if sorted != ['X', 'Y', 'Z'] {
                return None;
            }
            letters.chars().try_fold(DMat4::IDENTITY, |before, letter| {
                let place = axes.iter().position(|(axis, _)| axis.starts_with(letter))?;
                Some(turn(axes[place].1, *values.get(place)?) * before)
            })?
        }
        _ => return None,
    };
    if name.starts_with(INVERTED) {
        let determinant = matrix.determinant();
        return (determinant != 0.0 && determinant.is_finite()).then(|| matrix.inverse());
    }
    Some(matrix)
}

/// Rotation about a coordinate axis by an angle in degrees. Exact for multiples of 90 degrees.
fn turn(axis: DVec3, degrees: f64) -> DMat4 {
    let (sin, cos) = num::sin_cos_deg(degrees);
    // Each axis stays, or turns towards the product of `axis` with it.
    let column = |unit: DVec3| {
        let along = axis * axis.dot(unit);
        along + (unit - along) * cos + axis.cross(unit) * sin
    };
    DMat4::from_mat3(DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z)))
}

/// The rotation of a quaternion (w, x, y, z) of any length; `None` if its length is 0 or not finite.
fn rotation_of(quaternion: [f64; 4]) -> Option<DMat4> {
    let length = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return None;
    }
    let [w, x, y, z] = quaternion.map(|q| q / length);
    Some(DMat4::from_mat3(DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The point (1, 2, 3) after the operation.
    fn moved(name: &str, values: &[f64]) -> Option<[f64; 3]> {
        let point = matrix(name, values)?.transform_point3(DVec3::new(1.0, 2.0, 3.0));
        Some(point.to_array().map(|c| (c * 1e9).round() / 1e9 + 0.0))
    }

    #[test]
    fn operations_move_a_point() {
        for (name, values, wanted) in [
            ("xformOp:translate", &[10.0, 20.0, 30.0][..], [11.0, 22.0, 33.0]),
            ("xformOp:translate:pivot", &[10.0, 20.0, 30.0], [11.0, 22.0, 33.0]),
            ("!invert!xformOp:translate:pivot", &[10.0, 20.0, 30.0], [-9.0, -18.0, -27.0]),
            ("xformOp:translateY", &[5.0], [1.0, 7.0, 3.0]),
            ("xformOp:scale", &[2.0, 3.0, 4.0], [2.0, 6.0, 12.0]),
            ("xformOp:scaleZ", &[2.0], [1.0, 2.0, 6.0]),
            ("!invert!xformOp:scale", &[2.0, 2.0, 2.0], [0.5, 1.0, 1.5]),
            // Counterclockwise seen from the tip of the axis.
            ("xformOp:rotateX", &[90.0], [1.0, -3.0, 2.0]),
            ("xformOp:rotateY", &[90.0], [3.0, 2.0, -1.0]),
            ("xformOp:rotateZ", &[90.0], [-2.0, 1.0, 3.0]),
            ("!invert!xformOp:rotateZ", &[90.0], [2.0, -1.0, 3.0]),
            // Around x first, then around y, then around z: (1, -3, 2), (2, -3, -1), (3, 2, -1).
            ("xformOp:rotateXYZ", &[90.0, 90.0, 90.0], [3.0, 2.0, -1.0]),
            // Around z first, then around y, then around x: (-2, 1, 3), (3, 1, 2), (3, -2, 1).
            ("xformOp:rotateZYX", &[90.0, 90.0, 90.0], [3.0, -2.0, 1.0]),
            // The angles are those of x, y and z in any order of the axes: around y by 0, x by 90, z by 180.
            ("xformOp:rotateYXZ", &[90.0, 0.0, 180.0], [-1.0, 3.0, 2.0]),
            ("xformOp:rotateXYZ", &[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]),
            ("xformOp:orient", &[1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0]),
            // A quaternion of length 2: 90 degrees about z.
            ("xformOp:orient", &[2.0_f64.sqrt(), 0.0, 0.0, 2.0_f64.sqrt()], [-2.0, 1.0, 3.0]),
        ] {
            assert_eq!(moved(name, values), Some(wanted), "{name}");
        }
        let angle = moved("xformOp:rotateZ", &[60.0]).unwrap_or_default();
        let wanted = [0.5 - 3.0_f64.sqrt(), 3.0_f64.sqrt() / 2.0 + 1.0, 3.0];
        assert!(angle.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-8), "{angle:?}");
        for (name, values) in [
            ("xformOp:rotateXYX", &[1.0, 2.0, 3.0][..]),
            ("xformOp:rotateXYZ", &[1.0]),
            ("xformOp:rotateW", &[1.0]),
            ("xformOp:translate", &[1.0, 2.0]),
            ("xformOp:transform", &[1.0]),
            ("xformOp:orient", &[0.0; 4]),
            ("!invert!xformOp:scale", &[0.0; 3]),
            ("translate", &[1.0, 2.0, 3.0]),
        ] {
            assert_eq!(moved(name, values), None, "{name}");
        }
    }
}
