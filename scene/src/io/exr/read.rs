//! Reading of one flat part.

use std::collections::BTreeSet;
use std::io::Cursor;

use exr::block::UncompressedBlock;
use exr::block::chunk::TileCoordinates;
use exr::compression::Compression;
use exr::image::read::layers::{ChannelsReader, ReadChannels};
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{MetaData, ReadLayers, f16};

use super::compression::refusal;
use super::part::{choose_part, part_name};
use super::planes::{Channel, Planes};
use crate::error::Error;
use crate::io::believable::believable;
use crate::io::progress::{Progress, TrackedReader};

/// Reads a file with channels of 16-bit floats, 32-bit floats or integers.
pub fn read(file: &str, bytes: &[u8]) -> Result<Planes, Error> {
    read_for(file, bytes, Progress::UNTRACKED)
}

/// Like [`read`], with progress and cancellation.
pub fn read_for(file: &str, bytes: &[u8], progress: Progress<'_>) -> Result<Planes, Error> {
    read_layer(file, bytes, "", progress)
}

/// Reads the part that holds a layer; see [`choose_part`].
///
/// # Errors
/// [`Error::Stopped`] if the run was cancelled; another error if the file is invalid.
pub fn read_layer(file: &str, bytes: &[u8], layer: &str, progress: Progress<'_>) -> Result<Planes, Error> {
    open(file, bytes, layer)?.planes(progress)
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
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|e| refusal(file, bytes).unwrap_or_else(|| broken(file, e)))?;
    let Some((header, layer)) = choose_part(&meta.headers, layer) else {
        return Err(Error::unsupported(file, "deep data"));
    };
    if matches!(header.compression, Compression::HTJ2K32 | Compression::HTJ2K256) {
        let unread = || Error::unsupported(file, "HTJ2K compression; save the picture with ZIP or PIZ");
        return Err(refusal(file, bytes).unwrap_or_else(unread));
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

    /// Position of the data window relative to the display window, in pixels.
    fn shift(&self) -> [i64; 2] {
        let header = self.header();
        let (data, window) =
            (header.own_attributes.layer_position, header.shared_attributes.display_window.position);
        [i64::from(data.0) - i64::from(window.0), i64::from(data.1) - i64::from(window.1)]
    }

    /// Width of a pixel divided by its height.
    pub fn pixel_aspect(&self) -> f32 {
        self.header().shared_attributes.pixel_aspect
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

    /// Sorted names of the layers of all flat parts. A channel that belongs to no layer is listed under its own name.
    /// If the file has several parts, each name is prefixed with the name of its part, if that part has a name.
    pub fn layers(&self) -> BTreeSet<String> {
        let flat = || self.meta.headers.iter().filter(|header| !header.deep);
        let several = flat().count() > 1;
        let mut layers = BTreeSet::new();
        for header in flat() {
            let part = Some(part_name(header)).filter(|name| several && !name.is_empty());
            for channel in &header.channels.list {
                let name = channel.name.to_string();
                let layer = name.rsplit_once('.').map_or(name.as_str(), |(layer, _)| layer);
                layers
                    .insert(part.as_ref().map_or_else(|| layer.to_owned(), |part| format!("{part}.{layer}")));
            }
        }
        layers
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

/// Reads channels of one part, and copies each line of a block to its position in the result.
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

/// A read with [`Rows`] in progress, with the samples read so far.
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
