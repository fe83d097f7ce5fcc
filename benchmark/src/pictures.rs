//! Pictures of other methods: a folder per method, in it a folder per case, in it a picture per view.

use std::path::{Path, PathBuf};

use crate::error::{Error, Mistakes};
use crate::fields::is_name;
use crate::set::Set;

/// Pictures of another method.
#[derive(Debug, Clone, PartialEq)]
pub struct Given {
    /// Name of the method, which is the name of its folder.
    pub name: String,
    /// For each case of the set, the path of each view. `None` for a case of which pictures are missing.
    pub cases: Vec<Option<Vec<PathBuf>>>,
    /// The missing pictures as `CASE/VIEW.png`.
    pub missing: Vec<String>,
}

/// Reads the names of methods and the headers of their pictures.
///
/// # Errors
/// [`Error::Pictures`] if the folder has no method, if a method has no picture of the set, if the name of a method is
/// taken, or if the size of a picture differs from the truth.
pub fn given(folder: &Path, set: &Set, taken: &[&str]) -> Result<Vec<Given>, Error> {
    let mut mistakes = Mistakes::default();
    let whole = |mistakes| Error::Pictures { folder: folder.display().to_string(), mistakes };
    let mut names = Vec::new();
    // The paths of the graph are relative to its own folder.
    let folder = &folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    match std::fs::read_dir(folder) {
        Ok(entries) => {
            let folders = entries.filter_map(Result::ok).filter(|entry| entry.path().is_dir());
            names.extend(folders.map(|entry| entry.file_name().to_string_lossy().into_owned()));
        }
        Err(error) => mistakes.add(".", "", format!("cannot be read: {error}")),
    }
    names.sort();
    if names.is_empty() && mistakes.0.is_empty() {
        mistakes.add(".", "", "has no folder of a method; pictures are METHOD/CASE/VIEW.png");
    }
    let mut all = Vec::new();
    for name in names {
        if !is_name(&name) || taken.contains(&name.as_str()) {
            let why = "cannot be the name of a method: it must begin with a letter, consist of ASCII letters, digits, `-` and `_`, and differ from";
            mistakes.add(&name, "", format!("{why} {}; rename the folder", taken.join(", ")));
            continue;
        }
        let (mut cases, mut missing) = (Vec::new(), Vec::new());
        for case in &set.cases {
            let mut paths = Vec::new();
            for view in &case.views {
                let short = format!("{}/{}.png", case.name, view.name);
                let path = folder.join(&name).join(&case.name).join(format!("{}.png", view.name));
                match scene::io::picture::size(&path) {
                    _ if !path.is_file() => missing.push(short),
                    None => mistakes.add(
                        &format!("{name}/{short}"),
                        "",
                        "is not a picture, or its header is damaged",
                    ),
                    Some(size) if size != view.size => {
                        let ([w, h], [width, height]) = (size, view.size);
                        let text = format!("has {w}x{h} pixels, but the truth has {width}x{height}");
                        mistakes.add(&format!("{name}/{short}"), "", text);
                    }
                    Some(_) => paths.push(path),
                }
            }
            cases.push(Some(paths).filter(|paths| paths.len() == case.views.len()));
        }
        if cases.iter().all(Option::is_none) && mistakes.0.is_empty() {
            let text = "has no case with pictures of all views; they are METHOD/CASE/VIEW.png";
            mistakes.add(&name, "", text);
        }
        all.push(Given { name, cases, missing });
    }
    if mistakes.0.is_empty() { Ok(all) } else { Err(whole(mistakes)) }
}
