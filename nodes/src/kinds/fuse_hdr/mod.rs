//! `fuse-hdr`: fuses a panorama and its predicted exposures into an environment of light.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes};
use render::light::balance::Balance;
use render::light::exposure::{Shown, measured};
use render::light::linear::{LinearPixels, Transfer, linear_pixels, max3};
use scene::error::Error;
use scene::math::color::luminance;
use scene::math::num;
use scene::types::{Brackets, Environment, Image, Images, Linear, Panorama, Picture, Report, Taken};

mod feather;
mod fused;
mod gain;
mod ledger;
mod sky;

use self::ledger::{Lights, luminance_of};
use fused::Fused;
pub use gain::Gain;

engine::choices! {
    /// Transition from the light of the panorama to the predicted light.
    pub enum Blend {
        /// Gradual, while the brightest channel rises from the threshold to 1. A prediction can only make a pixel
        /// brighter.
        Ramp,
        /// Immediate where luminance exceeds the threshold, as in the paper's equation.
        Hard,
    }
}

engine::choices! {
    /// Source of the colour of recovered light.
    pub enum Hue {
        /// The colour that the method predicts for hidden light. The light that the panorama shows keeps its own
        /// colour. If the method predicts no colour, this is the same as `Base`.
        Predicted,
        /// The colour of the panorama, as in the paper; white where all channels are clipped.
        Base,
        /// The colour of the brightest exposure that is not clipped at a pixel, blended with the colour of the
        /// panorama where the panorama is only partly clipped. If every exposure is clipped, it is the colour of
        /// the panorama. This setting matters only for the method `Photographs`; for other methods it is the same as
        /// `Predicted`.
        Exposures,
    }
}

engine::params! {
    /// Fuses a panorama and its predicted exposures into an environment of light.
    ///
    /// Clipped parts of the panorama are replaced with the predicted light, in the hue of the panorama; all other
    /// parts are kept exactly. The report lists each recovered light: its position and amount, the source of its
    /// energy, and the effect of each step of the fusion.
    pub struct FuseHdr {
        /// Linear light above which a channel counts as clipped, where white is 1.
        threshold: f32 = 0.9, range(0.05, 0.999), other("0.6");
        /// Transition from the light of the panorama to the predicted light.
        blend: Blend = Blend::Ramp, other("Hard");
        /// Transfer curve from display values to linear light, for the base and for photographed exposures. Derived
        /// exposures are always sRGB.
        transfer: Transfer = Transfer::Srgb, other("Gamma24");
        /// Form of the prediction that is fused: the gain map in floats, or the list of exposures.
        gain: Gain = Gain::Direct, other("Brackets");
        /// Source of the colour of recovered light.
        hue: Hue = Hue::Predicted, other("Base");
        /// Angle over which recovered light rises from its edge to full strength. Each light keeps its total, so
        /// its middle becomes brighter; with `Brackets` it may exceed the white of the darkest exposure.
        feather_deg: f64 = 0.0, range(0.0, 10.0), unit("deg"), other("9.0"), inert("a light no wider than a pixel does not change");
        /// Albedo of the ground, for captures without a sky. Unseen directions above the horizon become a white
        /// sky, whose brightness is chosen so that the ground in the panorama has this albedo. `None` keeps the
        /// filled holes.
        ground_albedo: Option<f64> = None, range(0.02, 1.0), other("0.3");
    }
}

engine::inputs! {
    /// Inputs of `fuse-hdr`.
    pub struct In {
        /// The panorama at EV 0.
        base: Arc<Panorama>,
        /// The prediction for the panorama.
        brackets: Arc<Brackets>,
    }
}

engine::outputs! {
    /// Outputs of `fuse-hdr`.
    pub struct Out {
        /// Linear light from every direction, at the point where the panorama was captured.
        env: Arc<Environment>,
        /// Each recovered light, and the energy before and after fusion.
        report: Arc<Report>,
        /// The light as a picture, for `write-exr`.
        image: Arc<Images>,
    }
}

/// Minimum linear value at which a derived exposure counts as white, with a margin for the rounding of the transfer
/// curve.
const WHITE: f32 = 0.999;

