//! `snap`: an object put on what lies under it.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes};
use glam::{DMat4, DQuat, DVec3, Vec3};

use crate::bvh::{Bvh, Ray};
use crate::equirect::axes;
use crate::place::world_from_gltf;
use crate::resting::Relief;
use crate::sampling::hash;
use crate::support::{Foot, Level, triangles};
use crate::types::{Cell, Mesh, Object, Placed, Pose, Report, Splats, Table};

engine::params! {
    /// Moves a pose up or down so that the object stands on the mesh of the place, or on its splats.
    ///
    /// Looks under the object's foot, as far up and down as `reach_metres`, for the plane that holds most of
    /// what is there, of equal ones the nearest. The middle of the foot is put on it, and a rough mesh is met in
    /// the middle. Where a mesh lies more than 2 cm off that plane under the foot, on a mound, in a hollow or over a
    /// kerb, the object is put on what it touches, which is told. Ground is what looks up and is no steeper than 45
    /// degrees; in a mesh of which nothing there looks
    /// up, what looks down, which is told. Wire the new pose where the old one went: to `place` and the probe.
    pub struct Snap {
        /// How far the ground may lie above or below the object's foot.
        reach_metres: f64 = 0.5, range(0.001, 100.0), unit("m"), other("0.005");
        /// Turns the object's up to the normal of the ground, about its foot; on ground that is no plane, until it lies
        /// on three contacts around its middle.
        align: bool = false, other("true");
    }
}
engine::inputs! {
    /// What to put on what.
    pub struct In {
        /// The object.
        object: Arc<Object>,
        /// Where it stands, about.
        pose: Arc<Pose>,
        /// The mesh of the place; or `splats`.
        mesh: Option<Arc<Mesh>>,
        /// The splats of the place; their centres are taken.
        splats: Option<Arc<Splats>>,
    }
}
engine::outputs! {
    /// Where it stands now.
    pub struct Out {
        /// The pose on the ground.
        pose: Arc<Pose>,
        /// What was found: a table `ground`.
        report: Arc<Report>,
    }
}

/// Columns and rows of the rays that feel a mesh.
const GRID: u32 = 24;
/// Points within such a height of a plane are of it, in metres.
const NEAR: f64 = 0.02;
/// Planes that are tried, each through three points.
const TRIED: u32 = 400;
/// Splats more transparent than this are no ground.
const OPAQUE: f32 = 0.3;
/// How far ground is looked for to tell where it is, in metres: as far as `reach_metres` goes.
const FAR: f64 = 100.0;
/// Cosine of the steepest ground.
const STEEPEST: f64 = 0.7;

