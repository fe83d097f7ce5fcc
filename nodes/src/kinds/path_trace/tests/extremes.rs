//! Tests at the ends of the parameter ranges, which are listed in `docs/evidence/extremes.md`.

use super::*;
use testing::row;

// White furnace: a closed object in a white sky, with a receiver that lets light pass. Matte white and metal both
// give 1.
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
                render(&params(64, Surroundings::OPEN), &Mesh::default(), &object, &Arc::new(far), &white());
            let got = covered(&out.object);
            assert!((got - 1.0).abs() < tolerance, "{} {}: {got}", material.metallic, material.roughness);
        }
    }
}

/// A white body is white in every pose: mirrored, with two axes swapped, sheared, mirrored and sheared, or
/// flattened to a hundredth.
#[test]
fn a_white_body_is_white_in_every_pose() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 24, 1.5);
    let body = ball(0.8, Material { double_sided: false, ..matte(1.0) }, DVec3::ZERO);
    for columns in [
        [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0, 0.7, 1.0, 0.0, -0.4, 0.9, 1.0],
        [-1.0, 0.2, 0.3, 0.7, 1.0, 0.0, -0.4, 0.9, -0.5],
        [1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 1.0],
    ] {
        let world_from_object = DMat4::from_mat3(glam::DMat3::from_cols_array(&columns));
        let posed = [Arc::new(Placed { object: body.object.clone(), world_from_object })];
        let (out, _) = render(&params(16, Surroundings::OPEN), &Mesh::default(), &posed, &camera, &white());
        let lost = (covered(&out.object) - 1.0).abs();
        row(68, "light lost or made by a white body, mirrored, sheared or flat", lost, 0.01);
    }
}

/// A white ball in a white sky is white. If rays from its surface hit the ball again, it would be dark.
/// Tested at sizes of a millionth and a million units, and at a distance from the origin of about ten
/// thousand times its size.
#[test]
fn far_and_tiny_objects_do_not_shade_themselves() {
    let camera = rig(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, 24, 1.5);
    let seen = |scale: f64, at: DVec3, receiver: &Mesh| {
        let ball = ball(0.8, matte(1.0), DVec3::ZERO);
        let world_from_object = DMat4::from_translation(at) * DMat4::from_scale(DVec3::splat(scale));
        let object = [Arc::new(Placed { object: ball.object.clone(), world_from_object })];
        let mut moved = (*camera).clone();
        for k in 0..3 {
            let way = &mut moved.cameras[0].world_from_camera[12 + k];
            *way = *way * scale + at.to_array()[k];
        }
        let (out, _) = render(&params(16, Surroundings::OPEN), receiver, &object, &Arc::new(moved), &white());
        covered(&out.object)
    };
    let empty = Mesh::default();
    let plain = seen(1.0, DVec3::ZERO, &empty);
    assert!((plain - 1.0).abs() < 0.01, "{plain}");
    let change = |scale, at| (seen(scale, at, &empty) - plain).abs();
    row(42, "change of the light of an object of 1e-6", change(1e-6, DVec3::ZERO), 1e-6);
    row(42, "change of the light of an object of 1e6", change(1e6, DVec3::ZERO), 1e-6);
    row(42, "change 1e6 from the origin", change(1.0, DVec3::new(1e6, -2e6, 5e5)), 1e-6);
    let aside = seen(1.0, DVec3::new(6e3, 0.0, 8e3), &plane(3.0));
    row(42, "change 1e4 from the receiver", (aside - plain).abs(), 1e-3);
}

/// The shadow of a ball on a floor does not depend on the rest of the mesh, such as a stray triangle far
/// away, or a floor of two triangles that reach to the horizon.
#[test]
fn a_stray_triangle_and_a_huge_floor_change_nothing() {
    let (_, objects, rig) = shadowed();
    let picture = |receiver: &Mesh| {
        let (out, notes) = render(&params(16, Surroundings::OPEN), receiver, &objects, &rig, &sunny());
        assert!(!notes.iter().any(|note| note.id == "coarse-coordinates"));
        [samples(&out.with).to_vec(), samples(&out.without).to_vec(), samples(&out.object).to_vec()].concat()
    };
    let off = |a: &[f32], b: &[f32]| {
        let total: f32 = a.iter().sum();
        f64::from(a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / total)
    };
    let plain = picture(&plane(100.0));
    for far in [1e5, 1e8] {
        let mut stray = plane(1.0);
        stray.positions = vec![[far, far, -far], [far, far + 1000.0, -far], [far + 1000.0, far, -far]];
        stray.triangles = vec![[0, 1, 2]];
        let change = off(&plain, &picture(&merge(plane(100.0), stray)));
        row(42, "change of the picture by a stray triangle, relative", change, 1e-6);
    }
    for half in [1e4, 1e6] {
        let change = off(&plain, &picture(&plane(half)));
        row(42, "change of the picture by a floor of 2e6, relative", change, 2e-3);
    }
}

