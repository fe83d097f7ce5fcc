//! Tests of objects on the receiver: shadows, contact, holdout, and reflected light.

use super::*;

// Without objects, and with an object that no ray hits, S is exactly 1.
#[test]
fn without_objects_both_renders_are_equal() {
    let (plane, _, rig) = shadowed();
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    for objects in [&[][..], &far] {
        for block in [Surroundings::OPEN, Surroundings::TRANSPARENT] {
            let (out, _) = render(&params(20, block), &plane, objects, &rig, &sunny());
            assert_eq!(samples(&out.without), samples(&out.with));
            assert!(samples(&out.object).iter().all(|&v| v == 0.0));
        }
    }
}

#[test]
fn objects_cast_shadows_and_are_hidden_from_the_camera() {
    let (plane, objects, rig) = shadowed();
    let (out, _) = render(&params(64, Surroundings::Auto), &plane, &objects, &rig, &sunny());
    let (r0, r1) = (samples(&out.without), samples(&out.with));
    let ratios: Vec<f32> = r0.iter().zip(r1).map(|(a, b)| b / a).collect();
    let dark = ratios.iter().filter(|&&s| s < 0.4).count();
    let same = ratios.iter().filter(|&&s| (s - 1.0).abs() < 0.02).count();
    assert!(dark > 60 && same > ratios.len() / 2, "{dark} {same} of {}", ratios.len());
    // An object of albedo 0.6 on a plane of 0.5 in this light is neither black nor brighter than the sun.
    assert!((0.05..3.0).contains(&covered(&out.object)));
    // A visible object would cover the plane with another colour. A hidden object must not turn pixels of the plane
    // into sky.
    assert!(r1.iter().all(|v| v.is_finite()));
}

// Holdout: where the receiver is in front of the object, the object has an alpha of 0. At the border, alpha is
// partial.
#[test]
fn receiver_in_front_holds_the_object_out() {
    let wall = box_mesh([-3.0, -1.1, 0.0], [0.013, -1.0, 3.0], false);
    let object = [ball(0.5, matte(0.5), DVec3::new(0.0, 0.0, 0.5))];
    let camera = rig(DVec3::new(0.0, -4.0, 0.5), DVec3::new(0.0, 0.0, 0.5), 32, 3.0);
    let (out, _) = render(&params(32, Surroundings::OPEN), &wall, &object, &camera, &white());
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

// Alpha modes: a cut-out with an alpha below the cutoff is invisible, and a blend with an alpha of 0.25 covers a
// quarter.
#[test]
fn alpha_modes_cut_and_blend() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.5), DVec3::new(0.0, 0.0, 0.5), 8, 6.0);
    let cube = box_mesh([-0.5, 0.0, 0.0], [0.5, 0.0, 1.0], false);
    // Only the quad that faces the camera.
    let quad = Mesh { triangles: cube.triangles[4..6].to_vec(), ..cube };
    let covers = |mode, alpha| {
        let material = Material { alpha_mode: mode, base_colour: [0.5, 0.5, 0.5, alpha], ..matte(0.5) };
        let object = [placed(&quad, material, DVec3::ZERO)];
        let (out, _) = render(&params(64, Surroundings::OPEN), &Mesh::default(), &object, &camera, &white());
        samples(&out.object).chunks(4).map(|p| f64::from(p[3])).sum::<f64>() / 64.0
    };
    use scene::types::AlphaMode::{Blend, Mask, Opaque};
    assert_eq!([covers(Opaque, 0.25), covers(Mask(0.5), 0.25), covers(Mask(0.2), 0.25)], [1.0, 0.0, 1.0]);
    assert!((covers(Blend, 0.25) - 0.25).abs() < 0.03);
}

// An emissive object lights the receiver.
#[test]
fn emission_reaches_the_receiver() {
    let black = Environment::constant(Up::PlusZ, [0.0; 3], 16);
    let lamp = Material { emissive: [5.0, 5.0, 5.0], ..matte(0.0) };
    let (plane, _, camera) = shadowed();
    let object = [ball(0.4, lamp, DVec3::new(0.0, 0.0, 0.8))];
    let p = PathTrace { max_bounces: 0, ..params(64, Surroundings::OPEN) };
    let (out, _) = render(&p, &plane, &object, &camera, &black);
    assert_eq!(mean(&out.without), 0.0);
    assert!(mean(&out.with) > 0.02, "{}", mean(&out.with));
    assert!((covered(&out.object) - 5.0).abs() < 1e-4);
}

