//! Tests of the number of columns that an environment needs.

use render::light::env_resolution::EnvResolution;

use super::*;

/// Blue sky over brown ground with a disc of light of the given width in degrees, at an elevation of 40
/// degrees.
fn lit(width: usize, disc_deg: f64) -> Environment {
    let mut environment = Environment::constant(Up::PlusZ, [0.0; 3], width);
    let (sin, cos) = scene::math::num::sin_cos_deg(40.0);
    let towards = DVec3::new(0.5 * cos, 0.75_f64.sqrt() * cos, sin);
    let edge = scene::math::num::sin_cos_deg(disc_deg / 2.0).1;
    for y in 0..width / 2 {
        for x in 0..width {
            let (u, v) = ((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / (width / 2) as f64);
            let direction = equirect::direction(Up::PlusZ, u, v);
            let rgb = match direction {
                d if d.dot(towards) > edge => [120.0, 110.0, 90.0],
                d if d.z > 0.0 => [0.4, 0.5, 0.9],
                _ => [0.2, 0.15, 0.1],
            };
            environment.image.pixel_mut(x, y).copy_from_slice(&rgb);
        }
    }
    environment
}

/// The environment at half the resolution. Each texel is the mean of four.
fn halved(environment: &Environment) -> Environment {
    let (width, height) = (environment.image.width / 2, environment.image.height / 2);
    let mut half = Environment::constant(environment.up, [0.0; 3], width);
    for y in 0..height {
        let sizes = [2 * y, 2 * y + 1].map(|row| equirect::pixel_solid_angle(2 * width, 2 * height, row));
        for x in 0..width {
            for c in 0..3 {
                let at =
                    |i: usize, j: usize| f64::from(environment.image.rgb(2 * x + i, 2 * y + j)[c]) * sizes[j];
                let sum = at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1);
                half.image.pixel_mut(x, y)[c] = (sum / (2.0 * (sizes[0] + sizes[1]))) as f32;
            }
        }
    }
    half
}

fn plastic(roughness: f32) -> Material {
    Material { metallic: 0.0, roughness, ior: 1.5, double_sided: true, ..matte(0.5) }
}

#[test]
fn smooth_surfaces_and_small_lights_ask_for_more() {
    let columns = |disc_deg: f64, material: Material| {
        EnvResolution::of(&lit(512, disc_deg), &[ball(0.3, material, DVec3::ZERO)], 512).columns
    };
    assert_eq!(columns(24.0, matte(0.5)), 128);
    assert_eq!(columns(6.0, matte(0.5)), 512);
    assert_eq!(columns(24.0, plastic(0.7)), 128);
    assert_eq!(columns(24.0, plastic(0.2)), 512);
    assert_eq!(columns(24.0, plastic(0.0)), 512, "a mirror takes what there is");
    let mut spare = Placed::clone(&ball(0.3, plastic(0.7), DVec3::ZERO));
    Arc::make_mut(&mut spare.object).materials.push(plastic(0.0));
    let columns_of = |object| EnvResolution::of(&lit(512, 24.0), &[Arc::new(object)], 512).columns;
    assert_eq!(columns_of(spare), 128, "a mirror that no triangle has takes nothing");
    assert_eq!(
        EnvResolution::of(
            &Environment::constant(Up::PlusZ, [1.0; 3], 512),
            &[ball(0.3, matte(0.5), DVec3::ZERO)],
            512
        )
        .columns,
        64
    );
}

/// A sun with an aureole needs nearly the same resolution as the sun alone, since most of the power is in the sun.
#[test]
fn an_aureole_does_not_widen_the_sun() {
    let columns = |halo: f32| {
        let mut environment = lit(512, 3.0);
        let wide = lit(512, 12.0);
        for (to, from) in environment.image.samples.iter_mut().zip(&wide.image.samples) {
            if *from > 50.0 && *to < 50.0 {
                *to = halo;
            }
        }
        EnvResolution::of(&environment, &[ball(0.3, matte(0.5), DVec3::ZERO)], 512).columns
    };
    assert_eq!([columns(0.4), columns(12.0)], [512, 512]);
    assert_eq!(columns(120.0), 256);
}

/// With a resolution that is reported as sufficient, the shadow changes by less than 1 % and the object by less
/// than 2 % (root mean square).
#[test]
fn what_is_reported_to_suffice_does() {
    let fine = lit(512, 24.0);
    let camera = rig(DVec3::new(0.0, -2.2, 1.6), DVec3::new(0.0, 0.1, 0.2), 32, 1.6);
    for material in [matte(0.5), plastic(0.5)] {
        let objects = [ball(0.3, material, DVec3::new(0.0, 0.0, 0.3))];
        let mut coarse = halved(&fine);
        let enough = EnvResolution::of(&fine, &objects, fine.image.width);
        while coarse.image.width > enough.columns {
            coarse = halved(&coarse);
        }
        assert!(coarse.image.width <= 256, "{enough:?}");
        let seen = |environment: &Environment| {
            let (out, notes) =
                render(&params(64, Surroundings::OPEN), &plane(3.0), &objects, &camera, environment);
            let reported = notes.iter().any(|note| note.id == "finer-than-needed");
            assert_eq!(reported, environment.image.width >= 2 * enough.columns);
            let ratio = samples(&out.with).iter().zip(samples(&out.without)).map(|(a, b)| f64::from(a / b));
            (
                ratio.collect::<Vec<_>>(),
                samples(&out.object).iter().map(|v| f64::from(*v)).collect::<Vec<_>>(),
            )
        };
        let (a, b) = (seen(&fine), seen(&coarse));
        let off = |a: &[f64], b: &[f64]| {
            let square = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            (square / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
        };
        let (shadow, object) = (off(&a.0, &b.0), off(&a.1, &b.1));
        assert!(shadow < 0.01 && object < 0.02, "{enough:?}: {shadow} {object}");
    }
}
