//! A page that starts from a captured place, without a graph.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use engine::{Graph, NodeError};
use glam::DVec3;
use nodes::kinds::load_splats::LoadSplats;
use render::layout::{Extents, Viewpoint, arrange};
use serve::{Bare, Proposal, Stand, Starter};

use crate::session::first_graph::assumptions;
use crate::session::first_graph::graph::{of_capture, text};
use crate::session::first_graph::survey::{Files, Survey, Wanted, decimals, metres, relative, rounded};
use crate::session::orientation::Orientation;
use crate::session::standing::Standing;
use crate::session::{Error, splats};
use crate::terminal;

/// Name of the graph that is written, in the current folder.
const GRAPH: &str = "graph.ron";
/// Bounding box in metres of the object for which the first camera is chosen.
const ORDINARY: Extents = Extents { low: DVec3::new(-0.25, 0.0, -0.25), high: DVec3::new(0.25, 0.6, 0.25) };
/// Maximum number of objects that are offered.
const MOST_OBJECTS: usize = 200;
/// Maximum depth of the folders in which objects are looked for.
const DEPTH: usize = 3;

/// Largest relative difference of two scales that count as equal.
const SAME_SCALE: f64 = 1e-9;

/// A captured place, and the graph that was written for it.
pub struct Capture {
    splats: PathBuf,
    /// The capture as it was measured.
    measured: Standing,
    /// The capture in the orientation of the graph that was asked for last.
    last: Mutex<Standing>,
}

impl Capture {
    /// Reads a capture, and writes a graph that shows it into the current folder. A graph of this capture that is
    /// there already is kept.
    ///
    /// # Errors
    /// If the capture cannot be read, or if another graph is there.
    pub fn open(splats: &Path) -> Result<Self, Error> {
        let named = |error: NodeError| Error::usage(format!("{}: {error}", splats.display()));
        splats::check(splats).map_err(named)?;
        let path = relative(Path::new("."), splats).map_err(named)?;
        let known = std::fs::read_to_string(GRAPH);
        if known.as_ref().is_ok_and(|text| !text.contains(&format!("path: {path:?}"))) {
            return Err(Error::usage(format!(
                "`{GRAPH}` exists already and does not load `{path}`; watch the graph, or start in another folder"
            )));
        }
        let capture = Self::of(splats, Standing::of(splats, None).map_err(named)?);
        for Proposal { what, value } in proposals(&capture.measured) {
            terminal::remark(&format!("{what}: {value}"));
        }
        if known.is_err() {
            let text = capture.shown(&capture.measured).map_err(named)?;
            cache::publish_file(Path::new(GRAPH), text.as_bytes())?;
        }
        Ok(capture)
    }

    fn of(splats: &Path, measured: Standing) -> Self {
        Self { splats: splats.to_owned(), last: Mutex::new(measured.clone()), measured }
    }

    /// Path of the graph.
    pub fn path(&self) -> PathBuf {
        PathBuf::from(GRAPH)
    }

    /// The text of a graph that shows the capture without an object.
    fn shown(&self, standing: &Standing) -> Result<String, NodeError> {
        let path = relative(Path::new("."), &self.splats)?;
        Ok(of_capture(&path, standing, scale(standing), &view(standing)?))
    }

    /// The capture with the up axis and the transform of a graph. A scale that the user has set is in `chosen_scale`.
    ///
    /// # Errors
    /// If the orientation is not the measured one, and the capture cannot be read again.
    fn standing(&self, now: &Graph) -> Result<Standing, NodeError> {
        let matrix = now.nodes.iter().find_map(|node| Some(node.params::<LoadSplats>()?.matrix));
        let mut standing = self.oriented(Orientation { up: now.scene.up, matrix: matrix.flatten() })?;
        let (own, set) = (metres(&standing.stand), now.scene.metres_per_unit);
        standing.chosen_scale = ((own - set).abs() > SAME_SCALE * set).then_some(set);
        Ok(standing)
    }

    fn oriented(&self, to: Orientation) -> Result<Standing, NodeError> {
        if self.measured.orientation() == to {
            return Ok(self.measured.clone());
        }
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.orientation() != to {
            *last = self.measured.turned(&self.splats, to)?;
        }
        Ok(last.clone())
    }

    /// Folders in which objects are looked for: that of the graph, and that of the capture.
    fn folders(&self) -> Vec<PathBuf> {
        let of_capture = self.splats.parent().filter(|parent| !parent.as_os_str().is_empty());
        let mut folders = vec![PathBuf::from(".")];
        folders.extend(of_capture.map(Path::to_owned));
        folders
    }
}

