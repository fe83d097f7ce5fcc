//! glTF and GLB: the container, its checked document, buffers, accessors and pictures. What they mean
//! is the business of `load-object`.

use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

use gltf::accessor::{DataType, Dimensions};
use gltf::{Accessor, Document};
use serde_json::{Value, json};

use super::png::Raster;
use super::{jpeg, png, webp};
use crate::Error;

/// What of a file is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Want {
    /// Shapes only.
    Geometry,
    /// Shapes, materials and textures.
    Everything,
}

/// Extensions that a file may require.
pub const SUPPORTED: [&str; 18] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    // These change nothing that is drawn.
    "KHR_xmp_json_ld",
    "KHR_xmp",
];

/// Why some extensions are not supported, and what to do instead.
fn advice(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" => ": Draco compression; save the file without it",
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            ": meshopt compression; save the file without it"
        }
        "KHR_texture_basisu" => ": KTX2 textures; save them as PNG or JPEG",
        "EXT_texture_avif" => ": AVIF textures; save them as PNG or JPEG",
        "KHR_materials_pbrSpecularGlossiness" => ": specular-glossiness; convert it to metallic-roughness",
        _ => "",
    }
}

/// A parsed file whose indices are all in range.
pub struct File {
    name: String,
    /// The checked document.
    pub document: Document,
    /// The same as plain JSON, for extensions.
    pub json: Value,
    blob: Option<Vec<u8>>,
}

/// Reads the container and the JSON of a glTF or GLB file.
pub fn parse(name: &str, bytes: &[u8]) -> Result<File, Error> {
    let (text, blob) = if bytes.starts_with(b"glTF") { split(name, bytes)? } else { (bytes, None) };
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let mut json: Value = serde_json::from_slice(text).map_err(|e| match other_format(name, text) {
        Some(format) => Error::unsupported(
            name,
            format!("{format}: objects are read from glTF and GLB; open it in a program that has it, as Blender, and export glTF 2.0"),
        ),
        None => Error::format(name, format!("neither GLB nor glTF: its JSON does not parse: {e}")),
    })?;
    let version = json["asset"]["version"].as_str().unwrap_or_default().to_owned();
    if !version.starts_with("2.") {
        return Err(Error::unsupported(name, format!("glTF version `{version}`")));
    }
    for extension in json["extensionsRequired"].as_array().into_iter().flatten().filter_map(Value::as_str) {
        if !SUPPORTED.contains(&extension) {
            return Err(Error::unsupported(name, format!("{extension}{}", advice(extension))));
        }
    }
    for texture in json["textures"].as_array().into_iter().flatten() {
        if texture.get("source").is_none() && texture["extensions"].get("EXT_texture_webp").is_none() {
            let other =
                texture["extensions"].as_object().and_then(|o| o.keys().next()).map_or("no picture", |k| k);
            return Err(Error::unsupported(name, format!("{other} for a texture{}", advice(other))));
        }
    }
    check_accessors(name, &json)?;
    if let Some(top) = json.as_object_mut() {
        // Checked above; the crate knows fewer of them than we do.
        top.remove("extensionsRequired");
    }
    // A scene may be empty, which the crate does not know either.
    for scene in json.get_mut("scenes").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(scene) = scene.as_object_mut() {
            scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
        }
    }
    // A texture may have its picture in the extension alone, which the crate does not know.
    for texture in json.get_mut("textures").and_then(Value::as_array_mut).into_iter().flatten() {
        let webp = texture["extensions"]["EXT_texture_webp"]["source"].clone();
        if let Some(texture) = texture.as_object_mut().filter(|texture| !texture.contains_key("source")) {
            texture.insert("source".to_owned(), webp);
        }
    }
    let views = json["bufferViews"].as_array().is_some_and(|views| !views.is_empty());
    for accessor in json.get_mut("accessors").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some(accessor) = accessor.as_object_mut() {
            // Bounds of positions, which the crate insists on, are often missing and never needed.
            for bound in ["min", "max"] {
                accessor.entry(bound).or_insert_with(|| Value::from(vec![0.0; 3]));
            }
            // Neither numbers nor changes of them: all are 0 (glTF 2.0, 3.6.2.3), which the crate takes for a mistake.
            if views && !accessor.contains_key("bufferView") {
                accessor.entry("sparse").or_insert_with(|| {
                    json!({"count": 0, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}})
                });
            }
        }
    }
    let invalid = |text: String| {
        let text = text.trim().trim_end_matches(';').trim_start_matches("invalid glTF: ");
        Error::format(name, format!("not valid glTF: {text}"))
    };
    let text = serde_json::to_vec(&json).map_err(|e| Error::format(name, e.to_string()))?;
    let root = gltf::json::deserialize::from_slice(&text).map_err(|e| invalid(e.to_string()))?;
    let document = Document::from_json(root).map_err(|e| invalid(e.to_string()))?;
    Ok(File { name: name.to_owned(), document, json, blob })
}

