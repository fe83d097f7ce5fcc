//! Expected values of light transport, from closed forms and from relations between renders.

use engine::{Scene, Up};
use glam::DMat4;

use super::light::constant;
use super::*;
use crate::testing::context;
use crate::types::{Material, Object, Primitive};

mod materials;

/// The triangles of a box whose normals point outwards, or inwards.
fn box_mesh(low: [f32; 3], high: [f32; 3], inward: bool) -> Mesh {
    let corner = |i: u32| std::array::from_fn(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .map(|[a, b, c]| if inward { [a, c, b] } else { [a, b, c] })
        .collect();
    Mesh { positions: (0..8).map(corner).collect(), colours: Vec::new(), triangles }
}

fn merge(mut a: Mesh, b: Mesh) -> Mesh {
    let first = a.positions.len() as u32;
    a.positions.extend(b.positions);
    a.triangles.extend(b.triangles.iter().map(|t| t.map(|i| i + first)));
    a
}

/// A square plane at height 0 with normal +z.
fn plane(size: f32) -> Mesh {
    Mesh {
        positions: vec![[-size, -size, 0.0], [size, -size, 0.0], [size, size, 0.0], [-size, size, 0.0]],
        colours: Vec::new(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn placed(mesh: &Mesh, material: Material, at: DVec3) -> Arc<Placed> {
    let primitive = Primitive {
        positions: mesh.positions.clone(),
        triangles: mesh.triangles.clone(),
        ..Primitive::default()
    };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::from_translation(at) })
}

fn matte(albedo: f32) -> Material {
    Material {
        base_colour: [albedo, albedo, albedo, 1.0],
        metallic: 0.0,
        roughness: 1.0,
        ior: 1.0,
        double_sided: true,
        ..Material::default()
    }
}

/// A sphere of the given radius as a fine mesh with smooth normals.
fn ball(radius: f32, material: Material, at: DVec3) -> Arc<Placed> {
    let rings = 24;
    let mut primitive = Primitive::default();
    for i in 0..=rings {
        for j in 0..=2 * rings {
            let (st, ct) = crate::num::sin_cos(std::f64::consts::PI * f64::from(i) / f64::from(rings));
            let (sp, cp) = crate::num::sin_cos(std::f64::consts::PI * f64::from(j) / f64::from(rings));
            let normal = [(st * cp) as f32, (st * sp) as f32, ct as f32];
            primitive.normals.push(normal);
            primitive.positions.push(normal.map(|v| v * radius));
        }
    }
    let row = 2 * rings as u32 + 1;
    for i in 0..rings as u32 {
        for j in 0..row - 1 {
            let [a, b, c, d] = [i * row + j, (i + 1) * row + j, (i + 1) * row + j + 1, i * row + j + 1];
            primitive.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::from_translation(at) })
}

fn rig(eye: DVec3, target: DVec3, size: u32, focal: f64) -> Arc<Rig> {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let down = forward.cross(right);
    let pose = DMat4::from_cols(right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0));
    let half = f64::from(size) / 2.0;
    Arc::new(Rig {
        cameras: vec![Camera {
            name: "v".to_owned(),
            width_px: size,
            height_px: size,
            fx: focal * half,
            fy: focal * half,
            cx: half,
            cy: half,
            world_from_camera: pose.to_cols_array(),
        }],
    })
}

fn params(samples: u32, env_block: EnvBlock) -> PathTrace {
    PathTrace {
        samples,
        max_bounces: 8,
        env_block,
        bounce: Bounce::Auto,
        object_specular_sees: SpecularSees::Auto,
        clamp_indirect: 0.0,
        contact_metres: Some(0.0),
    }
}

fn render(
    params: &PathTrace,
    receiver: &Mesh,
    objects: &[Arc<Placed>],
    rig: &Arc<Rig>,
    env: &Environment,
) -> (Out, Notes) {
    render_in(&context(), params, receiver, objects, rig, env)
}

fn render_in(
    cx: &Context,
    params: &PathTrace,
    receiver: &Mesh,
    objects: &[Arc<Placed>],
    rig: &Arc<Rig>,
    env: &Environment,
) -> (Out, Notes) {
    let inputs = In {
        receiver: Arc::new(receiver.clone()),
        objects: objects.to_vec(),
        rig: rig.clone(),
        env: Arc::new(env.clone()),
    };
    PathTrace::run(params, inputs, cx).expect("renders")
}

fn samples(images: &Images) -> &[f32] {
    images.0[0].picture.samples()
}

fn mean(images: &Images) -> f64 {
    let s = samples(images);
    crate::num::ordered_sum(s.iter().copied()) / s.len() as f64
}

/// Mean colour of the pixels that the object covers wholly.
fn covered(images: &Images) -> f64 {
    let solid = samples(images).chunks(4).filter(|p| p[3] == 1.0);
    let (sum, n) = solid.fold((0.0, 0.0), |(s, n), p| (s + f64::from(p[0] + p[1] + p[2]) / 3.0, n + 1.0));
    sum / n
}

fn white() -> Environment {
    constant(Up::PlusZ, [1.0; 3], 64)
}

/// A dim sky with a sun of 4 texels, off the zenith.
fn sunny() -> Environment {
    let mut env = constant(Up::PlusZ, [0.3, 0.4, 0.6], 64);
    for (x, y) in [(40, 6), (41, 6), (40, 7), (41, 7)] {
        env.image.pixel_mut(x, y).copy_from_slice(&[900.0, 850.0, 700.0]);
    }
    env
}

fn inside() -> Arc<Rig> {
    rig(DVec3::new(-1.5, -1.2, 2.0), DVec3::new(0.5, 0.5, 1.0), 24, 1.2)
}

fn room() -> Mesh {
    box_mesh([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0], true)
}

// Notes, section 2: nothing reaches the inside of a solid box.
#[test]
fn solid_box_is_black() {
    let object = [ball(0.5, matte(0.5), DVec3::new(0.5, 0.5, 1.0))];
    let (out, _) = render(&params(16, EnvBlock::Solid), &room(), &object, &inside(), &sunny());
    assert!(samples(&out.without).iter().chain(samples(&out.with)).all(|&v| v == 0.0));
    assert_eq!(covered(&out.object), 0.0);
    assert!(samples(&out.depth).iter().all(|d| d.is_finite()));
}

// Notes, section 2: constant environment 1, albedo 0.5, receiver passes: 0.5 at any number of bounces.
#[test]
fn passing_box_is_half_lit() {
    for (bounces, block) in
        [(0, EnvBlock::Pass), (8, EnvBlock::Pass), (3, EnvBlock::FrontFace { max_layers: 3 })]
    {
        let p = PathTrace { max_bounces: bounces, ..params(64, block) };
        let (out, _) = render(&p, &room(), &[], &inside(), &white());
        assert!((mean(&out.without) - 0.5).abs() < 5e-4, "{bounces} bounces: {}", mean(&out.without));
    }
    // Direct 0.5; with every bounce off solid walls 0.5 / (1 - 0.5); with b bounces 1 - 0.5^(b + 1).
    for (bounces, expected) in [(0, 0.5), (1, 0.75), (2, 0.875), (24, 1.0)] {
        let p = PathTrace { max_bounces: bounces, bounce: Bounce::Solid, ..params(64, EnvBlock::Pass) };
        let (out, _) = render(&p, &room(), &[], &inside(), &white());
        assert!((mean(&out.without) - expected).abs() < 4e-3, "{bounces}: {}", mean(&out.without));
    }
}

// Notes, section 1: the printed indicator gives a closed room the environment itself, no shadow, and a black
// matte object; only what is glossy sees light.
#[test]
fn printed_visibility_lights_nothing() {
    let at = DVec3::new(0.5, 0.5, 1.0);
    let shiny = Material { roughness: 0.0, double_sided: true, ..Material::default() };
    for (material, lit) in [(matte(0.5), false), (shiny, true)] {
        let object = [ball(0.5, material, at)];
        let (out, _) = render(&params(16, EnvBlock::Paper), &room(), &object, &inside(), &white());
        assert!(samples(&out.without).iter().chain(samples(&out.with)).all(|&v| v == 1.0));
        assert_eq!(covered(&out.object) > 0.2, lit, "{}", covered(&out.object));
    }
}

// What counts twice is told, with its size.
#[test]
fn double_counting_is_told() {
    let told = |bounce| {
        let p = PathTrace { bounce, max_bounces: 0, ..params(1, EnvBlock::Pass) };
        let (_, notes) = render(&p, &room(), &[], &inside(), &white());
        notes.iter().find(|n| n.id == "double-count").map(|n| n.text.clone())
    };
    assert_eq!(told(Bounce::Auto), None);
    assert!(told(Bounce::Solid).expect("a warning").contains("100 %"));
}

// Notes, section 1: light samples and scattered rays share one visibility, so the estimate does not lose
// what one of them cannot reach. Reference: cosine integral of the texels at each wall, by the exact sum.
#[test]
fn both_strategies_together_are_exact_for_any_sky() {
    let env = sunny();
    let up = plane(50.0);
    let top = rig(DVec3::new(0.0, 0.1, 5.0), DVec3::ZERO, 8, 4.0);
    let mut expected = 0.0_f64;
    let sub = 8;
    for y in 0..32 {
        for x in 0..64 {
            for k in 0..sub * sub {
                let (u, v) = (
                    (x as f64 + (f64::from(k % sub) + 0.5) / f64::from(sub)) / 64.0,
                    (y as f64 + (f64::from(k / sub) + 0.5) / f64::from(sub)) / 32.0,
                );
                let cosine = crate::equirect::direction(Up::PlusZ, u, v).z.max(0.0);
                let area = crate::equirect::pixel_solid_angle(64, 32, y) / f64::from(sub * sub);
                expected += f64::from(luminance(env.image.rgb(x, y))) * cosine * area;
            }
        }
    }
    expected *= 0.5 / std::f64::consts::PI;
    for block in [EnvBlock::Solid, EnvBlock::Pass, EnvBlock::FrontFace { max_layers: 3 }] {
        let (out, _) = render(&params(64, block), &up, &[], &top, &env);
        let s = samples(&out.without);
        let got =
            s.chunks(3).map(|p| f64::from(luminance([p[0], p[1], p[2]]))).sum::<f64>() / (s.len() / 3) as f64;
        assert!((got / expected - 1.0).abs() < 2e-3, "{block:?}: {got} against {expected}");
    }
}

// Notes, section 1: a slab over the floor is seen but casts nothing when the receiver passes; with FrontFace
// it shades as a solid body would, while the walls stay open.
#[test]
fn only_the_shell_is_open_to_front_faces() {
    let slab = box_mesh([-0.8, -0.8, 0.9], [0.8, 0.8, 1.0], false);
    let furnished = merge(room(), slab);
    let floor = rig(DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, 0.01, 0.0), 8, 3.0);
    let lit = |mesh: &Mesh, block| mean(&render(&params(64, block), mesh, &[], &floor, &sunny()).0.without);
    let front = EnvBlock::FrontFace { max_layers: 3 };
    let open = lit(&room(), EnvBlock::Pass);
    assert!((lit(&room(), front) / open - 1.0).abs() < 1e-6);
    assert!((lit(&furnished, EnvBlock::Pass) / open - 1.0).abs() < 1e-6);
    let shaded = lit(&furnished, front);
    // The same slab over a floor in the open, without bounces between the two.
    let open_slab = merge(plane(2.0), box_mesh([-0.8, -0.8, 0.9], [0.8, 0.8, 1.0], false));
    let p = PathTrace { bounce: Bounce::Env, ..params(64, EnvBlock::Solid) };
    let reference = mean(&render(&p, &open_slab, &[], &floor, &sunny()).0.without);
    assert!(shaded < 0.9 * open && (shaded / reference - 1.0).abs() < 0.02, "{shaded} {reference} {open}");
    // One layer: a ray that has passed one front face counts as outside, so a slab seen from below, whose
    // front is met first, no longer shades.
    assert!((lit(&furnished, EnvBlock::FrontFace { max_layers: 1 }) / open - 1.0).abs() < 1e-6);
}

