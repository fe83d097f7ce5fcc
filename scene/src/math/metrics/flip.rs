//! FLIP, the difference that a viewer sees when two pictures alternate (Andersson et al. 2020), and its form for
//! scene-referred light, HDR-FLIP (Andersson et al. 2021). The papers call the former LDR-FLIP.

use engine::{Context, NodeError};

use super::plane::Plane;
use crate::math::num;

/// Default resolution in pixels per degree of visual angle: a display that is 3840 pixels and 0.7 m wide, seen from
/// 0.7 m.
pub const PIXELS_PER_DEGREE: f64 = 67.020_643_276_582_25;

/// Colour, edge and point features of all pixels of a picture, as defined by FLIP. Computed from linear RGB, clamped to
/// the range of a display, 0 to 1.
pub struct Sight(Vec<Features>);

impl Sight {
    /// Computes the features of a picture in linear light with three channels. `pixels_per_degree` is the resolution
    /// in pixels per degree of visual angle.
    pub fn of(plane: &Plane, pixels_per_degree: f64, cx: &Context) -> Result<Self, NodeError> {
        seen(plane, &Kernels::new(pixels_per_degree), cx).map(Self)
    }

    /// FLIP of every pixel, 0 (equal) to 1, for two pictures of equal size; symmetric.
    pub fn flip(&self, other: &Self, cx: &Context) -> Result<Vec<f64>, NodeError> {
        const TILE: usize = 4096;
        let tiles = cx.for_each_tile(self.0.len().div_ceil(TILE), |tile| {
            let range = tile * TILE..((tile + 1) * TILE).min(self.0.len());
            let pairs = self.0[range.clone()].iter().zip(&other.0[range]);
            pairs.map(|(a, b)| difference(a, b)).collect::<Vec<_>>()
        })?;
        Ok(tiles.concat())
    }
}

/// The colour difference, increased where the features differ (equation 16, with a feature exponent of 0.5).
fn difference(a: &Features, b: &Features) -> f64 {
    let colour = redistribute(hyab(a.colour, b.colour));
    let feature = (a.edge - b.edge).abs().max((a.point - b.point).abs());
    let feature = (feature / std::f64::consts::SQRT_2).sqrt();
    if colour > 0.0 { num::pow(colour, 1.0 - feature) } else { f64::from(feature >= 1.0) }
}

/// Exposures at which HDR-FLIP compares two pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposures {
    /// Darkest exposure, in stops.
    pub start_ev: f64,
    /// Brightest exposure, in stops.
    pub stop_ev: f64,
    /// Number of exposures, evenly spaced, both ends included; at least 2.
    pub count: usize,
}

impl Exposures {
    /// The exposures of the paper, about one stop apart. The first tone-maps the brightest pixel of the reference
    /// to 0.85, the last tone-maps the median pixel to 0.85. `None` if the reference or its median is black.
    pub fn of(reference: &Plane) -> Option<Self> {
        let pixels = reference.samples.chunks_exact(reference.channels);
        let mut luminance: Vec<f64> = pixels.map(|p| dot(XYZ[1], [p[0], p[1], p[2]])).collect();
        luminance.sort_by(f64::total_cmp);
        let (median, largest) = (*luminance.get(luminance.len() / 2)?, *luminance.last()?);
        if !(median > 0.0 && largest.is_finite()) {
            return None;
        }
        // The tone curve reaches 0.85 at the larger root of a x^2 + b x + c = 0.
        const LEVEL: f64 = 0.85;
        let [a, b, c] = [0, 1, 2].map(|i| ACES[i] - LEVEL * ACES[i + 3]);
        let middle = -0.5 * b / a;
        let x = middle + (middle * middle - c / a).sqrt();
        let (start_ev, stop_ev) = (num::f64::log2(x / largest), num::f64::log2(x / median));
        Some(Self { start_ev, stop_ev, count: ((stop_ev - start_ev).ceil() as usize).max(2) })
    }

    fn ev(&self, i: usize) -> f64 {
        self.start_ev + (self.stop_ev - self.start_ev) * i as f64 / (self.count - 1).max(1) as f64
    }
}

/// Coefficients of the filmic curve of Narkowicz, a quotient of two quadratic polynomials that approximates ACES.
const ACES: [f64; 6] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

