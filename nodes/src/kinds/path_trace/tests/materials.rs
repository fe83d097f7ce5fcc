//! Tests of materials in whole renders: light transmitted by objects, and their shadows.

use render::transport::bsdf::{BsdfParams, straight};
use render::transport::sky::environment::EnvironmentLight;
use scene::types::{AlphaMode, Map};

use super::*;

pub(super) fn clear(base: f32, volume: Option<[f32; 3]>, ior: f32) -> Material {
    Material {
        base_colour: [base, base, base, 1.0],
        metallic: 0.0,
        roughness: 0.0,
        transmission: Map::of(1.0),
        double_sided: true,
        volume,
        ior,
        ..Material::default()
    }
}

// A layer of strength 0, with any other parameters, changes no bit and costs no ray, whether it is evaluated or
// not.
#[test]
fn layers_of_no_strength_cost_nothing() {
    use scene::types::{Anisotropy, Clearcoat, ColourMap, DiffuseTransmission, Iridescence, Sheen};
    let (plane, _, rig) = shadowed();
    let go = |material: &Material, exhaustive| {
        let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7, exhaustive };
        let cx = Context::detached(scene, ".");
        let object = [ball(0.4, material.clone(), DVec3::new(0.0, 0.0, 0.4))];
        let (out, _) = render_in(&cx, &params(8, Surroundings::OPEN), &plane, &object, &rig, &sunny());
        (samples(&out.object).to_vec(), samples(&out.with).to_vec(), cx.counts()["rays"])
    };
    let plastic = Material { roughness: 0.4, ior: 1.5, ..matte(0.6) };
    let odd = Material {
        clearcoat: Clearcoat { strength: Map::of(0.0), roughness: Map::of(0.3), normal: None },
        sheen: Sheen { colour: ColourMap::of(0.0), roughness: Map::of(0.7) },
        anisotropy: Anisotropy { strength: 0.0, rotation: 1.0, texture: None },
        iridescence: Iridescence {
            strength: Map::of(0.0),
            ior: 1.9,
            thickness_nm: [300.0, 700.0],
            thickness_texture: None,
        },
        diffuse_transmission: DiffuseTransmission { strength: Map::of(0.0), colour: ColourMap::of(1.0) },
        ..plastic.clone()
    };
    let bare = go(&plastic, false);
    for (material, exhaustive) in [(&odd, false), (&plastic, true), (&odd, true)] {
        let layered = go(material, exhaustive);
        assert_eq!(bare.2, layered.2);
        assert!(bare == layered, "the same bytes");
    }
}

/// Cosine-weighted mean of `f` over the hemisphere, where the argument of `f` is the cosine.
pub(super) fn over_cosines(f: impl Fn(f32) -> f32) -> f64 {
    let n = 2_000;
    let cosines = (0..n).map(|i| (f64::from(i) + 0.5) / f64::from(n));
    cosines.map(|c| 2.0 * c * f64::from(f(c as f32))).sum::<f64>() / f64::from(n)
}

// A fine checkerboard with hundreds of squares per pixel is a flat grey with a single sample per pixel, at the mean
// light of its squares. At close range it is black and white.
#[test]
fn textures_are_filtered_where_they_are_small() {
    use scene::types::{Sampler, Texture, TextureRef, Wrap};
    let side = 256_u32;
    let square = |i: u32| if (i % side + i / side).is_multiple_of(2) { [255; 4] } else { [0, 0, 0, 255] };
    let texture = Texture { width: side, height: side, rgba: (0..side * side).flat_map(square).collect() };
    let sampler = Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
    let chequer = TextureRef { texture: 0, uv_set: 0, sampler, transform: None };
    let material = Material { unlit: true, base_colour_texture: Some(chequer), ..matte(1.0) };
    let primitive = Primitive {
        positions: vec![[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]],
        uv0: vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Primitive::default()
    };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: vec![texture] };
    let object = [Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY })];
    let spread = |distance: f64| {
        let camera = rig(DVec3::new(0.0, -distance, 0.0), DVec3::ZERO, 16, 8.0);
        let (out, _) = render(&params(1, Surroundings::OPEN), &Mesh::default(), &object, &camera, &white());
        let seen: Vec<f64> =
            samples(&out.object).chunks(4).filter(|p| p[3] == 1.0).map(|p| f64::from(p[0])).collect();
        let mean = seen.iter().sum::<f64>() / seen.len() as f64;
        (mean, seen.iter().map(|v| (v - mean).abs()).fold(0.0, f64::max))
    };
    let (mean, far) = spread(14.0);
    assert!((mean - 0.5).abs() < 0.01 && far < 0.02, "{mean} {far}");
    assert!(spread(0.1).1 > 0.45);
}

