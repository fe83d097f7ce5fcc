//! Slow reference implementations in float64. They were written from the documentation of the nodes, not from their
//! code.

use std::f64::consts::PI;

use engine::Up;
use glam::{DMat3, DVec3};
use scene::math::equirect;
use scene::math::num;
use scene::types::{Brackets, Cell, Panorama, Picture, Report, Views};

/// Converts sRGB to linear light, according to IEC 61966-2-1.
fn decoded(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { num::pow((v + 0.055) / 1.055, 2.4) }
}

pub fn encoded(v: f64) -> f64 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * num::pow(v, 1.0 / 2.4) - 0.055 }
}

pub fn luminance(rgb: &[f64]) -> f64 {
    0.21267 * rgb[0] + 0.71516 * rgb[1] + 0.07217 * rgb[2]
}

/// Converts premultiplied display values to premultiplied linear light.
pub fn light(pixel: &[f64]) -> [f64; 4] {
    let alpha = pixel[3];
    let linear = |c: usize| if alpha > 0.0 { decoded(pixel[c] / alpha) * alpha } else { 0.0 };
    [linear(0), linear(1), linear(2), alpha]
}

/// Stitches views to a panorama with z up. Returns the display values and the visible share of each pixel. Each
/// pixel is the mean of 12x12 samples, weighted by solid angle.
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

/// Weighted mean of all views in a direction. The weight of a view is a smooth step that rises from 0 at the border
/// of the view to 1 at a distance of 8 % of its shorter side.
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

/// The samples of all predicted exposures, concatenated.
pub fn taken(brackets: &Brackets) -> Vec<f64> {
    brackets.exposures.iter().flat_map(|image| image.samples.iter().map(|v| f64::from(*v))).collect()
}

/// The samples of a panorama as photographed at all exposures, concatenated. They are computed from the panorama
/// and its predicted gain, and are clamped to white.
pub fn exposed(base: &Panorama, brackets: &Brackets) -> Vec<f64> {
    let gains = &brackets.log2_gain.samples;
    let at = |ev: f64| {
        let light = base.image.samples().iter().enumerate().map(move |(i, v)| {
            let stops = f64::from(gains[i / 3]) + ev;
            decoded(f64::from(*v).clamp(0.0, 1.0)) * num::f64::exp2(stops)
        });
        light.map(|v| encoded(v.min(1.0)))
    };
    brackets.evs.iter().flat_map(|ev| at(*ev)).collect()
}

/// Factors in linear light that have the same effect as a grey mask. With a grey mask, black is composited over
/// display values with an opacity equal to the blocked share of the luminance.
pub fn grey(without: &[f64], with: &[f64], strength: f64) -> Vec<f64> {
    let pairs = without.chunks_exact(3).zip(with.chunks_exact(3));
    let factor = |(a, b): (&[f64], &[f64])| {
        let left = if luminance(a) > 0.0 { (luminance(b) / luminance(a)).min(1.0) } else { 1.0 };
        [decoded(1.0 - strength * (1.0 - left)); 3]
    };
    pairs.flat_map(factor).collect()
}

/// Fuses a panorama with its exposures, from the darkest to the brightest. Where an exposure is not clipped, it
/// replaces the result of the darker exposures: its weight is 1 until its brightest channel reaches 0.9, and falls
/// to 0 at white. Where the exposure is brighter than the result of the darker exposures, its weight is 1, so no
/// pixel becomes darker than in the panorama.
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

/// Parameters of the ratio `with` / `without`, computed in a form that is stable where both are dark.
pub struct Ratio {
    pub epsilon: f64,
    pub min_energy: f64,
    pub gamma: f64,
    pub s_min: f64,
    pub lambda: f64,
}

