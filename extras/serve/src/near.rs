//! Files in the folder of the graph and in its subfolders.

use std::fs;
use std::path::{Path, PathBuf};

/// Maximum number of files that are offered.
const MOST: usize = 200;
/// Maximum number of entries of folders that are looked at.
const MOST_ENTRIES: usize = 10_000;
/// Maximum depth of the folders in which files are looked for.
const DEPTH: usize = 3;

/// The files in `folder` and in its subfolders whose names have one of the endings, in the order of their names. Links
/// and hidden files are left out, since links could lead out of the folder.
pub fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let (mut found, mut room) = (Vec::new(), MOST_ENTRIES);
    collect(folder, endings, DEPTH, &mut room, &mut found);
    found
}

/// Path relative to the folder of the graph, for display and for the text of the graph.
pub fn name(folder: &Path, path: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).to_string_lossy().replace('\\', "/")
}

fn collect(folder: &Path, endings: &[&str], depth: usize, room: &mut usize, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut paths: Vec<PathBuf> = entries.flatten().take(*room).map(|entry| entry.path()).collect();
    *room -= paths.len();
    paths.sort();
    for path in paths {
        let is_hidden = path.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'));
        if is_hidden || path.is_symlink() || found.len() >= MOST {
            continue;
        }
        let is_wanted =
            path.extension().is_some_and(|end| endings.iter().any(|known| end.eq_ignore_ascii_case(known)));
        if is_wanted && path.is_file() {
            found.push(path);
        } else if depth > 1 && path.is_dir() {
            collect(&path, endings, depth - 1, room, found);
        }
    }
}
