//! Comparison of one picture with the reference.

use engine::{Context, NodeError};
use scene::math::color::srgb_from_linear;
use scene::math::metrics::{
    Errors, Exposures, Lpips, Plane, SSIM_RADIUS, Sight, ciede2000_map, errors, hdr_flip_map, mean_over,
    quantile_over, ssim_map,
};
use scene::math::num;
use scene::types::layers::{coloured, linear};
use scene::types::{Data, Image, Picture};

use super::params::{Compare, Space};

/// Lower bound for the values of a ratio. Smaller values are clamped to it, so that a pitch-black shadow, which
/// `shadow-ratio` may produce, has a finite error and is not left out.
const DARKEST: f64 = 0.001;

/// Two pictures in the encoding of the comparison.
pub struct Pair {
    a: Plane,
    b: Plane,
    kind: Of,
}

enum Of {
    Colours(Box<Colours>),
    Data,
}

/// Measures that exist for colours only. Maps contain one value per pixel.
struct Colours {
    light: (Plane, Plane),
    ssim: Vec<f64>,
    /// FLIP per pixel. `None` if HDR-FLIP finds no exposure because half of the reference is black.
    flip: Option<Vec<f64>>,
    ciede2000: Option<Vec<f64>>,
    lpips: Option<f64>,
}

/// The measures of one region.
pub struct Row {
    pub errors: Errors,
    pub ssim: Option<f64>,
    pub ssim_valid: Option<f64>,
    pub flip: Option<f64>,
    pub flip_p95: Option<f64>,
    pub ciede2000: Option<f64>,
    pub lpips: Option<f64>,
    pub relative: Option<f64>,
    pub log_error: Option<f64>,
    pub iou: Option<f64>,
}

impl Pair {
    pub fn new(
        p: &Compare,
        a: &Picture,
        b: &Picture,
        lpips: Option<&Lpips>,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let data = |picture: &Picture| matches!(picture, Picture::Data(_));
        if data(a) || data(b) {
            if a.encoding() != b.encoding() {
                let what =
                    format!("the encodings `{}` and `{}` cannot be compared", a.encoding(), b.encoding());
                return Err(NodeError::new(what).at("reference"));
            }
            let (of_a, of_b) = (a.size().2, b.size().2);
            if of_a != of_b {
                let what = format!(
                    "pictures of data must have equal numbers of channels (picture: {of_a}, reference: {of_b})"
                );
                let hint = "select the channels of an OpenEXR file with `layer` of `load-image`";
                return Err(NodeError::new(what).at("reference").hint(hint));
            }
            let (mut a, mut b) = (plain(a), plain(b));
            level_infinite(&mut a, &mut b);
            return Ok(Self { a, b, kind: Of::Data });
        }
        let (a, b) = (coloured(a), coloured(b));
        let (a, b) = (&*a, &*b);
        let light = (light(a, "image")?, light(b, "reference")?);
        let (a, b) = match p.space {
            Space::Display => (display(p, a), display(p, b)),
            Space::Linear => (copy(&light.0), copy(&light.1)),
        };
        let ssim = ssim_map(&a, &b, cx)?;
        let density = p.pixels_per_degree;
        let mut colours = Colours { light, ssim, flip: None, ciede2000: None, lpips: None };
        match p.space {
            Space::Display => {
                let sight = |plane: &Plane| Sight::of(&decoded(plane), density, cx);
                colours.flip = Some(sight(&b)?.flip(&sight(&a)?, cx)?);
                colours.ciede2000 = Some(ciede2000_map(&a, &b, cx)?);
                if let Some(network) = lpips {
                    colours.lpips = network.distance(&b, &a, p.lpips_scaled, cx)?;
                }
            }
            Space::Linear => {
                if let Some(exposures) = Exposures::of(&b) {
                    colours.flip = Some(hdr_flip_map(&b, &a, exposures, density, cx)?);
                }
            }
        }
        Ok(Self { a, b, kind: Of::Colours(Box::new(colours)) })
    }