/// HDR-FLIP of every pixel: the largest FLIP over the exposures, each tone-mapped with the ACES curve.
pub fn hdr_flip_map(
    reference: &Plane,
    test: &Plane,
    exposures: Exposures,
    pixels_per_degree: f64,
    cx: &Context,
) -> Result<Vec<f64>, NodeError> {
    let mut largest = vec![0.0_f64; reference.width * reference.height];
    for i in 0..exposures.count {
        let gain = num::f64::exp2(exposures.ev(i));
        let shown = |plane: &Plane| {
            let curve = |v: &f64| {
                // Beyond 1e12 the curve is constant; squares of larger values could overflow.
                let x = (v * gain).clamp(0.0, 1e12);
                let [k0, k1, k2, k3, k4, k5] = ACES;
                ((k0 * x * x + k1 * x + k2) / (k3 * x * x + k4 * x + k5)).clamp(0.0, 1.0)
            };
            Plane { samples: plane.samples.iter().map(curve).collect(), ..*plane }
        };
        let sight = |plane: &Plane| Sight::of(&shown(plane), pixels_per_degree, cx);
        let map = sight(reference)?.flip(&sight(test)?, cx)?;
        for (most, v) in largest.iter_mut().zip(map) {
            *most = most.max(v);
        }
        cx.progress((i + 1) as f32 / exposures.count as f32);
    }
    Ok(largest)
}

/// Matrix from linear RGB to XYZ for the sRGB primaries and D65, in exact fractions.
const XYZ: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn times(m: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| dot(row, v))
}

/// XYZ of a linear RGB colour, relative to the white point.
fn relative_xyz(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = times(&XYZ, rgb);
    let white = times(&XYZ, [1.0; 3]);
    std::array::from_fn(|i| xyz[i] / white[i])
}

/// The linear RGB colour `rgb` in the opponent space Y Cx Cz, in which the contrast sensitivity of the eye is
/// known.
fn opponent(rgb: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn rgb_of_opponent([y, cx, cz]: [f64; 3], inverse: &[[f64; 3]; 3]) -> [f64; 3] {
    let y = (y + 16.0) / 116.0;
    let white = times(&XYZ, [1.0; 3]);
    times(inverse, [(y + cx / 500.0) * white[0], y * white[1], (y - cz / 200.0) * white[2]])
}

fn inverse(m: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let columns = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
    let determinant = dot(m[0], columns[0]);
    std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r] / determinant))
}

/// CIELAB with chroma scaled by lightness, since dark colours appear less colourful (the Hunt effect).
fn hunt_lab(rgb: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let [x, y, z] = relative_xyz(rgb).map(|t| {
        if t > DELTA * DELTA * DELTA { libm::cbrt(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    });
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

/// The HyAB distance of two colours, raised to the power 0.7. HyAB is designed for large colour differences.
fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [l, p, q] = [0, 1, 2].map(|i| a[i] - b[i]);
    let distance = l.abs() + (p * p + q * q).sqrt();
    if distance > 0.0 { num::pow(distance, 0.7) } else { 0.0 }
}

/// Maps colour distances to 0..1: the lower 40 % of the range of distances to 0..0.95, and the rest to 0.95..1
/// (equation 12).
fn redistribute(distance: f64) -> f64 {
    const SHARE: f64 = 0.95;
    // The distance from green to blue is the largest one.
    let largest = hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0]));
    let knee = 0.4 * largest;
    if distance < knee {
        SHARE / knee * distance
    } else {
        SHARE + (distance - knee) / (largest - knee) * (1.0 - SHARE)
    }
}

/// Features of a pixel: the colour after the filters of the eye, and the strength of edges and points around it.
struct Features {
    colour: [f64; 3],
    edge: f64,
    point: f64,
}

