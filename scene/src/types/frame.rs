//! Similarity transforms of captures, and the transform from the frame of glTF to the world.

use engine::{NodeError, Up};
use glam::{DMat3, DMat4, DVec3, DVec4};

/// A similarity transform: a rotation, a uniform scale and a translation. It preserves the shape of a capture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Rotation, without a reflection.
    pub rotation: DMat3,
    /// Scale, above 0.
    pub scale: f64,
    /// Translation, applied last, in world units.
    pub offset: DVec3,
}

impl Similarity {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, scale: 1.0, offset: DVec3::ZERO };

    /// Converts a 4x4 matrix, given row by row. Returns an error at the field `matrix` if the matrix contains a
    /// reflection, a shear or a non-uniform scale. The tolerance allows for matrices that were rounded to six
    /// digits.
    pub fn of_rows(rows: &[f64; 16]) -> Result<Self, NodeError> {
        let m = DMat4::from_cols_array(rows).transpose();
        let (linear, offset) = (DMat3::from_mat4(m), m.w_axis.truncate());
        let error = |what: &str| {
            Err(NodeError::new(what).at("matrix").hint(
                "splats and cameras can only be transformed by a rotation, a uniform scale and a translation",
            ))
        };
        if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(NodeError::new("the last row of `matrix` must be 0, 0, 0, 1")
                .at("matrix")
                .hint("the matrix is written row by row; the first three rows end with the translation"));
        }
        let determinant = linear.determinant();
        if !(determinant.is_finite() && offset.is_finite()) || determinant == 0.0 {
            return error("the determinant of `matrix` must be finite, and not 0");
        }
        if determinant < 0.0 {
            return error("`matrix` contains a reflection");
        }
        let scale = linear.x_axis.length();
        let axes = linear * (1.0 / scale);
        let [x, y, z] = [axes.x_axis, axes.y_axis, axes.z_axis];
        // Pasted matrices often have only six digits.
        let near = |a: f64, b: f64| (a - b).abs() < 1e-5;
        let right = near(x.dot(y), 0.0) && near(y.dot(z), 0.0) && near(z.dot(x), 0.0);
        if !(right && near(y.length(), 1.0) && near(z.length(), 1.0)) {
            return error("`matrix` contains a non-uniform scale or a shear");
        }
        let y = (y - x * x.dot(y)).normalize();
        Ok(Self { rotation: DMat3::from_cols(x, y, x.cross(y)), scale, offset })
    }

    /// Converts an optional matrix with [`Self::of_rows`]. `None` gives the identity.
    pub fn of_parameter(rows: Option<&[f64; 16]>) -> Result<Self, NodeError> {
        rows.map_or(Ok(Self::IDENTITY), Self::of_rows)
    }

    /// Transforms a point.
    pub fn point(&self, p: DVec3) -> DVec3 {
        self.rotation * p * self.scale + self.offset
    }

    /// The composition: `first`, followed by this transform.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        Self {
            rotation: self.rotation * first.rotation,
            scale: self.scale * first.scale,
            offset: self.point(first.offset),
        }
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (rotation, scale) = (self.rotation.transpose(), 1.0 / self.scale);
        Self { rotation, scale, offset: -(rotation * self.offset) * scale }
    }

    /// The 16 numbers of the matrix, row by row, as [`Self::of_rows`] reads them.
    pub fn rows(&self) -> [f64; 16] {
        let linear = self.rotation * self.scale;
        let m = DMat4::from_cols(
            linear.x_axis.extend(0.0),
            linear.y_axis.extend(0.0),
            linear.z_axis.extend(0.0),
            self.offset.extend(1.0),
        );
        m.transpose().to_cols_array()
    }
}

/// The transform from the frame of glTF (y up, in metres) to a world whose up axis is `up` and whose unit is
/// `metres_per_unit` metres long.
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

    #[test]
    fn similarities_are_read_row_by_row_and_nothing_else_is() {
        let rows = [0.0, -2.0, 0.0, 5.0, 2.0, 0.0, 0.0, 6.0, 0.0, 0.0, 2.0, 7.0, 0.0, 0.0, 0.0, 1.0];
        let read = Similarity::of_rows(&rows).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(read.point(DVec3::new(1.0, 0.0, 0.0)), DVec3::new(5.0, 8.0, 7.0));
        assert_eq!((read.rows(), read.scale), (rows, 2.0));
        let both = read.after(&read);
        assert_eq!(both.point(DVec3::X), read.point(read.point(DVec3::X)));
        assert_eq!(read.inverse().after(&read).rows(), Similarity::IDENTITY.rows());
        let changed = |at: usize, value: f64| {
            let mut other = rows;
            other[at] = value;
            Similarity::of_rows(&other)
        };
        for (at, value) in [(10, -2.0), (10, 3.0), (2, 0.5), (10, 0.0), (3, f64::INFINITY), (12, 1.0)] {
            let error = changed(at, value).expect_err("not a similarity");
            assert!(error.to_string().contains("matrix"), "{error}");
        }
        assert!(changed(10, 2.000_001).is_ok());
    }

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