impl Ratio {
    /// Factors by which the three channels of the background are multiplied at each pixel. They are 1 where the
    /// mean of `without` around a pixel is less than `min_energy` times the median of the lit pixels, with a ramp
    /// up to twice this value.
    pub fn of(&self, without: &[f64], with: &[f64], width: usize) -> Vec<f64> {
        let mut sorted: Vec<f64> = without.iter().copied().filter(|v| *v > 0.0).collect();
        sorted.sort_by(f64::total_cmp);
        let bright = sorted[sorted.len() * 9 / 10];
        let lit: Vec<f64> = sorted.into_iter().filter(|v| *v >= 1e-6 * bright).collect();
        let level = lit[lit.len() / 2];
        let height = without.len() / 3 / width;
        let factor = |k: usize| {
            let (c, x, y) = (k % 3, (k / 3 % width) as i64, (k / 3 / width) as i64);
            let near: Vec<f64> = (-1..=1)
                .flat_map(|j| (-1..=1).map(move |i| (x + i, y + j)))
                .filter(|&(x, y)| x >= 0 && y >= 0 && x < width as i64 && y < height as i64)
                .map(|(x, y)| without[(y as usize * width + x as usize) * 3 + c])
                .collect();
            let energy = near.iter().sum::<f64>() / near.len() as f64 / (self.min_energy * level);
            let ratio = (with[k] + self.epsilon * level) / (without[k] + self.epsilon * level);
            let ratio = 1.0 + (energy - 1.0).clamp(0.0, 1.0) * (ratio.min(1.0) - 1.0);
            1.0 - self.lambda * (1.0 - num::pow(ratio, self.gamma).max(self.s_min))
        };
        (0..without.len()).map(factor).collect()
    }
}

/// Composites the object over the shaded background, and the result over black, in linear light. `background`
/// contains premultiplied display values.
pub fn composite(background: &[f64], object: &[f64], shadow: &[f64]) -> Vec<f64> {
    let pixels = background.chunks_exact(4).zip(object.chunks_exact(4)).zip(shadow.chunks_exact(3));
    let over = |((b, o), s): ((&[f64], &[f64]), &[f64])| {
        let (b, clear) = (light(b), 1.0 - o[3]);
        [0, 1, 2].map(|c| b[c] * s[c] * clear + o[c])
    };
    pixels.flat_map(over).collect()
}

