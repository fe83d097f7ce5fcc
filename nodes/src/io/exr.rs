//! OpenEXR: reading the first flat part as named f32 channels, and writing one part of named channels, with
//! reproducible bytes. Written by blocks here, since the parallel writer of the crate is not deterministic.

use std::io::Cursor;

use exr::block::writer::ChunksWriter;
use exr::block::{UncompressedBlock, enumerate_ordered_header_block_indices};
use exr::image::write::layers::{LayersWriter, WritableLayers};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, MetaData, ReadChannels,
    ReadLayers, Text, WritableImage, f16,
};

use super::png::believable;
use super::progress::{Progress, TrackedReader};
use crate::error::Error;

/// One plane of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// Full name in the file: `R`, `R0.G`, `Z`.
    pub name: String,
    /// `width * height` numbers, row by row.
    pub samples: Vec<f32>,
}

/// A decoded file, cropped or padded with zeros to its display window.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes {
    /// Columns of the display window.
    pub width: usize,
    /// Rows of the display window.
    pub height: usize,
    /// Sorted by name, as the format requires.
    pub channels: Vec<Channel>,
    /// Number of parts in the file; only the first flat one is read.
    pub parts: usize,
    /// True when the data window is not the display window.
    pub cropped: bool,
    /// x and y of red, green, blue and white, if the file has chromaticities.
    pub primaries: Option<[[f32; 2]; 4]>,
}

/// x and y of red, green, blue and white of sRGB (Rec. ITU-R BT.709), the default of files without chromaticities.
const REC_709: [[f32; 2]; 4] = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]];

impl Planes {
    /// True if the chromaticities of the file differ from those of sRGB by more than rounding.
    pub fn other_primaries(&self) -> bool {
        let off = |own: &[[f32; 2]; 4]| {
            own.as_flattened()
                .iter()
                .zip(REC_709.as_flattened())
                .any(|(a, b)| (a - b).abs().total_cmp(&2e-3).is_gt())
        };
        self.primaries.as_ref().is_some_and(off)
    }

    /// A channel by its full name.
    pub fn find(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.name == name).map(|channel| channel.samples.as_slice())
    }
}

/// Reads half, float and whole-number channels.
pub fn read(file: &str, bytes: &[u8]) -> Result<Planes, Error> {
    read_for(file, bytes, Progress::UNTRACKED)
}

/// The same with progress and cancellation.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Planes, Error> {
    let bad = |e: exr::error::Error| match e {
        exr::error::Error::NotSupported(what) => Error::unsupported(file, what.into_owned()),
        other => Error::format(file, format!("not a complete EXR: {other}")),
    };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(bad)?;
    let Some(header) = meta.headers.iter().find(|header| !header.deep) else {
        return Err(Error::unsupported(file, "deep data"));
    };
    // The largest compression ratio found in a valid file is that of a black PIZ one.
    for header in &meta.headers {
        let (size, planes) = (header.layer_size, header.channels.list.len() as u64);
        believable(file, size.0 as u64, size.1 as u64, planes, bytes.len(), 1 << 15)?;
        if header.channels.list.iter().any(|channel| channel.sampling.0 != 1 || channel.sampling.1 != 1) {
            return Err(Error::unsupported(file, "subsampled channels (luminance and chroma)"));
        }
    }
    let window = header.shared_attributes.display_window;
    let (width, height) = (window.size.0, window.size.1);
    believable(file, width as u64, height as u64, 1, bytes.len(), 1 << 16)?;

    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(TrackedReader::new(bytes, progress))
        .map_err(bad)?;
    let layer = image.layer_data;
    let (size, position) = (layer.size, layer.attributes.layer_position);
    let shift = [
        i64::from(position.0) - i64::from(window.position.0),
        i64::from(position.1) - i64::from(window.position.1),
    ];
    let cropped = shift != [0, 0] || (size.0, size.1) != (width, height);
    let mut channels = Vec::with_capacity(layer.channel_data.list.len());
    for channel in layer.channel_data.list {
        // Floats are moved; others are freed once they are converted to floats.
        let data: Vec<f32> = match channel.sample_data {
            FlatSamples::F32(samples) => samples,
            other => other.values_as_f32().collect(),
        };
        if data.len() != size.0 * size.1 {
            return Err(Error::format(file, "a channel of another size than the part"));
        }
        let samples = if cropped { place(&data, size.0, shift, width, height) } else { data };
        channels.push(Channel { name: channel.name.to_string(), samples });
    }
    let primaries = header
        .shared_attributes
        .chromaticities
        .map(|found| [found.red, found.green, found.blue, found.white].map(|exr::math::Vec2(x, y)| [x, y]));
    Ok(Planes { width, height, channels, parts: meta.headers.len(), cropped, primaries })
}

