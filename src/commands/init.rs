//! `init`: a folder to begin in.

use std::path::PathBuf;

use clap::Args;

use crate::session::Error;
use crate::terminal;

/// Makes a folder with a graph that runs as it is, and is made to be edited.
#[derive(Debug, Args)]
pub struct Init {
    /// The folder; made if it is not there
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

The scene in it is made up. For your own, read the end of `graph.ron`.

To hand it on: `lightharmony pack graph.ron picture.lhb`; whoever gets it runs `lightharmony verify picture.lhb`.
";

impl Init {
    /// Writes the files; refuses where the graph is there already. Of the others, one that is there stays as it is: most
    /// folders of a repository have them.
    pub fn run(self) -> Result<u8, Error> {
        let path = |name: &str| self.folder.join(name);
        let is_there = |name: &str| std::fs::symlink_metadata(path(name)).is_ok();
        if is_there(GRAPH) {
            return Err(Error::usage(format!("`{}` exists already", path(GRAPH).display())));
        }
        for (name, text) in FILES {
            if is_there(name) {
                terminal::remark(&format!("{} is there already and stays as it is", path(name).display()));
            } else {
                cache::publish_file(&path(name), text.as_bytes())?;
            }
        }
        terminal::print(&format!("{}\n", path(GRAPH).display()))?;
        Ok(0)
    }
}