#[test]
fn auto_finds_out_what_the_receiver_is() {
    let decided = |mesh: &Mesh, rig: &Arc<Rig>| {
        let p = PathTrace { max_bounces: 0, ..params(1, EnvBlock::Auto) };
        let (_, notes) = render(&p, mesh, &[], rig, &white());
        let note = notes.iter().find(|n| n.id == "env-block").expect("a decision");
        note.text.split(':').next().unwrap_or_default().to_owned()
    };
    assert_eq!(decided(&room(), &inside()), "FrontFace");
    let outward = box_mesh([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0], false);
    assert_eq!(decided(&outward, &inside()), "FrontFace with normals turned round");
    assert_eq!(decided(&plane(4.0), &rig(DVec3::new(0.0, -3.0, 2.0), DVec3::ZERO, 8, 1.0)), "Solid");
    let mut mixed = room();
    for triangle in mixed.triangles.iter_mut().step_by(2) {
        triangle.swap(0, 1);
    }
    assert_eq!(decided(&mixed, &inside()), "Pass");
}

// What lies farther than the radius does not block: with the room's own radius nothing is left of the
// shell, with a large one the box is solid.
#[test]
fn pass_beyond_blocks_only_what_is_near() {
    let mut env = white();
    env.origin = Some(DVec3::new(0.0, 0.0, 2.0));
    let lit = |metres| {
        let p = PathTrace { bounce: Bounce::Env, ..params(64, EnvBlock::PassBeyond { metres }) };
        mean(&render(&p, &room(), &[], &inside(), &env).0.without)
    };
    assert!((lit(0.5) - 0.5).abs() < 5e-4);
    assert_eq!(lit(100.0), 0.0);
}