/// The masks of four regions, concatenated: the object, the shadow, all other pixels, and the contact band.
pub fn masks(object: &[f64], shadow: &[f64], width: usize) -> Vec<f64> {
    let alpha: Vec<f64> = object.chunks_exact(4).map(|pixel| pixel[3]).collect();
    let inside = |i: usize| alpha[i] > 0.5;
    let changed = |i: usize| (0..3).any(|c| (shadow[3 * i + c] - 1.0).abs() > 0.02);
    let rows: Vec<usize> = (0..alpha.len()).filter(|&i| inside(i)).map(|i| i / width).collect();
    let tall = rows.last().zip(rows.first()).map_or(0, |(last, first)| last - first + 1);
    let deep = (0.05 * tall as f64).round() as usize;
    // The lowest pixel of the object in the same column is at most `deep` rows above.
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

const SCORES: [&str; 7] = [
    "mean absolute error",
    "psnr (dB)",
    "ssim_3dgs_zero_pad",
    "ssim_valid",
    "flip mean",
    "flip p95",
    "ciede2000 mean",
];

/// Scores of the whole picture in a report of `compare`, in the order of [`scores`].
pub fn scores_of(report: &Report) -> Vec<f64> {
    let table = &report.tables[0];
    let whole = &table.rows[0];
    let number = |name: &&str| match whole[table.columns.iter().position(|column| column == name).unwrap()] {
        Cell::Number(value) => value,
        ref other => panic!("{name} is {other:?}"),
    };
    SCORES.iter().map(number).collect()
}

/// Display values of `image`, which is in linear light, and of `reference`, which is in premultiplied display
/// values.
pub fn shown(image: &[f64], reference: &[f64]) -> [Vec<f64>; 2] {
    let encode = |pixel: &[f64]| [0, 1, 2].map(|c| f64::from(encoded(pixel[c]) as f32).clamp(0.0, 1.0));
    let cut = |pixel: &[f64]| [pixel[0], pixel[1], pixel[2]].map(|v| v.clamp(0.0, 1.0));
    [image.chunks_exact(3).flat_map(encode).collect(), reference.chunks_exact(4).flat_map(cut).collect()]
}

/// Scores of display values, in this order: mean absolute error, PSNR, SSIM with zeros outside the picture, SSIM
/// without the border, mean and 95th percentile of FLIP, and mean of CIEDE2000. Both SSIM use a two-dimensional
/// window.
pub fn scores([a, b]: &[Vec<f64>; 2], width: usize) -> Vec<f64> {
    let apart: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let count = apart.len() as f64;
    let absolute = apart.iter().map(|d| d.abs()).sum::<f64>() / count;
    let square = apart.iter().map(|d| d * d).sum::<f64>() / count;
    let map = similarity(a, b, width);
    let (height, rim) = (map.len() / width, 5);
    let valid: Vec<f64> = (0..map.len())
        .filter(|i| (rim..width - rim).contains(&(i % width)) && (rim..height - rim).contains(&(i / width)))
        .map(|i| map[i])
        .collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let mut flip = flip(a, b, width);
    flip.sort_by(f64::total_cmp);
    let place = 0.95 * (flip.len() - 1) as f64;
    let (low, high) = (flip[place as usize], flip[place as usize + 1]);
    let colours: Vec<f64> = a.chunks_exact(3).zip(b.chunks_exact(3)).map(|(a, b)| ciede2000(a, b)).collect();
    vec![
        absolute,
        -10.0 * num::f64::log10(square),
        mean(&map),
        mean(&valid),
        mean(&flip),
        low + (high - low) * place.fract(),
        mean(&colours),
    ]
}

/// SSIM of every pixel, averaged over three channels. The window has 11x11 pixels with Gaussian weights of sigma
/// 1.5.
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

/// Applies a filter to a channel. The filter covers the pixels at most `reach` columns and rows away. Outside the
/// picture, the border pixels are repeated.
fn filtered(channel: &[f64], width: usize, reach: i64, kernel: &dyn Fn(i64, i64) -> f64) -> Vec<f64> {
    let height = channel.len() / width;
    let offsets: Vec<(i64, i64)> =
        (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (i, j))).collect();
    let weights: Vec<f64> = offsets.iter().map(|(i, j)| kernel(*i, *j)).collect();
    let held = |at: i64, length: usize| at.clamp(0, length as i64 - 1) as usize;
    let at = |pixel: usize| {
        let (x, y) = ((pixel % width) as i64, (pixel / width) as i64);
        let value = |&(i, j): &(i64, i64)| channel[held(y + j, height) * width + held(x + i, width)];
        offsets.iter().zip(&weights).map(|(offset, weight)| weight * value(offset)).sum()
    };
    (0..channel.len()).map(at).collect()
}

/// Normalizes a kernel: the positive values are scaled to a sum of 1, and the negative values, if any, to a sum of
/// -1.
fn balanced(reach: i64, kernel: impl Fn(f64, f64) -> f64) -> impl Fn(i64, i64) -> f64 {
    let all = (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (i as f64, j as f64)));
    let (mut above, mut below) = (0.0, 0.0);
    for (x, y) in all {
        above += kernel(x, y).max(0.0);
        below += (-kernel(x, y)).max(0.0);
    }
    move |i, j| {
        let value = kernel(i as f64, j as f64);
        value / if value > 0.0 { above } else { below.max(f64::MIN_POSITIVE) }
    }
}

/// Converts linear Rec.709 to XYZ relative to white. The matrix is derived from the chromaticities of the primaries
/// and of D65.
fn relative_xyz(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = |[x, y]: [f64; 2]| DVec3::new(x / y, 1.0, (1.0 - x - y) / y);
    let white = xyz([0.3127, 0.3290]);
    let primaries = DMat3::from_cols(xyz([0.64, 0.33]), xyz([0.30, 0.60]), xyz([0.15, 0.06]));
    let light = primaries.inverse() * white * DVec3::from_array(rgb);
    (primaries * light / white).to_array()
}

