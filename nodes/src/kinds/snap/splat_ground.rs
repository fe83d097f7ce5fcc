//! Ground made of splats, below an object's foot.

use glam::{DMat3, DQuat, DVec3};
use render::geometry::support::Foot;
use scene::math::num;
use scene::types::Splats;

use super::ground::GRID;

/// Minimum density of a splat, relative to full opacity, along a vertical line at which the splat counts as ground.
const OPAQUE: f64 = 0.3;
/// Maximum difference in height between a point of the ground and the centre of its splat, in standard deviations
/// of the height of the splat. Farther away, the splat is seen nearly edge-on and is not a surface.
const HELD_SIGMAS: f64 = 2.0;
/// Minimum standard deviation along an axis, as a share of the longest, so that vertical splats have a slope.
const THINNEST: f64 = 1e-3;

/// Heights at which opaque splats are densest along the vertical lines of a grid above and below the foot, within
/// `reach`. Splats between the lines count at their centre. Points are in the coordinates of
/// [`Columns`](super::ground::Columns): two horizontal coordinates relative to the middle of the foot, and the
/// height above its base, in world units.
pub(super) fn on_splats(splats: &Splats, foot: &Foot, up: DVec3, reach: f64) -> Vec<[f64; 3]> {
    let [across, along] = Foot::axes(up);
    let half = [across, along].map(|axis| foot.half.dot(axis.abs()));
    let mut points = Vec::new();
    for i in 0..splats.len() {
        let opacity = f64::from(splats.opacities[i]);
        if opacity.is_nan() || opacity < OPAQUE {
            continue;
        }
        let mean = splats.mean(i);
        let offset = mean - foot.middle;
        let centre = [offset.dot(across), offset.dot(along), mean.dot(up) - foot.base];
        let scale = splats.scales[i].map(f64::from);
        let longest = scale[0].max(scale[1]).max(scale[2]);
        // The squared distance from the centre, in standard deviations, at which the density falls to `OPAQUE`.
        let most = 2.0 * num::f64::ln(opacity / OPAQUE);
        let wide = longest * most.sqrt();
        let away = (0..2).any(|k| centre[k].abs() > half[k] + wide);
        if away || centre[2].abs() > reach + HELD_SIGMAS * longest {
            continue;
        }
        let before = points.len();
        if let Some(slope) = Slope::of(splats.quats[i], scale, [across, along, up]) {
            let extents = [slope.xx, slope.yy].map(|variance| (most * variance).sqrt());
            let [columns, rows] = [0, 1].map(|k| lines(centre[k], extents[k], half[k]));
            for (x, y) in rows.flat_map(|row| {
                columns.clone().map(move |column| (line(column, half[0]), line(row, half[1])))
            }) {
                let [dx, dy] = [x - centre[0], y - centre[1]];
                let (distance, rise) = slope.at(dx, dy);
                let held = rise * rise > HELD_SIGMAS * HELD_SIGMAS * slope.hh;
                if distance <= most && !held && (centre[2] + rise).abs() <= reach {
                    points.push([x, y, centre[2] + rise]);
                }
            }
        }
        let inside = (0..2).all(|k| centre[k].abs() <= half[k]) && centre[2].abs() <= reach;
        if points.len() == before && inside {
            points.push(centre);
        }
    }
    points
}

/// Position of a line of the grid along one axis. The grid extends `half` to both sides.
fn line(number: u32, half: f64) -> f64 {
    (f64::from(2 * number + 1) / f64::from(GRID) - 1.0) * half
}

/// Numbers of the lines at most `extent` from `centre`.
fn lines(centre: f64, extent: f64, half: f64) -> std::ops::Range<u32> {
    let number = |at: f64| ((at / half + 1.0) * 0.5 * f64::from(GRID)).clamp(0.0, f64::from(GRID)) as u32;
    if half > 0.0 { number(centre - extent)..(number(centre + extent) + 1).min(GRID) } else { 0..0 }
}

/// Covariance of a splat along the horizontal axes x and y and the height h, and the inverse of its horizontal
/// part.
struct Slope {
    xx: f64,
    yy: f64,
    hh: f64,
    xh: f64,
    yh: f64,
    inverse: [f64; 3],
}

impl Slope {
    /// `None` if the splat is a point, or its numbers are not finite.
    fn of([w, x, y, z]: [f32; 4], scale: [f64; 3], axes: [DVec3; 3]) -> Option<Self> {
        let longest = scale[0].max(scale[1]).max(scale[2]);
        let scale = scale.map(|sigma| sigma.max(THINNEST * longest));
        let turn = DQuat::from_xyzw(f64::from(x), f64::from(y), f64::from(z), f64::from(w)).normalize();
        let own = DMat3::from_quat(turn) * DMat3::from_diagonal(DVec3::from(scale));
        let rows = axes.map(|axis| own.transpose() * axis);
        let of = |a: usize, b: usize| rows[a].dot(rows[b]);
        let (xx, xy, yy) = (of(0, 0), of(0, 1), of(1, 1));
        let determinant = xx * yy - xy * xy;
        let inverse = [yy / determinant, -xy / determinant, xx / determinant];
        let slope = Self { xx, yy, hh: of(2, 2), xh: of(0, 2), yh: of(1, 2), inverse };
        (determinant > 0.0 && inverse.iter().all(|v| v.is_finite())).then_some(slope)
    }

    /// Squared distance of a vertical line from the centre, in standard deviations, and the height above the centre
    /// at which the splat is densest along the line.
    fn at(&self, dx: f64, dy: f64) -> (f64, f64) {
        let [a, b, c] = self.inverse;
        let (u, v) = (a * dx + b * dy, b * dx + c * dy);
        (u * dx + v * dy, self.xh * u + self.yh * v)
    }
}