impl Kind for FuseHdr {
    const NAME: &'static str = "fuse-hdr";
    const VERSION: u32 = 9;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_: &Self, inputs: &In) -> Cost {
        Cost::of([(inputs.base.alpha.samples.len() as u64, 96)])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let In { base, brackets } = inputs;
        check_sizes(&base, &brackets)?;
        let mut notes = Notes::none();
        let pixels = linear_pixels(&base.image, params.transfer);
        let brackets = by_own_curve(params, &pixels, brackets, cx)?;
        report_broken(&pixels, &mut notes);
        if matches!(base.image, Picture::Linear(_)) && params.transfer == Transfer::Gamma24 {
            notes.decision("already-linear", "the panorama is linear, so `transfer` has no effect on it");
        }
        let (width, height) = (pixels.width, pixels.height);
        let rows = cx.for_each_tile(height, |y| {
            (y * width..(y + 1) * width).map(|at| fuse(params, &pixels, &brackets, at)).collect::<Vec<_>>()
        })?;
        cx.count("pixels", pixels.rgb.len() as u64);
        let (mut fused, shown): (Vec<Fused>, Vec<f64>) = rows.into_iter().flatten().unzip();
        let predicted = |at: usize| direct(&pixels, &brackets, at).luminance;
        let mut lights = Lights::find(&pixels, &fused, predicted);
        lights.record("predicted", predicted);
        if params.gain == Gain::Brackets {
            lights.record("exposures", |at| shown[at]);
        }
        if params.gain == Gain::Brackets && brackets.evs.is_empty() {
            let text = "the prediction has no exposures (`evs` is empty), so the panorama is kept; `gain: Direct` needs no exposures";
            notes.warning("no-exposures", text);
        } else {
            lights.report_unused(params.threshold, &pixels, &brackets.log2_gain.samples, &mut notes);
        }
        lights.report_darker(&pixels, &fused, &mut notes);
        lights.record("blended", |at| fused[at].luminance);
        drop(shown);
        if params.gain == Gain::Direct && params.blend == Blend::Ramp {
            lights.keep_flux(&pixels, &brackets.log2_gain.samples, &mut fused, &mut notes);
            lights.record("flux kept", |at| fused[at].luminance);
        }
        if params.feather_deg > 0.0 {
            lights.feather(params.feather_deg, &pixels, &mut fused, cx)?;
            lights.record("feathered", |at| fused[at].luminance);
        }
        let mut image = Image::<Linear>::new(width, height, 3);
        let colour = brackets.colour.as_ref().filter(|_| params.hue != Hue::Base);
        for (at, ((to, rgb), fused)) in
            image.samples.chunks_exact_mut(3).zip(&pixels.rgb).zip(&fused).enumerate()
        {
            let colour = colour.map(|colour| colour.rgb(at % width, at / width));
            to.copy_from_slice(&apply(*rgb, fused.luminance, colour));
        }
        // Derived exposures were made from the panorama with the sRGB curve; with another curve they would seem to
        // have another colour.
        if params.hue == Hue::Exposures && pixels.ceiling && brackets.taken != Taken::Derived {
            let coloured = cx.for_each_tile(height, |y| {
                let row = &image.samples[3 * y * width..][..3 * width];
                let colour = |x: usize| {
                    let at = y * width + x;
                    recolour(params, &brackets, pixels.rgb[at], [0, 1, 2].map(|c| row[3 * x + c]), at)
                };
                (0..width).flat_map(colour).collect::<Vec<f32>>()
            })?;
            image.samples = coloured.concat();
        }
        let saturated = fused.iter().filter(|fused| fused.saturated).count() as u64;
        if saturated > 0 {
            let text = format!(
                "the light of pixels that are white in the darkest exposure is a lower bound (count: {saturated})"
            );
            notes.warning("saturated-at-darkest", text);
        }
        cx.check()?;
        // The light of the ground is that of the photograph, because clipped pixels on the ground are glints and
        // lamps, whose recovered light does not depend on the light that falls on the ground.
        let balance = Balance::of(
            base.up,
            width,
            &base.alpha.samples,
            |at| luminance_of(&pixels, at),
            |at| f64::from(luminance(image.rgb(at % width, at / width))),
        );
        match params.ground_albedo {
            None => sky::report(&balance, &mut notes),
            Some(albedo) => {
                if let Some(radiance) = sky::radiance(&balance, albedo, &mut notes) {
                    sky::add(radiance, base.up, &base.alpha, &mut image, &mut fused, &mut lights);
                }
            }
        }
        lights.record("environment", |at| f64::from(luminance(image.rgb(at % width, at / width))));
        notes.count(
            "lights-not-listed",
            lights.unlisted(),
            "of the lights had to be left out of the lists in the report, which give their sum instead",
        );
        let report = lights.report(base.up, &pixels, &fused, &brackets.evs, params.gain);
        let env = Environment { image: image.into(), up: base.up, origin: base.origin };
        let image = env.image.pictures();
        Ok((Out { env: Arc::new(env), report: Arc::new(report), image }, notes))
    }
}

