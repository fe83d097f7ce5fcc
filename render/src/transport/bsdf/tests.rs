//! Furnace tests, chi-square tests and reciprocity tests of every lobe.

use super::*;
use crate::geometry::sampling::stream;
use testing::{SphereBins, chi_square, row};

fn towards(cosine: f32) -> Vec3 {
    Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
}

fn surface(params: &BsdfParams, out: Vec3) -> Bsdf {
    let frame = Frame::along(Vec3::Z, Vec3::X);
    Bsdf::Layers(Layers::new([frame; 3], Vec3::Z, out, params))
}

fn metal(roughness: f32) -> BsdfParams {
    BsdfParams { metallic: 1.0, roughness, ..BsdfParams::default() }
}

fn plastic(roughness: f32) -> BsdfParams {
    BsdfParams { roughness, ..BsdfParams::default() }
}

fn glass(roughness: f32, ior: f32) -> BsdfParams {
    BsdfParams { roughness, ior, transmission: 1.0, thick: true, ..BsdfParams::default() }
}

/// Share of the light of a uniform white environment that a surface reflects or transmits towards a viewer,
/// estimated with the sampler. `cosine` is the cosine between the direction to the viewer and the normal.
fn furnace(params: &BsdfParams, cosine: f32) -> f64 {
    furnace_from(params, towards(cosine), 2, 16_384)
}

/// Same as [`furnace`] for a viewer in the direction `out`, with the given number of points and scramble.
fn furnace_from(params: &BsdfParams, out: Vec3, scramble: u64, points: u32) -> f64 {
    let bsdf = surface(params, out);
    let weight = |i| {
        let (_, _, s) = bsdf.sample(&Points::new(stream(scramble, 0, 0), i), 0)?;
        Some(f64::from((s.value / s.pdf).element_sum()) / 3.0)
    };
    (0..points).filter_map(weight).sum::<f64>() / f64::from(points)
}

const ROUGHNESSES: [f32; 7] = [0.0, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0];
const COSINES: [f32; 5] = [0.05, 0.1, 0.3, 0.6, 1.0];

/// Base materials that conserve energy, with their names.
fn bases() -> Vec<(String, BsdfParams)> {
    let plain = BsdfParams::default();
    let pane = BsdfParams { transmission: 1.0, ..plain };
    let mut all: Vec<(String, BsdfParams)> = [
        ("metal", BsdfParams { metallic: 1.0, ..plain }),
        ("half metal", BsdfParams { metallic: 0.5, ..plain }),
        ("faint", BsdfParams { specular: (0.3, Vec3::ONE), ..plain }),
        ("half a wall", BsdfParams { transmission: 0.5, ..pane }),
        ("half of glass", BsdfParams { transmission: 0.5, thick: true, ..pane }),
        (
            "a bit of everything",
            BsdfParams { transmission: 0.5, metallic: 0.3, through: (0.5, Vec3::ONE), ..pane },
        ),
        ("leaf", BsdfParams { through: (0.7, Vec3::ONE), ..plain }),
    ]
    .map(|(name, params)| (name.to_string(), params))
    .into();
    for ior in [1.0, 1.05, 1.2, 1.33, 1.5, 1.76, 2.4] {
        let body = BsdfParams { ior, thick: true, ..pane };
        all.push((format!("plastic of {ior}"), BsdfParams { ior, ..plain }));
        all.push((format!("wall of {ior}"), BsdfParams { ior, ..pane }));
        all.push((format!("glass of {ior}"), body));
        all.push((format!("inside of glass of {ior}"), BsdfParams { inside: true, ..body }));
    }
    all
}

