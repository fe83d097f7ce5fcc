//! A page that starts from a captured place, without a graph.

use std::path::{Path, PathBuf};

use engine::NodeError;
use glam::DVec3;
use render::layout::{Extents, Viewpoint, arrange};
use serve::{Proposal, Stand, Starter};

use crate::session::first_graph::assumptions;
use crate::session::first_graph::graph::{of_capture, text};
use crate::session::first_graph::survey::{Files, Survey, Wanted, decimals, metres, relative, rounded};
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

/// A captured place, and the graph that was written for it.
pub struct Capture {
    splats: PathBuf,
    standing: Standing,
    metres_per_unit: f64,
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
        let standing = Standing::of(splats, None).map_err(named)?;
        let metres_per_unit = metres(&standing.stand);
        let capture = Self { splats: splats.to_owned(), standing, metres_per_unit };
        for Proposal { what, value } in capture.proposals() {
            terminal::remark(&format!("{what}: {value}"));
        }
        if known.is_err() {
            let view = capture.view().map_err(named)?;
            let text = of_capture(&path, &capture.standing, metres_per_unit, &view);
            cache::publish_file(Path::new(GRAPH), text.as_bytes())?;
        }
        Ok(capture)
    }

    /// Path of the graph.
    pub fn path(&self) -> PathBuf {
        PathBuf::from(GRAPH)
    }

    /// A camera that sees a level surface well, as for an object of ordinary size.
    fn view(&self) -> Result<Viewpoint, NodeError> {
        let (stand, cx) = (&self.standing.stand, splats::context(self.standing.up));
        let scene = &self.standing.splats;
        let arranged = arrange(scene, stand, &ORDINARY, self.metres_per_unit, None, &cx)?;
        let [right, forward, up] = scene::math::equirect::axes(self.standing.up);
        let centre = DVec3::from_array(stand.centre);
        let aside = (right * 0.4 - forward + up * 0.5) * (1.5 * stand.radius);
        let outside = Viewpoint { eye: centre + aside, target: centre, fov_y_deg: 45.0, score: 0.0 };
        let view = arranged.view.unwrap_or(outside);
        let places = decimals(stand);
        let round = |v: DVec3| DVec3::from_array(v.to_array().map(|c| rounded(c, places)));
        Ok(Viewpoint { eye: round(view.eye), target: round(view.target), ..view })
    }

    /// Folders in which objects are looked for: that of the graph, and that of the capture.
    fn folders(&self) -> Vec<PathBuf> {
        let of_capture = self.splats.parent().filter(|parent| !parent.as_os_str().is_empty());
        let mut folders = vec![PathBuf::from(".")];
        folders.extend(of_capture.map(Path::to_owned));
        folders
    }
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
    fn proposals(&self) -> Vec<Proposal> {
        let propose =
            |one: assumptions::Assumption| Proposal { what: one.what.to_owned(), value: one.text() };
        assumptions::of_capture(&self.standing, self.metres_per_unit).into_iter().map(propose).collect()
    }

    fn objects(&self) -> Vec<String> {
        let mut found = Vec::new();
        self.folders().iter().for_each(|folder| collect(folder, DEPTH, &mut found));
        found
    }

    fn graph(&self, object: &str, stand: &Stand) -> Result<String, String> {
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
        let survey = Survey::on(self.standing.clone(), &files, Some(Wanted { place, view }));
        survey.map(|survey| text(&survey)).map_err(|error| error.to_string())
    }
}
