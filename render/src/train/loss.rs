//! Loss between a rendered view and a photograph, with its gradient: L1 and D-SSIM as in 3D Gaussian splatting.
//!
//! Pixels that the mask excludes are ignored. A channel at which the photograph clips is ignored if the view is
//! brighter still, since the photograph does not say how bright the place is. In both cases the view is replaced
//! with the photograph, so that the windows of SSIM around such pixels see no difference either.

use std::ops::Range;

use engine::{Context, NodeError};
use fearless_simd::{Level, Simd, dispatch};

use super::window::{RADIUS, Window};
use crate::splat::gradient::PictureGradient;

/// Share of D-SSIM in the loss; the rest is L1.
pub const DSSIM_SHARE: f32 = 0.2;
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;
/// Number of rows per job. It is fixed, so that sums do not depend on the number of threads.
const BAND: usize = 64;
const LANES: usize = 8;

/// A photograph as the target of a view: for each pixel red, green, blue, and 255 if the pixel is compared or 0 if
/// it is ignored.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// Width of the photograph, in pixels.
    pub width: usize,
    /// Pixels, row by row.
    pub pixels: &'a [[u8; 4]],
}

/// How the premultiplied colour of a view becomes the colour that is compared: `gain * (colour + (1 - alpha) *
/// background)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    /// Factor on each channel, for the exposure of the photograph.
    pub gain: [f32; 3],
    /// Colour behind all splats.
    pub background: [f32; 3],
}

impl Default for Shown {
    /// Returns a gain of 1 and a black background.
    fn default() -> Self {
        Self { gain: [1.0; 3], background: [0.0; 3] }
    }
}

/// Value and gradient of the loss of a view.
pub struct Loss {
    /// Value of the loss.
    pub value: f64,
    /// Mean absolute difference over pixels and channels.
    pub absolute: f64,
    /// Mean SSIM over pixels and channels.
    pub ssim: f64,
    /// Gradient with respect to the rendered picture.
    pub picture: PictureGradient,
    /// Gradient with respect to the logarithm of the gain.
    pub log_gain: [f32; 3],
    /// Gradient with respect to the background.
    pub background: [f32; 3],
}

/// One channel of the compared pictures.
struct Channel {
    /// The view.
    x: Vec<f32>,
    /// The photograph.
    y: Vec<f32>,
    /// 1 where the pixel is compared, 0 where it is ignored.
    kept: Vec<f32>,
}

/// Derivatives of the sum of SSIM over a band by the windowed means of `x`, of `x^2 + y^2` and of `x y`.
struct Band {
    by: [Vec<f32>; 3],
    ssim: f64,
    absolute: f64,
}

/// Computes the loss of a view whose premultiplied RGB and alpha are `rgba`.
pub fn loss(
    rgba: &[[f32; 4]],
    target: &Target<'_>,
    shown: &Shown,
    cx: &Context,
    level: Level,
) -> Result<Loss, NodeError> {
    let width = target.width;
    let height = rgba.len() / width.max(1);
    let channels = cx.for_each_tile(3, |c| channel(rgba, target, shown, c))?;
    let bands = height.div_ceil(BAND);
    let window = Window::new();
    let rows = |band: usize| band * BAND..((band + 1) * BAND).min(height);
    let compared = cx.for_each_tile(3 * bands, |job| {
        let (channel, rows) = (&channels[job / bands], rows(job % bands));
        dispatch!(level, simd => compare(simd, &window, channel, (width, height), rows))
    })?;
    let count = (3 * width * height).max(1) as f32;
    let gradients = cx.for_each_tile(3 * bands, |job| {
        let (c, band) = (job / bands, job % bands);
        let (channel, compared) = (&channels[c], &compared[c * bands..(c + 1) * bands]);
        dispatch!(level, simd => differentiate(simd, &window, channel, compared, (width, height, count), rows(band)))
    })?;
    let mut by_shown = [Vec::new(), Vec::new(), Vec::new()];
    for (c, planes) in by_shown.iter_mut().enumerate() {
        *planes = gradients[c * bands..(c + 1) * bands].concat();
    }
    let (mut ssim, mut absolute) = (0.0, 0.0);
    for band in &compared {
        ssim += band.ssim;
        absolute += band.absolute;
    }
    let (ssim, absolute) = (ssim / f64::from(count), absolute / f64::from(count));
    let share = f64::from(DSSIM_SHARE);
    let value = (1.0 - share) * absolute + share * (1.0 - ssim);
    let through = cx.for_each_tile(bands, |band| {
        let pixels = band * BAND * width..((band + 1) * BAND * width).min(rgba.len());
        through_shown(rgba, &by_shown, shown, pixels)
    })?;
    let (mut alpha, mut log_gain, mut background) =
        (Vec::with_capacity(rgba.len()), [0.0_f32; 3], [0.0_f32; 3]);
    for (plane, gain, behind) in through {
        alpha.extend_from_slice(&plane);
        for c in 0..3 {
            log_gain[c] += gain[c];
            background[c] += behind[c];
        }
    }
    for (plane, gain) in by_shown.iter_mut().zip(shown.gain) {
        plane.iter_mut().for_each(|value| *value *= gain);
    }
    Ok(Loss {
        value,
        absolute,
        ssim,
        picture: PictureGradient { rgb: by_shown, alpha },
        log_gain,
        background,
    })
}

