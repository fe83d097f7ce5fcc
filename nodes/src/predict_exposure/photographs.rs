//! Exposures that a camera took of the same panorama: what they show is measured, not estimated.

use engine::{Context, InputFile, NodeError, Notes};

use crate::color::{luminance, srgb_from_linear};
use crate::error::Error;
use crate::io::stretch::Stretch;
use crate::light::linear::{LinearPixels, Transfer, linear_pixels, max3};
use crate::load_image::{FileEncoding, decode};
use crate::num;
use crate::types::{Image, Picture, Srgb};

/// A channel above this, in linear light, is clipped as far as anybody can tell.
const CLIPPED: f32 = 0.9;
/// Codes of what is darker say little, so light is compared with no less than this.
const DARKEST: f64 = 1e-4;

/// Refuses files that are not one for each exposure.
pub(super) fn check(files: &[InputFile], evs: &[f64]) -> Result<(), NodeError> {
    if files.len() == evs.len() && !files.is_empty() {
        return Ok(());
    }
    let text = format!("{} photographs for {} exposures", files.len(), evs.len());
    Err(NodeError::new(text).at("method").hint("list in `evs` the exposure of each file, in the same order"))
}

/// The log2 gain of every clipped pixel, and the photographs, darkest first.
pub(super) fn predict(
    files: &[InputFile],
    evs: &[f64],
    (pixels, mask): (&LinearPixels, &[bool]),
    notes: &mut Notes,
    cx: &Context,
) -> Result<(Vec<f32>, Vec<Image<Srgb>>), NodeError> {
    let (width, height) = (pixels.width, pixels.height);
    let mut taken = Vec::with_capacity(files.len());
    for (file, &ev) in files.iter().zip(evs) {
        let failed = |error: Error| NodeError::from(error).at("method");
        let bytes = cx.read(file).map_err(|error| error.at("method"))?;
        let picture = decode(FileEncoding::Auto, "", &file.0, &bytes, notes, Stretch::of(cx, 0.0, 0.0))
            .map_err(failed)?;
        let (w, h, channels) = picture.size();
        if (w, h) != (width, height) || channels < 3 || matches!(picture, Picture::Data(_)) {
            let what = format!("is {w}x{h} of {channels} channels; the panorama is {width}x{height} of 3");
            return Err(failed(Error::format(&file.0, what)));
        }
        taken.push((ev, linear_pixels(&picture, Transfer::Srgb).rgb));
        cx.check()?;
    }
    taken.sort_by(|a, b| a.0.total_cmp(&b.0));
    let rows = cx.for_each_tile(height, |y| {
        let gain = |at: usize| {
            let shown = taken.iter().rev().map(|(ev, rgb)| (*ev, rgb[at]));
            if mask[at] { measured(pixels.rgb[at], shown) } else { (0.0, false) }
        };
        (y * width..(y + 1) * width).map(gain).collect::<Vec<_>>()
    })?;
    let still = rows.iter().flatten().filter(|(_, clipped)| *clipped).count();
    tell_still(still, taken.first().map_or(0.0, |(ev, _)| *ev), notes);
    let codes =
        |rgb: &Vec<[f32; 3]>| rgb.as_flattened().iter().map(|v| srgb_from_linear(v.min(1.0))).collect();
    let pictures = taken.iter().map(|(_, rgb)| Image::from_samples(width, height, 3, codes(rgb))).collect();
    Ok((rows.into_iter().flatten().map(|(gain, _)| gain).collect(), pictures))
}

/// For a pixel the log2 of its luminance over that of the panorama, at least 0, as the first of `exposures` (EV and
/// linear light, brightest first) has it that shows it unclipped, else the last; and whether none shows it so.
pub(super) fn measured(own: [f32; 3], exposures: impl Iterator<Item = (f64, [f32; 3])>) -> (f32, bool) {
    let own = f64::from(luminance(own)).max(DARKEST);
    let (mut gain, mut clipped) = (0.0, true);
    for (ev, rgb) in exposures {
        let light = f64::from(luminance(rgb)) * num::f64::exp2(-ev);
        gain = num::f64::log2((light / own).max(1.0)) as f32;
        clipped = max3(rgb) > CLIPPED;
        if !clipped {
            break;
        }
    }
    (gain, clipped)
}

/// Warns of pixels that even the darkest exposure does not show.
pub(super) fn tell_still(pixels: usize, ev: f64, notes: &mut Notes) {
    if pixels > 0 {
        notes.warning(
            "still-clipped",
            format!("{pixels} pixels are clipped even at EV {ev}, so their gain is a lower bound; ask for a darker exposure in `evs`"),
        );
    }
}