fn shadowed() -> (Mesh, Vec<Arc<Placed>>, Arc<Rig>) {
    let objects = vec![ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, 0.4))];
    (plane(4.0), objects, rig(DVec3::new(0.0, -4.0, 2.5), DVec3::new(0.0, 0.0, 0.2), 32, 4.0))
}

// No object, and an object that no ray meets: S = 1 bit for bit.
#[test]
fn without_objects_both_renders_are_equal() {
    let (plane, _, rig) = shadowed();
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    for objects in [&[][..], &far] {
        for block in [EnvBlock::Solid, EnvBlock::Pass] {
            let (out, _) = render(&params(20, block), &plane, objects, &rig, &sunny());
            assert_eq!(samples(&out.without), samples(&out.with));
            assert!(samples(&out.object).iter().all(|&v| v == 0.0));
        }
    }
}

// Work is counted, and guarded: objects that are not there cost nothing, and for those that are only the
// samples that they touch are traced again.
#[test]
fn rays_are_only_cast_where_they_may_matter() {
    let (plane, objects, rig) = shadowed();
    let rays = |objects: &[Arc<Placed>], block| {
        let cx = context();
        render_in(&cx, &params(16, block), &plane, objects, &rig, &sunny());
        cx.counts()["rays"]
    };
    let samples = 16 * 32 * 32;
    // A camera ray; where it lands up to four to the sky and, where the plane is solid, one scattered.
    let (solid, pass) = (rays(&[], EnvBlock::Solid), rays(&[], EnvBlock::Pass));
    assert!(solid <= samples * 6 && pass == samples, "{solid} {pass} for {samples} samples");
    // Again a camera ray, and another to the object; up to four to the sky, and two scattered.
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let there = rays(&far, EnvBlock::Solid);
    assert!(there <= solid + samples * 8, "{there} over {solid}");
    let near = rays(&objects, EnvBlock::Solid);
    assert!(near < solid + samples * 11, "{near} over {solid}");
}