/// White furnace test: each base, alone and under each kind of layer, reflects or transmits all light at every
/// roughness. The tolerance is 4 standard errors plus 1 %, or 2 % for anisotropic surfaces, which are viewed along,
/// across and between their axes. The remaining error is due to interpolation in the tables.
#[test]
fn white_surfaces_keep_all_light() {
    let mut worst = [0.0_f64; 2];
    let mut check = |name: &str, params: &BsdfParams| {
        let sides: &[[f32; 2]] =
            if params.anisotropy > 0.0 { &[[1.0, 0.0], [0.0, 1.0], [0.8, 0.6]] } else { &[[1.0, 0.0]] };
        for (roughness, cosine) in ROUGHNESSES.into_iter().flat_map(|r| COSINES.map(|c| (r, c))) {
            for [x, y] in sides {
                let aslant = towards(cosine).x;
                let (out, params) =
                    (Vec3::new(aslant * x, aslant * y, cosine), BsdfParams { roughness, ..*params });
                const RUNS: u32 = 4;
                let got: [f64; RUNS as usize] =
                    std::array::from_fn(|run| furnace_from(&params, out, run as u64, 512));
                let mean = got.iter().sum::<f64>() / f64::from(RUNS);
                let spread = got.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>();
                let error = (spread / f64::from(RUNS * (RUNS - 1))).sqrt();
                let lost = (mean - 1.0).abs() - 4.0 * error;
                let worst = &mut worst[usize::from(params.anisotropy > 0.0)];
                *worst = worst.max(lost);
                let bound = if params.anisotropy > 0.0 { 0.02 } else { 0.01 };
                assert!(lost < bound, "{name} {roughness} {out}: {mean} +- {error}");
            }
        }
    };
    for (name, base) in bases() {
        check(&name, &base);
    }
    for over in ["metal", "leaf", "a bit of everything", "plastic of 1.5", "glass of 1.33", "wall of 2.4"] {
        let (_, base) = bases().into_iter().find(|(name, _)| name == over).expect("a base");
        for [share, roughness] in [[1.0, 0.0], [0.3, 0.2], [1.0, 0.5], [1.0, 1.0]] {
            check(
                &format!("coat of {roughness} on {over}"),
                &BsdfParams { coat: (share, roughness), ..base },
            );
            let sheen = (Vec3::splat(share), roughness);
            check(&format!("sheen of {roughness} on {over}"), &BsdfParams { sheen, ..base });
            check(
                &format!("both of {roughness} on {over}"),
                &BsdfParams { sheen, coat: (share, 0.1), ..base },
            );
        }
        for film in [(1.0, 1.6, 380.0), (0.5, 1.33, 550.0), (1.0, 2.0, 100.0)] {
            check(&format!("film of {} nm on {over}", film.2), &BsdfParams { film, ..base });
        }
        for anisotropy in [0.3, 0.8, 1.0] {
            check(&format!("brush of {anisotropy} on {over}"), &BsdfParams { anisotropy, ..base });
        }
    }
    row(38, "light lost or made by materials of all roughnesses, over 4 standard errors", worst[0], 0.01);
    row(38, "the same for anisotropic materials", worst[1], 0.02);
    let matte = BsdfParams { ior: 1.0, ..BsdfParams::default() };
    assert!((furnace(&matte, 0.4) - 1.0).abs() < 1e-5, "Lambert is exact");
}

/// With any bent normal, a smooth mirror shows only the space above the surface. A bent normal for which this
/// already holds is left unchanged. This test fails if `mirroring` always returns `bent`.
#[test]
fn bent_mirrors_keep_all_light() {
    for cosine in COSINES {
        let out = towards(cosine);
        for i in 0..64 {
            let [u, v] = Points::new(9, i).pair(0);
            let bent = cosine_towards(out, frame::cosine([u, v]));
            let normal = mirroring(bent, Vec3::Z, out);
            let layers = Layers::new([Frame::around(normal); 3], Vec3::Z, out, &metal(0.0));
            let (_, seen, s) = Bsdf::Layers(layers).sample(&Points::new(1, 7), 0).expect("light from above");
            assert!(seen.z > 0.0 && ((s.value / s.pdf).x - 1.0).abs() < 0.01, "{bent} from {out}: {normal}");
            let above = 2.0 * bent.dot(out) * bent.z - out.z > 0.02;
            assert!(!above || normal == bent);
        }
    }
}

/// Flips a direction to the side of `out` if it is on the other side.
fn cosine_towards(out: Vec3, d: Vec3) -> Vec3 {
    let turned = if d.dot(out) < 0.0 { -d } else { d };
    (turned + out * (0.02 - turned.dot(out)).max(0.0)).normalize()
}

#[test]
fn black_surfaces_reflect_only_the_interface() {
    let black = BsdfParams { base: Vec3::ZERO, roughness: 0.5, ..BsdfParams::default() };
    assert_eq!(furnace(&BsdfParams { ior: 1.0, ..black }, 0.5), 0.0);
    assert!(furnace(&black, 1.0) < 0.06);
    assert!(furnace(&BsdfParams { specular: (0.0, Vec3::ONE), ..black }, 1.0) == 0.0);
}

