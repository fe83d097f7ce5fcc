//! `load-object`: an object to insert.

mod geometry;
mod material;
pub(crate) mod tangents;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use std::io::{Seek, SeekFrom};

use engine::{Context, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot};

use self::geometry::Geometry;
use self::material::Materials;
use crate::io::gltf::{self, Want};
use crate::io::head::Head;
use crate::io::png::Raster;
use crate::types::{Object, Texture};

engine::params! {
    /// Loads an object to insert: glTF or GLB.
    ///
    /// Node transforms, instances, morph weights and skins are applied as the file has them. Materials are
    /// metallic-roughness with all their textures and the KHR extensions: transmission, volume, ior, clearcoat,
    /// sheen, specular, anisotropy, iridescence, diffuse transmission, emissive strength, unlit. A file that
    /// requires anything else is refused by name; what it merely uses is told, and marks the result as
    /// degraded where it would show. Pictures are PNG, JPEG or WebP.
    pub struct LoadObject {
        /// The file: `.glb`, or `.gltf` with what it names beside it.
        path: InputFile, other("\"b.glb\"");
        /// Which scene of the file, counted from 0; by default the one that the file shows first.
        scene: Option<u32> = None, range(0, 65535), other("Some(1)"), inert("most files have one scene");
    }
}
engine::inputs! {
    /// None.
    pub struct In {}
}
engine::outputs! {
    /// The object.
    pub struct Out {
        /// The object in the frame of its file: y up, metres.
        object: Arc<Object>,
    }
}

impl Kind for LoadObject {
    const NAME: &'static str = "load-object";
    const VERSION: u32 = 4;
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        sources(&p.path, root)
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        let all = files.iter().fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
        // Pictures beside it, and those in it: in the worst case all are being read at the same time.
        let beside = files.iter().filter_map(|file| Head::read(&mut file.open()?));
        let pictures = beside.chain(files.first().into_iter().flat_map(pictures_inside));
        let texels = pictures.map(|head| head.as_texels()[0]).fold(0, u64::saturating_add);
        // The files, their geometry as floats and once more as triangles of the object.
        Cost { bytes: all.saturating_mul(3).saturating_add(texels) }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let bytes = cx.read(&p.path).map_err(|e| e.at("path"))?;
        let object =
            object(&p.path, &bytes, Want::Everything, p.scene, cx, &mut notes).map_err(|e| e.at("path"))?;
        let triangles: usize = object.primitives.iter().map(|part| part.triangles.len()).sum();
        cx.count("triangles", triangles as u64);
        Ok((Out { object: Arc::new(object) }, notes))
    }
}

/// The heads of the pictures that a GLB holds.
fn pictures_inside(file: &FileHead<'_>) -> Vec<Head> {
    let read = || {
        let mut reader = file.open()?;
        let (json, binary) = gltf::json_in(&mut reader).ok()??;
        let json: serde_json::Value = serde_json::from_slice(&json).ok().filter(|_| binary)?;
        // The binary chunk begins behind its own length and name.
        let start = reader.stream_position().ok()? + 8;
        let views = json["images"].as_array()?.iter().filter_map(|image| image["bufferView"].as_u64());
        let mut heads = Vec::new();
        for view in views {
            let offset = json["bufferViews"][view as usize]["byteOffset"].as_u64().unwrap_or(0);
            reader.seek(SeekFrom::Start(start.saturating_add(offset))).ok()?;
            heads.extend(Head::read(&mut reader));
        }
        Some(heads)
    };
    read().unwrap_or_default()
}

/// The file and all that it names, by its content as it is read. What is wrong with a GLB is told when it
/// runs, with all of its bytes at hand.
pub(crate) fn sources(path: &InputFile, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
    let file = root.file(path);
    let mut sources = vec![file.clone()];
    let failed = |e| NodeError::new(format!("cannot read `{}`: {e}", path.0)).at("path");
    let Some((json, binary)) = gltf::json_of(&file.path).map_err(failed)? else { return Ok(sources) };
    let names = gltf::parse(&path.0, &json).and_then(|parsed| parsed.beside(Want::Everything));
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
    let file = gltf::parse(name, bytes)?;
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
    notes.count("textures-narrowed", narrowed, "textures of 16 bits were rounded to 8");
    cx.progress(0.5);
    let primitives = Geometry::new(name, &file, &buffers).scene(scene, &mut materials, cx, notes)?;
    Ok(Object { primitives, materials, textures: textures.into_iter().map(|(texture, _)| texture).collect() })
}

/// Four bytes a texel, and whether bits were lost.
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