/// Converts XYZ relative to white to linear Rec.709.
fn rgb_of(xyz: [f64; 3]) -> [f64; 3] {
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(relative_xyz);
    (DMat3::from_cols_array_2d(&columns).inverse() * DVec3::from_array(xyz)).to_array()
}

/// FLIP (Andersson et al. 2020) of display values at each pixel. The filters are two-dimensional, as in the
/// definition. The assumed display is 3840 pixels and 0.7 m wide, and is seen from 0.7 m.
pub fn flip(a: &[f64], b: &[f64], width: usize) -> Vec<f64> {
    let density = 3840.0 / 0.7 * 0.7 * PI / 180.0;
    let [a, b] = [a, b].map(|picture| seen(picture, width, density));
    let largest = hyab(hunt([0.0, 1.0, 0.0]), hunt([0.0, 0.0, 1.0]));
    let pixel = |((colour, edge, point), (other, other_edge, other_point)): (&Seen, &Seen)| {
        // Differences below 0.4 of the largest are mapped to the range up to 0.95.
        let share = hyab(*colour, *other) / largest;
        let colour = if share < 0.4 { share / 0.4 * 0.95 } else { 0.95 + (share - 0.4) / 0.6 * 0.05 };
        let feature = ((edge - other_edge).abs().max((point - other_point).abs()) / 2.0_f64.sqrt()).sqrt();
        num::pow(colour, 1.0 - feature)
    };
    a.iter().zip(&b).map(pixel).collect()
}

/// Values of a pixel: its colour after the contrast sensitivity filters, the strength of edges, and the strength of
/// points.
type Seen = ([f64; 3], f64, f64);

fn seen(picture: &[f64], width: usize, density: f64) -> Vec<Seen> {
    let xyz: Vec<[f64; 3]> =
        picture.chunks_exact(3).map(|p| relative_xyz([p[0], p[1], p[2]].map(decoded))).collect();
    let of = |value: &dyn Fn(&[f64; 3]) -> f64| xyz.iter().map(value).collect::<Vec<f64>>();
    let opponents = [
        of(&|[_, y, _]| 116.0 * y - 16.0),
        of(&|[x, y, _]| 500.0 * (x - y)),
        of(&|[_, y, z]| 200.0 * (y - z)),
    ];
    // Contrast sensitivity: sums of two Gaussians over degrees.
    let reach = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * density).ceil() as i64;
    let sums = [[(1.0, 0.0047), (0.0, 1e-5)], [(1.0, 0.0053), (0.0, 1e-5)], [(34.1, 0.04), (13.5, 0.025)]];
    let blurred = [0, 1, 2].map(|c| {
        let sum = |x: f64, y: f64| {
            let square = (x * x + y * y) / (density * density);
            sums[c].iter().map(|(a, b)| a * (PI / b).sqrt() * num::f64::exp(-PI * PI * square / b)).sum()
        };
        filtered(&opponents[c], width, reach, &balanced(reach, sum))
    });
    // Edges and points 0.082 degrees wide, in lightness from 0 to 1.
    let sigma = 0.5 * 0.082 * density;
    let reach = (3.0 * sigma).ceil() as i64;
    let gauss = move |x: f64, y: f64| num::f64::exp(-(x * x + y * y) / (2.0 * sigma * sigma));
    let first = balanced(reach, move |x, y| -x * gauss(x, y));
    let second = balanced(reach, move |x, y| (x * x / (sigma * sigma) - 1.0) * gauss(x, y));
    let grey = of(&|[_, y, _]| *y);
    let length = |kernel: &dyn Fn(i64, i64) -> f64| -> Vec<f64> {
        let across = filtered(&grey, width, reach, kernel);
        let down = filtered(&grey, width, reach, &|i, j| kernel(j, i));
        across.iter().zip(&down).map(|(x, y)| (x * x + y * y).sqrt()).collect()
    };
    let (edges, points) = (length(&first), length(&second));
    let colour = |i: usize| {
        let y = (blurred[0][i] + 16.0) / 116.0;
        let rgb = rgb_of([y + blurred[1][i] / 500.0, y, y - blurred[2][i] / 200.0]);
        hunt(rgb.map(|v| v.clamp(0.0, 1.0)))
    };
    (0..xyz.len()).map(|i| (colour(i), edges[i], points[i])).collect()
}