/// What a file is that holds no glTF, by its first bytes and by its name where these tell nothing.
fn other_format(name: &str, bytes: &[u8]) -> Option<&'static str> {
    let starts: [(&[u8], &str); 6] = [
        (b"Kaydara FBX", "FBX"),
        (b"BLENDER", "a Blender file"),
        (b"PXR-USDC", "USD"),
        (b"#usda", "USD"),
        (b"ply", "PLY"),
        (b"solid ", "STL"),
    ];
    let extensions = [
        (".obj", "Wavefront OBJ"),
        (".fbx", "FBX"),
        (".stl", "STL"),
        (".dae", "COLLADA"),
        (".3ds", "3DS"),
        (".usd", "USD"),
        (".usda", "USD"),
        (".usdc", "USD"),
        (".usdz", "USD"),
        (".abc", "Alembic"),
        (".blend", "a Blender file"),
    ];
    let name = name.to_ascii_lowercase();
    let by_bytes = starts.iter().find(|(start, _)| bytes.starts_with(start));
    let by_name = || extensions.iter().find(|(end, _)| name.ends_with(end));
    by_bytes.map(|(_, format)| *format).or_else(|| by_name().map(|(_, format)| *format))
}

/// The JSON of a file that is glTF by its first bytes, and whether it is binary (GLB), of which nothing else
/// is read; `None` for any other file.
pub fn json_of(path: &Path) -> std::io::Result<Option<(Vec<u8>, bool)>> {
    json_in(&mut std::fs::File::open(path)?)
}

/// The same from the start of a file, up to the end of its JSON.
pub fn json_in(file: &mut impl Read) -> std::io::Result<Option<(Vec<u8>, bool)>> {
    let mut head = Vec::new();
    file.by_ref().take(20).read_to_end(&mut head)?;
    if head.starts_with(b"glTF") {
        // A header of 12 bytes, then length and type of the first chunk, which is the JSON.
        let Some(length) = head.get(12..).and_then(|rest| rest.first_chunk()) else { return Ok(None) };
        let mut json = Vec::new();
        file.take(u32::from_le_bytes(*length).into()).read_to_end(&mut json)?;
        return Ok(Some((json, true)));
    }
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head);
    if !text.trim_ascii_start().starts_with(b"{") {
        return Ok(None);
    }
    file.read_to_end(&mut head)?;
    Ok(Some((head, false)))
}

/// The crate's own checks index the accessors of primitives before they look whether these exist.
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
                format!("not valid glTF: a primitive names an accessor beyond the {count}"),
            ));
        }
    }
    Ok(())
}

/// The JSON and binary chunks of a GLB.
fn split<'a>(name: &str, bytes: &'a [u8]) -> Result<(&'a [u8], Option<Vec<u8>>), Error> {
    let short = || Error::format(name, "the GLB is cut off");
    let word = |at: usize| -> Result<usize, Error> {
        let raw = bytes.get(at..at + 4).ok_or_else(short)?;
        Ok(raw.iter().rev().fold(0, |sum, b| sum << 8 | usize::from(*b)))
    };
    if word(4)? != 2 {
        return Err(Error::unsupported(name, format!("GLB version {}", word(4)?)));
    }
    let bytes = bytes.get(..word(8)?).ok_or_else(short)?;
    let length = word(12)?;
    if word(16)? != 0x4e4f_534a {
        return Err(Error::format(name, "the first chunk of the GLB is not JSON"));
    }
    let text = bytes.get(20..20 + length).ok_or_else(short)?;
    let next = 20 + length.next_multiple_of(4);
    if bytes.len() < next + 8 {
        return Ok((text, None));
    }
    let blob = bytes.get(next + 8..next + 8 + word(next)?).ok_or_else(short)?;
    Ok((text, (word(next + 4)? == 0x004e_4942).then(|| blob.to_vec())))
}

