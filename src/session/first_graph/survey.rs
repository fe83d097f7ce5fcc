//! Values of the graph that `init` derives from the user's files: the orientation of the capture, and a position
//! for the object and the camera.

use std::path::{Path, PathBuf};

use engine::{InputFile, Kind, NodeError, Up};
use glam::DVec3;
use nodes::kinds::load_object::{self, LoadObject};
use render::geometry::level::{LevelEstimate, Scale};
use render::layout::{Arrangement, Extents, Surface, Viewpoint, arrange};
use scene::io::splats::Format;
use scene::math::equirect::axes;
use scene::types::Rig;

use super::sky::Sky;
use crate::session::standing::Standing;
use crate::session::{mesh, splats};

/// Range of scene radii, in units. A scene of unknown scale is assumed to be in metres if its radius is in this
/// range.
const METRIC: [f64; 2] = [1.0, 100.0];
/// Size in metres from which the file of an object is assumed to be in centimetres.
const CENTIMETRES: f64 = 20.0;
/// Default of the near plane of views, in metres.
pub const NEAR: f64 = 0.2;
/// Width and height of the first picture.
pub const SIZE: [u32; 2] = [960, 540];

/// The user's files.
#[derive(Debug, Clone, Copy)]
pub struct Files<'a> {
    /// Folder of the graph.
    pub folder: &'a Path,
    /// File or folder of the captured splats.
    pub splats: &'a Path,
    /// File of the object to insert.
    pub object: &'a Path,
    /// File with a mesh of the place.
    pub mesh: Option<&'a Path>,
    /// File with the cameras of the capture.
    pub cameras: Option<&'a Path>,
    /// File of a photograph of the place.
    pub photo: Option<&'a Path>,
}

/// Where the user wants the object and the camera.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Point that the object stands on, in world units.
    pub place: DVec3,
    /// The camera.
    pub view: Viewpoint,
}

/// A photograph, and the camera of the same name.
#[derive(Debug, Clone)]
pub struct Photo {
    /// Path of the photograph as written in the graph.
    pub path: String,
    /// Name of the camera.
    pub camera: String,
}

/// All values from which the graph is written.
#[derive(Debug)]
pub struct Survey {
    /// Path of the splats as written in the graph.
    pub splats: String,
    /// Path of the object as written in the graph.
    pub object: String,
    /// Path of the mesh as written in the graph.
    pub mesh: Option<String>,
    /// Path of the cameras as written in the graph.
    pub cameras: Option<String>,
    /// The photograph.
    pub photo: Option<Photo>,
    /// The capture, rotated upright, in world space.
    pub standing: Standing,
    /// Metres per unit as written in the graph.
    pub metres_per_unit: f64,
    /// Bounding box of the object, in metres, after scaling by `file_scale`.
    pub extents: Extents,
    /// Metres per unit of the object's file: 1, as glTF requires, or 0.01.
    pub file_scale: f64,
    /// Position and size of the object, and the camera.
    pub arranged: Arrangement,
    /// Translation of the pose: the position of the origin of the object's file, in world units.
    pub translation: DVec3,
    /// Rotation of the object about the up axis, in degrees.
    pub yaw_deg: f64,
    /// Height of the probe above the foot of the object, in metres.
    pub probe_metres: f64,
    /// The light at the probe.
    pub sky: Sky,
    /// True if the user chose the place and the camera.
    pub is_chosen: bool,
}

/// The path of a file as written in a graph in `folder`: relative to `folder` if the two have a common parent
/// folder other than the root, otherwise absolute.
pub fn relative(folder: &Path, file: &Path) -> Result<String, NodeError> {
    let absolute = |path: &Path| -> Result<PathBuf, NodeError> {
        // The folder may not exist yet.
        let mut there =
            std::path::absolute(path).map_err(|e| NodeError::new(format!("`{}`: {e}", path.display())))?;
        let mut rest = Vec::new();
        loop {
            if let Ok(found) = there.canonicalize() {
                return Ok(rest.iter().rev().fold(found, |path, part| path.join(part)));
            }
            let Some(name) = there.file_name().map(ToOwned::to_owned) else { return Ok(there) };
            rest.push(name);
            there.pop();
        }
    };
    let (folder, file) = (absolute(folder)?, absolute(file)?);
    let common = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    let path = if common > 1 {
        let ups = folder.components().count() - common;
        let below: PathBuf = file.components().skip(common).collect();
        (0..ups).fold(PathBuf::new(), |path, _| path.join("..")).join(below)
    } else {
        file
    };
    let unreadable =
        || NodeError::new(format!("the path `{}` is not UTF-8, which graph files require", path.display()));
    Ok(path.to_str().ok_or_else(unreadable)?.to_owned())
}

