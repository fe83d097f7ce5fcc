//! Paths of the files that a graph reads. A trusted graph may read any path, an untrusted graph only certain
//! folders, and an action only the files that were placed in its folder.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use cache::Digest;
use serde::{Deserialize, Serialize};

use crate::value::error::NodeError;

/// A file that a node reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceFile {
    /// Name as written in the graph or in another source file. It enters the key, along with the digest of the
    /// content.
    pub name: String,
    /// Path on this machine.
    pub path: PathBuf,
}

impl SourceFile {
    /// True if the file is an installed program from [`SourceRoot::program`], and not a file of the graph.
    pub fn is_program(&self) -> bool {
        is_program(&self.name)
    }
}

/// Advice for the user of a graph from others that runs programs.
pub(crate) const PROGRAMS_HINT: &str =
    "read the graph; if you trust it, unpack it, remove the file `.lightharmony-bundle` and run it again";

/// True if a source file with this name is a program. No file in a bundle can have such a name.
pub(crate) fn is_program(name: &str) -> bool {
    name.starts_with('<') && name.ends_with('>')
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
    reach: Reach,
    /// Digests of programs by the names of their source files, as stated by the lock of a bundle.
    programs: Option<Arc<BTreeMap<String, Digest>>>,
}

/// The files that a graph may read.
#[derive(Debug, Clone)]
enum Reach {
    Everything,
    /// The files in these folders, with links resolved.
    Folders(Arc<[PathBuf]>),
    /// The files in one folder, with names from [`staged_name`].
    Staged(Arc<Path>),
}

