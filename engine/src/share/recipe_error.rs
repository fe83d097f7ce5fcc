//! The error of a recipe that cannot run.

use std::path::PathBuf;

use crate::text::diag::Diagnostics;

/// Errors when making a graph from a recipe.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// The recipe is missing or has another format.
    #[error("the picture has no recipe that this version of lightharmony can read")]
    NoRecipe,
    /// The graph of the recipe has mistakes.
    #[error(transparent)]
    Graph(#[from] Diagnostics),
    /// A node runs a program, which a picture may not do.
    #[error(
        "the graph of the picture contains `{0}`, which runs a program, so it cannot be run from the picture; run the graph file"
    )]
    Program(String),
    /// Source files were not found, or several files match. Each line describes one file.
    #[error("{}", .0.join("\n"))]
    Missing(Vec<String>),
    /// A folder cannot be read.
    #[error("cannot read the folder `{}`: {source}", folder.display())]
    Folder {
        /// Path of the folder.
        folder: PathBuf,
        /// Underlying I/O error.
        source: std::io::Error,
    },
}