    pub fn is_colour(&self) -> bool {
        matches!(self.kind, Of::Colours(_))
    }

    /// Ids and texts of the notes about requested measures that could not be computed.
    pub fn not_computed(&self, p: &Compare, masked: bool) -> Vec<(&'static str, String)> {
        let mut missing = Vec::new();
        let broken = |plane: &Plane| plane.samples.iter().filter(|v| v.is_nan()).count();
        let broken = broken(&self.a).max(broken(&self.b));
        if broken > 0 && !self.is_colour() {
            let text = "of the samples had the value NaN, so the mean over a region with such a sample is not computed";
            missing.push(("not-a-number", format!("{broken} {text}")));
        }
        let colours = if let Of::Colours(colours) = &self.kind { Some(colours) } else { None };
        if colours.is_some_and(|c| c.flip.is_none()) {
            let why = "half of the reference is black, so no exposure for HDR-FLIP can be computed";
            missing.push(("no-flip", why.to_owned()));
        }
        if colours.is_some_and(|c| c.ciede2000.is_none()) {
            missing.push(("no-ciede2000", "CIEDE2000 is not computed in linear light".to_owned()));
        }
        if p.lpips.is_some() && (masked || colours.is_none_or(|c| c.lpips.is_none())) {
            let why = match (colours, p.space) {
                (None, _) => "LPIPS is not computed for data",
                (_, Space::Linear) => "LPIPS is not computed in linear light",
                _ if masked => "LPIPS is computed for whole pictures only, not with a `mask`",
                _ => "the picture is too small for the LPIPS network",
            };
            missing.push(("no-lpips", why.to_owned()));
        }
        missing
    }

    pub fn row(&self, region: Option<&[bool]>, mask: Option<&[bool]>) -> Option<Row> {
        let counts = |pixel: usize| region.is_none_or(|r| r[pixel]) && mask.is_none_or(|m| m[pixel]);
        let errors_here = errors(&self.a, &self.b, counts);
        if errors_here.pixels == 0 {
            return None;
        }
        let mut row = Row {
            errors: errors_here,
            ssim: None,
            ssim_valid: None,
            flip: None,
            flip_p95: None,
            ciede2000: None,
            lpips: None,
            relative: None,
            log_error: None,
            iou: None,
        };
        match &self.kind {
            Of::Data => (row.log_error, row.iou) = self.ratio(counts),
            Of::Colours(colours) => {
                let whole = region.is_none() && mask.is_none();
                let (width, height) = (self.a.width, self.a.height);
                let interior = |pixel: usize| {
                    let (x, y) = (pixel % width, pixel / width);
                    let r = SSIM_RADIUS;
                    x >= r && y >= r && x + r < width && y + r < height
                };
                row.ssim = mean_over(&colours.ssim, counts);
                row.ssim_valid = if whole { mean_over(&colours.ssim, interior) } else { None };
                if let Some(map) = &colours.flip {
                    row.flip = mean_over(map, counts);
                    row.flip_p95 = quantile_over(map, 0.95, counts);
                }
                row.ciede2000 = colours.ciede2000.as_ref().and_then(|map| mean_over(map, counts));
                row.lpips = colours.lpips.filter(|_| whole);
                row.relative = Some(errors(&colours.light.0, &colours.light.1, counts).relative_square);
            }
        }
        Some(row)
    }