/// The bytes of a `data:` address, or `None` for another kind of address.
fn inline(name: &str, uri: &str) -> Option<Result<Vec<u8>, Error>> {
    let data = uri.strip_prefix("data:")?;
    Some(match data.split_once(";base64,") {
        Some((_, text)) => base64(text).ok_or_else(|| Error::format(name, "a data URI is not base64")),
        None => Err(Error::unsupported(name, "a data URI that is not base64")),
    })
}

fn base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=');
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 2);
    let (mut bits, mut held) = (0_u32, 0);
    for c in text.bytes() {
        let six = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(six);
        held += 6;
        if held >= 8 {
            held -= 8;
            out.push((bits >> held) as u8);
        }
    }
    (text.len() % 4 != 1).then_some(out)
}

/// The path that an address names, with `%20` and the like decoded.
fn path(name: &str, uri: &str) -> Result<String, Error> {
    let mut out = Vec::with_capacity(uri.len());
    let mut rest = uri.bytes();
    while let Some(byte) = rest.next() {
        let digit = |b: Option<u8>| b.and_then(|b| char::from(b).to_digit(16));
        out.push(match byte {
            b'%' => match (digit(rest.next()), digit(rest.next())) {
                (Some(high), Some(low)) => (high * 16 + low) as u8,
                _ => return Err(Error::format(name, format!("the address `{uri}` is not understood"))),
            },
            other => other,
        });
    }
    let path = String::from_utf8(out)
        .map_err(|_| Error::format(name, format!("the address `{uri}` is not text")))?;
    if path.contains("://") || path.starts_with('/') || path.contains('\\') || path.contains('\0') {
        return Err(Error::unsupported(
            name,
            format!("the address `{uri}`: only paths beside the file can be read"),
        ));
    }
    Ok(path)
}

/// Numbers of an accessor, `width` to an element.
pub struct Numbers {
    /// Numbers to an element.
    pub width: usize,
    /// All of them, in order; whole-number types normalised where the accessor says so.
    pub values: Vec<f64>,
}

impl Numbers {
    /// Elements as arrays; `None` where the width is another.
    pub fn arrays<const N: usize>(&self) -> Option<&[[f64; N]]> {
        if self.width == N { Some(self.values.as_chunks::<N>().0) } else { None }
    }
}

impl File {
    fn bad(&self, what: impl Into<String>) -> Error {
        Error::format(&self.name, what)
    }

