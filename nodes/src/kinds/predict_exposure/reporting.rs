//! Notes about the clipped pixels.

use engine::Notes;
use render::light::linear::{LinearPixels, max3};

use super::interface::PredictExposure;
use super::method::Method;
use render::light::hidden::clip::SEEN;

/// Number of columns below which a warning is given. With pixels of 5.6 degrees, many lamps are averaged with
/// their surroundings and do not clip.
const COARSE: usize = 64;

/// Reports white pixels whose colour was mostly filled in, since they are transparent. They do not count as clipped
/// and get no light.
pub(super) fn report_unseen(pixels: &LinearPixels, alpha: &[f32], white: f32, notes: &mut Notes) {
    let unseen = |(rgb, alpha): &(&[f32; 3], &f32)| **alpha < SEEN && **alpha > 0.0 && max3(**rgb) > white;
    let count = pixels.rgb.iter().zip(alpha).filter(unseen).count();
    if pixels.ceiling && count > 0 {
        let text = format!(
            "white pixels that are more than half transparent do not count as clipped and are not changed (count: {count})"
        );
        notes.decision("white-unseen", text);
    }
}

/// Warns about a coarse panorama: a lamp smaller than a pixel may not clip, and another light may then seem
/// to be the strongest.
pub(super) fn report_coarse(width: usize, notes: &mut Notes) {
    if width < COARSE {
        let text = format!(
            "a pixel of the panorama is {:.1} degrees wide; smaller lights may not clip and are then missed: use {COARSE} columns or more",
            360.0 / width as f64
        );
        notes.decision("coarse", text);
    }
}

pub(super) fn report_nothing_clipped(
    pixels: &LinearPixels,
    alpha: &[f32],
    (params, exhaustive): (&PredictExposure, bool),
    notes: &mut Notes,
) {
    let seen = pixels.rgb.iter().zip(alpha).filter(|(_, alpha)| **alpha >= SEEN);
    let brightest = seen.map(|(rgb, _)| max3(*rgb)).fold(0.0, f32::max);
    let why = if pixels.ceiling {
        format!(
            "no pixel is clipped: the brightest pixel reaches {brightest:.3} of white, but only pixels of at least `white` = {} count as clipped",
            params.white
        )
    } else {
        let equal = pixels.rgb.iter().filter(|rgb| max3(**rgb) == brightest).count();
        format!(
            "the panorama contains light above white, so none of its pixels counts as clipped; the brightest value is {brightest:.3} (pixels with this value: {equal})"
        )
    };
    if let Method::Manual { emitters } = &params.method
        && !emitters.is_empty()
        && !exhaustive
    {
        let text = format!("the given lights (count: {}) have no effect: {why}", emitters.len());
        notes.warning(
            "nothing-to-light",
            format!("{text}; a lower `white` lets more pixels count as clipped"),
        );
        return;
    }
    let then =
        if exhaustive { "the method runs anyway, because of `--exhaustive`" } else { "nothing is predicted" };
    notes.decision("nothing-clipped", format!("{why}; {then}"));
}
