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

/// Reflectance of GGX facets is `f0 * a + f90 * b`: gives `[a, b]`.
pub fn reflection(cosine: f32, roughness: f32) -> [f32; 2] {
    static TABLE: LazyLock<Table<2, 2>> = LazyLock::new(|| {
        Table::new([32, 32], |[place, roughness]| {
            let (ggx, out) = (Ggx::round(roughness), viewer(place));
            mean(256, |point| {
                let incident = ggx.reflect(out, point);
                if incident.z <= 0.0 {
                    return [0.0; 2];
                }
                let mirror = ggx.mirror(out, incident);
                let (weight, c5) = (mirror.value / mirror.pdf, schlick(mirror.cosine));
                [weight * (1.0 - c5), weight * c5]
            })
        })
    });
    TABLE.at([place(cosine), roughness])
}

/// Twice the integral of E(c) c dc over the hemisphere for an interface with f90 = 1, where E is
/// `albedo` of an interface.
pub fn mean_reflection(f0: f32, roughness: f32) -> f32 {
    static TABLE: LazyLock<Table<2, 1>> = LazyLock::new(|| {
        Table::new([26, 32], |[f0, roughness]| {
            const N: usize = 32;
            let cosines = (0..N).map(|i| (i as f32 + 0.5) / N as f32);
            [cosines.map(|c| 2.0 * c * with_gain(f0, c, roughness)).sum::<f32>() / N as f32]
        })
    });
    TABLE.at([f0, roughness])[0]
}

/// How much more facets of mean reflectance `f` give than their single scattering, of which a white mirror has
/// `all`: light that meets a facet again is dimmed each time (the series of Kulla and Conty 2017).
pub fn again(f: f32, all: f32, roughness: f32) -> f32 {
    static MEAN: LazyLock<Table<1, 1>> = LazyLock::new(|| {
        Table::new([32], |[roughness]| {
            const N: usize = 32;
            let cosines = (0..N).map(|i| (i as f32 + 0.5) / N as f32);
            let all = |c: f32| reflection(c, roughness).iter().sum::<f32>();
            [cosines.map(|c| 2.0 * c * all(c)).sum::<f32>() / N as f32]
        })
    });
    let mean = MEAN.at([roughness])[0];
    1.0 + (1.0 - all) / all * (f * mean / (1.0 - f * (1.0 - mean)))
}

/// Albedo of an interface with f90 = 1, what is lost between facets given back.
pub fn with_gain(f0: f32, cosine: f32, roughness: f32) -> f32 {
    let [a, b] = reflection(cosine, roughness);
    let all = (a + b).clamp(1e-3, 1.0);
    ((f0 * a + b) * again(average(f0), all, roughness)).min(1.0)
}

/// Mean of Schlick's reflectance over the hemisphere.
pub fn average(f0: f32) -> f32 {
    f0 + (1.0 - f0) / 21.0
}

/// What of the light a single rough interface between two indices reflects and lets through:
/// `[reflected, transmitted]`, for a viewer on the side whose index is 1 where the other's is `eta`.
pub fn interface(cosine: f32, roughness: f32, eta: f32) -> [f32; 2] {
    static TABLE: LazyLock<[Table<3, 2>; 2]> = LazyLock::new(|| {
        [false, true].map(|inside| {
            Table::new([24, 12, 8], |[place, roughness, x]| {
                // From no step to an index of 3.
                let eta = (1.0 + 0.5 * x) / (1.0 - 0.5 * x);
                let eta = glass::steep(if inside { 1.0 / eta } else { eta });
                let (ggx, out) = (Ggx::round(roughness), viewer(place));
                mean(1024, |point| glass::split(&ggx, out, eta, point))
            })
        })
    });
    let outer = eta.max(1.0 / eta);
    let x = 2.0 * (outer - 1.0) / (outer + 1.0);
    TABLE[usize::from(eta < 1.0)].at([place(cosine), roughness, x])
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
