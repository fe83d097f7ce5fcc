//! glTF and GLB: the container, its checked document, buffers, accessors, pictures, and objects made of them; objects
//! written as GLB.

mod accessor;
pub(crate) mod address;
pub mod animation;
mod container;
mod document;
mod file;
pub mod object;
pub(crate) mod specular_glossiness;
pub mod write;

use std::collections::BTreeSet;

use serde_json::Value;

use super::foreign::{self, json_text, refuse_foreign, refuse_placeholder};
use super::mesh_format;
use super::png::Raster;
use super::{jpeg, png, webp};
use crate::error::Error;
use address::{inline, path};
use container::split;
use document::{document, repair};

pub use accessor::Numbers;
pub use container::{json_in, json_of};
pub use file::File;

/// The parts of a file that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Want {
    /// Shapes only.
    Geometry,
    /// Shapes, materials and textures.
    Everything,
}

/// glTF extensions that a file may list as required.
pub const SUPPORTED: [&str; 19] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    // These change nothing visible.
    "KHR_xmp_json_ld",
    "KHR_xmp",
];

/// Advice on how to save a file without an unsupported extension.
fn advice(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" => " (Draco compression); save the file without it",
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            " (meshopt compression); save the file without it"
        }
        "KHR_texture_basisu" => " (KTX2 textures); save them as PNG or JPEG",
        "EXT_texture_avif" => " (AVIF textures); save them as PNG or JPEG",
        _ => "",
    }
}

/// Reads the container and the JSON of a glTF or GLB file.
pub fn parse(name: &str, bytes: &[u8]) -> Result<File, Error> {
    let (text, blob) = if bytes.starts_with(b"glTF") { split(name, bytes)? } else { (bytes, None) };
    refuse_foreign(name, text)?;
    let text = json_text(text);
    let mut json: Value = serde_json::from_slice(text).map_err(|e| {
        // JSON that is damaged begins like glTF too.
        match mesh_format::of(name, text).filter(|format| *format != "glTF") {
            Some(format) => mesh_format::refused(name, format, "glTF, OBJ or STL"),
            None => Error::format(
                name,
                format!("the file is neither GLB nor glTF; its JSON cannot be parsed ({e})"),
            ),
        }
    })?;
    let version = json["asset"]["version"].as_str().unwrap_or_default().to_owned();
    if !version.starts_with("2.") {
        return Err(Error::unsupported(name, format!("glTF version `{version}`; save the file as glTF 2.0")));
    }
    for extension in json["extensionsRequired"].as_array().into_iter().flatten().filter_map(Value::as_str) {
        if !SUPPORTED.contains(&extension) {
            return Err(Error::unsupported(name, format!("{extension}{}", advice(extension))));
        }
    }
    for texture in json["textures"].as_array().into_iter().flatten() {
        if texture.get("source").is_none() && texture["extensions"].get("EXT_texture_webp").is_none() {
            let format = texture["extensions"].as_object().and_then(|o| o.keys().next());
            let what = match format {
                Some(format) => format!("a texture in the format {format}{}", advice(format)),
                None => "a texture without a picture".to_owned(),
            };
            return Err(Error::unsupported(name, what));
        }
    }
    check_accessors(name, &json)?;
    specular_glossiness::replace(&mut json);
    repair(&mut json);
    let document = document(name, &mut json)?;
    Ok(File { name: name.to_owned(), document, json, blob })
}

