//! Images: rows of f32 samples whose encoding is part of the type.

use std::marker::PhantomData;

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};

/// Encoding of the samples of an image.
pub trait Encoding: Copy + std::fmt::Debug + PartialEq + Send + Sync + 'static {
    /// Name of the encoding in files and reports.
    const NAME: &'static str;
}

/// Scene-referred linear light, Rec.709 primaries, 1 = white at EV 0. May exceed 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Linear;
/// Display encoding with the sRGB curve, Rec.709 primaries. Values may exceed 1, as they do in some splat scenes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Srgb;
/// Data other than colours, such as depth, normals, variance and masks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Data;

impl Encoding for Linear {
    const NAME: &'static str = "linear";
}
impl Encoding for Srgb {
    const NAME: &'static str = "srgb";
}
impl Encoding for Data {
    const NAME: &'static str = "data";
}

/// A `width` x `height` image of `channels` interleaved f32 samples per pixel, row 0 at the top. Colour has 3
/// channels (RGB) or 4 (RGB premultiplied by alpha, alpha); `Image<Data>` may have any number.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<E> {
    /// Width, in pixels.
    pub width: usize,
    /// Height, in pixels.
    pub height: usize,
    /// Number of samples per pixel.
    pub channels: usize,
    /// `width * height * channels` samples, row by row.
    pub samples: Vec<f32>,
    encoding: PhantomData<E>,
}

impl<E: Encoding> Image<E> {
    /// An image of zeros.
    pub fn new(width: usize, height: usize, channels: usize) -> Self {
        Self::from_samples(width, height, channels, vec![0.0; width * height * channels])
    }

    /// An image with the given samples, row by row. There must be `width * height * channels` of them.
    pub fn from_samples(width: usize, height: usize, channels: usize, samples: Vec<f32>) -> Self {
        assert_eq!(
            samples.len(),
            width * height * channels,
            "samples of a {width}x{height}x{channels} image"
        );
        Self { width, height, channels, samples, encoding: PhantomData }
    }

    /// The samples of the pixel in column `x` of row `y`.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let at = (y * self.width + x) * self.channels;
        &self.samples[at..at + self.channels]
    }

    /// The samples of the pixel in column `x` of row `y`, mutable.
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let at = (y * self.width + x) * self.channels;
        &mut self.samples[at..at + self.channels]
    }

    /// The first three samples of a pixel.
    pub fn rgb(&self, x: usize, y: usize) -> [f32; 3] {
        let p = self.pixel(x, y);
        [p[0], p[1], p[2]]
    }

    fn encode(&self, to: &mut Encoder) {
        to.u32(self.width as u32);
        to.u32(self.height as u32);
        to.u32(self.channels as u32);
        to.f32s(&self.samples);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let (width, height, channels) = (from.u32()? as usize, from.u32()? as usize, from.u32()? as usize);
        let samples = from.f32s()?;
        if width.checked_mul(height).and_then(|n| n.checked_mul(channels)) != Some(samples.len()) {
            return Err(Corrupt(format!(
                "a {width}x{height}x{channels} image has the wrong number of samples, {}",
                samples.len()
            )));
        }
        Ok(Self::from_samples(width, height, channels, samples))
    }
}

/// An image of any encoding, for ports that accept all encodings.
#[derive(Debug, Clone, PartialEq)]
pub enum Picture {
    /// Linear light.
    Linear(Image<Linear>),
    /// Display-encoded.
    Srgb(Image<Srgb>),
    /// Data other than colours.
    Data(Image<Data>),
}

macro_rules! each_picture {
    ($picture:expr, $image:ident => $body:expr) => {
        match $picture {
            Picture::Linear($image) => $body,
            Picture::Srgb($image) => $body,
            Picture::Data($image) => $body,
        }
    };
}

impl Picture {
    /// Name of the encoding: `linear`, `srgb` or `data`.
    pub fn encoding(&self) -> &'static str {
        match self {
            Picture::Linear(_) => Linear::NAME,
            Picture::Srgb(_) => Srgb::NAME,
            Picture::Data(_) => Data::NAME,
        }
    }

    /// The size as (columns, rows, samples per pixel).
    pub fn size(&self) -> (usize, usize, usize) {
        each_picture!(self, image => (image.width, image.height, image.channels))
    }

    /// The samples, row by row.
    pub fn samples(&self) -> &[f32] {
        each_picture!(self, image => &image.samples)
    }
}

impl From<Image<Linear>> for Picture {
    fn from(image: Image<Linear>) -> Self {
        Picture::Linear(image)
    }
}
impl From<Image<Srgb>> for Picture {
    fn from(image: Image<Srgb>) -> Self {
        Picture::Srgb(image)
    }
}
impl From<Image<Data>> for Picture {
    fn from(image: Image<Data>) -> Self {
        Picture::Data(image)
    }
}