#[test]
fn objects_cast_shadows_and_are_hidden_from_the_camera() {
    let (plane, objects, rig) = shadowed();
    let (out, _) = render(&params(64, EnvBlock::Auto), &plane, &objects, &rig, &sunny());
    let (r0, r1) = (samples(&out.without), samples(&out.with));
    let ratios: Vec<f32> = r0.iter().zip(r1).map(|(a, b)| b / a).collect();
    let dark = ratios.iter().filter(|&&s| s < 0.4).count();
    let same = ratios.iter().filter(|&&s| (s - 1.0).abs() < 0.02).count();
    assert!(dark > 60 && same > ratios.len() / 2, "{dark} {same} of {}", ratios.len());
    // An object of albedo 0.6 on a plane of 0.5 in this light is neither black nor brighter than the sun.
    assert!((0.05..3.0).contains(&covered(&out.object)));
    // A visible object would replace the plane by something of another colour in its own pixels; hidden, no
    // pixel of the plane becomes sky.
    assert!(r1.iter().all(|v| v.is_finite()));
}

// The estimate of a touched pixel is the same whether its chunk was skipped or traced: tracing everything
// with an object that is present but black to no one gives the sums without it.
#[test]
fn skipping_untouched_paths_changes_nothing() {
    let (plane, objects, rig) = shadowed();
    let cx = context();
    let stage_inputs = In { receiver: Arc::new(plane), objects, rig, env: Arc::new(sunny()) };
    let receiver = Receiver::new(&stage_inputs.receiver, DVec3::ZERO);
    let sky = Sky::new(&stage_inputs.env);
    let objects = Objects::new(&stage_inputs.objects, DVec3::ZERO).expect("consistent");
    for bounce_solid in [false, true] {
        let rules = Rules {
            block: Block::Solid,
            bounce_solid,
            specular_env: false,
            printed: false,
            max_bounces: 8,
            clamp: f32::MAX,
        };
        let world = World { receiver: &receiver, objects: &objects, sky: &sky, rules: &rules };
        let camera = &stage_inputs.rig.cameras[0];
        let ground = Ground::default();
        let lens = Lens::new(camera, DVec3::ZERO, cx.seed(), &ground);
        let (mut same, mut other) = (0, 0);
        for pixel in (0..32).flat_map(|y| (0..32).map(move |x| (x, y))) {
            let (points, key, ray) = lens.sample(pixel, 3);
            let Some(hit) = receiver_hit(&world, ray) else { continue };
            let go = |objects| {
                let mut walk = Walk::new(world, points, key, objects);
                let light = walk.radiance::<false>(Vertex::Receiver(hit), ray.direction);
                (light, walk.touched)
            };
            let mut probe = Walk::new(world, points, key, true);
            probe.radiance::<true>(Vertex::Receiver(hit), ray.direction);
            let ((with, touched), (without, _)) = (go(true), go(false));
            assert!(probe.touched || !touched, "the probe misses nothing");
            if probe.touched {
                other += 1;
            } else {
                same += 1;
                assert_eq!(with, without);
            }
        }
        assert!(same > 100 && other > 50, "{same} {other}");
    }
}