impl Survey {
    /// Reads the files and derives the values of the graph.
    pub fn of(files: &Files<'_>) -> Result<Self, NodeError> {
        for file in [Some(files.splats), Some(files.object), files.mesh, files.cameras, files.photo]
            .into_iter()
            .flatten()
        {
            splats::check(file)?;
        }
        let standing = Standing::of(files.splats, files.cameras)
            .map_err(|error| if mesh::is_mesh(files.splats) { exchanged(error) } else { error })?;
        Self::on(standing, files, None)
    }

    /// Derives the values of the graph for a capture that has been read. `wanted` replaces the place and the camera
    /// that would be chosen.
    pub fn on(standing: Standing, files: &Files<'_>, wanted: Option<Wanted>) -> Result<Self, NodeError> {
        let (up, stand, cameras) = (standing.up, &standing.stand, standing.cameras.as_deref());
        let cx = splats::context(up);
        let params = LoadObject::of(InputFile(files.object.display().to_string()));
        let object = LoadObject::run(&params, load_object::In {}, &cx)
            .map_err(|error| if is_splats(files.object) { exchanged(error) } else { error })?
            .0
            .object;
        let own = Extents::of(&object)
            .ok_or_else(|| NodeError::new(format!("`{}` has no triangles", files.object.display())))?;
        let file_scale = if own.size().max_element() < CENTIMETRES { 1.0 } else { 0.01 };
        let extents = Extents { low: own.low * file_scale, high: own.high * file_scale };
        let mut metres_per_unit = standing.chosen_scale.unwrap_or_else(|| metres(stand));
        let mut arranged = arrange(&standing.splats, stand, &extents, metres_per_unit, cameras, &cx)?;
        if let Some(Wanted { place, view }) = wanted {
            let height = place.dot(axes(up)[2]) - stand.floor;
            let radius = arranged.surface.map_or(0.0, |surface| surface.radius);
            let surface = Surface { place, radius, height, clearance: 0.0, area: 0.0, score: 0.0 };
            arranged = Arrangement { place, surface: Some(surface), view: Some(view), ..arranged };
        }
        if standing.chosen_scale.is_some() {
            // With a scale that the user has set, the object has its own size.
            (arranged.scale, arranged.fitted) = (1.0, false);
        }
        if arranged.fitted && !is_known(stand) {
            // Lengths in the graph are in metres. The object keeps its size, and the scale of the place is chosen
            // to fit it.
            let exact = metres_per_unit / arranged.scale;
            metres_per_unit = three_digits(exact);
            arranged.scale = 1.0;
        }
        let photo = files.photo.map(|path| photo(path, files, cameras)).transpose()?;
        let decimals = decimals(stand);
        let round = |v: DVec3| DVec3::from_array(v.to_array().map(|c| rounded(c, decimals)));
        if let Some(view) = &mut arranged.view {
            (view.eye, view.target) = (round(view.eye), round(view.target));
        }
        let yaw_deg = arranged.view.map_or(0.0, |view| facing(view.eye - arranged.place, up));
        let centre = 0.5 * (extents.low + extents.high);
        let to_world = scene::types::frame::world_from_gltf(up, metres_per_unit);
        let offset =
            yaw(up, yaw_deg, to_world.transform_vector3(DVec3::new(centre.x, extents.low.y, centre.z)));
        let translation = round(arranged.place - offset * arranged.scale);
        let path = |file: &Path| relative(files.folder, file);
        let tall = extents.size().y * arranged.scale;
        let probe_metres = one_digit((0.6 * tall).max(1e-3));
        let eye = arranged.place + axes(up)[2] * (probe_metres / metres_per_unit);
        let near = one_digit((0.1 * extents.size().length() * arranged.scale).min(NEAR)) / metres_per_unit;
        let sky = Sky::at(&standing.splats, eye, up, near)?;
        Ok(Self {
            splats: path(files.splats)?,
            object: path(files.object)?,
            mesh: files.mesh.map(path).transpose()?,
            cameras: files.cameras.map(path).transpose()?,
            photo,
            standing,
            metres_per_unit,
            extents,
            file_scale,
            arranged,
            translation,
            yaw_deg,
            probe_metres,
            sky,
            is_chosen: wanted.is_some(),
        })
    }

    /// Number of decimal places with which lengths in this scene are written.
    pub fn decimals(&self) -> usize {
        decimals(&self.standing.stand)
    }
}

/// True if a file of an object contains splats.
fn is_splats(file: &Path) -> bool {
    std::fs::read(file).is_ok_and(|bytes| Format::of("", &bytes).is_ok())
}

/// The error of a file that was given in place of another. The hint of the loader is about nodes of graphs.
fn exchanged(error: NodeError) -> NodeError {
    NodeError::new(error.message().to_owned())
        .hint("`--splats` takes the captured place and `--object` the object to insert; are they exchanged?")
}