/// On a mesh with black colours, or with a colour channel of 0, the shadow is complete and has the same colours as
/// on a grey mesh. Captured meshes have such colours where no photograph shows the surface. Raised colours are
/// reported.
#[test]
fn colours_of_the_mesh_do_not_colour_the_shadow() {
    // The plane is so large that the camera sees nothing else.
    let (grey, (_, objects, camera)) = (plane(8.0), shadowed());
    let of = |colour: [f32; 3]| {
        let mesh = Mesh { colours: vec![colour; 4], ..grey.clone() };
        let how = PathTrace { max_bounces: 0, ..params(16, Surroundings::OPEN) };
        let (out, notes) = render(&how, &mesh, &objects, &camera, &sunny());
        let raised = notes.iter().any(|note| note.id == "raised-albedo");
        let ratios: Vec<f32> =
            samples(&out.without).iter().zip(samples(&out.with)).map(|(a, b)| b / a).collect();
        (ratios, raised)
    };
    let (expected, raised) = of([0.5; 3]);
    assert!(!raised && expected.iter().any(|s| *s < 0.3));
    for colour in [[0.0, 0.35, 0.0], [0.0; 3], [0.02; 3]] {
        let (got, raised) = of(colour);
        assert_eq!(raised, colour[0] == 0.0);
        let off = got.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 1e-4, "{colour:?}: {off}");
    }
}

/// With `shadow_only`, `with` stays the same bit for bit wherever the object is not visible, and no rays are
/// traced for the object.
#[test]
fn a_shadow_alone_is_the_shadow() {
    let (plane, objects, rig) = shadowed();
    let trace = |shadow_only: bool| {
        let cx = context();
        let params = PathTrace { shadow_only, crop: 0.001, ..params(16, Surroundings::OPEN) };
        let (out, notes) = render_in(&cx, &params, &plane, &objects, &rig, &sunny());
        assert!(notes.iter().all(|note| note.id != "objects-not-seen"));
        (out, cx.counts()["rays"])
    };
    let ((whole, rays), (alone, fewer)) = (trace(false), trace(true));
    assert_eq!(samples(&whole.without), samples(&alone.without));
    assert_eq!(samples(&whole.with), samples(&alone.with));
    assert!(samples(&alone.object).iter().all(|&v| v == 0.0) && mean(&whole.object) > 0.0);
    // Each sample that shows the object takes a camera ray and some rays to the light. Other samples take none.
    let shown: f32 = samples(&whole.object).chunks(4).map(|o| 16.0 * o[3]).sum();
    assert!((rays - fewer) as f32 > 8.0 * shown && shown > 100.0, "{fewer} of {rays} rays, {shown} samples");
    // Only the ground is visible.
    assert!(samples(&alone.normal).chunks(3).all(|n| n[2] > 0.99 || n == [0.0; 3]));
}

/// An object that is inside out is black whatever the number of bounces, so the advice is about its faces; and one
/// that is seen only from behind is reported as that. In an earlier version the advice was to raise `max_bounces`,
/// or to check the axes.
#[test]
fn faces_seen_from_behind_are_reported_as_that() {
    let camera = rig(DVec3::new(0.0, -4.0, 0.5), DVec3::new(0.0, 0.0, 0.5), 16, 24.0);
    let single = Material { double_sided: false, ..matte(0.9) };
    let has = |notes: &Notes, id: &str| notes.iter().any(|note| note.id == id);
    for (inward, max_bounces) in [(true, 4), (true, 64), (false, 4)] {
        let cube = box_mesh([-0.5, -0.5, 0.0], [0.5, 0.5, 1.0], inward);
        let params = PathTrace { max_bounces, ..params(4, Surroundings::OPEN) };
        let object = [placed(&cube, single.clone(), DVec3::ZERO)];
        let (out, notes) = render(&params, &plane(4.0), &object, &camera, &white());
        assert_eq!(has(&notes, "faces-from-behind"), inward, "{max_bounces}");
        assert!(!has(&notes, "paths-cut"), "{inward} {max_bounces}");
        assert_eq!(covered(&out.object) < 0.01, inward);
    }
    let away =
        Mesh { triangles: plane(0.5).triangles.iter().map(|t| [t[0], t[2], t[1]]).collect(), ..plane(0.5) };
    let above = rig(DVec3::new(0.0, -2.0, 3.0), DVec3::new(0.0, 0.0, 0.5), 16, 24.0);
    let object = [placed(&away, single, DVec3::new(0.0, 0.0, 0.5))];
    let (_, notes) = render(&params(4, Surroundings::OPEN), &plane(4.0), &object, &above, &white());
    let note = notes.iter().find(|note| note.id == "objects-not-seen");
    assert!(note.is_some_and(|note| note.text.contains("only from behind")), "{note:?}");
}

