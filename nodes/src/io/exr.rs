//! OpenEXR: reading one flat part as named f32 channels, and writing one part of named channels, with reproducible
//! bytes. This module writes the blocks itself, since the parallel writer of the crate is not deterministic.

use std::io::Cursor;

use exr::block::chunk::TileCoordinates;
use exr::block::writer::ChunksWriter;
use exr::block::{UncompressedBlock, enumerate_ordered_header_block_indices};
use exr::compression::Compression;
use exr::image::read::layers::{ChannelsReader, ReadChannels};
use exr::image::write::layers::{LayersWriter, WritableLayers};
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, MetaData, ReadLayers,
    Text, WritableImage, f16,
};

use super::png::believable;
use super::progress::{Progress, TrackedReader};
use crate::error::Error;

/// A channel of numbers.
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
    /// Number of parts in the file; one of them is read.
    pub parts: usize,
    /// Name of the part that was read; empty if it has no name.
    pub part: String,
    /// Names of all flat parts that have one.
    pub part_names: Vec<String>,
    /// Name of the layer within the part; empty for channels whose names have no layer.
    pub layer: String,
    /// True if the data window differs from the display window.
    pub cropped: bool,
    /// The chromaticities: x and y of red, green, blue and white; `None` if the file has none.
    pub primaries: Option<[[f32; 2]; 4]>,
}

/// The chromaticities of sRGB (Rec. ITU-R BT.709), which are the default for files without chromaticities: x and y
/// of red, green, blue and white.
const REC_709: [[f32; 2]; 4] = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]];

/// True if chromaticities differ from those of sRGB by more than rounding; false for `None`.
pub fn differ_from_srgb(primaries: Option<&[[f32; 2]; 4]>) -> bool {
    let off = |own: &[[f32; 2]; 4]| {
        own.as_flattened()
            .iter()
            .zip(REC_709.as_flattened())
            .any(|(a, b)| (a - b).abs().total_cmp(&2e-3).is_gt())
    };
    primaries.is_some_and(off)
}

impl Planes {
    /// True if the chromaticities of the file differ from those of sRGB by more than rounding.
    pub fn other_primaries(&self) -> bool {
        differ_from_srgb(self.primaries.as_ref())
    }

    /// Returns a channel by its full name.
    pub fn find(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.name == name).map(|channel| channel.samples.as_slice())
    }
}

/// Reads a file with channels of 16-bit floats, 32-bit floats or integers.
pub fn read(file: &str, bytes: &[u8]) -> Result<Planes, Error> {
    read_for(file, bytes, Progress::UNTRACKED)
}

/// Like [`read`], with progress and cancellation.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Planes, Error> {
    read_layer(file, bytes, "", progress)
}

/// Name of the part of a header.
fn part_name(header: &Header) -> String {
    header.own_attributes.layer_name.as_ref().map_or_else(String::new, ToString::to_string)
}

/// True if a part has colour channels without a layer name, or a single grey channel.
fn has_colours(header: &Header) -> bool {
    let has = |name: &str| header.channels.list.iter().any(|channel| channel.name.eq(name));
    let all = |names: [&str; 3]| names.into_iter().all(has);
    all(["R", "G", "B"]) || all(["r", "g", "b"]) || has("Y")
}

/// The part of a file that contains a layer, and the name of the layer within the part. An empty name selects the
/// first flat part with colours or, if no part has colours, the first flat part. Any other name is the name of a
/// layer in any part, the name of a part, or both, separated by a dot or a slash.
pub fn choose_part<'a>(headers: &'a [Header], layer: &str) -> Option<(&'a Header, String)> {
    let flat = || headers.iter().filter(|header| !header.deep);
    let first = flat().next()?;
    if layer.is_empty() {
        return Some((flat().find(|header| has_colours(header)).unwrap_or(first), String::new()));
    }
    let holds = |header: &&Header, name: &str| {
        let channels = header.channels.list.iter().map(|channel| channel.name.to_string());
        channels.into_iter().any(|channel| {
            channel == name || channel.strip_prefix(name).is_some_and(|rest| rest.starts_with('.'))
        })
    };
    if let Some(header) = flat().find(|header| holds(header, layer)) {
        return Some((header, layer.to_owned()));
    }
    for header in flat() {
        let name = part_name(header);
        let Some(rest) = layer.strip_prefix(&*name).filter(|_| !name.is_empty()) else { continue };
        if let [only] = &*header.channels.list
            && rest.is_empty()
        {
            return Some((header, only.name.to_string()));
        }
        if rest.is_empty() {
            return Some((header, String::new()));
        }
        if let Some(rest) = rest.strip_prefix(['.', '/'])
            && holds(&header, rest)
        {
            return Some((header, rest.to_owned()));
        }
    }
    Some((first, layer.to_owned()))
}

