//! Pictures of the whole sphere from files, for the loaders of panoramas and of light.

use std::io::Read;
use std::sync::{Mutex, PoisonError};

use engine::{Context, FileHead, InputFile, NodeError, Notes};
use scene::error::Error;
use scene::io::gpano::{self, GPano, Placement};
use scene::io::picture::{FileEncoding, decode};
use scene::io::progress::Progress;
use scene::types::{Data, Image, Linear, Picture, Srgb};

/// Reads the picture in a file with the given encoding, or one layer of this picture. A picture of a part of the sphere is placed according
/// to its metadata and is transparent elsewhere. An aspect ratio other than 2:1 is reported.
pub fn open(
    path: &InputFile,
    encoding: FileEncoding,
    layer: &str,
    notes: &mut Notes,
    cx: &Context,
) -> Result<Picture, NodeError> {
    let bytes = cx.read(path).map_err(|e| e.at("path"))?;
    let picture = decode(encoding, layer, &path.0, &bytes, notes, Progress::of(cx, 0.0, 0.4));
    let picture = picture.map_err(|e| NodeError::from(e).at("path"))?;
    let picture = whole(&path.0, &bytes, picture, notes).map_err(|e| NodeError::from(e).at("path"))?;
    cx.check()?;
    cx.progress(0.4);
    let (width, height, _) = picture.size();
    if width != 2 * height {
        let what = format!(
            "the picture is {width}x{height} pixels, not twice as wide as high, and is stretched over the whole sphere; pad it to 2:1 with transparent pixels"
        );
        notes.warning("not-two-to-one", what);
    }
    Ok(picture)
}

/// Expands a picture to the whole sphere if the metadata of its file says that it shows only a part.
pub fn whole(name: &str, bytes: &[u8], picture: Picture, notes: &mut Notes) -> Result<Picture, Error> {
    let Some(part) = GPano::find(bytes) else { return Ok(picture) };
    report(&part, notes);
    let (width, height, _) = picture.size();
    let Some(placement) = part.place(name, [width, height])? else { return Ok(picture) };
    let ([w, h], [x, y]) = (placement.size, placement.at);
    let what = format!(
        "according to its metadata (GPano), the picture of {width}x{height} pixels is a crop, at {x}, {y}, of a panorama of {w}x{h} pixels; the rest is unknown"
    );
    notes.decision("part-of-a-sphere", what);
    Ok(laid(&picture, placement))
}

/// Ratio of the number of pixels of the whole sphere to the number of pixels of the picture; 1 unless the picture
/// shows only a part of the sphere.
pub fn growth(file: &FileHead<'_>) -> f64 {
    let mut head = Vec::new();
    let read = file.open().and_then(|reader| reader.take(gpano::HEAD as u64).read_to_end(&mut head).ok());
    read.and_then(|_| GPano::find(&head)).map_or(1.0, |part| part.share().recip())
}

/// Warns about metadata that is ignored.
fn report(part: &GPano, notes: &mut Notes) {
    if part.tilt.iter().any(|degrees| degrees.abs() > 0.5) {
        let [pitch, roll] = part.tilt;
        let what = format!(
            "according to its metadata (GPano), the picture is pitched by {pitch} and rolled by {roll} degrees; this is ignored, and the rows of the picture are treated as level"
        );
        notes.warning("tilt-ignored", what);
    }
    if !part.projection.eq_ignore_ascii_case("equirectangular") {
        let what = format!(
            "according to its metadata (GPano), the picture has the projection {}; it is treated as equirectangular",
            part.projection
        );
        notes.warning("projection-ignored", what);
    }
}

/// Places a picture within a whole sphere.
fn laid(picture: &Picture, placement: Placement) -> Picture {
    let ([w, h], [left, top]) = (placement.size, placement.at);
    let (width, _, channels) = picture.size();
    let mut samples = vec![0.0; w * h * 4];
    for (index, pixel) in picture.samples().chunks_exact(channels).enumerate() {
        let (x, y) = ((left + index % width) % w, top + index / width);
        samples[4 * (y * w + x)..][..4].copy_from_slice(&match *pixel {
            [v] => [v, v, v, 1.0],
            [v, a] => [v, v, v, a],
            [r, g, b] => [r, g, b, 1.0],
            [r, g, b, a, ..] => [r, g, b, a],
            [] => [0.0; 4],
        });
    }
    match picture {
        Picture::Srgb(_) => Image::<Srgb>::from_samples(w, h, 4, samples).into(),
        Picture::Linear(_) => Image::<Linear>::from_samples(w, h, 4, samples).into(),
        Picture::Data(_) => Image::<Data>::from_samples(w, h, 4, samples).into(),
    }
}