// 64 then 256 equals 256 at once, in small: chunks are the same whatever the number of samples is.
#[test]
fn more_samples_only_add_chunks() {
    let (plane, objects, rig) = shadowed();
    let sums = |n| {
        let (out, _) = render(&params(n, EnvBlock::Solid), &plane, &objects, &rig, &sunny());
        samples(&out.without).iter().map(|v| f64::from(*v) * f64::from(n)).collect::<Vec<_>>()
    };
    let (four, sixteen) = (sums(4), sums(16));
    assert!(four.iter().zip(&sixteen).all(|(a, b)| *b >= a - 1e-4));
}

// A closed object on a passing receiver in a white sky: the furnace. Matte white gives 1, and so does metal.
#[test]
fn furnace_holds_in_the_scene() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 24, 1.5);
    for (material, tolerance) in [
        (matte(1.0), 2e-3),
        (Material { double_sided: true, ..Material::default() }, 0.02),
        (Material { roughness: 0.3, double_sided: true, ..Material::default() }, 0.02),
        (Material { roughness: 0.0, double_sided: true, ..Material::default() }, 0.02),
        (Material { metallic: 0.0, roughness: 0.4, double_sided: true, ..Material::default() }, 0.02),
    ] {
        for at in [DVec3::ZERO, DVec3::new(1e6, -2e6, 5e5)] {
            let object = [ball(0.8, material.clone(), at)];
            let mut far = (*camera).clone();
            for k in 0..3 {
                far.cameras[0].world_from_camera[12 + k] += at.to_array()[k];
            }
            let (out, _) =
                render(&params(64, EnvBlock::Solid), &Mesh::default(), &object, &Arc::new(far), &white());
            let got = covered(&out.object);
            assert!((got - 1.0).abs() < tolerance, "{} {}: {got}", material.metallic, material.roughness);
        }
    }
}

