//! Functions for combining pictures: finding the picture of a view in a set, and converting pictures to linear
//! light.

use std::borrow::Cow;

use engine::{Context, NodeError};

use crate::error::Error;
use crate::math::color::linear_from_srgb;
use crate::types::{Image, Images, Linear, Picture, Srgb};

/// Returns the picture of the view `name` in a set. It is an error if the size of the picture is not `size`
/// (columns, rows).
pub fn matching<'a>(
    images: &'a Images,
    port: &'static str,
    name: &str,
    size: (usize, usize),
) -> Result<&'a Picture, NodeError> {
    let Some(picture) = images.view(name) else {
        let there: Vec<&str> = images.0.iter().map(|image| image.name.as_str()).collect();
        let what = format!("`{port}` has no view `{name}`; its views are {}", there.join(", "));
        return Err(NodeError::from(Error::Mismatch(what))
            .at(port)
            .hint("render all layers with the same rig"));
    };
    let (width, height, _) = picture.size();
    if (width, height) != size {
        let [w, h] = [size.0, size.1];
        let what = format!("`{port}` is {width}x{height} pixels, but the view `{name}` is {w}x{h}");
        return Err(NodeError::from(Error::Mismatch(what))
            .at(port)
            .hint("render all layers with the same rig"));
    }
    Ok(picture)
}

/// A linear picture whose only colour channel is luminance (Y, or Y and A in OpenEXR), expanded to three equal
/// channels; any other picture unchanged.
pub fn coloured(picture: &Picture) -> Cow<'_, Picture> {
    let Picture::Linear(image) = picture else { return Cow::Borrowed(picture) };
    if !(1..=2).contains(&image.channels) {
        return Cow::Borrowed(picture);
    }
    let pixels = image.samples.chunks_exact(image.channels);
    let samples = pixels.flat_map(|p| [p[0]; 3].into_iter().chain(p.get(1).copied())).collect();
    let colour = Image::<Linear>::from_samples(image.width, image.height, image.channels + 2, samples);
    Cow::Owned(colour.into())
}

/// The premultiplied linear light of a premultiplied, display-encoded sample; 0 if `alpha` is 0.
pub fn decoded(encoded: f32, alpha: f32) -> f32 {
    if alpha > 0.0 { linear_from_srgb(encoded / alpha) * alpha } else { 0.0 }
}

/// The linear light of a colour picture of 3 or 4 channels, still premultiplied; luminance is expanded to grey.
/// Display-encoded values are un-premultiplied, decoded and premultiplied again.
pub fn linear<'a>(picture: &'a Picture, port: &'static str) -> Result<Cow<'a, Image<Linear>>, NodeError> {
    decode(picture, port, |encoded| {
        let mut samples = encoded.samples.clone();
        decode_pixels(&mut samples, encoded.channels);
        Ok(samples)
    })
}

/// Same as [`linear`], on the threads of `cx`.
pub fn linear_on<'a>(
    picture: &'a Picture,
    port: &'static str,
    cx: &Context,
) -> Result<Cow<'a, Image<Linear>>, NodeError> {
    decode(picture, port, |encoded| {
        let length = encoded.width * encoded.channels;
        let rows = cx.for_each_tile(encoded.height, |y| {
            let mut row = encoded.samples[y * length..(y + 1) * length].to_vec();
            decode_pixels(&mut row, encoded.channels);
            row
        })?;
        Ok(rows.concat())
    })
}

fn decode<'a>(
    picture: &'a Picture,
    port: &'static str,
    samples: impl FnOnce(&Image<Srgb>) -> Result<Vec<f32>, NodeError>,
) -> Result<Cow<'a, Image<Linear>>, NodeError> {
    if let Cow::Owned(Picture::Linear(grey)) = coloured(picture) {
        return Ok(Cow::Owned(grey));
    }
    let channels = picture.size().2;
    if !(3..=4).contains(&channels) || matches!(picture, Picture::Data(_)) {
        let what = format!(
            "`{port}` needs a colour picture, but has the encoding `{}` (channels: {channels})",
            picture.encoding()
        );
        return Err(NodeError::from(Error::Mismatch(what)).at(port));
    }
    let encoded = match picture {
        Picture::Linear(image) => return Ok(Cow::Borrowed(image)),
        Picture::Srgb(image) => image,
        Picture::Data(_) => {
            return Err(NodeError::new("a picture with the encoding `data` has no colours").at(port));
        }
    };
    Ok(Cow::Owned(Image::from_samples(encoded.width, encoded.height, channels, samples(encoded)?)))
}

fn decode_pixels(samples: &mut [f32], channels: usize) {
    for pixel in samples.chunks_exact_mut(channels) {
        let alpha = if channels == 4 { pixel[3] } else { 1.0 };
        for c in &mut pixel[..3] {
            *c = decoded(*c, alpha);
        }
    }
}