/// Reads a file that stores linear light. Returns its width, its height and its RGB values, which are finite.
pub fn light(name: &str, bytes: &[u8], notes: &mut Notes) -> Result<(usize, usize, Vec<f32>), Error> {
    let picture = decode(FileEncoding::Auto, "", name, bytes, notes, Progress::UNTRACKED)?;
    let (width, height, _) = picture.size();
    Ok((width, height, linear(name, picture)?))
}

/// Linear RGB of a picture that stores linear light. The colours stay premultiplied by alpha, but alpha itself is
/// not returned. The result reuses the memory of a picture with three or four channels.
pub fn linear(name: &str, picture: Picture) -> Result<Vec<f32>, Error> {
    let Picture::Linear(Image { width, height, channels, mut samples, .. }) = picture else {
        return Err(Error::format(
            name,
            "the file contains display colours; light must be stored as OpenEXR or Radiance HDR",
        ));
    };
    match channels {
        1 | 2 => Ok(samples.chunks_exact(channels).flat_map(|pixel| [pixel[0]; 3]).collect()),
        3 => Ok(samples),
        4 => {
            for pixel in 0..width * height {
                samples.copy_within(4 * pixel..4 * pixel + 3, 3 * pixel);
            }
            samples.truncate(width * height * 3);
            samples.shrink_to_fit();
            Ok(samples)
        }
        _ => {
            Err(Error::Mismatch(format!("the picture has {channels} channels; a colour picture has 1 to 4")))
        }
    }
}

/// Premultiplied colours, clamped to at least 0, with alpha from 0 to 1.
pub fn premultiplied(picture: &Picture, notes: &mut Notes) -> Result<Vec<[f32; 4]>, Error> {
    let (width, height, channels) = picture.size();
    let mut pixels = Vec::with_capacity(width * height);
    for pixel in picture.samples().chunks_exact(channels) {
        let (colour, a) = match *pixel {
            [y] => ([y; 3], 1.0),
            [y, a] => ([y; 3], a),
            [r, g, b] => ([r, g, b], 1.0),
            [r, g, b, a] => ([r, g, b], a),
            _ => {
                return Err(Error::Mismatch(format!(
                    "the picture has {channels} channels; a colour picture has 1 to 4"
                )));
            }
        };
        let [r, g, b] = colour.map(|v| v.clamp(0.0, f32::MAX));
        pixels.push([r, g, b, a.clamp(0.0, 1.0)]);
    }
    let negative = picture.samples().iter().filter(|v| **v < 0.0).count() as u64;
    notes.count("below-zero", negative, "of the samples had a value below 0, which was replaced with 0");
    Ok(pixels)
}

/// Un-premultiplied colours, and alpha.
pub fn straight(pixels: Vec<[f32; 4]>) -> (Vec<f32>, Vec<f32>) {
    let alpha = pixels.iter().map(|pixel| pixel[3]).collect();
    let colour =
        |[r, g, b, a]: [f32; 4]| [r, g, b].map(|v| if a > 0.0 { (v / a).min(f32::MAX) } else { 0.0 });
    (pixels.into_iter().flat_map(colour).collect(), alpha)
}

/// Number of rows that one job rotates.
const ROWS: usize = 32;

/// Rotates a panorama by `degrees`, by shifting every row to the left, so that light in front moves to the left.
/// Each pixel has `N` samples.
pub fn turn<const N: usize>(
    pixels: &[[f32; N]],
    width: usize,
    degrees: f64,
    cx: &Context,
) -> Result<Vec<[f32; N]>, NodeError> {
    let mut turned = pixels.to_vec();
    turn_in_place(&mut turned, width, degrees, cx)?;
    Ok(turned)
}

