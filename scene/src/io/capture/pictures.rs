//! Pictures in a folder.

use std::collections::BTreeMap;

use engine::{InputFile, NodeError, SourceRoot};

use crate::types::Camera;
use crate::types::pick::stem;

/// Pictures of a folder, by name without extension.
pub type Listing = BTreeMap<String, InputFile>;

/// Extensions of pictures, in lower case.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "hdr"];

/// Lists the pictures of a folder.
///
/// # Errors
/// If the folder cannot be read, has no picture, or has two pictures that differ only by their extension.
pub fn listing(folder: &InputFile, root: &SourceRoot) -> Result<Listing, NodeError> {
    let failed = |e: std::io::Error| {
        NodeError::new(format!("`{}` cannot be listed: {e}", folder.0))
            .hint("give the folder of the pictures")
    };
    let mut found = Listing::new();
    for entry in std::fs::read_dir(root.file(folder).path).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        let Some(name) = name.to_str() else { continue };
        let ending = name.rsplit_once('.').map(|(_, ending)| ending.to_lowercase());
        if !ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) || name.starts_with('.') {
            continue;
        }
        let file = InputFile(format!("{}/{name}", folder.0.trim_end_matches('/')));
        if let Some(other) = found.insert(stem(name).to_owned(), file) {
            let what = format!("`{}` has two pictures named `{}`", folder.0, stem(&other.0));
            return Err(NodeError::new(what).hint("keep one of them; they differ only by their extension"));
        }
    }
    if found.is_empty() {
        return Err(NodeError::new(format!("`{}` contains no PNG, JPEG, OpenEXR or HDR file", folder.0)));
    }
    Ok(found)
}

/// The picture of a camera.
pub fn file_of<'a>(files: &'a Listing, camera: &Camera) -> Option<&'a InputFile> {
    files.get(&camera.name)
}