// A ball that absorbs nothing is white in a white sky, whether it is a bubble or solid.
#[test]
fn clear_balls_are_white_in_a_white_sky() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 16, 1.5);
    let none = Some([0.0; 3]);
    for (material, name) in [
        (clear(1.0, None, 1.5), "bubble"),
        (clear(1.0, none, 1.5), "glass"),
        (clear(1.0, none, 1.0), "air"),
        (Material { roughness: 0.4, ..clear(1.0, none, 1.33) }, "frosted"),
    ] {
        let p = PathTrace { max_bounces: 40, ..params(64, Surroundings::OPEN) };
        let object = [ball(0.8, material, DVec3::ZERO)];
        let (out, _) = render(&p, &Mesh::default(), &object, &camera, &white());
        let got = covered(&out.object);
        assert!((got - 1.0).abs() < 0.03, "{name}: {got}");
    }
}

// The light below a pane is the light that passes straight through it at each angle and, in a white sky, the light
// that it reflects from below.
#[test]
fn shadow_of_a_pane_is_what_it_lets_through() {
    let floor = rig(DVec3::new(0.0, 0.0, 0.4), DVec3::new(0.0, 0.01, 0.0), 8, 4.0);
    let pane = placed(&plane(400.0), clear(1.0, None, 1.5), DVec3::new(0.0, 0.0, 0.5));
    let tinted = placed(&plane(400.0), clear(0.25, None, 1.5), DVec3::new(0.0, 0.0, 0.5));
    let p = params(4096, Surroundings::TRANSPARENT);
    let lit = |object: &Arc<Placed>| {
        mean(&render(&p, &plane(400.0), std::slice::from_ref(object), &floor, &white()).0.with)
    };
    assert!((lit(&pane) / 0.5 - 1.0).abs() < 0.01, "{}", lit(&pane));
    let params =
        BsdfParams { base: Vec3::splat(0.25), roughness: 0.0, transmission: 1.0, ..BsdfParams::default() };
    let passing = over_cosines(|c| straight(&params, c).x);
    // Both panes reflect the light that the white pane does not transmit.
    let mirrored = 1.0 - over_cosines(|c| straight(&BsdfParams { base: Vec3::ONE, ..params }, c).x);
    let expected = 0.5 * (passing + mirrored);
    // Transmission is decided at random. With 262144 samples the standard error is about 0.2 %.
    let found = lit(&tinted);
    assert!((found / expected - 1.0).abs() < 0.01, "{found} for {expected}");
}

// Absorption: a slab of one metre halves the light seen through it, also if it is scaled to twice the size. Its
// shadow follows from the oblique paths through it.
#[test]
fn bodies_absorb_along_the_way() {
    let half = scene::math::num::f32::ln(2.0);
    let slab = box_mesh([-200.0, -200.0, 0.5], [200.0, 200.0, 1.5], false);
    let object = placed(&slab, clear(1.0, Some([half, half, 0.0]), 1.0), DVec3::ZERO);
    let above = rig(DVec3::new(0.0, 0.0, 9.0), DVec3::new(0.0, 0.001, 0.0), 4, 40.0);
    let large = Placed { world_from_object: DMat4::from_scale(DVec3::splat(2.0)), ..(*object).clone() };
    for object in [object.clone(), Arc::new(large)] {
        let (out, _) = render(&params(16, Surroundings::OPEN), &Mesh::default(), &[object], &above, &white());
        let [r, g, b] = [0, 1, 2].map(|k| samples(&out.object)[k]);
        assert!((r - 0.5).abs() < 0.01 && (g - 0.5).abs() < 0.01 && (b - 1.0).abs() < 0.01, "{r} {g} {b}");
    }
    let floor = rig(DVec3::new(0.0, 0.0, 0.4), DVec3::new(0.0, 0.01, 0.0), 8, 4.0);
    let p = params(64, Surroundings::TRANSPARENT);
    let (out, _) = render(&p, &plane(200.0), &[object], &floor, &white());
    let [r, b] = [0, 2].map(|k| samples(&out.with).iter().skip(k).step_by(3).sum::<f32>() / 64.0);
    let expected = 0.5 * over_cosines(|c| scene::math::num::f32::exp(-half / c));
    assert!(
        (f64::from(r) / expected - 1.0).abs() < 0.02 && (b / 0.5 - 1.0).abs() < 0.01,
        "{r} {b}, {expected}"
    );
}