/// A picture in a set, with its name.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedImage {
    /// Name of the view, as in the rig; replaces `{view}` in paths.
    pub name: String,
    /// The picture.
    pub picture: Picture,
}

/// Pictures, one per camera of a rig, in the order of the rig. Port type `image`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Images(pub Vec<NamedImage>);

impl Images {
    /// A set of one picture.
    pub fn single(name: impl Into<String>, picture: impl Into<Picture>) -> Self {
        Self(vec![NamedImage { name: name.into(), picture: picture.into() }])
    }

    /// Encodes a set of one picture. This writes the same bytes as [`single`](Self::single) followed by `encode`,
    /// without a copy of the picture.
    pub(super) fn encode_single<E: Encoding>(name: &str, image: &Image<E>, to: &mut Encoder) {
        to.u64(1);
        to.str(name);
        to.str(E::NAME);
        image.encode(to);
    }

    /// Returns the picture of the view `name`. If no picture has this name and the set contains only one picture,
    /// that picture is returned. `None` if neither applies.
    pub fn view(&self, name: &str) -> Option<&Picture> {
        let named = self.0.iter().find(|image| image.name == name);
        named.or(if self.0.len() == 1 { self.0.first() } else { None }).map(|image| &image.picture)
    }
}

impl Artifact for Images {
    const TYPE: &'static str = "image";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.u64(self.0.len() as u64);
        for NamedImage { name, picture } in &self.0 {
            to.str(name);
            to.str(picture.encoding());
            each_picture!(picture, image => image.encode(to));
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let count = from.length(36)?;
        let mut images = Vec::with_capacity(count);
        for _ in 0..count {
            let name = from.str()?;
            let picture = match from.str()?.as_str() {
                Linear::NAME => Image::<Linear>::decode(from)?.into(),
                Srgb::NAME => Image::<Srgb>::decode(from)?.into(),
                Data::NAME => Image::<Data>::decode(from)?.into(),
                other => return Err(Corrupt(format!("the encoding `{other}` is unknown"))),
            };
            images.push(NamedImage { name, picture });
        }
        Ok(Images(images))
    }

    fn bytes(&self) -> usize {
        self.0.iter().map(|image| image.picture.samples().len() * 4 + image.name.len() + 64).sum()
    }

    fn difference(&self, other: &Self) -> Difference {
        if self.0.len() != other.0.len() {
            return Difference::of(format!(
                "the numbers of views differ: {} and {}",
                self.0.len(),
                other.0.len()
            ));
        }
        for (a, b) in self.0.iter().zip(&other.0) {
            if a.name != b.name || a.picture.encoding() != b.picture.encoding() {
                return Difference::of(format!(
                    "views with different names or encodings: {} ({}) and {} ({})",
                    a.name,
                    a.picture.encoding(),
                    b.name,
                    b.picture.encoding()
                ));
            }
            let difference = samples_difference(
                &a.name,
                a.picture.size(),
                a.picture.samples(),
                b.picture.size(),
                b.picture.samples(),
            );
            if !difference.equal {
                return difference;
            }
        }
        Difference::none()
    }
}

/// The difference between two arrays of samples: the PSNR in decibels, for a peak of 1, and the largest deviation
/// with its position.
pub(crate) fn samples_difference(
    name: &str,
    size: (usize, usize, usize),
    a: &[f32],
    other_size: (usize, usize, usize),
    b: &[f32],
) -> Difference {
    if size != other_size {
        return Difference::of(format!(
            "{name}: the sizes differ, {}x{}x{} and {}x{}x{} samples",
            size.0, size.1, size.2, other_size.0, other_size.1, other_size.2
        ));
    }
    let (mut squares, mut largest, mut at, mut unequal) = (0.0_f64, 0.0_f64, 0, 0_u64);
    for (index, (a, b)) in a.iter().zip(b).enumerate() {
        if a.to_bits() == b.to_bits() {
            continue;
        }
        unequal += 1;
        let deviation = (f64::from(*a) - f64::from(*b)).abs();
        squares += deviation * deviation;
        if deviation > largest {
            (largest, at) = (deviation, index);
        }
    }
    if unequal == 0 {
        return Difference::none();
    }
    let psnr = -10.0 * libm::log10(squares / a.len() as f64);
    let pixel = at / size.2.max(1);
    Difference::of(format!(
        "{name}: PSNR {psnr:.2} dB, {unequal} samples differ, largest difference {largest:.4} at ({}, {})",
        pixel % size.0.max(1),
        pixel / size.0.max(1)
    ))
}
