//! The installed COLMAP: its program, or the Python package `pycolmap`.

use std::path::PathBuf;

use engine::{NodeError, SourceRoot};

use crate::program::{find, library_of};

/// An installed COLMAP.
#[derive(Debug, Clone)]
pub enum Tool {
    /// The program `colmap`.
    Program(PathBuf),
    /// A Python with the package `pycolmap`.
    Python {
        /// The Python.
        python: PathBuf,
        /// The compiled part of the package, whose content identifies its version.
        library: PathBuf,
    },
}

/// Code that prints the path of the compiled part of `pycolmap`, without loading it.
const LOCATE: &str = "import importlib.util, glob, os; found = importlib.util.find_spec('pycolmap'); \
                      folder = os.path.dirname(found.origin) if found and found.origin else ''; \
                      print((sorted(glob.glob(os.path.join(folder, '_core*.*')) + \
                      glob.glob(os.path.join(folder, 'pycolmap*.so'))) or [found.origin])[0] if folder else '')";

const INSTALL: &str = "install COLMAP (Debian and Ubuntu: `apt install colmap`; macOS: `brew install colmap`; others: \
                       https://colmap.github.io/install.html), or the Python package (`pip install pycolmap`); or set \
                       `program` to its path";

impl Tool {
    /// Finds the program that the graph states, or else `colmap`, or else `pycolmap`.
    ///
    /// # Errors
    /// If it is not installed. The hint describes how to install it.
    pub fn find(program: Option<&str>, root: &SourceRoot) -> Result<Self, NodeError> {
        let failed = |what: String| Err(NodeError::new(what).at("program").hint(INSTALL));
        match program {
            Some(name) => {
                let path = match find(name, root.folder()) {
                    Ok(path) => path,
                    Err(error) => return failed(error.to_string()),
                };
                let is_python =
                    name.rsplit(['/', '\\']).next().is_some_and(|file| file.starts_with("python"));
                if !is_python {
                    return Ok(Self::Program(path));
                }
                match library_of(&path, LOCATE) {
                    Some(library) => Ok(Self::Python { python: path, library }),
                    None => failed(format!("`{name}` has no package `pycolmap`")),
                }
            }
            None => {
                if let Ok(path) = find("colmap", root.folder()) {
                    return Ok(Self::Program(path));
                }
                let python = find("python3", root.folder()).ok();
                match python.and_then(|python| Some((library_of(&python, LOCATE)?, python))) {
                    Some((library, python)) => Ok(Self::Python { python, library }),
                    None => failed(
                        "COLMAP is not installed: neither the program `colmap` nor the Python package `pycolmap` was found"
                            .to_owned(),
                    ),
                }
            }
        }
    }

    /// The file whose content identifies the version.
    pub fn identity(self) -> PathBuf {
        match self {
            Self::Program(path) | Self::Python { library: path, .. } => path,
        }
    }
}
