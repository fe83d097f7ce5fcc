//! How a surface scatters light: a diffuse lobe under a GGX lobe.
//!
//! Metallic-roughness as in the glTF 2.0 specification, appendix B. The lobes are two separate
//! integrands, each sampled on its own and weighed against light samples on its own, because the scene
//! may be visible to one and transparent to the other.

use std::f32::consts::{FRAC_1_PI, PI};
use std::sync::LazyLock;

use glam::Vec3;

use crate::color::luminance;
use crate::sampling::{Points, circle};

/// Smallest GGX width; smoother surfaces than this cannot be told apart in f32.
const ALPHA_MIN: f32 = 1e-4;

/// A lobe of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lobe {
    /// Light that entered the surface and left in any direction.
    Diffuse,
    /// Light reflected at the surface.
    Specular,
}

/// What one lobe does for a pair of directions.
#[derive(Debug, Clone, Copy, Default)]
pub struct Scatter {
    /// Value times the cosine of the incident direction.
    pub value: Vec3,
    /// Density of sampling this incident direction by this lobe, choice of lobe included.
    pub pdf: f32,
}

/// A surface point seen from a direction.
#[derive(Debug, Clone, Copy)]
pub struct Bsdf {
    frame: [Vec3; 3],
    geometric: Vec3,
    /// Outgoing direction in the frame.
    out: Vec3,
    diffuse: Vec3,
    f0: Vec3,
    f90: f32,
    alpha: f32,
    /// Multiple-scattering gain of the specular lobe.
    gain: Vec3,
    /// (1 - albedo of the dielectric interface towards the viewer) / (1 - its mean).
    coupling: f32,
    interface: Interface,
    specular_share: f32,
}

/// Albedo of the dielectric interface of one material and roughness.
#[derive(Debug, Clone, Copy)]
struct Interface {
    f0: f32,
    f90: f32,
    roughness: f32,
}

impl Interface {
    fn albedo(&self, cosine: f32) -> f32 {
        if self.f90 == 0.0 {
            return 0.0;
        }
        let [a, b] = Albedo::get().at(cosine, self.roughness);
        let all = (a + b).max(1e-3);
        ((self.f0 * a + self.f90 * b) * (1.0 + self.f0 * (1.0 - all) / all)).min(1.0)
    }
}

/// Parameters of a surface point, textures already looked up.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    /// Linear base colour.
    pub base: Vec3,
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Reflectance of the dielectric at normal incidence; 0 means no interface at all.
    pub f0: f32,
}

/// An orthonormal frame around a unit vector (Duff et al. 2017).
fn frame(n: Vec3) -> [Vec3; 3] {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    [
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
        n,
    ]
}

impl Bsdf {
    /// A matte surface of the given albedo. `normal` is the geometric normal on the side of `out`.
    pub fn diffuse(normal: Vec3, out: Vec3, albedo: Vec3) -> Self {
        Self::new(normal, normal, out, Look { base: albedo, metallic: 0.0, roughness: 1.0, f0: 0.0 })
    }

