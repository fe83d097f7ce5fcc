//! The graph of the method that is scored.

use std::path::{Path, PathBuf};

use engine::GraphText;

use crate::error::Error;

/// Inputs that a graph may declare in `parameters`, each with a description.
pub const INPUTS: [(&str, &str); 10] = [
    ("rig", "the cameras of the scored views"),
    (
        "background",
        "the pictures without the object; the tier determines whether they are true or made of splats",
    ),
    ("env", "the light at the place, true or recovered"),
    ("object", "the object as in its file"),
    ("pose", "the pose of the object"),
    ("placed", "the object at its pose"),
    ("probe", "the pose of the point at which the light is captured"),
    ("mesh", "the mesh of the scene, extracted from the splats if the case has none"),
    ("splats", "the splats of the scene"),
    ("samples", "number of samples per pixel, from `--samples`"),
];

/// A graph whose node `final` makes the pictures of a method.
#[derive(Debug, Clone)]
pub struct Method {
    /// Name in the tables.
    pub name: String,
    /// Path of the graph file; `None` for the built-in graph.
    pub file: Option<PathBuf>,
    declared: Vec<&'static str>,
}

/// The built-in graph.
pub(crate) const BUILT_IN: &str = include_str!("../../graphs/bench.ron");
/// Name of the built-in graph in the tables.
const OURS: &str = "lightharmony";

impl Method {
    /// The built-in graph.
    pub fn built_in() -> Self {
        Self { name: OURS.to_owned(), file: None, declared: declared(BUILT_IN) }
    }

    /// Reads the graph in a file. Its name in the tables is the file name without extension.
    ///
    /// # Errors
    /// [`Error::Method`] if the file cannot be read, or has neither a node `final` nor includes another file.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let wrong = |why: String| Error::Method { file: file.display().to_string(), why };
        let text =
            engine::read_text(file, engine::MAX_GRAPH_BYTES).map_err(|error| wrong(error.to_string()))?;
        let absolute = file.canonicalize().map_err(|error| wrong(error.to_string()))?;
        let graph = GraphText::new(&text);
        // An included file may have the node; if it does not, the check of the whole graph reports it.
        if graph.node("final").is_none() && !text.contains("include") {
            return Err(wrong(
                "it has no node `final`; give this name to the node that makes the finished pictures"
                    .to_owned(),
            ));
        }
        let name = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self { name, file: Some(absolute), declared: declared(&text) })
    }

    /// True if the graph declares this input.
    pub fn takes(&self, input: &str) -> bool {
        self.declared.contains(&input)
    }
}

/// The inputs that a graph declares.
fn declared(text: &str) -> Vec<&'static str> {
    let graph = GraphText::new(text);
    INPUTS.iter().map(|(name, _)| *name).filter(|name| graph.field("parameters", name).is_some()).collect()
}
