//! glTF with `KHR_gaussian_splatting` (Khronos, 2025): splats are the points of mesh primitives, transformed by the
//! nodes that use them. The file is GLB, or JSON with external or embedded buffers. The compression extension
//! `KHR_gaussian_splatting_compression_spz_2` is an SPZ file in a buffer view.
//!
//! glTF is y-up and in metres, so splats are rotated and scaled in the same way as objects.

use std::collections::BTreeMap;

use engine::{NodeError, Notes, Up};
use glam::{DMat3, DMat4, DVec3};
use serde::Deserialize;

use super::accessor::{Accessor, Reader};
use super::bytes::{range, u32_at};
use super::frame::Turn;
use super::loaded::Loaded;
use super::parts::RowChunk;
use super::reading::{Fetch, Reading};
use super::rows::{Row, sh_rest};
use super::spz;
use crate::error::Error;
use crate::io::base64;
use crate::io::foreign::json_text;
use crate::io::gltf::address;
use crate::math::num;
use crate::types::SplatEncoding;
use crate::types::frame::Similarity;

const NAME: &str = "KHR_gaussian_splatting";
const SPZ: [&str; 2] = ["KHR_gaussian_splatting_compression_spz_2", "KHR_gaussian_splatting_compression_spz"];

/// First bytes of a GLB file.
pub(super) const MAGIC: &[u8; 4] = b"glTF";

/// The parts of a glTF file that splats need.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    scene: Option<usize>,
    #[serde(default)]
    scenes: Vec<Scene>,
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    meshes: Vec<Mesh>,
    #[serde(default)]
    accessors: Vec<Accessor>,
    #[serde(default)]
    buffer_views: Vec<BufferView>,
    #[serde(default)]
    buffers: Vec<Buffer>,
    #[serde(default)]
    extensions_required: Vec<String>,
}

#[derive(Deserialize)]
struct Scene {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

impl Node {
    fn matrix(&self) -> DMat4 {
        if let Some(matrix) = self.matrix {
            return DMat4::from_cols_array(&matrix);
        }
        let [x, y, z, w] = self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let [sx, sy, sz] = self.scale.unwrap_or([1.0; 3]);
        let columns = [
            DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)) * sx,
            DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)) * sy,
            DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)) * sz,
        ];
        let offset = DVec3::from(self.translation.unwrap_or_default());
        DMat4::from_cols(
            columns[0].extend(0.0),
            columns[1].extend(0.0),
            columns[2].extend(0.0),
            offset.extend(1.0),
        )
    }
}

#[derive(Deserialize)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    mode: Option<u32>,
    #[serde(default)]
    extensions: BTreeMap<String, serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Splatting {
    kernel: Option<String>,
    color_space: Option<String>,
    sorting_method: Option<String>,
    projection: Option<String>,
    #[serde(default)]
    extensions: BTreeMap<String, serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferView {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

#[derive(Deserialize)]
struct Buffer {
    uri: Option<String>,
}

impl Document {
    /// Reads the JSON of a file.
    pub fn read(file: &str, json: &[u8]) -> Result<Self, Error> {
        serde_json::from_slice(json_text(json)).map_err(|e| Error::format(file, format!("not glTF: {e}")))
    }

    /// Names of the external files that contain the buffers of the document.
    pub fn files(&self, file: &str) -> Result<Vec<String>, Error> {
        let uris = self.buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
        uris.filter(|uri| !uri.starts_with("data:")).map(|uri| address::path(file, uri)).collect()
    }
}

/// Splits a GLB file (glTF 2.0, section 4.4) into the JSON and the optional binary chunk.
pub(super) fn chunks<'a>(file: &str, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>), Error> {
    let head = range(file, bytes, 0, 20, "the header")?;
    if u32_at(head, 4) != 2 {
        return Err(Error::unsupported(file, format!("version {} of GLB", u32_at(head, 4))));
    }
    if &head[16..20] != b"JSON" {
        return Err(Error::format(file, "the first chunk of the GLB file is not JSON"));
    }
    let json = range(file, bytes, 20, u32_at(head, 12) as usize, "the JSON chunk")?;
    let at = 20 + json.len();
    if bytes.len() <= at {
        return Ok((json, None));
    }
    let head = range(file, bytes, at, 8, "the header of a chunk")?;
    let binary = range(file, bytes, at + 8, u32_at(head, 0) as usize, "the binary chunk")?;
    Ok((json, (&head[4..8] == b"BIN\0").then_some(binary)))
}

/// A primitive, with the transform of a node that uses it.
struct Use<'a> {
    primitive: &'a Primitive,
    splatting: Splatting,
    matrix: DMat4,
}

