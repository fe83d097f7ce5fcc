//! Tables of directional albedo: the share of light that a lobe reflects towards a viewer if equal light arrives
//! from all directions. The albedo of a layer determines how much light the layer leaves to the layers below. It
//! also determines the energy that single scattering at microfacets loses. A gain compensates this loss (Turquin
//! 2019, Practical multiple scattering compensation for microfacet models).
//!
//! The tables for microfacets cover a fixed set of relative indices of refraction and roughnesses. They are
//! computed on first use, and values between entries are interpolated. All quantities of a table come from the same
//! sample points, so a reflection that is too high in a table is balanced by a transmission that is too low.

use std::sync::{LazyLock, OnceLock};

use glam::Vec3;

use super::ggx::{Ggx, schlick};
use super::{dielectric, sheen};

/// `N` values at each point of a grid over the `D`-dimensional unit cube. Values between grid points are
/// interpolated linearly.
struct Table<const D: usize, const N: usize> {
    steps: [usize; D],
    cells: Vec<[f32; N]>,
}

impl<const D: usize, const N: usize> Table<D, N> {
    fn new(steps: [usize; D], value: impl Fn([f32; D]) -> [f32; N]) -> Self {
        let cell = |mut index: usize| {
            value(steps.map(|n| {
                let at = index % n;
                index /= n;
                at as f32 / (n - 1) as f32
            }))
        };
        Self { steps, cells: (0..steps.iter().product()).map(cell).collect() }
    }

    fn at(&self, point: [f32; D]) -> [f32; N] {
        let (mut first, mut stride) = (0, 1);
        let mut axes = [(0, 0.0); D];
        for (axis, (p, n)) in axes.iter_mut().zip(point.into_iter().zip(self.steps)) {
            let x = p.clamp(0.0, 1.0) * (n - 1) as f32;
            let cell = (x as usize).min(n - 2);
            first += cell * stride;
            *axis = (stride, x - cell as f32);
            stride *= n;
        }
        let mut sum = [0.0; N];
        for corner in 0..1_usize << D {
            let (mut index, mut weight) = (first, 1.0);
            for (k, (stride, t)) in axes.into_iter().enumerate() {
                let upper = corner >> k & 1 == 1;
                index += if upper { stride } else { 0 };
                weight *= if upper { t } else { 1.0 - t };
            }
            for (sum, value) in sum.iter_mut().zip(self.cells[index]) {
                *sum += weight * value;
            }
        }
        sum
    }
}

/// Table coordinate of the cosine between the viewer direction and the normal. Table entries are denser at grazing
/// angles, where albedos are steep.
fn place(cosine: f32) -> f32 {
    cosine.max(0.0).sqrt()
}

/// Viewer direction that corresponds to the table coordinate `place`.
fn viewer(place: f32) -> Vec3 {
    let z = (place * place).max(1e-4);
    Vec3::new((1.0 - z * z).max(0.0).sqrt(), 0.0, z)
}

/// Shares of light that single scattering at microfacets sends towards a viewer.
#[derive(Debug, Clone, Copy)]
pub struct Facets {
    /// Share reflected if facets are perfect mirrors.
    pub all: f32,
    /// Same as `all`, with each facet weighted by Schlick's factor [`schlick`]; for metals.
    metal: f32,
    /// Same as `all`, with each facet weighted by [`dielectric::rise`]; for dielectrics.
    dielectric: f32,
    /// Share transmitted by a dielectric interface.
    pub passed: f32,
    /// Mean of `all` over all viewer directions. Used for light that hits a second facet.
    mean: f32,
    /// Mean of [`dielectric::rise`] over the hemisphere.
    rise: f32,
}

impl Facets {
    /// Shares for a surface without an interface, for which no table is needed.
    pub const NONE: Self = Self { all: 1.0, metal: 0.0, dielectric: 0.0, passed: 1.0, mean: 1.0, rise: 0.0 };

