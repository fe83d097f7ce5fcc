//! Directional albedos in tables: how much of the light towards a viewer a lobe reflects, whatever
//! direction it came from. They say what a layer leaves to those below, and how much light single
//! scattering between facets loses, which a gain gives back (Turquin 2019, Practical multiple scattering
//! compensation for microfacet models).

use std::sync::LazyLock;

use glam::Vec3;

use super::ggx::{Ggx, schlick};
use super::{glass, sheen};
use crate::sampling::Points;

/// Values on a grid over the unit cube, interpolated linearly.
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

/// The place of a cosine in a table: denser at grazing angles, where albedos are steep.
fn place(cosine: f32) -> f32 {
    cosine.max(0.0).sqrt()
}

/// A viewer at a place of a table.
fn viewer(place: f32) -> Vec3 {
    let z = (place * place).max(1e-4);
    Vec3::new((1.0 - z * z).max(0.0).sqrt(), 0.0, z)
}

/// Mean of `f` over the points of the unit square.
fn mean<const N: usize>(n: u32, f: impl Fn([f32; 2]) -> [f32; N]) -> [f32; N] {
    let mut sum = [0.0_f64; N];
    for i in 0..n {
        let value = f(Points::new(1, i).pair(0));
        sum.iter_mut().zip(value).for_each(|(sum, v)| *sum += f64::from(v));
    }
    sum.map(|sum| (sum / f64::from(n)) as f32)
}

/// The place of an index of refraction in a table, from no step to an index of 3, and its inverse. An index of
/// 1.5 stands at 0.4.
fn step(eta: f32) -> f32 {
    2.0 * (eta - 1.0) / (eta + 1.0)
}

fn index(step: f32) -> f32 {
    (1.0 + 0.5 * step) / (1.0 - 0.5 * step)
}

/// What round GGX facets reflect towards a viewer at a place: see [`reflected`].
fn facets(place: f32, roughness: f32, rise: impl Fn(f32) -> f32) -> [f32; 2] {
    reflected(&Ggx::round(roughness), viewer(place), rise)
}

/// What GGX facets reflect towards a viewer: `[a, b]` of `f0 * a + f90 * b`, where reflectance has risen from
/// f0 to f90 by the share `rise` of the cosine to a facet.
fn reflected(ggx: &Ggx, out: Vec3, rise: impl Fn(f32) -> f32) -> [f32; 2] {
    mean(256, |point| {
        let incident = ggx.reflect(out, point);
        if incident.z <= 0.0 {
            return [0.0; 2];
        }
        let mirror = ggx.mirror(out, incident);
        let (weight, rise) = (mirror.value / mirror.pdf, rise(mirror.cosine));
        [weight * (1.0 - rise), weight * rise]
    })
}

/// Reflectance of metal facets, by Schlick's formula, is `f0 * a + f90 * b`: gives `[a, b]`.
pub fn metal(cosine: f32, roughness: f32) -> [f32; 2] {
    static TABLE: LazyLock<Table<2, 2>> =
        LazyLock::new(|| Table::new([32, 32], |[place, roughness]| facets(place, roughness, schlick)));
    TABLE.at([place(cosine), roughness])
}

/// The same for facets stretched along an axis, of the widths of `ggx`, for a viewer in their frame.
pub fn brushed(ggx: &Ggx, out: Vec3) -> [f32; 2] {
    // The place of the viewer, how far along the first axis it is seen aslant, and the roots of both widths.
    static TABLE: LazyLock<Table<4, 2>> = LazyLock::new(|| {
        Table::new([16, 5, 9, 9], |[place, along, x, y]| {
            let aslant = viewer(place);
            let out = Vec3::new(aslant.x * along.sqrt(), aslant.x * (1.0 - along).sqrt(), aslant.z);
            reflected(&Ggx::of([x * x, y * y]), out, schlick)
        })
    });
    let (x, y) = (out.x * out.x, out.y * out.y);
    let along = if x + y > 0.0 { x / (x + y) } else { 0.5 };
    let [a, b] = ggx.widths().map(f32::sqrt);
    TABLE.at([place(out.z), along, a, b])
}

/// The same for facets of a dielectric of an index, by Fresnel's formula.
pub fn dielectric(cosine: f32, roughness: f32, eta: f32) -> [f32; 2] {
    static TABLE: LazyLock<Table<3, 2>> = LazyLock::new(|| {
        Table::new([32, 24, 6], |[place, roughness, step]| {
            let eta = index(step);
            facets(place, roughness, |cosine| glass::rise(cosine, eta))
        })
    });
    TABLE.at([place(cosine), roughness, step(eta)])
}

