//! Values for the page: their descriptions, and their pictures as PNG or as raw samples.

use std::sync::{Arc, Mutex, PoisonError};

use cache::Digest;
use engine::{Artifact, Engine, Graph, Wire};
use scene::io::png::{Packing, Raster, write_for};
use scene::io::progress::Progress;
use scene::math::color::space::Space;
use scene::math::color::{code8, srgb_from_linear};
use scene::math::num;
use scene::types::{Brackets, Environment, Images, NamedImage, Panorama, Picture, Report, Views};
use serde::Serialize;

/// Types of values that can be shown.
pub const SHOWN: [&str; 6] = ["image", "views", "pano", "env", "brackets", "report"];

/// Maximum memory of decoded values, in bytes. The last value is kept even if it is larger.
const MEMORY: usize = 512 << 20;

/// A decoded value whose memory is counted.
pub trait Weight {
    /// Memory in bytes, roughly.
    fn bytes(&self) -> usize;
}

/// A decoded value.
pub struct Shown {
    /// Its pictures, each with its name.
    pub pictures: Vec<NamedImage>,
    /// The tables of a report.
    pub report: Option<Report>,
}

/// Description of a value.
#[derive(Serialize)]
pub struct Description<'a> {
    pictures: Vec<PictureDescription<'a>>,
    report: Option<&'a Report>,
}

#[derive(Serialize)]
struct PictureDescription<'a> {
    name: &'a str,
    width: usize,
    height: usize,
    channels: usize,
    encoding: &'static str,
    /// Minimum and maximum of the finite samples.
    low: f32,
    high: f32,
}

/// A value from the store or, if it is not stored, computed again from `wire`, the output that has the value now.
pub fn stored_or_computed<T: Artifact>(
    engine: &Engine,
    digest: &Digest,
    wire: Option<(&Graph, Wire)>,
) -> Option<T> {
    engine.stored::<T>(digest).or_else(|| wire.and_then(|(graph, wire)| engine.value::<T>(graph, wire)))
}

impl Shown {
    /// Reads a value of type `type_name`. `wire` is the output that has the value now, from which a value that is
    /// not stored is computed again. `None` if the value is gone or cannot be shown.
    pub fn read(
        engine: &Engine,
        type_name: &str,
        digest: &Digest,
        wire: Option<(&Graph, Wire)>,
    ) -> Option<Self> {
        macro_rules! value {
            ($type:ty) => {
                stored_or_computed::<$type>(engine, digest, wire)
            };
        }
        let single = |name: &str, picture: Picture| vec![NamedImage { name: name.to_owned(), picture }];
        let pictures = match type_name {
            "image" => value!(Images)?.0,
            "views" => {
                let both = |view: scene::types::View| {
                    let name = view.camera.name;
                    let depth = NamedImage { name: format!("{name} depth"), picture: view.depth.into() };
                    [NamedImage { name, picture: view.colour }, depth]
                };
                value!(Views)?.0.into_iter().flat_map(both).collect()
            }
            "pano" => single("panorama", value!(Panorama)?.image),
            "env" => single("environment", value!(Environment)?.image.into()),
            "brackets" => {
                let brackets = value!(Brackets)?;
                let exposures = brackets.evs.iter().zip(brackets.exposures);
                let exposure =
                    |(ev, image): (&f64, _)| single(&format!("EV {ev}"), Picture::Srgb(image)).remove(0);
                let mut all = single("log2 gain", brackets.log2_gain.into());
                all.extend(exposures.map(exposure));
                all
            }
            "report" => return Some(Self { pictures: Vec::new(), report: Some(value!(Report)?) }),
            _ => return None,
        };
        Some(Self { pictures, report: None })
    }

    /// The description of the value.
    pub fn description(&self) -> Description<'_> {
        let describe = |image: &'_ NamedImage| {
            let (width, height, channels) = image.picture.size();
            let (low, high) = range(&image.picture);
            let encoding = image.picture.encoding();
            (width, height, channels, low, high, encoding)
        };
        let pictures = self.pictures.iter().map(|image| {
            let (width, height, channels, low, high, encoding) = describe(image);
            PictureDescription { name: &image.name, width, height, channels, encoding, low, high }
        });
        Description { pictures: pictures.collect(), report: self.report.as_ref() }
    }
}

impl Weight for Shown {
    fn bytes(&self) -> usize {
        self.pictures.iter().map(|image| image.picture.samples().len() * 4).sum()
    }
}

/// Minimum and maximum of the finite samples; both 0 if no sample is finite.
fn range(picture: &Picture) -> (f32, f32) {
    let finite = picture.samples().iter().copied().filter(|v| v.is_finite());
    let (low, high) =
        finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { (low, high) } else { (0.0, 0.0) }
}

