//! Reference for the scores of `score-env`. It is computed from texels, whereas the node uses the cells of a grid.

use std::f64::consts::PI;

use engine::Up;
use glam::DVec3;
use scene::math::equirect;
use scene::math::num;
use scene::types::{Cell, Environment, Report};

use super::references::luminance;

/// Direction, solid angle and radiance of a texel.
type Texel = (DVec3, f64, [f64; 3]);

/// Texels of an environment with z up. Each texel is split into `across` columns and `down` rows.
fn texels(environment: &Environment, [across, down]: [usize; 2]) -> Vec<Texel> {
    let (width, height) = (environment.image.width * across, environment.image.height * down);
    let texel = |i: usize| {
        let (x, y) = (i % width, i / width);
        let [top, bottom] = [y, y + 1].map(|y| num::f64::cos(PI * y as f64 / height as f64));
        let [u, v] = [(x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64];
        let size = 2.0 * PI / width as f64 * (top - bottom);
        (
            equirect::direction(Up::PlusZ, u, v),
            size,
            environment.image.rgb(x / across, y / down).map(f64::from),
        )
    };
    (0..width * height).map(texel).collect()
}

fn irradiance(texels: &[Texel], normal: DVec3) -> [f64; 3] {
    let each = |c: usize| texels.iter().map(|(d, size, rgb)| d.dot(normal).max(0.0) * size * rgb[c]).sum();
    [0, 1, 2].map(each)
}

/// Scores in the order of [`reported`], for environments of at most 128 columns. `truth` must not have more columns
/// than `found`.
pub fn scores(found: &Environment, truth: &Environment) -> Vec<f64> {
    // Large texels are cut so that there are at least half as many columns as the program's grid has.
    let fine = |of: &Environment| texels(of, [128 / of.image.width, 64 / of.image.height].map(|n| n.max(1)));
    let [all, all_truth] = [found, truth].map(fine);
    let stops = |a: f64, b: f64| num::f64::log2(a / b);
    // Points of a Fibonacci spiral about up.
    let normal = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / 512.0;
        let (sine, cosine) = num::sin_cos(PI * (1.0 + 5.0_f64.sqrt()) * (i as f64 + 0.5));
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * cosine, radius * sine, z)
    };
    let (mut sums, mut apart, mut square) = ([0.0; 2], 0.0, 0.0);
    for (a, b) in (0..512).map(|i| (irradiance(&all, normal(i)), irradiance(&all_truth, normal(i)))) {
        for (a, b) in a.into_iter().zip(b) {
            sums = [sums[0] + a, sums[1] + b];
            apart += (a - b) * (a - b);
            square += b * b;
        }
    }
    let peak = |of: &[Texel]| of.iter().map(|(_, _, rgb)| luminance(rgb)).fold(0.0, f64::max);
    let mut scores =
        vec![stops(sums[0], sums[1]), (apart / square).sqrt(), stops(peak(&all), peak(&all_truth))];
    for normal in [DVec3::Z, DVec3::NEG_Z, DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y] {
        let [found, want] = [&all, &all_truth].map(|of| luminance(&irradiance(of, normal)));
        scores.push(stops(found, want));
    }
    // Compare each texel of `truth` with the mean of the texels of `found` there.
    let across = found.image.width / truth.image.width;
    let [whole_found, whole_truth] = [found, truth].map(|of| texels(of, [1, 1]));
    let (mut off, mut energies) = (0.0, [0.0; 2]);
    for (i, (_, size, want)) in whole_truth.iter().enumerate() {
        let (x, y) = (i % truth.image.width * across, i / truth.image.width * across);
        let (mut mean, mut whole) = ([0.0; 3], 0.0);
        for (_, part, rgb) in
            (0..across * across).map(|k| &whole_found[(y + k / across) * found.image.width + x + k % across])
        {
            whole += part;
            mean.iter_mut().zip(rgb).for_each(|(sum, v)| *sum += part * v);
        }
        for (mean, want) in mean.into_iter().zip(want) {
            off += (mean / whole - want).abs() * size;
            energies = [energies[0] + mean, energies[1] + want * size];
        }
    }
    scores.extend([off / energies[1], stops(energies[0], energies[1])]);
    for shade in [matte, glossy] {
        scores.push(sphere(shade, &all, &all_truth));
    }
    scores
}

fn matte(texels: &[Texel], normal: DVec3) -> [f64; 3] {
    irradiance(texels, normal).map(|e| e / PI)
}

/// Direction of the light that a mirror with this normal reflects to a viewer who looks along +y.
fn reflected(normal: DVec3) -> DVec3 {
    DVec3::Y - 2.0 * DVec3::Y.dot(normal) * normal
}

fn glossy(texels: &[Texel], normal: DVec3) -> [f64; 3] {
    let lobe = |d: &DVec3| num::pow(d.dot(reflected(normal)).max(0.0), 24.0);
    let whole: f64 = texels.iter().map(|(d, size, _)| lobe(d) * size).sum();
    [0, 1, 2].map(|c| texels.iter().map(|(d, size, rgb)| lobe(d) * size * rgb[c]).sum::<f64>() / whole)
}

/// Renders a sphere, 32 pixels wide and seen along +y, under both lights. Returns the root mean square error over
/// its pixels, relative to the truth.
fn sphere(shade: fn(&[Texel], DVec3) -> [f64; 3], found: &[Texel], truth: &[Texel]) -> f64 {
    let (mut off, mut square) = (0.0, 0.0);
    for i in 0..32 * 32 {
        let [x, z] = [i % 32, 31 - i / 32].map(|k| (f64::from(k) + 0.5) / 16.0 - 1.0);
        if x * x + z * z >= 1.0 {
            continue;
        }
        let normal = DVec3::new(x, -(1.0 - x * x - z * z).sqrt(), z);
        for (a, b) in shade(found, normal).into_iter().zip(shade(truth, normal)) {
            off += (a - b) * (a - b);
            square += b * b;
        }
    }
    (off / square).sqrt()
}

/// Scores from the report, in the order of [`scores`].
pub fn reported(report: &Report) -> Vec<f64> {
    let begins = [
        "mean irradiance",
        "irradiance on all planes, relative RMS",
        "peak luminance",
        "irradiance on a plane that faces up",
        "irradiance on a plane that faces down",
        "irradiance on a plane that faces right",
        "irradiance on a plane that faces left",
        "irradiance on a plane that faces forward",
        "irradiance on a plane that faces back",
        "panorama, mean absolute error",
        "energy over the whole sphere",
        "matte sphere, relative",
        "glossy sphere, relative",
    ];
    let rows = &report.tables[0].rows;
    let value = |begin: &&str| {
        let row = rows.iter().find(|row| matches!(&row[0], Cell::Text(name) if name.starts_with(begin)));
        match row.unwrap()[1] {
            Cell::Number(value) => value,
            ref other => panic!("{begin} is {other:?}"),
        }
    };
    begins.iter().map(value).collect()
}
