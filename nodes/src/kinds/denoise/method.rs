//! Who filters, as a graph file says it.

use engine::{NodeError, Notes, ParamType, Role, SourceFile};
use serde::{Deserialize, Serialize};

use super::oidn;

/// Who filters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    /// This program: every pixel becomes the mean of those that look the same. The same bytes everywhere.
    Means,
    /// Open Image Denoise 2, of a build with the feature `oidn`, where it is installed. Its version counts as a file
    /// that is read; another processor may give other bytes.
    Oidn,
}

impl Method {
    pub(super) fn check(self) -> Result<(), NodeError> {
        self.sources().map(|_| ())
    }

    /// The library, which tells its version, is a file that the node reads.
    pub(super) fn sources(self) -> Result<Vec<SourceFile>, NodeError> {
        match self {
            Self::Means => Ok(Vec::new()),
            Self::Oidn => oidn::sources(),
        }
    }

    /// Memory beyond that of the layers.
    pub(super) fn bytes(self, pixels: usize) -> u64 {
        match self {
            Self::Means => 0,
            Self::Oidn => oidn::bytes(pixels),
        }
    }

    pub(super) fn tell(self, notes: &mut Notes) -> Result<(), NodeError> {
        match self {
            Self::Means => Ok(()),
            Self::Oidn => oidn::tell(notes),
        }
    }
}

impl ParamType for Method {
    // `Oidn` reads a file, although no path names it.
    const ROLE: Role = Role::Input;

    fn describe() -> String {
        "Means | Oidn".to_owned()
    }
}
