//! Probing of a mesh by vertical rays below an object's foot.

use engine::{Context, NodeError, Notes};
use glam::{DVec3, Vec3};
use render::geometry::bvh::{Bvh, Ray};
use render::geometry::support::{Foot, median};
use scene::types::Mesh;

/// Minimum cosine of the angle between the normal of the ground and up.
pub(super) const STEEPEST: f64 = 0.7;
/// Number of columns and of rows of the grid of rays.
pub(super) const GRID: u32 = 24;
/// Maximum thickness of a shell of ground, in metres. Rooms are higher: if the normals of a room point outwards,
/// its floor faces down and its ceiling is the next surface that faces up.
const SHELL: f64 = 2.0;

/// Number of triangles that one task searches.
const PIECE: usize = 1 << 16;

/// Triangles of a mesh above and below an object, and their tree. Coordinates are relative to the middle of a foot
/// at the height of its base. All rays are vertical and within the width of the object, so they can hit no other
/// triangle.
pub(super) struct Ground {
    pub(super) around: DVec3,
    pub(super) corners: Vec<[Vec3; 3]>,
    pub(super) bvh: Bvh,
}

/// Intersections of vertical lines through a foot with a mesh. Positions are relative to the middle of the
/// foot and heights relative to its base, in world units.
#[derive(Default)]
pub(super) struct Columns {
    /// Hits on surfaces that face up.
    pub(super) up: Vec<[f64; 3]>,
    /// Hits on surfaces that face down.
    pub(super) down: Vec<[f64; 3]>,
    /// True if any of these surfaces is steeper than ground may be.
    steep: bool,
}

impl Ground {
    pub(super) fn new(mesh: &Mesh, foot: &Foot, up: DVec3, cx: &Context) -> Result<Self, NodeError> {
        let around = foot.middle - up * (foot.middle.dot(up) - foot.base);
        Self::within(mesh, around, Foot::axes(up), widest(foot, around), cx)
    }

    /// Selects the triangles whose distance from the vertical line through `around` is at most `half` along each of
    /// the two horizontal axes.
    fn within(
        mesh: &Mesh,
        around: DVec3,
        axes: [DVec3; 2],
        half: f64,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let corner = |i: u32| (mesh.position(i) - around).as_vec3();
        let axes = axes.map(|axis| axis.as_vec3());
        let half = half as f32;
        let pieces: Vec<&[[u32; 3]]> = mesh.triangles.chunks(PIECE).collect();
        let near = |triangle: &[Vec3; 3]| {
            axes.iter().all(|axis| {
                let along = triangle.map(|p| p.dot(*axis));
                along.iter().any(|v| *v <= half) && along.iter().any(|v| *v >= -half)
            })
        };
        let found = cx.for_each_tile(pieces.len(), |i| {
            pieces[i].iter().map(|t| t.map(corner)).filter(near).collect::<Vec<_>>()
        })?;
        let corners = found.concat();
        Ok(Self { around, bvh: Bvh::build_in(&corners, cx)?, corners })
    }

    /// Cosine of the angle between the normal of a triangle and up.
    fn facing(&self, triangle: u32, up: DVec3) -> f64 {
        let [a, b, c] = self.corners[triangle as usize].map(|p| p.as_dvec3());
        (b - a).cross(c - a).normalize_or_zero().dot(up)
    }

    /// Intersections of a grid of vertical lines through the foot, within `reach` up and down.
    pub(super) fn columns(
        &self,
        foot: &Foot,
        up: DVec3,
        reach: f64,
        cx: &Context,
    ) -> Result<Columns, NodeError> {
        let axes = Foot::axes(up);
        let mut columns = Columns::default();
        for k in 0..GRID * GRID {
            cx.check()?;
            let place = [k % GRID, k / GRID].map(|i| (f64::from(2 * i + 1) / f64::from(GRID)) - 1.0);
            let [x, y] = [0, 1].map(|a| place[a] * foot.half.dot(axes[a].abs()));
            let start = axes[0] * x + axes[1] * y + up * reach;
            let ray = Ray { t_max: (2.0 * reach) as f32, ..Ray::new(start.as_vec3(), -up.as_vec3()) };
            let first = [columns.up.len(), columns.down.len()];
            self.bvh.any(ray, |hit| {
                let facing = self.facing(hit.triangle, up);
                if facing.abs() >= STEEPEST {
                    let side = if facing > 0.0 { &mut columns.up } else { &mut columns.down };
                    side.push([x, y, reach - f64::from(hit.t)]);
                }
                columns.steep |= facing.abs() < STEEPEST;
                false
            });
            // The tree returns hits in no order, and reports an edge twice.
            columns.up[first[0]..].sort_by(|a, b| a[2].total_cmp(&b[2]));
            columns.down[first[1]..].sort_by(|a, b| a[2].total_cmp(&b[2]));
        }
        Ok(columns)
    }

    /// Ground within reach: the surfaces that face up. If no surface faces up, the surfaces that face down, unless
    /// they are the underside of a shell.
    pub(super) fn ground(
        &self,
        foot: &Foot,
        up: DVec3,
        reach: f64,
        cx: &Context,
        notes: &mut Notes,
    ) -> Result<Vec<[f64; 3]>, NodeError> {
        let Columns { up: above, down, steep } = self.columns(foot, up, reach, cx)?;
        match (above.is_empty(), down.is_empty()) {
            (false, _) => Ok(above),
            (true, false) => {
                if let Some([under, upper]) = self.shell(&down, up, SHELL / cx.metres_per_unit()) {
                    return Err(under_a_shell([reach, under, upper].map(|v| v * cx.metres_per_unit())));
                }
                let text = "no surface below the object faces up, so surfaces that face down count as ground";
                notes.warning("ground-looks-down", text);
                Ok(down)
            }
            (true, true) if steep => {
                let hint =
                    "move the pose to less steep ground, or place the object by its pose without `snap`";
                Err(NodeError::new("the ground under the object is steeper than 45 degrees")
                    .at("pose")
                    .hint(hint))
            }
            (true, true) => Ok(above),
        }
    }

