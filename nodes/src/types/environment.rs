//! Environments: the light that arrives from every direction.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder, Up};
use glam::DVec3;

use super::image::{Image, Images, Linear, Picture, samples_difference};
use super::panorama::{decode_point, decode_up, encode_point, encode_up};

/// Linear radiance from every direction, as an equirectangular image of 3 channels in the same layout
/// as a [`Panorama`](super::Panorama).
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    /// Radiance; white at EV 0 is 1.
    pub image: Image<Linear>,
    /// The axis of the world that points up; determines the direction of every texel.
    pub up: Up,
    /// The point where it was captured, if known.
    pub origin: Option<DVec3>,
}

impl Artifact for Environment {
    const TYPE: &'static str = "env";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        Images::single("", self.image.clone()).encode(to);
        encode_up(self.up, to);
        encode_point(self.origin, to);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let Some(Picture::Linear(image)) = Images::decode(from)?.0.pop().map(|image| image.picture) else {
            return Err(Corrupt("the radiance is not linear".to_owned()));
        };
        if image.channels != 3 || image.width == 0 || image.height == 0 {
            return Err(Corrupt("the radiance does not have three channels".to_owned()));
        }
        let up = decode_up(from)?;
        let origin = decode_point(from)?;
        Ok(Self { image, up, origin })
    }

    fn bytes(&self) -> usize {
        self.image.samples.len() * 4 + 128
    }

    fn difference(&self, other: &Self) -> Difference {
        if self.up != other.up || self.origin != other.origin {
            return Difference::of("captured at another point");
        }
        let size = |image: &Image<Linear>| (image.width, image.height, image.channels);
        samples_difference(
            "radiance",
            size(&self.image),
            &self.image.samples,
            size(&other.image),
            &other.image.samples,
        )
    }
}