// Row 43: contact on the plane. The floor under a box is dark whatever the gap is, up to what comes in
// through it, and no light leaks at gap 0.
#[test]
fn contact_shadow_is_dark_and_monotone_in_the_gap() {
    let below = rig(DVec3::new(0.0, 0.0, 3.0), DVec3::new(0.0, 0.001, 0.0), 6, 20.0);
    let mut last = 0.0;
    for gap in [0.0, 1e-6, 1e-4, 1e-2, 1e-1] {
        let cube = box_mesh([-0.5, -0.5, 0.0], [0.5, 0.5, 1.0], false);
        let object = [placed(&cube, matte(0.5), DVec3::new(0.0, 0.0, gap))];
        let (out, _) = render(&params(16, EnvBlock::Solid), &plane(3.0), &object, &below, &white());
        let lit = mean(&out.with);
        assert!(lit >= last - 1e-3, "gap {gap}: {lit} after {last}");
        if gap <= 1e-6 {
            assert_eq!(lit, 0.0, "a leak at gap {gap}");
        }
        last = lit;
    }
    assert!(last > 0.0);
}

// Holdout: where the receiver stands in front the object has no alpha; at the border it is partial.
#[test]
fn receiver_in_front_holds_the_object_out() {
    let wall = box_mesh([-3.0, -1.1, 0.0], [0.013, -1.0, 3.0], false);
    let object = [ball(0.5, matte(0.5), DVec3::new(0.0, 0.0, 0.5))];
    let camera = rig(DVec3::new(0.0, -4.0, 0.5), DVec3::new(0.0, 0.0, 0.5), 32, 3.0);
    let (out, _) = render(&params(32, EnvBlock::Solid), &wall, &object, &camera, &white());
    let alpha: Vec<f32> = samples(&out.object).chunks(4).map(|p| p[3]).collect();
    let row = &alpha[16 * 32..17 * 32];
    assert!(row[..15].iter().all(|&a| a == 0.0), "{row:?}");
    assert!(row[17..22].iter().all(|&a| a == 1.0), "{row:?}");
    assert!(row[15..17].iter().any(|&a| a > 0.0 && a < 1.0), "{row:?}");
    // Depth is planar: the wall at 4 - 1.1 from the camera wherever it is seen.
    let depth = samples(&out.depth);
    assert!((depth[16 * 32 + 4] - 2.9).abs() < 1e-4 && (depth[20 * 32 + 10] - 2.9).abs() < 1e-4);
    assert_eq!(depth[31], f32::INFINITY);
}

// Alpha modes: a cut-out of alpha below the cut-off is not there; a blend of 0.25 covers a quarter.
#[test]
fn alpha_modes_cut_and_blend() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.5), DVec3::new(0.0, 0.0, 0.5), 8, 6.0);
    let cube = box_mesh([-0.5, 0.0, 0.0], [0.5, 0.0, 1.0], false);
    // Only the quad that faces the camera.
    let quad = Mesh { triangles: cube.triangles[4..6].to_vec(), ..cube };
    let covers = |mode, alpha| {
        let material = Material { alpha_mode: mode, base_colour: [0.5, 0.5, 0.5, alpha], ..matte(0.5) };
        let object = [placed(&quad, material, DVec3::ZERO)];
        let (out, _) = render(&params(64, EnvBlock::Solid), &Mesh::default(), &object, &camera, &white());
        samples(&out.object).chunks(4).map(|p| f64::from(p[3])).sum::<f64>() / 64.0
    };
    use crate::types::AlphaMode::{Blend, Mask, Opaque};
    assert_eq!([covers(Opaque, 0.25), covers(Mask(0.5), 0.25), covers(Mask(0.2), 0.25)], [1.0, 0.0, 1.0]);
    assert!((covers(Blend, 0.25) - 0.25).abs() < 0.03);
}

