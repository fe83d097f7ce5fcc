//! Measures the sharpness of a background, and blurs objects to match it. Captures are softer than renders, since
//! splats overlap and lenses blur photographs. The amount of blur is measured at the sharpest edges of the
//! background. An edge of contrast C that is blurred by a Gaussian of standard deviation s has the maximum slope C
//! / (s sqrt(2 pi)). So s follows from contrast and slope wherever no other edge is near. Grain makes some slopes
//! steeper, and the sharpest edges would be those; where there is grain, slopes are of the mean of several lines.

use std::f64::consts::PI;

use engine::{Context, NodeError};
use scene::math::color::{luminance, srgb_from_linear};
use scene::math::num;
use scene::types::{Image, Linear};

/// Half the side of the window in which an edge is measured, in pixels.
const REACH: usize = 4;
/// Minimum contrast of an edge, in display values.
const CONTRAST: f32 = 0.12;
/// Quantile of the blurs of all edges that is taken as the blur of a background. Edges of penumbras and round
/// shapes are soft in the scene itself, so they have a larger blur.
const SHARPEST: f64 = 0.1;
/// Grain, as the standard deviation of luminance in display values, from which the mean of several lines is taken.
const GRAINY: f64 = 0.003;
/// Number of lines on each side of a line that are averaged with it where there is grain. The sharpest edges are
/// those along the lines, which the mean does not blur.
const BESIDE: usize = 2;
/// Minimum contrast of an edge, as a multiple of the grain that is left in the mean of lines.
const ABOVE_GRAIN: f64 = 16.0;
/// Minimum number of edges for a measurement.
const FEWEST: usize = 64;
/// Blur, in pixels, that [`edge_width`] measures at an unblurred step between two pixels. Edges in renders are such
/// steps.
const RENDERED: f64 = 0.551;
/// Maximum blur that is matched, in pixels. A background with a larger blur is out of focus rather than soft.
pub(super) const MOST: f64 = 3.0;

/// Blur of the sharpest edges of a background around an object, in pixels. Edges are searched for in the bounding
/// box of the pixels that the object covers, grown by its own size on each side. `grain` is that of the background around
/// the object. `None` if there are too few edges.
pub(super) fn of_background(
    background: &Image<Linear>,
    object: &Image<Linear>,
    grain: Option<[f64; 3]>,
    cx: &Context,
) -> Result<Option<f64>, NodeError> {
    let Some([x0, y0, x1, y1]) = surroundings(object) else { return Ok(None) };
    let (width, height) = (x1 - x0, y1 - y0);
    let shown = |x: usize, y: usize| srgb_from_linear(luminance(background.rgb(x, y)).max(0.0));
    let covered = |x: usize, y: usize| object.channels == 4 && object.pixel(x, y)[3] > 0.0;
    let (beside, contrast) = lines(grain);
    let shown = cx.for_each_tile(height, |y| (x0..x1).map(|x| shown(x, y0 + y)).collect::<Vec<f32>>())?;
    let rows = cx.for_each_tile(height.saturating_sub(2 * REACH), |above| {
        let y = above + REACH;
        let mut widths = Vec::new();
        for x in REACH..width.saturating_sub(REACH) {
            if covered(x0 + x, y0 + y) {
                continue;
            }
            let mean =
                |at: &dyn Fn(usize) -> f32| (0..=2 * beside).map(at).sum::<f32>() / (2 * beside + 1) as f32;
            let across = |k: usize| mean(&|j| shown[y + j - beside][x + k - REACH]);
            widths.extend(edge_width(&std::array::from_fn(across), contrast));
            let down = |k: usize| mean(&|j| shown[above + k][x + j - beside]);
            widths.extend(edge_width(&std::array::from_fn(down), contrast));
        }
        widths
    })?;
    let mut widths: Vec<f64> = rows.into_iter().flatten().collect();
    if widths.len() < FEWEST {
        return Ok(None);
    }
    let nth = (widths.len() as f64 * SHARPEST) as usize;
    Ok(Some(*widths.select_nth_unstable_by(nth, f64::total_cmp).1))
}

/// Number of lines on each side that are averaged, and the minimum contrast of an edge, for a background with this
/// grain per channel.
fn lines(grain: Option<[f64; 3]>) -> (usize, f32) {
    let [r, g, b] = grain.unwrap_or_default();
    // The channels have independent grain, in proportions that the weights of luminance describe closely enough.
    let of_luminance = [0.2126 * r, 0.7152 * g, 0.0722 * b].iter().map(|v| v * v).sum::<f64>().sqrt();
    if of_luminance < GRAINY {
        return (0, CONTRAST);
    }
    let left = of_luminance / ((2 * BESIDE + 1) as f64).sqrt();
    (BESIDE, CONTRAST.max((ABOVE_GRAIN * left) as f32))
}

