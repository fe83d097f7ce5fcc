//! Environments: the light that arrives from every direction.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder, Up};
use glam::DVec3;

use super::image::{Image, Images, Linear, Picture, samples_difference};
use super::panorama::{decode_point, decode_up, encode_point, encode_up};

/// A linear picture that an environment shares with an output of type `image`, so that a large panorama is in
/// memory only once.
#[derive(Debug, Clone, PartialEq)]
pub struct Light(Arc<Images>);

impl Light {
    /// A set that contains only this picture, named `env`.
    pub fn pictures(&self) -> Arc<Images> {
        self.0.clone()
    }
}

impl From<Image<Linear>> for Light {
    fn from(image: Image<Linear>) -> Self {
        Self(Arc::new(Images::single("env", image)))
    }
}

impl From<Light> for Picture {
    fn from(light: Light) -> Self {
        Picture::Linear(Image::clone(&light))
    }
}

impl Deref for Light {
    type Target = Image<Linear>;

    fn deref(&self) -> &Image<Linear> {
        match self.0.0.first().map(|image| &image.picture) {
            Some(Picture::Linear(image)) => image,
            _ => unreachable!("a `Light` holds one linear picture"),
        }
    }
}

impl DerefMut for Light {
    fn deref_mut(&mut self) -> &mut Image<Linear> {
        match Arc::make_mut(&mut self.0).0.first_mut().map(|image| &mut image.picture) {
            Some(Picture::Linear(image)) => image,
            _ => unreachable!("a `Light` holds one linear picture"),
        }
    }
}

/// Linear radiance from every direction, as an equirectangular image of 3 channels in the same layout
/// as a [`Panorama`](super::Panorama).
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    /// Radiance, in units in which white at EV 0 is 1.
    pub image: Light,
    /// The axis of the world that points up; determines the direction of every texel.
    pub up: Up,
    /// The point where the light was captured, if known.
    pub origin: Option<DVec3>,
}

impl Environment {
    /// An environment of one colour, `width` texels wide and half as high.
    pub fn constant(up: Up, radiance: [f32; 3], width: usize) -> Self {
        let height = (width / 2).max(1);
        let samples = (0..width * height).flat_map(|_| radiance).collect();
        Self { image: Image::from_samples(width, height, 3, samples).into(), up, origin: None }
    }
}

impl Artifact for Environment {
    const TYPE: &'static str = "env";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        Images::encode_single("", &self.image, to);
        encode_up(self.up, to);
        encode_point(self.origin, to);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let Some(Picture::Linear(image)) = Images::decode(from)?.0.pop().map(|image| image.picture) else {
            return Err(Corrupt("the radiance is not stored as linear light".to_owned()));
        };
        if image.channels != 3 || image.width == 0 || image.height == 0 {
            return Err(Corrupt("the radiance does not have three channels".to_owned()));
        }
        let up = decode_up(from)?;
        let origin = decode_point(from)?;
        Ok(Self { image: image.into(), up, origin })
    }

    fn bytes(&self) -> usize {
        self.image.samples.len() * 4 + 128
    }

    fn difference(&self, other: &Self) -> Difference {
        if self.up != other.up || self.origin != other.origin {
            return Difference::of("the up axes or the points of capture differ");
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
