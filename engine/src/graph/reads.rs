//! The files that contain a graph, and the files that it reads. No sink may write to them.

use std::collections::{BTreeSet, HashMap};
use std::path::{Component, Path, PathBuf};

use crate::graph::graph::Graph;
use crate::text::diag::{Code, Diagnostic, Diagnostics};

/// A set of files, compared by their location after links are resolved.
#[derive(Debug, Clone, Default)]
pub struct ReadFiles(BTreeSet<PathBuf>);

impl ReadFiles {
    /// Creates a set of the given files, which need not exist.
    pub fn new(files: impl IntoIterator<Item = PathBuf>) -> Self {
        let (mut places, mut folders) = (BTreeSet::new(), HashMap::new());
        for file in files {
            places.extend(places_of(&file, &mut folders));
        }
        Self(places)
    }

    /// True if writing to `path` would change one of the files. This is the case if `path` is the file, a link to
    /// it, or the link by which the file was named when it was added to the set.
    pub fn has(&self, path: &Path) -> bool {
        !self.0.is_empty() && places_of(path, &mut HashMap::new()).any(|place| self.0.contains(&place))
    }
}

/// The locations of a path. These are the path itself, with the links in its folder resolved, and its target if it
/// is a link. `folders` caches the resolved folders.
fn places_of(path: &Path, folders: &mut HashMap<PathBuf, PathBuf>) -> impl Iterator<Item = PathBuf> + use<> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folders.contains_key(folder) {
        folders.insert(folder.to_owned(), folder.canonicalize().unwrap_or_else(|_| in_steps(folder)));
    }
    let place = folders[folder].join(path.file_name().unwrap_or_default());
    let end = if place.is_symlink() { place.canonicalize().ok() } else { None };
    [Some(place), end].into_iter().flatten()
}

/// Resolves the links in the path of a folder that may not exist. Parts of the path that do not exist are kept as
/// they are.
fn in_steps(folder: &Path) -> PathBuf {
    let mut at = PathBuf::new();
    for part in std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()).components() {
        if part == Component::ParentDir {
            at.pop();
        } else {
            at.push(part);
            at = at.canonicalize().unwrap_or(at);
        }
    }
    at
}

impl Graph {
    /// Rejects sinks that would overwrite a file of the graph itself (one of `texts`) or a file that a parameter
    /// names. `only` contains the targets of the run. Other conflicts, such as with a file that a source file
    /// refers to, are found during the run.
    ///
    /// # Errors
    /// A diagnostic for each of these sinks.
    pub fn check_outputs(&self, only: &[usize], out: &Path, texts: &[PathBuf]) -> Result<(), Diagnostics> {
        let wanted = if only.is_empty() { self.targets() } else { only.to_vec() };
        let sinks: Vec<(usize, PathBuf)> = wanted
            .into_iter()
            .filter_map(|index| Some((index, out.join(self.nodes[index].sink_path.as_ref()?))))
            .collect();
        if sinks.is_empty() {
            return Ok(());
        }
        let read = ReadFiles::new(texts.iter().cloned().chain(self.named_files()));
        let over = sinks.into_iter().filter(|(_, path)| read.has(path));
        let mistakes: Vec<Diagnostic> = over
            .map(|(index, path)| {
                Diagnostic::of(Code::OutputPath, self.nodes[index].place(Some("path")), over_text(&path))
                    .label(format!("`{}`", self.nodes[index].id))
                    .hint(OTHER_FILE)
            })
            .collect();
        if mistakes.is_empty() { Ok(()) } else { Err(Diagnostics::new(self.source.clone(), mistakes)) }
    }
}

/// The message for a sink that would overwrite `path`.
pub(crate) fn over_text(path: &Path) -> String {
    format!("this sink would overwrite {}, which the graph reads", path.display())
}

/// The hint for a sink that would overwrite a file of the graph.
pub(crate) const OTHER_FILE: &str = "choose another file, or another folder with `--out`";

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_file_is_known_whatever_way_leads_there() {
        let place = tempfile::tempdir().expect("a folder");
        let at = |name: &str| place.path().join(name);
        std::fs::create_dir_all(at("in/sub")).expect("a folder");
        for name in ["in/a.png", "in/b.png", "other.png"] {
            std::fs::write(at(name), "x").expect("a file");
        }
        let link = |to: &str, name: &str| std::os::unix::fs::symlink(at(to), at(name)).expect("a link");
        link("in", "way");
        link("in/a.png", "link.png");
        link("in/b.png", "read.png");
        let read = ReadFiles::new([at("in/a.png"), at("read.png"), at("gone/x.png")]);
        for name in [
            "in/a.png",
            "in/./a.png",
            "in/sub/../a.png",
            "way/a.png",
            "link.png",
            "read.png",
            "in/b.png",
            "gone/x.png",
            "no/../in/a.png",
            "way/no/./../a.png",
        ] {
            assert!(read.has(&at(name)), "{name}");
        }
        for name in ["other.png", "in/c.png", "a.png", "in/sub/a.png", "gone/y.png"] {
            assert!(!read.has(&at(name)), "{name}");
        }
        assert!(!ReadFiles::new([]).has(&at("in/a.png")));
    }
}
