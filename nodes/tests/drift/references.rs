//! Slow references in float64, written from what the docs of a node say and not from its code.

use std::f64::consts::PI;

use engine::Up;
use glam::DVec3;
use nodes::equirect;
use nodes::num;
use nodes::types::{Brackets, Cell, Panorama, Picture, Report, Views};

/// sRGB to linear light, IEC 61966-2-1.
fn decoded(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { num::pow((v + 0.055) / 1.055, 2.4) }
}

fn encoded(v: f64) -> f64 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * num::pow(v, 1.0 / 2.4) - 0.055 }
}

fn luminance(rgb: &[f64]) -> f64 {
    0.21267 * rgb[0] + 0.71516 * rgb[1] + 0.07217 * rgb[2]
}

/// Premultiplied display values as premultiplied linear light.
fn light(pixel: &[f64]) -> [f64; 4] {
    let alpha = pixel[3];
    let linear = |c: usize| if alpha > 0.0 { decoded(pixel[c] / alpha) * alpha } else { 0.0 };
    [linear(0), linear(1), linear(2), alpha]
}

/// The mean of the views over each pixel of a panorama with z up, 12x12 samples a pixel by solid angle, in display
/// values; and how much of each pixel was seen.
pub fn stitch(views: &Views, width: usize) -> (Vec<f64>, Vec<f64>) {
    const ACROSS: usize = 12;
    let height = width / 2;
    let faces: Vec<Vec<[f64; 4]>> = views
        .0
        .iter()
        .map(|view| {
            assert!(matches!(view.colour, Picture::Srgb(_)));
            let pixels = view.colour.samples().chunks_exact(4);
            pixels.map(|p| light(&[0, 1, 2, 3].map(|c| f64::from(p[c])))).collect()
        })
        .collect();
    let (mut colours, mut seen) = (Vec::new(), Vec::new());
    for pixel in 0..width * height {
        let (mut sum, mut area) = ([0.0; 4], 0.0);
        for sample in 0..ACROSS * ACROSS {
            let part = |n: usize| (n as f64 + 0.5) / ACROSS as f64;
            let u = ((pixel % width) as f64 + part(sample % ACROSS)) / width as f64;
            let v = ((pixel / width) as f64 + part(sample / ACROSS)) / height as f64;
            let sine = num::sin_cos(PI * v).0;
            let value = around(views, &faces, equirect::direction(Up::PlusZ, u, v));
            sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += sine * value);
            area += sine;
        }
        seen.push(sum[3] / area);
        colours.extend([0, 1, 2].map(|c| if sum[3] > 0.0 { encoded(sum[c] / sum[3]) } else { 0.0 }));
    }
    (colours, seen)
}

/// What all views show in a direction. Each weighs by how far from its border it shows it: a smooth step over the
/// outer 8 % of its shorter side.
fn around(views: &Views, faces: &[Vec<[f64; 4]>], direction: DVec3) -> [f64; 4] {
    let (mut sum, mut total) = ([0.0; 4], 0.0);
    for (view, pixels) in views.0.iter().zip(faces) {
        let camera = &view.camera;
        let (width, height) = (camera.width_px as usize, camera.height_px as usize);
        let there = camera.world_from_camera().inverse().transform_vector3(direction);
        if there.z <= 0.0 {
            continue;
        }
        let x = camera.fx * there.x / there.z + camera.cx;
        let y = camera.fy * there.y / there.z + camera.cy;
        let border = x.min(width as f64 - x).min(y).min(height as f64 - y);
        if border < 0.0 {
            continue;
        }
        let t = (border / (0.08 * width.min(height) as f64)).min(1.0);
        let weight = (t * t * (3.0 - 2.0 * t)).max(1e-6);
        let (x, y) = ((x - 0.5).clamp(0.0, (width - 1) as f64), (y - 0.5).clamp(0.0, (height - 1) as f64));
        for (column, row) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (i, j) = ((x as usize + column).min(width - 1), (y as usize + row).min(height - 1));
            let share = |at: f64, further: usize| if further == 1 { at.fract() } else { 1.0 - at.fract() };
            let share = weight * share(x, column) * share(y, row);
            sum.iter_mut().zip(pixels[j * width + i]).for_each(|(sum, value)| *sum += share * value);
        }
        total += weight;
    }
    if total > 0.0 { sum.map(|v| v / total) } else { sum }
}