// An unlit surface shows its colour in any light.
#[test]
fn unlit_surfaces_show_their_colour() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 8, 1.5);
    let material = Material { unlit: true, ..matte(0.3) };
    for env in [white(), Environment::constant(Up::PlusZ, [0.0; 3], 8)] {
        let object = [ball(0.8, material.clone(), DVec3::ZERO)];
        let (out, _) = render(&params(4, Surroundings::OPEN), &Mesh::default(), &object, &camera, &env);
        assert!((covered(&out.object) - 0.3).abs() < 1e-6);
    }
}

// A glowing ball in the dark lights a plane with the closed form E = pi L r^2 h / d^3, and the noise of light
// samples is small.
#[test]
fn lamps_light_what_is_around_them() {
    let black = Environment::constant(Up::PlusZ, [0.0; 3], 8);
    let lamp = Material { emissive: [7.0, 7.0, 7.0], ..matte(0.0) };
    let (radius, height) = (0.1, 1.0);
    let object = ball(radius, lamp, DVec3::new(0.0, 0.0, height));
    let below = rig(DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, 0.001, 0.0), 8, 40.0);
    let p = PathTrace { max_bounces: 0, ..params(64, Surroundings::OPEN) };
    let (out, _) = render(&p, &plane(50.0), std::slice::from_ref(&object), &below, &black);
    // A mesh of 24 rings lies inside the sphere, so its outline is smaller by a third of 1 %.
    let expected = 0.5 * 7.0 * f64::from(radius * radius) / (height * height);
    let got = mean(&out.with);
    assert!((got / expected - 1.0).abs() < 0.015, "{got} for {expected}");
    let worst = samples(&out.with).iter().fold(0.0_f64, |w, v| w.max((f64::from(*v) / got - 1.0).abs()));
    assert!(worst < 0.1, "{worst}");
    // A wall of the receiver between hides the lamp from both strategies.
    let walled = merge(plane(50.0), box_mesh([-5.0, -5.0, 0.82], [5.0, 5.0, 0.85], false));
    let (out, _) = render(&p, &walled, &[object], &below, &black);
    assert_eq!(mean(&out.with), 0.0);
}

/// A row of clear sheets transmits all light until their number exceeds the maximum number of path vertices,
/// which is reported.
#[test]
fn paths_that_are_too_long_are_reported() {
    let clear = Material { transmission: Map::of(1.0), roughness: 0.0, ..matte(1.0) };
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 8, 8.0);
    for (sheets, max_bounces, reported) in [(6, 8, false), (12, 8, true), (12, 16, false)] {
        let quad = box_mesh([-1.0, 0.0, -1.0], [1.0, 0.0, 1.0], false);
        let quad = Mesh { triangles: quad.triangles[4..6].to_vec(), ..quad };
        let rows = (0..sheets).map(|i| placed(&quad, clear.clone(), DVec3::Y * (0.1 * f64::from(i))));
        let how = PathTrace { max_bounces, ..params(4, Surroundings::OPEN) };
        let objects: Vec<_> = rows.collect();
        let (out, notes) = render(&how, &Mesh::default(), &objects, &camera, &white());
        let note = notes.iter().find(|note| note.id == "paths-cut");
        assert_eq!(note.is_some(), reported, "{sheets} {max_bounces}");
        // Long paths end at random, so their mean is noisy.
        let light = covered(&out.object);
        let expected = if reported { light < 0.01 } else { (light - 1.0).abs() < 0.2 };
        assert!(expected, "{sheets} {max_bounces}: {light}");
    }
}