impl Document {
    /// The splat primitives of the scene, in the order of its nodes, depth first.
    fn uses(&self, file: &str) -> Result<Vec<Use<'_>>, Error> {
        let wrong = |what: &str| Error::format(file, what);
        let roots: Vec<usize> = match (self.scene, self.scenes.first()) {
            (Some(scene), _) => self
                .scenes
                .get(scene)
                .ok_or_else(|| wrong("`scene` refers to a scene that does not exist"))?
                .nodes
                .clone(),
            (None, Some(first)) => first.nodes.clone(),
            (None, None) => (0..self.nodes.len()).collect(),
        };
        let mut uses = Vec::new();
        let mut open: Vec<(usize, DMat4)> = roots.iter().rev().map(|node| (*node, DMat4::IDENTITY)).collect();
        let mut visits = 0;
        while let Some((index, above)) = open.pop() {
            visits += 1;
            if visits > self.nodes.len() {
                return Err(wrong("a node appears twice in the hierarchy; nodes must form trees"));
            }
            let node = self
                .nodes
                .get(index)
                .ok_or_else(|| wrong("the hierarchy refers to a node that does not exist"))?;
            let matrix = above * node.matrix();
            if let Some(mesh) = node.mesh {
                let mesh = self
                    .meshes
                    .get(mesh)
                    .ok_or_else(|| wrong("a node refers to a mesh that does not exist"))?;
                for primitive in &mesh.primitives {
                    let Some(splatting) = primitive.extensions.get(NAME) else { continue };
                    let splatting = Splatting::deserialize(splatting)
                        .map_err(|e| Error::format(file, format!("{NAME}: {e}")))?;
                    uses.push(Use { primitive, splatting, matrix });
                }
            }
            open.extend(node.children.iter().rev().map(|child| (*child, matrix)));
        }
        Ok(uses)
    }

    fn view<'a>(&self, file: &str, index: usize, buffers: &'a [Vec<u8>]) -> Result<&'a [u8], Error> {
        let view = self.buffer_views.get(index);
        let view = view.ok_or_else(|| Error::format(file, format!("buffer view {index} does not exist")))?;
        let buffer = buffers.get(view.buffer);
        let buffer =
            buffer.ok_or_else(|| Error::format(file, format!("buffer {} does not exist", view.buffer)))?;
        range(file, buffer, view.byte_offset, view.byte_length, &format!("buffer view {index}"))
    }

    fn reader<'a>(&self, file: &str, index: usize, buffers: &'a [Vec<u8>]) -> Result<Reader<'a>, Error> {
        let accessor = self.accessors.get(index);
        let accessor =
            accessor.ok_or_else(|| Error::format(file, format!("accessor {index} does not exist")))?;
        let view = accessor.view(file)?;
        let stride = self.buffer_views.get(view).and_then(|view| view.byte_stride);
        accessor.reader(file, self.view(file, view, buffers)?, stride)
    }
}

