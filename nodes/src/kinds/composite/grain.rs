//! Grain of a background, measured around an object, and grain of the same power for the object. Both are in display
//! values, in which the grain of photographs depends least on brightness. A residual that flat and evenly sloped
//! surfaces do not have (Immerkaer, Fast Noise Variance Estimation, 1996) is averaged over squares of pixels; squares
//! with texture have a larger residual, so a low quantile over the squares is that of grain alone.

use std::f64::consts::PI;

use engine::{Context, NodeError};
use render::geometry::sampling::{fraction, hash};
use scene::math::color::{linear_from_srgb, srgb_from_linear};
use scene::math::num;
use scene::types::{Image, Linear};

use super::sharpness::surroundings;

/// Side of the squares over which the residual is averaged, in pixels.
const SIDE: usize = 16;
/// Quantile of the squares that is taken as grain.
const FLAT: f64 = 0.2;
/// Ratio of that quantile to the true standard deviation for white grain without texture, by simulation with squares of
/// this size.
const OF_FLAT: f64 = 0.917;
/// Minimum number of squares for a measurement.
const FEWEST: usize = 8;
/// Display values outside which a square is left out, because clipping hides its grain.
const CLIPPED: [f32; 2] = [0.02, 0.98];

/// Standard deviation of the grain of a background around an object, per channel, in display values. Pixels that the
/// object covers are left out. `None` if too few squares of pixels are free and not clipped.
pub(super) fn of_background(
    background: &Image<Linear>,
    object: &Image<Linear>,
    cx: &Context,
) -> Result<Option<[f64; 3]>, NodeError> {
    let Some([x0, y0, x1, y1]) = surroundings(object) else { return Ok(None) };
    let [columns, rows] = [(x1 - x0) / SIDE, (y1 - y0) / SIDE];
    let found = cx.for_each_tile(rows, |row| {
        let square = |column: usize| square(background, object, [x0 + column * SIDE, y0 + row * SIDE]);
        (0..columns).filter_map(square).collect::<Vec<_>>()
    })?;
    let found: Vec<[f64; 3]> = found.concat();
    if found.len() < FEWEST {
        return Ok(None);
    }
    let nth = (found.len() as f64 * FLAT) as usize;
    Ok(Some([0, 1, 2].map(|c| {
        let mut all: Vec<f64> = found.iter().map(|sigma| sigma[c]).collect();
        *all.select_nth_unstable_by(nth, f64::total_cmp).1 / OF_FLAT
    })))
}

/// Grain of one square, from its inner pixels; `None` if it is covered or clipped.
fn square(background: &Image<Linear>, object: &Image<Linear>, [x0, y0]: [usize; 2]) -> Option<[f64; 3]> {
    let mut shown = [[0.0_f32; 3]; SIDE * SIDE];
    for (at, shown) in shown.iter_mut().enumerate() {
        let (x, y) = (x0 + at % SIDE, y0 + at / SIDE);
        if object.channels == 4 && object.pixel(x, y)[3] > 0.0 {
            return None;
        }
        *shown = background.rgb(x, y).map(srgb_from_linear);
        if shown.iter().any(|v| !(CLIPPED[0]..=CLIPPED[1]).contains(v)) {
            return None;
        }
    }
    let mut sums = [0.0; 3];
    for y in 1..SIDE - 1 {
        for x in 1..SIDE - 1 {
            for (c, sum) in sums.iter_mut().enumerate() {
                let at = |dx: usize, dy: usize| f64::from(shown[(y + dy - 1) * SIDE + x + dx - 1][c]);
                let corners = at(0, 0) + at(2, 0) + at(0, 2) + at(2, 2);
                let sides = at(1, 0) + at(0, 1) + at(2, 1) + at(1, 2);
                *sum += (corners - 2.0 * sides + 4.0 * at(1, 1)).abs();
            }
        }
    }
    // The residual of white grain has 6 times its standard deviation, and the mean of the absolute value of a normal
    // variable is sqrt(2 / pi) of its standard deviation.
    let count = ((SIDE - 2) * (SIDE - 2)) as f64;
    Some(sums.map(|sum| (PI / 2.0).sqrt() / 6.0 * sum / count))
}

/// Adds white grain of the given standard deviations, in display values, to an object: in proportion to its alpha, and
/// the same for the same seed. `view` distinguishes the views of a rig.
pub(super) fn added(
    object: &Image<Linear>,
    sigma: [f64; 3],
    (seed, view): (u64, usize),
    cx: &Context,
) -> Result<Image<Linear>, NodeError> {
    let (width, channels) = (object.width, object.channels);
    let [low, high] = [seed as u32, (seed >> 32) as u32];
    let key = hash(hash(low, high), view as u32);
    let rows = cx.for_each_tile(object.height, |y| {
        let mut row = object.samples[y * width * channels..][..width * channels].to_vec();
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let alpha = if channels == 4 { pixel[3] } else { 1.0 };
            if alpha <= 0.0 {
                continue;
            }
            let at = hash(key, (y * width + x) as u32);
            for (channel, (sample, sigma)) in pixel.iter_mut().zip(sigma).enumerate() {
                let shown = f64::from(srgb_from_linear(*sample / alpha)) + sigma * normal(at, channel as u32);
                *sample = linear_from_srgb(shown as f32) * alpha;
            }
        }
        row
    })?;
    Ok(Image::from_samples(width, object.height, channels, rows.concat()))
}