/// The green channel of a normal map points up in the texture, while v increases downwards. A card with a normal
/// map of one colour looks like a card whose vertex normals are bent, whether tangents are stored or computed from
/// the texture coordinates.
#[test]
fn green_of_a_normal_map_points_up_the_picture() {
    use scene::types::{NormalMap, Sampler, Texture, TextureRef, Wrap};
    let rgba: Vec<u8> = vec![176, 210, 200, 255];
    let bent = Vec3::new(f32::from(rgba[0]), f32::from(rgba[1]), f32::from(rgba[2])) * (2.0 / 255.0) - 1.0;
    let card = plane(0.5);
    // u runs along x, v against y.
    let uv0 = card.positions.iter().map(|&[x, y, _]| [x + 0.5, 0.5 - y]).collect::<Vec<_>>();
    let sampler = Sampler { wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
    let texture = TextureRef { texture: 0, uv_set: 0, sampler, transform: None };
    let map = NormalMap { texture, scale: 1.0 };
    let render_card = |normal: Vec3, map: Option<NormalMap>, made: bool| {
        let mut primitive = Primitive {
            positions: card.positions.clone(),
            triangles: card.triangles.clone(),
            normals: vec![normal.normalize().to_array(); 4],
            uv0: uv0.clone(),
            ..Primitive::default()
        };
        if made {
            scene::io::gltf::object::tangents::generate(&mut primitive, false);
        }
        let material = Material { normal: map, ..matte(0.8) };
        let textures = vec![Texture { width: 1, height: 1, rgba: rgba.clone() }];
        let object = Object { primitives: vec![primitive], materials: vec![material], textures };
        let placed =
            Placed { object: Arc::new(object), world_from_object: DMat4::from_translation(DVec3::Z) };
        let camera = rig(DVec3::new(0.2, 0.1, 3.0), DVec3::Z, 8, 12.0);
        let (out, _) =
            render(&params(64, Surroundings::OPEN), &plane(0.1), &[Arc::new(placed)], &camera, &sunny());
        covered(&out.object)
    };
    let expected = render_card(bent, None, false);
    assert!((expected / render_card(Vec3::Z, None, false) - 1.0).abs() > 0.05, "the map bends");
    for made in [false, true] {
        let found = render_card(Vec3::Z, Some(map), made);
        assert!((found / expected - 1.0).abs() < 2e-3, "{made}: {found} for {expected}");
    }
}

/// Emission under a clearcoat is attenuated by the reflection of the coat (KHR_materials_clearcoat): 0.96 of it
/// remains at normal incidence and 0.747 at 75 degrees, by Fresnel's equations for an index of 1.5. The light that
/// the emission casts on a floor is attenuated in the same way.
#[test]
fn a_clear_coat_dims_what_shines_under_it() {
    let coat = scene::types::Clearcoat { strength: Map::of(1.0), roughness: Map::of(0.0), normal: None };
    let lamp = |coated: bool| {
        let shining = Material { emissive: [1.0; 3], ..matte(0.0) };
        if coated { Material { clearcoat: coat, ..shining } } else { shining }
    };
    let black = Environment::constant(Up::PlusZ, [0.0; 3], 8);
    for (degrees, left) in [(0.0, 0.96), (75.0, 0.747)] {
        let (sin, cos) = scene::math::num::sin_cos(f64::to_radians(degrees));
        let camera = rig(DVec3::new(5.0 * sin, 0.001, 5.0 * cos), DVec3::ZERO, 4, 60.0);
        let panel = [placed(&plane(2.0), lamp(true), DVec3::ZERO)];
        let (out, _) = render(&params(4, Surroundings::OPEN), &Mesh::default(), &panel, &camera, &black);
        let found = covered(&out.object);
        assert!((found - left).abs() < 0.01, "{found} for {left} at {degrees}");
    }
    // The panel is 4 m above the floor.
    let floor = rig(DVec3::new(0.0, -1.0, 1.0), DVec3::ZERO, 4, 40.0);
    let lit = |coated| {
        let panel = [placed(&plane(0.2), lamp(coated), DVec3::Z * 4.0)];
        mean(&render(&params(64, Surroundings::OPEN), &plane(3.0), &panel, &floor, &black).0.with)
    };
    let (found, bare) = (lit(true), lit(false));
    assert!(bare > 0.0 && (found / bare - 0.96).abs() < 0.01, "{found} of {bare}");
}

/// A flat mirror shows the sky exactly as the background next to it does, without the edges of texels. This test
/// fails if `is_narrow` is always false.
#[test]
fn mirrors_show_no_texels() {
    let mut env = Environment::constant(Up::PlusZ, [0.0; 3], 16);
    let texels = env.image.samples.iter_mut().enumerate();
    texels.for_each(|(i, v)| {
        *v = 0.2 + render::geometry::sampling::unit(render::geometry::sampling::mix(i as u32));
    });
    let sky = EnvironmentLight::new(&env);
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..matte(1.0) };
    let mirror = placed(&plane(3.0), mirror, DVec3::ZERO);
    let camera = rig(DVec3::new(0.4, -2.0, 1.5), DVec3::new(0.1, 0.0, 0.0), 24, 3.0);
    let p = PathTrace { max_bounces: 1, ..params(64, Surroundings::TRANSPARENT) };
    let (out, _) = render(&p, &Mesh::default(), &[mirror], &camera, &env);
    for (index, pixel) in samples(&out.object).chunks_exact(4).enumerate() {
        let (x, y) = (index % 24, index / 24);
        let ray = camera.cameras[0].direction(x as f64 + 0.5, y as f64 + 0.5).as_vec3();
        let seen = sky.background(Vec3::new(ray.x, ray.y, -ray.z));
        assert!((pixel[1] - seen.y).abs() < 0.02, "{x} {y}: {} for {}", pixel[1], seen.y);
    }
}