    /// A surface with shading normal `normal`. Both normals lie on the side of `out`.
    pub fn new(normal: Vec3, geometric: Vec3, out: Vec3, look: Look) -> Self {
        let frame = frame(normal);
        let local = Vec3::new(out.dot(frame[0]), out.dot(frame[1]), out.dot(frame[2]).max(1e-4));
        let roughness = look.roughness.clamp(0.0, 1.0);
        let f90 = if look.f0 > 0.0 { 1.0 } else { 0.0 };
        let interface = Interface { f0: look.f0, f90, roughness };
        let f0 = Vec3::splat(look.f0).lerp(look.base, look.metallic);
        // A metal always reflects fully at grazing angles; a dielectric only where it has an interface.
        let f90 = f90 + (1.0 - f90) * look.metallic;
        let diffuse = look.base * (1.0 - look.metallic);
        let specular = f90 > 0.0 || f0 != Vec3::ZERO;
        let (mut gain, mut albedo) = (Vec3::ONE, Vec3::ZERO);
        if specular {
            let [a, b] = Albedo::get().at(local.z, roughness);
            let all = (a + b).clamp(1e-3, 1.0);
            // The gain of the mix is such that its albedo is the mix of the two albedos.
            let lost = (1.0 - all) / all;
            let (m, metal) = (look.metallic, look.base);
            let dielectric = (look.f0 * a + interface.f90 * b) * (1.0 + look.f0 * lost);
            albedo = Vec3::splat((1.0 - m) * dielectric)
                + (metal * a + Vec3::splat(b)) * (Vec3::ONE + metal * lost) * m;
            gain = albedo / (f0 * a + Vec3::splat(f90 * b)).max(Vec3::splat(1e-6));
        }
        let below = 1.0 - interface.albedo(local.z);
        let coupling = if interface.f90 > 0.0 {
            below / (1.0 - Albedo::get().mean(look.f0, roughness)).max(1e-3)
        } else {
            1.0
        };
        let (s, d) = (luminance(albedo.to_array()), luminance((diffuse * below).to_array()));
        let specular_share = match (s > 0.0, d > 0.0) {
            (false, _) => 0.0,
            (true, false) => 1.0,
            (true, true) => (s / (s + d)).clamp(0.1, 0.9),
        };
        Self {
            frame,
            geometric,
            out: local.normalize(),
            diffuse,
            f0,
            f90,
            alpha: (roughness * roughness).max(ALPHA_MIN),
            gain,
            coupling,
            interface,
            specular_share,
        }
    }

    fn local(&self, direction: Vec3) -> Vec3 {
        Vec3::new(direction.dot(self.frame[0]), direction.dot(self.frame[1]), direction.dot(self.frame[2]))
    }

    /// Both lobes (diffuse, specular) for light from the unit direction `incident`.
    pub fn eval(&self, incident: Vec3) -> [Scatter; 2] {
        let i = self.local(incident);
        if i.z <= 0.0 || incident.dot(self.geometric) <= 0.0 {
            return [Scatter::default(); 2];
        }
        let mut lobes = [Scatter::default(); 2];
        if self.specular_share < 1.0 {
            let coupling = self.coupling * (1.0 - self.interface.albedo(i.z));
            lobes[0] = Scatter {
                value: self.diffuse * (FRAC_1_PI * i.z * coupling),
                pdf: (1.0 - self.specular_share) * FRAC_1_PI * i.z,
            };
        }
        if self.specular_share > 0.0 {
            let half = (i + self.out).normalize_or_zero();
            let d = ggx(half, self.alpha);
            let (lo, li) = (smith(self.out.z, self.alpha), smith(i.z, self.alpha));
            let c = 1.0 - self.out.dot(half).clamp(0.0, 1.0);
            let c5 = (c * c) * (c * c) * c;
            let fresnel = self.f0 * (1.0 - c5) + Vec3::splat(self.f90 * c5);
            let base = d / (4.0 * self.out.z);
            lobes[1] = Scatter {
                // Height-correlated masking and shadowing, 1 / (1 + lo + li).
                value: fresnel * self.gain * (base / (1.0 + lo + li)),
                pdf: self.specular_share * base / (1.0 + lo),
            };
        }
        lobes
    }

    /// A lobe and an incident direction in proportion to it, with what that lobe does there. None when
    /// the direction falls below the surface.
    pub fn sample(&self, points: &Points, pair: u32) -> Option<(Lobe, Vec3, Scatter)> {
        let specular = self.specular_share > 0.0
            && (self.specular_share >= 1.0 || points.pair(pair + 1)[0] < self.specular_share);
        let [u, v] = points.pair(pair);
        let local = if specular {
            let half = visible_normal(self.out, self.alpha, u, v);
            half * (2.0 * self.out.dot(half)) - self.out
        } else {
            let (sin, cos) = circle(u);
            let r = v.sqrt();
            Vec3::new(r * cos, r * sin, (1.0 - v).max(0.0).sqrt())
        };
        let incident = self.frame[0] * local.x + self.frame[1] * local.y + self.frame[2] * local.z;
        let incident = incident.normalize_or_zero();
        let lobe = if specular { Lobe::Specular } else { Lobe::Diffuse };
        let scatter = self.eval(incident)[lobe as usize];
        (scatter.pdf > 0.0 && scatter.value.is_finite()).then_some((lobe, incident, scatter))
    }
}