/// Blur of the edge in a line of pixels, in pixels. `None` unless the line rises or falls throughout, is steepest
/// in its middle, and has the contrast `least`.
fn edge_width(line: &[f32; 2 * REACH + 1], least: f32) -> Option<f64> {
    let slope = |k: usize| 0.5 * (line[k + 1] - line[k - 1]);
    let middle = slope(REACH);
    let contrast = (line[2 * REACH] - line[0]) * middle.signum();
    // Most lines end here.
    if contrast < least {
        return None;
    }
    let steepest = (1..2 * REACH).all(|k| slope(k) * middle.signum() <= middle.abs());
    let steady = line.windows(2).all(|pair| (pair[1] - pair[0]) * middle.signum() > -0.1 * contrast);
    if !steepest || !steady {
        return None;
    }
    // The slope over two pixels is the slope of the edge blurred by a box of two pixels, whose variance is 1/3.
    let over_two = f64::from(contrast) / (f64::from(middle.abs()) * (2.0 * PI).sqrt());
    Some((over_two * over_two - 1.0 / 3.0).max(0.0).sqrt())
}

/// Bounding box of the covered pixels, grown by its own size on each side: `[x0, y0, x1, y1]`, the last two
/// exclusive. `None` if no pixel is covered.
pub(super) fn surroundings(object: &Image<Linear>) -> Option<[usize; 4]> {
    if object.channels != 4 {
        return Some([0, 0, object.width, object.height]);
    }
    let covered = (0..object.width * object.height).filter(|at| object.samples[4 * at + 3] > 0.0);
    let [x0, y0, x1, y1] = covered
        .map(|at| [at % object.width, at / object.width])
        .fold([usize::MAX, usize::MAX, 0, 0], |[x0, y0, x1, y1], [x, y]| {
            [x0.min(x), y0.min(y), x1.max(x + 1), y1.max(y + 1)]
        });
    let (wide, high) = (x1.checked_sub(x0)?, y1.checked_sub(y0)?);
    Some([
        x0.saturating_sub(wide),
        y0.saturating_sub(high),
        (x1 + wide).min(object.width),
        (y1 + high).min(object.height),
    ])
}

/// Blur, in pixels, to apply to a render so that it becomes as soft as a background with the given blur. The
/// variances of successive blurs add up.
pub(super) fn missing(background: f64) -> f64 {
    (background * background - RENDERED * RENDERED).max(0.0).sqrt().min(MOST)
}

/// Blurs an image by a Gaussian of `sigma` pixels, truncated at three sigma and normalised. The edge pixels are
/// repeated outside the image. Premultiplied colours and alpha are blurred in the same way, so no colour bleeds.
pub(super) fn blurred(image: &Image<Linear>, sigma: f64, cx: &Context) -> Result<Image<Linear>, NodeError> {
    let reach = (3.0 * sigma).ceil() as isize;
    let weight = |k: isize| num::f64::exp(-0.5 * (k * k) as f64 / (sigma * sigma));
    let total: f64 = (-reach..=reach).map(weight).sum();
    let kernel: Vec<f64> = (-reach..=reach).map(|k| weight(k) / total).collect();
    let (reach, (width, height, channels)) = (reach as usize, (image.width, image.height, image.channels));
    // The sums of a row are added up tap by tap, so that the inner loop runs along the row.
    let rows = cx.for_each_tile(height, |y| {
        let row = &image.samples[y * width * channels..][..width * channels];
        let (first, last) = (&row[..channels], &row[(width - 1) * channels..]);
        let padded = [first.repeat(reach).as_slice(), row, last.repeat(reach).as_slice()].concat();
        sums(row.len(), kernel.iter().enumerate().map(|(k, weight)| (*weight, &padded[k * channels..])))
    })?;
    let blurred = cx.for_each_tile(height, |y| {
        let taps = kernel.iter().enumerate();
        let row = |k: usize| rows[(y + k).saturating_sub(reach).min(height - 1)].as_slice();
        sums(width * channels, taps.map(|(k, weight)| (*weight, row(k))))
    })?;
    Ok(Image::from_samples(width, height, channels, blurred.concat()))
}