fn seen(plane: &Plane, kernels: &Kernels, cx: &Context) -> Result<Vec<Features>, NodeError> {
    let (width, height) = (plane.width, plane.height);
    let mut channels: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(width * height));
    for pixel in plane.samples.chunks_exact(plane.channels) {
        let shown = [pixel[0], pixel[1], pixel[2]].map(|v| v.clamp(0.0, 1.0));
        for (channel, v) in channels.iter_mut().zip(opponent(shown)) {
            channel.push(v);
        }
    }
    let blur = |channel: &[f64], x: &[f64], y: &[f64]| separable(channel, width, height, x, y, cx);
    let mut blurred: [Vec<f64>; 3] = Default::default();
    for (c, gaussians) in kernels.sensitivity.iter().enumerate() {
        let mut sum = vec![0.0; width * height];
        for (weight, gaussian) in gaussians {
            for (sum, v) in sum.iter_mut().zip(blur(&channels[c], gaussian, gaussian)?) {
                *sum += weight * v;
            }
        }
        blurred[c] = sum;
    }
    let grey: Vec<f64> = channels[0].iter().map(|y| (y + 16.0) / 116.0).collect();
    let feature = |along: &[f64]| -> Result<Vec<f64>, NodeError> {
        let x = blur(&grey, along, &kernels.across)?;
        let y = blur(&grey, &kernels.across, along)?;
        Ok(x.iter().zip(&y).map(|(x, y)| (x * x + y * y).sqrt()).collect())
    };
    let (edges, points) = (feature(&kernels.edge)?, feature(&kernels.point)?);
    let back = inverse(&XYZ);
    let rows = cx.for_each_tile(height, |y| {
        let pixel = |i: usize| {
            let rgb = rgb_of_opponent([blurred[0][i], blurred[1][i], blurred[2][i]], &back);
            let colour = hunt_lab(rgb.map(|v| v.clamp(0.0, 1.0)));
            Features { colour, edge: edges[i], point: points[i] }
        };
        (y * width..(y + 1) * width).map(pixel).collect::<Vec<_>>()
    })?;
    Ok(rows.into_iter().flatten().collect())
}

/// Filters a channel along rows with `x` and along columns with `y`. Pixels at the border are repeated beyond it.
fn separable(
    channel: &[f64],
    width: usize,
    height: usize,
    x: &[f64],
    y: &[f64],
    cx: &Context,
) -> Result<Vec<f64>, NodeError> {
    let radius = x.len() / 2;
    let rows = cx.for_each_tile(height, |row| {
        let line = &channel[row * width..(row + 1) * width];
        let mut wide = vec![line[0]; radius];
        wide.extend_from_slice(line);
        wide.resize(width + 2 * radius, line[width - 1]);
        (0..width).map(|at| wide[at..].iter().zip(x).fold(0.0, |sum, (v, k)| sum + v * k)).collect::<Vec<_>>()
    })?;
    let radius = y.len() / 2;
    let columns = cx.for_each_tile(height, |row| {
        let mut sum = vec![0.0; width];
        for (i, k) in y.iter().enumerate() {
            let from = (row + i).saturating_sub(radius).min(height - 1);
            for (sum, v) in sum.iter_mut().zip(&rows[from]) {
                *sum += v * k;
            }
        }
        sum
    })?;
    Ok(columns.concat())
}

/// The filters for a given number of pixels per degree. Each is separable and stored as one-dimensional kernels.
struct Kernels {
    /// Filters for the contrast sensitivity to lightness, red-green and blue-yellow. Each is a sum of Gaussians,
    /// given as weights and kernels.
    sensitivity: [Vec<(f64, Vec<f64>)>; 3],
    /// First derivative of a Gaussian, scaled so that the weights on each side of the centre sum to 1 or -1.
    edge: Vec<f64>,
    /// Second derivative of the Gaussian, scaled so that the positive weights sum to 1 and the negative weights to
    /// -1.
    point: Vec<f64>,
    /// The Gaussian itself, applied perpendicular to the direction of the derivative.
    across: Vec<f64>,
}

