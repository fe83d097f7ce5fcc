//! Obstacles: anything of the wrong type at the path of a file or folder of the cache, such as a folder named
//! `records.log`. Obstacles are moved to the quarantine, so that the next run works as in a cache without them.

use std::fs;
use std::io;
use std::path::Path;

use crate::log_head::fresh_salt;
use crate::regular::is_broken_link;
use crate::settings::Incident;

/// The folder that obstacles and damaged blobs are moved to. Every collection empties it.
pub(crate) const QUARANTINE: &str = "quarantine";

const FOLDERS: [&str; 5] = ["temp", "blobs", "leases", "pins", "last"];

const FILES: [&str; 7] =
    ["records.log", "records.lock", "records.index", "blobs.log", "blobs.lock", "blobs.index", "runs.lock"];

/// Moves every obstacle directly below `root` to the quarantine, and returns a report of each.
///
/// A link to a file or folder of the expected type is not an obstacle. A dangling link is an obstacle, because no
/// file may be created at its target.
pub(crate) fn clear_all(root: &Path) -> Vec<Incident> {
    // The quarantine itself comes first: nothing can be moved there before it is a folder.
    let quarantine = root.join(QUARANTINE);
    let mut found = Vec::new();
    if is_obstacle(&quarantine, fs::Metadata::is_dir) && fs::remove_file(&quarantine).is_ok() {
        let what = format!("{} was not a folder and was removed", quarantine.display());
        found.push(Incident { digest: None, what });
    }
    found.extend(FOLDERS.iter().filter_map(|name| clear(root, &root.join(name), Expected::Folder)));
    found.extend(FILES.iter().filter_map(|name| clear(root, &root.join(name), Expected::File)));
    found
}

/// The type of file-system object that is expected at a path.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Expected {
    File,
    Folder,
}

/// If there is an object at `path` that is not of the type `expected`, moves it to the quarantine of `root` and
/// returns a report.
pub(crate) fn clear(root: &Path, path: &Path, expected: Expected) -> Option<Incident> {
    let (name, right): (_, fn(&fs::Metadata) -> bool) = match expected {
        Expected::File => ("file", fs::Metadata::is_file),
        Expected::Folder => ("folder", fs::Metadata::is_dir),
    };
    if !is_obstacle(path, right) {
        return None;
    }
    let outcome = quarantine(root, path).ok()?;
    Some(Incident { digest: None, what: format!("{} is not a {name} and was {outcome}", path.display()) })
}

/// If there is a folder at `path`, moves it to the quarantine of `root`, because no file can be renamed to the path
/// of a folder.
pub(crate) fn clear_folder(root: &Path, path: &Path) {
    if fs::symlink_metadata(path).is_ok_and(|found| found.is_dir()) {
        let _ = quarantine(root, path);
    }
}

/// True if an object exists at `path` and `right` returns false for its metadata, or if `path` is a dangling link.
/// A link is judged by the metadata of its target.
fn is_obstacle(path: &Path, right: fn(&fs::Metadata) -> bool) -> bool {
    match fs::metadata(path) {
        Ok(found) => !right(&found),
        Err(error) => is_broken_link(path, &error),
    }
}

/// Moves an object of any type at `path` to the quarantine, or removes it if it cannot be moved. A link is moved,
/// not followed. Returns a description of the action.
fn quarantine(root: &Path, path: &Path) -> io::Result<String> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let target = root.join(QUARANTINE).join(format!("{name}.{:08x}", fresh_salt()));
    let moved = fs::create_dir_all(root.join(QUARANTINE)).and_then(|()| fs::rename(path, &target));
    match moved {
        Ok(()) => Ok(format!("moved to {}", target.display())),
        Err(_) => fs::remove_file(path).or_else(|_| fs::remove_dir_all(path)).map(|()| "removed".to_owned()),
    }
}
