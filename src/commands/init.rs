//! `init`: a folder to begin in.

use std::path::PathBuf;

use clap::Args;

use crate::session::Error;

/// Makes a folder with a graph that runs as it is, and is made to be edited.
#[derive(Debug, Args)]
pub struct Init {
    /// The folder; made if it is not there
    #[arg(default_value = ".")]
    folder: PathBuf,
}

const FILES: [(&str, &str); 3] = [
    ("graph.ron", include_str!("../../graphs/starter.ron")),
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
    /// Writes the files; refuses where one of them is there already.
    pub fn run(self) -> Result<u8, Error> {
        let path = |name: &str| self.folder.join(name);
        if let Some((name, _)) = FILES.iter().find(|(name, _)| std::fs::symlink_metadata(path(name)).is_ok())
        {
            return Err(Error::Exists(path(name)));
        }
        for (name, text) in FILES {
            cache::publish_file(&path(name), text.as_bytes())?;
        }
        super::print(&format!("{}\n", path("graph.ron").display()))?;
        Ok(0)
    }
}