/// Like [`turn`], but rotates the pixels in place.
pub fn turn_in_place<const N: usize>(
    pixels: &mut [[f32; N]],
    width: usize,
    degrees: f64,
    cx: &Context,
) -> Result<(), NodeError> {
    let shift = (degrees / 360.0).rem_euclid(1.0) * width as f64;
    // A whole number of columns, except for rounding, is not interpolated.
    let shift = if (shift - shift.round()).abs() < 1e-9 * width as f64 { shift.round() } else { shift };
    let (whole, part) = (shift.floor() as usize % width, (shift - shift.floor()) as f32);
    if whole == 0 && part == 0.0 {
        return Ok(());
    }
    // Equal values stay exact, so that alpha stays 1.
    let mix = |a: f32, b: f32| if a == b { a } else { a * (1.0 - part) + b * part };
    let pieces: Vec<_> = pixels.chunks_mut(width * ROWS).map(Mutex::new).collect();
    cx.for_each_tile(pieces.len(), |i| {
        let mut rows = pieces[i].lock().unwrap_or_else(PoisonError::into_inner);
        for row in rows.chunks_exact_mut(width) {
            let old = row.to_vec();
            for (x, pixel) in row.iter_mut().enumerate() {
                let (near, far) = (old[(x + whole) % width], old[(x + whole + 1) % width]);
                *pixel = if part == 0.0 { near } else { std::array::from_fn(|c| mix(near[c], far[c])) };
            }
        }
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};
    use glam::DVec3;
    use scene::math::equirect;
    use scene::math::equirect::yaw;

    fn detached(up: Up) -> Context {
        Context::detached(Scene { up, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".")
    }

    // A light in front, rotated by yaw, must be where the yaw of a pose would put it.
    #[test]
    fn turns_as_a_pose_does() {
        let (width, height) = (72, 36);
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let mut light = vec![[0.0]; width * height];
            light[18 * width + 36] = [1.0];
            let turned = turn(&light, width, 25.0, &detached(up)).unwrap_or_else(|e| panic!("{e}"));
            let at = turned.iter().position(|v| v[0] > 0.9).unwrap_or_default();
            let seen = |x: usize| equirect::direction(up, (x as f64 + 0.5) / 72.0, (18.5) / 36.0);
            let expected: DVec3 = yaw(equirect::axes(up), 25.0) * seen(36);
            assert!((seen(at % width) - expected).length() < 1e-9, "{up:?}");
        }
    }

    /// Grey and colour pictures, with and without alpha, give RGB.
    #[test]
    fn light_is_rgb_whatever_channels_the_picture_has() {
        let of = |channels: usize| {
            let samples = (0..6 * channels).map(|i| i as f32).collect();
            let image = Image::<Linear>::from_samples(3, 2, channels, samples);
            linear("a", image.into())
        };
        for channels in 1..=4 {
            let rgb = of(channels).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(rgb.len(), 18);
            for (pixel, found) in rgb.as_chunks::<3>().0.iter().enumerate() {
                let first = (pixel * channels) as f32;
                let wanted = if channels < 3 { [first; 3] } else { [first, first + 1.0, first + 2.0] };
                assert_eq!(*found, wanted, "{channels} channels");
            }
        }
        assert!(of(5).is_err());
    }

    #[test]
    fn any_turn_keeps_the_energy_of_rows() {
        let rgb: Vec<[f32; 3]> =
            (0..32 * 2).map(|i| [3 * i, 3 * i + 1, 3 * i + 2].map(|i| (i * 37 % 11) as f32)).collect();
        for degrees in [0.0, 1.7, 360.0, -723.4] {
            let turned = turn(&rgb, 32, degrees, &detached(Up::PlusZ)).unwrap_or_else(|e| panic!("{e}"));
            for row in 0..2 {
                let sum = |v: &[[f32; 3]]| v[row * 32..(row + 1) * 32].as_flattened().iter().sum::<f32>();
                assert!((sum(&turned) - sum(&rgb)).abs() < 1e-3);
            }
        }
        assert_eq!(turn(&rgb, 32, 720.0, &detached(Up::PlusZ)).unwrap_or_default(), rgb);
    }
}
