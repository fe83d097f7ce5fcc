//! Compression of colours into the gamut of a display.

use super::appearance::{Appearance, Jmh, PEAK, exponent, lightness};
use crate::math::num;

/// Smoothing of the cusp: share of its colourfulness within which both hulls are blended, and by how much the cusp
/// is moved outwards for it.
const SMOOTH: f64 = 0.12;
const SMOOTH_OUT: f64 = 0.27;
/// Blend of the lightness to which colours are projected, between that of the cusp and that of middle grey.
const MIDDLE_BLEND: f64 = 1.3;
/// Distance of the focus of the projection, in units of the largest lightness.
const FOCUS: f64 = 1.35;
/// Start of the increase of that distance, between cusp and white.
const FOCUS_START: f64 = 0.3;
/// Share of the boundary below which no colour moves.
const UNCHANGED: f64 = 0.75;
/// Exponent of the lower hull.
const LOWER: f64 = 1.14;
/// Luminance of middle grey on the display, in cd/m2.
const GREY: f64 = 10.013;
/// Positions between cusp and white at which the upper hull is fitted.
const FITTED: [f64; 5] = [0.01, 0.1, 0.5, 0.8, 0.99];

/// The gamut of a display, and how far colours of AP1 reach.
#[derive(Debug, Clone)]
pub(super) struct Gamut {
    /// Lightness of white, and that of middle grey.
    brightest: f64,
    middle: f64,
    /// Colourfulness of AP1 at the lightness of white, for each degree of hue.
    reach: Vec<f64>,
    /// Cusps by rising hue, from below 0 to 360 degrees and more: at each degree and at each corner.
    cusps: Vec<Cusp>,
}

/// The most colourful colour of the gamut at one hue.
#[derive(Debug, Clone, Copy)]
struct Cusp {
    hue: f64,
    j: f64,
    m: f64,
    /// Inverse exponent of the upper hull.
    upper: f64,
}

/// Limits at the hue of a colour.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Lightness of white.
    pub brightest: f64,
    /// Colourfulness of AP1 at the lightness of white.
    pub reach: f64,
    cusp: Cusp,
    /// Lightness of the axis to which colours are projected.
    focus: f64,
}

/// Line along which colours are projected: through the axis at lightness `axis`.
struct Line {
    axis: f64,
    slope: f64,
}

impl Gamut {
    /// The gamut of a display for colours of a scene in AP1.
    pub fn new(scene: &Appearance, display: &Appearance) -> Self {
        let brightest = lightness(PEAK);
        let reach = (0..360).map(|hue| reach(scene, brightest, f64::from(hue))).collect();
        let mut gamut = Self { brightest, middle: lightness(GREY), reach, cusps: Vec::new() };
        let mut cusps = cusps(display);
        for cusp in &mut cusps {
            cusp.upper = 1.0 / gamut.upper_exponent(cusp, display);
        }
        let (first, last) = (cusps[0], cusps[cusps.len() - 1]);
        cusps.insert(0, Cusp { hue: last.hue - 360.0, ..last });
        cusps.push(Cusp { hue: first.hue + 360.0, ..first });
        gamut.cusps = cusps;
        gamut
    }

    /// The limits at a hue, 0 to 360 degrees.
    pub fn limits(&self, hue: f64) -> Limits {
        let low = (hue as usize).min(359);
        let part = hue - low as f64;
        let reach = self.reach[low] + (self.reach[(low + 1) % 360] - self.reach[low]) * part;
        let next = self.cusps.partition_point(|cusp| cusp.hue < hue).clamp(1, self.cusps.len() - 1);
        let (a, b) = (self.cusps[next - 1], self.cusps[next]);
        let part = (hue - a.hue) / (b.hue - a.hue);
        let mix = |a: f64, b: f64| a + (b - a) * part;
        let cusp = Cusp { hue, j: mix(a.j, b.j), m: mix(a.m, b.m), upper: mix(a.upper, b.upper) };
        Limits { brightest: self.brightest, reach, cusp, focus: self.focus(&cusp) }
    }