/// GGX density of half vectors in the frame (Walter et al. 2007), from the tangent components so that it
/// stays exact near the pole.
fn ggx(half: Vec3, alpha: f32) -> f32 {
    let tangent = (half.x * half.x + half.y * half.y) / (alpha * alpha);
    let d = tangent + half.z * half.z;
    1.0 / (PI * alpha * alpha * d * d)
}

/// Smith's auxiliary function of GGX.
fn smith(cosine: f32, alpha: f32) -> f32 {
    let c2 = cosine * cosine;
    0.5 * ((1.0 + alpha * alpha * ((1.0 - c2).max(0.0) / c2)).sqrt() - 1.0)
}

/// A half vector in proportion to what is visible from `out` (Dupuy and Benyoub 2023, Sampling visible
/// GGX normals with spherical caps).
fn visible_normal(out: Vec3, alpha: f32, u: f32, v: f32) -> Vec3 {
    let stretched = Vec3::new(out.x * alpha, out.y * alpha, out.z).normalize();
    let (sin, cos) = circle(u);
    let z = (1.0 - v) * (1.0 + stretched.z) - stretched.z;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let half = Vec3::new(r * cos, r * sin, z) + stretched;
    Vec3::new(half.x * alpha, half.y * alpha, half.z.max(0.0)).normalize_or(Vec3::Z)
}

/// Directional albedo of the GGX lobe: reflectance is `f0 * a + f90 * b` before multiple scattering. What
/// is missing to 1 at f0 = f90 = 1 was scattered more than once and is given back by a gain (Turquin
/// 2019, Practical multiple scattering compensation for microfacet models).
struct Albedo {
    table: Vec<[f32; 2]>,
}

const STEPS: usize = 32;

impl Albedo {
    fn get() -> &'static Self {
        static TABLE: LazyLock<Albedo> = LazyLock::new(Albedo::compute);
        &TABLE
    }

    fn compute() -> Self {
        let mut table = Vec::with_capacity(STEPS * STEPS);
        for row in 0..STEPS {
            let roughness = row as f32 / (STEPS - 1) as f32;
            let alpha = (roughness * roughness).max(ALPHA_MIN);
            for column in 0..STEPS {
                let z = (column as f32 / (STEPS - 1) as f32).max(2e-3);
                let out = Vec3::new((1.0 - z * z).max(0.0).sqrt(), 0.0, z);
                let (mut a, mut b) = (0.0_f64, 0.0_f64);
                const N: u32 = 256;
                for i in 0..N {
                    let [u, v] = Points::new(1, i).pair(0);
                    let half = visible_normal(out, alpha, u, v);
                    let i = half * (2.0 * out.dot(half)) - out;
                    if i.z <= 0.0 {
                        continue;
                    }
                    let (lo, li) = (smith(out.z, alpha), smith(i.z, alpha));
                    let weight = f64::from((1.0 + lo) / (1.0 + lo + li));
                    let c = f64::from(1.0 - out.dot(half).clamp(0.0, 1.0));
                    let c5 = c * c * c * c * c;
                    a += weight * (1.0 - c5);
                    b += weight * c5;
                }
                table.push([(a / f64::from(N)) as f32, (b / f64::from(N)) as f32]);
            }
        }
        Self { table }
    }

    /// (a, b), bilinear in the cosine and the roughness.
    fn at(&self, cosine: f32, roughness: f32) -> [f32; 2] {
        let scale = (STEPS - 1) as f32;
        let (x, y) = (cosine.clamp(0.0, 1.0) * scale, roughness.clamp(0.0, 1.0) * scale);
        let (i, j) = ((x as usize).min(STEPS - 2), (y as usize).min(STEPS - 2));
        let (u, v) = (x - i as f32, y - j as f32);
        let at = |i: usize, j: usize, k: usize| self.table[j * STEPS + i][k];
        std::array::from_fn(|k| {
            let low = at(i, j, k) * (1.0 - u) + at(i + 1, j, k) * u;
            let high = at(i, j + 1, k) * (1.0 - u) + at(i + 1, j + 1, k) * u;
            low * (1.0 - v) + high * v
        })
    }

    /// Mean over the hemisphere of the albedo of a dielectric interface, bilinear in a table.
    fn mean(&self, f0: f32, roughness: f32) -> f32 {
        static MEANS: LazyLock<Vec<f32>> = LazyLock::new(|| {
            let at = |i: usize, steps: usize| i as f32 / (steps - 1) as f32;
            let cell = |i: usize| mean_albedo(at(i % MEAN_STEPS, MEAN_STEPS), at(i / MEAN_STEPS, STEPS));
            (0..MEAN_STEPS * STEPS).map(cell).collect()
        });
        let (x, y) = (f0 * (MEAN_STEPS - 1) as f32, roughness * (STEPS - 1) as f32);
        let (i, j) = ((x as usize).min(MEAN_STEPS - 2), (y as usize).min(STEPS - 2));
        let (u, v) = (x - i as f32, y - j as f32);
        let at = |i: usize, j: usize| MEANS[j * MEAN_STEPS + i];
        let low = at(i, j) * (1.0 - u) + at(i + 1, j) * u;
        let high = at(i, j + 1) * (1.0 - u) + at(i + 1, j + 1) * u;
        low * (1.0 - v) + high * v
    }
}

