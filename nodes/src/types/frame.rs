//! Frames of reference of files.

use engine::Up;
use glam::{DMat4, DVec4};

/// The transform from glTF's frame (y up, metres) to a frame with the axes and units of the world.
pub fn world_from_gltf(up: Up, metres_per_unit: f64) -> DMat4 {
    let s = 1.0 / metres_per_unit;
    let [x, y, z] = match up {
        Up::PlusZ => [[s, 0.0, 0.0], [0.0, 0.0, s], [0.0, -s, 0.0]],
        Up::PlusY => [[s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]],
        Up::MinusY => [[s, 0.0, 0.0], [0.0, -s, 0.0], [0.0, 0.0, -s]],
    };
    let column = |c: [f64; 3]| DVec4::new(c[0], c[1], c[2], 0.0);
    DMat4::from_cols(column(x), column(y), column(z), DVec4::W)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::equirect::axes;
    use glam::{DMat3, DVec3};

    #[test]
    fn up_of_the_file_is_up_of_the_world_and_metres_become_units() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let m = world_from_gltf(up, 0.5);
            assert_eq!(m.transform_vector3(DVec3::Y), axes(up)[2] * 2.0);
            assert_eq!(m.transform_vector3(DVec3::X), DVec3::X * 2.0);
            assert_eq!(DMat3::from_mat4(m).determinant(), 8.0, "no mirror");
        }
    }
}