    /// The colour moved into the gamut along a line of constant hue. Colours well inside stay.
    pub fn compressed(&self, colour: Jmh, limits: &Limits) -> Jmh {
        let Jmh { j, m, h } = colour;
        if j <= 0.0 {
            return Jmh { j: 0.0, m: 0.0, h };
        }
        if m <= 0.0 || j > self.brightest {
            return Jmh { j, m: 0.0, h };
        }
        let gain = self.gain(j, limits.cusp.j);
        let line = self.line(j, m, limits.focus, gain);
        let boundary = self.boundary(&limits.cusp, &line, limits.focus, gain, limits.cusp.upper);
        if boundary <= 0.0 {
            return Jmh { j, m: 0.0, h };
        }
        let reach = crossing(&line, 1.0 / exponent(), [self.brightest, limits.reach], self.brightest);
        let m = remapped(m, boundary, reach);
        Jmh { j: line.axis + m * line.slope, m, h }
    }

    /// Lightness of the axis to which colours of a hue are projected.
    fn focus(&self, cusp: &Cusp) -> f64 {
        cusp.j + (self.middle - cusp.j) * (MIDDLE_BLEND - cusp.j / self.brightest).min(1.0)
    }

    /// Scale of the slopes of projection lines: they get flatter towards white.
    fn gain(&self, j: f64, cusp: f64) -> f64 {
        let start = cusp + (self.brightest - cusp) * FOCUS_START;
        let mut gain = 1.0;
        if j > start {
            let towards = (self.brightest - start) / (self.brightest - j.min(self.brightest)).max(1e-4);
            // OpenColorIO 2.6 squares the logarithm; early versions of the specification have the power 1 / 0.55.
            let stops = num::f64::log10(towards);
            gain += stops * stops;
        }
        self.brightest * FOCUS * gain
    }

    /// The projection line through a colour.
    fn line(&self, j: f64, m: f64, focus: f64, gain: f64) -> Line {
        let a = m / (focus * gain);
        let axis = if j < focus {
            let b = 1.0 - m / gain;
            -2.0 * j / (-b - (b * b + 4.0 * a * j).sqrt())
        } else {
            let b = -(1.0 + m / gain + self.brightest * a);
            let c = self.brightest * m / gain + j;
            2.0 * c / (-b + (b * b - 4.0 * a * c).sqrt())
        };
        let room = if axis < focus { axis } else { self.brightest - axis };
        Line { axis, slope: room * (axis - focus) / (focus * gain) }
    }

    /// Colourfulness at which a line leaves the gamut. `upper` is the inverse exponent of the upper hull.
    fn boundary(&self, cusp: &Cusp, line: &Line, focus: f64, gain: f64, upper: f64) -> f64 {
        let at_cusp = self.line(cusp.j, cusp.m, focus, gain).axis;
        let below = crossing(line, 1.0 / LOWER, [cusp.j, cusp.m], at_cusp);
        // The upper hull, seen from white downwards.
        let flipped = Line { axis: self.brightest - line.axis, slope: -line.slope };
        let above = crossing(&flipped, upper, [self.brightest - cusp.j, cusp.m], self.brightest - at_cusp);
        // A minimum that is smooth within a share of the cusp.
        let width = SMOOTH * cusp.m;
        let near = (width - (below - above).abs()).max(0.0) / width;
        below.min(above) - near * near * near * width / 6.0
    }

