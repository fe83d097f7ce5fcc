//! Meshes in Wavefront OBJ (with its materials) and STL. They are converted to glTF in memory, so that shapes,
//! materials and textures have a single loader.

mod glb;
mod material;
mod mtl;
mod obj;
mod stl;
mod text;

use std::borrow::Cow;

use engine::{Context, InputFile, NodeError, Notes};

use glb::Builder;

/// A format that is read through glTF.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Foreign {
    /// Wavefront OBJ.
    Obj,
    /// STL, binary or text.
    Stl,
}

impl Foreign {
    /// The format according to the extension of the name, since neither format has a distinctive start.
    pub fn of(name: &str) -> Option<Self> {
        let lower = name.to_ascii_lowercase();
        match lower.rsplit_once('.')?.1 {
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            _ => None,
        }
    }

    /// Adds a note about the frame in which an object of this format is read.
    pub fn tell_frame(self, notes: &mut Notes) {
        let (id, name) = match self {
            Self::Obj => ("frame-of-obj", "OBJ"),
            Self::Stl => ("frame-of-stl", "STL"),
        };
        let text =
            "defines neither an up axis nor a unit; y is assumed to be up, and the unit to be the metre";
        notes.decision(id, format!("{name} {text}"));
    }
}

/// The other files that a file refers to, by relative path: materials and their pictures. `file` is read once, without
/// keeping it in memory.
pub fn other_files(
    path: &str,
    file: impl std::io::Read,
    mut read: impl FnMut(&str) -> Option<Vec<u8>>,
) -> std::io::Result<Vec<String>> {
    match Foreign::of(path) {
        Some(Foreign::Obj) => Ok(obj::other_files(&text::lines_with(file, "mtllib")?, &mut read)),
        _ => Ok(Vec::new()),
    }
}

/// Converts an OBJ or STL file to GLB; other files are returned unchanged.
pub fn as_gltf<'a>(
    path: &InputFile,
    bytes: &'a [u8],
    cx: &Context,
    notes: &mut Notes,
) -> Result<Cow<'a, [u8]>, NodeError> {
    let name = &path.0;
    let mut builder = Builder::default();
    match Foreign::of(name) {
        None => return Ok(Cow::Borrowed(bytes)),
        Some(Foreign::Obj) => {
            let read = |name: &str| cx.read_sibling(path, name);
            obj::read(name, bytes, &read, &mut builder, cx, notes)?;
        }
        Some(Foreign::Stl) => stl::read(name, bytes, &mut builder, cx, notes)?,
    }
    cx.check()?;
    Ok(Cow::Owned(builder.finish()))
}