/// True if the measured scale of a scene is certain enough to be written to the graph.
pub fn is_known(stand: &LevelEstimate) -> bool {
    stand.scale.metres_per_unit.is_some() && stand.scale.confidence >= 0.5
}

/// The largest number with one significant digit that is at most `value`.
pub fn one_digit(value: f64) -> f64 {
    let mut unit = 1e-9;
    while unit * 10.0 <= value {
        unit *= 10.0;
    }
    (value / unit).floor() * unit
}

fn three_digits(value: f64) -> f64 {
    let mut unit = 1e-9;
    while unit * 1000.0 <= value {
        unit *= 10.0;
    }
    (value / unit).round() * unit
}

/// The scale to write to the graph, in metres per unit: the measured scale if its confidence is high, otherwise 1
/// if the radius of the scene is plausible in metres, otherwise a power of ten that makes the radius plausible.
pub fn metres(stand: &LevelEstimate) -> f64 {
    match &stand.scale {
        Scale { metres_per_unit: Some(metres), confidence, .. } if *confidence >= 0.5 => rounded(*metres, 4),
        _ if (METRIC[0]..METRIC[1]).contains(&stand.radius) => 1.0,
        _ => {
            let mut unit = 1.0;
            while unit * stand.radius < METRIC[0] {
                unit *= 10.0;
            }
            while unit * stand.radius > METRIC[1] {
                unit *= 0.1;
            }
            unit
        }
    }
}

fn photo(path: &Path, files: &Files<'_>, cameras: Option<&Rig>) -> Result<Photo, NodeError> {
    let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let camera = cameras.into_iter().flat_map(|rig| &rig.cameras).find(|camera| camera.name == name);
    let camera = camera.ok_or_else(|| {
        NodeError::new(format!("no camera of `--cameras` has the name of the photograph, `{name}`")).hint(
            "`--photo` must be an undistorted picture of the capture, and `--cameras` must contain the camera of this picture",
        )
    })?;
    Ok(Photo { path: relative(files.folder, path)?, camera: camera.name.clone() })
}

/// Number of decimal places of coordinates: the smallest number, from 2 to 9, for which the radius of the scene is
/// at least 2000 units of the last place.
pub fn decimals(stand: &LevelEstimate) -> usize {
    let (mut digits, mut size) = (0, stand.radius);
    while size < 2000.0 && digits < 9 {
        (digits, size) = (digits + 1, size * 10.0);
    }
    digits.max(2)
}

pub fn rounded(value: f64, decimals: usize) -> f64 {
    let unit = (0..decimals).fold(1.0, |unit, _| unit * 10.0);
    let whole = (value * unit).round() / unit;
    // Not -0.
    if whole == 0.0 { 0.0 } else { whole }
}

/// The yaw, in degrees, that turns the front of an object (+z of glTF) to the direction `towards`, plus 20 degrees,
/// so that the object is seen slightly from the side. Rounded to a multiple of 5 degrees.
fn facing(towards: DVec3, up: Up) -> f64 {
    let [right, forward, _] = axes(up);
    // Front of glTF in the world is the opposite of forward.
    let (x, y) = (towards.dot(right), -towards.dot(forward));
    let angle = scene::math::num::atan2(x, y).to_degrees() + 20.0;
    (angle / 5.0).round() * 5.0
}

/// Rotates a vector about the up axis, counter-clockwise seen from above.
fn yaw(up: Up, degrees: f64, v: DVec3) -> DVec3 {
    let [right, forward, above] = axes(up);
    let (s, c) = scene::math::num::sin_cos(degrees.to_radians());
    let (x, y) = (v.dot(right), v.dot(forward));
    right * (x * c - y * s) + forward * (x * s + y * c) + above * v.dot(above)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_the_folder_of_the_graph() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("my captures")).expect("made");
        std::fs::write(at("my captures/a \"b\".ply"), "").expect("written");
        let path = relative(&at("new/deep"), &at("my captures/a \"b\".ply")).expect("a path");
        assert_eq!(path, "../../my captures/a \"b\".ply");
        assert_eq!(relative(&at(""), &at("my captures")).expect("a path"), "my captures");
    }

    #[test]
    fn the_front_of_an_object_faces_the_camera() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let [right, forward, _] = axes(up);
            let towards = right * 0.6 - forward * 0.8;
            let front = scene::types::frame::world_from_gltf(up, 1.0).transform_vector3(DVec3::Z);
            let turned = yaw(up, facing(towards, up), front);
            let angle =
                scene::math::num::atan2(turned.cross(towards).length(), turned.dot(towards)).to_degrees();
            assert!((15.0..25.0).contains(&angle), "{angle}");
        }
    }
}