// An emissive object lights the receiver.
#[test]
fn emission_reaches_the_receiver() {
    let black = constant(Up::PlusZ, [0.0; 3], 16);
    let lamp = Material { emissive: [5.0, 5.0, 5.0], ..matte(0.0) };
    let (plane, _, camera) = shadowed();
    let object = [ball(0.4, lamp, DVec3::new(0.0, 0.0, 0.8))];
    let p = PathTrace { max_bounces: 0, ..params(64, EnvBlock::Solid) };
    let (out, _) = render(&p, &plane, &object, &camera, &black);
    assert_eq!(mean(&out.without), 0.0);
    assert!(mean(&out.with) > 0.02, "{}", mean(&out.with));
    assert!((covered(&out.object) - 5.0).abs() < 1e-4);
}

// Rows 36, 37 and 41, 48: a black sky, a hot one, a subnormal one, broken triangles, an empty receiver.
#[test]
fn extremes_stay_finite() {
    let (mut plane, objects, rig) = shadowed();
    plane.positions.push([f32::NAN, 0.0, 0.0]);
    plane.triangles.extend([[0, 1, 4], [0, 1, 1]]);
    let mut hot = constant(Up::PlusZ, [1e-9; 3], 32);
    hot.image.pixel_mut(3, 3).fill(1e9);
    for env in [constant(Up::PlusZ, [0.0; 3], 8), hot, constant(Up::PlusZ, [1e-40; 3], 8)] {
        let (out, notes) = render(&params(8, EnvBlock::Auto), &plane, &objects, &rig, &env);
        for images in [&out.without, &out.with, &out.object, &out.variance, &out.normal] {
            assert!(samples(images).iter().all(|v| v.is_finite() && *v >= -1.0));
        }
        for id in ["receiver-not-finite", "receiver-degenerate", "grey-receiver"] {
            assert!(notes.iter().any(|n| n.id == id), "{id}");
        }
    }
    let (out, _) = render(&params(4, EnvBlock::Auto), &Mesh::default(), &[], &rig, &white());
    assert!(samples(&out.without).iter().all(|&v| v == 1.0), "all sky");
}

// Same bytes with one thread and with several.
#[test]
fn threads_do_not_change_a_bit() {
    let (plane, objects, rig) = shadowed();
    let go = |threads: usize| {
        let pool = rayon_pool(threads);
        pool.install(|| {
            let (out, _) = render(&params(8, EnvBlock::Auto), &plane, &objects, &rig, &sunny());
            [samples(&out.with).to_vec(), samples(&out.object).to_vec(), samples(&out.depth).to_vec()]
        })
    };
    assert_eq!(go(1), go(3));
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool")
}

// The standard error that comes out is that of the mean: over many seeds the spread of a pixel is not above
// the estimate for independent samples, and not far below it either.
#[test]
fn variance_is_an_upper_estimate() {
    let (plane, objects, rig) = shadowed();
    let mut runs = Vec::new();
    let mut claimed = 0.0;
    for seed in 0..12 {
        let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed };
        let cx = Context::detached(scene, ".");
        let (out, _) = render_in(&cx, &params(16, EnvBlock::Solid), &plane, &objects, &rig, &sunny());
        claimed += samples(&out.variance).chunks(4).map(|p| f64::from(p[0])).sum::<f64>() / 12.0;
        let s = samples(&out.without);
        runs.push(s.chunks(3).map(|p| f64::from(luminance([p[0], p[1], p[2]]))).collect::<Vec<_>>());
    }
    let mut spread = 0.0;
    for pixel in 0..runs[0].len() {
        let values: Vec<f64> = runs.iter().map(|r| r[pixel]).collect();
        let mean = values.iter().sum::<f64>() / 12.0;
        spread += values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 11.0;
    }
    assert!(spread < 1.1 * claimed && spread > 0.01 * claimed, "{spread} against {claimed}");
}

#[test]
fn nonsense_is_refused() {
    assert!(PathTrace::check(&params(1, EnvBlock::PassBeyond { metres: -1.0 })).is_err());
    assert!(PathTrace::check(&params(1, EnvBlock::FrontFace { max_layers: 0 })).is_err());
    assert!(PathTrace::check(&params(1, EnvBlock::FrontFace { max_layers: 3 })).is_ok());
}