    /// Shares for a distribution of facets. `out` is the direction to the viewer in the frame of the distribution.
    /// `eta` is the index of refraction of the other side, relative to the side of the viewer.
    pub fn new(ggx: &Ggx, out: Vec3, eta: f32) -> Self {
        let [x, y] = ggx.alphas();
        if x <= y {
            return Self::round(out.z, y.sqrt(), eta);
        }
        let aslant = out.x * out.x + out.y * out.y;
        let along = if aslant > 0.0 { out.x * out.x / aslant } else { 0.5 };
        let point = [place(out.z), along, y.sqrt(), ((x - y) / (1.0 - y)).sqrt()];
        Self::of(eta, ggx.roughness(out), |slice| slice.brushed.get_or_init(|| brushed(slice.eta)).at(point))
    }

    /// Shares for isotropic facets with the given perceptual roughness.
    pub fn round(cosine: f32, roughness: f32, eta: f32) -> Self {
        Self::of(eta, roughness, |slice| slice.round(place(cosine), roughness))
    }

    fn of(eta: f32, roughness: f32, scattered: impl Fn(&Slice) -> [f32; 4]) -> Self {
        let [all, metal, dielectric, passed, mean, rise] = at_index(eta, |slice| {
            let [all, metal, dielectric, passed] = scattered(slice);
            let [a, b, ..] = slice.means(roughness);
            [all, metal, dielectric, passed, a + b, slice.rise]
        });
        Self { all: all.clamp(1e-3, 1.0), metal, dielectric, passed, mean, rise }
    }

    /// Albedo of a metal with reflectance `f0` at normal incidence. The first value counts only single scattering,
    /// the second also multiple scattering.
    pub fn metal(&self, f0: f32) -> [f32; 2] {
        let once = f0 * (self.all - self.metal) + self.metal;
        [once, once * self.gain(f0 + (1.0 - f0) / 21.0)]
    }

    /// Albedo of a dielectric with reflectance `f0` at normal incidence. The first value counts only single
    /// scattering, the second also multiple scattering.
    pub fn dielectric(&self, f0: f32) -> [f32; 2] {
        let once = f0 * (self.all - self.dielectric) + self.dielectric;
        [once, (once * self.gain(f0 + (1.0 - f0) * self.rise)).min(1.0)]
    }

    /// Ratio of all reflected light to the light that is reflected by single scattering, for facets of mean
    /// reflectance `f`.
    fn gain(&self, f: f32) -> f32 {
        1.0 + (1.0 - self.all) / self.all * again(f, self.mean)
    }
}

/// Light that facets of mean reflectance `f` reflect by multiple scattering, as a share of the light that single
/// scattering at white mirrors loses. `mean` is the mean of [`Facets::all`]. Light is attenuated at each further
/// facet (the series of Kulla and Conty 2017).
fn again(f: f32, mean: f32) -> f32 {
    f * mean / (1.0 - f * (1.0 - mean))
}

/// Cosine-weighted mean, over the hemisphere, of the total albedo [`Facets::dielectric`] of isotropic facets. The
/// reflectance is `f0` at normal incidence and 1 at grazing incidence.
pub fn mean_reflection(f0: f32, eta: f32, roughness: f32) -> f32 {
    let [a, b, c, d, rise] = at_index(eta, |slice| {
        let [a, b, c, d] = slice.means(roughness);
        [a, b, c, d, slice.rise]
    });
    (f0 * a + b + (f0 * c + d) * again(f0 + (1.0 - f0) * rise, a + b)).min(1.0)
}

/// Number of viewer coordinates and number of roughnesses in the tables of isotropic facets.
const SIDE: usize = 32;

/// Index of the last table entry before the coordinate `at` (from 0 to 1), and the distance from that entry to `at`
/// in units of the entry spacing.
fn step(at: f32) -> (usize, f32) {
    let x = at.clamp(0.0, 1.0) * (SIDE - 1) as f32;
    let cell = (x as usize).min(SIDE - 2);
    (cell, x - cell as f32)
}

