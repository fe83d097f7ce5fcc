//! `init`: a folder with a first graph.

use std::path::PathBuf;

use clap::Args;

use crate::session::Error;
use crate::terminal;

/// Creates a folder with a commented graph that runs as it is.
#[derive(Debug, Args)]
pub struct Init {
    /// The folder; created if it does not exist
    #[arg(default_value = ".")]
    folder: PathBuf,
}

const GRAPH: &str = "graph.ron";

const FILES: [(&str, &str); 3] = [
    (GRAPH, include_str!("../../graphs/starter.ron")),
    (".gitignore", "# What runs write.\n/out/\n"),
    ("README.md", README),
];

const README: &str = "\
# An object in a place

    lightharmony run graph.ron          # writes out/picture.png
    lightharmony plan graph.ron         # what a run would compute, why, about how long
    lightharmony explain graph.ron save # why a node runs

Edit `graph.ron` and run it again: only what the edit reaches is computed. `lightharmony nodes` lists what a graph can
be made of, and `lightharmony nodes path-trace` describes one kind.

The scene in it is synthetic. For your own scene, read the end of `graph.ron`.

To share it: `lightharmony pack graph.ron picture.lhb`; the receiver runs `lightharmony verify picture.lhb`.
";

impl Init {
    /// Writes the files; refuses where the graph exists already. The other files are kept where they exist, since
    /// most folders of a repository have them.
    pub fn run(self) -> Result<u8, Error> {
        let path = |name: &str| self.folder.join(name);
        let is_there = |name: &str| std::fs::symlink_metadata(path(name)).is_ok();
        if is_there(GRAPH) {
            return Err(Error::usage(format!("`{}` exists already", path(GRAPH).display())));
        }
        for (name, text) in FILES {
            if is_there(name) {
                terminal::remark(&format!("{} exists already and is kept", path(name).display()));
            } else {
                cache::publish_file(&path(name), text.as_bytes())?;
            }
        }
        terminal::print(&format!("{}\n", path(GRAPH).display()))?;
        Ok(0)
    }
}
