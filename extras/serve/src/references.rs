//! Picture files near the graph, with which outputs can be compared.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::UNIX_EPOCH;

use cache::Digest;
use scene::io::picture::of_bytes;
use scene::types::NamedImage;
use serde::Serialize;

use crate::near;
use crate::values::Shown;

/// Endings of the names of files that are offered.
const ENDINGS: [&str; 5] = ["exr", "hdr", "jpeg", "jpg", "png"];
/// Maximum length of a file that is read, in bytes.
const MOST_BYTES: u64 = 1 << 30;

/// A picture file that is offered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Reference {
    /// Handle in the form of the digest of a value. It changes when the file changes.
    id: String,
    /// Path relative to the folder of the graph.
    name: String,
}

/// The files that were offered, by their handles. A client names a file by its handle, so a request cannot contain a
/// path.
#[derive(Default)]
pub struct References(Mutex<BTreeMap<Digest, PathBuf>>);

impl References {
    /// Lists the picture files in `folder` and in its subfolders, in the order of their names.
    pub fn list(&self, folder: &Path) -> Vec<Reference> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.clear();
        let offer = |path: PathBuf| {
            let id = handle(&path)?;
            let name = near::name(folder, &path);
            known.insert(id, path);
            Some(Reference { id: id.to_string(), name })
        };
        near::files(folder, &ENDINGS).into_iter().filter_map(offer).collect()
    }

    /// True if a file was offered under this handle.
    pub fn contains(&self, id: &Digest) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).contains_key(id)
    }

    /// Reads the file with this handle. `None` if it was not offered, has changed since then, or is damaged.
    pub fn read(&self, id: &Digest) -> Option<Shown> {
        let path = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(id).cloned()?;
        if handle(&path)? != *id {
            return None;
        }
        let name = path.file_stem()?.to_string_lossy().into_owned();
        let picture = of_bytes(&path.to_string_lossy(), &fs::read(&path).ok()?).ok()?;
        Some(Shown { pictures: vec![NamedImage { name, picture }], report: None })
    }
}

/// The handle of a file: a digest of its path, length and time of change. `None` if it cannot be read or is too long.
fn handle(path: &Path) -> Option<Digest> {
    // Links could lead out of the folder.
    let about =
        fs::symlink_metadata(path).ok().filter(|about| about.is_file() && about.len() <= MOST_BYTES)?;
    let changed = about.modified().ok()?.duration_since(UNIX_EPOCH).ok()?.as_nanos();
    Some(Digest::of(format!("{}\n{}\n{changed}", path.display(), about.len()).as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_offered_by_handles_that_follow_their_content() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("a/b/c"))?;
        let codes = vec![7, 8, 9];
        let raster = scene::io::png::Raster {
            width: 1,
            height: 1,
            channels: 3,
            largest: 255,
            codes,
            colour: None,
            ignored: Vec::new(),
        };
        let png = scene::io::png::write(&raster, true, &[]).unwrap_or_default();
        for name in ["truth.png", "a/b/deep.PNG", "a/b/c/deeper.png", ".hidden.png", "notes.txt"] {
            fs::write(at(name), &png)?;
        }
        #[cfg(unix)]
        std::os::unix::fs::symlink(at("truth.png"), at("link.png"))?;
        let references = References::default();
        let names = |list: &[Reference]| list.iter().map(|one| one.name.clone()).collect::<Vec<_>>();
        let list = references.list(folder.path());
        assert_eq!(names(&list), ["a/b/deep.PNG", "truth.png"]);
        let id = Digest::from_hex(&list[1].id).unwrap_or_else(|| Digest::of(b""));
        assert!(
            references.contains(&id) && references.read(&id).is_some_and(|shown| shown.pictures.len() == 1)
        );
        assert!(references.read(&Digest::of(b"other")).is_none());
        // A file that has changed has another handle.
        fs::write(at("truth.png"), [&png[..], b"x"].concat())?;
        assert!(references.read(&id).is_none());
        assert_ne!(references.list(folder.path())[1].id, list[1].id);
        Ok(())
    }
}