// Coordinates that are still too coarse are reported.
#[test]
fn an_object_too_far_for_its_size_is_reported() {
    let reported = |distance: f64| {
        let camera = rig(DVec3::new(0.0, -distance, 0.0), DVec3::ZERO, 4, 2.0 * distance);
        let object = [ball(0.5, matte(0.5), DVec3::ZERO)];
        let (_, notes) = render(&params(1, Surroundings::OPEN), &plane(2.0), &object, &camera, &white());
        notes.iter().any(|note| note.id == "coarse-coordinates")
    };
    assert!(!reported(1e3) && reported(1e4));
}

// A whole scene (receiver, objects and camera) that is moved by 1e6, or made a million times larger or smaller,
// gives the same picture, except for samples that rounding moves across an edge.
#[test]
fn a_scene_may_lie_anywhere_and_have_any_size() {
    let (plane, objects, rig) = shadowed();
    let picture = |scale: f64, by: DVec3| {
        let scene = DMat4::from_translation(by) * DMat4::from_scale(DVec3::splat(scale));
        let mut receiver = plane.clone();
        for p in &mut receiver.positions {
            *p = scene.transform_point3(DVec3::from_array(p.map(f64::from))).as_vec3().to_array();
        }
        let moved = |o: &Arc<Placed>| {
            Arc::new(Placed { object: o.object.clone(), world_from_object: scene * o.world_from_object })
        };
        let objects: Vec<_> = objects.iter().map(moved).collect();
        let mut camera = (*rig).clone();
        let pose = &mut camera.cameras[0].world_from_camera;
        for k in 0..3 {
            pose[12 + k] = pose[12 + k] * scale + by.to_array()[k];
        }
        let p = params(16, Surroundings::OPEN);
        let (out, _) = render(&p, &receiver, &objects, &Arc::new(camera), &sunny());
        [samples(&out.without).to_vec(), samples(&out.with).to_vec(), samples(&out.object).to_vec()].concat()
    };
    let plain = picture(1.0, DVec3::ZERO);
    let total: f32 = plain.iter().sum();
    for (scale, by) in [
        (1e-6, DVec3::ZERO),
        (1e6, DVec3::ZERO),
        (1.0, DVec3::new(1e6, -1e6, 1e6)),
        (1.0 / 1_048_576.0, DVec3::ZERO),
    ] {
        let off: f32 = plain.iter().zip(picture(scale, by)).map(|(a, b)| (a - b).abs()).sum();
        assert!(off < 1e-3 * total, "{scale} {by}: {off} of {total}");
    }
}

/// The floor under a box is dark, except for the light that enters through the gap between them, for any height of
/// the gap. No light leaks in if the height is 0.
#[test]
fn contact_shadow_is_dark_and_monotone_in_the_gap() {
    let below = rig(DVec3::new(0.0, 0.0, 3.0), DVec3::new(0.0, 0.001, 0.0), 6, 20.0);
    let mut last = 0.0;
    for gap in [0.0, 1e-6, 1e-4, 1e-2, 1e-1] {
        let cube = box_mesh([-0.5, -0.5, 0.0], [0.5, 0.5, 1.0], false);
        let object = [placed(&cube, matte(0.5), DVec3::new(0.0, 0.0, gap))];
        let (out, _) = render(&params(16, Surroundings::OPEN), &plane(3.0), &object, &below, &white());
        let lit = mean(&out.with);
        assert!(lit >= last - 1e-3, "gap {gap}: {lit} after {last}");
        if gap <= 1e-6 {
            row(43, "light that leaks under a box without a gap", lit, 0.0);
        }
        last = lit;
    }
    assert!(last > 0.0);
}