fn check_sizes(base: &Panorama, brackets: &Brackets) -> Result<(), NodeError> {
    let (width, height, channels) = base.image.size();
    let map = &brackets.log2_gain;
    let sized = |w: usize, h: usize| (w, h) == (width, height);
    if channels != 3 || matches!(base.image, Picture::Data(_)) || width == 0 || height == 0 {
        return Err(NodeError::from(Error::Mismatch("`base` is not an RGB panorama".to_owned())).at("base"));
    }
    let fits = sized(map.width, map.height)
        && map.channels == 1
        && brackets.colour.iter().all(|c| sized(c.width, c.height) && c.channels == 3)
        && brackets.exposures.len() == brackets.evs.len()
        && brackets.exposures.iter().all(|e| sized(e.width, e.height) && e.channels == 3);
    if !fits {
        let what =
            format!("the prediction is {}x{} pixels, but `base` is {width}x{height}", map.width, map.height);
        return Err(NodeError::from(Error::Mismatch(what))
            .at("brackets")
            .hint("wire `base` to the same panorama as the prediction's `pano`"));
    }
    Ok(())
}

/// Recomputes the gain of photographs if their transfer curve is not sRGB, since the gain was measured with the
/// sRGB curve.
fn by_own_curve(
    params: &FuseHdr,
    pixels: &LinearPixels,
    brackets: Arc<Brackets>,
    cx: &Context,
) -> Result<Arc<Brackets>, NodeError> {
    if brackets.taken != Taken::Display || params.transfer == Transfer::Srgb {
        return Ok(brackets);
    }
    let rows = cx.for_each_tile(pixels.height, |y| {
        let gain = |at: usize| {
            let own = pixels.rgb[at].map(|v| v.min(1.0));
            let shown = |i: usize| Shown::display(brackets.evs[i], exposure(params, &brackets, i, at).0);
            match brackets.log2_gain.samples[at] {
                0.0 => 0.0,
                _ => measured(own, (0..brackets.evs.len()).rev().map(shown)).map_or(0.0, |(gain, _)| gain),
            }
        };
        (y * pixels.width..(y + 1) * pixels.width).map(gain).collect::<Vec<f32>>()
    })?;
    let log2_gain = Image::from_samples(pixels.width, pixels.height, 1, rows.concat());
    Ok(Arc::new(Brackets { log2_gain, ..(*brackets).clone() }))
}

fn report_broken(pixels: &LinearPixels, notes: &mut Notes) {
    if pixels.broken > 0 {
        notes.warning(
            "not-finite",
            format!("samples that are not finite count as black (count: {})", pixels.broken),
        );
    }
    notes.count(
        "below-zero",
        pixels.negative,
        "of the samples had a value below 0, which was replaced with 0",
    );
}

/// Luminance of a pixel according to the gain map.
fn direct(pixels: &LinearPixels, brackets: &Brackets, at: usize) -> Fused {
    let held = f64::from(luminance(pixels.rgb[at].map(|v| v.min(1.0))));
    let gain = if pixels.ceiling { f64::from(brackets.log2_gain.samples[at]) } else { 0.0 };
    Fused { luminance: held * num::f64::exp2(gain), source: 0, saturated: false }
}

/// Fuses one pixel, beginning with the darkest exposure, as described in the paper's section on HDR construction.
/// The second result is the luminance according to the gain map or the exposures, before it is blended with the
/// panorama.
fn fuse(params: &FuseHdr, pixels: &LinearPixels, brackets: &Brackets, at: usize) -> (Fused, f64) {
    let base = pixels.rgb[at];
    let n = brackets.evs.len();
    let own = Fused { luminance: f64::from(luminance(base)), source: n, saturated: false };
    let kept = |saturated| (Fused { saturated, ..own }, own.luminance);
    let darkest = match params.gain {
        _ if !pixels.ceiling => return kept(false),
        Gain::Direct => {
            let taken = n > 0 && brackets.taken == Taken::Display;
            let bound = taken && exposure(params, brackets, 0, at).1.saturated;
            Fused { saturated: bound, ..direct(pixels, brackets, at) }
        }
        // The panorama itself is then the darkest exposure.
        Gain::Brackets if n == 0 => return kept(max3(base) >= WHITE),
        // Derived exposures show the panorama itself there, except for rounding.
        Gain::Brackets if brackets.taken == Taken::Derived && brackets.log2_gain.samples[at] == 0.0 => {
            return kept(false);
        }
        // Linear light is not clipped, so the brightest photograph shows all of it, and with the finest steps.
        Gain::Brackets if brackets.taken == Taken::Linear => exposure(params, brackets, n - 1, at).1,
        Gain::Brackets => (1..n).fold(exposure(params, brackets, 0, at).1, |fused, i| {
            let (linear, step) = exposure(params, brackets, i, at);
            merge(params, fused, linear, step, brackets.taken == Taken::Display)
        }),
    };
    let measured = brackets.taken != Taken::Derived && brackets.log2_gain.samples[at] > 0.0;
    let fused = merge(params, darkest, base, own, measured);
    (Fused { saturated: fused.saturated && fused.source != n, ..fused }, darkest.luminance)
}