/// Loads a GLB file, or glTF as JSON, in which case `fetch` reads the external files.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    fetch: &Fetch<'_>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let (json, binary) = if bytes.starts_with(MAGIC) { chunks(file, bytes)? } else { (bytes, None) };
    let document = Document::read(file, json)?;
    let known =
        |name: &String| name == NAME || SPZ.contains(&name.as_str()) || name == "KHR_mesh_quantization";
    if let Some(other) = document.extensions_required.iter().find(|name| !known(name)) {
        return Err(Error::unsupported(file, format!("the glTF extension `{other}`")).into());
    }
    let uses = document.uses(file)?;
    if uses.is_empty() {
        let what = format!("no primitive of the scene has `{NAME}`; is the file a mesh?");
        return Err(
            NodeError::from(Error::format(file, what)).hint("`load-mesh` and `load-object` read meshes")
        );
    }
    let mut buffers = Vec::new();
    for buffer in &document.buffers {
        buffers.push(match buffer.uri.as_deref() {
            None => binary.unwrap_or_default().to_vec(),
            Some(uri) => match uri.strip_prefix("data:") {
                Some(data) => {
                    let encoded = data.split_once(";base64,").map(|(_, encoded)| encoded);
                    encoded
                        .and_then(base64::decode)
                        .ok_or_else(|| Error::format(file, "a data URI is not valid base64"))?
                }
                None => fetch(uri)?,
            },
        });
    }
    let world = reading.world(file, Some(Up::PlusY), true, notes);
    let world = world.unwrap_or(Similarity::IDENTITY);
    let mut all: Option<Loaded> = None;
    for (number, one) in uses.iter().enumerate() {
        let linear = world.rotation * DMat3::from_mat4(one.matrix) * world.scale;
        let offset = world.point(one.matrix.w_axis.truncate());
        let turn = if linear == DMat3::IDENTITY && offset == DVec3::ZERO {
            None
        } else {
            let turn = Turn::of_linear(linear, offset).ok_or_else(|| {
                let feature = format!("splats scaled unevenly by their node (primitive {number})");
                Error::unsupported(file, feature)
            })?;
            Some(turn)
        };
        let first = all.as_ref().map_or(0, |all| all.count);
        let mut loaded = primitive(file, &document, one, &buffers, first, turn.as_ref(), reading, notes)?;
        loaded.encoding = encoding(file, &one.splatting)?;
        all = Some(match all {
            None => loaded,
            Some(before) => before.join(file, loaded)?,
        });
    }
    all.ok_or_else(|| Error::format(file, "the file has no splats").into())
}

/// The encoding of the colours. It is an error if the file requires settings that are not supported.
fn encoding(file: &str, splatting: &Splatting) -> Result<SplatEncoding, Error> {
    for (what, reported, done) in
        [("kernel", &splatting.kernel, "ellipse"), ("projection", &splatting.projection, "perspective")]
    {
        if let Some(reported) = reported.as_deref().filter(|reported| *reported != done) {
            return Err(Error::unsupported(file, format!("the {what} `{reported}` of {NAME}")));
        }
    }
    match splatting.color_space.as_deref() {
        None | Some("srgb_rec709_display" | "BT.709-sRGB") => Ok(SplatEncoding::Srgb),
        Some("lin_rec709_display" | "BT.709-linear") => Ok(SplatEncoding::Linear),
        Some(other) => Err(Error::unsupported(file, format!("the colour space `{other}` of {NAME}"))),
    }
}

