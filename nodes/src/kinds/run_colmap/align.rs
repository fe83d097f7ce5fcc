//! An upright world with a scale, for a reconstruction whose orientation, origin and scale are arbitrary.

use engine::{Context, Notes};
use glam::{DMat3, DMat4, DVec3};
use render::geometry::level::upright_cameras;
use scene::math::equirect::axes;
use scene::types::Rig;
use scene::types::frame::Similarity;

use super::model::Reconstruction;

/// Share of the points that lie below the ground: reflections, and points with large errors.
const BELOW: f64 = 0.02;
/// Maximum reprojection error, relative to the mean, of the points that determine the ground.
const EXACT: f64 = 2.0;

/// Rotates the reconstruction upright, puts its origin on the ground below the middle of the points, and scales it so
/// that the cameras have the given median height above the ground. Adds a note about each assumption.
pub fn upright(found: &mut Reconstruction, camera_height_metres: f64, cx: &Context, notes: &mut Notes) {
    let up = axes(cx.up())[2];
    let rig = Rig { cameras: found.photos.iter().map(|photo| photo.camera.clone()).collect() };
    let rotation = match upright_cameras(&rig, up) {
        Some((rotation, signed)) => {
            if !signed {
                let text = "the cameras were held on their side, so the place may be upside down; if it is, set \
                            `alignment: AsReconstructed` and correct it with `matrix` of the loaders";
                notes.warning("up-unsigned", text);
            }
            rotation
        }
        None => {
            let text =
                "the cameras were not held level, so the up axis is unknown and that of COLMAP is kept";
            notes.warning("up-unknown", text);
            DMat3::IDENTITY
        }
    };
    let eyes: Vec<DVec3> = rig.cameras.iter().map(|camera| rotation * camera.eye()).collect();
    let most = EXACT * found.error_px();
    let mut exact: Vec<DVec3> = found
        .points
        .iter()
        .filter(|scored| scored.error_px <= most)
        .map(|scored| rotation * DVec3::from(scored.point.position.map(f64::from)))
        .collect();
    if exact.is_empty() {
        exact.clone_from(&eyes);
    }
    let heights = sorted(exact.iter().map(|point| point.dot(up)));
    let ground = heights[(BELOW * heights.len() as f64) as usize];
    let eye = median(eyes.iter().map(|eye| eye.dot(up)));
    let above = eye - ground;
    let middle = DVec3::new(
        median(exact.iter().map(|point| point.x)),
        median(exact.iter().map(|point| point.y)),
        median(exact.iter().map(|point| point.z)),
    );
    let origin = middle + up * (ground - middle.dot(up));
    let scale = if above > 0.0 { camera_height_metres / cx.metres_per_unit() / above } else { 1.0 };
    if above > 0.0 {
        let text = format!(
            "the scale is such that the cameras are {camera_height_metres} m above the ground (median); \
             `camera_height_metres` corrects it"
        );
        notes.decision("scale-assumed", text);
    } else {
        notes.warning("scale-unknown", "the cameras are below the points, so the scale of COLMAP is kept");
    }
    let all = Similarity { rotation, scale, offset: -origin * scale };
    for photo in &mut found.photos {
        let turn = rotation * DMat3::from_mat4(photo.camera.world_from_camera());
        let eye = all.point(photo.camera.eye());
        photo.camera.world_from_camera = DMat4::from_cols(
            turn.x_axis.extend(0.0),
            turn.y_axis.extend(0.0),
            turn.z_axis.extend(0.0),
            eye.extend(1.0),
        )
        .to_cols_array();
    }
    for scored in &mut found.points {
        let at = DVec3::from(scored.point.position.map(f64::from));
        scored.point.position = all.point(at).as_vec3().to_array();
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The median of at least one value.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let values = sorted(values);
    values[values.len() / 2]
}