/// Tables for one relative index of refraction.
struct Slice {
    eta: f32,
    /// Values of `all`, `metal`, `dielectric` and `passed` of [`Facets`] over the viewer coordinate, for each
    /// roughness.
    round: [OnceLock<[[f32; 4]; SIDE]>; SIDE],
    /// The same quantities for anisotropic facets, over the viewer coordinate, the azimuth of the viewer, the
    /// roughness and the anisotropy.
    brushed: OnceLock<Table<4, 4>>,
    /// Means over the hemisphere for each roughness, as linear functions of f0. Values 0 and 1 are the factor of f0
    /// and the constant term for single scattering. Values 2 and 3 are the factor and the constant term for
    /// multiple scattering.
    means: [OnceLock<[f32; 4]>; SIDE],
    rise: f32,
}

impl Slice {
    fn new(eta: f32) -> Self {
        let [rise] = over_cosines(|c| [dielectric::rise(c, eta)]);
        let (round, means) = ([const { OnceLock::new() }; SIDE], [const { OnceLock::new() }; SIDE]);
        Self { eta, round, brushed: OnceLock::new(), means, rise }
    }

    /// Values of [`Slice::round`] for the roughness with index `number`.
    fn line(&self, number: usize) -> &[[f32; 4]; SIDE] {
        let along = |k: usize| k as f32 / (SIDE - 1) as f32;
        self.round[number].get_or_init(|| {
            let ggx = Ggx::isotropic(along(number));
            std::array::from_fn(|k| facets(&ggx, viewer(along(k)), self.eta, [144, 233]))
        })
    }

    fn round(&self, place: f32, roughness: f32) -> [f32; 4] {
        let ((cell, along), (number, across)) = (step(place), step(roughness));
        let mut sum = [0.0; 4];
        for (number, weight) in [(number, 1.0 - across), (number + 1, across)] {
            let line = self.line(number);
            for (value, part) in [(line[cell], 1.0 - along), (line[cell + 1], along)] {
                sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += part * weight * value);
            }
        }
        sum
    }

    fn means(&self, roughness: f32) -> [f32; 4] {
        let (number, across) = step(roughness);
        let mut sum = [0.0; 4];
        for (number, weight) in [(number, 1.0 - across), (number + 1, across)] {
            let mean = self.means[number].get_or_init(|| {
                let roughness = number as f32 / (SIDE - 1) as f32;
                over_cosines(|c| {
                    let [all, _, b, _] = self.round(place(c), roughness);
                    let (a, lost) = (all - b, (1.0 - all) / all.clamp(1e-3, 1.0));
                    [a, b, a * lost, b * lost]
                })
            });
            sum.iter_mut().zip(mean).for_each(|(sum, value)| *sum += weight * value);
        }
        sum
    }
}

fn brushed(eta: f32) -> Table<4, 4> {
    Table::new([16, 5, 20, 9], |[place, along, roughness, strength]| {
        let aslant = viewer(place);
        let out = Vec3::new(aslant.x * along.sqrt(), aslant.x * (1.0 - along).sqrt(), aslant.z);
        facets(&Ggx::anisotropic(roughness, strength), out, eta, [89, 144])
    })
}

/// Number of slices between the indices of refraction 1 and 1.5. The last slice has an index of about 61.
const STEPS: f32 = 20.0;
const SLICES: usize = 45;

