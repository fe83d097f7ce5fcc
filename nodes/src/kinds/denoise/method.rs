//! Denoising methods, as written in a graph file.

use engine::{NodeError, Notes, ParamType, Role, SourceFile};
use serde::{Deserialize, Serialize};

use super::oidn;

/// Denoising method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    /// Non-local means, built in: every pixel becomes the mean of pixels that look similar. Gives the same bytes
    /// on every machine.
    Means,
    /// Open Image Denoise 2, if it is installed. Its version is part of the cache key, like a source file. Another
    /// processor may give different bytes.
    Oidn,
}

impl Method {
    pub(super) fn check(self) -> Result<(), NodeError> {
        self.sources().map(|_| ())
    }

    /// Source files of the method. For `Oidn`, the only source file is the library, whose content identifies its
    /// version.
    pub(super) fn sources(self) -> Result<Vec<SourceFile>, NodeError> {
        match self {
            Self::Means => Ok(Vec::new()),
            Self::Oidn => oidn::sources(),
        }
    }

    /// Memory that the method needs in addition to the layers, in bytes, for layers of `pixels` pixels.
    pub(super) fn bytes(self, pixels: usize) -> u64 {
        match self {
            Self::Means => 0,
            Self::Oidn => oidn::bytes(pixels),
        }
    }

    pub(super) fn report(self, notes: &mut Notes) -> Result<(), NodeError> {
        match self {
            Self::Means => Ok(()),
            Self::Oidn => oidn::report(notes),
        }
    }
}

impl ParamType for Method {
    // `Oidn` reads a file although no parameter names it.
    const ROLE: Role = Role::Input;

    fn describe() -> String {
        "Means | Oidn".to_owned()
    }

    fn choices() -> Vec<(&'static str, &'static str)> {
        vec![
            (
                "Means",
                "Non-local means, built in: every pixel becomes the mean of pixels that look similar. Gives the same \
                 bytes on every machine.",
            ),
            ("Oidn", "Open Image Denoise 2, if it is installed. Another processor may give different bytes."),
        ]
    }
}
