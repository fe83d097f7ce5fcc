//! Tests of how the receiver blocks environment light, and of interreflection in rooms.

use super::*;

// No light reaches the inside of a solid box.
#[test]
fn solid_box_is_black() {
    let object = [ball(0.5, matte(0.5), DVec3::new(0.5, 0.5, 1.0))];
    let (out, _) = render(&params(16, Surroundings::OPEN), &room(), &object, &inside(), &sunny());
    assert!(samples(&out.without).iter().chain(samples(&out.with)).all(|&v| v == 0.0));
    assert_eq!(covered(&out.object), 0.0);
    assert!(samples(&out.depth).iter().all(|d| d.is_finite()));
}

// A black picture is reported, with the reason.
#[test]
fn darkness_is_reported() {
    let reported = |mesh: &Mesh, block, env: &Environment| {
        let (_, notes) = render(&params(1, block), mesh, &[], &inside(), env);
        notes.iter().find(|note| note.id == "no-light").map(|note| note.text.clone()).unwrap_or_default()
    };
    let black = Environment::constant(Up::PlusZ, [0.0; 3], 8);
    assert!(reported(&room(), Surroundings::OPEN, &white()).contains("the mesh blocks all light"));
    assert!(reported(&room(), Surroundings::TRANSPARENT, &black).contains("the environment is black"));
    assert_eq!(reported(&room(), Surroundings::TRANSPARENT, &white()), "");
    assert_eq!(reported(&Mesh::default(), Surroundings::OPEN, &white()), "", "all sky");
}

// With a constant environment of 1, an albedo of 0.5 and a receiver that lets light pass, the radiance is 0.5 for
// any number of bounces.
#[test]
fn passing_box_is_half_lit() {
    for (bounces, block) in
        [(0, Surroundings::TRANSPARENT), (8, Surroundings::TRANSPARENT), (3, Surroundings::ROOM)]
    {
        let p = PathTrace { max_bounces: bounces, ..params(64, block) };
        let (out, _) = render(&p, &room(), &[], &inside(), &white());
        assert!((mean(&out.without) - 0.5).abs() < 5e-4, "{bounces} bounces: {}", mean(&out.without));
    }
    // The direct light is 0.5. With b bounces off solid walls it is 1 - 0.5^(b + 1).
    for (bounces, expected) in [(0, 0.5), (1, 0.75), (2, 0.875), (24, 1.0)] {
        let p = PathTrace { max_bounces: bounces, ..params(64, Surroundings::Transparent { bounces: true }) };
        let (out, _) = render(&p, &room(), &[], &inside(), &white());
        assert!((mean(&out.without) - expected).abs() < 4e-3, "{bounces}: {}", mean(&out.without));
    }
}

// With the visibility printed in the paper, a closed room shows the environment itself, there is no shadow, and a
// matte object is black. Only glossy lobes receive light.
#[test]
fn printed_visibility_lights_nothing() {
    let at = DVec3::new(0.5, 0.5, 1.0);
    let shiny = Material { roughness: 0.0, double_sided: true, ..Material::default() };
    for (material, lit) in [(matte(0.5), false), (shiny, true)] {
        let object = [ball(0.5, material, at)];
        let (out, _) = render(&params(16, Surroundings::Paper), &room(), &object, &inside(), &white());
        assert!(samples(&out.without).iter().chain(samples(&out.with)).all(|&v| v == 1.0));
        assert_eq!(covered(&out.object) > 0.2, lit, "{}", covered(&out.object));
    }
}

// Light that counts twice is reported, with its amount.
#[test]
fn double_counting_is_reported() {
    let reported = |bounces, max_bounces| {
        let p = PathTrace { max_bounces, ..params(1, Surroundings::Transparent { bounces }) };
        let (_, notes) = render(&p, &room(), &[], &inside(), &white());
        let note = notes.iter().find(|n| n.id == "double-count")?;
        let words: Vec<&str> = note.text.split(' ').collect();
        let percent = words.iter().position(|word| *word == "%").expect("a size");
        words[percent - 1].parse::<f64>().ok()
    };
    // Each bounce adds half of the previous light at an albedo of 0.5.
    assert_eq!(reported(false, 8), None);
    for (bounces, expected) in [(0, 0.0), (1, 50.0), (30, 100.0)] {
        let percent = reported(true, bounces).expect("a warning");
        assert!((percent - expected).abs() < 6.0, "{bounces} bounces: {percent} %");
    }
}