    /// The median height of the surfaces that face down, and the median height of their upper sides. An upper side
    /// is a surface that faces up, at most `thickest` above a surface that faces down. `None` unless more than half
    /// of the surfaces that face down have an upper side.
    fn shell(&self, down: &[[f64; 3]], up: DVec3, thickest: f64) -> Option<[f64; 2]> {
        let axes = Foot::axes(up);
        let pair = |&[x, y, height]: &[f64; 3]| {
            let start = axes[0] * x + axes[1] * y + up * height;
            let ray = Ray { t_max: thickest as f32, ..Ray::new(start.as_vec3(), up.as_vec3()) };
            let hit = self.bvh.closest(ray, |hit| self.facing(hit.triangle, up) >= STEEPEST)?;
            Some([height, height + f64::from(hit.t)])
        };
        let pairs: Vec<[f64; 2]> = down.iter().filter_map(pair).collect();
        if 2 * pairs.len() <= down.len() {
            return None;
        }
        let [under, upper] = [0, 1].map(|side| median(pairs.iter().map(|pair| pair[side]).collect()));
        Some([under?, upper?])
    }
}

/// Half the width of the region that contains all rays, with a margin for rounding. The region contains the foot,
/// and the object at any rotation about the middle of its foot.
fn widest(foot: &Foot, around: DVec3) -> f64 {
    let [low, high] = [foot.low - around, foot.high - around];
    let reach = low.abs().max(high.abs()).length();
    1.001 * reach.max(foot.half.max_element())
}

/// Error that only the underside of a shell is within reach. The arguments are the reach, the height of the
/// underside above the foot, and the height of the upper side above the foot, in metres.
fn under_a_shell([reach, under, upper]: [f64; 3]) -> NodeError {
    let side = if under > 0.0 { "above" } else { "below" };
    let text = format!(
        "no surface within {reach} m of the object's foot faces up: the surface {:.2} m {side} the foot is the underside of a shell, whose \
         upper side is {upper:.2} m above the foot",
        under.abs()
    );
    // One centimetre more, rounded to centimetres.
    let enough = ((upper * 100.0).round() + 1.0) / 100.0;
    let hint = format!("move the pose up by {upper:.2} m, or raise `reach_metres` to {enough:.2}");
    NodeError::new(text).at("pose").hint(hint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    /// Rough ground of 40 by 40 units in squares of 0.25 units, with a step, and with a few thin triangles across
    /// all of it.
    fn ground() -> Mesh {
        let side = 161_u32;
        let height = |i: u32, j: u32| 0.02 * ((i * 7 + j * 13) % 11) as f32 + if i > 83 { 0.3 } else { 0.0 };
        let mut mesh = Mesh::default();
        for k in 0..side * side {
            let (i, j) = (k % side, k / side);
            mesh.positions.push([i as f32 * 0.25 - 20.0, j as f32 * 0.25 - 20.0, height(i, j)]);
        }
        for k in (0..side * (side - 1)).filter(|k| k % side != side - 1) {
            mesh.triangles.extend([[k, k + 1, k + side], [k + 1, k + side + 1, k + side]]);
        }
        for k in 0..5 {
            let first = mesh.positions.len() as u32;
            let z = 0.5 + 0.1 * k as f32;
            mesh.positions.extend([[-30.0, -30.0, z], [30.0, 30.0, z], [30.0, 30.5, z]]);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh
    }

    /// The triangles near an object are few and give the same columns as all triangles.
    #[test]
    fn triangles_that_no_ray_can_hit_are_left_out() {
        let (mesh, cx, up) = (ground(), context(), DVec3::Z);
        let corner = DVec3::new(0.9, 0.4, 1.5);
        let middle = DVec3::new(1.03, -2.21, 0.4);
        let foot = Foot {
            low: middle - corner * DVec3::new(1.0, 1.0, 0.0),
            high: middle + corner,
            base: 0.4,
            middle,
            half: DVec3::new(0.675, 0.3, 1.1),
        };
        let some = Ground::new(&mesh, &foot, up, &cx).expect("nothing stops it");
        let all = Ground::within(&mesh, some.around, Foot::axes(up), 1e6, &cx).expect("nothing stops it");
        assert_eq!(all.corners.len(), mesh.triangles.len());
        assert!(some.corners.len() < mesh.triangles.len() / 50, "{}", some.corners.len());
        let columns = |ground: &Ground| {
            let Columns { up, down, steep } =
                ground.columns(&foot, up, 100.0, &cx).expect("nothing stops it");
            (up, down, steep)
        };
        assert_eq!(columns(&some), columns(&all));
        assert!(columns(&some).0.len() > 500);
        // Rays through the farthest corner of the object, at many rotations.
        let reach = corner.length();
        for k in 0..64 {
            let (sin, cos) = scene::math::num::sin_cos(f64::from(k) / 64.0 * std::f64::consts::TAU);
            let start = DVec3::new(reach * cos, reach * sin, 50.0);
            let ray = Ray::new(start.as_vec3(), -up.as_vec3());
            let hit = |ground: &Ground| {
                let hit = ground.bvh.closest(ray, |_| true).expect("there is ground");
                (hit.t, ground.corners[hit.triangle as usize])
            };
            assert_eq!(hit(&some), hit(&all));
        }
    }
}
