//! Objects of glTF files: shapes, materials and textures.

mod geometry;
mod material;
pub mod tangents;
#[cfg(test)]
mod tests;

pub use geometry::local;
pub(super) use geometry::{inverse_transpose, turned};

use engine::{Context, InputFile, NodeError, Notes, SourceFile, SourceRoot};
use std::collections::BTreeSet;

use self::geometry::Geometry;
use self::material::{Materials, Picture};
use super::animation::{self, Moment};
use super::{Want, json_of, parse};
use crate::io::import::{self, Foreign};
use crate::io::png::Raster;
use crate::types::{Object, Texture};

/// Maximum length in bytes of a file that is read to find the files to which it refers, such as an MTL file.
const PARTNER_LIMIT: u64 = 256 << 20;

/// The file and all files that it refers to. The format of the file is detected by content. Errors in a GLB are
/// reported only when the node runs, since only then are all of its bytes read.
pub fn sources(path: &InputFile, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
    let file = root.file(path);
    let mut sources = vec![file.clone()];
    let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", path.0)).at("path");
    if Foreign::of(&path.0).is_some() {
        let opened = engine::open_regular(&file.path).map_err(failed)?;
        let read = |name: &str| engine::read_at_most(&root.sibling(&file, name).path, PARTNER_LIMIT).ok();
        let names = import::other_files(&path.0, opened, read).map_err(failed)?;
        sources.extend(names.iter().map(|name| root.sibling(&file, name)));
        return Ok(sources);
    }
    let Some((json, binary)) = json_of(&file.path).map_err(failed)? else { return Ok(sources) };
    let names = parse(&path.0, &json).and_then(|parsed| parsed.other_files(Want::Everything));
    match names {
        Ok(names) => sources.extend(names.iter().map(|name| root.sibling(&file, name))),
        Err(_) if binary => {}
        Err(error) => return Err(NodeError::from(error).at("path")),
    }
    Ok(sources)
}

/// Reads an object from the bytes of its file. With a moment, its parts are placed by that animation, and as stored
/// in the file otherwise.
pub fn object(
    path: &InputFile,
    bytes: &[u8],
    want: Want,
    (scene, moment): (Option<u32>, Option<Moment<'_>>),
    cx: &Context,
    notes: &mut Notes,
) -> Result<Object, NodeError> {
    let name = &path.0;
    let bytes = &*import::as_gltf(path, bytes, cx, notes)?;
    if let Some(foreign) = Foreign::of(name).filter(|_| want == Want::Everything) {
        foreign.tell_frame(notes);
    }
    let mut file = parse(name, bytes)?;
    let buffers = file.buffers(|name| cx.read_sibling(path, name))?;
    let clips = animation::names(&file.json);
    if let Some(moment) = &moment {
        file.pose(moment, &buffers, notes)?;
    } else if want == Want::Everything && !clips.is_empty() {
        let clips = animation::listed(&clips);
        let text = format!(
            "the file has the animations {clips}, which are not played: set `clip` to play one of them"
        );
        notes.decision("not-shown", text);
    }
    let mut reader = Materials::new(name, &file.json);
    let mut unheard = Notes::none();
    let shown = if want == Want::Everything { &mut *notes } else { &mut unheard };
    let mut materials = reader.read(shown)?;
    let images = reader.images;
    let textures = if want == Want::Everything {
        let decoded = cx.for_each_tile(images.len(), |k| {
            let Picture { image, glossiness } = images[k];
            file.picture(image, &buffers, |name| cx.read_sibling(path, name))
                .map(|raster| Decoded::of(raster, glossiness))
        })?;
        decoded.into_iter().collect::<Result<Vec<_>, NodeError>>()?
    } else {
        Vec::new()
    };
    report_profiles(&textures, notes);
    let narrowed = textures.iter().filter(|texture| texture.narrowed).count() as u64;
    notes.count(
        "textures-narrowed",
        narrowed,
        "of the textures had to be rounded from 16 to 8 bits per channel",
    );
    cx.progress(0.5);
    let primitives = Geometry::new(name, &file, &buffers).scene(scene, &mut materials, cx, notes)?;
    Ok(Object {
        primitives,
        materials,
        textures: textures.into_iter().map(|decoded| decoded.texture).collect(),
    })
}

/// A texture, and what was lost when it was decoded.
struct Decoded {
    texture: Texture,
    /// True if 16-bit codes were rounded to 8 bits.
    narrowed: bool,
    /// Descriptions of properties of the file that are ignored, such as its colour profile.
    ignored: Vec<String>,
}

impl Decoded {
    /// Converts a picture to a texture with four bytes per texel. If a factor of the glossiness is given, the green
    /// channel becomes one minus the glossiness, which alpha holds, and the other colours become 0.
    fn of(raster: Raster, glossiness: Option<f64>) -> Self {
        let wide = raster.largest > 255;
        let byte =
            |code: u16| if wide { ((u32::from(code) * 255 + 32_767) / 65_535) as u8 } else { code as u8 };
        let rgba = raster
            .codes
            .chunks_exact(raster.channels)
            .flat_map(|texel| {
                let rgba = match *texel {
                    [y] => [y, y, y, raster.largest],
                    [y, a] => [y, y, y, a],
                    [r, g, b] => [r, g, b, raster.largest],
                    [r, g, b, a, ..] => [r, g, b, a],
                    [] => [0; 4],
                };
                let rgba = rgba.map(byte);
                match glossiness {
                    Some(factor) => [0, (255.0 - factor * f64::from(rgba[3])).round() as u8, 0, 255],
                    None => rgba,
                }
            })
            .collect();
        let (width, height) = (raster.width as u32, raster.height as u32);
        let profile = raster.colour.map(|_| "a colour profile other than sRGB".to_owned());
        let ignored = raster.ignored.into_iter().chain(profile).collect();
        Self { texture: Texture { width, height, rgba }, narrowed: wide, ignored }
    }
}

/// Reports what is ignored in the files of textures: glTF requires that colour profiles are.
fn report_profiles(textures: &[Decoded], notes: &mut Notes) {
    let found: BTreeSet<&str> =
        textures.iter().flat_map(|texture| &texture.ignored).map(String::as_str).collect();
    for what in found {
        let count = textures.iter().filter(|texture| texture.ignored.iter().any(|own| own == what)).count();
        let text = format!(
            "textures have {what} (number: {count}); this is ignored, as glTF requires; save the textures upright and in sRGB if \
             they look wrong"
        );
        notes.warning("profile-ignored", text);
    }
}