/// Metres per unit: as the user has set it, else as measured or assumed.
fn scale(standing: &Standing) -> f64 {
    standing.chosen_scale.unwrap_or_else(|| metres(&standing.stand))
}

fn proposals(standing: &Standing) -> Vec<Proposal> {
    let propose = |one: assumptions::Assumption| Proposal { what: one.what.to_owned(), value: one.text() };
    assumptions::of_capture(standing, scale(standing)).into_iter().map(propose).collect()
}

/// A camera that sees a level surface well, as for an object of ordinary size.
fn view(standing: &Standing) -> Result<Viewpoint, NodeError> {
    let (stand, cx) = (&standing.stand, splats::context(standing.up));
    let arranged = arrange(&standing.splats, stand, &ORDINARY, scale(standing), None, &cx)?;
    let [right, forward, up] = scene::math::equirect::axes(standing.up);
    let centre = DVec3::from_array(stand.centre);
    let aside = (right * 0.4 - forward + up * 0.5) * (1.5 * stand.radius);
    let outside = Viewpoint { eye: centre + aside, target: centre, fov_y_deg: 45.0, score: 0.0 };
    let view = arranged.view.unwrap_or(outside);
    let places = decimals(stand);
    let round = |v: DVec3| DVec3::from_array(v.to_array().map(|c| rounded(c, places)));
    Ok(Viewpoint { eye: round(view.eye), target: round(view.target), ..view })
}

/// Adds the objects in a folder, in the order of their names.
fn collect(folder: &Path, depth: usize, found: &mut Vec<String>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        let is_hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        let is_object = path
            .extension()
            .is_some_and(|end| ["glb", "gltf"].iter().any(|known| end.eq_ignore_ascii_case(known)));
        if found.len() >= MOST_OBJECTS || is_hidden {
            continue;
        }
        if is_object && path.is_file() {
            found.extend(relative(Path::new("."), &path).ok().filter(|name| !found.contains(name)));
        } else if depth > 1 && path.is_dir() && !path.is_symlink() {
            collect(&path, depth - 1, found);
        }
    }
}

impl Starter for Capture {
    fn bare(&self, now: &Graph) -> Bare {
        match self.standing(now) {
            Ok(standing) => {
                let up = standing.orientation().axis(standing.is_declared);
                Bare { proposals: proposals(&standing), up }
            }
            Err(error) => {
                let proposal = Proposal { what: "capture".to_owned(), value: error.to_string() };
                Bare { proposals: vec![proposal], up: None }
            }
        }
    }

    fn objects(&self) -> Vec<String> {
        let mut found = Vec::new();
        self.folders().iter().for_each(|folder| collect(folder, DEPTH, &mut found));
        found
    }

    fn graph(&self, now: &Graph, object: &str, stand: &Stand) -> Result<String, String> {
        let files = Files {
            folder: Path::new("."),
            splats: &self.splats,
            object: Path::new(object),
            mesh: None,
            cameras: None,
            photo: None,
        };
        let [place, eye, target] = [stand.place, stand.eye, stand.target].map(DVec3::from_array);
        let is_seen =
            place.is_finite() && eye.is_finite() && target.is_finite() && (target - eye).length() > 0.0;
        if !is_seen || !(0.1..=170.0).contains(&stand.fov_y_deg) {
            return Err("the place and the camera must be finite".to_owned());
        }
        let view = Viewpoint { eye, target, fov_y_deg: stand.fov_y_deg, score: 1.0 };
        let standing = self.standing(now).map_err(|error| error.to_string())?;
        let survey = Survey::on(standing, &files, Some(Wanted { place, view }));
        survey.map(|survey| text(&survey)).map_err(|error| error.to_string())
    }