impl Kernels {
    fn new(pixels_per_degree: f64) -> Self {
        use std::f64::consts::PI;
        // Table 1: a and b of a sqrt(pi / b) exp(-pi^2 (x^2 + y^2) / b) in degrees.
        let table: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
        // All extend to three standard deviations of the widest.
        let reach = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i64;
        let sensitivity = table.map(|gaussians| {
            let mut parts: Vec<(f64, Vec<f64>)> = gaussians
                .iter()
                .map(|(a, b)| {
                    let along: Vec<f64> = (-reach..=reach)
                        .map(|i| i as f64 / pixels_per_degree)
                        .map(|x| num::f64::exp(-PI * PI * x * x / b))
                        .collect();
                    (a * (PI / b).sqrt(), along)
                })
                .collect();
            let square = |along: &[f64]| along.iter().sum::<f64>() * along.iter().sum::<f64>();
            let whole: f64 = parts.iter().map(|(weight, along)| weight * square(along)).sum();
            parts.iter_mut().for_each(|(weight, _)| *weight /= whole);
            parts
        });
        // Features have a width of 0.082 degrees.
        let sigma = 0.5 * 0.082 * pixels_per_degree;
        let reach = (3.0 * sigma).ceil() as i64;
        let gaussian = |x: f64| num::f64::exp(-x * x / (2.0 * sigma * sigma));
        let along = |f: &dyn Fn(f64) -> f64| (-reach..=reach).map(|i| f(i as f64)).collect::<Vec<f64>>();
        let signed = |mut kernel: Vec<f64>| {
            let sum = |sign: f64| kernel.iter().map(|v| (sign * v).max(0.0)).sum::<f64>();
            let (above, below) = (sum(1.0), sum(-1.0));
            kernel.iter_mut().for_each(|v| *v /= if *v > 0.0 { above } else { below });
            kernel
        };
        let mut across = along(&gaussian);
        let whole: f64 = across.iter().sum();
        across.iter_mut().for_each(|v| *v /= whole);
        let edge = signed(along(&|x| -x * gaussian(x)));
        let point = signed(along(&|x| (x * x / (sigma * sigma) - 1.0) * gaussian(x)));
        Self { sensitivity, edge, point, across }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    fn flat(width: usize, height: usize, rgb: [f64; 3]) -> Plane {
        Plane { width, height, channels: 3, samples: rgb.repeat(width * height) }
    }

    fn flip_map(a: &Plane, b: &Plane, ppd: f64, cx: &Context) -> Result<Vec<f64>, NodeError> {
        Sight::of(a, ppd, cx)?.flip(&Sight::of(b, ppd, cx)?, cx)
    }

    #[test]
    fn equal_pictures_do_not_differ_and_black_to_white_nearly_does_all() {
        let cx = context();
        let picture = Plane {
            samples: (0..18 * 11 * 3).map(|i| f64::from(i % 17) / 16.0).collect(),
            ..flat(18, 11, [0.0; 3])
        };
        let same = flip_map(&picture, &picture, PIXELS_PER_DEGREE, &cx).expect("runs");
        assert!(same.iter().all(|v| *v == 0.0));
        let map =
            flip_map(&flat(9, 7, [0.0; 3]), &flat(9, 7, [1.0; 3]), PIXELS_PER_DEGREE, &cx).expect("runs");
        // The value of the published tool, whose matrix differs in the sixth digit.
        assert!(map.iter().all(|v| (v - 0.967_388).abs() < 2e-5), "{map:?}");
    }

    #[test]
    fn a_point_is_seen_from_near_and_lost_from_far() {
        let cx = context();
        let dark = flat(31, 31, [0.1; 3]);
        let mut dotted = flat(31, 31, [0.1; 3]);
        dotted.samples[(15 * 31 + 15) * 3..][..3].fill(0.9);
        let mean =
            |ppd| flip_map(&dark, &dotted, ppd, &cx).expect("runs").iter().copied().fold(0.0, f64::max);
        assert!(mean(20.0) > 1.5 * mean(150.0), "{} {}", mean(20.0), mean(150.0));
    }

    #[test]
    fn exposures_span_the_picture_and_extremes_stay_finite() {
        let cx = context();
        let mut sunny = flat(12, 8, [0.2; 3]);
        sunny.samples[..3].fill(1e30);
        let exposures = Exposures::of(&sunny).expect("has light");
        assert!(exposures.count > 90 && exposures.start_ev < -95.0 && exposures.stop_ev > 0.0);
        let few = Exposures { count: 3, ..exposures };
        let map = hdr_flip_map(&sunny, &flat(12, 8, [0.2; 3]), few, PIXELS_PER_DEGREE, &cx).expect("runs");
        assert!(map.iter().all(|v| (0.0..=1.0).contains(v)));
        assert_eq!(Exposures::of(&flat(4, 4, [0.0; 3])), None);
    }
}