// The Fresnel reflectance for an index of 1.5 is 0.0892 at 60 degrees, where Schlick's approximation is 0.070. Its
// mean over the hemisphere is 0.0918.
#[test]
fn gloss_rises_as_fresnel_says() {
    let black = BsdfParams { base: Vec3::ZERO, roughness: 0.0, ..BsdfParams::default() };
    let at = |params: &BsdfParams, cosine| furnace(params, cosine);
    for (cosine, expected) in [(0.5, 0.0892), (0.7, 0.0509), (0.2, 0.3389)] {
        let got = at(&black, cosine);
        assert!((got / expected - 1.0).abs() < 0.03, "{cosine}: {got} for {expected}");
    }
    let n = 64;
    let mean: f64 = (0..n)
        .map(|i| (i as f32 + 0.5) / n as f32)
        .map(|c| 2.0 * f64::from(c) * at(&black, c) / f64::from(n))
        .sum();
    assert!((mean / 0.0918 - 1.0).abs() < 0.01, "{mean}");
}

// At normal incidence on smooth facets the reflectance is the known one.
#[test]
fn smooth_faces_have_fresnels_reflectance() {
    let black = BsdfParams { base: Vec3::ZERO, roughness: 0.0, ..BsdfParams::default() };
    for (params, expected) in [
        (BsdfParams { ior: 1.5, ..black }, 0.04),
        (BsdfParams { ior: 2.0, ..black }, 1.0 / 9.0),
        (BsdfParams { specular: (0.5, Vec3::ONE), ..black }, 0.02),
        (BsdfParams { specular: (1.0, Vec3::splat(3.0)), ..black }, 0.12),
        (BsdfParams { coat: (0.5, 0.0), ior: 1.0, ..black }, 0.02),
        (BsdfParams { metallic: 1.0, base: Vec3::splat(0.7), ..black }, 0.7),
    ] {
        let got = furnace(&params, 1.0);
        assert!((got / expected - 1.0).abs() < 0.02, "{got} for {expected}");
    }
}

// A smooth body refracts by Snell's law, and reflects everything beyond the critical angle.
#[test]
fn bodies_bend_light_by_their_index() {
    let mean = |params: &BsdfParams, out: Vec3| {
        let bsdf = surface(params, out);
        let mut sum = Vec3::ZERO;
        for i in 0..256 {
            if let Some((_, d, s)) = bsdf.sample(&Points::new(3, i), 0)
                && d.z < 0.0
            {
                sum += d * s.pdf.min(1.0);
            }
        }
        sum.normalize_or_zero()
    };
    let out = towards(0.6);
    let into = mean(&glass(0.0, 1.5), out);
    assert!((into.x + 0.8 / 1.5).abs() < 1e-3 && into.y.abs() < 1e-3, "{into}");
    let inside = BsdfParams { inside: true, ..glass(0.0, 1.5) };
    assert_eq!(mean(&inside, out), Vec3::ZERO, "sine 0.8 is over 1 / 1.5");
    let leaving = mean(&inside, towards(0.9));
    assert!((leaving.x + 1.5 * (1.0_f32 - 0.81).sqrt()).abs() < 1e-3, "{leaving}");
    let straight = mean(&BsdfParams { thick: false, ..glass(0.0, 1.5) }, out);
    assert!((straight + out).length() < 1e-3, "a wall bends nothing: {straight}");
}

/// Extreme parameters give finite values. The weight of a sample never exceeds the albedo of its lobe divided by
/// the probability of the lobe. Viewers at grazing angles and behind the surface, which a normal map may cause, are
/// tested too.
#[test]
fn extremes_are_finite() {
    for roughness in [0.0, 1e-4, 1e-2, 1.0] {
        for cosine in [-1e-3, 0.0, 1.745e-4, 1e-2, 1.0] {
            let everything = BsdfParams {
                anisotropy: 1.0,
                film: (1.0, 3.0, 1e4),
                sheen: (Vec3::ONE, roughness),
                coat: (1.0, roughness),
                through: (0.5, Vec3::ONE),
                ..plastic(roughness)
            };
            let steep = BsdfParams { transmission: 0.5, thick: true, ..everything };
            let odd = [
                everything,
                BsdfParams { ior: 1.0, ..steep },
                BsdfParams { ior: 1e3, ..steep },
                BsdfParams { inside: true, ior: 1.001, ..steep },
                BsdfParams { inside: true, ior: 1e3, ..steep },
            ];
            for (k, params) in bases()
                .into_iter()
                .map(|(_, params)| BsdfParams { roughness, ..params })
                .chain(odd)
                .enumerate()
            {
                let bsdf = surface(&params, towards(cosine));
                let mut found = 0;
                for i in 0..300 {
                    let Some((_, direction, s)) = bsdf.sample(&Points::new(7, i), 0) else { continue };
                    found += 1;
                    assert!((direction.length() - 1.0).abs() < 1e-4);
                    let weight = (s.value / s.pdf).max_element();
                    assert!((0.0..60.0).contains(&weight), "{k} {roughness} {cosine}: {weight} {s:?}");
                }
                assert!(found > 0, "{k} {roughness} {cosine}");
            }
        }
    }
}

