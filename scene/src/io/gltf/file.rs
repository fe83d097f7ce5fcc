//! A parsed glTF file.

use gltf::Document;
use serde_json::Value;

/// A parsed file whose indices are all in range.
pub struct File {
    pub(super) name: String,
    /// The checked document.
    pub document: Document,
    /// The document as plain JSON, for extensions.
    pub json: Value,
    pub(super) blob: Option<Vec<u8>>,
}