    /// Files beside this one that its buffers and, where wanted, pictures name; each once, in order.
    pub fn beside(&self, want: Want) -> Result<Vec<String>, Error> {
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

    /// The bytes of every buffer; `read` reads a file beside this one.
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
                    None => read(&path(&self.name, uri)?)?,
                },
            };
            if bytes.len() < buffer.length() {
                let what = format!(
                    "buffer {} has {} bytes and claims {}",
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
            .ok_or_else(|| self.bad(format!("buffer view {} lies outside of its buffer", view.index())))
    }

    /// The numbers of an accessor.
    pub fn numbers(&self, accessor: &Accessor<'_>, buffers: &[Vec<u8>]) -> Result<Numbers, Error> {
        let width = match accessor.dimensions() {
            Dimensions::Scalar => 1,
            Dimensions::Vec2 => 2,
            Dimensions::Vec3 => 3,
            Dimensions::Vec4 | Dimensions::Mat2 => 4,
            Dimensions::Mat3 => 9,
            Dimensions::Mat4 => 16,
        };
        let (count, data) = (accessor.count(), accessor.data_type());
        let outside = || self.bad(format!("accessor {} lies outside of its buffer view", accessor.index()));
        let mut values;
        if let Some(view) = accessor.view() {
            let raw = self.view(&view, buffers)?;
            let size = data.size() * width;
            let stride = view.stride().unwrap_or(size);
            if stride < size {
                return Err(self.bad(format!("accessor {} has overlapping elements", accessor.index())));
            }
            let end = count
                .saturating_sub(1)
                .checked_mul(stride)
                .and_then(|n| n.checked_add(size + accessor.offset()));
            if count > 0 && end.is_none_or(|end| end > raw.len()) {
                return Err(outside());
            }
            values = Vec::with_capacity(count * width);
            for element in 0..count {
                let at = accessor.offset() + element * stride;
                let element = raw.get(at..at + size).ok_or_else(outside)?;
                values.extend(
                    element.chunks_exact(data.size()).map(|raw| number(raw, data, accessor.normalized())),
                );
            }
        } else {
            // Zeros that only a sparse part changes; no honest file has more of them than bytes.
            if count > buffers.iter().map(Vec::len).sum() {
                let text = format!("accessor {} has more elements than the file bytes", accessor.index());
                return Err(self.bad(text));
            }
            values = vec![0.0; count * width];
        }
        if let Some(sparse) = accessor.sparse() {
            let indices = self.view(&sparse.indices().view(), buffers)?;
            let index_type = match sparse.indices().index_type() {
                gltf::accessor::sparse::IndexType::U8 => DataType::U8,
                gltf::accessor::sparse::IndexType::U16 => DataType::U16,
                gltf::accessor::sparse::IndexType::U32 => DataType::U32,
            };
            let changes = self.view(&sparse.values().view(), buffers)?;
            let indices =
                indices.get(sparse.indices().offset()..).unwrap_or_default().chunks_exact(index_type.size());
            let changes =
                changes.get(sparse.values().offset()..).unwrap_or_default().chunks_exact(data.size() * width);
            let wrong = |what| self.bad(format!("the sparse part of accessor {} {what}", accessor.index()));
            if indices.len() < sparse.count() || changes.len() < sparse.count() {
                return Err(wrong("lies outside of its buffer view"));
            }
            for (index, change) in indices.zip(changes).take(sparse.count()) {
                let at = number(index, index_type, false) as usize * width;
                let slot = values
                    .get_mut(at..at + width)
                    .ok_or_else(|| wrong("changes an element that there is not"))?;
                for (value, raw) in slot.iter_mut().zip(change.chunks_exact(data.size())) {
                    *value = number(raw, data, accessor.normalized());
                }
            }
        }
        Ok(Numbers { width, values })
    }

    /// A picture as 8-bit codes.
    pub fn picture<E: From<Error>>(
        &self,
        index: usize,
        buffers: &[Vec<u8>],
        read: impl FnOnce(&str) -> Result<Vec<u8>, E>,
    ) -> Result<Raster, E> {
        // From the JSON: the crate stops the process at a picture without address or type.
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
            _ => return Err(Error::format(label, "neither PNG nor JPEG nor WebP").into()),
        };
        Ok(raster)
    }
}

/// One number, normalised as section 3.11 of the glTF specification says.
fn number(raw: &[u8], data: DataType, normalized: bool) -> f64 {
    let (value, largest) = match (data, raw) {
        (DataType::I8, &[a]) => (f64::from(a as i8), 127.0),
        (DataType::U8, &[a]) => (f64::from(a), 255.0),
        (DataType::I16, &[a, b]) => (f64::from(i16::from_le_bytes([a, b])), 32_767.0),
        (DataType::U16, &[a, b]) => (f64::from(u16::from_le_bytes([a, b])), 65_535.0),
        (DataType::U32, &[a, b, c, d]) => (f64::from(u32::from_le_bytes([a, b, c, d])), 4_294_967_295.0),
        (DataType::F32, &[a, b, c, d]) => return f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => return f64::NAN,
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_decode() {
        assert_eq!(base64("bGlnaHQ=").as_deref(), Some(&b"light"[..]));
        assert_eq!(base64("bGlnaHRz").as_deref(), Some(&b"lights"[..]));
        assert_eq!(base64("bGlna*"), None);
        assert_eq!(base64("bGlnaHQab"), None);
        assert_eq!(path("a", "my%20chair.bin").ok().as_deref(), Some("my chair.bin"));
        for refused in ["https://x/y.bin", "/etc/passwd", "a%2", "c:\\x"] {
            assert!(path("a", refused).is_err(), "{refused}");
        }
    }

    #[test]
    fn numbers_normalise_as_the_specification_says() {
        assert_eq!(number(&[255], DataType::U8, true), 1.0);
        assert_eq!(number(&[0x80], DataType::I8, true), -1.0);
        assert_eq!(number(&[0x81], DataType::I8, true), -1.0);
        assert_eq!(number(&[0x80], DataType::I8, false), -128.0);
        assert_eq!(number(&[0xff, 0x7f], DataType::I16, true), 1.0);
        assert_eq!(number(&1.5_f32.to_le_bytes(), DataType::F32, true), 1.5);
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