/// A file whose headers have been read.
pub struct Opened<'a> {
    file: &'a str,
    bytes: &'a [u8],
    meta: MetaData,
    /// Index of the part that holds the layer.
    index: usize,
    /// Name of the layer within the part; empty for channels whose names have no layer.
    pub layer: String,
}

/// Reads the headers of a file and chooses the part that holds a layer; see [`choose_part`].
///
/// # Errors
/// If a header is invalid, or the part is not supported.
pub fn open<'a>(file: &'a str, bytes: &'a [u8], layer: &str) -> Result<Opened<'a>, Error> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|e| broken(file, e))?;
    let Some((header, layer)) = choose_part(&meta.headers, layer) else {
        return Err(Error::unsupported(file, "deep data"));
    };
    if matches!(header.compression, Compression::HTJ2K32 | Compression::HTJ2K256) {
        return Err(Error::unsupported(file, "HTJ2K compression; save the picture with ZIP or PIZ"));
    }
    // The largest compression ratio found in a valid file is that of a black picture with PIZ compression.
    for header in &meta.headers {
        let (size, planes) = (header.layer_size, header.channels.list.len() as u64);
        believable(file, size.0 as u64, size.1 as u64, planes, bytes.len(), 1 << 15)?;
    }
    if header.channels.list.iter().any(|channel| channel.sampling.0 != 1 || channel.sampling.1 != 1) {
        return Err(Error::unsupported(file, "subsampled channels (luminance and chroma)"));
    }
    let window = header.shared_attributes.display_window.size;
    believable(file, window.0 as u64, window.1 as u64, 1, bytes.len(), 1 << 16)?;
    let index = meta.headers.iter().position(|other| std::ptr::eq(other, header)).unwrap_or(0);
    Ok(Opened { file, bytes, meta, index, layer })
}

/// Error for a file that the decoder rejects.
fn broken(file: &str, error: exr::error::Error) -> Error {
    match error {
        exr::error::Error::NotSupported(what) => Error::unsupported(file, what.into_owned()),
        other => Error::format(file, format!("not a complete EXR: {other}")),
    }
}