// Light samples and scattered rays share one visibility, so the estimate loses no light that one of them cannot
// reach. The reference is the exact sum over the texels of radiance times cosine.
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
                let cosine = equirect::direction(Up::PlusZ, u, v).z.max(0.0);
                let area = equirect::pixel_solid_angle(64, 32, y) / f64::from(sub * sub);
                expected += f64::from(luminance(env.image.rgb(x, y))) * cosine * area;
            }
        }
    }
    expected *= 0.5 / std::f64::consts::PI;
    for block in [Surroundings::OPEN, Surroundings::TRANSPARENT, Surroundings::ROOM] {
        let (out, _) = render(&params(64, block), &up, &[], &top, &env);
        let s = samples(&out.without);
        let got =
            s.chunks(3).map(|p| f64::from(luminance([p[0], p[1], p[2]]))).sum::<f64>() / (s.len() / 3) as f64;
        assert!((got / expected - 1.0).abs() < 2e-3, "{block:?}: {got} against {expected}");
    }
}

/// A slab above the floor of a room blocks a share of the light at a point of the floor. This share is the form
/// factor of the slab, computed by Lambert's sum over the edges of its underside. If the receiver lets light pass,
/// the slab blocks nothing. This test fails if `Block::passes` does not test `hit.back`.
#[test]
fn a_slab_takes_its_form_factor_from_the_floor() {
    let furnished = merge(room(), box_mesh([-0.8, -0.8, 0.9], [0.8, 0.8, 1.0], false));
    let corners = [[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]].map(|[x, y]| DVec3::new(x, y, 0.9));
    for (x, y) in [(0.0, 0.0), (0.7, 0.2), (-0.5, -0.6)] {
        let point = DVec3::new(x, y, 0.0);
        let form = (0..4).map(|k| {
            let [a, b] = [corners[k], corners[(k + 1) % 4]].map(|corner| (corner - point).normalize());
            scene::math::num::f64::acos(a.dot(b)) * a.cross(b).normalize().z
        });
        let form = form.sum::<f64>().abs() / std::f64::consts::TAU;
        let camera = rig(point + DVec3::Z * 0.5, point + DVec3::new(0.0, 1e-6, 0.0), 4, 40.0);
        for (block, expected) in [(Surroundings::TRANSPARENT, 0.5), (Surroundings::ROOM, 0.5 * (1.0 - form))]
        {
            let got = mean(&render(&params(1024, block), &furnished, &[], &camera, &white()).0.without);
            assert!((got / expected - 1.0).abs() < 2e-3, "{block:?} at {x}, {y}: {got} for {expected}");
        }
    }
}

// A slab above the floor is visible but casts no shadow if the receiver lets light pass. With `Room` it casts the
// shadow of a solid body, while the walls stay open.
#[test]
fn only_the_shell_is_open_to_front_faces() {
    let slab = box_mesh([-0.8, -0.8, 0.9], [0.8, 0.8, 1.0], false);
    let furnished = merge(room(), slab);
    let floor = rig(DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.0, 0.01, 0.0), 8, 3.0);
    let lit = |mesh: &Mesh, block| mean(&render(&params(64, block), mesh, &[], &floor, &sunny()).0.without);
    let front = Surroundings::ROOM;
    let open = lit(&room(), Surroundings::TRANSPARENT);
    assert!((lit(&room(), front) / open - 1.0).abs() < 1e-6);
    assert!((lit(&furnished, Surroundings::TRANSPARENT) / open - 1.0).abs() < 1e-6);
    let shaded = lit(&furnished, front);
    // The same slab over a floor in the open, without bounces between the two.
    let open_slab = merge(plane(2.0), box_mesh([-0.8, -0.8, 0.9], [0.8, 0.8, 1.0], false));
    let p = params(64, Surroundings::Open { bounces: false });
    let reference = mean(&render(&p, &open_slab, &[], &floor, &sunny()).0.without);
    assert!(shaded < 0.9 * open && (shaded / reference - 1.0).abs() < 0.02, "{shaded} {reference} {open}");
    // With one layer, a ray that has passed one front face counts as outside. The ray hits the front of the slab
    // first, so the slab no longer casts a shadow.
    assert!((lit(&furnished, Surroundings::Room { layers: 1, bounces: false }) / open - 1.0).abs() < 1e-6);
}