/// A metal ball maps equal solid angles of the sky to equal areas of the picture. It reflects the light of a sun of
/// one texel exactly once, whether the lobe is wider or narrower than the texel, and for any number of texels. This
/// test fails if `light_sample` keeps narrow glossy lobes.
#[test]
fn a_lobe_as_narrow_as_a_texel_counts_a_sun_once() {
    let of_width = |times: usize| {
        let mut env = Environment::constant(Up::PlusZ, [0.01; 3], 32 * times);
        for (i, v) in env.image.samples.chunks_exact_mut(3).enumerate() {
            let (x, y) = (i % (32 * times) / times, i / (32 * times) / times);
            if (x, y) == (3, 6) {
                v.fill(100.0);
            }
        }
        env
    };
    let camera = rig(DVec3::new(0.0, -60.0, 0.0), DVec3::ZERO, 64, 58.0);
    let p = PathTrace { max_bounces: 1, ..params(64, Surroundings::TRANSPARENT) };
    for roughness in [0.1, 0.2, 0.25, 0.3, 0.4] {
        let metal = Material { metallic: 1.0, roughness, ..matte(1.0) };
        let light = |times| {
            let (out, _) = render(
                &p,
                &Mesh::default(),
                &[ball(1.0, metal.clone(), DVec3::ZERO)],
                &camera,
                &of_width(times),
            );
            mean(&out.object)
        };
        let (one, many) = (light(1), light(8));
        assert!((one / many - 1.0).abs() < 0.01, "roughness {roughness}: {one} for {many}");
    }
}

