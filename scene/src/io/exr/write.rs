//! Writing of one part. This module writes the blocks itself, since the parallel writer of the crate is not
//! deterministic.

use std::io::Cursor;

use exr::block::writer::ChunksWriter;
use exr::block::{UncompressedBlock, enumerate_ordered_header_block_indices};
use exr::image::write::layers::{LayersWriter, WritableLayers};
use exr::meta::attribute::Chromaticities;
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Encoding, FlatSamples, Image, Layer, LayerAttributes, Text,
    Vec2, WritableImage, f16,
};

use super::camera::CameraMatrices;
use super::planes::Channel;
use super::sorted::sort_attributes;
use crate::error::Error;
use crate::io::progress::Progress;
use crate::math::color::primaries::{Primaries, REC709};

/// Number format of a stored channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// 32-bit floats: exact.
    Float,
    /// 16-bit floats, rounded to nearest; finite values beyond 65504 become 65504.
    Half,
}

/// Number of row blocks that are compressed at a time.
const BATCH: usize = 16;

/// Largest finite 16-bit float.
const HALF_MAX: f32 = 65_504.0;

/// Writes one part whose colours have the primaries of Rec.709. `encoding` and `recipe` become the attributes
/// `lightharmony:encoding` and `comments`. Returns the bytes and the number of values beyond the range of 16-bit
/// floats.
pub fn write(
    width: usize,
    height: usize,
    channels: Vec<(Channel, Depth)>,
    encoding: &str,
    recipe: Option<&str>,
) -> Result<(Vec<u8>, u64), Error> {
    let attributes = Attributes { encoding, recipe, primaries: &REC709, camera: None, more: &[] };
    write_for(width, height, channels, attributes, Progress::UNTRACKED)
}

/// Statements of a file about its colours, its camera and its origin.
#[derive(Debug, Clone, Copy)]
pub struct Attributes<'a> {
    /// Encoding of each layer: the attribute `lightharmony:encoding`.
    pub encoding: &'a str,
    /// The graph that made the picture: the attribute `comments`.
    pub recipe: Option<&'a str>,
    /// Primaries of the colours: the attribute `chromaticities`.
    pub primaries: &'a Primaries,
    /// The camera of the picture: the attributes `worldToCamera` and `worldToNDC`.
    pub camera: Option<CameraMatrices>,
    /// Further attributes, as pairs of name and text. The text must be in ASCII.
    pub more: &'a [(String, String)],
}

/// Like [`write()`], with progress and cancellation. Blocks of rows are compressed on all threads and written in
/// order.
pub fn write_for(
    width: usize,
    height: usize,
    channels: Vec<(Channel, Depth)>,
    Attributes { encoding, recipe, primaries, camera, more }: Attributes<'_>,
    progress: Progress<'_>,
) -> Result<(Vec<u8>, u64), Error> {
    let fail = |e: exr::error::Error| Error::Mismatch(format!("cannot encode the picture as EXR: {e}"));
    let mut clamped = 0;
    let list = channels
        .into_iter()
        .map(|(Channel { name, samples }, depth)| {
            let name = Text::new_or_none(&name)
                .ok_or_else(|| Error::Mismatch(format!("`{name}` cannot be the name of an EXR channel")))?;
            let samples = match depth {
                Depth::Float => FlatSamples::F32(samples),
                Depth::Half => {
                    clamped += samples.iter().filter(|v| v.is_finite() && v.abs() >= 65_520.0).count() as u64;
                    let half = |v: f32| if v.is_finite() { v.clamp(-HALF_MAX, HALF_MAX) } else { v };
                    FlatSamples::F16(samples.into_iter().map(|v| f16::from_f32(half(v))).collect())
                }
            };
            Ok(AnyChannel::new(name, samples))
        })
        .collect::<Result<_, Error>>()?;
    // The library of OpenEXR reads texts as UTF-8; the crate would write Latin-1, or nothing.
    let comments = recipe.map(|text| Text::from_bytes_unchecked(text.bytes().collect()));
    let mut attributes = LayerAttributes {
        comments,
        world_to_camera: camera.map(|camera| camera.world_to_camera),
        world_to_normalized_device: camera.map(|camera| camera.world_to_ndc),
        ..LayerAttributes::default()
    };
    let encoding = ("lightharmony:encoding", encoding);
    let more_texts = more.iter().map(|(name, text)| (name.as_str(), text.as_str()));
    for (name, text) in [encoding].into_iter().chain(more_texts) {
        if let (Some(name), Some(text)) = (Text::new_or_none(name), Text::new_or_none(text)) {
            attributes.other.insert(name, AttributeValue::Text(text));
        }
    }
    let layer = Layer::new((width, height), attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(list));
    let mut image = Image::from_layer(layer);
    let xy = |[x, y]: [f64; 2]| Vec2(x as f32, y as f32);
    image.attributes.chromaticities = Some(Chromaticities {
        red: xy(primaries.red),
        green: xy(primaries.green),
        blue: xy(primaries.blue),
        white: xy(primaries.white),
    });
    let headers = image.write().infer_meta_data();
    let layers = image.layer_data.create_writer(&headers);
    // A block that does not get shorter is stored uncompressed.
    let plain = width * height * headers.iter().map(|header| header.channels.bytes_per_pixel).sum::<usize>();
    let mut bytes = Cursor::new(Vec::with_capacity(plain + height * 8 + (1 << 16)));
    exr::block::write(&mut bytes, headers, true, |meta, to| {
        let stopped = |e: Error| exr::error::Error::Invalid(e.to_string().into());
        let blocks: Vec<_> = enumerate_ordered_header_block_indices(&meta.headers).collect();
        for (at, batch) in blocks.chunks(BATCH).enumerate() {
            progress.report((at * BATCH) as f32 / blocks.len() as f32).map_err(stopped)?;
            let packed = progress.tiles(batch.len(), |i| {
                let index = batch[i].1;
                let data = layers.extract_uncompressed_block(&meta.headers, index);
                UncompressedBlock { index, data }.compress_to_chunk(&meta.headers)
            });
            for ((place, _), chunk) in batch.iter().zip(packed.map_err(stopped)?) {
                to.write_chunk(*place, chunk?)?;
            }
        }
        Ok(())
    })
    .map_err(fail)?;
    let mut bytes = bytes.into_inner();
    // The crate writes other attributes in the order of a seeded hash, which is unique for one attribute.
    if !more.is_empty() {
        sort_attributes(&mut bytes);
    }
    bytes.shrink_to_fit();
    Ok((bytes, clamped))
}
