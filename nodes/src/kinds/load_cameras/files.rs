//! Files to which the parameter `path` refers.

use std::collections::BTreeSet;
use std::io::Read;

use engine::{InputFile, NodeError, SourceFile, SourceRoot};
use scene::error::Error;
use scene::io::foreign::refuse_foreign;
use scene::io::picture;

use super::json;

/// Maximum size in bytes of files that are read before the run, to count their cameras or to find their pictures.
pub const READ_MOST: u64 = 256 << 20;

/// The JSON file, and the pictures that must be read because the file does not contain their sizes.
pub fn with_pictures(file: SourceFile, root: &SourceRoot) -> Vec<SourceFile> {
    let read = || engine::read_at_most(&file.path, READ_MOST).ok();
    let names: BTreeSet<String> =
        read().iter().flat_map(|bytes| json::pictures_without_size(bytes)).collect();
    let mut files: Vec<SourceFile> = names.iter().filter_map(|name| existing(&file, name, root)).collect();
    files.insert(0, file);
    files
}

/// Finds the file of a picture whose path is relative to the cameras file. The path may lack the extension, as it
/// does in the synthetic scenes of NeRF. `None` if there is no such file.
pub fn existing(file: &SourceFile, picture: &str, root: &SourceRoot) -> Option<SourceFile> {
    ["", ".png", ".jpg", ".jpeg", ".JPG", ".PNG"]
        .iter()
        .map(|ending| root.sibling(file, &format!("{picture}{ending}")))
        .find(|source| source.path.is_file())
}

/// Width and height of a picture. If it cannot be read, the error is the end of a sentence that begins with the
/// picture.
pub fn size_of(picture: Option<SourceFile>) -> Result<[u64; 2], String> {
    let Some(source) = picture else { return Err("does not exist".to_owned()) };
    if let Some(size) = picture::size(&source.path) {
        return Ok(size);
    }
    let mut head = Vec::new();
    let opened = std::fs::File::open(&source.path).and_then(|file| file.take(4096).read_to_end(&mut head));
    match opened.map(|_| refuse_foreign(&source.name, &head)) {
        Ok(Err(Error::Unsupported { feature, .. })) => Err(format!("is not supported: {feature}")),
        _ => Err("cannot be read".to_owned()),
    }
}

/// True if the name of a file is that of JSON.
pub fn is_json(path: &InputFile) -> bool {
    path.0.to_lowercase().ends_with(".json")
}

/// The JSON file of cameras that a path stands for: the file itself, or a `transforms.json` or `cameras.json` in
/// its folder. `None` for other formats, and if there is no such file.
pub fn json_file(path: &InputFile, root: &SourceRoot) -> Option<InputFile> {
    if is_json(path) {
        return Some(path.clone());
    }
    if is_gltf(path) {
        return None;
    }
    let [file] = <[InputFile; 1]>::try_from(files(path, root).ok()?).ok()?;
    Some(file)
}

/// True if the name of a file is that of glTF.
pub fn is_gltf(path: &InputFile) -> bool {
    let lower = path.0.to_lowercase();
    lower.ends_with(".glb") || lower.ends_with(".gltf")
}

/// Sets of files that a path may stand for if it is not the path of a JSON file, in order of preference.
fn candidates(path: &InputFile) -> Vec<Vec<InputFile>> {
    let folder = match path.0.rsplit_once('/') {
        Some((folder, file)) if is_part(file) => folder,
        None if is_part(&path.0) => ".",
        _ => path.0.trim_end_matches('/'),
    };
    let file = |name: String| InputFile(format!("{folder}/{name}"));
    let mut candidates = Vec::new();
    // The last one is the layout of nerfstudio.
    for inner in ["", "sparse/0/", "sparse/", "colmap/sparse/0/"] {
        for ending in ["bin", "txt"] {
            candidates.push(vec![
                file(format!("{inner}cameras.{ending}")),
                file(format!("{inner}images.{ending}")),
            ]);
        }
    }
    candidates.extend(["transforms.json", "cameras.json"].map(|name| vec![file(name.to_owned())]));
    candidates
}

/// The first element of [`candidates`] whose files all exist.
pub fn files(path: &InputFile, root: &SourceRoot) -> Result<Vec<InputFile>, NodeError> {
    let there = |files: &Vec<InputFile>| files.iter().all(|file| root.file(file).path.is_file());
    candidates(path).into_iter().find(there).ok_or_else(|| unknown(path))
}

fn is_part(file: &str) -> bool {
    matches!(file, "cameras.bin" | "images.bin" | "cameras.txt" | "images.txt")
}

fn unknown(path: &InputFile) -> NodeError {
    let what =
        format!("`{}` is neither a file `.json`, `.gltf` or `.glb` nor the folder of a COLMAP model", path.0);
    let ending = path.0.rsplit_once('.').map_or(String::new(), |(_, ending)| ending.to_ascii_lowercase());
    let hint = match ending.as_str() {
        "xml" => "cameras of Metashape are exported as COLMAP by File, Export, Export Cameras",
        "csv" => "cameras of RealityCapture are exported as COLMAP by Alignment, Export, Registration",
        "out" | "nvm" | "rc" => {
            "export the cameras as a COLMAP model, which most reconstruction programs write"
        }
        _ => "a COLMAP model has `cameras.bin` and `images.bin`, or both as `.txt`",
    };
    NodeError::new(what).at("path").hint(hint)
}