const MEAN_STEPS: usize = 26;

/// 2 * integral of E(c) c dc over the hemisphere, by the midpoint rule.
fn mean_albedo(f0: f32, roughness: f32) -> f32 {
    const N: usize = 32;
    let interface = Interface { f0, f90: 1.0, roughness };
    let sum: f32 = (0..N)
        .map(|i| {
            let c = (i as f32 + 0.5) / N as f32;
            2.0 * c * interface.albedo(c)
        })
        .sum();
    sum / N as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::stream;

    fn look(base: f32, metallic: f32, roughness: f32, f0: f32) -> Look {
        Look { base: Vec3::splat(base), metallic, roughness, f0 }
    }

    fn towards(cosine: f32) -> Vec3 {
        Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
    }

    /// Reflected share of a uniform white environment, by the sampler.
    fn furnace(look: Look, cosine: f32) -> f64 {
        let bsdf = Bsdf::new(Vec3::Z, Vec3::Z, towards(cosine), look);
        let n = 16_384;
        let mut sum = 0.0;
        for i in 0..n {
            if let Some((_, _, s)) = bsdf.sample(&Points::new(stream(2, 0, 0), i), 0) {
                sum += f64::from(s.value.y / s.pdf);
            }
        }
        sum / f64::from(n)
    }

    // Row 38: white furnace for each roughness. The bound of 1.5 % is the interpolation of a 32 x 32 table;
    // at grazing angles of smooth metal the table is coarsest.
    #[test]
    fn white_surfaces_keep_all_light() {
        for roughness in [0.0, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0] {
            for cosine in [0.1, 0.3, 0.6, 1.0] {
                let metal = furnace(look(1.0, 1.0, roughness, 0.04), cosine);
                let plastic = furnace(look(1.0, 0.0, roughness, 0.04), cosine);
                let half = furnace(look(1.0, 0.5, roughness, 0.04), cosine);
                assert!((metal - 1.0).abs() < 0.015, "metal {roughness} {cosine}: {metal}");
                assert!((plastic - 1.0).abs() < 0.015, "plastic {roughness} {cosine}: {plastic}");
                assert!((half - 1.0).abs() < 0.015, "half metal {roughness} {cosine}: {half}");
            }
        }
        assert!((furnace(look(1.0, 0.0, 1.0, 0.0), 0.4) - 1.0).abs() < 1e-5, "Lambert is exact");
    }

    // Row 39.
    #[test]
    fn black_surfaces_reflect_only_the_interface() {
        assert_eq!(furnace(look(0.0, 0.0, 0.5, 0.0), 0.5), 0.0);
        assert!(furnace(look(0.0, 0.0, 0.5, 0.04), 1.0) < 0.06);
    }

    // Row 40: extremes stay finite and no sample carries more than its lobe's albedo over its share.
    #[test]
    fn extremes_are_finite() {
        for roughness in [0.0, 1e-4, 1e-2, 1.0] {
            for cosine in [1.745e-4, 1e-2, 1.0] {
                for (metallic, f0) in [(0.0, 0.0), (0.0, 0.04), (1.0, 0.04), (0.5, 1.0)] {
                    let bsdf =
                        Bsdf::new(Vec3::Z, Vec3::Z, towards(cosine), look(0.8, metallic, roughness, f0));
                    for i in 0..500 {
                        let Some((_, direction, s)) = bsdf.sample(&Points::new(7, i), 0) else { continue };
                        assert!((direction.length() - 1.0).abs() < 1e-4);
                        assert!((s.value / s.pdf).max_element() < 12.0, "{roughness} {cosine} {s:?}");
                    }
                }
            }
        }
    }

    // Chi-square of each lobe's sampler against its density, by bins of equal solid angle.
    #[test]
    fn samplers_follow_their_densities() {
        for (roughness, metallic, cosine) in
            [(0.4, 1.0, 0.7), (0.7, 1.0, 0.2), (1.0, 0.0, 0.5), (0.6, 0.0, 0.9)]
        {
            let bsdf = Bsdf::new(Vec3::Z, Vec3::Z, towards(cosine), look(0.6, metallic, roughness, 0.04));
            const Z: usize = 10;
            const P: usize = 16;
            let bin = |d: Vec3| {
                let turns = crate::num::atan2(f64::from(d.y), f64::from(d.x)) / (2.0 * std::f64::consts::PI);
                let p = ((turns + 0.5) * P as f64) as usize;
                ((d.z * Z as f32) as usize).min(Z - 1) * P + p.min(P - 1)
            };
            let n = 100_000;
            let mut counts = [vec![0.0_f64; Z * P], vec![0.0; Z * P]];
            for i in 0..n {
                if let Some((lobe, d, _)) = bsdf.sample(&Points::new(stream(3, i, 0), 0), 0) {
                    counts[lobe as usize][bin(d)] += 1.0;
                }
            }
            let mut expected = [vec![0.0_f64; Z * P], vec![0.0; Z * P]];
            const FINE: usize = 24;
            for z in 0..Z * FINE {
                for p in 0..P * FINE {
                    let c = (z as f32 + 0.5) / (Z * FINE) as f32;
                    let (sin, cos) = circle((p as f32 + 0.5) / (P * FINE) as f32);
                    let r = (1.0 - c * c).sqrt();
                    let d = Vec3::new(r * cos, r * sin, c);
                    let area = 2.0 * std::f64::consts::PI / (Z * FINE * P * FINE) as f64;
                    for (sum, s) in expected.iter_mut().zip(bsdf.eval(d)) {
                        sum[bin(d)] += f64::from(n) * f64::from(s.pdf) * area;
                    }
                }
            }
            for (counts, expected) in counts.iter().zip(&expected) {
                let (mut chi2, mut bins) = (0.0, 0.0);
                for (count, expected) in counts.iter().zip(expected) {
                    if *expected > 20.0 {
                        chi2 += (count - expected) * (count - expected) / expected;
                        bins += 1.0;
                    }
                }
                let bound = bins + 4.5 * f64::sqrt(2.0 * bins) + 1.0;
                assert!(chi2 < bound, "{roughness} {metallic}: {chi2} over {bins} bins");
            }
        }
    }

    // The diffuse lobe and the bare specular one are symmetric; only the energy gain is not.
    #[test]
    fn lobes_are_reciprocal() {
        let (a, b) = (towards(0.3), Vec3::new(-0.48, 0.6, 0.64));
        let value = |o: Vec3, i: Vec3| {
            let bsdf = Bsdf::new(Vec3::Z, Vec3::Z, o, look(0.7, 0.0, 0.4, 0.04));
            let lobes = bsdf.eval(i);
            [lobes[0].value.x / i.z, lobes[1].value.x / bsdf.gain.x / i.z]
        };
        for (x, y) in value(a, b).into_iter().zip(value(b, a)) {
            assert!((x / y - 1.0).abs() < 1e-3, "{x} {y}");
        }
    }
}