/// The samples as little-endian f32, row by row, channels interleaved.
pub fn floats(picture: &Picture) -> Vec<u8> {
    picture.samples().iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The samples as little-endian half floats, in the layout of [`floats`]. The relative error is at most 2^-11
/// between 6.1e-5 and 65504; larger values become infinite.
pub fn halves(picture: &Picture) -> Vec<u8> {
    picture.samples().iter().flat_map(|v| half::f16::from_f32(*v).to_le_bytes()).collect()
}

/// A PNG for display, as `lightharmony show` writes it: linear light is multiplied by 2^`exposure` and encoded with
/// the sRGB curve, numbers are stretched from black to white, normals are colours. If `size` is given, the picture
/// is reduced so that no side is longer than `size` pixels.
///
/// # Errors
/// If the PNG cannot be encoded.
pub fn png(picture: &Picture, exposure: f32, size: Option<usize>) -> Result<Vec<u8>, scene::Error> {
    let (width, height, channels) = picture.size();
    let step = size.map_or(1, |size| width.max(height).div_ceil(size.max(1))).max(1);
    let (columns, rows) = (width.div_ceil(step), height.div_ceil(step));
    let factor = num::f64::exp2(f64::from(exposure)) as f32;
    let (low, high) = range(picture);
    let code = |pixel: &[f32]| -> [u8; 3] {
        let rgb = if channels >= 3 {
            [pixel[0], pixel[1], pixel[2]]
        } else {
            [pixel.first().copied().unwrap_or(0.0); 3]
        };
        match picture {
            Picture::Linear(_) => rgb.map(|v| code8(srgb_from_linear(v * factor))),
            Picture::Srgb(_) => rgb.map(code8),
            Picture::Data(_) if channels >= 3 => rgb.map(|v| code8(0.5 + 0.5 * v)),
            // Values that are not finite, such as the depth of the sky, are white.
            Picture::Data(_) => rgb.map(|v| {
                if v.is_finite() { code8((v - low) / (high - low).max(f32::MIN_POSITIVE)) } else { 255 }
            }),
        }
    };
    let samples = picture.samples();
    let mut codes = Vec::with_capacity(columns * rows * 3);
    for row in 0..rows {
        for column in 0..columns {
            let (mut sum, mut count) = ([0_u32; 3], 0);
            for y in row * step..((row + 1) * step).min(height) {
                for x in column * step..((column + 1) * step).min(width) {
                    let at = (y * width + x) * channels;
                    let codes = code(&samples[at..at + channels]);
                    sum.iter_mut().zip(codes).for_each(|(sum, code)| *sum += u32::from(code));
                    count += 1;
                }
            }
            codes.extend(sum.map(|sum| ((sum + count / 2) / count.max(1)) as u16));
        }
    }
    let raster = Raster {
        width: columns,
        height: rows,
        channels: 3,
        largest: 255,
        codes,
        colour: None,
        ignored: Vec::new(),
    };
    write_for(&raster, Packing::Fast, Some(Space::Srgb), &[], Progress::UNTRACKED)
}

/// The most recently decoded values.
pub struct Decoded<T>(Mutex<Vec<(Digest, Arc<T>)>>);

impl<T> Default for Decoded<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Weight> Decoded<T> {
    /// The value with this digest, from memory or from `read`.
    pub fn get(&self, digest: &Digest, read: impl FnOnce() -> Option<T>) -> Option<Arc<T>> {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let known = |values: &Vec<(Digest, Arc<T>)>| values.iter().position(|(known, _)| known == digest);
        {
            let mut values = lock();
            if let Some(at) = known(&values) {
                let entry = values.remove(at);
                values.push(entry.clone());
                return Some(entry.1);
            }
        }
        let value = Arc::new(read()?);
        let mut values = lock();
        if known(&values).is_none() {
            values.push((*digest, value.clone()));
            let mut bytes: usize = values.iter().map(|(_, value)| value.bytes()).sum();
            while values.len() > 1 && bytes > MEMORY {
                bytes -= values.remove(0).1.bytes();
            }
        }
        Some(value)
    }
}

#[cfg(test)]
mod tests {
    use scene::types::{Data, Image, Linear};

    use super::*;

    fn codes(picture: &Picture, exposure: f32, size: Option<usize>) -> (usize, usize, Vec<u16>) {
        let png = png(picture, exposure, size).and_then(|bytes| scene::io::png::read("a.png", &bytes));
        png.map(|raster| (raster.width, raster.height, raster.codes)).unwrap_or_default()
    }

    #[test]
    fn pictures_are_shown_like_show_does() {
        let light: Picture =
            Image::<Linear>::from_samples(2, 1, 3, vec![0.25, 0.25, 0.25, 0.0, 0.0, 0.0]).into();
        assert_eq!(codes(&light, 2.0, None), (2, 1, vec![255, 255, 255, 0, 0, 0]));
        assert_eq!(codes(&light, 2.0, Some(1)), (1, 1, vec![128, 128, 128]));
        let depth: Picture = Image::<Data>::from_samples(3, 1, 1, vec![2.0, 4.0, f32::INFINITY]).into();
        assert_eq!(codes(&depth, 0.0, None).2, [0, 0, 0, 255, 255, 255, 255, 255, 255]);
        let normal: Picture = Image::<Data>::from_samples(1, 1, 3, vec![-1.0, 0.0, 1.0]).into();
        assert_eq!(codes(&normal, 0.0, None).2, [0, 128, 255]);
        assert_eq!(range(&depth), (2.0, 4.0));
        assert_eq!(floats(&depth)[4..8], 4.0_f32.to_le_bytes());
        assert_eq!(halves(&depth)[2..4], [0x00, 0x44]);
    }

    #[test]
    fn the_last_values_stay_decoded() {
        let decoded = Decoded::default();
        let value = || Some(Shown { pictures: Vec::new(), report: None });
        let digest = Digest::of(b"a");
        assert!(decoded.get(&digest, || None).is_none());
        assert!(decoded.get(&digest, value).is_some() && decoded.get(&digest, || None).is_some());
    }
}
