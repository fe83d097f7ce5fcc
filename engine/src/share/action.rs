//! Writes the action folder of a node of a graph.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use cache::{Digest, publish_file};

use crate::graph::graph::Graph;
use crate::graph::node::Wire;
use crate::graph::surroundings::Surroundings;
use crate::plan::plan::{Fate, Outlook};
use crate::remote::action_file::{self, ActionFile, BLOBS, FILES};
use crate::remote::error::ActionError;
use crate::run::engine::Engine;
use crate::value::root::staged_name;

impl Engine {
    /// Creates the action folder `folder`, which contains everything that the code of a node reads, so that another
    /// process or machine can compute the node; see [`run_action`](Self::run_action). The results of its input
    /// nodes must be known. Returns the key of the node.
    ///
    /// # Errors
    /// If the node runs a program, if an input is not known or its value is not available, if two source files would have the same path in the
    /// folder, or if a file cannot be read or written.
    pub fn write_action(&self, graph: &Graph, index: usize, folder: &Path) -> Result<Digest, ActionError> {
        let node = &graph.nodes[index];
        if node.kind.runs_programs {
            return Err(ActionError::Program { kind: node.kind.name.to_owned() });
        }
        let unsuitable = |why: String| ActionError::Unsuitable { node: node.id.clone(), why };
        let mut outlook = Outlook::new(self, graph);
        let needed = graph.above(&[index]);
        let mut fate = Fate::Unwanted;
        for &above in graph.order().iter().filter(|&&above| needed[above]) {
            fate = outlook.fate(above);
            if above == index {
                break;
            }
        }
        match fate {
            Fate::Follows(input) => {
                return Err(unsuitable(format!(
                    "the result of `{input}`, which the node reads, is not known"
                )));
            }
            Fate::Fails(why) => return Err(unsuitable(why)),
            _ => {}
        }
        let record = |wire: Wire| outlook.records[wire.node].as_ref().expect("the inputs are known");
        let output = |wire: Wire| &record(wire).outputs[wire.port];
        let action = &outlook.actions[index];
        let around = Surroundings::of(graph, index, action.recipe.clone());
        let file = ActionFile::of(node, &around, output, action);

        // By path in the folder.
        let mut files: BTreeMap<String, Digest> = BTreeMap::new();
        for source in &action.sources {
            let name = staged_name("", &source.file.name);
            let known = files.insert(name.clone(), source.digest);
            if known.is_some_and(|known| known != source.digest) {
                return Err(unsuitable(format!(
                    "the node reads two different files with the name `{name}`, whose paths differ only in a link or `..`"
                )));
            }
        }
        let (blobs, stage) = (folder.join(BLOBS), folder.join(FILES));
        for (above, folder) in [(true, folder), (false, &blobs), (false, &stage)] {
            let create = if above { fs::create_dir_all } else { fs::create_dir };
            if above && folder.exists() {
                let exists = std::io::ErrorKind::AlreadyExists.into();
                return Err(ActionError::io("create", folder)(exists));
            }
            create(folder).map_err(ActionError::io("create", folder))?;
        }
        for &wire in node.inputs.iter().flatten() {
            let path = blobs.join(output(wire).digest.to_string());
            if !path.exists() {
                let bytes = self.encoded(graph, wire, output(wire)).ok_or_else(|| {
                    let input = &graph.nodes[wire.node].id;
                    unsuitable(format!("the value of `{input}`, which the node reads, is not available"))
                })?;
                publish_file(&path, &bytes)?;
            }
        }
        for source in &action.sources {
            let to = stage.join(staged_name("", &source.file.name));
            fs::create_dir_all(to.parent().unwrap_or(&stage)).map_err(ActionError::io("create", &to))?;
            fs::copy(&source.file.path, &to).map_err(ActionError::io("copy", &source.file.path))?;
        }
        // Last, so that a folder with an action file is complete.
        publish_file(&folder.join(action_file::NAME), file.text().as_bytes())?;
        Ok(file.key.0)
    }
}