#[expect(
    clippy::too_many_arguments,
    reason = "called once; a struct would only repeat the names of the arguments"
)]
fn primitive(
    file: &str,
    document: &Document,
    one: &Use<'_>,
    buffers: &[Vec<u8>],
    first: usize,
    turn: Option<&Turn>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    if one.primitive.mode != Some(0) {
        return Err(Error::format(
            file,
            format!("a primitive with {NAME} does not consist of points (mode 0)"),
        )
        .into());
    }
    if first == 0 {
        match one.splatting.sorting_method.as_deref() {
            // The default of the extension.
            None | Some("cameraDistance") => {
                let text =
                    format!("`{file}` was made for sorting by distance; use `SplatRender(sort: Distance)`");
                notes.decision("sorting-method", text);
            }
            Some(other) => {
                let text = format!("`{file}` requires the sorting method `{other}`, which is unknown");
                notes.warning("sorting-method", text);
            }
        }
    }
    if let Some(packed) = SPZ.iter().find_map(|name| one.splatting.extensions.get(*name)) {
        let view = packed.get("bufferView").and_then(serde_json::Value::as_u64);
        let view = view
            .ok_or_else(|| Error::format(file, "the SPZ compression extension refers to no buffer view"))?;
        let bytes = document.view(file, usize::try_from(view).unwrap_or(usize::MAX), buffers)?;
        return spz::load(file, bytes, Some(turn), reading, notes);
    }
    if let Some(other) = one.splatting.extensions.keys().next() {
        return Err(Error::unsupported(file, format!("the glTF extension `{other}`")).into());
    }
    let find = |name: &str| one.primitive.attributes.get(name).copied();
    let need = |name: &str, width: usize| {
        let index = find(name);
        let index =
            index.ok_or_else(|| Error::format(file, format!("the splats have no attribute `{name}`")))?;
        let reader = document.reader(file, index, buffers)?;
        if reader.width() != width {
            let what = format!("the number of components of `{name}` is {}, not {width}", reader.width());
            return Err(Error::format(file, what));
        }
        Ok(reader)
    };
    let centres = need("POSITION", 3)?;
    let rotations = need(&format!("{NAME}:ROTATION"), 4)?;
    let scales = need(&format!("{NAME}:SCALE"), 3)?;
    let opacities = need(&format!("{NAME}:OPACITY"), 1)?;
    let coefficient = |l: u32, n: u32| format!("{NAME}:SH_DEGREE_{l}_COEF_{n}");
    // The specification ends at degree 3; degree 4 is read if it is stored in the same way.
    let degree = (1..=4).take_while(|l| find(&coefficient(*l, 0)).is_some()).last().unwrap_or(0);
    let names = (0..=degree).flat_map(|l| (0..2 * l + 1).map(move |n| (l, n)));
    let harmonics = names.map(|(l, n)| need(&coefficient(l, n), 3)).collect::<Result<Vec<_>, _>>()?;
    debug_assert_eq!(harmonics.len(), sh_rest(degree) + 1);
    let count = centres.count();
    let others = harmonics.iter().chain([&rotations, &scales, &opacities]);
    if others.clone().any(|reader| reader.count() != count) {
        return Err(
            Error::format(file, "the attributes of the splats have different numbers of elements").into()
        );
    }
    // Lengths are never negative; drafts of the extension stored logarithms here (KhronosGroup/glTF#2563).
    let below = (0..count).filter(|&index| (0..3).any(|k| scales.get(index, k) < 0.0)).count();
    let logarithms = below > count / 20;
    if logarithms {
        let text = format!(
            "{below} of {count} splats of `{file}` have a negative scale, so scales are read as logarithms, as in drafts of {NAME}"
        );
        notes.warning("logarithmic-scales", text);
    }
    let length = |scale: f64| if logarithms { num::f64::exp(scale) } else { scale };
    let parts: Vec<RowChunk> = reading.rows_from(first, count, turn, |index, sh| {
        let three = |reader: &Reader<'_>| [0, 1, 2].map(|i| reader.get(index, i));
        let [x, y, z, w] = [0, 1, 2, 3].map(|i| rotations.get(index, i));
        sh.extend(harmonics.iter().map(|reader| three(reader).map(|v| v as f32)));
        let opacity = opacities.get(index, 0);
        let scale = three(&scales).map(length);
        Row::checked(three(&centres), [w, x, y, z], scale, opacity, reading.max_extent)
    })?;
    Ok(Loaded::new(parts, count, degree))
}