impl SourceRoot {
    /// A root for a trusted graph. Paths are relative to `folder`, the folder of the graph file.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), reach: Reach::Everything, programs: None }
    }

    /// A root for the source files of an action, which were placed in `folder` under their [`staged_name`]. No file
    /// outside `folder` is named.
    pub(crate) fn staged(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), reach: Reach::Staged(folder.into()), programs: None }
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
        Ok(Self { folder, reach: Reach::Folders(allowed.into()), programs: None })
    }

    /// A root with the same permissions, for paths relative to another folder.
    pub fn at(self, folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), ..self }
    }

    /// Accepts nodes that run programs in an untrusted graph, with these digests of the programs. Only results of such
    /// nodes that are already known are used; the programs never run.
    pub(crate) fn stating_programs(self, programs: BTreeMap<String, Digest>) -> Self {
        Self { programs: Some(Arc::new(programs)), ..self }
    }

    /// True if nodes that run programs are permitted in the graph.
    pub(crate) fn permits_programs(&self) -> bool {
        !self.is_confined() || self.programs.is_some()
    }

    /// The stated digest of a program.
    pub(crate) fn stated_program(&self, name: &str) -> Option<Digest> {
        self.programs.as_ref()?.get(name).copied()
    }

    /// The source file of an installed program, whose content identifies its version in the key of a node. `find`
    /// returns its path; it is not called if the graph is untrusted.
    ///
    /// # Errors
    /// If `find` fails, which is the case if the program is not installed.
    pub fn program(
        &self,
        name: &str,
        find: impl FnOnce() -> Result<PathBuf, NodeError>,
    ) -> Result<SourceFile, NodeError> {
        let path = if self.is_confined() { Path::new(OUTSIDE).join("program") } else { find()? };
        Ok(SourceFile { name: format!("<{name}>"), path })
    }

    /// The folder to which paths are relative.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// True if the graph is untrusted.
    pub fn is_confined(&self) -> bool {
        !matches!(self.reach, Reach::Everything)
    }

    /// The source file that a parameter names.
    pub fn file(&self, file: &InputFile) -> SourceFile {
        SourceFile { name: file.0.clone(), path: self.resolve(&self.folder, &file.0) }
    }

    /// A source file that another source file refers to, such as a buffer of a glTF file. `name` is relative to the
    /// folder of `other`.
    pub fn sibling(&self, other: &SourceFile, name: &str) -> SourceFile {
        let path = self.resolve(other.path.parent().unwrap_or(&self.folder), name);
        let name = match other.name.rsplit_once('/') {
            Some((folder, _)) => format!("{folder}/{name}"),
            None => name.to_owned(),
        };
        SourceFile { name, path }
    }

    fn resolve(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        let allowed = match &self.reach {
            Reach::Everything => return path,
            Reach::Folders(allowed) => allowed,
            Reach::Staged(stage) => {
                let inside = folder.strip_prefix(stage).ok().and_then(Path::to_str).unwrap_or_default();
                return stage.join(staged_name(inside, name));
            }
        };
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
    pub fn is_untrusted(&self, path: &Path) -> bool {
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

/// Folder of a stage that stands for the parent of the folder in which it is.
const ABOVE: &str = "%up";
/// Folder of a stage that stands for the root of the file system.
const ROOT: &str = "%root";

/// The path, relative to the stage of an action, of the file that a graph calls `name`. A relative name is relative
/// to `folder`, which is itself such a path. The path contains no `.` or `..`. Each step to a parent above the
/// stage is written as the placeholder folder [`ABOVE`], and the root of the file system as [`ROOT`].
pub(crate) fn staged_name(folder: &str, name: &str) -> String {
    let mut path: Vec<String> = Vec::new();
    if name.starts_with('/') {
        path.push(ROOT.to_owned());
    } else {
        path.extend(folder.split('/').filter(|part| !part.is_empty()).map(str::to_owned));
    }
    for part in name.split('/') {
        match part {
            "" | "." => {}
            ".." => match path.last().map(String::as_str) {
                Some(ROOT) => {}
                Some(ABOVE) | None => path.push(ABOVE.to_owned()),
                Some(_) => drop(path.pop()),
            },
            // No file can be mistaken for one of the two folders.
            _ if part.starts_with('%') => path.push(format!("%{part}")),
            _ => path.push(part.to_owned()),
        }
    }
    path.join("/")
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
            assert_eq!(read(&root.sibling(&main, name)), None, "{name}");
        }
        assert!(!root.is_outside(&file("gone.txt")) && read(&file("gone.txt")).is_none());
        let stage = SourceRoot::staged(&at("in"));
        for name in ["../secret/a.txt", "link/../../secret/a.txt", "/etc/passwd", "sub/../../../etc/passwd"] {
            let path = stage.file(&InputFile(name.to_owned())).path;
            assert!(path.starts_with(at("in")) && !path.exists(), "{}", path.display());
        }
        let free = SourceRoot::new(at("in"));
        assert!(read(&free.file(&InputFile("../secret/a.txt".to_owned()))).is_some());
    }

    #[test]
    fn a_staged_name_is_inside_the_stage_and_unambiguous() {
        for (folder, name, staged) in [
            ("", "a.ply", "a.ply"),
            ("", "./a//b/./c.ply", "a/b/c.ply"),
            ("", "a/../b.ply", "b.ply"),
            ("", "../a.ply", "%up/a.ply"),
            ("", "../../a.ply", "%up/%up/a.ply"),
            ("%up", "../a.ply", "%up/%up/a.ply"),
            ("%up/models", "../tex.png", "%up/tex.png"),
            ("models", "/srv/a.ply", "%root/srv/a.ply"),
            ("%root", "../../a.ply", "%root/a.ply"),
            ("", "%up/a.ply", "%%up/a.ply"),
            ("", "100%.ply", "100%.ply"),
        ] {
            assert_eq!(staged_name(folder, name), staged, "{name} in {folder}");
        }
        // A file that another file refers to has the same path, whichever way its name is read.
        let stage = SourceRoot::staged(Path::new("/stage"));
        let model = stage.file(&InputFile("../models/chair.gltf".to_owned()));
        let texture = stage.sibling(&model, "../tex/wood.png");
        assert_eq!(texture.path, stage.file(&InputFile(texture.name.clone())).path);
    }
}