/// The error of S, averaged over a part of the image, falls at least with the square root of the number of samples,
/// for any seed. The result of a single sample is finite and unbiased.
#[test]
fn errors_fall_with_samples_whatever_the_seed() {
    let (plane, objects, rig) = shadowed();
    let mut small = (*rig).clone();
    let camera = &mut small.cameras[0];
    (camera.width_px, camera.height_px) = (12, 12);
    (camera.cx, camera.cy) = (camera.cx - 10.0, camera.cy - 10.0);
    let small = Arc::new(small);
    let with = |n, seed| {
        let cx =
            Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed, exhaustive: false }, ".");
        let (out, _) = render_in(&cx, &params(n, Surroundings::OPEN), &plane, &objects, &small, &sunny());
        samples(&out.with).iter().map(|v| f64::from(*v)).collect::<Vec<_>>()
    };
    let truth = with(4096, 1);
    let seeds = [0, 1 << 63, u64::MAX - 1, u64::MAX];
    let error = |n| {
        let squares = seeds.iter().flat_map(|&seed| {
            with(n, seed).into_iter().zip(&truth).map(|(a, b)| (a - b) * (a - b)).collect::<Vec<_>>()
        });
        squares.sum::<f64>().sqrt()
    };
    let (one, few, many) = (error(1), error(4), error(64));
    row(47, "error at 64 samples over that at 4", many / few, 0.25);
    row(47, "error at 4 samples over that at 1", few / one, 0.5);
    let all = |n, seed| with(n, seed).iter().sum::<f64>();
    let mean = (0..32).map(|seed| all(1, seed * 0x9E37_79B9_7F4A_7C15 + 1)).sum::<f64>() / 32.0;
    let off = (mean / truth.iter().sum::<f64>() - 1.0).abs();
    row(47, "bias of one sample, by the mean of 32", off, 0.01);
}

/// The maximum number of samples is summed in double precision, and the mean agrees with a closed form at least as
/// well as the mean of independent samples would. This test fails if `Accumulator::add` keeps `*sum` in single
/// precision.
#[test]
fn a_million_samples_add_up() {
    const MOST: u32 = 1 << 20;
    let one = |receiver: &Mesh, env: &Environment, n| {
        let camera = rig(DVec3::new(0.0, 0.0, 1.0), DVec3::new(0.0, 1e-3, 0.0), 1, 50.0);
        mean(&render(&params(n, Surroundings::TRANSPARENT), receiver, &[], &camera, env).0.without)
    };
    let tenth = Environment::constant(Up::PlusZ, [0.1; 3], 8);
    let off = (one(&Mesh::default(), &tenth, MOST) / f64::from(0.1_f32) - 1.0).abs();
    row(47, "error of the mean of 2^20 equal samples, relative", off, 1e-6);
    // Half of the sky's light falls on a floor of albedo 1/2 under an even sky.
    let error = |n| (one(&plane(4.0), &tenth, n) / f64::from(0.05_f32) - 1.0).abs();
    row(47, "error of 2^20 samples of an even sky, relative", error(MOST), 1e-5);
}