/// Copies rows of `data` to their position in the display window.
fn place(data: &[f32], columns: usize, [dx, dy]: [i64; 2], width: usize, height: usize) -> Vec<f32> {
    let mut out = vec![0.0; width * height];
    for (y, row) in data.chunks_exact(columns.max(1)).enumerate() {
        let Some(y) = usize::try_from(y as i64 + dy).ok().filter(|y| *y < height) else { continue };
        for (x, value) in row.iter().enumerate() {
            if let Some(x) = usize::try_from(x as i64 + dx).ok().filter(|x| *x < width) {
                out[y * width + x] = *value;
            }
        }
    }
    out
}

/// Interleaves planes of equal size, in their order.
///
/// # Errors
/// [`Error::Stopped`].
pub fn interleaved(planes: &[&[f32]], progress: Progress<'_>) -> Result<Vec<f32>, Error> {
    let pixels = planes.first().map_or(0, |plane| plane.len());
    let mut samples = Vec::with_capacity(pixels * planes.len());
    for start in (0..pixels).step_by(1 << 18) {
        progress.report(1.0)?;
        for i in start..pixels.min(start + (1 << 18)) {
            samples.extend(planes.iter().map(|plane| plane[i]));
        }
    }
    Ok(samples)
}

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

/// Largest finite half.
const HALF_MAX: f32 = 65_504.0;

/// Writes one part. `encoding` and `recipe` become the attributes `lightharmony:encoding` and `comments`. Returns
/// the bytes and the number of values that did not fit into a half.
pub fn write(
    width: usize,
    height: usize,
    channels: Vec<(Channel, Depth)>,
    encoding: &str,
    recipe: Option<&str>,
) -> Result<(Vec<u8>, u64), Error> {
    write_for(width, height, channels, encoding, recipe, Progress::UNTRACKED)
}