impl Opened<'_> {
    fn header(&self) -> &Header {
        &self.meta.headers[self.index]
    }

    /// Columns and rows of the display window.
    pub fn size(&self) -> (usize, usize) {
        let window = self.header().shared_attributes.display_window.size;
        (window.0, window.1)
    }

    /// Position of the data window relative to the display window.
    fn shift(&self) -> [i64; 2] {
        let header = self.header();
        let (data, window) =
            (header.own_attributes.layer_position, header.shared_attributes.display_window.position);
        [i64::from(data.0) - i64::from(window.0), i64::from(data.1) - i64::from(window.1)]
    }

    /// True if the data window differs from the display window.
    pub fn cropped(&self) -> bool {
        let size = self.header().layer_size;
        self.shift() != [0, 0] || (size.0, size.1) != self.size()
    }

    /// Full names of the channels of the part, sorted.
    pub fn names(&self) -> Vec<String> {
        self.header().channels.list.iter().map(|channel| channel.name.to_string()).collect()
    }

    /// Number of parts in the file.
    pub fn parts(&self) -> usize {
        self.meta.headers.len()
    }

    /// Name of the part; empty if it has no name.
    pub fn part(&self) -> String {
        part_name(self.header())
    }

    /// Names of all flat parts that have a name.
    pub fn part_names(&self) -> Vec<String> {
        let flat = self.meta.headers.iter().filter(|header| !header.deep);
        flat.map(part_name).filter(|name| !name.is_empty()).collect()
    }

    /// The chromaticities: x and y of red, green, blue and white; `None` if the file has none.
    pub fn primaries(&self) -> Option<[[f32; 2]; 4]> {
        let found = self.header().shared_attributes.chromaticities;
        found.map(|c| [c.red, c.green, c.blue, c.white].map(|exr::math::Vec2(x, y)| [x, y]))
    }

    /// Reads some channels of the part. The samples of each pixel are in the order of `names`. Other channels are
    /// not kept in memory.
    ///
    /// # Errors
    /// [`Error::Stopped`], errors about the file, and an error if a channel does not exist.
    pub fn interleaved(&self, names: &[String], progress: Progress<'_>) -> Result<Vec<f32>, Error> {
        let mut starts = vec![None; self.header().channels.list.len()];
        for (start, name) in names.iter().enumerate() {
            let index = self.header().channels.list.iter().position(|channel| channel.name.eq(name));
            match index.and_then(|index| starts.get_mut(index)) {
                Some(of_channel) => *of_channel = Some(start),
                None => return Err(Error::format(self.file, format!("the part has no channel `{name}`"))),
            }
        }
        self.read(&Rows { opened: self, starts, stride: names.len() }, progress)
    }

    /// Reads all channels of the part.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the run was cancelled; another error if the file is invalid.
    pub fn planes(&self, progress: Progress<'_>) -> Result<Planes, Error> {
        let ((width, height), names) = (self.size(), self.names());
        let starts = (0..names.len()).map(|plane| Some(plane * width * height)).collect();
        let samples = self.read(&Rows { opened: self, starts, stride: 1 }, progress)?;
        let each = samples.chunks_exact((width * height).max(1)).map(<[f32]>::to_vec);
        let channels = names.into_iter().zip(each).map(|(name, samples)| Channel { name, samples }).collect();
        Ok(Planes {
            width,
            height,
            channels,
            parts: self.parts(),
            part: self.part(),
            part_names: self.part_names(),
            layer: self.layer.clone(),
            cropped: self.cropped(),
            primaries: self.primaries(),
        })
    }

    fn read(&self, rows: &Rows<'_>, progress: Progress<'_>) -> Result<Vec<f32>, Error> {
        let image = rows
            .clone()
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(TrackedReader::new(self.bytes, progress))
            .map_err(|e| broken(self.file, e))?;
        Ok(image.layer_data.channel_data)
    }
}

/// Reads channels of one part, and writes each line of a block to its place in the result.
#[derive(Clone)]
struct Rows<'a> {
    opened: &'a Opened<'a>,
    /// Index in the result of the first sample of each channel; `None` for channels that are not read.
    starts: Vec<Option<usize>>,
    /// Distance in the result between the samples of one channel in neighbouring pixels.
    stride: usize,
}

impl<'a> ReadChannels<'a> for Rows<'_> {
    type Reader = RowsReader;

    fn create_channels_reader(&'a self, header: &Header) -> exr::error::Result<RowsReader> {
        // The names of parts are unique. Headers cannot be compared, since chromaticities may be NaN.
        let part = self.opened.header();
        let same = header.own_attributes.layer_name == part.own_attributes.layer_name
            && header.layer_size == part.layer_size
            && header.channels == part.channels;
        if !same || header.deep {
            return Err(exr::error::Error::NotSupported("another part".into()));
        }
        let (size, count) = (self.opened.size(), self.starts.iter().flatten().count());
        let samples = vec![0.0; size.0 * size.1 * count];
        let (starts, stride) = (self.starts.clone(), self.stride);
        Ok(RowsReader { samples, size, shift: self.opened.shift(), starts, stride })
    }
}

/// Result of [`Rows`] while it is read.
struct RowsReader {
    samples: Vec<f32>,
    /// Columns and rows of the display window.
    size: (usize, usize),
    shift: [i64; 2],
    starts: Vec<Option<usize>>,
    stride: usize,
}

impl RowsReader {
    /// Writes a line of a channel to the result. The line begins at `x` and `y` in the data window. `start` is the
    /// index in the result of the first sample of the channel. Samples outside the display window are skipped.
    fn put<T>(
        &mut self,
        start: usize,
        [x, y]: [usize; 2],
        line: impl Iterator<Item = exr::error::Result<T>>,
        number: impl Fn(T) -> f32,
    ) -> exr::error::UnitResult {
        let ((width, height), [dx, dy]) = (self.size, self.shift);
        let row = usize::try_from(y as i64 + dy).ok().filter(|row| *row < height);
        for (column, value) in (x as i64 + dx..).zip(line) {
            let value = number(value?);
            let column = usize::try_from(column).ok().filter(|column| *column < width);
            if let (Some(row), Some(column)) = (row, column)
                && let Some(sample) = self.samples.get_mut(start + (row * width + column) * self.stride)
            {
                *sample = value;
            }
        }
        Ok(())
    }
}

