//! Conversion from the frame of a file to the world of the graph.

use engine::Up;
use glam::{DMat3, DVec3};

use super::rows::Row;
use super::sh_turn::ShTurn;

engine::choices! {
    /// Up axis of a file of splats.
    pub enum Frame {
        /// +y for SPZ and glTF, which define it; other formats are used as stored.
        ByFormat,
        /// As stored, for any format.
        AsStored,
        /// +y is up.
        YUp,
        /// -y is up, as in many COLMAP models.
        YDown,
        /// +z is up.
        ZUp,
    }
}

/// The rotation from the right-handed Y-up frame of glTF to a world with `up`.
pub fn from_y_up(up: Up) -> DMat3 {
    match up {
        Up::PlusY => DMat3::IDENTITY,
        Up::MinusY => DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
        Up::PlusZ => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
    }
}

impl Frame {
    /// The up axis of the file: `declared`, which its format defines, or the axis chosen by the user. `None` if
    /// coordinates are used as stored.
    pub fn up(self, declared: Option<Up>) -> Option<Up> {
        match self {
            Self::ByFormat => declared,
            Self::AsStored => None,
            Self::YUp => Some(Up::PlusY),
            Self::YDown => Some(Up::MinusY),
            Self::ZUp => Some(Up::PlusZ),
        }
    }
}

/// A similarity transform: rotation or mirror image, uniform scale and translation.
#[derive(Debug, Clone)]
pub struct Turn {
    matrix: DMat3,
    scale: f64,
    offset: DVec3,
    /// Rotation of a Gaussian (w, x, y, z): the rotation of `matrix` or, if `matrix` is a mirror image, of its
    /// negative. Both matrices transform a Gaussian equally, since it is symmetric about its centre.
    quat: [f64; 4],
    sh: ShTurn,
}

impl Turn {
    /// The transform of `x` to `scale * matrix * x + offset`; `matrix` is orthogonal.
    pub fn new(matrix: DMat3, scale: f64, offset: DVec3) -> Self {
        let proper = if matrix.determinant() < 0.0 { -matrix } else { matrix };
        Self { matrix, scale, offset, quat: quaternion(proper), sh: ShTurn::new(matrix) }
    }

    /// Converts an affine map to a similarity; `None` if its axes are scaled unevenly or sheared.
    pub fn of_linear(linear: DMat3, offset: DVec3) -> Option<Self> {
        let scale = linear.x_axis.length();
        if !(scale > 0.0 && scale.is_finite() && offset.is_finite()) {
            return None;
        }
        let matrix = linear * (1.0 / scale);
        let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
        // Single precision matrices multiplied a few times are orthogonal to about 1e-6.
        let near = |a: f64, b: f64| (a - b).abs() < 1e-4;
        let similar = near(y.length(), 1.0)
            && near(z.length(), 1.0)
            && near(x.dot(y), 0.0)
            && near(x.dot(z), 0.0)
            && near(y.dot(z), 0.0);
        similar.then(|| {
            let y = (y - x * x.dot(y)).normalize();
            let across = x.cross(y);
            let z = if across.dot(z) < 0.0 { -across } else { across };
            Self::new(DMat3::from_cols(x, y, z), scale, offset)
        })
    }

