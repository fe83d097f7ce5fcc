//! Sinks: the files a run leaves in the output folder.

use std::path::{Path, PathBuf};

use cache::{Store, publish_file};

use crate::artifact::AnyArtifact;
use crate::error::NodeError;
use crate::files::Files;
use crate::record::FileRecord;

/// Each file and whether it had to be written.
pub(crate) type Placed = Vec<(PathBuf, bool)>;

/// Makes the files of a sink lie under `out`. An equal file is left alone. `None` when bytes must be
/// written that are not in memory.
pub(crate) fn place(
    store: &Store,
    out: &Path,
    template: &str,
    files: &[FileRecord],
    value: Option<&AnyArtifact>,
) -> Result<Option<Placed>, NodeError> {
    let mut placed = Vec::with_capacity(files.len());
    if files.len() > 1 && !template.contains("{view}") {
        let views: Vec<&str> = files.iter().map(|file| file.view.as_str()).collect();
        return Err(NodeError::new(format!(
            "`{template}` names one file, there are {}: {}",
            files.len(),
            views.join(", ")
        ))
        .at("path")
        .hint("put `{view}` into the path"));
    }
    for (index, file) in files.iter().enumerate() {
        let path = out.join(template.replace("{view}", &plain_name(&file.view)));
        let equal = store.digest_file(&path).is_ok_and(|(digest, _)| digest == file.digest);
        if !equal {
            let Some(value) = value.and_then(|value| value.downcast_ref::<Files>()) else { return Ok(None) };
            write(&path, &value.0[index].bytes)?;
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

/// A view's name as part of a file name: what could lead elsewhere becomes `_`.
fn plain_name(view: &str) -> String {
    view.chars().map(|c| if c.is_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '_' }).collect()
}