/// A matte surface with bent shading normals reflects light by Lambert's law, regardless of the position of the
/// viewer, because normals are adjusted only for mirrors. The expected light is summed over the texels above the
/// triangles. This test fails if `Frame::around(matte_normal)` is replaced by `frame`.
#[test]
fn bent_normals_of_matte_surfaces_do_not_turn_with_the_viewer() {
    let mut env = Environment::constant(Up::PlusZ, [0.1; 3], 64);
    let (width, height) = (64, 32);
    for x in 14..18 {
        env.image.pixel_mut(x, 8).fill(100.0);
    }
    for tilt in [20.0_f64, 40.0, 60.0] {
        let (sin, cos) = scene::math::num::sin_cos(tilt.to_radians());
        let normal = DVec3::new(sin, 0.0, cos);
        let mut object = Object::clone(&placed(&plane(1.0), matte(0.5), DVec3::ZERO).object);
        object.primitives[0].normals = vec![normal.as_vec3().to_array(); 4];
        let card = [Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY })];
        let texel = |i: usize| {
            let (x, y) = (i % width, i / width);
            let [u, v] = [(x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64];
            let way = equirect::direction(Up::PlusZ, u, v);
            let cosine = if way.z > 0.0 { way.dot(normal).max(0.0) } else { 0.0 };
            f64::from(env.image.rgb(x, y)[1]) * cosine * equirect::pixel_solid_angle(width, height, y)
        };
        let expected = 0.5 / std::f64::consts::PI * (0..width * height).map(texel).sum::<f64>();
        for view in [0.01_f64, 45.0, 75.0] {
            let (sin, cos) = scene::math::num::sin_cos(view.to_radians());
            let camera = rig(DVec3::new(-4.0 * sin, 0.0, 4.0 * cos), DVec3::ZERO, 8, 40.0);
            let p = PathTrace { max_bounces: 0, ..params(64, Surroundings::TRANSPARENT) };
            let (out, _) = render(&p, &Mesh::default(), &card, &camera, &env);
            let found = covered(&out.object);
            // The closed form uses the cosine at the centre of each texel.
            assert!((found / expected - 1.0).abs() < 0.02, "{tilt} from {view}: {found} for {expected}");
        }
    }
}

/// Blended surfaces cover the share of a pixel that their alpha gives, with almost no noise: alone, behind another
/// surface and behind a cut-out. They block the same share of the sun's light. Neither is decided by independent
/// random numbers, with which 16 samples would deviate by 0.125. This test fails if `front` or
/// `object_transmittance` decides by `accepts`.
#[test]
fn blended_surfaces_are_smooth() {
    let sheet = |alpha: f32, z: f64| {
        let mut material = Material { alpha_mode: AlphaMode::Blend, ..matte(0.0) };
        material.base_colour[3] = alpha;
        placed(&plane(1.0), material, DVec3::Z * z)
    };
    let of = |values: &mut dyn Iterator<Item = f64>| {
        let all: Vec<f64> = values.collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let square = all.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / all.len() as f64;
        (mean, square.sqrt())
    };
    let above = rig(DVec3::new(0.0, -0.1, 4.0), DVec3::ZERO, 24, 8.0);
    let p = params(16, Surroundings::OPEN);
    for (alphas, cover) in
        [(&[0.5_f32][..], 0.5), (&[0.5, 0.3], 0.65), (&[0.2, 0.0, 0.7, 0.1], 0.784), (&[1.0, 0.5], 1.0)]
    {
        let sheets: Vec<_> =
            alphas.iter().enumerate().map(|(i, alpha)| sheet(*alpha, 0.5 + 0.1 * i as f64)).collect();
        let (out, _) = render(&p, &Mesh::default(), &sheets, &above, &white());
        let (mean, deviation) = of(&mut samples(&out.object).chunks(4).map(|p| f64::from(p[3])));
        assert!((mean - cover).abs() < 0.01 && deviation < 0.04, "{alphas:?}: {mean} +- {deviation}");
    }
    let aside = rig(DVec3::new(0.0, -4.0, 0.4), DVec3::ZERO, 16, 60.0);
    let mut sun = Environment::constant(Up::PlusZ, [0.0; 3], 64);
    sun.image.samples[..64 * 3].fill(100.0);
    let (out, _) = render(&p, &plane(3.0), &[sheet(0.5, 0.5)], &aside, &sun);
    let ratios = samples(&out.with).chunks(3).zip(samples(&out.without).chunks(3));
    let (mean, deviation) = of(&mut ratios.map(|(with, without)| f64::from(with[1] / without[1])));
    assert!((mean - 0.5).abs() < 0.01 && deviation < 0.01, "{mean} +- {deviation}");
}
