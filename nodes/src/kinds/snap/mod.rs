//! `snap`: puts an object on the ground below it.

mod ground;
mod level_search;
mod splat_ground;

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes};
use glam::{DMat4, DQuat};
use render::geometry::resting::Relief;
use render::geometry::support::{Foot, GroundPlane, triangles};
use scene::math::equirect::axes;
use scene::types::frame::world_from_gltf;
use scene::types::{Cell, Mesh, Object, Placed, Pose, Report, Splats, Table};

use ground::Ground;
use level_search::bearing;
use splat_ground::on_splats;

engine::params! {
    /// Moves a pose up or down so that the object stands on the mesh of the scene, or on its splats.
    ///
    /// The ground is searched for below and slightly around the object's foot, up to `reach_metres` above and below
    /// it. Of the levels that support at least half as much of the foot as the best level, the nearest is the
    /// ground. So an object on a table stays there. The middle of the foot is put on the plane that fits most of
    /// this level; if the mesh is rough, this plane lies at its mean height. If the mesh below the foot deviates
    /// more than 2 cm from this plane (a mound, a hollow, a kerb), the object is put on its contact points, which
    /// is reported.
    ///
    /// Ground faces up and is not steeper than 45 degrees. If no surface of the mesh within reach faces up,
    /// surfaces that face down are used, which is reported. The underside of a shell less than 2 m thick is never
    /// used; the error then gives the height of its upper side. Wire the new pose in place of the old one, to
    /// `place` and to the probe.
    pub struct Snap {
        /// Maximum distance of the ground above or below the object's foot.
        reach_metres: f64 = 0.5, range(0.001, 100.0), unit("m"), other("0.005");
        /// True to rotate the object about its foot so that its up axis is the normal of the ground. On
        /// uneven ground it is rotated until it rests on three contacts around its middle.
        align: bool = false, other("true");
    }
}
engine::inputs! {
    /// Object, pose and ground.
    pub struct In {
        /// The object.
        object: Arc<Object>,
        /// Approximate pose of the object.
        pose: Arc<Pose>,
        /// Mesh of the scene; give this or `splats`.
        mesh: Option<Arc<Mesh>>,
        /// Splats of the scene; give this or `mesh`. For each splat, the height is used at which the splat is
        /// densest along vertical lines through the foot.
        splats: Option<Arc<Splats>>,
    }
}
engine::outputs! {
    /// Outputs of [`Snap`].
    pub struct Out {
        /// The pose on the ground.
        pose: Arc<Pose>,
        /// Table `ground` with the measured ground.
        report: Arc<Report>,
    }
}

/// Maximum distance above or below a plane of the points that belong to it, in metres.
const NEAR: f64 = 0.02;
/// Distance within which the nearest ground is searched for, in metres, to name it in an error message. It is the
/// largest value of `reach_metres`.
const FAR: f64 = 100.0;

impl Kind for Snap {
    const NAME: &'static str = "snap";
    const VERSION: u32 = 6;
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
            return Err(NodeError::new("the object has no usable triangle").at("object"));
        };
        let reach = params.reach_metres * metre;
        let mut notes = Notes::none();
        let felt = inputs.mesh.as_deref().map(|mesh| Ground::new(mesh, &foot, up, cx)).transpose()?;
        let points = match (&felt, &inputs.splats) {
            (Some(felt), None) => felt.ground(&foot, up, reach, cx, &mut notes)?,
            (None, Some(splats)) => on_splats(splats, &foot, up, reach),
            _ => {
                let what = "the ground needs either `mesh` or `splats`";
                return Err(NodeError::new(what).at("mesh").hint("wire one of the two"));
            }
        };
        // The foot itself, without the margin around it.
        let half = Foot::axes(up).map(|axis| foot.half.dot(axis.abs()) / 1.5);
        let Some(level) = GroundPlane::of(&bearing(&points, half, NEAR * metre, cx)?) else {
            let far = FAR * metre;
            let points = match (&felt, &inputs.splats) {
                // Steep surfaces are not ground.
                (Some(felt), _) => {
                    let columns = felt.columns(&foot, up, far, cx)?;
                    if columns.up.is_empty() { columns.down } else { columns.up }
                }
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
                "the ground below the foot deviates {:.0} mm from a plane, so the object is put on its contact points",
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
            "the object was moved by {:+.1} mm (positive: up), to ground with a roughness of {:.1} mm and the normal ({:.3}, {:.3}, {:.3})",
            millimetres(height),
            millimetres(level.roughness),
            normal.x,
            normal.y,
            normal.z
        );
        notes.decision("snapped", text);
        let row = [height, level.roughness, normal.x, normal.y, normal.z];
        let columns =
            ["moved up (world units)", "roughness (world units)", "normal x", "normal y", "normal z"];
        let table = Table::new("ground", columns, vec![row.map(Cell::Number).to_vec()]);
        let report = Report { title: "Object placed on the ground".to_owned(), tables: vec![table] };
        Ok((Out { pose: Arc::new(Pose { world_from_local: moved }), report: Arc::new(report) }, notes))
    }
}

/// Error for a foot that has no ground within `reach`. All lengths are in metres. `below` is the distance from the
/// origin of the pose down to the foot, and `nearest` is the height of the nearest ground above the foot, if any
/// ground was found.
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
            // One centimetre more, rounded to centimetres.
            let enough = ((by * 100.0).round() + 1.0) / 100.0;
            let side = side(height, ["above", "below"]);
            (
                format!("the nearest ground is {by:.2} m {side} the foot"),
                format!("move the pose {up} by {by:.2} m, or raise `reach_metres` to {enough:.2}"),
            )
        }
        None => (
            format!("there is no ground within {FAR} m"),
            "move the pose to a position with ground above or below it".to_owned(),
        ),
    };
    NodeError::new(format!("there is no ground within {reach} m of the object's foot{foot}; {what}"))
        .at("pose")
        .hint(hint)
}

#[cfg(test)]
mod tests;