/// A number with the standard normal distribution, by the transform of Box and Muller.
fn normal(key: u32, channel: u32) -> f64 {
    let [a, b] = [2 * channel, 2 * channel + 1].map(|k| fraction(hash(key, k)));
    // 1 - a is above 0.
    (-2.0 * num::f64::ln(1.0 - a)).sqrt() * num::sin_cos(2.0 * PI * b).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    const SIZE: [usize; 2] = [192, 128];

    /// A sloped wall with grain of the given standard deviation in display values, and a square object in its middle.
    fn scene(sigma: [f64; 3], seed: u64) -> (Image<Linear>, Image<Linear>) {
        let [width, height] = SIZE;
        let mut wall = Image::new(width, height, 3);
        let mut object = Image::new(width, height, 4);
        for y in 0..height {
            for x in 0..width {
                let shown = 0.35 + 0.3 * x as f32 / width as f32;
                wall.pixel_mut(x, y).fill(linear_from_srgb(shown));
                if x.abs_diff(width / 2) < 32 && y.abs_diff(height / 2) < 24 {
                    object.pixel_mut(x, y).copy_from_slice(&[0.2, 0.2, 0.2, 1.0]);
                }
            }
        }
        (added(&wall, sigma, (seed, 0), &context()).expect("runs"), object)
    }

    /// In 200 simulations, the result was between 95 and 104 % of the true value. This test fails if covered pixels are
    /// not left out, or if the residual is not divided by 6.
    #[test]
    fn the_grain_of_a_sloped_wall_is_measured() {
        for sigma in [[0.0; 3], [0.01, 0.02, 0.04]] {
            let (mut wall, object) = scene(sigma, 3);
            // Below the object, anything.
            for at in (0..SIZE[0] * SIZE[1]).filter(|at| object.samples[4 * at + 3] > 0.0) {
                wall.samples[3 * at] = (at % 7) as f32;
            }
            let found = of_background(&wall, &object, &context()).expect("runs").expect("has squares");
            for (found, sigma) in found.iter().zip(sigma) {
                assert!((found - sigma).abs() <= 0.07 * sigma + 2e-4, "{found}, not {sigma}");
            }
        }
        let (mut white, object) = scene([0.0; 3], 0);
        white.samples.fill(1.0);
        assert_eq!(of_background(&white, &object, &context()).expect("runs"), None);
    }

    /// Grain has the mean and the standard deviation that are asked for, is not correlated between neighbours, channels
    /// or seeds, and is the same for the same seed. Bounds are five standard errors.
    #[test]
    fn grain_is_white_and_seeded() {
        let count = 1 << 16;
        let flat = Image::<Linear>::from_samples(256, 256, 3, vec![linear_from_srgb(0.5); 3 * count]);
        let grain = |seed: u64, view| {
            let grain = added(&flat, [0.02; 3], (seed, view), &context()).expect("runs");
            grain.samples.iter().map(|v| (f64::from(srgb_from_linear(*v)) - 0.5) / 0.02).collect::<Vec<f64>>()
        };
        let first = grain(1, 0);
        assert_eq!(first, grain(1, 0));
        let mean = |pairs: &mut dyn Iterator<Item = f64>| pairs.sum::<f64>() / count as f64;
        let within = 5.0 / (count as f64).sqrt();
        let red = || first.iter().step_by(3);
        assert!(mean(&mut red().copied()).abs() < within);
        // The variance of the square of a normal variable is 2.
        assert!((mean(&mut red().map(|v| v * v)) - 1.0).abs() < 2.0_f64.sqrt() * within + 1e-3);
        assert!(mean(&mut red().zip(red().skip(1)).map(|(a, b)| a * b)).abs() < within);
        assert!(mean(&mut red().zip(red().skip(256)).map(|(a, b)| a * b)).abs() < within);
        for other in [first[1..].to_vec(), grain(2, 0), grain(1 << 32, 0), grain(1, 1)] {
            assert!(mean(&mut red().zip(other.iter().step_by(3)).map(|(a, b)| a * b)).abs() < within);
        }
    }

    /// Grain is in proportion to alpha, and pixels without alpha keep their bits.
    #[test]
    fn grain_follows_alpha() {
        let pixels = [[0.2, 0.2, 0.2, 1.0], [0.1, 0.1, 0.1, 0.5], [0.3, 0.0, 0.0, 0.0]];
        let object = Image::<Linear>::from_samples(3, 1, 4, pixels.concat());
        let grain = added(&object, [0.05; 3], (9, 0), &context()).expect("runs");
        assert_eq!(grain.pixel(2, 0), pixels[2]);
        assert_eq!([grain.pixel(0, 0)[3], grain.pixel(1, 0)[3]], [1.0, 0.5]);
        assert!(grain.pixel(0, 0)[0] != 0.2 && grain.pixel(1, 0)[0] != 0.1);
        assert!((grain.pixel(1, 0)[0] - 0.1).abs() < 0.05);
    }
}
