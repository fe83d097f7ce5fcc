//! Darker photographs of the same scene, from which hidden light is measured instead of estimated.

use engine::{Context, InputFile, NodeError, Notes};
use render::light::exposure::{DARKEST, Shown, WHITE, measured};
use render::light::linear::{LinearPixels, Transfer, max3};
use render::light::whole_sphere::{premultiplied, straight};
use render::light::whole_sphere::{turn, whole};
use scene::error::Error;
use scene::io::picture::{FileEncoding, decode};
use scene::io::progress::Progress;
use scene::math::color::srgb_from_linear;
use scene::math::num;
use scene::types::{Image, Panorama, Picture, Srgb, Taken};

use super::exposures::exposed;
use render::light::hidden::clip::SEEN;

/// Number of stops by which a photograph must show more light at a pixel for the pixel to count as clipped. At ten
/// stops below white, this is half an 8-bit code.
const BRIGHTER: f32 = 0.25;
/// Luminance of the 8-bit code 4. Pixels darker than this in a photograph are not used to check the photograph, if
/// there are enough others.
const SHOWN: f64 = 1.2e-3;
/// Minimum number of pixels that are needed to check a photograph.
const FEWEST: usize = 16;
/// Limits above which the light of a photograph contradicts the other pictures, in stops. The first limit is for
/// the median of the differences at all pixels, and the second for the median deviation from this median.
const APART: [f32; 2] = [0.5, 1.0];
/// Maximum share of pixels that may be too dark in a photograph, among the pixels that are white in all brighter
/// pictures. For the 74 panoramas of hdri-train, this share is 0 for photographs made from the same panorama. It
/// exceeds the limit for 99 of 100 photographs that show another place, are mirrored, or are rotated by 56 degrees;
/// for two of three that are rotated by 4 degrees; and for one of three that are rotated by one degree.
const SHORT: f64 = 0.1;

/// Checks that there is one file per exposure.
pub(super) fn check(files: &[InputFile], evs: &[f64]) -> Result<(), NodeError> {
    if files.len() == evs.len() && !files.is_empty() {
        return Ok(());
    }
    let text = format!(
        "`evs` must list one exposure per photograph (photographs: {}, exposures: {})",
        files.len(),
        evs.len()
    );
    Err(NodeError::new(text).at("method").hint("list the exposure of each file in `evs`, in the same order"))
}

struct Photograph {
    ev: f64,
    name: String,
    /// Linear light.
    rgb: Vec<[f32; 3]>,
    alpha: Vec<f32>,
    /// True if the file holds linear light, which is not clipped at white.
    linear: bool,
}

impl Photograph {
    /// Light of a pixel in the photograph. `None` in a hole.
    fn shown(&self, at: usize) -> Option<Shown> {
        let (ev, rgb) = (self.ev, self.rgb[at]);
        let shown = if self.linear { Shown { ev, rgb, clipped: false } } else { Shown::display(ev, rgb) };
        (self.alpha[at] >= SEEN).then_some(shown)
    }
}

/// Comparison of a photograph with brighter pictures at one pixel.
#[derive(Clone, Copy)]
struct Off {
    /// Number of stops by which the photograph shows more light than the brighter pictures.
    stops: f32,
    /// True if all brighter pictures are clipped at the pixel, so that the photograph must show at least as much
    /// light.
    white: bool,
}

impl Photograph {
    /// Compares a pixel with the brighter pictures `others`, in order from the brightest. `None` if no picture can
    /// be compared.
    fn off(&self, at: usize, others: impl Iterator<Item = Shown>) -> Option<Off> {
        let (mut light, mut white) = (0.0_f64, true);
        for other in others {
            // The light is at least that of each clipped picture.
            light = if other.clipped { light.max(other.light()) } else { other.light() };
            white = other.clipped;
            if !white {
                break;
            }
        }
        let wanted = light * num::f64::exp2(self.ev);
        if wanted < SHOWN || (!white && wanted > f64::from(WHITE) && !self.linear) {
            return None;
        }
        let stops = num::f64::log2(self.shown(at)?.light().max(light * DARKEST) / light) as f32;
        Some(Off { stops, white })
    }

