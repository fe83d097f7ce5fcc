//! Panoramas around a point, and the exposures predicted for them.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder, Up};
use glam::DVec3;

use super::image::{Data, Image, Images, Picture, Srgb, samples_difference};
use super::report::Report;

/// An equirectangular picture of everything seen from one point. `image` has 3 channels and
/// `width = 2 * height`; row 0 is up, the centre column looks forward, u grows to the right, pixel
/// centres at (i + 0.5) / N. See [`crate::math::equirect`] for directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Panorama {
    /// RGB, not premultiplied, with filled holes.
    pub image: Picture,
    /// Coverage of each pixel, 0 to 1; one channel.
    pub alpha: Image<Data>,
    /// The axis of the world that points up; determines the direction of every pixel.
    pub up: Up,
    /// Point from which the panorama was taken, in world units, if known.
    pub origin: Option<DVec3>,
    /// Rotation about the up axis that was applied when the panorama was loaded, in degrees, counter-clockwise seen
    /// from above. Other photographs of the same place need the same rotation.
    pub turned_deg: f64,
}

/// Source of the exposures of [`Brackets`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// Derived from the gain map. They are sRGB-encoded and clipped to 1.
    Derived,
    /// Photographs in display colours, clipped to 1, encoded with the same transfer curve as the panorama.
    Display,
    /// Photographs in linear light, stored as sRGB codes. Values may exceed 1, and nothing is clipped.
    Linear,
}

/// The light that clipping hides in a panorama, and exposures that show this light.
#[derive(Debug, Clone, PartialEq)]
pub struct Brackets {
    /// log2 of (true luminance / clipped luminance), 0 where nothing is clipped; one channel, of the
    /// size of the panorama.
    pub log2_gain: Image<Data>,
    /// Linear RGB of the hidden light of each pixel, scaled to a luminance of 1; 0 where nothing is clipped. Three
    /// channels, of the size of the panorama. `None` if the method does not predict a colour. Hidden light then has
    /// the colour that the panorama shows.
    pub colour: Option<Image<Data>>,
    /// Exposure values, ascending (darkest first), of the pictures in `exposures`.
    pub evs: Vec<f64>,
    /// For each of `evs`, the photograph that a camera would take, display-encoded. It is clipped to 1 unless
    /// `taken` is [`Taken::Linear`].
    pub exposures: Vec<Image<Srgb>>,
    /// Source of the exposures.
    pub taken: Taken,
    /// Report with the method that was used and the regions that it found.
    pub report: Report,
}

pub(crate) fn encode_up(up: Up, to: &mut Encoder) {
    to.u8(match up {
        Up::PlusY => 0,
        Up::MinusY => 1,
        Up::PlusZ => 2,
    });
}

pub(crate) fn decode_up(from: &mut Decoder<'_>) -> Result<Up, Corrupt> {
    Ok(match from.u8()? {
        0 => Up::PlusY,
        1 => Up::MinusY,
        2 => Up::PlusZ,
        other => return Err(Corrupt(format!("the code {other} of the up axis is unknown"))),
    })
}

pub(super) fn encode_point(point: Option<DVec3>, to: &mut Encoder) {
    to.bool(point.is_some());
    point.into_iter().flat_map(|p| p.to_array()).for_each(|c| to.f64(c));
}

pub(super) fn decode_point(from: &mut Decoder<'_>) -> Result<Option<DVec3>, Corrupt> {
    Ok(if from.bool()? { Some(DVec3::new(from.f64()?, from.f64()?, from.f64()?)) } else { None })
}

fn encode_picture(picture: &Picture, to: &mut Encoder) {
    Images::single("", picture.clone()).encode(to);
}

fn decode_picture(from: &mut Decoder<'_>) -> Result<Picture, Corrupt> {
    Images::decode(from)?
        .0
        .pop()
        .map(|image| image.picture)
        .ok_or_else(|| Corrupt("a set that must contain one picture is empty".to_owned()))
}

impl Artifact for Panorama {
    const TYPE: &'static str = "pano";
    const FORMAT: u32 = 3;