/// Chi-square test of the sampler of each class against its density: for each lobe with a material that it
/// dominates, and for the receiver. This test fails if `v.sqrt()` in `cosine` is replaced with `v`.
#[test]
fn samplers_follow_their_densities() {
    let black = BsdfParams { base: Vec3::ZERO, ior: 1.0, ..BsdfParams::default() };
    let inside = BsdfParams { inside: true, ..glass(0.7, 1.3) };
    let receiver = Bsdf::matte(towards(0.3), Vec3::splat(0.5));
    let materials = [
        ("gloss", metal(0.63), 0.7),
        ("grazing gloss", metal(0.84), 0.2),
        ("brush", BsdfParams { anisotropy: 0.6, ..metal(0.6) }, 0.6),
        ("matte", plastic(1.0), 0.5),
        ("matte and gloss", plastic(0.77), 0.9),
        ("coat", BsdfParams { coat: (1.0, 0.7), ..black }, 0.5),
        ("coat and gloss", BsdfParams { coat: (0.8, 0.6), ..metal(0.9) }, 0.4),
        ("sheen", BsdfParams { sheen: (Vec3::ONE, 0.6), ..black }, 0.4),
        ("leaf", BsdfParams { through: (0.6, Vec3::ONE), ..plastic(0.8) }, 0.6),
        ("wall", BsdfParams { transmission: 1.0, thick: false, ..plastic(0.7) }, 0.6),
        ("into glass", glass(0.8, 1.5), 0.8),
        ("out of glass", inside, 0.85),
    ]
    .map(|(name, params, cosine)| (name, surface(&params, towards(cosine))));
    for (name, bsdf) in materials.into_iter().chain([("receiver", receiver)]) {
        let (bins, n) = (SphereBins { rings: 20, sectors: 16 }, 100_000);
        let mut counts = [vec![0.0; bins.count()], vec![0.0; bins.count()]];
        for i in 0..n {
            if let Some((lobe, d, _)) = bsdf.sample(&Points::new(stream(3, i, 0), 0), 0) {
                counts[lobe as usize][bins.of(d)] += 1.0;
            }
        }
        let expected = bins.integrals(20, |d| bsdf.eval(d).map(|s| f64::from(n) as f32 * s.pdf));
        let z = chi_square(&counts.concat(), &expected.concat());
        assert!(z < 4.5, "{name}: {z}");
    }
}

