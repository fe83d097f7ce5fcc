//! Pictures as the bytes that OpenColorIO converts, and back.

use std::borrow::Cow;

use engine::NodeError;
use scene::types::layers::{coloured, linear};
use scene::types::{Data, Image, Linear, Picture, Srgb};

/// Encoding of converted pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Encoded {
    /// Linear light in the working space.
    Linear,
    /// Codes of a display.
    Display,
    /// Numbers of another space.
    Data,
}

/// RGB of each pixel, not multiplied by alpha, as little-endian 32-bit floats. Colours without alpha are black. If `decode`
/// is true, display-encoded pictures are decoded to linear light.
pub(super) fn bytes_of(picture: &Picture, decode: bool) -> Result<Vec<u8>, NodeError> {
    let picture = match picture {
        Picture::Srgb(_) if decode => Cow::Owned(Picture::Linear(linear(picture, "image")?.into_owned())),
        _ => coloured(picture),
    };
    if decode && matches!(*picture, Picture::Data(_)) {
        let what = "the picture is data, so its space is not known";
        return Err(NodeError::new(what).at("from").hint("name the space of its numbers in `from`"));
    }
    let (width, height, channels) = picture.size();
    if !matches!(channels, 3 | 4) {
        let what = format!("the picture has no colours (channels: {channels})");
        return Err(NodeError::new(what).at("image").hint("wire a picture with 3 or 4 channels"));
    }
    let mut bytes = Vec::with_capacity(width * height * 12);
    for pixel in picture.samples().chunks_exact(channels) {
        let alpha = pixel.get(3).copied();
        let plain = |value: f32| match alpha {
            Some(alpha) if alpha > 0.0 => value / alpha,
            Some(_) => 0.0,
            None => value,
        };
        pixel[..3].iter().for_each(|value| bytes.extend(plain(*value).to_le_bytes()));
    }
    Ok(bytes)
}

/// The picture with converted colours, and the number of its numbers that were not finite.
pub(super) fn picture_of(
    from: &Picture,
    bytes: &[u8],
    encoded: Encoded,
) -> Result<(Picture, u64), NodeError> {
    let from = coloured(from);
    let (width, height, channels) = from.size();
    if bytes.len() != width * height * 12 {
        let what =
            format!("OpenColorIO wrote {} bytes for a picture of {width}x{height} pixels", bytes.len());
        return Err(NodeError::new(what).at("program"));
    }
    let mut broken = 0;
    let mut samples = Vec::with_capacity(from.samples().len());
    let numbers = bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
    let mut numbers = numbers.map(|value| {
        broken += u64::from(!value.is_finite());
        if value.is_finite() { value } else { 0.0 }
    });
    for pixel in from.samples().chunks_exact(channels) {
        let alpha = pixel.get(3).copied();
        let own = numbers.by_ref().take(3);
        samples.extend(own.map(|value| match alpha {
            Some(alpha) if alpha > 0.0 => value * alpha,
            Some(_) => 0.0,
            None => value,
        }));
        samples.extend(alpha);
    }
    let picture = match encoded {
        Encoded::Linear => Image::<Linear>::from_samples(width, height, channels, samples).into(),
        Encoded::Display => Image::<Srgb>::from_samples(width, height, channels, samples).into(),
        Encoded::Data => Image::<Data>::from_samples(width, height, channels, samples).into(),
    };
    Ok((picture, broken))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floats(bytes: &[u8]) -> Vec<f32> {
        bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
    }

    /// This test fails if colours are converted as multiplied by alpha.
    #[test]
    fn alpha_is_divided_out_and_multiplied_in() {
        let picture: Picture =
            Image::<Linear>::from_samples(2, 1, 4, vec![0.5, 1.0, 0.25, 0.5, 3.0, 3.0, 3.0, 0.0]).into();
        let bytes = bytes_of(&picture, true).expect("has colours");
        assert_eq!(floats(&bytes), [1.0, 2.0, 0.5, 0.0, 0.0, 0.0]);
        let (back, broken) = picture_of(&picture, &bytes, Encoded::Data).expect("fits");
        assert_eq!(back.samples(), [0.5, 1.0, 0.25, 0.5, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!((back.encoding(), broken), ("data", 0));
        assert!(picture_of(&picture, &bytes[4..], Encoded::Data).is_err());
    }

    /// This test fails if NaN is kept.
    #[test]
    fn numbers_that_are_not_finite_are_counted() {
        let picture: Picture = Image::<Data>::from_samples(1, 1, 3, vec![0.0; 3]).into();
        let bytes = [f32::NAN, 1.0, f32::INFINITY].map(f32::to_le_bytes).concat();
        let (back, broken) = picture_of(&picture, &bytes, Encoded::Display).expect("fits");
        assert_eq!((back.samples(), broken), (&[0.0, 1.0, 0.0][..], 2));
    }

    /// This test fails if display codes of a named space are decoded, or if those of the working space are not.
    #[test]
    fn display_codes_are_decoded_for_the_working_space_alone() {
        let picture: Picture = Image::<Srgb>::from_samples(1, 1, 3, vec![0.5, 0.0, 1.0]).into();
        assert_eq!(floats(&bytes_of(&picture, false).expect("has colours")), [0.5, 0.0, 1.0]);
        let decoded = floats(&bytes_of(&picture, true).expect("has colours"));
        assert!((decoded[0] - 0.214_041).abs() < 1e-5);
        let depth: Picture = Image::<Data>::from_samples(1, 1, 1, vec![2.0]).into();
        assert!(bytes_of(&depth, true).is_err());
    }
}
