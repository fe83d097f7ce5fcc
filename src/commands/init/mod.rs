//! `init`: creates a folder with a first graph, for a synthetic scene or for the user's files.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::session::Error;
use crate::session::first_graph::survey::{self, Survey};
use crate::session::first_graph::{assumptions, graph};
use crate::terminal;

/// Creates a folder with a commented graph that can be run without changes.
///
/// Without files the scene is synthetic. With `--splats` and `--object` it measures which way is up, where the
/// floor lies and how long a unit is, and chooses a place for the object and a camera. It prints what it assumed,
/// how sure it is, and the line to edit. With `--photos` and `--object`, the graph finds the poses of the photographs
/// with COLMAP and trains splats.
#[derive(Debug, Args)]
pub struct Init {
    /// The folder; created if it does not exist
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// The captured place: a file or folder of splats (PLY, SPZ, SOG, .splat, .ksplat, glTF, .usda)
    #[arg(long, requires = "object")]
    splats: Option<PathBuf>,
    /// A folder of photographs of the place, PNG or JPEG, without poses; COLMAP finds the poses when the graph runs
    #[arg(long, requires = "object", conflicts_with_all = ["splats", "mesh", "cameras", "photo"])]
    photos: Option<PathBuf>,
    /// The object to insert: glTF, GLB, OBJ or STL
    #[arg(long)]
    object: Option<PathBuf>,
    /// A mesh of the place, in the frame of the splats; by default, it is extracted from the splats
    #[arg(long, requires = "splats")]
    mesh: Option<PathBuf>,
    /// The cameras of the capture (COLMAP, nerfstudio, INRIA, lightharmony JSON), in the frame of the splats
    #[arg(long, requires = "splats")]
    cameras: Option<PathBuf>,
    /// A photograph of the place as the background; a camera of `--cameras` must have the same name
    #[arg(long, requires = "cameras")]
    photo: Option<PathBuf>,
}

const GRAPH: &str = "graph.ron";

const README: &str = "\
# An object in a place

    lightharmony run graph.ron          # writes out/picture.png
    lightharmony plan graph.ron         # what a run would compute, why, and how long it would take
    lightharmony explain graph.ron save # why a node runs

Edit `graph.ron` and run it again: only what the edit affects is computed. `lightharmony nodes` lists the kinds of nodes,
and `lightharmony nodes path-trace` describes one kind.
";

const MADE_UP: &str = "
The scene of this graph is synthetic. For your own scene:

    lightharmony init FOLDER --splats capture.ply --object chair.glb
";

const HAND_ON: &str = "
To share it: `lightharmony pack graph.ron picture.lhb`; the recipient runs `lightharmony verify picture.lhb`.
";

impl Init {
    /// Writes the files. Returns an error if the graph file already exists. An existing `.gitignore` or `README.md`
    /// is kept, since most repositories have these files. Returns exit code 0, or 1 if a file cannot be used.
    pub fn run(self) -> Result<u8, Error> {
        let path = |name: &str| self.folder.join(name);
        let is_there = |name: &str| std::fs::symlink_metadata(path(name)).is_ok();
        if is_there(GRAPH) {
            return Err(Error::usage(format!("`{}` exists already", path(GRAPH).display())));
        }
        if self.object.is_some() && self.splats.is_none() && self.photos.is_none() {
            return Err(Error::usage("`--object` needs the place: add `--splats FILE` or `--photos FOLDER`"));
        }
        if let (Some(photos), Some(object)) = (&self.photos, &self.object) {
            return self.of_photos(photos, object);
        }
        let (text, assumed) = match (&self.splats, &self.object) {
            (Some(splats), Some(object)) => {
                let files = survey::Files {
                    folder: &self.folder,
                    splats,
                    object,
                    mesh: self.mesh.as_deref(),
                    cameras: self.cameras.as_deref(),
                    photo: self.photo.as_deref(),
                };
                let survey = match Survey::of(&files) {
                    Ok(survey) => survey,
                    Err(error) => return Ok(crate::session::splats::failed(&error)),
                };
                let graph = graph::text(&survey);
                let shown = assumptions::list(&survey, &graph, &path(GRAPH));
                (graph, shown)
            }
            _ => (include_str!("../../../graphs/starter.ron").to_owned(), String::new()),
        };
        let made_up = if assumed.is_empty() { MADE_UP } else { "" };
        self.write(&text, made_up)?;
        terminal::print(&format!("{}\n{assumed}", path(GRAPH).display()))?;
        Ok(0)
    }

    /// Writes the graph for a folder of photographs, which is `graphs/from-photos.ron` with the paths of the user.
    fn of_photos(&self, photos: &Path, object: &Path) -> Result<u8, Error> {
        for (path, is_there) in [(photos, photos.is_dir()), (object, object.is_file())] {
            if !is_there {
                return Err(Error::usage(format!("there is no `{}`", path.display())));
            }
        }
        let quoted = |path: &Path| -> Result<String, Error> {
            let path = survey::relative(&self.folder, path).map_err(|e| Error::usage(e.to_string()))?;
            Ok(format!("{path:?}"))
        };
        let template = include_str!("../../../graphs/from-photos.ron");
        let text = template
            .replace("graphs/from-photos.ron --set poses.path=my-photos --set chair.path=chair.glb", GRAPH)
            .replace("\"photos\", largest", &format!("{}, largest", quoted(photos)?))
            .replace("\"chair.glb\"", &quoted(object)?);
        self.write(&text, "")?;
        let graph = self.folder.join(GRAPH);
        let graph = graph.display();
        terminal::print(&format!(
            "{graph}\nnext: `lightharmony run {graph} --only report` finds the poses with COLMAP, which must be installed\n"
        ))?;
        Ok(0)
    }

    /// Writes the graph, a `.gitignore` and a `README.md`. The last two are kept if they exist.
    fn write(&self, text: &str, made_up: &str) -> Result<(), Error> {
        let path = |name: &str| self.folder.join(name);
        let is_there = |name: &str| std::fs::symlink_metadata(path(name)).is_ok();
        let readme = format!("{README}{made_up}{HAND_ON}");
        let ignored = "# Files that runs write.\n/out/\n";
        for (name, text) in [(GRAPH, text), (".gitignore", ignored), ("README.md", &readme)] {
            if is_there(name) {
                terminal::remark(&format!("{} exists already and is kept", path(name).display()));
            } else {
                cache::publish_file(&path(name), text.as_bytes())?;
            }
        }
        Ok(())
    }
}