/// Among several objects, an object under the ground or outside the view is named, with the reason. An object
/// behind or inside another object, which may be made of glass, is not named. This test fails if `unseen` does not
/// call `is_before`, or if `met` is always true.
#[test]
fn one_of_several_objects_that_is_not_seen_is_named() {
    let (plane, objects, rig) = shadowed();
    let behind = ball(0.2, matte(0.5), DVec3::new(0.0, 1.0, 0.2));
    for (second, expected) in [
        // Behind the other one as the camera sees it.
        (
            ball(0.1, matte(0.5), DVec3::new(0.0, 1.5, -0.39)),
            Some(("object-hidden", "the receiver mesh hides object 1 ")),
        ),
        (
            ball(0.2, matte(0.5), DVec3::new(0.3, -0.5, -0.5)),
            Some(("object-hidden", "the receiver mesh hides object 1 ")),
        ),
        (
            ball(0.2, matte(0.5), DVec3::new(9.0, 0.0, 0.2)),
            Some(("object-outside", "no view shows object 1;")),
        ),
        (ball(0.1, matte(0.5), DVec3::new(0.0, 0.0, 0.4)), None),
        (behind, None),
    ] {
        let both = [objects[0].clone(), second];
        let (_, notes) = render(&params(4, Surroundings::OPEN), &plane, &both, &rig, &white());
        let reported = notes.iter().find(|note| ["object-hidden", "object-outside"].contains(&&*note.id));
        assert_eq!(reported.map(|note| note.id.as_str()), expected.map(|(id, _)| id));
        if let (Some(note), Some((_, text))) = (reported, expected) {
            assert!(note.text.starts_with(text), "{}", note.text);
        }
    }
}

/// Tests `nearest` for rods a third of a pixel wide, and for a pane with a coverage of a third. `nearest` is their
/// depth wherever any of the first 16 samples of a pixel hits them, and otherwise a tenth of their size above the
/// plane, which the camera sees from a height of 2 m. `depth` is the
/// depth of the first surface at the centre of the pixel that covers more than half.
#[test]
fn nearest_is_what_shows_anywhere_in_a_pixel() {
    let rod = box_mesh([-0.01, -0.01, 0.0], [0.01, 0.01, 1.0], false);
    let rods: Vec<_> =
        (0..7).map(|i| placed(&rod, matte(0.5), DVec3::X * (0.137 * f64::from(i) - 0.5))).collect();
    let sheet = Mesh {
        positions: vec![[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, 1.0], [-0.5, 0.0, 1.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    let glimpse = Material {
        base_colour: [0.5, 0.5, 0.5, 0.3],
        alpha_mode: scene::types::AlphaMode::Blend,
        ..matte(0.5)
    };
    let camera = rig(DVec3::new(0.0, -4.0, 2.0), DVec3::new(0.0, 0.0, 0.5), 32, 4.0);
    let one = |images: &Images, i: usize| samples(images)[i];
    for (name, objects) in [("rods", rods), ("pane", vec![placed(&sheet, glimpse, DVec3::ZERO)])] {
        let go = |objects: &[_]| {
            render(&params(16, Surroundings::Auto), &plane(4.0), objects, &camera, &white()).0
        };
        let (out, bare) = (go(&objects), go(&[]));
        let (mut shown, mut missed) = (0, 0);
        for i in 0..32 * 32 {
            let [depth, nearest, ground] = [&out.depth, &out.nearest, &bare.depth].map(|z| one(z, i));
            assert_eq!(ground, one(&bare.nearest, i));
            if samples(&out.object)[4 * i + 3] > 0.0 {
                shown += 1;
                missed += u32::from(depth == ground);
                // The plane of the objects, seen along the camera's axis: 4 m aside and 0.5 to 2 m below.
                assert!((3.85..4.5).contains(&nearest), "{name}, {i}: {nearest}");
                assert!(nearest <= ground + 1e-5, "{name}, {i}: {nearest} {ground}");
            } else if name == "rods" {
                let height = 2.0 * (1.0 - nearest / depth);
                let is_low = (height - 0.1).abs() < 1e-4;
                assert!(if depth.is_finite() { is_low } else { nearest == depth }, "{i}: {height}");
            }
        }
        assert!(
            shown > 100 && 3 * missed > shown,
            "{name}: {missed} of {shown} have the ground at the centre"
        );
    }
}