/// Twice the integral of E(c) c dc over the hemisphere for an interface with f90 = 1, where E is
/// [`with_gain`].
pub fn mean_reflection(f0: f32, eta: f32, roughness: f32) -> f32 {
    // E is linear in f0 for each of its terms, single scattering and what comes after it.
    static TABLE: LazyLock<Table<2, 4>> = LazyLock::new(|| {
        Table::new([24, 6], |[roughness, step]| {
            over_cosines(|c| {
                let [a, b] = dielectric(c, roughness, index(step));
                let all = (a + b).clamp(1e-3, 1.0);
                [a, b, a * (1.0 - all) / all, b * (1.0 - all) / all]
            })
        })
    });
    let [a, b, c, d] = TABLE.at([roughness, step(eta)]);
    (f0 * a + b + (f0 * c + d) * again(average(f0, eta), roughness)).min(1.0)
}

/// Twice the integral of f(c) c dc over the hemisphere.
fn over_cosines<const N: usize>(f: impl Fn(f32) -> [f32; N]) -> [f32; N] {
    const STEPS: usize = 32;
    let mut sum = [0.0; N];
    for i in 0..STEPS {
        let c = (i as f32 + 0.5) / STEPS as f32;
        sum.iter_mut().zip(f(c)).for_each(|(sum, v)| *sum += 2.0 * c * v / STEPS as f32);
    }
    sum
}

/// What facets of mean reflectance `f` give beyond their single scattering, as a share of what a white mirror
/// loses: light that meets a facet again is dimmed each time (the series of Kulla and Conty 2017).
fn again(f: f32, roughness: f32) -> f32 {
    static MEAN: LazyLock<Table<1, 1>> = LazyLock::new(|| {
        Table::new([32], |[roughness]| over_cosines(|c| [metal(c, roughness).iter().sum()]))
    });
    let mean = MEAN.at([roughness])[0];
    f * mean / (1.0 - f * (1.0 - mean))
}

/// How much more facets of mean reflectance `f` give than their single scattering, of which a white mirror has
/// `all`.
pub fn gain(f: f32, all: f32, roughness: f32) -> f32 {
    1.0 + (1.0 - all) / all * again(f, roughness)
}

/// Albedo of an interface of an index and f90 = 1, what is lost between facets given back.
pub fn with_gain(f0: f32, eta: f32, cosine: f32, roughness: f32) -> f32 {
    let [a, b] = dielectric(cosine, roughness, eta);
    let all = (a + b).clamp(1e-3, 1.0);
    ((f0 * a + b) * gain(average(f0, eta), all, roughness)).min(1.0)
}

/// Mean reflectance of a dielectric over the hemisphere.
pub fn average(f0: f32, eta: f32) -> f32 {
    static RISE: LazyLock<Table<1, 1>> =
        LazyLock::new(|| Table::new([41], |[step]| over_cosines(|c| [glass::rise(c, index(step))])));
    f0 + (1.0 - f0) * RISE.at([step(eta)])[0]
}

/// Mean of Schlick's reflectance over the hemisphere.
pub fn average_metal(f0: f32) -> f32 {
    f0 + (1.0 - f0) / 21.0
}

/// What of the light a single rough interface between two indices reflects and lets through:
/// `[reflected, transmitted]`, for a viewer on the side whose index is 1 where the other's is `eta`.
pub fn interface(cosine: f32, roughness: f32, eta: f32) -> [f32; 2] {
    static TABLE: LazyLock<[Table<3, 2>; 2]> = LazyLock::new(|| {
        [false, true].map(|inside| {
            Table::new([24, 12, 8], |[place, roughness, step]| {
                let eta = glass::steep(if inside { 1.0 / index(step) } else { index(step) });
                let (ggx, out) = (Ggx::round(roughness), viewer(place));
                mean(1024, |point| glass::split(&ggx, out, eta, point))
            })
        })
    });
    TABLE[usize::from(eta < 1.0)].at([place(cosine), roughness, step(eta.max(1.0 / eta))])
}

/// Albedo of a white sheen.
pub fn sheen(cosine: f32, roughness: f32) -> f32 {
    static TABLE: LazyLock<Table<2, 1>> = LazyLock::new(|| {
        Table::new([24, 24], |[place, roughness]| {
            let out = viewer(place);
            let value = mean(1024, |point| {
                let incident = sheen::uniform(point);
                [sheen::value(out, incident, roughness) / sheen::UNIFORM]
            });
            [value[0].min(1.0)]
        })
    });
    TABLE.at([place(cosine), roughness])[0]
}