/// Value of `f` for the relative index of refraction `eta`, interpolated between slices.
fn at_index<const N: usize>(eta: f32, f: impl Fn(&Slice) -> [f32; N]) -> [f32; N] {
    static OUTSIDE: [OnceLock<Box<Slice>>; SLICES] = [const { OnceLock::new() }; SLICES];
    static INSIDE: [OnceLock<Box<Slice>>; SLICES] = [const { OnceLock::new() }; SLICES];
    let (slices, index) = if eta < 1.0 { (&INSIDE, 1.0 / eta) } else { (&OUTSIDE, eta) };
    // Denser towards an index of 1, where grazing reflectance is steep. 1.5 is a slice.
    let step = 2.0 * (index - 1.0) / (index + 1.0);
    let x = (STEPS * (step / 0.4).sqrt()).min((SLICES - 1) as f32);
    let at = |k: usize| {
        f(slices[k].get_or_init(|| {
            let root = k as f32 / STEPS;
            let step = 0.4 * root * root;
            let index = (1.0 + 0.5 * step) / (1.0 - 0.5 * step);
            Box::new(Slice::new(if eta < 1.0 { 1.0 / index } else { index }))
        }))
    };
    let near = (x + 0.5) as usize;
    if (x - near as f32).abs() < 1e-3 {
        return at(near);
    }
    let (lower, upper, t) = (at(x as usize), at(x as usize + 1), x.fract());
    std::array::from_fn(|i| lower[i] + (upper[i] - lower[i]) * t)
}

/// Values of [`Slice::round`] for one distribution and one viewer, computed as the mean over sampled visible
/// facets. The sample points form a Fibonacci lattice, which is given by two consecutive Fibonacci numbers. A
/// lattice of 233 points is more accurate than 256 stratified points.
fn facets(ggx: &Ggx, out: Vec3, eta: f32, [step, n]: [u32; 2]) -> [f32; 4] {
    let mut sum = [0.0_f64; 4];
    for i in 0..n {
        let along = |k: u32| ((k % n) as f32 + 0.5) / n as f32;
        let half = ggx.sample(out, [along(i * step), along(i)]);
        let cosine = out.dot(half);
        let mirrored = half * (2.0 * cosine) - out;
        let above = if mirrored.z > 0.0 { ggx.g2_over_g1(out, mirrored) } else { 0.0 };
        let below = dielectric::refract(out, half, eta).filter(|bent| bent.z < 0.0);
        let below =
            below.map_or(0.0, |bent| (1.0 - dielectric::fresnel(cosine, eta)) * ggx.g2_over_g1(out, bent));
        let value = [above, above * schlick(cosine), above * dielectric::rise(cosine, eta), below];
        sum.iter_mut().zip(value).for_each(|(sum, v)| *sum += f64::from(v));
    }
    sum.map(|sum| (sum / f64::from(n)) as f32)
}

/// Cosine-weighted mean of `f` over the hemisphere: twice the integral of f(c) c dc for c from 0 to 1.
fn over_cosines<const N: usize>(f: impl Fn(f32) -> [f32; N]) -> [f32; N] {
    const STEPS: usize = 32;
    let mut sum = [0.0; N];
    for i in 0..STEPS {
        let c = (i as f32 + 0.5) / STEPS as f32;
        sum.iter_mut().zip(f(c)).for_each(|(sum, v)| *sum += 2.0 * c * v / STEPS as f32);
    }
    sum
}

/// Albedo of a white sheen. At grazing angles it exceeds 1; the caller must limit it.
pub fn sheen(cosine: f32, roughness: f32) -> f32 {
    static TABLE: LazyLock<Table<2, 1>> = LazyLock::new(|| {
        const SIDE: usize = 32;
        let middle = |i: usize| (i as f32 + 0.5) / SIDE as f32;
        Table::new([24, 24], |[place, roughness]| {
            let out = viewer(place);
            let weight = |i: usize| {
                // Sampled by the square root of the height, since smooth fibres are brightest at grazing angles.
                let root = middle(i % SIDE);
                let incident = sheen::uniform([middle(i / SIDE), root * root]);
                f64::from(2.0 * root * sheen::value(out, incident, roughness) / sheen::UNIFORM)
            };
            [((0..SIDE * SIDE).map(weight).sum::<f64>() / (SIDE * SIDE) as f64) as f32]
        })
    });
    TABLE.at([place(cosine), roughness])[0]
}
