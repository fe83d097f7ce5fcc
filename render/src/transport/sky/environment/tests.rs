use engine::Up;

use super::*;
use crate::geometry::sampling::{Points, stream};
use crate::transport::sky::defensive::{DefensiveSampling, NearLights};
use crate::transport::sky::light_draws::wanted;
use scene::math::equirect;
use testing::{chi_square, row};

/// Light samples of a first vertex.
fn sampled(
    sky: &EnvironmentLight,
    distributions: Distributions<'_>,
    lights: [u32; TIERS],
    points: Points,
) -> Vec<LightSample> {
    let all: Vec<_> = wanted(distributions, lights, points, 0).collect();
    let mut found = Vec::new();
    sky.draw_each(&all, |drawn| found.push(sky.light(&drawn)));
    found
}

fn noisy(width: usize, height: usize) -> Environment {
    let mut environment = Environment::constant(Up::PlusY, [0.0; 3], 2);
    let samples = (0..width * height * 3)
        .map(|i| crate::geometry::sampling::unit(crate::geometry::sampling::mix(i as u32)).powi_exact())
        .collect();
    environment.image = scene::types::Image::from_samples(width, height, 3, samples).into();
    environment
}

trait PowiExact {
    fn powi_exact(self) -> f32;
}
impl PowiExact for f32 {
    // A peaked distribution, computed without the power function, which is not allowed here.
    fn powi_exact(self) -> f32 {
        let s = self * self;
        s * s * s * 20.0
    }
}

#[test]
fn lookup_agrees_with_the_layout() {
    for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
        for (width, height) in [(64, 32), (200, 77), (8, 3), (1, 1), (5, 4)] {
            let mut environment = noisy(width, height);
            environment.up = up;
            let sky = EnvironmentLight::new(&environment);
            for i in 0..4_000_u32 {
                let [u, v] = Points::new(1, i).pair(0).map(f64::from);
                let direction = equirect::direction(up, u, v).as_vec3();
                let (u, v) = equirect::uv(up, direction.as_dvec3());
                let x = ((u * width as f64) as usize).min(width - 1);
                let y = ((v * height as f64) as usize).min(height - 1);
                let found = sky.radiance(direction);
                let near_edge = |a: f64| (a - a.round()).abs() < 1e-3;
                if !near_edge(u * width as f64) && !near_edge(v * height as f64) {
                    assert_eq!(found.to_array(), environment.image.rgb(x, y), "{u} {v}");
                }
            }
        }
    }
}

#[test]
fn samples_lie_in_the_texel_they_claim() {
    let sky = EnvironmentLight::new(&noisy(128, 64));
    let mut elsewhere = 0;
    for i in 0..20_000 {
        let s = sky.sample_one(Some(Vec3::Y), Points::new(stream(3, 0, 0), i).bits(0)).expect("light");
        assert!((s.direction.length() - 1.0).abs() < 1e-5);
        elsewhere += u32::from(sky.eval_one(Some(Vec3::Y), s.direction) != s);
    }
    assert!(elsewhere < 40, "{elsewhere} of 20000 fall across an edge by rounding");
}

// Compares the mean of radiance times cosine over density with the exact irradiance, which is a sum over subdivided
// texels.
#[test]
fn sampling_integrates_the_picture() {
    for (width, height) in [(64, 32), (128, 40), (7, 3), (1, 1)] {
        let environment = noisy(width, height);
        let sky = EnvironmentLight::new(&environment);
        // Each channel is weighted as in the density of the samples.
        let weight = |rgb: [f32; 3]| (0..3).map(|k| f64::from(rgb[k]) / sky.power[k].max(1e-30)).sum::<f64>();
        for normal in [Vec3::Y, Vec3::new(0.6, -0.48, 0.64), Vec3::NEG_Z] {
            let (mut exact, sub) = (0.0, 512 / width);
            for y in 0..height * sub {
                let area = pixel_solid_angle(width * sub, height * sub, y);
                for x in 0..width * sub {
                    let (u, v) =
                        ((x as f64 + 0.5) / (width * sub) as f64, (y as f64 + 0.5) / (height * sub) as f64);
                    let cosine = equirect::direction(Up::PlusY, u, v).dot(normal.as_dvec3()).max(0.0);
                    exact += weight(environment.image.rgb(x / sub, y / sub)) * cosine * area;
                }
            }
            let (n, distributions) = (1 << 14, sky.distributions(Some(normal)));
            let mut sum = 0.0;
            for i in 0..n {
                // As at the first vertex of a path, each tier has its own points.
                let points = Points::new(stream(3, 1, 0), i);
                for s in sampled(&sky, distributions, sky.lights, points) {
                    let cosine = s.direction.dot(normal).max(0.0);
                    sum += weight(s.radiance.to_array()) * f64::from(cosine / s.pdf);
                }
            }
            let ratio = sum / f64::from(n) / exact;
            let tolerance = if width < 8 { 2e-3 } else { 3e-4 };
            assert!((ratio - 1.0).abs() < tolerance, "{width} {height} {normal}: {ratio}");
        }
    }
}

