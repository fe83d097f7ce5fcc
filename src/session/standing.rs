//! The orientation of a capture: its splats and cameras are transformed to a world in which up is known.

use std::path::Path;
use std::sync::Arc;

use engine::{Context, InputFile, Kind, NodeError, Scene, Up};
use glam::DVec3;
use nodes::kinds::load_cameras::{self, Distortion, LoadCameras};
use nodes::kinds::load_splats::{self, Frame, LoadSplats};
use render::geometry::level::{self, LevelEstimate};
use scene::io::splats::{StatedUp, from_y_up};
use scene::math::equirect::axes;
use scene::math::num;
use scene::types::frame::Similarity;
use scene::types::{Rig, Splats};

#[cfg(feature = "serve")]
use super::orientation::Orientation;

/// Maximum angle in degrees between the measured up direction and an axis. If the angle is at most this, the axis
/// is used as the up direction.
const STRAIGHT_DEG: f64 = 2.5;
/// Minimum confidence at which a measured up direction is preferred to the usual convention of trainers.
const LEANING: f64 = 0.5;

/// Number of splats that are projected into each camera to find out whether the cameras see the place.
const SAMPLED: usize = 2000;
/// Share of the splats below which cameras do not belong to a capture.
const BLIND: f64 = 0.002;

/// The basis on which the up direction was determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpBy {
    /// Measured from the floor or the cameras.
    Measured,
    /// Defined by the format of the file.
    Format,
    /// Neither measured nor defined by the format.
    Guessed,
    /// Set by the user.
    #[cfg(feature = "serve")]
    Chosen,
}

/// A capture that was rotated upright.
#[derive(Debug, Clone)]
pub struct Standing {
    /// The splats in world space.
    pub splats: Arc<Splats>,
    /// The cameras in world space.
    pub cameras: Option<Arc<Rig>>,
    /// The axis of the world that points up.
    pub up: Up,
    /// The basis on which `up` was determined.
    pub by: UpBy,
    /// Probability that `up` is correct, 0 to 1.
    pub confidence: f64,
    /// Transform of the splats to the world, row by row, applied after the transform that the format of the file
    /// defines; `None` for the identity.
    pub matrix: Option<[f64; 16]>,
    /// Transform of the cameras to the world, row by row; `None` for the identity. Camera formats do not define an
    /// up axis.
    pub camera_matrix: Option<[f64; 16]>,
    /// Floor, ceiling and scale in world space.
    pub stand: LevelEstimate,
    /// Metres per unit that the user has set, in place of the scale of `stand`.
    pub chosen_scale: Option<f64>,
    /// True if the format of the file defines +y as up, so that loading has rotated the capture.
    #[cfg(feature = "serve")]
    pub is_declared: bool,
}

fn context(up: Up) -> Context {
    Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, "")
}

fn load(path: &Path, matrix: Option<[f64; 16]>, cx: &Context) -> Result<Arc<Splats>, NodeError> {
    let path = InputFile(path.display().to_string());
    let frame = Frame::ByFormat;
    let params =
        LoadSplats { path, more: Vec::new(), strict: false, max_extent: 1e6, level: 0, frame, matrix };
    Ok(LoadSplats::run(&params, load_splats::In {}, cx)?.0.splats)
}

fn rig(path: &Path, matrix: Option<[f64; 16]>, cx: &Context) -> Result<Arc<Rig>, NodeError> {
    let cameras = LoadCameras::of(InputFile(path.display().to_string()));
    let params = LoadCameras { distortion: Distortion::Ignore, matrix, ..cameras };
    Ok(LoadCameras::run(&params, load_cameras::In {}, cx)?.0.rig)
}

/// Mean share of the splats whose centres a camera sees, of about [`SAMPLED`] splats.
fn seen(splats: &Splats, rig: &Rig) -> f64 {
    let step = splats.len().div_ceil(SAMPLED).max(1);
    let (mut inside, mut all) = (0_u64, 0_u64);
    for camera in &rig.cameras {
        let from_world = camera.camera_from_world();
        for position in splats.means.iter().step_by(step) {
            let p = from_world.transform_point3(DVec3::from_array(position.map(f64::from)));
            let shown = camera.pixel(p).is_some_and(|[x, y]| {
                (0.0..camera.width_px.into()).contains(&x) && (0.0..camera.height_px.into()).contains(&y)
            });
            inside += u64::from(shown);
            all += 1;
        }
    }
    inside as f64 / all.max(1) as f64
}

/// Refuses cameras that see almost none of the splats.
fn check_cameras(splats: &Splats, rig: &Rig, path: &Path) -> Result<(), NodeError> {
    let share = seen(splats, rig);
    if share >= BLIND {
        return Ok(());
    }
    let what = format!(
        "the cameras of `{}` see only {:.2} % of the splats: they are in another coordinate frame, or of another place",
        path.display(),
        100.0 * share
    );
    Err(NodeError::new(what)
        .hint("leave out `--cameras`, or give the cameras in the frame of the splats; `init` measures up and scale from them"))
}

