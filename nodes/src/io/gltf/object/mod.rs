//! Objects of glTF files: shapes, materials and textures.

mod geometry;
mod inward;
mod material;
pub(crate) mod tangents;
#[cfg(test)]
mod tests;

pub(crate) use geometry::local;

use std::path::Path;

use engine::{Context, InputFile, NodeError, Notes, SourceFile, SourceRoot};

use self::geometry::Geometry;
use self::material::Materials;
use super::{Want, json_of, parse};
use crate::io::import::{self, Foreign};
use crate::io::png::Raster;
use crate::types::{Object, Texture};

/// The file and all files that it refers to. The format of the file is detected by content. Errors in a GLB are
/// reported only when the node runs, since only then are all of its bytes read.
pub(crate) fn sources(path: &InputFile, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
    let file = root.file(path);
    let mut sources = vec![file.clone()];
    let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", path.0)).at("path");
    if Foreign::of(&path.0).is_some() {
        let read = |path: &Path| if path.is_file() { std::fs::read(path).ok() } else { None };
        let bytes = std::fs::read(&file.path).map_err(failed)?;
        let names = import::beside(&path.0, &bytes, |name| read(&root.beside(&file, name).path));
        sources.extend(names.iter().map(|name| root.beside(&file, name)));
        return Ok(sources);
    }
    let Some((json, binary)) = json_of(&file.path).map_err(failed)? else { return Ok(sources) };
    let names = parse(&path.0, &json).and_then(|parsed| parsed.beside(Want::Everything));
    match names {
        Ok(names) => sources.extend(names.iter().map(|name| root.beside(&file, name))),
        Err(_) if binary => {}
        Err(error) => return Err(NodeError::from(error).at("path")),
    }
    Ok(sources)
}

/// Reads an object from the bytes of its file.
pub(crate) fn object(
    path: &InputFile,
    bytes: &[u8],
    want: Want,
    scene: Option<u32>,
    cx: &Context,
    notes: &mut Notes,
) -> Result<Object, NodeError> {
    let name = &path.0;
    let bytes = &*import::as_gltf(path, bytes, cx, notes)?;
    let file = parse(name, bytes)?;
    let buffers = file.buffers(|beside| cx.read_beside(path, beside))?;
    let mut reader = Materials::new(name, &file.json);
    let mut unheard = Notes::none();
    let said = if want == Want::Everything { &mut *notes } else { &mut unheard };
    let mut materials = reader.read(said)?;
    let images = reader.images;
    let textures = if want == Want::Everything {
        let decoded = cx.for_each_tile(images.len(), |k| {
            file.picture(images[k], &buffers, |beside| cx.read_beside(path, beside)).map(texture)
        })?;
        decoded.into_iter().collect::<Result<Vec<_>, NodeError>>()?
    } else {
        Vec::new()
    };
    let narrowed = textures.iter().filter(|(_, narrowed)| *narrowed).count() as u64;
    notes.count(
        "textures-narrowed",
        narrowed,
        "of the textures had to be rounded from 16 to 8 bits per channel",
    );
    cx.progress(0.5);
    let mut primitives = Geometry::new(name, &file, &buffers).scene(scene, &mut materials, cx, notes)?;
    if want == Want::Everything {
        inward::turn(&mut primitives, &materials, cx, notes)?;
    }
    Ok(Object { primitives, materials, textures: textures.into_iter().map(|(texture, _)| texture).collect() })
}

/// Converts a picture to a texture with four bytes per texel. The flag is true if 16-bit codes were rounded to 8
/// bits.
fn texture(raster: Raster) -> (Texture, bool) {
    let wide = raster.largest > 255;
    let byte = |code: u16| if wide { ((u32::from(code) * 255 + 32_767) / 65_535) as u8 } else { code as u8 };
    let rgba = raster
        .codes
        .chunks_exact(raster.channels)
        .flat_map(|texel| {
            let [r, g, b, a] = match *texel {
                [y] => [y, y, y, raster.largest],
                [y, a] => [y, y, y, a],
                [r, g, b] => [r, g, b, raster.largest],
                [r, g, b, a, ..] => [r, g, b, a],
                [] => [0; 4],
            };
            [byte(r), byte(g), byte(b), byte(a)]
        })
        .collect();
    (Texture { width: raster.width as u32, height: raster.height as u32, rgba }, wide)
}