/// Weighted sums of the first `length` elements of several rows.
fn sums<'a>(length: usize, taps: impl Iterator<Item = (f64, &'a [f32])>) -> Vec<f32> {
    // The sum of no terms, so that the sum of negative zeros is one.
    let mut sums = vec![-0.0; length];
    for (weight, row) in taps {
        sums.iter_mut().zip(row).for_each(|(sum, v)| *sum += weight * f64::from(*v));
    }
    sums.into_iter().map(|sum| sum as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::super::grain;
    use super::*;
    use scene::math::color::linear_from_srgb;
    use testing::context;

    /// Picture with vertical edges every 20 pixels, blurred in display values by a Gaussian, and a small object in
    /// the middle.
    fn stripes(sigma: f64) -> (Image<Linear>, Image<Linear>) {
        let (width, height) = (160, 60);
        let mut image = Image::new(width, height, 3);
        for y in 0..height {
            for x in 0..width {
                // The mean over the pixel of the blurred edge, by eight points.
                let value = (0..8).map(|k| {
                    let p = x as f64 + (f64::from(k) + 0.5) / 8.0;
                    let edges = (1..8).map(|edge| {
                        let away = (p - 20.0 * f64::from(edge)) / sigma.max(1e-3);
                        let sign = if edge % 2 == 0 { 1.0 } else { -1.0 };
                        sign * 0.5 * (1.0 + libm::erf(away / 2.0_f64.sqrt()))
                    });
                    0.7 + 0.4 * edges.sum::<f64>()
                });
                let display = (value.sum::<f64>() / 8.0) as f32;
                image.pixel_mut(x, y).fill(linear_from_srgb(display));
            }
        }
        let mut object = Image::new(width, height, 4);
        for y in 20..40 {
            for x in 60..100 {
                object.pixel_mut(x, y).fill(1.0);
            }
        }
        (image, object)
    }

    // The tolerance is 0.15 pixels, since the boxes of the pixel and of the slope are only taken into account by
    // their variances. This test fails if `edge_width` does not subtract the variance of the box of the slope.
    #[test]
    fn the_blur_of_edges_is_measured() {
        for sigma in [1.2, 2.0] {
            let (background, object) = stripes(sigma);
            let found =
                of_background(&background, &object, None, &context()).expect("runs").expect("has edges");
            let expected = (sigma * sigma + 1.0 / 12.0).sqrt();
            assert!((found - expected).abs() < 0.15, "{sigma}: {found}");
        }
        let (background, object) = stripes(0.0);
        let found = of_background(&background, &object, None, &context()).expect("runs").expect("has edges");
        assert!((found - RENDERED).abs() < 0.01, "{found}");
    }

    /// With grain of 2 % of white, blurs are measured within 15 %. This test fails if `BESIDE` is 0.
    #[test]
    fn the_blur_of_edges_is_measured_under_grain() {
        for sigma in [0.8, 1.5, 2.0_f64] {
            let (clean, object) = stripes(sigma);
            let expected = (sigma * sigma + 1.0 / 12.0).sqrt();
            for seed in 1..6 {
                let plate = grain::added(&clean, [0.02; 3], (seed, 0), &context()).expect("runs");
                let grain = grain::of_background(&plate, &object, &context()).expect("runs");
                let found =
                    of_background(&plate, &object, grain, &context()).expect("runs").expect("has edges");
                assert!(
                    (found / expected - 1.0).abs() < 0.15,
                    "{sigma}, seed {seed}: {found}, not {expected}"
                );
            }
        }
    }

    #[test]
    fn a_background_without_edges_has_no_blur() {
        let (mut background, object) = stripes(1.0);
        background.samples.fill(0.25);
        assert_eq!(of_background(&background, &object, None, &context()).expect("runs"), None);
    }

    #[test]
    fn blurring_keeps_the_sum_and_adds_the_variance() {
        let mut image = Image::<Linear>::new(31, 31, 4);
        image.pixel_mut(15, 15).fill(1.0);
        let blurred = blurred(&image, 1.5, &context()).expect("runs");
        let weigh = |f: &dyn Fn(f64) -> f64| -> f64 {
            (0..31 * 31).map(|at| f64::from(blurred.samples[4 * at]) * f((at % 31) as f64 - 15.0)).sum()
        };
        assert!((weigh(&|_| 1.0) - 1.0).abs() < 1e-5);
        // Cutting at three sigmas takes 0.03 of the variance of 2.25.
        assert!((weigh(&|x| x * x) - 2.25).abs() < 0.08, "{}", weigh(&|x| x * x));
    }
}