/// Linear RGB of exposure `i`, and its luminance scaled to EV 0: E_i = L_i 2^-EV_i.
fn exposure(params: &FuseHdr, brackets: &Brackets, i: usize, at: usize) -> ([f32; 3], Fused) {
    let encoded = brackets.exposures[i].samples[3 * at..3 * at + 3].iter();
    let transfer = if brackets.taken == Taken::Display { params.transfer } else { Transfer::Srgb };
    let mut linear = [0.0; 3];
    for (to, value) in linear.iter_mut().zip(encoded) {
        *to = transfer.linear(*value);
    }
    let scaled = f64::from(luminance(linear)) * num::f64::exp2(-brackets.evs[i]);
    let saturated = match brackets.taken {
        Taken::Linear => false,
        Taken::Display => Shown::display(brackets.evs[i], linear).clipped,
        Taken::Derived => max3(linear) >= WHITE,
    };
    let saturated = i == 0 && saturated;
    (linear, Fused { luminance: scaled, source: i, saturated })
}

/// Degree to which a pixel is clipped, from its brightest channel: 0 at the threshold, 1 at white.
fn ramp(params: &FuseHdr, rgb: [f32; 3]) -> f32 {
    ((max3(rgb) - params.threshold) / (1.0 - params.threshold)).clamp(0.0, 1.0)
}

/// Performs one step of the merge: keeps the darker estimate where the brighter picture is clipped. Photographs
/// (`measured`) show the same light until they clip, so they need no gradual transition. A gradual transition would
/// also be wrong for a JPEG, in which white may be a code or two below white.
fn merge(params: &FuseHdr, darker: Fused, brighter: [f32; 3], own: Fused, measured: bool) -> Fused {
    match params.blend {
        Blend::Hard if luminance(brighter) > params.threshold => darker,
        Blend::Hard => own,
        Blend::Ramp => {
            let ramp = ramp(params, brighter);
            if ramp == 0.0 || darker.luminance <= own.luminance {
                return own;
            }
            if measured {
                return darker;
            }
            let m = f64::from(ramp);
            let mixed = own.luminance * (1.0 - m) + darker.luminance * m;
            let gained = darker.luminance * m > own.luminance * (1.0 - m);
            let main = if gained { darker } else { own };
            Fused { luminance: mixed, source: main.source, saturated: darker.saturated }
        }
    }
}

/// RGB of a pixel with the fused luminance. If a colour is given, the light by which the pixel becomes brighter has
/// this colour, whose luminance is 1. Otherwise the colour of the base is scaled: HDR = E'_N / L_N * I_N. Where
/// fusion changed nothing, the base is returned unchanged, so that black stays black and nothing is rounded.
fn apply(rgb: [f32; 3], fused: f64, colour: Option<[f32; 3]>) -> [f32; 3] {
    let own = f64::from(luminance(rgb));
    if fused == own {
        return rgb;
    }
    if let Some(colour) = colour.filter(|colour| fused > own && luminance(*colour) > 0.0) {
        let lit = |c: usize| f64::from(rgb[c]) + f64::from(colour[c]) * (fused - own);
        return [0, 1, 2].map(|c| lit(c).min(f64::from(f32::MAX)) as f32);
    }
    rgb.map(|v| (f64::from(v) * (fused / own)).min(f64::from(f32::MAX)) as f32)
}

/// Colour of a pixel, at the luminance of `fused`. The colour comes from the brightest exposure that is not clipped
/// there, since that exposure has the finest quantisation. Where the panorama is only partly clipped, this colour
/// is blended with the colour of `fused`.
fn recolour(params: &FuseHdr, brackets: &Brackets, base: [f32; 3], fused: [f32; 3], at: usize) -> [f32; 3] {
    let clipped = match params.blend {
        Blend::Hard if luminance(base) > params.threshold => 1.0,
        Blend::Hard => 0.0,
        Blend::Ramp => ramp(params, base),
    };
    // Unchanged pixels keep their colour.
    if clipped == 0.0 || fused == base {
        return fused;
    }
    let seen = (0..brackets.evs.len()).rev().map(|i| exposure(params, brackets, i, at).0);
    let open = |rgb: &[f32; 3]| brackets.taken == Taken::Linear || max3(*rgb) <= params.threshold;
    let Some(colour) = seen.into_iter().find(open) else {
        return fused;
    };
    let (own, wanted) = (f64::from(luminance(colour)), f64::from(luminance(fused)));
    if own <= 0.0 {
        return fused;
    }
    let m = f64::from(clipped);
    let mixed = |c: usize| f64::from(fused[c]) * (1.0 - m) + f64::from(colour[c]) * (wanted / own) * m;
    [0, 1, 2].map(|c| mixed(c).min(f64::from(f32::MAX)) as f32)
}

#[cfg(test)]
mod tests;