/// Prepares one channel for comparison.
fn channel(rgba: &[[f32; 4]], target: &Target<'_>, shown: &Shown, c: usize) -> Channel {
    let codes: [f32; 256] = std::array::from_fn(|code| code as f32 / 255.0);
    let (gain, behind) = (shown.gain[c], shown.background[c]);
    let mut out = Channel {
        x: Vec::with_capacity(rgba.len()),
        y: Vec::with_capacity(rgba.len()),
        kept: Vec::with_capacity(rgba.len()),
    };
    for (pixel, photo) in rgba.iter().zip(target.pixels) {
        let y = codes[usize::from(photo[c])];
        let x = gain * (pixel[c] + (1.0 - pixel[3]) * behind);
        let ignored = photo[3] == 0 || (photo[c] == u8::MAX && x > y) || (photo[c] == 0 && x < y);
        out.x.push(if ignored { y } else { x });
        out.y.push(y);
        out.kept.push(if ignored { 0.0 } else { 1.0 });
    }
    out
}

/// Rows of `maps` maps, windowed along rows, for the rows of a band and [`RADIUS`] rows above and below. Rows
/// beyond the border are 0.
struct Windowed<const MAPS: usize> {
    width: usize,
    first: usize,
    values: [Vec<f32>; MAPS],
}

impl<const MAPS: usize> Windowed<MAPS> {
    /// Computes the rows. `fill` writes one row of each map.
    #[inline(always)]
    fn of(
        window: &Window,
        (width, height): (usize, usize),
        rows: &Range<usize>,
        fill: impl Fn(usize, [&mut [f32]; MAPS]),
    ) -> Self {
        let count = rows.len() + 2 * RADIUS;
        let mut values: [Vec<f32>; MAPS] = std::array::from_fn(|_| vec![0.0; count * width]);
        let mut padded: [Vec<f32>; MAPS] = std::array::from_fn(|_| vec![0.0; width + 2 * RADIUS]);
        for at in 0..count {
            let Some(row) = (rows.start + at).checked_sub(RADIUS).filter(|row| *row < height) else {
                continue;
            };
            fill(row, padded.each_mut().map(|padded| &mut padded[RADIUS..RADIUS + width]));
            for (values, padded) in values.iter_mut().zip(&padded) {
                window.along(padded, &mut values[at * width..(at + 1) * width]);
            }
        }
        Self { width, first: rows.start, values }
    }

    /// Writes the row `row` of each map, windowed in both directions.
    #[inline(always)]
    fn row(&self, window: &Window, row: usize, out: &mut [Vec<f32>; MAPS]) {
        for (values, out) in self.values.iter().zip(out) {
            let at = row - self.first;
            window.apply(std::array::from_fn(|k| &values[(at + k) * self.width..]), out);
        }
    }
}