    fn turned(&self, now: &Graph, up: &str) -> Result<String, String> {
        let turned = || {
            let to = Orientation::of_axis(up, self.measured.is_declared)
                .ok_or_else(|| NodeError::new(format!("`{up}` is not an axis")))?;
            let chosen_scale = self.standing(now)?.chosen_scale;
            self.shown(&Standing { chosen_scale, ..self.oriented(to)? })
        };
        turned().map_err(|error: NodeError| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use engine::{Source, SourceRoot};

    use super::*;

    /// A floor of flat splats with a box on it, in a frame in which +x points up. 8 units wide.
    fn place() -> Vec<u8> {
        let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
        let mut rows: Vec<[f32; 14]> = Vec::new();
        let mut flat = |x: f32, y: f32, z: f32| {
            rows.push([x, y, z, 0.3, 0.1, 0.0, 5.0, -5.0, -1.6, -1.6, 1.0, 0.0, 0.0, 0.0]);
        };
        for i in 0..40 {
            for j in 0..40 {
                let (y, z) = (f32::from(i as u8) * 0.2 - 3.9, f32::from(j as u8) * 0.2 - 3.9);
                let inside = (10..16).contains(&i) && (10..16).contains(&j);
                flat(if inside { 0.8 } else { 0.0 }, y, z);
            }
        }
        let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{properties}end_header\n",
            rows.len()
        );
        let bytes = rows.into_iter().flatten().flat_map(f32::to_le_bytes);
        head.into_bytes().into_iter().chain(bytes).collect()
    }

    /// A tetrahedron 0.6 m high, as glTF.
    fn object(folder: &Path) -> PathBuf {
        let corners: [[f32; 3]; 4] = [[-0.2, 0.0, -0.2], [0.2, 0.0, -0.2], [0.0, 0.0, 0.3], [0.0, 0.6, 0.0]];
        let faces: [u16; 12] = [0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0];
        let positions = corners.as_flattened().iter().flat_map(|v| v.to_le_bytes());
        let bytes: Vec<u8> = positions.chain(faces.iter().flat_map(|v| v.to_le_bytes())).collect();
        std::fs::write(folder.join("a.bin"), bytes).expect("written");
        let text = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-0.2, 0.0, -0.2], "max": [0.2, 0.6, 0.3]},
                {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}],
            "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
            "buffers": [{"uri": "a.bin", "byteLength": 72}]}"#;
        let path = folder.join("a.gltf");
        std::fs::write(&path, text).expect("written");
        path
    }

    fn parsed(text: &str) -> Graph {
        let source = Source::new("graph.ron".to_owned(), text.to_owned());
        let root = SourceRoot::new(Path::new("."));
        Graph::parse(source, &nodes::registry(), root)
            .unwrap_or_else(|mistakes| panic!("{}\n{text}", mistakes.render(false)))
    }

    /// The up axis and the scale of the text of a graph, and the scale of the pose.
    fn scene_line(text: &str) -> &str {
        text.lines().find(|line| line.trim_start().starts_with("scene: (")).map(str::trim).unwrap_or_default()
    }

    /// This test fails if `standing` returns the measured capture for every graph.
    #[test]
    fn the_first_graph_keeps_the_scale_and_the_up_axis_that_were_set() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("place.ply");
        std::fs::write(&path, place()).expect("written");
        let object = object(folder.path()).display().to_string();
        let capture = Capture::of(&path, Standing::of(&path, None).expect("a capture"));
        let bare = capture.shown(&capture.measured).expect("a graph");

        // The user turns the capture.
        let turned = capture.turned(&parsed(&bare), "+x").expect("turned");
        assert!(scene_line(&turned).contains("up: \"+z\", metres_per_unit: 1.0,"), "{turned}");
        assert!(turned.contains("set by hand: `matrix` below"), "{turned}");
        let now = parsed(&turned);
        assert_eq!(capture.bare(&now).up, Some("+x"));
        let floor = &capture.bare(&now).proposals[1];
        assert!(floor.value.starts_with("z = 0.0") || floor.value.starts_with("z = -0.0"), "{floor:?}");

        // The user measures the scale.
        let scaled = turned.replace("metres_per_unit: 1.0,", "metres_per_unit: 0.00125,");
        let now = parsed(&scaled);
        let scale = &capture.bare(&now).proposals[2];
        assert_eq!(scale.value, "0.00125 m per unit, set by hand");
        let stand =
            Stand { place: [1.0, 2.0, 0.0], eye: [3.0, -3.0, 2.0], target: [1.0, 2.0, 0.0], fov_y_deg: 45.0 };
        let first = capture.graph(&now, &object, &stand).expect("a graph");
        assert!(scene_line(&first).contains("up: \"+z\", metres_per_unit: 0.00125,"), "{first}");
        assert!(first.contains("`metres_per_unit` was set by hand"), "{first}");
        assert!(first.contains("scale: 1.0),"), "the object has its own size: {first}");
        let matrix =
            |text: &str| parsed(text).nodes.iter().find_map(|node| Some(node.params::<LoadSplats>()?.matrix));
        assert_eq!(matrix(&first), matrix(&turned));
        assert!(matrix(&first).flatten().is_some());
        // The scale stays if the capture is turned again.
        let again = capture.turned(&now, "-x").expect("turned");
        assert!(scene_line(&again).contains("metres_per_unit: 0.00125,"), "{again}");
        assert!(capture.turned(&now, "sideways").is_err());
    }
}
