//! The installed OpenColorIO: a Python with its package.

use std::path::PathBuf;

use engine::{NodeError, SourceRoot};

use crate::program::{find, library_of};

/// Code that prints the path of the compiled part of the package, without loading it.
const LOCATE: &str = "import importlib.util, glob, os; found = importlib.util.find_spec('PyOpenColorIO'); \
                      folder = os.path.dirname(found.origin) if found and found.origin else ''; \
                      print((sorted(glob.glob(os.path.join(folder, '*OpenColorIO*.*')), \
                      key=lambda path: 'libOpenColorIO' not in path) or [found.origin])[0] if folder else '')";

const INSTALL: &str = "install its Python package (`pip install opencolorio`), or set `program` to a Python that has it, such as \
                       `program: Some(\"venv/bin/python\")`";

/// A Python with OpenColorIO.
pub(super) struct Tool {
    /// The Python.
    pub(super) python: PathBuf,
    /// The file whose content identifies the version of OpenColorIO.
    pub(super) identity: PathBuf,
}

impl Tool {
    /// Finds the Python that the graph states, or else `python3`, and its package.
    ///
    /// # Errors
    /// If one of them is not installed. The hint describes how to install it.
    pub(super) fn find(program: Option<&str>, root: &SourceRoot) -> Result<Self, NodeError> {
        let failed = |what: String| NodeError::new(what).at("program").hint(INSTALL);
        let name = program.unwrap_or("python3");
        let python = find(name, root.folder()).map_err(|error| failed(error.to_string()))?;
        // Another program stands in for Python.
        if !name.rsplit(['/', '\\']).next().is_some_and(|file| file.starts_with("python")) {
            return Ok(Self { identity: python.clone(), python });
        }
        match library_of(&python, LOCATE) {
            Some(identity) => Ok(Self { python, identity }),
            None => Err(failed(format!("`{name}` has no package `opencolorio`"))),
        }
    }
}