impl Kind for Snap {
    const NAME: &'static str = "snap";
    const VERSION: u32 = 3;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let metre = 1.0 / cx.metres_per_unit();
        let [_, _, up] = axes(cx.up());
        let placed = |pose: &DMat4| {
            let world_from_object = *pose * world_from_gltf(cx.up(), cx.metres_per_unit());
            Placed { object: inputs.object.clone(), world_from_object }
        };
        let pose = inputs.pose.world_from_local;
        let Some(foot) = Foot::of(&placed(&pose), up) else {
            return Err(NodeError::new("the object has no triangle that could stand").at("object"));
        };
        let reach = params.reach_metres * metre;
        let mut notes = Notes::none();
        let felt = inputs.mesh.as_deref().map(|mesh| Felt::new(mesh, &foot, up));
        let points = match (&felt, &inputs.splats) {
            (Some(felt), None) => on_mesh(felt, &foot, up, reach, cx, &mut notes)?,
            (None, Some(splats)) => on_splats(splats, &foot, up, reach),
            _ => {
                let what = "the ground is either `mesh` or `splats`";
                return Err(NodeError::new(what).at("mesh").hint("wire one of the two"));
            }
        };
        let Some(level) = Level::of(&densest(&points, NEAR * metre, cx)?) else {
            let far = FAR * metre;
            let points = match (&felt, &inputs.splats) {
                // What is too steep there is none.
                (Some(felt), _) => on_mesh(felt, &foot, up, far, cx, &mut Notes::none()).unwrap_or_default(),
                (None, splats) => {
                    splats.iter().flat_map(|splats| on_splats(splats, &foot, up, far)).collect()
                }
            };
            let nearest = points.iter().map(|p| p[2]).min_by(|a, b| a.abs().total_cmp(&b.abs()));
            let below = pose.w_axis.truncate().dot(up) - foot.base;
            return Err(none_near(params.reach_metres, below / metre, nearest.map(|height| height / metre)));
        };
        let [across, along] = Foot::axes(up);
        let mut normal = (up - across * level.slope[0] - along * level.slope[1]).normalize();
        let mut height = level.height;
        let curved = felt.as_ref().and_then(|felt| {
            let (bvh, corners) = (&felt.bvh, &felt.corners[..]);
            let relief = Relief { bvh, corners, axes: [across, along, up], reach, plane: level };
            // The foot itself, of what was looked at around it.
            let half = [across, along].map(|axis| foot.half.dot(axis.abs()) / 1.5);
            let (departure, noise) = relief.departure(half);
            let object = || {
                let world = triangles(&placed(&pose)).into_iter();
                world.map(|triangle| triangle.map(|corner| corner - felt.around)).collect::<Vec<_>>()
            };
            if departure > NEAR * metre {
                Some((relief.rest(&object(), noise, params.align)?, departure, felt.around))
            } else {
                None
            }
        });
        let mut moved = DMat4::from_translation(up * height) * pose;
        if let Some((rest, departure, about)) = curved {
            height = rest.lift;
            let turn = DMat4::from_translation(about)
                * DMat4::from_quat(rest.turn)
                * DMat4::from_translation(-about);
            moved = DMat4::from_translation(up * height) * turn * pose;
            normal = if params.align { rest.turn * up } else { normal };
            let text = format!(
                "the ground under the foot lies {:.0} mm off a plane, so the object is put on what it touches",
                departure * cx.metres_per_unit() * 1e3
            );
            notes.decision("curved-ground", text);
        } else if params.align {
            let about = foot.middle + up * (foot.base + level.height - foot.middle.dot(up));
            let turn = DMat4::from_quat(DQuat::from_rotation_arc(up, normal));
            moved = DMat4::from_translation(about) * turn * DMat4::from_translation(-about) * moved;
        }
        let millimetres = |v: f64| v * cx.metres_per_unit() * 1e3;
        let text = format!(
            "moved by {:+.1} mm to ground that is {:.1} mm rough, normal ({:.3}, {:.3}, {:.3})",
            millimetres(height),
            millimetres(level.roughness),
            normal.x,
            normal.y,
            normal.z
        );
        notes.decision("snapped", text);
        let row = [height, level.roughness, normal.x, normal.y, normal.z];
        let columns = ["moved (world units)", "roughness (world units)", "normal x", "normal y", "normal z"];
        let table = Table {
            name: "ground".to_owned(),
            columns: columns.map(str::to_owned).to_vec(),
            rows: vec![row.map(Cell::Number).to_vec()],
        };
        let report = Report { title: "Put on the ground".to_owned(), tables: vec![table] };
        Ok((Out { pose: Arc::new(Pose { world_from_local: moved }), report: Arc::new(report) }, notes))
    }
}