/// The same with progress and cancellation. Blocks of rows are compressed on all threads and written in order.
pub fn write_for(
    width: usize,
    height: usize,
    channels: Vec<(Channel, Depth)>,
    encoding: &str,
    recipe: Option<&str>,
    progress: Progress<'_>,
) -> Result<(Vec<u8>, u64), Error> {
    let fail = |e: exr::error::Error| Error::Mismatch(format!("cannot make an EXR: {e}"));
    let mut clamped = 0;
    let list = channels
        .into_iter()
        .map(|(Channel { name, samples }, depth)| {
            let name = Text::new_or_none(&name)
                .ok_or_else(|| Error::Mismatch(format!("`{name}` cannot name an EXR channel")))?;
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
    let comments = recipe.and_then(Text::new_or_none);
    let mut attributes = LayerAttributes { comments, ..LayerAttributes::default() };
    // One attribute only: the crate writes this map in the order of a seeded hash.
    if let Some(text) = Text::new_or_none(encoding) {
        attributes
            .other
            .insert(Text::from("lightharmony:encoding"), exr::prelude::AttributeValue::Text(text));
    }
    let layer = Layer::new((width, height), attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(list));
    let image = Image::from_layer(layer);
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
    bytes.shrink_to_fit();
    Ok((bytes, clamped))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::row;

    fn planes(depth: Depth) -> Vec<(Channel, Depth)> {
        let plane = |name: &str, k: f32| {
            let samples = (0..35).map(|i| i as f32 * k).collect();
            (Channel { name: name.to_owned(), samples }, depth)
        };
        vec![plane("R", 0.5), plane("G", 1.0), plane("B", -2.0), plane("R0.R", 0.25), plane("Z", 8.0)]
    }

    #[test]
    fn named_planes_come_back_exactly_and_bytes_repeat() {
        for depth in [Depth::Float, Depth::Half] {
            let make =
                || write(7, 5, planes(depth), "R=linear", Some("(recipe)")).unwrap_or_else(|e| panic!("{e}"));
            let (bytes, clamped) = make();
            assert_eq!(clamped, 0);
            for _ in 0..4 {
                assert_eq!(make().0, bytes);
            }
            let back = read("a.exr", &bytes).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!((back.width, back.height, back.parts, back.cropped), (7, 5, 1, false));
            for (channel, _) in planes(depth) {
                assert_eq!(back.find(&channel.name), Some(channel.samples.as_slice()), "{}", channel.name);
            }
            assert!(bytes.windows(8).any(|w| w == b"(recipe)"));
        }
    }

    /// Blocks compressed in parallel equal those that the library writes sequentially.
    #[test]
    fn blocks_give_the_bytes_of_the_whole_picture() {
        let plane = |name: &str, k: usize| {
            let samples = (0..70 * 700).map(|i| ((i * 7919 * k) % 1013) as f32).collect();
            (Channel { name: name.to_owned(), samples }, Depth::Float)
        };
        let (bytes, _) = write(70, 700, vec![plane("R", 1), plane("Z", 3)], "", Some("a recipe"))
            .unwrap_or_else(|e| panic!("{e}"));
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(&bytes))
            .unwrap_or_else(|e| panic!("{e}"));
        let mut again = Cursor::new(Vec::new());
        image.write().non_parallel().to_buffered(&mut again).unwrap_or_else(|e| panic!("{e}"));
        assert!(again.into_inner() == bytes);
    }

    #[test]
    fn halves_round_to_nearest_and_never_overflow_silently() {
        let samples = vec![65_504.0, 65_519.99, 65_520.0, 1e5, 6e-5, 6e-8, -1e9, f32::INFINITY];
        let (bytes, clamped) =
            write(8, 1, vec![(Channel { name: "R".into(), samples }, Depth::Half)], "", None)
                .unwrap_or_else(|e| panic!("{e}"));
        row(62, "finite values beyond a half that are not counted", 3.0 - clamped as f64, 0.0);
        let back = read("a.exr", &bytes).unwrap_or_else(|e| panic!("{e}"));
        let r = back.find("R").unwrap_or_default();
        row(62, "error of 6e-8, half of the least half", f64::from((r[5] - 6e-8).abs()), 3e-8);
        assert_eq!(r[..4], [65_504.0; 4]);
        assert_eq!(r[4], f16::from_f32(6e-5).to_f32());
        assert_eq!(r[6..], [-65_504.0, f32::INFINITY]);
    }

    /// Halves and floats in one file; NaN and infinity are kept, and a picture without pixels is refused.
    #[test]
    fn types_mix_and_what_is_no_number_comes_through() {
        let odd = vec![f32::NAN, f32::INFINITY, -0.0, 1e-40];
        let channel = |name: &str, samples: &[f32]| Channel { name: name.into(), samples: samples.to_vec() };
        let channels =
            vec![(channel("Z", &odd), Depth::Float), (channel("A", &[0.5, 1.0, 0.25, 0.0]), Depth::Half)];
        let (bytes, _) = write(2, 2, channels, "", None).unwrap_or_else(|e| panic!("{e}"));
        let back = read("a.exr", &bytes).unwrap_or_else(|e| panic!("{e}"));
        let bits = |samples: &[f32]| samples.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(back.find("Z").map(bits), Some(bits(&odd)));
        assert_eq!(back.find("A"), Some(&[0.5, 1.0, 0.25, 0.0][..]));
        let none = write(0, 0, vec![(channel("Z", &[]), Depth::Float)], "", None);
        assert!(none.map_or(true, |(bytes, _)| read("a.exr", &bytes).is_err()));
    }

    /// Chromaticities of a file are read; those of sRGB, with usual rounding, do not count as different. Mutation:
    /// `off` with `all` for `any`.
    #[test]
    fn chromaticities_of_other_colours_are_distinguished() {
        use exr::meta::attribute::Chromaticities;
        let read_with = |green: Option<(f32, f32)>| {
            let at = |[x, y]: [f32; 2]| exr::math::Vec2(x, y);
            let [red, own, blue, white] = REC_709.map(at);
            let list = ["R", "G", "B"].map(|name| AnyChannel::new(name, FlatSamples::F32(vec![0.5; 2])));
            let layer = Layer::new(
                (2, 1),
                LayerAttributes::default(),
                Encoding::UNCOMPRESSED,
                AnyChannels::sort(list.into_iter().collect()),
            );
            let mut image = Image::from_layer(layer);
            image.attributes.chromaticities =
                green.map(|(x, y)| Chromaticities { red, green: at([own.0 + x, own.1 + y]), blue, white });
            let mut bytes = Cursor::new(Vec::new());
            image.write().non_parallel().to_buffered(&mut bytes).unwrap_or_else(|e| panic!("{e}"));
            read("a.exr", &bytes.into_inner()).unwrap_or_else(|e| panic!("{e}")).other_primaries()
        };
        assert!(!read_with(None) && !read_with(Some((0.0, 0.0))) && !read_with(Some((1e-3, -1e-3))));
        // Rec. ITU-R BT.2020 has its green at (0.170, 0.797).
        assert!(read_with(Some((-0.13, 0.197))) && read_with(Some((0.0, f32::NAN))));
    }

    /// The first flat part of several is read, with its channels of each type, and the number of parts is reported.
    #[test]
    fn the_first_of_several_parts_is_read() {
        let part = |name: &str, size: (usize, usize), channels| {
            let attributes = LayerAttributes::named(name);
            Layer::new(size, attributes, Encoding::UNCOMPRESSED, AnyChannels::sort(channels))
        };
        let half = FlatSamples::F16([0.5, 2.0].map(f16::from_f32).to_vec());
        let first = [
            AnyChannel::new("R", half),
            AnyChannel::new("G", FlatSamples::F32(vec![0.1, -0.0])),
            AnyChannel::new("id", FlatSamples::U32(vec![7, 1 << 24])),
        ];
        let second = [AnyChannel::new("Z", FlatSamples::F32(vec![9.0; 6]))];
        let parts = vec![
            part("a", (2, 1), first.into_iter().collect()),
            part("b", (3, 2), second.into_iter().collect()),
        ];
        let window = exr::prelude::IntegerBounds::from_dimensions((2, 1));
        let image = Image::from_layers(exr::prelude::ImageAttributes::new(window), parts);
        let mut bytes = Cursor::new(Vec::new());
        image.write().non_parallel().to_buffered(&mut bytes).expect("writes");
        let back = read("a.exr", bytes.get_ref()).expect("reads");
        assert_eq!((back.width, back.height, back.parts, back.cropped), (2, 1, 2, false));
        assert_eq!(back.find("R"), Some(&[0.5, 2.0][..]));
        assert_eq!(back.find("G"), Some(&[0.1, -0.0][..]));
        assert_eq!(back.find("id"), Some(&[7.0, 16_777_216.0][..]));
        assert_eq!(back.find("Z"), None);
    }

    #[test]
    fn a_cropped_data_window_lands_in_its_place() {
        let data = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(place(&data, 2, [1, 0], 3, 2), [0.0, 1.0, 2.0, 0.0, 3.0, 4.0]);
        assert_eq!(place(&data, 2, [-1, -1], 2, 2), [4.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn no_cut_or_flip_panics_and_every_cut_is_an_error() {
        let (bytes, _) =
            write(7, 5, planes(Depth::Float), "R=linear", None).unwrap_or_else(|e| panic!("{e}"));
        for end in 0..bytes.len() {
            assert!(read("a.exr", &bytes[..end]).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() * 8 {
            let mut hurt = bytes.clone();
            hurt[at / 8] ^= 1 << (at % 8);
            drop(read("a.exr", &hurt));
        }
    }
}