    fn encode(&self, to: &mut Encoder) {
        encode_picture(&self.image, to);
        encode_picture(&Picture::Data(self.alpha.clone()), to);
        encode_up(self.up, to);
        encode_point(self.origin, to);
        to.f64(self.turned_deg);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let image = decode_picture(from)?;
        let Picture::Data(alpha) = decode_picture(from)? else {
            return Err(Corrupt(
                "the alpha of a panorama is stored as colours instead of as plain numbers".to_owned(),
            ));
        };
        if image.size().2 != 3
            || (alpha.width, alpha.height, alpha.channels) != (image.size().0, image.size().1, 1)
        {
            return Err(Corrupt("panorama and alpha differ in size".to_owned()));
        }
        let (up, origin) = (decode_up(from)?, decode_point(from)?);
        Ok(Self { image, alpha, up, origin, turned_deg: from.f64()? })
    }

    fn bytes(&self) -> usize {
        (self.image.samples().len() + self.alpha.samples.len()) * 4 + 128
    }

    fn difference(&self, other: &Self) -> Difference {
        if self.up != other.up || self.origin != other.origin {
            let from = |pano: &Self| pano.origin.map_or("an unknown point".to_owned(), |p| p.to_string());
            return Difference::of(format!(
                "one was captured at {}, the other at {}",
                from(self),
                from(other)
            ));
        }
        if self.turned_deg != other.turned_deg {
            return Difference::of(format!(
                "one is rotated by {} degrees, the other by {} degrees",
                self.turned_deg, other.turned_deg
            ));
        }
        samples_difference(
            "panorama",
            self.image.size(),
            self.image.samples(),
            other.image.size(),
            other.image.samples(),
        )
    }
}

impl Artifact for Brackets {
    const TYPE: &'static str = "brackets";
    const FORMAT: u32 = 4;

    fn encode(&self, to: &mut Encoder) {
        encode_picture(&Picture::Data(self.log2_gain.clone()), to);
        to.u8(u8::from(self.colour.is_some()));
        if let Some(colour) = &self.colour {
            encode_picture(&Picture::Data(colour.clone()), to);
        }
        to.f64s(&self.evs);
        for exposure in &self.exposures {
            encode_picture(&Picture::Srgb(exposure.clone()), to);
        }
        to.u8(self.taken as u8);
        self.report.encode(to);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let data = |what: &str, from: &mut Decoder<'_>| match decode_picture(from)? {
            Picture::Data(image) => Ok(image),
            _ => Err(Corrupt(format!("the {what} is stored as colours instead of as plain numbers"))),
        };
        let log2_gain = data("gain map", from)?;
        let colour = match from.u8()? {
            0 => None,
            1 => Some(data("colour of hidden light", from)?),
            other => return Err(Corrupt(format!("the code {other} of the presence of colour is unknown"))),
        };
        let evs = from.f64s()?;
        let exposures = evs
            .iter()
            .map(|_| match decode_picture(from)? {
                Picture::Srgb(image) => Ok(image),
                _ => Err(Corrupt("an exposure is not display-encoded".to_owned())),
            })
            .collect::<Result<_, _>>()?;
        let taken = match from.u8()? {
            0 => Taken::Derived,
            1 => Taken::Display,
            2 => Taken::Linear,
            other => {
                return Err(Corrupt(format!("the code {other} of the source of the exposures is unknown")));
            }
        };
        Ok(Self { log2_gain, colour, evs, exposures, taken, report: Report::decode(from)? })
    }

    fn bytes(&self) -> usize {
        let exposures: usize = self.exposures.iter().map(|image| image.samples.len()).sum();
        let colour = self.colour.as_ref().map_or(0, |image| image.samples.len());
        (self.log2_gain.samples.len() + colour + exposures) * 4 + 256
    }

    fn difference(&self, other: &Self) -> Difference {
        let size = |image: &Image<Data>| (image.width, image.height, image.channels);
        samples_difference(
            "log2 gain",
            size(&self.log2_gain),
            &self.log2_gain.samples,
            size(&other.log2_gain),
            &other.log2_gain.samples,
        )
    }
}