/// Scaling the light by 2^-80 scales every value exactly. At 1e-40 of the light, where values are subnormal, the
/// ratio changes by at most 0.01.
#[test]
fn light_of_any_strength_gives_the_same_picture() {
    let (plane, objects, rig) = shadowed();
    let at = |scale: f32| {
        let mut env = sunny();
        env.image.samples.iter_mut().for_each(|v| *v *= scale);
        let (out, _) = render(&params(8, Surroundings::OPEN), &plane, &objects, &rig, &env);
        [samples(&out.without).to_vec(), samples(&out.with).to_vec(), samples(&out.object).to_vec()]
    };
    let dimmer = f32::from_bits((127 - 80) << 23);
    let (plain, dim) = (at(1.0), at(dimmer));
    let changed = |layer: usize, channels: usize| {
        let pairs = plain[layer].iter().zip(&dim[layer]).enumerate();
        let colour = pairs.filter(|(i, _)| i % channels < 3);
        colour.filter(|(_, (a, b))| **a * dimmer != **b).count() as f64
    };
    let (without, with, object) = (changed(0, 3), changed(1, 3), changed(2, 4));
    row(48, "values that differ at 2^-80 of the light", without + with + object, 0.0);
    let faint = at(1e-40);
    let ratio = |of: &[Vec<f32>; 3]| -> Vec<f64> {
        of[1].iter().zip(&of[0]).map(|(a, b)| f64::from(*a) / f64::from(*b).max(1e-300)).collect()
    };
    let off = ratio(&plain).iter().zip(ratio(&faint)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    row(48, "change of the ratio at 1e-40 of the light", off, 1e-2);
}

/// The variance of the ratio does not depend on the unit of light, bit for bit; variances of light beyond single
/// precision are finite and reported.
#[test]
fn the_noise_of_the_ratio_is_that_of_any_light() {
    let (plane, objects, rig) = shadowed();
    let at = |exponent: i32| {
        let scale = f32::from_bits(((127 + exponent) << 23) as u32);
        let mut env = sunny();
        env.image.samples.iter_mut().for_each(|v| *v *= scale);
        let (out, notes) = render(&params(8, Surroundings::OPEN), &plane, &objects, &rig, &env);
        assert!(samples(&out.variance).iter().all(|v| v.is_finite()));
        let ratio: Vec<f32> = samples(&out.variance).iter().skip(3).step_by(4).copied().collect();
        (ratio, notes.iter().any(|note| note.id == "variance-range"))
    };
    let (plain, reported) = at(0);
    assert!(!reported && plain.iter().any(|v| *v > 0.0));
    for exponent in [-80, 66, 100] {
        let (ratio, reported) = at(exponent);
        let off = ratio.iter().zip(&plain).filter(|(a, b)| a != b).count();
        row(48, "variances of the ratio that differ at 2^-80, 2^66 and 2^100 of the light", off as f64, 0.0);
        assert!(reported, "2^{exponent}");
    }
}

// One sample gives no variance, which is reported.
#[test]
fn one_sample_reports_no_variance() {
    let (plane, objects, rig) = shadowed();
    let reported = |n| {
        let (out, notes) = render(&params(n, Surroundings::OPEN), &plane, &objects, &rig, &sunny());
        let views = out.report.tables.iter().find(|table| table.name == "views").expect("is there");
        let error = views.rows[0][2] == scene::types::Cell::Missing;
        let noise = samples(&out.variance).iter().any(|v| *v != 0.0);
        (error, noise, notes.iter().any(|note| note.id == "no-variance"))
    };
    assert_eq!((reported(1), reported(2)), ((true, false, true), (false, true, false)));
}

// A black, a very bright and a subnormal sky, broken triangles, and an empty receiver.
#[test]
fn extremes_stay_finite() {
    let (mut plane, objects, rig) = shadowed();
    plane.positions.push([f32::NAN, 0.0, 0.0]);
    plane.triangles.extend([[0, 1, 4], [0, 1, 1]]);
    let mut hot = Environment::constant(Up::PlusZ, [1e-9; 3], 32);
    hot.image.pixel_mut(3, 3).fill(1e9);
    for env in
        [Environment::constant(Up::PlusZ, [0.0; 3], 8), hot, Environment::constant(Up::PlusZ, [1e-40; 3], 8)]
    {
        let (out, notes) = render(&params(8, Surroundings::Auto), &plane, &objects, &rig, &env);
        for images in [&out.without, &out.with, &out.object, &out.variance, &out.normal] {
            assert!(samples(images).iter().all(|v| v.is_finite() && *v >= -1.0));
        }
        for id in ["receiver-not-finite", "receiver-degenerate", "grey-receiver"] {
            assert!(notes.iter().any(|n| n.id == id), "{id}");
        }
    }
    let (out, _) = render(&params(4, Surroundings::Auto), &Mesh::default(), &[], &rig, &white());
    assert!(samples(&out.without).iter().all(|&v| v == 1.0), "all sky");
}

#[test]
fn nonsense_is_refused() {
    assert!(PathTrace::check(&params(1, Surroundings::Within { metres: -1.0, bounces: false })).is_err());
    assert!(PathTrace::check(&params(1, Surroundings::Room { layers: 0, bounces: false })).is_err());
    assert!(PathTrace::check(&params(1, Surroundings::ROOM)).is_ok());
}