/// Checks that the accessors of primitives exist, since the crate `gltf` uses them as indices before it tests that
/// they exist.
fn check_accessors(name: &str, json: &Value) -> Result<(), Error> {
    let count = json["accessors"].as_array().map_or(0, Vec::len) as u64;
    let known = |index: &Value| index.as_u64().is_none_or(|index| index < count);
    let meshes = json["meshes"].as_array().into_iter().flatten();
    for primitive in meshes.filter_map(|mesh| mesh["primitives"].as_array()).flatten() {
        let maps = std::iter::once(&primitive["attributes"])
            .chain(primitive["targets"].as_array().into_iter().flatten());
        let attributes = maps.filter_map(Value::as_object).flat_map(|map| map.values());
        if !attributes.chain([&primitive["indices"]]).all(known) {
            return Err(Error::format(
                name,
                format!(
                    "not valid glTF: a primitive refers to an accessor that does not exist (the file has {count} accessors)"
                ),
            ));
        }
    }
    Ok(())
}

/// The error about a texture in a format that is not read.
fn other_picture(label: &str, bytes: &[u8]) -> Error {
    if let Err(named) = refuse_foreign(label, bytes) {
        return named;
    }
    match foreign::other_picture(label, bytes) {
        Some(format) => Error::unsupported(label, format!("a {format} texture; save it as PNG or JPEG")),
        None => Error::format(label, "the picture is not PNG, JPEG or WebP"),
    }
}

impl File {
    fn bad(&self, what: impl Into<String>) -> Error {
        Error::format(&self.name, what)
    }

    /// Paths of the other files to which the buffers and, if requested, the pictures refer. The paths are sorted
    /// and without duplicates.
    pub fn other_files(&self, want: Want) -> Result<Vec<String>, Error> {
        let lists: &[&str] = if want == Want::Geometry { &["buffers"] } else { &["buffers", "images"] };
        let mut paths = BTreeSet::new();
        for list in lists {
            for item in self.json[*list].as_array().into_iter().flatten() {
                if let Some(uri) = item["uri"].as_str().filter(|uri| !uri.starts_with("data:")) {
                    paths.insert(path(&self.name, uri)?);
                }
            }
        }
        Ok(paths.into_iter().collect())
    }

    /// The bytes of every buffer. `read` reads a file, given its path relative to this file.
    pub fn buffers<E: From<Error>>(
        &self,
        mut read: impl FnMut(&str) -> Result<Vec<u8>, E>,
    ) -> Result<Vec<Vec<u8>>, E> {
        let mut buffers = Vec::new();
        for buffer in self.document.buffers() {
            let bytes = match buffer.source() {
                gltf::buffer::Source::Bin => self
                    .blob
                    .clone()
                    .ok_or_else(|| self.bad("a buffer has neither an address nor a binary chunk"))?,
                gltf::buffer::Source::Uri(uri) => match inline(&self.name, uri) {
                    Some(bytes) => bytes?,
                    None => {
                        let bytes = read(&path(&self.name, uri)?)?;
                        refuse_placeholder(uri, &bytes)?;
                        bytes
                    }
                },
            };
            if bytes.len() < buffer.length() {
                let what = format!(
                    "buffer {} has {} bytes, but its `byteLength` is {}",
                    buffer.index(),
                    bytes.len(),
                    buffer.length()
                );
                return Err(self.bad(what).into());
            }
            buffers.push(bytes);
        }
        Ok(buffers)
    }

    fn view<'b>(&self, view: &gltf::buffer::View<'_>, buffers: &'b [Vec<u8>]) -> Result<&'b [u8], Error> {
        let end = view.offset().checked_add(view.length());
        buffers
            .get(view.buffer().index())
            .zip(end)
            .and_then(|(buffer, end)| buffer.get(view.offset()..end))
            .ok_or_else(|| self.bad(format!("buffer view {} lies outside its buffer", view.index())))
    }