    /// Transforms a splat and its colour.
    pub fn apply(&self, row: &mut Row, sh: &mut [[f32; 3]]) {
        let mean = DVec3::from(row.mean.map(f64::from)) + DVec3::from(row.mean_low.map(f64::from));
        row.set_mean((self.matrix * mean * self.scale + self.offset).to_array());
        let [a, b, c, d] = self.quat;
        let [w, x, y, z] = row.quat.map(f64::from);
        row.quat = [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
        .map(|q| q as f32);
        row.scale = row.scale.map(|s| (f64::from(s) * self.scale) as f32);
        self.sh.apply(sh);
    }
}

/// The quaternion (w, x, y, z) of a rotation. Of four equivalent formulas, the one with the largest divisor is
/// used, since the others lose precision to cancellation.
pub fn quaternion(m: DMat3) -> [f64; 4] {
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    let squares =
        [1.0 + x.x + y.y + z.z, 1.0 + x.x - y.y - z.z, 1.0 - x.x + y.y - z.z, 1.0 - x.x - y.y + z.z];
    let largest = (1..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let twice = squares[largest].max(0.0).sqrt();
    let (half, by) = (twice * 0.5, 0.5 / twice);
    match largest {
        0 => [half, (y.z - z.y) * by, (z.x - x.z) * by, (x.y - y.x) * by],
        1 => [(y.z - z.y) * by, half, (x.y + y.x) * by, (z.x + x.z) * by],
        2 => [(z.x - x.z) * by, (x.y + y.x) * by, half, (y.z + z.y) * by],
        _ => [(x.y - y.x) * by, (z.x + x.z) * by, (y.z + z.y) * by, half],
    }
}

/// Settings that determine the transform of a file into the world.
#[derive(Debug, Clone, Copy)]
pub struct Placing {
    /// The frame chosen by the user.
    pub frame: Frame,
    /// Up axis of the world.
    pub up: Up,
    /// Metres per world unit.
    pub metres_per_unit: f64,
}

impl Placing {
    /// The rotation and the scale from a file to the world; `None` for the identity. `declared` is the up axis that
    /// the format of the file defines; `metres` is true if the unit of the format is the metre. The text describes
    /// the decision; it is `None` if there was nothing to decide.
    pub fn turn(&self, declared: Option<Up>, metres: bool) -> (Option<(DMat3, f64)>, Option<String>) {
        let scale = if metres && self.frame != Frame::AsStored { 1.0 / self.metres_per_unit } else { 1.0 };
        let Some(up) = self.frame.up(declared) else {
            let text =
                declared.map(|up| format!("is used as stored, although its format has {} up", up.name()));
            return (None, text);
        };
        let matrix = from_y_up(self.up) * from_y_up(up).transpose();
        let by =
            if self.frame == Frame::ByFormat { "according to its format" } else { "according to `frame`" };
        let units = if scale == 1.0 { String::new() } else { format!("; it was scaled by {scale}") };
        let turned = if matrix == DMat3::IDENTITY {
            ", like the scene".to_owned()
        } else {
            format!("; it was rotated to {} up", self.up.name())
        };
        let text = format!("has {} up, {by}{turned}{units}", up.name());
        let idle = matrix == DMat3::IDENTITY && scale == 1.0;
        ((!idle).then_some((matrix, scale)), Some(text))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn covariance(row: &Row) -> DMat3 {
        let [w, x, y, z] = row.quat.map(f64::from);
        let r = DMat3::from_cols(
            DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
            DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
            DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
        );
        let c = r * DMat3::from_diagonal(DVec3::from(row.scale.map(f64::from)));
        c * c.transpose()
    }

    fn row() -> Row {
        Row::checked([1.0, -2.0, 3.0], [0.3, -0.5, 0.7, 0.4], [0.1, 0.2, 0.5], 0.5, 1e6).unwrap()
    }

    #[test]
    fn covariances_turn_with_the_matrix() {
        let s = 0.5_f64.sqrt();
        let rotation = DMat3::from_cols_array(&[s, s, 0.0, -0.5, 0.5, s, 0.5, -0.5, s]);
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        for matrix in [rotation, rotation * rotation, mirror, -rotation, from_y_up(Up::PlusZ)] {
            let turn = Turn::of_linear(matrix * 2.0, DVec3::new(5.0, 6.0, 7.0)).unwrap();
            let mut turned = row();
            turn.apply(&mut turned, &mut []);
            let expected = matrix * covariance(&row()) * matrix.transpose() * 4.0;
            assert!((covariance(&turned) - expected).to_cols_array().iter().all(|d| d.abs() < 1e-6));
            let mean = matrix * DVec3::new(1.0, -2.0, 3.0) * 2.0 + DVec3::new(5.0, 6.0, 7.0);
            let low = DVec3::from(turned.mean_low.map(f64::from));
            assert!((DVec3::from(turned.mean.map(f64::from)) + low - mean).length() < 1e-12);
        }
    }

    #[test]
    fn uneven_maps_are_refused() {
        assert!(Turn::of_linear(DMat3::from_diagonal(DVec3::new(1.0, 2.0, 1.0)), DVec3::ZERO).is_none());
        assert!(Turn::of_linear(DMat3::ZERO, DVec3::ZERO).is_none());
        assert!(Turn::of_linear(DMat3::IDENTITY, DVec3::splat(f64::NAN)).is_none());
    }

    // The rule of the design for all formats with Y up.
    #[test]
    fn up_stays_up_and_back_again() {
        let v = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(from_y_up(Up::PlusZ) * v, DVec3::new(1.0, -3.0, 2.0));
        assert_eq!(from_y_up(Up::MinusY) * v, DVec3::new(1.0, -2.0, -3.0));
        let placing = Placing { frame: Frame::ZUp, up: Up::PlusZ, metres_per_unit: 2.0 };
        assert!(placing.turn(None, false).0.is_none());
        let placing = Placing { frame: Frame::ByFormat, up: Up::PlusY, metres_per_unit: 2.0 };
        assert!(placing.turn(None, false).1.is_none());
        assert_eq!(placing.turn(Some(Up::PlusY), true).0, Some((DMat3::IDENTITY, 0.5)));
        // Only what was done is reported. This test fails if the text states a rotation that is the identity.
        let text = |up: Up, metres: bool| placing.turn(Some(up), metres).1.unwrap();
        assert_eq!(text(Up::PlusY, false), "has +y up, according to its format, like the scene");
        assert_eq!(
            text(Up::PlusY, true),
            "has +y up, according to its format, like the scene; it was scaled by 0.5"
        );
        assert_eq!(text(Up::PlusZ, false), "has +z up, according to its format; it was rotated to +y up");
    }
}