impl ChannelsReader for RowsReader {
    type Channels = Vec<f32>;

    fn filter_block(&self, tile: TileCoordinates) -> bool {
        tile.level_index == exr::math::Vec2(0, 0)
    }

    fn read_block(&mut self, header: &Header, block: UncompressedBlock) -> exr::error::UnitResult {
        for line in block.lines(&header.channels) {
            let (channel, exr::math::Vec2(x, y)) = (line.location.channel, line.location.position);
            let Some(start) = self.starts.get(channel).copied().flatten() else { continue };
            let Some(of) = header.channels.list.get(channel) else { continue };
            match of.sample_type {
                SampleType::F32 => self.put(start, [x, y], line.read_samples::<f32>(), |v| v)?,
                SampleType::F16 => self.put(start, [x, y], line.read_samples::<f16>(), f16::to_f32)?,
                SampleType::U32 => self.put(start, [x, y], line.read_samples::<u32>(), |v| v as f32)?,
            }
        }
        Ok(())
    }

    fn into_channels(self) -> Vec<f32> {
        self.samples
    }
}

/// Reads the part that holds a layer; see [`choose_part`].
///
/// # Errors
/// [`Error::Stopped`] if the run was cancelled; another error if the file is invalid.
pub fn read_layer(file: &str, bytes: &[u8], layer: &str, progress: Progress<'_>) -> Result<Planes, Error> {
    open(file, bytes, layer)?.planes(progress)
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

/// Largest finite 16-bit float.
const HALF_MAX: f32 = 65_504.0;

/// Writes one part. `encoding` and `recipe` become the attributes `lightharmony:encoding` and `comments`. Returns
/// the bytes and the number of values beyond the range of 16-bit floats.
pub fn write(
    width: usize,
    height: usize,
    channels: Vec<(Channel, Depth)>,
    encoding: &str,
    recipe: Option<&str>,
) -> Result<(Vec<u8>, u64), Error> {
    write_for(width, height, channels, encoding, recipe, Progress::UNTRACKED)
}

/// Like [`write()`], with progress and cancellation. Blocks of rows are compressed on all threads and written in
/// order.
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

    /// One file may contain both 16-bit and 32-bit floats. NaN and infinity are kept, and a picture without pixels
    /// is refused.
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

    /// Chromaticities of a file are read; those of sRGB, with usual rounding, do not count as different. This test
    /// fails if `off` uses `all` instead of `any`.
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
        assert_eq!(
            (back.part.as_str(), back.part_names.as_slice()),
            ("a", &["a".to_owned(), "b".to_owned()][..])
        );
        assert_eq!(back.find("R"), Some(&[0.5, 2.0][..]));
        assert_eq!(back.find("G"), Some(&[0.1, -0.0][..]));
        assert_eq!(back.find("id"), Some(&[7.0, 16_777_216.0][..]));
        assert_eq!(back.find("Z"), None);
    }

    /// In a file whose first part is a depth, the colours of a later part are found, and any part can be named.
    #[test]
    fn colours_of_a_later_part_are_read_and_parts_can_be_named() {
        let plane = |name: &str, v: f32| AnyChannel::new(name, FlatSamples::F32(vec![v; 2]));
        let part = |name: &str, list: &[(&str, f32)]| {
            let channels = list.iter().map(|(name, v)| plane(name, *v)).collect();
            Layer::new(
                (2, 1),
                LayerAttributes::named(name),
                Encoding::UNCOMPRESSED,
                AnyChannels::sort(channels),
            )
        };
        let file = |parts: Vec<Layer<AnyChannels<FlatSamples>>>| {
            let window = exr::prelude::IntegerBounds::from_dimensions((2, 1));
            let image = Image::from_layers(exr::prelude::ImageAttributes::new(window), parts);
            let mut bytes = Cursor::new(Vec::new());
            image.write().non_parallel().to_buffered(&mut bytes).expect("writes");
            bytes.into_inner()
        };
        let rgb = |v: f32| [("R", v), ("G", v + 1.0), ("B", v + 2.0)];
        let bytes = file(vec![
            part("depth", &[("Z", 9.0)]),
            part("beauty", &rgb(1.0)),
            part("light", &[("key.R", 5.0), ("key.G", 6.0), ("key.B", 7.0)]),
            part("left", &rgb(20.0)),
        ]);
        let of = |layer: &str| {
            let read = read_layer("a.exr", &bytes, layer, Progress::UNTRACKED).expect("reads");
            (read.part, read.layer, read.channels[0].samples[0])
        };
        let is = |part: &str, layer: &str, first: f32| (part.to_owned(), layer.to_owned(), first);
        // Channels are sorted: B comes first.
        assert_eq!(of(""), is("beauty", "", 3.0));
        assert_eq!(of("left"), is("left", "", 22.0));
        assert_eq!(of("depth"), is("depth", "Z", 9.0));
        assert_eq!(of("Z"), is("depth", "Z", 9.0));
        assert_eq!(of("key"), is("light", "key", 7.0));
        assert_eq!((of("light.key"), of("light/key")), (is("light", "key", 7.0), is("light", "key", 7.0)));
        assert_eq!(of("left.R"), is("left", "R", 22.0));
        // For an unknown name the first part is read, and the caller lists the existing names.
        assert_eq!(of("right"), is("depth", "right", 9.0));
        let grey = file(vec![part("id", &[("I", 1.0)]), part("plate", &[("Y", 4.0)])]);
        assert_eq!(read("a.exr", &grey).map(|read| read.part).expect("reads"), "plate");
        let none = file(vec![part("id", &[("I", 1.0)]), part("more", &[("J", 4.0)])]);
        assert_eq!(read("a.exr", &none).map(|read| read.part).expect("reads"), "id");
    }

    /// Tests data windows that equal, partly overlap, miss or lie inside the display window, read both as separate
    /// planes and as interleaved pixels of selected channels.
    #[test]
    fn a_cropped_data_window_lands_in_its_place() {
        let file = |position: (i32, i32), window: (usize, usize)| {
            let plane = |name: &str, k: f32| {
                AnyChannel::new(name, FlatSamples::F32([1.0, 2.0, 3.0, 4.0].map(|v| v * k).to_vec()))
            };
            let list = [plane("B", 1.0), plane("G", 10.0), plane("Z", 100.0)];
            let attributes = LayerAttributes {
                layer_position: exr::math::Vec2(position.0, position.1),
                ..LayerAttributes::named("a")
            };
            let channels = AnyChannels::sort(list.into_iter().collect());
            let layer = Layer::new((2, 2), attributes, Encoding::SMALL_LOSSLESS, channels);
            let window = exr::prelude::IntegerBounds::from_dimensions(window);
            let image = Image::new(exr::prelude::ImageAttributes::new(window), layer);
            let mut bytes = Cursor::new(Vec::new());
            image.write().non_parallel().to_buffered(&mut bytes).unwrap_or_else(|e| panic!("{e}"));
            bytes.into_inner()
        };
        for (position, window, wanted) in [
            ((0, 0), (2, 2), vec![1.0, 2.0, 3.0, 4.0]),
            ((1, 0), (3, 2), vec![0.0, 1.0, 2.0, 0.0, 3.0, 4.0]),
            ((-1, -1), (2, 2), vec![4.0, 0.0, 0.0, 0.0]),
            ((5, 0), (2, 2), vec![0.0; 4]),
        ] {
            let bytes = file(position, window);
            let opened = open("a.exr", &bytes, "").unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(opened.cropped(), position != (0, 0));
            let planes = opened.planes(Progress::UNTRACKED).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(planes.find("B"), Some(&wanted[..]));
            let pixels = opened
                .interleaved(&["Z".to_owned(), "B".to_owned()], Progress::UNTRACKED)
                .unwrap_or_else(|e| panic!("{e}"));
            let both: Vec<f32> = wanted.iter().flat_map(|v| [100.0 * v, *v]).collect();
            assert_eq!(pixels, both);
            assert!(opened.interleaved(&["A".to_owned()], Progress::UNTRACKED).is_err());
        }
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