// Every lobe is symmetric, except for gains and coverage that depend only on the viewer. These cancel relative to a
// reference direction.
#[test]
fn lobes_are_reciprocal() {
    let black = BsdfParams { base: Vec3::ZERO, ior: 1.0, ..BsdfParams::default() };
    let (a, b) = (towards(0.3), Vec3::new(-0.48, 0.6, 0.64));
    let value = |params: &BsdfParams, o: Vec3, i: Vec3| {
        let [d, s] = surface(params, o).eval(i);
        [d.value.x / i.z.abs(), s.value.x / i.z.abs()]
    };
    for (name, params, class) in [
        ("matte", plastic(0.4), 0),
        ("faint gloss over matte", BsdfParams { specular: (0.4, Vec3::ONE), ..plastic(0.2) }, 0),
        ("sheen", BsdfParams { sheen: (Vec3::splat(0.6), 0.5), ..black }, 0),
    ] {
        let (x, y) = (value(&params, a, b)[class], value(&params, b, a)[class]);
        assert!((x / y - 1.0).abs() < 1e-3, "{name}: {x} {y}");
    }
    // The share that a sheen transmits to the base is one factor for the viewer, from any direction of light.
    let fibres = (Vec3::splat(0.6), 0.5);
    let left = |o: Vec3, i: Vec3| {
        let sheen = value(&BsdfParams { sheen: fibres, ..black }, o, i)[0];
        (value(&BsdfParams { sheen: fibres, ..plastic(0.5) }, o, i)[0] - sheen)
            / value(&plastic(0.5), o, i)[0]
    };
    assert!((left(a, b) - left(a, towards(0.9))).abs() < 1e-4 && left(a, b) < 0.9 && left(b, a) > left(a, b));
    // The gain of a gloss is a factor of the viewer: f(a, b) g(b) = f(b, a) g(a), where g follows from the albedo
    // alone, so the ratio is the same for every gloss of one roughness and a white metal.
    for params in [metal(0.4), BsdfParams { anisotropy: 0.7, ..metal(0.4) }] {
        let mirror = |o: Vec3, i: Vec3| {
            let ggx = ggx::Ggx::anisotropic(params.roughness, params.anisotropy);
            ggx.mirror(o, i).value / i.z
        };
        assert!((mirror(a, b) / mirror(b, a) - 1.0).abs() < 1e-3);
    }
    // Through an interface: f(a, b) / eta^2 = f(b, a), as carried here without the factor of either side.
    let eta = 1.5;
    let ggx = ggx::Ggx::isotropic(0.6);
    let (a, down) = (towards(0.8), Vec3::new(-0.4, 0.1, -0.9).normalize());
    let [there, ..] = glass::refraction(&ggx, a, down, eta);
    // Seen from the other side, which is then above.
    let [back, ..] = glass::refraction(&ggx, -down, -a, 1.0 / eta);
    let (there, back) = (there / down.z.abs(), back / a.z);
    assert!((there / back / (eta * eta) - 1.0).abs() < 1e-2, "{there} {back}");
}

/// A white surface below a gloss absorbs no light, so the light of a lamp at any angle is reflected by the
/// interface or by the layers below, to viewers in all directions. This test fails if `Layers::eval` leaves out the
/// factor `1.0 - self.interface.albedo(m.z)`.
#[test]
fn a_lamp_is_mirrored_or_given_back() {
    for (ior, roughness) in [1.5, 1.8].into_iter().flat_map(|ior| [0.0, 0.3, 0.8, 1.0].map(|r| (ior, r))) {
        let white = BsdfParams { ior, ..plastic(roughness) };
        for cosine in [0.087, 0.292, 0.7, 1.0] {
            let (lamp, n) = (towards(cosine), 4096);
            let given = (0..n).map(|i| {
                let viewer = frame::cosine(Points::new(3, i).pair(0));
                f64::from(surface(&white, viewer).eval(lamp)[Lobe::Diffuse as usize].value.x / lamp.z)
            });
            let given = given.sum::<f64>() * std::f64::consts::PI / f64::from(n);
            let mirrored = furnace(&BsdfParams { base: Vec3::ZERO, ..white }, cosine);
            assert!(
                (given + mirrored - 1.0).abs() < 0.01,
                "{ior} {roughness} {cosine}: {given} and {mirrored}"
            );
        }
    }
}

// For each colour a film transmits what it does not reflect, over any base.
#[test]
fn films_pass_what_they_do_not_reflect() {
    let film = (1.0, 1.7, 420.0);
    for base in [plastic(0.3), BsdfParams { transmission: 1.0, ..plastic(0.1) }, glass(0.2, 1.8)] {
        for cosine in COSINES {
            let (bsdf, n) = (surface(&BsdfParams { film, ..base }, towards(cosine)), 4096);
            let weight = |i| bsdf.sample(&Points::new(5, i), 0).map_or(Vec3::ZERO, |(.., s)| s.value / s.pdf);
            let got = (0..n).map(weight).sum::<Vec3>() / n as f32;
            assert!((got - Vec3::ONE).abs().max_element() < 0.012, "{cosine}: {got}");
        }
    }
}

// A film without thickness leaves the base unchanged. With thickness, metals stay below 1 and colours appear.
#[test]
fn films_have_colours() {
    let bare = thin_film::f0(1.8, 0.0, Vec3::splat(0.3), 1.0, 0.0);
    assert!((bare - Vec3::splat(0.3)).abs().max_element() < 1e-2, "{bare}");
    let mut most = 0.0_f32;
    for thickness in 10..90 {
        let f0 = thin_film::f0(1.4, thickness as f32 * 10.0, Vec3::splat(0.04), 0.8, ggx::schlick(0.8));
        assert!(f0.min_element() >= 0.0 && f0.max_element() <= 1.0);
        most = most.max(f0.max_element() - f0.min_element());
    }
    assert!(most > 0.02, "{most}");
}
