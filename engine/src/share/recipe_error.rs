//! Why a recipe cannot run.

use std::path::PathBuf;

use crate::text::diag::Diagnostics;

/// Why a recipe cannot run.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// It is none, or none of this format.
    #[error("the picture carries no recipe that this program reads")]
    NoRecipe,
    /// Its graph does not parse.
    #[error(transparent)]
    Graph(#[from] Diagnostics),
    /// Files that it reads were not found, or not told apart.
    #[error("{}", .0.join("\n"))]
    Missing(Vec<String>),
    /// A folder cannot be read.
    #[error("cannot look into `{}`: {source}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}
