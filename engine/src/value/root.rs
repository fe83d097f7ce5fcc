//! Paths of the files that a graph reads. A trusted graph may read any path, an untrusted graph only certain
//! folders.

use std::fs::File;
use std::io::BufReader;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// A file that a node reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceFile {
    /// Name as written in the graph or in another source file. It enters the key, along with the digest of the
    /// content.
    pub name: String,
    /// Path on this machine.
    pub path: PathBuf,
}

/// A file that a node is about to read, for [`crate::Kind::estimate_files`].
#[derive(Debug, Clone, Copy)]
pub struct FileHead<'a> {
    /// Name as written in the graph.
    pub name: &'a str,
    /// Length in bytes.
    pub bytes: u64,
    path: &'a Path,
}

impl<'a> FileHead<'a> {
    /// A file of the given length.
    pub fn new(file: &'a SourceFile, bytes: u64) -> Self {
        Self { name: &file.name, bytes, path: &file.path }
    }

    /// Opens the file for reading; `None` if it is not a regular file or cannot be read.
    pub fn open(&self) -> Option<BufReader<File>> {
        let file = File::open(self.path).ok()?;
        file.metadata().ok()?.is_file().then(|| BufReader::new(file))
    }
}

/// Resolves the paths in a graph file.
#[derive(Debug, Clone)]
pub struct SourceRoot {
    folder: PathBuf,
    /// The folders that may be read, with links resolved; `None` if all folders may be read.
    confined: Option<Arc<[PathBuf]>>,
}

impl SourceRoot {
    /// A root for a trusted graph. Paths are relative to `folder`, the folder of the graph file.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), confined: None }
    }

    /// A root for an untrusted graph. No file outside `folder` and the folders in `also` is read, even if names or
    /// links lead there. Links inside the output folder are not followed.
    ///
    /// # Errors
    /// If one of the folders does not exist.
    pub fn confined(folder: &Path, also: &[PathBuf]) -> std::io::Result<Self> {
        let folder = folder.canonicalize()?;
        let mut allowed = vec![folder.clone()];
        for other in also {
            allowed.push(other.canonicalize()?);
        }
        Ok(Self { folder, confined: Some(allowed.into()) })
    }

    /// A root with the same permissions, for paths relative to another folder.
    pub fn at(self, folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), ..self }
    }

    /// The folder to which paths are relative.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// True if the graph is untrusted.
    pub fn is_confined(&self) -> bool {
        self.confined.is_some()
    }

    /// The source file that a parameter names.
    pub fn file(&self, file: &InputFile) -> SourceFile {
        SourceFile { name: file.0.clone(), path: self.resolve(&self.folder, &file.0) }
    }

    /// A source file that another source file refers to, such as a buffer of a glTF file. `name` is relative to the
    /// folder of `other`.
    pub fn beside(&self, other: &SourceFile, name: &str) -> SourceFile {
        let path = self.resolve(other.path.parent().unwrap_or(&self.folder), name);
        let name = match other.name.rsplit_once('/') {
            Some((folder, _)) => format!("{folder}/{name}"),
            None => name.to_owned(),
        };
        SourceFile { name, path }
    }

    fn resolve(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        let Some(allowed) = &self.confined else { return path };
        match path.canonicalize() {
            // The path without links is opened, so that the file that was checked is the file that is read.
            Ok(real) if allowed.iter().any(|folder| real.starts_with(folder)) => real,
            // A missing file, which the reader reports.
            Err(_) if Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) => path,
            _ => Path::new(OUTSIDE).join(name.replace(['/', '\\'], "_")),
        }
    }

    /// True if a file belongs to an unpacked bundle but the graph does not. Such a file is untrusted: if the graph
    /// included it, it could read every file that the graph may read.
    pub fn is_strange(&self, path: &Path) -> bool {
        // Links are followed to the folder that contains the text.
        let folder = || path.canonicalize().ok()?.parent().and_then(bundle_around);
        !self.is_confined() && folder().is_some()
    }

    /// True if `file` is outside the folders that the graph may read, so that [`SourceRoot::file`] has replaced its
    /// path.
    pub fn is_outside(&self, file: &SourceFile) -> bool {
        file.path.starts_with(OUTSIDE)
    }
}

/// A path that cannot be opened, since its first part is not a folder. The rest of the path is text that appears in
/// the error message.
const OUTSIDE: &str = "/dev/null/outside the files that this graph may read";

/// A file that a node reads: a path relative to the graph file, or absolute. The content digest of the file enters
/// the key instead of the path, so the kind must list the file in its sources.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct InputFile(pub String);

/// Name of the file that marks an unpacked bundle as untrusted.
pub(crate) const BUNDLE_MARK: &str = ".lightharmony-bundle";

/// The folder made by [`Bundle::unpack`](crate::Bundle::unpack) that is `folder` or contains `folder`. The content
/// of such a folder is untrusted. Links in the path `folder` are followed.
pub fn bundle_around(folder: &Path) -> Option<PathBuf> {
    let folder = folder.canonicalize().ok()?;
    folder
        .ancestors()
        .find(|above| std::fs::symlink_metadata(above.join(BUNDLE_MARK)).is_ok())
        .map(Path::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn nothing_leads_out_of_a_confined_root() {
        let place = tempfile::tempdir().expect("a folder");
        let at = |name: &str| place.path().join(name);
        for folder in ["in/sub", "also", "secret"] {
            std::fs::create_dir_all(at(folder)).expect("a folder");
            std::fs::write(at(folder).join("a.txt"), folder).expect("a file");
        }
        std::os::unix::fs::symlink(at("secret"), at("in/link")).expect("a link");
        std::os::unix::fs::symlink(at("secret/a.txt"), at("in/sub/link.txt")).expect("a link");
        std::os::unix::fs::symlink(at("in/sub/a.txt"), at("in/fine.txt")).expect("a link");
        let root = SourceRoot::confined(&at("in"), &[at("also")]).expect("folders that exist");
        let read = |file: &SourceFile| std::fs::read_to_string(&file.path).ok();
        let file = |name: &str| root.file(&InputFile(name.to_owned()));
        let absolute = |name: &str| at(name).to_string_lossy().into_owned();

        assert_eq!(read(&file("sub/a.txt")).as_deref(), Some("in/sub"));
        assert_eq!(read(&file("fine.txt")).as_deref(), Some("in/sub"), "a link that stays inside");
        assert_eq!(read(&file(&absolute("also/a.txt"))).as_deref(), Some("also"));
        assert_eq!(file("sub/a.txt").name, "sub/a.txt", "names, which enter keys, stay");
        for name in ["../secret/a.txt", "link/a.txt", "sub/link.txt", "sub/../../secret/a.txt", "/etc/passwd"]
        {
            assert!(root.is_outside(&file(name)) && read(&file(name)).is_none(), "{name}");
        }
        let main = file("sub/a.txt");
        for name in ["../../secret/a.txt", "link.txt", "/etc/passwd"] {
            assert_eq!(read(&root.beside(&main, name)), None, "{name}");
        }
        assert!(!root.is_outside(&file("gone.txt")) && read(&file("gone.txt")).is_none());
        let free = SourceRoot::new(at("in"));
        assert!(read(&free.file(&InputFile("../secret/a.txt".to_owned()))).is_some());
    }
}