    /// The smallest exponent with which the upper hull contains the gamut at all fitted positions.
    fn upper_exponent(&self, cusp: &Cusp, display: &Appearance) -> f64 {
        let focus = self.focus(cusp);
        let contains = |exponent: f64| {
            FITTED.iter().all(|position| {
                let j = cusp.j + (self.brightest - cusp.j) * position;
                let gain = self.gain(j, cusp.j);
                let line = self.line(j, cusp.m, focus, gain);
                let m = self.boundary(cusp, &line, focus, gain, 1.0 / exponent);
                let rgb = display.rgb(Jmh { j: line.axis + line.slope * m, m, h: cusp.hue });
                rgb.iter().any(|v| *v > 1.0)
            })
        };
        let (mut low, mut high) = (0.0, 0.4);
        while high < 5.0 && !contains(high) {
            (low, high) = (high, high + 0.4);
        }
        while high - low > 1e-5 {
            let middle = 0.5 * (low + high);
            if contains(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        high
    }
}

/// Approximate colourfulness at which `line` meets the curve `j = top.j (m / top.m)^(1 / inverse)`. The curve is
/// replaced by the straight line from the origin through `top`. To compensate, the lightness at which `line` starts
/// on the axis is raised to the power `inverse`, scaled so that the lightness `reference` is unchanged.
fn crossing(line: &Line, inverse: f64, [top_j, top_m]: [f64; 2], reference: f64) -> f64 {
    let start = reference * num::pow(line.axis / reference, inverse);
    start / (top_j / top_m - line.slope)
}

/// A colourfulness between 0 and `reach`, compressed so that `reach` becomes `boundary`.
fn remapped(m: f64, boundary: f64, reach: f64) -> f64 {
    let share = (boundary / reach).max(UNCHANGED);
    let start = share * boundary;
    if share >= 1.0 || m <= start {
        return m;
    }
    let (room, source) = (boundary - start, reach - start);
    let scale = source / (source / room - 1.0);
    let x = (m - start) / scale;
    start + scale * x / (1.0 + x)
}

/// Colourfulness at which colours of AP1 with the given lightness and hue get a negative component.
fn reach(scene: &Appearance, j: f64, h: f64) -> f64 {
    let outside = |m: f64| scene.rgb(Jmh { j, m, h }).iter().any(|v| *v < 0.0);
    let (mut low, mut high) = (0.0, 50.0);
    while high < 1300.0 && !outside(high) {
        (low, high) = (high, high + 50.0);
    }
    while high - low > 1e-6 {
        let middle = 0.5 * (low + high);
        if outside(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

/// The cusps at each degree and at each corner of the gamut, by rising hue. Cusps lie on the edges between the
/// corners red, yellow, green, cyan, blue and magenta.
fn cusps(display: &Appearance) -> Vec<Cusp> {
    let rgb = [
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 1.0, 1.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
    ];
    let at = |Jmh { j, m, h }: Jmh, hue: f64| {
        debug_assert!((h - hue).abs() < 1e-3 || (h - hue).abs() > 359.0);
        Cusp { hue, j, m: m * (1.0 + SMOOTH_OUT * SMOOTH), upper: 1.0 }
    };
    let mut all: Vec<Cusp> =
        rgb.iter().map(|corner| at(display.jmh(*corner), display.jmh(*corner).h)).collect();
    for degree in 0..360 {
        let hue = f64::from(degree);
        // Hue of a colour relative to the wanted one, -180 to 180 degrees.
        let beyond = |rgb: [f64; 3]| (display.jmh(rgb).h - hue + 540.0).rem_euclid(360.0) - 180.0;
        let edge = (0..6).map(|i| (rgb[i], rgb[(i + 1) % 6])).find(|(a, b)| {
            let (a, b) = (beyond(*a), beyond(*b));
            a <= 0.0 && b > 0.0 && b - a < 180.0
        });
        let Some((from, to)) = edge else { continue };
        let (mut low, mut high) = (0.0, 1.0);
        let point = |t: f64| std::array::from_fn(|i| from[i] + (to[i] - from[i]) * t);
        for _ in 0..48 {
            let middle = 0.5 * (low + high);
            if beyond(point(middle)) > 0.0 {
                high = middle;
            } else {
                low = middle;
            }
        }
        all.push(at(display.jmh(point(low)), hue));
    }
    all.sort_by(|a, b| a.hue.total_cmp(&b.hue));
    all.dedup_by(|a, b| (a.hue - b.hue).abs() < 1e-9);
    all
}
