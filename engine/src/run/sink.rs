//! Writing the files of sinks to the output folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cache::{Digest, Store, publish_file};

use crate::record::record::FileRecord;
use crate::run::message::Placed;
use crate::value::artifact::AnyArtifact;
use crate::value::error::NodeError;
use crate::value::files::{Files, plain_name};

/// The output paths of a sink, each with the digest of its file.
pub(crate) fn targets(
    out: &Path,
    template: &str,
    files: &[FileRecord],
) -> Result<Vec<(PathBuf, Digest)>, NodeError> {
    if files.len() > 1 && !template.contains("{view}") {
        let views: Vec<&str> = files.iter().map(|file| file.view.as_str()).collect();
        let message = format!(
            "`{template}` names one file, but the sink writes one file for each view: {}",
            views.join(", ")
        );
        return Err(NodeError::new(message).at("path").hint("put `{view}` into the path"));
    }
    let mut seen: BTreeMap<String, &str> = BTreeMap::new();
    for file in files {
        if let Some(first) = seen.insert(plain_name(&file.view), &file.view) {
            let message = format!("the views `{first}` and `{}` give the same file name", file.view);
            return Err(NodeError::new(message).at("path"));
        }
    }
    let path = |file: &FileRecord| out.join(template.replace("{view}", &plain_name(&file.view)));
    Ok(files.iter().map(|file| (path(file), file.digest)).collect())
}

/// Returns the same as [`place`], without reading any file, if all files of a sink are known to be up to date.
/// Otherwise returns `None`.
pub(crate) fn in_place(
    store: &Store,
    targets: &[(PathBuf, Digest)],
    confined: Option<&Path>,
) -> Option<Placed> {
    let one = |(path, wanted): &(PathBuf, Digest)| {
        let equal = store.known_digest(path).is_some_and(|(digest, _)| digest == *wanted)
            && confined.is_none_or(|out| link_below(out, path).is_none());
        equal.then(|| (path.clone(), false))
    };
    targets.iter().map(one).collect()
}

/// Writes those files of a sink that are missing or differ from the result. Returns `None` if a file must be
/// written but its bytes are not in memory. If `confined` is given, a link inside that folder is an error.
pub(crate) fn place(
    store: &Store,
    targets: Vec<(PathBuf, Digest)>,
    value: Option<&AnyArtifact>,
    confined: Option<&Path>,
) -> Result<Option<Placed>, NodeError> {
    let mut placed = Vec::with_capacity(targets.len());
    for (index, (path, wanted)) in targets.into_iter().enumerate() {
        if let Some(link) = confined.and_then(|out| link_below(out, &path)) {
            let what = format!("`{}` is a link, which could lead out of the output folder", link.display());
            return Err(NodeError::new(what)
                .at("path")
                .hint("remove the link, or choose another output folder with `--out`"));
        }
        let equal = store.digest_file(&path).is_ok_and(|(digest, _)| digest == wanted);
        if !equal {
            let Some(files) = value.and_then(|value| value.downcast_ref::<Files>()) else { return Ok(None) };
            write(&path, &files.0[index].bytes)?;
        }
        placed.push((path, !equal));
    }
    Ok(Some(placed))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), NodeError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|error| {
            NodeError::new(format!("cannot create the folder `{}`: {error}", folder.display())).at("path")
        })?;
    }
    publish_file(path, bytes).map_err(|error| NodeError::from(error).at("path"))
}

/// The first link on the way from `out` to the folder of a file. The file itself is not checked: if it is a link,
/// the link is replaced and not followed.
fn link_below(out: &Path, path: &Path) -> Option<PathBuf> {
    let mut at = out.to_owned();
    for part in path.strip_prefix(out).ok()?.parent()?.components() {
        at.push(part);
        if at.is_symlink() {
            return Some(at);
        }
    }
    None
}