// At the centre of a texel the background equals the texel. Halfway between two texels it equals their mean.
#[test]
fn the_picture_behind_is_smooth() {
    let environment = noisy(64, 32);
    let sky = EnvironmentLight::new(&environment);
    for (x, y) in [(3, 4), (63, 16), (0, 31)] {
        let seen = |dx: f64| {
            let (u, v) = ((x as f64 + 0.5 + dx) / 64.0, (f64::from(y) + 0.5) / 32.0);
            sky.background(equirect::direction(Up::PlusY, u, v).as_vec3())
        };
        let texel = |x: usize| Vec3::from_array(environment.image.rgb(x % 64, y as usize));
        assert!((seen(0.0) - texel(x)).length() < 1e-2, "{x} {y}");
        assert!((seen(0.5) - (texel(x) + texel(x + 1)) * 0.5).length() < 1e-2, "{x} {y}");
    }
}

#[test]
fn a_black_sky_is_sampled_evenly() {
    let black = EnvironmentLight::new(&Environment::constant(Up::PlusZ, [0.0; 3], 16));
    assert_eq!(black.power, [0.0; 3]);
    for normal in [None, Some(Vec3::X), Some(Vec3::NEG_Z)] {
        for i in 0..64 {
            let s = black.sample_one(normal, Points::new(3, i).bits(0)).expect("a direction");
            assert!(s.pdf > 0.0 && s.pdf.is_finite() && s.radiance == Vec3::ZERO, "{s:?}");
            assert!((s.direction.length() - 1.0).abs() < 1e-5);
        }
    }
}

/// A surface that faces the bright texel samples it, and a surface that faces away never does. The density
/// integrates to 1 for both surfaces.
#[test]
fn one_texel_may_outshine_all_others() {
    let mut environment = Environment::constant(Up::PlusZ, [1e-9; 3], 32);
    environment.image.pixel_mut(7, 5).fill(1e9);
    environment.image.pixel_mut(3, 3)[0] = f32::NAN;
    let sky = EnvironmentLight::new(&environment);
    assert_eq!(sky.broken, 1);
    let at = |x: f64, y: f64| equirect::direction(Up::PlusZ, x / 32.0, y / 16.0);
    let hot = at(7.5, 5.5).as_vec3();
    let mut off = 0.0_f64;
    for normal in [hot, -hot] {
        let pdf =
            |x: usize, y: usize| sky.eval_one(Some(normal), at(x as f64 + 0.5, y as f64 + 0.5).as_vec3()).pdf;
        let total: f64 = (0..16)
            .flat_map(|y| (0..32).map(move |x| (x, y)))
            .map(|(x, y)| f64::from(pdf(x, y)) * pixel_solid_angle(32, 16, y))
            .sum();
        off = off.max((total - 1.0).abs());
    }
    row(37, "integral of the density over the sphere, less 1", off, 1e-6);
    let hottest = |normal| sky.sample_one(Some(normal), [1 << 31, 1 << 31]).expect("light").radiance.x == 1e9;
    assert!(hottest(hot) && !hottest(-hot));
    // Irradiance of a surface that faces it: its subdivided texel, against samples of a first vertex.
    let fine = 64;
    let cosines = (0..fine * fine).map(|i| {
        let [u, v] = [i % fine, i / fine].map(|k| (f64::from(k) + 0.5) / f64::from(fine));
        at(7.0 + u, 5.0 + v).dot(hot.as_dvec3())
    });
    let mean = cosines.sum::<f64>() / f64::from(fine * fine);
    let (distributions, n) = (sky.distributions(Some(hot)), 1 << 12);
    let arrived = |i| {
        let found = sampled(&sky, distributions, [sky.lights[0], 0], Points::new(5, i));
        found.into_iter().map(|s| f64::from(s.radiance.x * s.direction.dot(hot) / s.pdf)).sum::<f64>()
    };
    let got = (0..n).map(arrived).sum::<f64>() / f64::from(n);
    let exact = 1e9 * pixel_solid_angle(32, 16, 5) * mean;
    row(37, "relative error of the irradiance of 4096 points", (got / exact - 1.0).abs(), 1e-4);
}

