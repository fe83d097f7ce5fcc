//! The ends of the range: rows of the table of extremes.

use super::*;

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
            // What is left is the rounding of what was there before.
            assert!(lit < 1e-7, "a leak at gap {gap}: {lit}");
        }
        last = lit;
    }
    assert!(last > 0.0);
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

#[test]
fn nonsense_is_refused() {
    assert!(PathTrace::check(&params(1, EnvBlock::PassBeyond { metres: -1.0 })).is_err());
    assert!(PathTrace::check(&params(1, EnvBlock::FrontFace { max_layers: 0 })).is_err());
    assert!(PathTrace::check(&params(1, EnvBlock::FrontFace { max_layers: 3 })).is_ok());
}
