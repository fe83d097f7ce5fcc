//! Iridescence: interference in a thin film (Belcour and Barla 2017, A practical extension to microfacet theory for
//! the modeling of varying iridescence), as specified by KHR_materials_iridescence.

use std::f32::consts::PI;

use glam::Vec3;
use scene::math::num::f32::{cos, exp};

use super::dielectric::{cos_refracted, f0_of_ior as from_index};
use super::ggx::schlick;

/// Fourier transforms of the CIE colour matching functions, in SI units. Each row is a Gaussian, given by its
/// height, position and variance. X is approximated by the sum of the first and the last row, Y by the second and Z
/// by the third.
const SENSITIVITY: [[f32; 3]; 4] = [
    [5.4856e-13, 1.6810e6, 4.3278e9],
    [4.4201e-13, 1.7953e6, 9.3046e9],
    [5.2481e-13, 2.2084e6, 6.6121e9],
    [9.7470e-14, 2.2399e6, 4.5282e9],
];
/// Divisor of the sensitivities, chosen so that the colour without a film is white.
const WHITE: f32 = 1.0685e-7;

fn each(v: Vec3, f: impl Fn(f32) -> f32) -> Vec3 {
    Vec3::from_array(v.to_array().map(f))
}

/// Colour of the interference for the optical path difference `path` in metres, with a phase shift per channel.
fn wave(path: f32, shift: Vec3) -> Vec3 {
    let phase = 2.0 * PI * path;
    let at = |[height, place, spread]: [f32; 3], shift: f32| {
        height * (2.0 * PI * spread).sqrt() * cos(place * phase + shift) * exp(-phase * phase * spread)
    };
    let [x, y, z, x2] = SENSITIVITY;
    let xyz = [at(x, shift.x) + at(x2, shift.x), at(y, shift.y), at(z, shift.z)].map(|v| v / WHITE);
    // CIE XYZ to linear Rec. 709.
    Vec3::new(3.240_454_2, -0.969_266, 0.055_643_4) * xyz[0]
        + Vec3::new(-1.537_138_5, 1.876_010_8, -0.204_025_9) * xyz[1]
        + Vec3::new(-0.498_531_4, 0.041_556, 1.057_225_2) * xyz[2]
}

/// Computes the reflectance at normal incidence of a plain surface that can replace a thin film on a base of
/// reflectance `f0`. If the result is raised towards 1 by the share `risen`, it equals the reflectance of the film
/// at the given cosine.
pub fn f0(index: f32, thickness_nm: f32, f0: Vec3, cosine: f32, risen: f32) -> Vec3 {
    // A film thinner than an atom has no effect.
    let fade = (thickness_nm / 0.03).min(1.0);
    let eta = 1.0 + (index - 1.0) * (fade * fade * (3.0 - 2.0 * fade));
    let Some(inner) = cos_refracted(cosine, eta) else { return Vec3::ONE };
    let f1 = from_index(eta);
    let upper = f1 + (1.0 - f1) * schlick(cosine);
    let passed = 1.0 - upper;
    // The base below the film, with the indices that f0 implies.
    let root = each(f0.clamp(Vec3::ZERO, Vec3::splat(0.9999)), f32::sqrt);
    let base = (Vec3::ONE + root) / (Vec3::ONE - root);
    let f2 = each(base, |b| from_index(b / eta));
    let lower = f2 + (Vec3::ONE - f2) * schlick(inner);
    // Each reflection at a denser medium shifts the phase by half a wave. One of them is at the upper interface,
    // seen from inside the film.
    let shift = each(base, |b| if b < eta { 2.0 * PI } else { PI });

    // Airy summation over the bounces in the film: its mean and two of its waves.
    let path = 2.0 * eta * (thickness_nm * 1e-9) * inner;
    let both = (lower * upper).clamp(Vec3::splat(1e-5), Vec3::splat(0.9999));
    let steady = lower * (passed * passed) / (Vec3::ONE - both);
    let mut light = Vec3::splat(upper) + steady;
    let mut height = steady - Vec3::splat(passed);
    for order in [1.0, 2.0] {
        height *= each(both, f32::sqrt);
        light += height * wave(order * path, shift * order) * 2.0;
    }
    let risen = risen.min(0.9999);
    ((light - Vec3::splat(risen)) / (1.0 - risen)).clamp(Vec3::ZERO, Vec3::ONE)
}