    /// Measures for ratios: the mean of `|ln a - ln b|` over samples clamped to at least [`DARKEST`], and the
    /// intersection over union of the shadows, which are the pixels whose mean is below 0.98.
    fn ratio(&self, counts: impl Fn(usize) -> bool) -> (Option<f64>, Option<f64>) {
        let channels = self.a.channels.min(self.b.channels).max(1);
        let (mut sum, mut samples, mut both, mut either) = (0.0, 0_u64, 0_u64, 0_u64);
        let pixels = self.a.samples.chunks_exact(self.a.channels.max(1));
        for (i, (a, b)) in pixels.zip(self.b.samples.chunks_exact(self.b.channels.max(1))).enumerate() {
            if !counts(i) {
                continue;
            }
            for (a, b) in a.iter().zip(b).take(channels) {
                // NaN is kept, which makes the mean NaN too.
                let ln = |v: f64| if v < DARKEST { num::f64::ln(DARKEST) } else { num::f64::ln(v) };
                sum += (ln(*a) - ln(*b)).abs();
                samples += 1;
            }
            let dark = |p: &[f64]| p[..channels].iter().sum::<f64>() / (channels as f64) < 0.98;
            both += u64::from(dark(a) && dark(b));
            either += u64::from(dark(a) || dark(b));
        }
        let share = |part: f64, whole: u64| (whole > 0).then(|| part / whole as f64);
        (share(sum, samples), share(both as f64, either))
    }

    pub fn flip(&self) -> Option<Image<Data>> {
        let Of::Colours(colours) = &self.kind else { return None };
        let samples = colours.flip.as_ref()?.iter().map(|v| *v as f32).collect();
        Some(Image::from_samples(self.a.width, self.a.height, 1, samples))
    }

    pub fn difference(&self, gain: f64) -> Image<Data> {
        let channels = self.a.channels.min(self.b.channels);
        let pixels =
            self.a.samples.chunks_exact(self.a.channels).zip(self.b.samples.chunks_exact(self.b.channels));
        let samples = pixels
            .flat_map(|(a, b)| {
                a.iter().zip(b).take(channels).map(|(a, b)| {
                    let d = (a - b).abs() * gain;
                    // Two infinite depths do not differ.
                    if d.is_nan() { 0.0 } else { d as f32 }
                })
            })
            .collect();
        Image::from_samples(self.a.width, self.a.height, channels, samples)
    }
}

/// Replaces values that are infinite in both pictures, such as the depth of the background, with the same finite
/// number, so that they do not differ. The number is on the same side of every threshold as the values that it
/// replaces.
fn level_infinite(a: &mut Plane, b: &mut Plane) {
    for (a, b) in a.samples.iter_mut().zip(&mut b.samples) {
        if a.is_infinite() && a == b {
            (*a, *b) = if *a > 0.0 { (1.0, 1.0) } else { (0.0, 0.0) };
        }
    }
}

fn copy(plane: &Plane) -> Plane {
    Plane { samples: plane.samples.clone(), ..*plane }
}

fn plain(picture: &Picture) -> Plane {
    let (width, height, channels) = picture.size();
    Plane { width, height, channels, samples: picture.samples().iter().map(|v| f64::from(*v)).collect() }
}

/// The colour channels in linear light, premultiplied by alpha, as if the picture were composited on black.
fn light(picture: &Picture, port: &'static str) -> Result<Plane, NodeError> {
    let image = linear(picture, port)?;
    let samples = image.samples.chunks_exact(image.channels).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from);
    Ok(Plane { width: image.width, height: image.height, channels: 3, samples: samples.collect() })
}

/// The colour channels as display values, composited on black in the encoding of the picture: display-encoded
/// pictures in display values, linear pictures in linear light.
fn display(p: &Compare, picture: &Picture) -> Plane {
    let (width, height, channels) = picture.size();
    let is_linear = matches!(picture, Picture::Linear(_));
    let shown = |v: &f32| {
        let v = f64::from(if is_linear { srgb_from_linear(*v) } else { *v }).clamp(0.0, 1.0);
        if p.quantise { (v * 255.0 + 0.5).floor() / 255.0 } else { v }
    };
    let samples = picture.samples().chunks_exact(channels).flat_map(|pixel| pixel[..3].iter().map(shown));
    Plane { width, height, channels: 3, samples: samples.collect() }
}

/// Linear light of display values, in f64.
fn decoded(plane: &Plane) -> Plane {
    let decode = |v: &f64| if *v > 0.04045 { num::pow((v + 0.055) / 1.055, 2.4) } else { v / 12.92 };
    Plane { samples: plane.samples.iter().map(decode).collect(), ..*plane }
}