/// Computes SSIM and the absolute differences in a band of rows.
#[inline(always)]
fn compare<S: Simd>(
    _simd: S,
    window: &Window,
    channel: &Channel,
    (width, height): (usize, usize),
    rows: Range<usize>,
) -> Band {
    let Channel { x, y, .. } = channel;
    let windowed = Windowed::<4>::of(window, (width, height), &rows, |row, [to_x, to_y, both, product]| {
        let (x, y) = (&x[row * width..(row + 1) * width], &y[row * width..(row + 1) * width]);
        to_x.copy_from_slice(x);
        to_y.copy_from_slice(y);
        for ((both, product), (x, y)) in both.iter_mut().zip(product).zip(x.iter().zip(y)) {
            *both = x * x + y * y;
            *product = x * y;
        }
    });
    let mut means: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; width]);
    let mut by: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; rows.len() * width]);
    let (mut ssim, mut absolute) = (0.0, 0.0);
    let mut ssims = vec![0.0_f32; width];
    for row in rows.clone() {
        windowed.row(window, row, &mut means);
        let at = (row - rows.start) * width;
        let [by_mean, by_both, by_product] = by.each_mut().map(|by| &mut by[at..at + width]);
        let [mean_x, mean_y, both, product] = means.each_ref().map(|mean| &mean[..width]);
        let ssims = &mut ssims[..width];
        for i in 0..width {
            let (mx, my) = (mean_x[i], mean_y[i]);
            let (mm, squares) = (mx * my, mx * mx + my * my);
            let (a1, a2) = (2.0 * mm + C1, 2.0 * (product[i] - mm) + C2);
            let (b1, b2) = (squares + C1, both[i] - squares + C2);
            let inverse = 1.0 / (b1 * b2);
            let value = a1 * a2 * inverse;
            ssims[i] = value;
            by_product[i] = 2.0 * a1 * inverse;
            by_both[i] = -value * b1 * inverse;
            by_mean[i] = 2.0 * my * (a2 - a1) * inverse + 2.0 * mx * value * (b1 - b2) * inverse;
        }
        ssim += sum(ssims);
        let (x, y) = (&x[row * width..(row + 1) * width], &y[row * width..(row + 1) * width]);
        for ((to, x), y) in ssims.iter_mut().zip(x).zip(y) {
            *to = (x - y).abs();
        }
        absolute += sum(ssims);
    }
    Band { by, ssim, absolute }
}

/// Sum of a row: in eight lanes, which are then added in order.
#[inline(always)]
fn sum(values: &[f32]) -> f64 {
    let (groups, rest) = values.as_chunks::<LANES>();
    let mut lanes = [0.0_f32; LANES];
    for group in groups {
        for (lane, value) in lanes.iter_mut().zip(group) {
            *lane += value;
        }
    }
    lanes.iter().chain(rest).fold(0.0, |sum, value| sum + f64::from(*value))
}

/// Gradient of the loss with respect to the shown view, for a band of rows.
#[inline(always)]
fn differentiate<S: Simd>(
    _simd: S,
    window: &Window,
    channel: &Channel,
    compared: &[Band],
    (width, height, count): (usize, usize, f32),
    rows: Range<usize>,
) -> Vec<f32> {
    let windowed = Windowed::<3>::of(window, (width, height), &rows, |row, to| {
        let at = row % BAND * width;
        for (to, from) in to.into_iter().zip(&compared[row / BAND].by) {
            to.copy_from_slice(&from[at..at + width]);
        }
    });
    let mut sums: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width]);
    let mut out = vec![0.0; rows.len() * width];
    let (of_ssim, of_absolute) = (-DSSIM_SHARE / count, (1.0 - DSSIM_SHARE) / count);
    for row in rows.clone() {
        windowed.row(window, row, &mut sums);
        let [by_mean, by_both, by_product] = sums.each_ref().map(|sum| &sum[..width]);
        let [x, y, kept] =
            [&channel.x, &channel.y, &channel.kept].map(|plane| &plane[row * width..(row + 1) * width]);
        let at = (row - rows.start) * width;
        let out = &mut out[at..at + width];
        for i in 0..width {
            let d = x[i] - y[i];
            let sign = f32::from(u8::from(d > 0.0)) - f32::from(u8::from(d < 0.0));
            let similar = by_mean[i] + 2.0 * x[i] * by_both[i] + y[i] * by_product[i];
            out[i] = kept[i] * (of_ssim * similar + of_absolute * sign);
        }
    }
    out
}

/// Derivatives by alpha of some pixels, and the sums of the derivatives by the logarithm of the gain and by the
/// background, from the derivatives by the shown colour.
fn through_shown(
    rgba: &[[f32; 4]],
    by_shown: &[Vec<f32>; 3],
    shown: &Shown,
    pixels: Range<usize>,
) -> (Vec<f32>, [f32; 3], [f32; 3]) {
    let mut alpha = vec![0.0_f32; pixels.len()];
    let (mut log_gain, mut background) = ([0.0_f32; 3], [0.0_f32; 3]);
    for (c, plane) in by_shown.iter().enumerate() {
        let (gain, behind) = (shown.gain[c], shown.background[c]);
        for ((alpha, by), pixel) in alpha.iter_mut().zip(&plane[pixels.clone()]).zip(&rgba[pixels.clone()]) {
            let by = by * gain;
            let through = 1.0 - pixel[3];
            *alpha -= by * behind;
            background[c] += by * through;
            log_gain[c] += by * (pixel[c] + through * behind);
        }
    }
    (alpha, log_gain, background)
}
