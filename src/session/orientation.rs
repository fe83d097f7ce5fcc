//! The orientation of a capture: which of its axes points up.

use engine::Up;

/// Axis of the world that points up, and the transform of a capture to the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orientation {
    /// The axis of the world that points up.
    pub up: Up,
    /// Transform of the splats to the world, row by row; `None` for the identity. See
    /// [`Standing::matrix`](super::standing::Standing::matrix).
    pub matrix: Option<[f64; 16]>,
}

/// Rotations that turn an axis to +z, row by row, by the name of the axis.
const TO_Z: [(&str, [f64; 9]); 6] = [
    ("+x", [0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]),
    ("-x", [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0]),
    ("+y", [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0]),
    ("-y", [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0]),
    ("+z", [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
    ("-z", [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0]),
];

/// The axes of a file whose format defines +y as up, and the axes that they have after loading into a world in which
/// +z points up.
const LOADED: [(&str, &str); 6] =
    [("+x", "+x"), ("-x", "-x"), ("+y", "+z"), ("-y", "-z"), ("+z", "-y"), ("-z", "+y")];

impl Orientation {
    /// The orientation in which an axis of the file points up, such as `-y`. `is_declared` is true if the format of the
    /// file defines an up axis. `None` for a text that is not the name of an axis.
    pub fn of_axis(axis: &str, is_declared: bool) -> Option<Self> {
        let loaded = match is_declared {
            true => LOADED.iter().find(|(file, _)| *file == axis)?.1,
            false => axis,
        };
        // Loading turns a capture of such a format already, so its world is always that of +z.
        let ups: &[Up] = if is_declared { &[Up::PlusZ] } else { &[Up::PlusZ, Up::PlusY, Up::MinusY] };
        if let Some(up) = ups.iter().find(|up| up.name() == loaded) {
            return Some(Self { up: *up, matrix: None });
        }
        let (_, rows) = TO_Z.iter().find(|(name, _)| *name == loaded)?;
        let [a, b, c, d, e, f, g, h, i] = *rows;
        let matrix = [a, b, c, 0.0, d, e, f, 0.0, g, h, i, 0.0, 0.0, 0.0, 0.0, 1.0];
        Some(Self { up: Up::PlusZ, matrix: Some(matrix) })
    }

    /// The axis of the file that points up; `None` if none does, or if the orientation has another form.
    pub fn axis(&self, is_declared: bool) -> Option<&'static str> {
        TO_Z.iter().map(|(name, _)| *name).find(|name| Self::of_axis(name, is_declared) == Some(*self))
    }
}

#[cfg(test)]
mod tests {
    use scene::math::equirect::axes;
    use scene::types::frame::Similarity;

    use super::*;

    fn direction(axis: &str) -> glam::DVec3 {
        let sign = if axis.starts_with('-') { -1.0 } else { 1.0 };
        sign * match &axis[1..] {
            "x" => glam::DVec3::X,
            "y" => glam::DVec3::Y,
            _ => glam::DVec3::Z,
        }
    }

    #[test]
    fn the_axis_points_up() {
        for is_declared in [false, true] {
            for (axis, _) in TO_Z {
                let found = Orientation::of_axis(axis, is_declared).expect("an axis");
                assert_eq!(found.axis(is_declared), Some(axis));
                let loaded = match is_declared {
                    true => scene::io::splats::from_y_up(Up::PlusZ) * direction(axis),
                    false => direction(axis),
                };
                let rows = found.matrix.unwrap_or_else(|| Similarity::IDENTITY.rows());
                let rotation = Similarity::of_rows(&rows).expect("a rotation without a reflection").rotation;
                let [_, _, up] = axes(found.up);
                assert!((rotation * loaded - up).length() < 1e-12, "{axis} {is_declared}");
            }
        }
        assert_eq!(Orientation::of_axis("up", false), None);
    }
}