/// Converts XYZ relative to white to CIELAB.
fn lab(relative: [f64; 3]) -> [f64; 3] {
    let edge = 6.0 / 29.0;
    let [x, y, z] = relative.map(|t| {
        if t > edge * edge * edge { num::pow(t, 1.0 / 3.0) } else { t / (3.0 * edge * edge) + 4.0 / 29.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Converts linear light to CIELAB, with the chroma of dark colours reduced (Hunt effect).
fn hunt(rgb: [f64; 3]) -> [f64; 3] {
    let [l, a, b] = lab(relative_xyz(rgb));
    [l, 0.01 * l * a, 0.01 * l * b]
}

fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [l, p, q] = [0, 1, 2].map(|i| a[i] - b[i]);
    num::pow(l.abs() + (p * p + q * q).sqrt(), 0.7)
}

/// CIEDE2000 of two display colours (CIE 142, in the notation of Sharma, Wu and Dalal 2005), with the rounded
/// matrix and white of the node.
fn ciede2000(a: &[f64], b: &[f64]) -> f64 {
    let rows = [
        [0.412_453, 0.357_580, 0.180_423],
        [0.212_671, 0.715_160, 0.072_169],
        [0.019_334, 0.119_193, 0.950_227],
    ];
    let lab = |rgb: &[f64]| {
        let xyz = rows.map(|row| (0..3).map(|c| row[c] * decoded(rgb[c])).sum::<f64>());
        lab([xyz[0] / 0.950_47, xyz[1], xyz[2] / 1.088_83])
    };
    let ([l1, a1, b1], [l2, a2, b2]) = (lab(a), lab(b));
    let seventh = |c: f64| (num::pow(c, 7.0) / (num::pow(c, 7.0) + num::pow(25.0, 7.0))).sqrt();
    let chroma = |a: f64, b: f64| (a * a + b * b).sqrt();
    let g = 0.5 * (1.0 - seventh(0.5 * (chroma(a1, b1) + chroma(a2, b2))));
    let (a1, a2) = ((1.0 + g) * a1, (1.0 + g) * a2);
    let (c1, c2) = (chroma(a1, b1), chroma(a2, b2));
    let grey = c1 * c2 == 0.0;
    // The shorter rotation from one hue to the other. The mean hue is half of this rotation from the first.
    let (h1, h2) = (num::atan2(b1, a1), num::atan2(b2, a2));
    let turn = if grey { 0.0 } else { (h2 - h1 + 3.0 * PI).rem_euclid(2.0 * PI) - PI };
    let hue = if grey { h1 + h2 } else { h1 + 0.5 * turn }.to_degrees().rem_euclid(360.0);
    let (l, c) = (0.5 * (l1 + l2), 0.5 * (c1 + c2));
    let cos = |degrees: f64| num::f64::cos(degrees.to_radians());
    let t = 1.0 - 0.17 * cos(hue - 30.0) + 0.24 * cos(2.0 * hue) + 0.32 * cos(3.0 * hue + 6.0)
        - 0.20 * cos(4.0 * hue - 63.0);
    let s_l = 1.0 + 0.015 * (l - 50.0) * (l - 50.0) / (20.0 + (l - 50.0) * (l - 50.0)).sqrt();
    let (s_c, s_h) = (1.0 + 0.045 * c, 1.0 + 0.015 * c * t);
    let bend = (hue - 275.0) / 25.0;
    let r_t = -2.0 * seventh(c) * num::f64::sin((60.0 * num::f64::exp(-bend * bend)).to_radians());
    let (l, c, h) =
        ((l2 - l1) / s_l, (c2 - c1) / s_c, 2.0 * (c1 * c2).sqrt() * num::f64::sin(0.5 * turn) / s_h);
    (l * l + c * c + h * h + r_t * c * h).sqrt()
}