fn degrees(a: DVec3, b: DVec3) -> f64 {
    num::atan2(a.cross(b).length(), a.dot(b)).to_degrees()
}

/// Determines the up axis of the world, the transform of the capture to the world, the basis on which the up axis
/// was determined, and the confidence. If the format defines an up axis, the loader has already rotated the
/// capture to +z.
fn upright(measured: Option<&LevelEstimate>, stated: Option<StatedUp>) -> (Up, Option<[f64; 16]>, UpBy, f64) {
    let is_turned = stated.is_some_and(|up| up.by_format);
    let sure = measured.filter(|found| found.is_sure());
    let leaning = measured.filter(|found| stated.is_none() && found.confidence >= LEANING);
    if let Some(found) = sure.or(leaning) {
        let by = if found.is_sure() { UpBy::Measured } else { UpBy::Guessed };
        let up = DVec3::from_array(found.up);
        let near = |axis: &Up| degrees(up, axes(*axis)[2]) <= STRAIGHT_DEG;
        let axis = [Up::PlusZ, Up::PlusY, Up::MinusY].into_iter().find(near);
        if let Some(axis) = axis.filter(|axis| !is_turned || *axis == Up::PlusZ) {
            return (axis, None, by, found.confidence);
        }
        let turn = Similarity { rotation: found.turn_to(DVec3::Z), ..Similarity::IDENTITY };
        return (Up::PlusZ, Some(turn.rows()), by, found.confidence);
    }
    match stated {
        Some(up) => (if up.by_format { Up::PlusZ } else { up.axis }, None, UpBy::Format, 0.8),
        // The usual convention of trainers.
        None => (Up::MinusY, None, UpBy::Guessed, 0.3),
    }
}

impl Standing {
    /// Reads a capture and determines its orientation.
    pub fn of(splats: &Path, cameras: Option<&Path>) -> Result<Self, NodeError> {
        // A folder is a SOG scene, which says nothing about axes.
        let bytes = std::fs::read(splats).unwrap_or_default();
        let stated = StatedUp::of(&bytes);
        drop(bytes);
        let declared = stated.filter(|up| up.by_format).map(|up| up.axis);
        let cx = context(Up::PlusZ);
        let first = load(splats, None, &cx)?;
        // The cameras are in the frame of the file, which a declared format is turned from.
        let by_format = declared.map(|up| {
            let rotation = from_y_up(Up::PlusZ) * from_y_up(up).transpose();
            Similarity { rotation, ..Similarity::IDENTITY }
        });
        let in_file = cameras.map(|path| rig(path, by_format.map(|m| m.rows()), &cx)).transpose()?;
        if let (Some(rig), Some(path)) = (&in_file, cameras) {
            check_cameras(&first, rig, path)?;
        }
        let measured = level::of_splats(&first, in_file.as_deref());
        let (up, matrix, by, confidence) = upright(measured.as_ref(), stated);
        let cx = context(up);
        let place = match matrix {
            None => first,
            Some(_) => {
                // Both scenes at once would take twice the memory.
                drop(first);
                load(splats, matrix, &cx)?
            }
        };
        let turned = matrix.as_ref().map(Similarity::of_rows).transpose()?;
        let camera_matrix = match (by_format, turned) {
            (Some(first), Some(then)) => Some(then.after(&first).rows()),
            (one, other) => one.or(other).map(|m| m.rows()),
        };
        let cameras = cameras.map(|path| rig(path, camera_matrix, &cx)).transpose()?;
        let stand = level::upright(&place, axes(up)[2], cameras.as_deref())
            .ok_or_else(|| NodeError::new(format!("`{}` has no visible splats", splats.display())))?;
        Ok(Self {
            splats: place,
            cameras,
            up,
            by,
            confidence,
            matrix,
            camera_matrix,
            stand,
            chosen_scale: None,
            #[cfg(feature = "serve")]
            is_declared: declared == Some(Up::PlusY),
        })
    }

    /// Orientation of the splats.
    #[cfg(feature = "serve")]
    pub fn orientation(&self) -> Orientation {
        Orientation { up: self.up, matrix: self.matrix }
    }

    /// Reads the same capture from `splats` in an orientation that the user has set.
    #[cfg(feature = "serve")]
    pub fn turned(&self, splats: &Path, to: Orientation) -> Result<Self, NodeError> {
        let Orientation { up, matrix } = to;
        let place = load(splats, matrix, &context(up))?;
        let stand = level::upright(&place, axes(up)[2], None)
            .ok_or_else(|| NodeError::new(format!("`{}` has no visible splats", splats.display())))?;
        Ok(Self {
            splats: place,
            cameras: None,
            up,
            by: UpBy::Chosen,
            confidence: 1.0,
            matrix,
            camera_matrix: None,
            stand,
            chosen_scale: None,
            is_declared: self.is_declared,
        })
    }
}