/// The fusion of a panorama and its exposures, the darkest first, each taking over from the darker ones where it is
/// not clipped: a ramp of its brightest channel from 0.9 to 1. Nothing becomes darker by it.
pub fn fuse(base: &Panorama, brackets: &Brackets) -> Vec<f64> {
    let linear = |samples: &[f32], at: usize| [0, 1, 2].map(|c| decoded(f64::from(samples[3 * at + c])));
    let base = base.image.samples();
    let mut fused = Vec::with_capacity(base.len());
    for at in 0..base.len() / 3 {
        let own = linear(base, at);
        let mut best: Option<f64> = None;
        let exposures = brackets.evs.iter().zip(&brackets.exposures);
        let dark = exposures.map(|(ev, image)| (linear(&image.samples, at).map(|v| v.min(1.0)), *ev));
        for (rgb, ev) in dark.chain([(own, 0.0)]) {
            let value = luminance(&rgb) * num::f64::exp2(-ev);
            let clipped = ((rgb.iter().copied().fold(0.0, f64::max) - 0.9) / 0.1).clamp(0.0, 1.0);
            let darker = best.filter(|darker| *darker > value);
            best = Some(darker.map_or(value, |darker| value + clipped * (darker - value)));
        }
        let gain = if luminance(&own) > 0.0 { best.unwrap_or(0.0) / luminance(&own) } else { 1.0 };
        fused.extend(own.map(|v| v * gain));
    }
    fused
}

/// The stable form of the ratio, for each channel.
pub struct Ratio {
    pub epsilon: f64,
    pub min_energy: f64,
    pub gamma: f64,
    pub s_min: f64,
    pub lambda: f64,
}

impl Ratio {
    /// The factor of the background, from R0 and R1 of three channels. Where the mean of R0 around a pixel is less
    /// than `min_energy` of that of the picture there is none, and up to twice as much the less.
    pub fn of(&self, without: &[f64], with: &[f64], width: usize) -> Vec<f64> {
        let mean = without.iter().sum::<f64>() / without.len() as f64;
        let height = without.len() / 3 / width;
        let factor = |k: usize| {
            let (c, x, y) = (k % 3, (k / 3 % width) as i64, (k / 3 / width) as i64);
            let near: Vec<f64> = (-1..=1)
                .flat_map(|j| (-1..=1).map(move |i| (x + i, y + j)))
                .filter(|&(x, y)| x >= 0 && y >= 0 && x < width as i64 && y < height as i64)
                .map(|(x, y)| without[(y as usize * width + x as usize) * 3 + c])
                .collect();
            let energy = near.iter().sum::<f64>() / near.len() as f64 / (self.min_energy * mean);
            let ratio = (with[k] + self.epsilon * mean) / (without[k] + self.epsilon * mean);
            let ratio = 1.0 + (energy - 1.0).clamp(0.0, 1.0) * (ratio.min(1.0) - 1.0);
            1.0 - self.lambda * (1.0 - num::pow(ratio, self.gamma).max(self.s_min))
        };
        (0..without.len()).map(factor).collect()
    }
}

/// The object over the shaded background on black, in linear light, from a premultiplied display background.
pub fn composite(background: &[f64], object: &[f64], shadow: &[f64]) -> Vec<f64> {
    let pixels = background.chunks_exact(4).zip(object.chunks_exact(4)).zip(shadow.chunks_exact(3));
    let over = |((b, o), s): ((&[f64], &[f64]), &[f64])| {
        let (b, clear) = (light(b), 1.0 - o[3]);
        [0, 1, 2].map(|c| b[c] * s[c] * clear + o[c])
    };
    pixels.flat_map(over).collect()
}