/// Chi-square test of samples against the density that they report, by quarters of texels.
fn follows(
    what: &str,
    sky: &EnvironmentLight,
    draw: impl Fn(u32) -> Vec<LightSample>,
    pdf: impl Fn(Vec3) -> f32,
) {
    let (n, [width, height]) = (100_000, [sky.texel_grid.width, sky.texel_grid.height].map(|k| 2 * k));
    let place = |bin: usize| [(bin % width) as f64 + 0.5, (bin / width) as f64 + 0.5];
    let towards = |bin: usize| {
        let [x, y] = place(bin);
        equirect::direction(Up::PlusY, x / width as f64, y / height as f64).as_vec3()
    };
    let mut counts = vec![0.0; width * height];
    for sample in (0..n).flat_map(draw) {
        let (u, v) = equirect::uv(Up::PlusY, sample.direction.as_dvec3());
        let [x, y] = [(u, width), (v, height)].map(|(at, size)| ((at * size as f64) as usize).min(size - 1));
        counts[y * width + x] += 1.0;
        let reported = pdf(sample.direction);
        // Rounding may move a direction across an edge.
        let same = (sample.pdf - reported).abs() <= 1e-3 * reported;
        assert!(
            same || sky.radiance(sample.direction) != sample.radiance,
            "{what}: {sample:?} for {reported}"
        );
    }
    let density = |bin| f64::from(n) * f64::from(pdf(towards(bin)));
    let expected: Vec<f64> =
        (0..counts.len()).map(|bin| density(bin) * pixel_solid_angle(width, height, bin / width)).collect();
    let all = expected.iter().sum::<f64>() / counts.iter().sum::<f64>();
    assert!((all - 1.0).abs() < 1e-3, "{what}: the density integrates to {all}");
    let z = chi_square(&counts, &expected);
    assert!(z < 4.0, "{what}: {z}");
}

/// Samples follow their densities in every step: tiers, cells, texels and points in texels. This test fails if
/// `numbers[tier]` is left out of `EnvironmentLight::eval`, if the share of the row is squared in
/// `LightDistribution::probability`, if `of_row` is left out of `LightCells::divide`, if `v` is squared in
/// `TexelGrid::within`, or if `0.75` and `0.25` are swapped in `DefensiveSampling::light`.
#[test]
fn samples_follow_their_densities() {
    let mut lamps = noisy(24, 12);
    for (x, y) in [(3, 2), (4, 2), (17, 9)] {
        lamps.image.pixel_mut(x, y).copy_from_slice(&[900.0, 300.0, 700.0]);
    }
    let point = |i: u32, pair: u32| Points::new(stream(5, i, 1), 0).bits(pair);
    let normal = Vec3::new(0.48, 0.64, -0.6);
    for (name, environment) in [("noise", noisy(80, 20)), ("lamps", lamps), ("one texel", noisy(1, 1))] {
        let sky = &EnvironmentLight::new(&environment);
        for side in [None, Some(normal)] {
            let what = format!("{name}, {side:?}");
            let one = |i| sky.sample_one(side, point(i, 0)).into_iter().collect();
            follows(&what, sky, one, |d| sky.eval_one(side, d).pdf);
            // A sky without bright texels, or with nothing else, has no samples in the other tier.
            for lights in [NearLights::One, NearLights::Tiers([1, 2]), NearLights::Tiers(sky.near_lights)] {
                let (defensive, count) = (DefensiveSampling::new(sky, side, lights), lights.count());
                let light = |d| {
                    let light = defensive.light(d, &sky.texel(d));
                    LightSample { pdf: count as f32 * light.pdf, ..light }
                };
                let each = |i| {
                    let points = Points::new(stream(5, i, 1), 0);
                    let wanted =
                        |number| defensive.choose(sky, number, lights.points(&points, number).bits(0));
                    let wanted: Vec<_> = (0..count).filter_map(wanted).collect();
                    let mut found = Vec::new();
                    sky.draw_placed(&wanted, |drawn| found.push(light(drawn.direction)));
                    found
                };
                follows(&format!("{what}, defensive, {lights:?}"), sky, each, |d| light(d).pdf);
            }
        }
        // As at the first vertex of a path: several samples per tier, for the normals of a tile and the directions
        // of the objects.
        let normals = Cone { axis: normal, cosine: 0.995 };
        for to in [Cone::ALL, Cone { axis: normal, cosine: 0.3 }] {
            let distributions = sky.distributions_within(Some(normals), &to);
            let distributions = distributions.each_ref();
            // A tier without light there is not sampled.
            let lights = [0, 1].map(|k| if distributions[k].power > 0.0 { sky.lights[k] } else { 0 });
            let numbers = sky.numbers(distributions, Some(lights));
            let several = |i| sampled(sky, distributions, lights, Points::new(stream(5, i, 2), 0));
            let what = format!("{name}, several within {}", to.cosine);
            follows(&what, sky, several, |d| sky.eval(distributions, numbers, d).pdf);
        }
    }
}
