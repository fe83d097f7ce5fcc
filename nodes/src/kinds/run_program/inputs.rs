//! The inputs of a program as files.

use std::collections::BTreeSet;

use engine::{Context, InputFile, NodeError};
use scene::io::capture::write::{file_name, model, pictures};
use scene::io::mesh::{MeshFormat, encode as encode_mesh};
use scene::io::splats::save::{SaveFormat, encode as encode_splats};
use scene::types::{Mesh, Photos, Splats};

use crate::program::WorkFolder;

/// The names of the copies of files.
///
/// # Errors
/// If two files have the same name.
pub fn names(files: &[InputFile]) -> Result<Vec<&str>, NodeError> {
    let name = |file: &'_ InputFile| file.0.trim_end_matches('/').rsplit(['/', '\\']).next().map(str::len);
    let mut seen = BTreeSet::new();
    let mut names = Vec::with_capacity(files.len());
    for file in files {
        let whole = file.0.trim_end_matches('/');
        let name = &whole[whole.len() - name(file).unwrap_or(0)..];
        if name.is_empty() || name == ".." || !seen.insert(name) {
            let what = format!("`{}` has no name of its own among `files`", file.0);
            return Err(NodeError::new(what).at("files").hint("the program finds the files by their names"));
        }
        names.push(name);
    }
    Ok(names)
}

/// The inputs of a program.
pub struct Given<'a> {
    pub photos: Option<&'a Photos>,
    pub splats: Option<&'a Splats>,
    pub mesh: Option<&'a Mesh>,
    pub files: &'a [InputFile],
}

/// Writes the inputs that are connected, and the files.
pub fn write(given: &Given<'_>, folder: &WorkFolder, cx: &Context) -> Result<(), NodeError> {
    if let Some(photos) = given.photos {
        write_photos(photos, folder, cx)?;
    }
    if let Some(splats) = given.splats {
        folder.write("splats.ply", &encode_splats(splats, SaveFormat::Ply, None, cx)?.0)?;
    }
    if let Some(mesh) = given.mesh {
        folder.write("mesh.ply", &encode_mesh(mesh, MeshFormat::Ply, None))?;
    }
    folder.create("files")?;
    for (file, name) in given.files.iter().zip(names(given.files)?) {
        let bytes = cx.read(file).map_err(|e| e.at("files"))?;
        folder.write(&format!("files/{name}"), &bytes)?;
    }
    Ok(())
}

fn write_photos(photos: &Photos, folder: &WorkFolder, cx: &Context) -> Result<(), NodeError> {
    for (name, bytes) in model(photos) {
        folder.write(&format!("photos/{name}"), &bytes)?;
    }
    for (index, photo) in photos.photos.iter().enumerate() {
        cx.check()?;
        cx.progress(0.05 * index as f32 / photos.photos.len() as f32);
        let (picture, mask) = pictures(photo)?;
        folder.write(&format!("photos/images/{}", file_name(photo)), &picture)?;
        if let Some(mask) = mask {
            folder.write(&format!("photos/masks/{}", file_name(photo)), &mask)?;
        }
    }
    Ok(())
}