#[test]
fn auto_finds_out_what_the_receiver_is() {
    let decided = |mesh: &Mesh, rig: &Arc<Rig>| {
        let p = PathTrace { max_bounces: 0, ..params(1, Surroundings::Auto) };
        let (_, notes) = render(&p, mesh, &[], rig, &white());
        let note = notes.iter().find(|n| n.id == "surroundings").expect("a decision");
        // The name ends at the first colon outside its parentheses.
        let text = note.text.replace("(layers: ", "(layers=");
        text.split(": ").next().unwrap_or_default().replace("(layers=", "(layers: ")
    };
    assert_eq!(decided(&room(), &inside()), "Room(layers: 3)");
    let outward = box_mesh([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0], false);
    assert_eq!(decided(&outward, &inside()), "Room(layers: 3), normals reversed");
    assert_eq!(decided(&plane(4.0), &rig(DVec3::new(0.0, -3.0, 2.0), DVec3::ZERO, 8, 1.0)), "Open");
    let mut mixed = room();
    for triangle in mixed.triangles.iter_mut().step_by(2) {
        triangle.swap(0, 1);
    }
    assert_eq!(decided(&mixed, &inside()), "Transparent");
}

/// Tested in a room with a hole in a wall, without a known point of capture. In the evening nearly all light comes
/// from the lamp in the room, and the decision is the same from a camera at the hole, which sees much of the
/// outside, as from a camera in a corner. By day the light comes from the hole. This test fails if `Probe::decide`
/// does not use `solid_light`.
#[test]
fn a_window_does_not_take_the_light_of_the_lamp() {
    let mut holed = room();
    holed.triangles.remove(10);
    let mut evening = Environment::constant(Up::PlusZ, [0.08; 3], 64);
    evening.image.samples[..3 * 64 * 4].fill(9.0);
    let mut day = Environment::constant(Up::PlusZ, [0.05; 3], 64);
    for i in 0..64 * 32 {
        let (x, y) = (i % 64, i / 64);
        let [u, v] = [(x as f64 + 0.5) / 64.0, (y as f64 + 0.5) / 32.0];
        if equirect::direction(Up::PlusZ, u, v).x > 0.5 {
            day.image.pixel_mut(x, y).fill(20.0);
        }
    }
    let corner = rig(DVec3::new(-1.5, -1.2, 2.0), DVec3::new(-0.5, -0.5, 0.0), 16, 1.2);
    let window = rig(DVec3::new(1.2, 0.2, 2.0), DVec3::new(-0.5, -0.5, 0.0), 16, 1.2);
    let seen = |mesh: &Mesh, rig: &Arc<Rig>, env: &Environment| {
        let (out, notes) = render(&params(16, Surroundings::Auto), mesh, &[], rig, env);
        let note = notes.iter().find(|n| n.id == "surroundings").expect("a decision");
        (mean(&out.without), note.text.clone())
    };
    for rig in [&corner, &window] {
        let ((closed, _), (open, reported)) = (seen(&room(), rig, &evening), seen(&holed, rig, &evening));
        assert!(
            reported.starts_with("Room") && (open / closed - 1.0).abs() < 0.05,
            "{reported}: {open}, {closed}"
        );
    }
    let (_, reported) = seen(&holed, &window, &day);
    assert!(reported.starts_with("Open") && reported.contains("a solid mesh would let in"), "{reported}");
}

// Surfaces farther away than the radius do not block light. With a radius smaller than the room nothing of the
// walls is left; with a large radius the box is solid.
#[test]
fn pass_beyond_blocks_only_what_is_near() {
    let mut env = white();
    env.origin = Some(DVec3::new(0.0, 0.0, 2.0));
    let lit = |metres| {
        let p = params(64, Surroundings::Within { metres, bounces: false });
        mean(&render(&p, &room(), &[], &inside(), &env).0.without)
    };
    assert!((lit(0.5) - 0.5).abs() < 5e-4);
    assert_eq!(lit(100.0), 0.0);
}

/// Without a point of capture, a camera in the room is used instead, whatever the order of the cameras in the rig.
/// This test fails if `stand_in` always returns the first camera.
#[test]
fn the_order_of_cameras_changes_no_light() {
    let (within, over) = (inside(), rig(DVec3::new(0.5, -6.0, 9.0), DVec3::ZERO, 8, 2.0));
    let pair = |cameras: [&Arc<Rig>; 2]| {
        Arc::new(Rig { cameras: cameras.map(|rig| rig.cameras[0].clone()).to_vec() })
    };
    let seen = |rig: &Arc<Rig>, which: usize| {
        let (out, _) = render(&params(16, Surroundings::Auto), &room(), &[], rig, &white());
        let picture = out.without.0[which].picture.samples().to_vec();
        scene::math::num::ordered_sum(picture.iter().copied()) / picture.len() as f64
    };
    let (first, last) = (seen(&pair([&within, &over]), 0), seen(&pair([&over, &within]), 1));
    assert!(first > 0.4 && (first / last - 1.0).abs() < 1e-3, "{first} {last}");
}