    /// Warns if the photograph contradicts the brighter pictures.
    fn report(&self, shown: &[Off], white: &[Off], notes: &mut Notes) {
        let taken = format!("in `{}`, taken at EV {},", self.name, self.ev);
        let mut off: Vec<f32> = shown.iter().map(|off| off.stops).collect();
        let enough = off.len() >= FEWEST;
        let middle = if enough { median(&mut off) } else { 0.0 };
        off.iter_mut().for_each(|stops| *stops = (*stops - middle).abs());
        let apart = if enough { median(&mut off) } else { 0.0 };
        let short = white.iter().filter(|off| off.stops < -APART[0]).count();
        if middle.abs() > APART[0] || apart > APART[1] {
            let (stops, than) = (middle.abs(), if middle > 0.0 { "brighter" } else { "darker" });
            let text = format!(
                "{taken} the median of {} pixels is {stops:.1} stops {than} than in the panorama or a brighter photograph (half of the pixels are within {apart:.1} stops of the median); check the exposure of the photograph, and that it shows the same place",
                shown.len()
            );
            notes.warning("photograph-disagrees", text);
        } else if short as f64 > SHORT * white.len() as f64 {
            let text = format!(
                "{taken} {short} of the {} pixels that are white in brighter pictures show less light than this white requires; check that the photograph shows the same place and is not rotated",
                white.len()
            );
            notes.warning("photograph-disagrees", text);
        } else if !enough {
            let text = format!(
                "{taken} too few pixels can be compared with the panorama or brighter photographs, so its exposure is not checked"
            );
            notes.decision("photograph-unchecked", text);
        }
    }
}

/// Photographs of a panorama, darkest first, rotated like the panorama.
pub(super) struct Photographs(Vec<Photograph>);

impl Photographs {
    /// Reads the files as `load-panorama` does.
    pub fn read(
        files: &[InputFile],
        evs: &[f64],
        pano: &Panorama,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let mut taken = Vec::with_capacity(files.len());
        for (i, (file, &ev)) in files.iter().zip(evs).enumerate() {
            let progress = Progress::of(cx, 0.0, 0.5).piece(i, files.len());
            taken.push(read(file, ev, pano, notes, progress, cx).map_err(|error| error.at("method"))?);
        }
        if let Some(other) = taken.iter().find(|other| other.linear != taken[0].linear) {
            let kind = |linear| if linear { "linear light" } else { "display colours" };
            let (this, that) = (kind(taken[0].linear), kind(other.linear));
            let text = format!("`{}` holds {this}, but `{}` holds {that}", taken[0].name, other.name);
            return Err(NodeError::new(text)
                .at("method")
                .hint("give all photographs as PNG and JPEG, or all as OpenEXR and Radiance"));
        }
        let columns = pano.turned_deg / 360.0 * pano.alpha.width as f64;
        if (columns - columns.round()).abs() > 1e-6 {
            let text = "the panorama was rotated by a fraction of a column and its photographs by whole columns, so they differ by up to half a pixel";
            notes.warning("photographs-between-pixels", text);
        }
        taken.sort_by(|a, b| a.ev.total_cmp(&b.ev));
        Ok(Self(taken))
    }

    /// Encoding of the photographs, which is the same for all.
    pub fn taken(&self) -> Taken {
        if self.0.iter().any(|photograph| photograph.linear) { Taken::Linear } else { Taken::Display }
    }