    /// Decodes a picture to 8-bit codes.
    pub fn picture<E: From<Error>>(
        &self,
        index: usize,
        buffers: &[Vec<u8>],
        read: impl FnOnce(&str) -> Result<Vec<u8>, E>,
    ) -> Result<Raster, E> {
        // From the JSON: the crate panics at a picture without address or type.
        let image = &self.json["images"][index];
        let (label, owned);
        let bytes = match (image["uri"].as_str(), image["bufferView"].as_u64()) {
            (Some(uri), _) => {
                label = if uri.starts_with("data:") {
                    format!("{} image {index}", self.name)
                } else {
                    uri.to_owned()
                };
                owned = match inline(&self.name, uri) {
                    Some(bytes) => bytes?,
                    None => read(&path(&self.name, uri)?)?,
                };
                owned.as_slice()
            }
            (None, Some(view)) => {
                label = format!("{} image {index}", self.name);
                let view = self.document.views().nth(view as usize);
                self.view(&view.ok_or_else(|| self.bad(format!("image {index} has no bytes")))?, buffers)?
            }
            _ => return Err(self.bad(format!("image {index} has neither an address nor bytes")).into()),
        };
        let raster = match bytes {
            [0x89, b'P', b'N', b'G', ..] => png::read(&label, bytes)?,
            [0xff, 0xd8, ..] => jpeg::read(&label, bytes)?,
            [0xab, b'K', b'T', b'X', ..] => {
                return Err(Error::unsupported(label, "KTX textures; save them as PNG").into());
            }
            [b'R', b'I', b'F', b'F', ..] => webp::read(&label, bytes)?,
            _ => return Err(other_picture(&label, bytes).into()),
        };
        Ok(raster)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_in_other_formats_are_named() {
        for (bytes, says) in [
            (&b"version https://git-lfs.github.com/spec/v1\n"[..], "git lfs pull"),
            (b"\0\0\0\x18ftypheic\0\0\0\0", "HEIC"),
            (b"\0\0\0\x18ftypavif\0\0\0\0", "AVIF"),
            (b"II*\0\x08\0\0\0", "TIFF"),
            (b"BM\0\0", "BMP"),
            (b"\0\0\x02", "not PNG, JPEG or WebP"),
        ] {
            let error = other_picture("a.jpg", bytes).to_string();
            assert!(error.contains(says), "{error}");
        }
        assert!(other_picture("maps/A.TGA", b"\0\0\x02").to_string().contains("TGA"));
    }

    // JSON that a program padded with NUL, and JSON after a byte-order mark.
    #[test]
    fn json_with_a_mark_or_fill_is_read() {
        let text = br#"{"asset":{"version":"2.0"}}"#;
        let glb = |fill: &[u8]| {
            let chunk = [&text[..], fill].concat();
            let mut out = b"glTF\x02\0\0\0".to_vec();
            out.extend((20 + chunk.len() as u32).to_le_bytes());
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(b"JSON");
            [out, chunk].concat()
        };
        for bytes in [
            glb(b" "),
            glb(b"\0"),
            glb(b"\0\0\0\0\0"),
            glb(b" \n\0"),
            [b"\xef\xbb\xbf", &text[..], b"\0"].concat(),
        ] {
            assert!(parse("a", &bytes).is_ok(), "{bytes:?}");
        }
        let lfs = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n";
        assert!(parse("a.glb", lfs).err().is_some_and(|e| e.to_string().contains("git lfs pull")));
    }

    #[test]
    fn what_is_required_and_unknown_is_named() {
        for (json, named) in [
            (r#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_draco_mesh_compression"]}"#, "Draco"),
            (r#"{"asset":{"version":"2.0"},"extensionsRequired":["XYZ_odd"]}"#, "XYZ_odd"),
            (
                r#"{"asset":{"version":"2.0"},"textures":[{"extensions":{"KHR_texture_basisu":{"source":0}}}]}"#,
                "KTX2",
            ),
            (r#"{"asset":{"version":"1.0"}}"#, "1.0"),
            (
                r#"{"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":3}}]}]}"#,
                "valid",
            ),
            ("{", "JSON"),
        ] {
            let error = parse("a.gltf", json.as_bytes()).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains(named), "{error}");
        }
        assert!(
            parse("a.gltf", br#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_materials_ior"]}"#)
                .is_ok()
        );
    }
}