/// Object, shadow, rest and contact band, one after another.
pub fn masks(object: &[f64], shadow: &[f64], width: usize) -> Vec<f64> {
    let alpha: Vec<f64> = object.chunks_exact(4).map(|pixel| pixel[3]).collect();
    let inside = |i: usize| alpha[i] > 0.5;
    let changed = |i: usize| (0..3).any(|c| (shadow[3 * i + c] - 1.0).abs() > 0.02);
    let rows: Vec<usize> = (0..alpha.len()).filter(|&i| inside(i)).map(|i| i / width).collect();
    let tall = rows.last().zip(rows.first()).map_or(0, |(last, first)| last - first + 1);
    let deep = (0.05 * tall as f64).round() as usize;
    // The lowest pixel of the object in the column stands at most so many rows above.
    let touches = |i: usize| {
        let lowest = (0..alpha.len() / width).rev().find(|row| inside(row * width + i % width));
        lowest.is_some_and(|row| i / width > row && i / width - row <= deep)
    };
    let of = |test: &dyn Fn(usize) -> bool| {
        (0..alpha.len()).map(|i| f64::from(u8::from(test(i)))).collect::<Vec<_>>()
    };
    [
        of(&inside),
        of(&|i| alpha[i] <= 0.0 && changed(i)),
        of(&|i| alpha[i] <= 0.0 && !changed(i)),
        of(&touches),
    ]
    .concat()
}

const SCORES: [&str; 4] = ["mean absolute error", "psnr (dB)", "ssim_3dgs_zero_pad", "ssim_valid"];

/// What `compare` tells of the whole picture, in the order of [`scores`].
pub fn scores_of(report: &Report) -> Vec<f64> {
    let table = &report.tables[0];
    let whole = &table.rows[0];
    let number = |name: &&str| match whole[table.columns.iter().position(|column| column == name).unwrap()] {
        Cell::Number(value) => value,
        ref other => panic!("{name} is {other:?}"),
    };
    SCORES.iter().map(number).collect()
}

/// Mean absolute error, PSNR, and SSIM with zeros beyond the border and without the border: the window as it is
/// defined, in two dimensions. Linear light against premultiplied display values.
pub fn scores(image: &[f64], reference: &[f64], width: usize) -> Vec<f64> {
    let shown = |pixel: &[f64]| [0, 1, 2].map(|c| f64::from(encoded(pixel[c]) as f32).clamp(0.0, 1.0));
    let a: Vec<f64> = image.chunks_exact(3).flat_map(shown).collect();
    let b: Vec<f64> =
        reference.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]].map(|v| v.clamp(0.0, 1.0))).collect();
    let apart: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
    let count = apart.len() as f64;
    let absolute = apart.iter().map(|d| d.abs()).sum::<f64>() / count;
    let square = apart.iter().map(|d| d * d).sum::<f64>() / count;
    let map = similarity(&a, &b, width);
    let (height, rim) = (map.len() / width, 5);
    let valid: Vec<f64> = (0..map.len())
        .filter(|i| (rim..width - rim).contains(&(i % width)) && (rim..height - rim).contains(&(i / width)))
        .map(|i| map[i])
        .collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    vec![absolute, -10.0 * num::f64::log10(square), mean(&map), mean(&valid)]
}

/// SSIM of every pixel, averaged over three channels: Gaussian weights of sigma 1.5 over 11x11 pixels.
fn similarity(a: &[f64], b: &[f64], width: usize) -> Vec<f64> {
    let height = a.len() / 3 / width;
    let gauss = |d: i64| num::f64::exp(-(d * d) as f64 / 4.5);
    let total: f64 = (-5..=5).map(gauss).sum();
    let at_pixel = |pixel: usize, c: usize| {
        let (mut ma, mut mb, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (i, j) in (-5..=5).flat_map(|j| (-5..=5).map(move |i| (i, j))) {
            let (x, y) = ((pixel % width) as i64 + i, (pixel / width) as i64 + j);
            if x < 0 || y < 0 || x >= width as i64 || y >= height as i64 {
                continue;
            }
            let at = (y as usize * width + x as usize) * 3 + c;
            let weight = gauss(i) * gauss(j) / (total * total);
            ma += weight * a[at];
            mb += weight * b[at];
            aa += weight * a[at] * a[at];
            bb += weight * b[at] * b[at];
            ab += weight * a[at] * b[at];
        }
        let (va, vb, cov) = (aa - ma * ma, bb - mb * mb, ab - ma * mb);
        (2.0 * ma * mb + 1e-4) * (2.0 * cov + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4))
    };
    (0..width * height).map(|pixel| (0..3).map(|c| at_pixel(pixel, c)).sum::<f64>() / 3.0).collect()
}