    /// Warns about photographs that contradict the panorama or a brighter photograph. A photograph contradicts them if
    /// its radiance differs at pixels where the brighter picture is not clipped, or is less than the clipping level
    /// at pixels where all brighter pictures are clipped.
    pub fn compare(
        &self,
        (pixels, alpha): (&LinearPixels, &[f32]),
        white: f32,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<(), NodeError> {
        let white = white.min(WHITE);
        let known = |at: usize| {
            let (rgb, clipped) = (pixels.rgb[at], pixels.ceiling && max3(pixels.rgb[at]) > white);
            (alpha[at] >= SEEN).then_some(Shown { ev: 0.0, rgb, clipped })
        };
        for (i, photograph) in self.0.iter().enumerate().rev() {
            let brighter = &self.0[i + 1..];
            let rows = cx.for_each_tile(pixels.height, |y| {
                let off = |at: usize| {
                    let others = brighter.iter().rev().filter_map(|other| other.shown(at));
                    photograph.off(at, known(at).into_iter().chain(others))
                };
                (y * pixels.width..(y + 1) * pixels.width).filter_map(off).collect::<Vec<_>>()
            })?;
            let (shown, white): (Vec<Off>, Vec<Off>) = rows.concat().into_iter().partition(|off| !off.white);
            photograph.report(&shown, &white, notes);
        }
        Ok(())
    }

    /// Adds pixels slightly below the white level to the mask, since they may be clipped too. A pixel is added if a
    /// photograph shows more light there, and the difference is larger than the rounding of codes.
    pub fn add_clipped(
        &self,
        pixels: &LinearPixels,
        mask: &mut [bool],
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<(), NodeError> {
        if !pixels.ceiling {
            return Ok(());
        }
        let rows = cx.for_each_tile(pixels.height, |y| {
            let brighter = |at: usize| {
                let shown = || self.0.iter().rev().filter_map(|taken| taken.shown(at));
                let whiteish = !mask[at] && max3(pixels.rgb[at]) > WHITE;
                whiteish && measured(pixels.rgb[at], shown()).is_some_and(|(gain, _)| gain > BRIGHTER)
            };
            (y * pixels.width..(y + 1) * pixels.width).map(brighter).collect::<Vec<_>>()
        })?;
        let mut added = 0;
        for (clipped, brighter) in mask.iter_mut().zip(rows.iter().flatten()) {
            *clipped |= *brighter;
            added += u64::from(*brighter);
        }
        notes.count(
            "white-early",
            added,
            "of the pixels below `white` had to count as clipped, since a photograph shows more light there",
        );
        Ok(())
    }

    /// log2 gain of every clipped pixel.
    pub fn gains(
        &self,
        (pixels, mask): (&LinearPixels, &[bool]),
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Vec<f32>, NodeError> {
        let rows = cx.for_each_tile(pixels.height, |y| {
            let gain = |at: usize| match mask[at] {
                true => measured(pixels.rgb[at], self.0.iter().rev().filter_map(|taken| taken.shown(at))),
                false => Some((0.0, false)),
            };
            (y * pixels.width..(y + 1) * pixels.width).map(gain).collect::<Vec<_>>()
        })?;
        let still = rows.iter().flatten().filter(|gain| matches!(gain, Some((_, true)))).count();
        report_still(still, notes);
        let unseen = rows.iter().flatten().filter(|gain| gain.is_none()).count();
        if unseen > 0 {
            let text = format!(
                "clipped pixels that are holes in every photograph are not changed (count: {unseen})"
            );
            notes.warning("photographs-have-holes", text);
        }
        Ok(rows.iter().flatten().map(|gain| gain.map_or(0.0, |(gain, _)| gain)).collect())
    }

    /// Photographs as pictures, with values above 1 where linear light is above white. Holes show the exposure that
    /// is derived from the gain.
    pub fn pictures(
        &self,
        pixels: &LinearPixels,
        log2_gain: &[f32],
        cx: &Context,
    ) -> Result<Vec<Image<Srgb>>, NodeError> {
        cx.for_each_tile(self.0.len(), |i| {
            let photograph = &self.0[i];
            let codes = |at: usize| match photograph.shown(at) {
                Some(shown) => shown.rgb.map(srgb_from_linear),
                None => {
                    let white = if photograph.linear { f32::MAX } else { 1.0 };
                    exposed(pixels.rgb[at], (log2_gain[at], None), photograph.ev, white)
                }
            };
            let samples = (0..pixels.rgb.len()).flat_map(codes).collect();
            Image::from_samples(pixels.width, pixels.height, 3, samples)
        })
    }
}

fn read(
    file: &InputFile,
    ev: f64,
    pano: &Panorama,
    notes: &mut Notes,
    progress: Progress<'_>,
    cx: &Context,
) -> Result<Photograph, NodeError> {
    let bytes = cx.read(file)?;
    let picture = decode(FileEncoding::Auto, "", &file.0, &bytes, notes, progress)?;
    let picture = whole(&file.0, &bytes, picture, notes)?;
    let (width, height, _) = picture.size();
    let (wanted, tall) = (pano.alpha.width, pano.alpha.height);
    if (width, height) != (wanted, tall) {
        let what = format!("is {width}x{height} pixels, but the panorama is {wanted}x{tall}");
        return Err(Error::format(&file.0, what).into());
    }
    let linear = matches!(picture, Picture::Linear(_));
    let pixels = premultiplied(&picture, notes)?;
    drop(picture);
    // By whole columns, so that white pixels stay white.
    let column = 360.0 / width as f64;
    let turned_deg = (pano.turned_deg / column).round() * column;
    let (samples, alpha) = straight(turn(&pixels, width, turned_deg, cx)?);
    let light = |v: f32| if linear { v } else { Transfer::Srgb.linear(v).min(1.0) };
    let rgb = samples.as_chunks::<3>().0.iter().map(|rgb| rgb.map(light)).collect();
    Ok(Photograph { ev, name: file.0.clone(), rgb, alpha, linear })
}

/// Median of a non-empty list. Of two middle values, the lower is returned.
fn median(of: &mut [f32]) -> f32 {
    let middle = (of.len() - 1) / 2;
    *of.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Warns about pixels that are clipped even in the darkest exposure.
pub(super) fn report_still(pixels: usize, notes: &mut Notes) {
    if pixels > 0 {
        notes.warning(
            "still-clipped",
            format!("the gain of pixels that are clipped even in the darkest exposure that shows them is a lower bound (count: {pixels}); add a darker exposure to `evs`"),
        );
    }
}

#[cfg(test)]
mod tests;