/// No ground is near the foot of an object, which is so far below the origin of its pose: how far over the foot the
/// nearest is, if there is any. In metres.
fn none_near(reach: f64, below: f64, nearest: Option<f64>) -> NodeError {
    let side = |height: f64, [over, under]: [&'static str; 2]| if height > 0.0 { over } else { under };
    let foot = match below.abs() {
        0.005.. => {
            let side = side(below, ["below", "above"]);
            format!(", which is {:.2} m {side} the origin of its pose", below.abs())
        }
        _ => String::new(),
    };
    let (what, hint) = match nearest {
        Some(height) => {
            let (by, up) = (height.abs(), side(height, ["up", "down"]));
            // A whole centimetre above it.
            let enough = ((by * 100.0).round() + 1.0) / 100.0;
            let side = side(height, ["above", "below"]);
            (
                format!("the nearest is {by:.2} m {side} the foot"),
                format!("move the pose {up} by {by:.2} m, or raise `reach_metres` to {enough:.2}"),
            )
        }
        None => (
            format!("nor is there any within {FAR} m"),
            "move the pose to where there is ground above or below it".to_owned(),
        ),
    };
    NodeError::new(format!("no ground within {reach} m of the object's foot{foot}: {what}"))
        .at("pose")
        .hint(hint)
}

/// A mesh by its tree, from the middle of a foot at the height of its base.
struct Felt {
    around: DVec3,
    corners: Vec<[Vec3; 3]>,
    bvh: Bvh,
}

impl Felt {
    fn new(mesh: &Mesh, foot: &Foot, up: DVec3) -> Self {
        let around = foot.middle - up * (foot.middle.dot(up) - foot.base);
        let corner = |i: u32| (mesh.position(i) - around).as_vec3();
        let corners: Vec<_> = mesh.triangles.iter().map(|t| t.map(corner)).collect();
        Self { around, bvh: Bvh::build(&corners), corners }
    }
}

/// Where vertical lines through the foot meet the mesh: places from the foot's middle, heights over its base.
fn on_mesh(
    felt: &Felt,
    foot: &Foot,
    up: DVec3,
    reach: f64,
    cx: &Context,
    notes: &mut Notes,
) -> Result<Vec<[f64; 3]>, NodeError> {
    let Felt { corners, bvh, .. } = felt;
    let axes = Foot::axes(up);
    let (mut points, mut below, mut steep) = (Vec::new(), Vec::new(), false);
    for k in 0..GRID * GRID {
        cx.check()?;
        let place = [k % GRID, k / GRID].map(|i| (f64::from(2 * i + 1) / f64::from(GRID)) - 1.0);
        let [x, y] = [0, 1].map(|a| place[a] * foot.half.dot(axes[a].abs()));
        let start = axes[0] * x + axes[1] * y + up * reach;
        let ray = Ray { t_max: (2.0 * reach) as f32, ..Ray::new(start.as_vec3(), -up.as_vec3()) };
        let first = [points.len(), below.len()];
        bvh.any(ray, |hit| {
            let [a, b, c] = corners[hit.triangle as usize].map(|p| p.as_dvec3());
            let facing = (b - a).cross(c - a).normalize_or_zero().dot(up);
            if facing.abs() >= STEEPEST {
                let side = if facing > 0.0 { &mut points } else { &mut below };
                side.push([x, y, reach - f64::from(hit.t)]);
            }
            steep |= facing.abs() < STEEPEST;
            false
        });
        // The tree has no order, and tells an edge twice.
        points[first[0]..].sort_by(|a, b| a[2].total_cmp(&b[2]));
        below[first[1]..].sort_by(|a, b| a[2].total_cmp(&b[2]));
    }
    if points.is_empty() && below.is_empty() && steep {
        let hint =
            "move the pose to where it is less steep, or leave `snap` out and place the object by its pose";
        return Err(NodeError::new("the ground under the object is steeper than 45 degrees")
            .at("pose")
            .hint(hint));
    }
    if points.is_empty() && !below.is_empty() {
        let text = "no face under the object looks up, so those that look down are taken for the ground";
        notes.warning("ground-looks-down", text);
        return Ok(below);
    }
    Ok(points)
}

/// Centres of opaque splats over and under the foot, likewise.
fn on_splats(splats: &Splats, foot: &Foot, up: DVec3, reach: f64) -> Vec<[f64; 3]> {
    let axes = Foot::axes(up);
    let point = |i: usize| {
        let mean = splats.mean(i);
        let [x, y] = axes.map(|axis| (mean - foot.middle).dot(axis));
        let height = mean.dot(up) - foot.base;
        let inside = x.abs() <= foot.half.dot(axes[0].abs()) && y.abs() <= foot.half.dot(axes[1].abs());
        (inside && height.abs() <= reach && splats.opacities[i] >= OPAQUE).then_some([x, y, height])
    };
    (0..splats.len()).filter_map(point).collect()
}

/// The points within some height of the plane that holds most of them; of equal ones the nearest to 0 under the
/// foot's middle, and of those the first that is tried.
fn densest(points: &[[f64; 3]], near: f64, cx: &Context) -> Result<Vec<[f64; 3]>, NodeError> {
    let mut best: ([f64; 3], usize) = ([f64::INFINITY, 0.0, 0.0], 0);
    for k in 0..TRIED {
        cx.check()?;
        let some = |i| points.get(((u64::from(hash(k, i)) * points.len() as u64) >> 32) as usize).copied();
        let [Some(a), Some(b), Some(c)] = [some(0), some(1), some(2)] else { break };
        // Every other plane is level, which is what most ground is.
        let plane =
            if k % 2 == 0 { [a[2], 0.0, 0.0] } else { through([a, b, c]).unwrap_or([a[2], 0.0, 0.0]) };
        let held = points.iter().filter(|p| off(&plane, p).abs() <= near).count();
        if held > best.1 || (held == best.1 && plane[0].abs() < best.0[0].abs()) {
            best = (plane, held);
        }
    }
    Ok(points.iter().filter(|p| off(&best.0, p).abs() <= near).copied().collect())
}

/// The plane through three points, as its height over (0, 0) and its rise along both axes; none where it is steep.
fn through(points: [[f64; 3]; 3]) -> Option<[f64; 3]> {
    let [a, b, c] = points.map(DVec3::from_array);
    let normal = (b - a).cross(c - a).try_normalize().filter(|n| n.z.abs() >= STEEPEST)?;
    let rise = normal.truncate() / -normal.z;
    Some([a.z - rise.dot(a.truncate()), rise.x, rise.y])
}

/// Height of a point over a plane.
fn off(plane: &[f64; 3], point: &[f64; 3]) -> f64 {
    point[2] - plane[0] - plane[1] * point[0] - plane[2] * point[1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;
    use crate::types::Primitive;

    /// A pyramid of 0.4 by 0.4 by 1 that stands on its square, y up as glTF has it.
    fn object() -> Arc<Object> {
        let primitive = Primitive {
            positions: vec![
                [-0.2, 0.0, -0.2],
                [0.2, 0.0, -0.2],
                [0.2, 0.0, 0.2],
                [-0.2, 0.0, 0.2],
                [0.0, 1.0, 0.0],
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 1, 4]],
            ..Primitive::default()
        };
        Arc::new(Object { primitives: vec![primitive], ..Object::default() })
    }

    /// A quad of 4 by 4 at a height, with a rise along x.
    fn plane(height: f32, rise: f32) -> Mesh {
        let corner = |x: f32, y: f32| [x, y, height + rise * x];
        Mesh {
            positions: vec![corner(-2.0, -2.0), corner(2.0, -2.0), corner(2.0, 2.0), corner(-2.0, 2.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    fn run(mesh: Option<Mesh>, splats: Option<Splats>, z: f64, align: bool) -> Result<DMat4, NodeError> {
        let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, z)) };
        let inputs = In {
            object: object(),
            pose: Arc::new(pose),
            mesh: mesh.map(Arc::new),
            splats: splats.map(Arc::new),
        };
        Snap::run(&Snap { reach_metres: 0.5, align }, inputs, &context())
            .map(|(out, _)| out.pose.world_from_local)
    }

    #[test]
    fn objects_come_to_stand_from_above_and_below() {
        for z in [0.9, 0.75, 0.4] {
            let pose = run(Some(plane(0.75, 0.0)), None, z, false).unwrap_or_else(|e| panic!("{e}"));
            assert!((pose.w_axis.truncate() - DVec3::new(0.3, 0.1, 0.75)).length() < 1e-6, "{pose}");
        }
        let error = run(Some(plane(0.75, 0.0)), None, 2.0, false).map(|_| ()).expect_err("too far");
        assert!(error.message().contains("0.5 m"), "{error}");
        let told = format!("{error:?}");
        assert!(told.contains("the nearest is 1.25 m below the foot"), "{told}");
        assert!(told.contains("down by 1.25 m, or raise `reach_metres` to 1.26"), "{told}");
        let error = run(Some(plane(0.0, 1.2)), None, 0.2, false).map(|_| ()).expect_err("too steep");
        assert!(error.message().contains("steeper than 45 degrees"), "{error}");
        assert!(run(None, None, 0.0, false).is_err());
    }

    /// An object whose origin is its middle, as of many models: its foot is far under a pose that is near the ground.
    #[test]
    fn what_is_too_far_is_told_by_the_foot() {
        let mut object = (*object()).clone();
        object.primitives[0].positions.iter_mut().for_each(|p| p[1] -= 0.9);
        let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, 0.1)) };
        let go = |mesh: Mesh, reach_metres: f64| {
            let inputs = In {
                object: Arc::new(object.clone()),
                pose: Arc::new(pose.clone()),
                mesh: Some(Arc::new(mesh)),
                splats: None,
            };
            Snap::run(&Snap { reach_metres, align: false }, inputs, &context())
        };
        let error = go(plane(0.0, 0.0), 0.5).map(|_| ()).expect_err("0.8 m");
        let told = format!("{error:?}");
        for part in ["0.90 m below the origin", "nearest is 0.80 m above", "up by 0.80 m", "to 0.81"] {
            assert!(told.contains(part), "{part}: {told}");
        }
        assert!(go(plane(0.0, 0.0), 0.81).is_ok(), "as it says");
        let aside = Mesh { positions: vec![[5.0; 3], [6.0, 5.0, 5.0], [5.0, 6.0, 5.0]], ..plane(0.0, 0.0) };
        let aside = Mesh { triangles: vec![[0, 1, 2]], ..aside };
        let told = go(aside, 0.5).map(|_| ()).expect_err("none").message().to_owned();
        assert!(told.contains("nor is there any within 100 m"), "{told}");
    }

    #[test]
    fn aligned_objects_take_the_normal() {
        let pose = run(Some(plane(0.0, 0.2)), None, 0.1, true).unwrap_or_else(|e| panic!("{e}"));
        let normal = DVec3::new(-0.2, 0.0, 1.0).normalize();
        assert!((pose.transform_vector3(DVec3::Z) - normal).length() < 1e-5, "{pose}");
        // The foot lies on the plane.
        let foot = pose.w_axis.truncate();
        assert!((foot.z - 0.2 * foot.x).abs() < 1e-5, "{foot}");
    }

    /// A block of 0.4 by 0.4 by 0.4 that stands on a face.
    fn block() -> Arc<Object> {
        let corner = |i: u32| [0, 1, 2].map(|k| (i >> k & 1) as f32 * 0.4 - if k == 1 { 0.0 } else { 0.2 });
        let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let positions = (0..8).map(corner).collect();
        let primitive = Primitive { positions, triangles, ..Primitive::default() };
        Arc::new(Object { primitives: vec![primitive], ..Object::default() })
    }

    /// Ground of 80 by 80 cells, 2 wide, at heights given by a function of the place.
    fn relief(height: impl Fn(f64, f64) -> f64) -> Mesh {
        let side = 81_u32;
        let mut mesh = Mesh::default();
        for i in 0..side * side {
            let [x, y] = [i % side, i / side].map(|k| f64::from(k) / 40.0 - 1.0);
            mesh.positions.push([x as f32, y as f32, height(x, y) as f32]);
        }
        for i in (0..side * (side - 1)).filter(|i| i % side + 1 < side) {
            mesh.triangles.extend([[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]);
        }
        mesh
    }

    /// On a mound a block stands on the top of it, in a hollow on its rim, on a rounded kerb on the kerb's edge and, if
    /// turned, on the street too: nothing of the ground is in it and it touches. Before, the mound stood 43 mm into it.
    #[test]
    fn on_curved_ground_objects_stand_on_what_they_touch() {
        let exp = |v: f64| f64::from(crate::num::f32::exp(v as f32));
        let mound = |x: f64, y: f64| 0.15 * exp(-(x * x + y * y) / 0.18);
        let hollow = |x: f64, y: f64| 0.6 * (x * x + y * y);
        let kerb = |x: f64, _: f64| 0.15 / (1.0 + exp(-x / 0.04));
        let valley = |x: f64, y: f64| 0.5 * (x * x + 0.01).sqrt() + 0.1 * y;
        type Height<'a> = &'a dyn Fn(f64, f64) -> f64;
        let grounds: [(&str, Height<'_>, bool); 4] = [
            ("mound", &mound, false),
            ("hollow", &hollow, false),
            ("kerb", &kerb, true),
            ("valley", &valley, true),
        ];
        for (name, ground, tilts) in grounds {
            for align in [false, true] {
                let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.0, 0.0, 0.1)) };
                let inputs = In {
                    object: block(),
                    pose: Arc::new(pose),
                    mesh: Some(Arc::new(relief(ground))),
                    splats: None,
                };
                let (out, notes) = Snap::run(&Snap { reach_metres: 0.5, align }, inputs, &context())
                    .unwrap_or_else(|e| panic!("{name}: {e}"));
                assert!(notes.iter().any(|note| note.id == "curved-ground"), "{name}");
                let pose = out.pose.world_from_local;
                // Gaps between the underside and the ground below it.
                let gaps: Vec<f64> = (0..41 * 41)
                    .map(|i| [i % 41, i / 41].map(|k| f64::from(k) * 0.01 - 0.2))
                    .map(|[x, y]| pose.transform_point3(DVec3::new(x, y, 0.0)))
                    .map(|p| p.z - ground(p.x, p.y))
                    .collect();
                let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
                assert!((-2.5e-3..2e-3).contains(&least), "{name}, {align}: {least}");
                let tilt = pose.transform_vector3(DVec3::Z).truncate().length();
                assert_eq!(tilt > 0.05, align && tilts, "{name}: {tilt}");
                if align && tilts {
                    // Three contacts: the middle is as low as it can be, so contacts lie on both sides of it.
                    let near = |side: f64| {
                        let at = |i: usize| f64::from((i % 41) as u32) * 0.01 - 0.2;
                        gaps.iter().enumerate().any(|(i, gap)| at(i) * side > 0.0 && *gap < 4e-3)
                    };
                    assert!(near(1.0) && near(-1.0), "{name}");
                }
            }
        }
    }

    // On a slope the middle of the foot comes to stand, however large the foot is.
    /// Mutation: level planes alone in `densest` (seen red).
    #[test]
    fn slopes_hold_the_middle_of_the_foot() {
        for rise in [-0.9, -0.3, 0.05, 0.2, 0.6] {
            for align in [false, true] {
                let pose = run(Some(plane(0.0, rise)), None, 0.2, align).unwrap_or_else(|e| panic!("{e}"));
                let foot = pose.w_axis.truncate();
                assert!(
                    (foot - DVec3::new(0.3, 0.1, 0.3 * f64::from(rise))).length() < 1e-5,
                    "{rise}: {foot}"
                );
            }
        }
    }

    /// A table top has an underside, on which nothing stands; where all looks down it is the ground, and told.
    /// Mutation: `facing` taken without its sign in `on_mesh` (seen red).
    #[test]
    fn nothing_stands_on_what_looks_down() {
        let mut slab = plane(0.45, 0.0);
        let below = plane(0.4, 0.0);
        slab.positions.extend(below.positions);
        slab.triangles.extend([[4, 6, 5], [4, 7, 6]]);
        let turned = Mesh { triangles: slab.triangles[2..].to_vec(), ..slab.clone() };
        for (mesh, expected, told) in [(slab, 0.45, false), (turned, 0.4, true)] {
            let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, 0.38)) };
            let inputs =
                In { object: object(), pose: Arc::new(pose), mesh: Some(Arc::new(mesh)), splats: None };
            let how = Snap { reach_metres: 0.5, align: false };
            let (out, notes) = Snap::run(&how, inputs, &context()).unwrap_or_else(|e| panic!("{e}"));
            assert!((out.pose.world_from_local.w_axis.z - expected).abs() < 1e-6, "{expected}");
            assert_eq!(notes.iter().any(|note| note.id == "ground-looks-down"), told);
            assert!(notes.iter().any(|note| note.text.contains("0.0 mm rough")));
        }
    }

    // A table over a floor: the object goes to what it was near.
    #[test]
    fn of_two_levels_the_nearer_one_holds() {
        let mut both = plane(0.0, 0.0);
        let table = plane(0.4, 0.0);
        both.positions.extend(table.positions);
        both.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        for (z, expected) in [(0.1, 0.0), (0.35, 0.4)] {
            let pose = run(Some(both.clone()), None, z, false).unwrap_or_else(|e| panic!("{e}"));
            assert!((pose.w_axis.z - expected).abs() < 1e-6, "{z}: {pose}");
        }
    }

    #[test]
    fn splats_hold_objects_too() {
        let mut splats = Splats {
            means: Vec::new(),
            means_low: Vec::new(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 400],
            scales: vec![[0.01; 3]; 400],
            opacities: Vec::new(),
            sh_degree: 0,
            sh: vec![[0.0; 3]; 400],
            encoding: crate::types::SplatEncoding::Srgb,
            antialiased: false,
        };
        for i in 0..400_u32 {
            let [x, y] = [i % 20, i / 20].map(|k| k as f32 * 0.05 - 0.4);
            let height = 0.2 + if i % 3 == 0 { 0.004 } else { -0.002 };
            splats.means.push([x, y, if i % 10 == 0 { 0.45 } else { height }]);
            splats.opacities.push(if i % 7 == 0 { 0.1 } else { 0.9 });
        }
        let pose = run(None, Some(splats), 0.0, false).unwrap_or_else(|e| panic!("{e}"));
        assert!((pose.w_axis.z - 0.2).abs() < 0.005, "{pose}");
    }
}
