use glam::DVec3;

use super::*;
use scene::types::Primitive;
use testing::context;

/// Pyramid that stands on its square base, 0.4 by 0.4 wide and 1 high, with y up as in glTF.
fn object() -> Arc<Object> {
    let primitive = Primitive {
        positions: vec![
            [-0.2, 0.0, -0.2],
            [0.2, 0.0, -0.2],
            [0.2, 0.0, 0.2],
            [-0.2, 0.0, 0.2],
            [0.0, 1.0, 0.0],
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 1, 4]],
        ..Primitive::default()
    };
    Arc::new(Object { primitives: vec![primitive], ..Object::default() })
}

/// Quad of 4 by 4 at a height, with a slope along x.
fn plane(height: f32, rise: f32) -> Mesh {
    let corner = |x: f32, y: f32| [x, y, height + rise * x];
    Mesh {
        positions: vec![corner(-2.0, -2.0), corner(2.0, -2.0), corner(2.0, 2.0), corner(-2.0, 2.0)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

fn run(mesh: Option<Mesh>, splats: Option<Splats>, z: f64, align: bool) -> Result<DMat4, NodeError> {
    let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, z)) };
    let inputs =
        In { object: object(), pose: Arc::new(pose), mesh: mesh.map(Arc::new), splats: splats.map(Arc::new) };
    Snap::run(&Snap { reach_metres: 0.5, align }, inputs, &context())
        .map(|(out, _)| out.pose.world_from_local)
}

#[test]
fn objects_come_to_stand_from_above_and_below() {
    for z in [0.9, 0.75, 0.4] {
        let pose = run(Some(plane(0.75, 0.0)), None, z, false).unwrap_or_else(|e| panic!("{e}"));
        assert!((pose.w_axis.truncate() - DVec3::new(0.3, 0.1, 0.75)).length() < 1e-6, "{pose}");
    }
    let error = run(Some(plane(0.75, 0.0)), None, 2.0, false).map(|_| ()).expect_err("too far");
    assert!(error.message().contains("0.5 m"), "{error}");
    let reported = format!("{error:?}");
    assert!(reported.contains("the nearest ground is 1.25 m below the foot"), "{reported}");
    assert!(reported.contains("down by 1.25 m, or raise `reach_metres` to 1.26"), "{reported}");
    let error = run(Some(plane(0.0, 1.2)), None, 0.2, false).map(|_| ()).expect_err("too steep");
    assert!(error.message().contains("steeper than 45 degrees"), "{error}");
    assert!(run(None, None, 0.0, false).is_err());
}

/// The origin of the object is its middle, as in many models, so the foot is far below the origin of a pose near
/// the ground.
#[test]
fn what_is_too_far_is_reported_by_the_foot() {
    let mut object = (*object()).clone();
    object.primitives[0].positions.iter_mut().for_each(|p| p[1] -= 0.9);
    let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, 0.1)) };
    let go = |mesh: Mesh, reach_metres: f64| {
        let inputs = In {
            object: Arc::new(object.clone()),
            pose: Arc::new(pose.clone()),
            mesh: Some(Arc::new(mesh)),
            splats: None,
        };
        Snap::run(&Snap { reach_metres, align: false }, inputs, &context())
    };
    let error = go(plane(0.0, 0.0), 0.5).map(|_| ()).expect_err("0.8 m");
    let reported = format!("{error:?}");
    for part in ["0.90 m below the origin", "nearest ground is 0.80 m above", "up by 0.80 m", "to 0.81"] {
        assert!(reported.contains(part), "{part}: {reported}");
    }
    assert!(go(plane(0.0, 0.0), 0.81).is_ok(), "as it says");
    let aside = Mesh { positions: vec![[5.0; 3], [6.0, 5.0, 5.0], [5.0, 6.0, 5.0]], ..plane(0.0, 0.0) };
    let aside = Mesh { triangles: vec![[0, 1, 2]], ..aside };
    let reported = go(aside, 0.5).map(|_| ()).expect_err("none").message().to_owned();
    assert!(reported.contains("there is no ground within 100 m"), "{reported}");
}

#[test]
fn aligned_objects_take_the_normal() {
    let pose = run(Some(plane(0.0, 0.2)), None, 0.1, true).unwrap_or_else(|e| panic!("{e}"));
    let normal = DVec3::new(-0.2, 0.0, 1.0).normalize();
    assert!((pose.transform_vector3(DVec3::Z) - normal).length() < 1e-5, "{pose}");
    // The foot lies on the plane.
    let foot = pose.w_axis.truncate();
    assert!((foot.z - 0.2 * foot.x).abs() < 1e-5, "{foot}");
}

/// Block of 0.4 by 0.4 by 0.4 that stands on a face.
fn block() -> Arc<Object> {
    let corner = |i: u32| [0, 1, 2].map(|k| (i >> k & 1) as f32 * 0.4 - if k == 1 { 0.0 } else { 0.2 });
    let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let positions = (0..8).map(corner).collect();
    let primitive = Primitive { positions, triangles, ..Primitive::default() };
    Arc::new(Object { primitives: vec![primitive], ..Object::default() })
}

/// Ground of 80 by 80 cells that is 2 units wide. `height` returns the height at a position.
fn relief(height: impl Fn(f64, f64) -> f64) -> Mesh {
    let side = 81_u32;
    let mut mesh = Mesh::default();
    for i in 0..side * side {
        let [x, y] = [i % side, i / side].map(|k| f64::from(k) / 40.0 - 1.0);
        mesh.positions.push([x as f32, y as f32, height(x, y) as f32]);
    }
    for i in (0..side * (side - 1)).filter(|i| i % side + 1 < side) {
        mesh.triangles.extend([[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]);
    }
    mesh
}

/// A block on top of a mound, on the rim of a hollow, and on the edge of a rounded kerb (if rotated, also on
/// the street) touches the ground and does not intersect it. In an earlier version, the mound intersected the block
/// by 43 mm.
#[test]
fn on_curved_ground_objects_stand_on_what_they_touch() {
    let exp = |v: f64| f64::from(scene::math::num::f32::exp(v as f32));
    let mound = |x: f64, y: f64| 0.15 * exp(-(x * x + y * y) / 0.18);
    let hollow = |x: f64, y: f64| 0.6 * (x * x + y * y);
    let kerb = |x: f64, _: f64| 0.15 / (1.0 + exp(-x / 0.04));
    let valley = |x: f64, y: f64| 0.5 * (x * x + 0.01).sqrt() + 0.1 * y;
    type Height<'a> = &'a dyn Fn(f64, f64) -> f64;
    let grounds: [(&str, Height<'_>, bool); 4] = [
        ("mound", &mound, false),
        ("hollow", &hollow, false),
        ("kerb", &kerb, true),
        ("valley", &valley, true),
    ];
    for (name, ground, tilts) in grounds {
        for align in [false, true] {
            let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.0, 0.0, 0.1)) };
            let inputs = In {
                object: block(),
                pose: Arc::new(pose),
                mesh: Some(Arc::new(relief(ground))),
                splats: None,
            };
            let (out, notes) = Snap::run(&Snap { reach_metres: 0.5, align }, inputs, &context())
                .unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(notes.iter().any(|note| note.id == "curved-ground"), "{name}");
            let pose = out.pose.world_from_local;
            // Gaps between the underside and the ground below it.
            let gaps: Vec<f64> = (0..41 * 41)
                .map(|i| [i % 41, i / 41].map(|k| f64::from(k) * 0.01 - 0.2))
                .map(|[x, y]| pose.transform_point3(DVec3::new(x, y, 0.0)))
                .map(|p| p.z - ground(p.x, p.y))
                .collect();
            let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
            assert!((-2.5e-3..2e-3).contains(&least), "{name}, {align}: {least}");
            let tilt = pose.transform_vector3(DVec3::Z).truncate().length();
            assert_eq!(tilt > 0.05, align && tilts, "{name}: {tilt}");
            if align && tilts {
                // Three contacts: the middle is as low as possible, so contacts lie on both sides of it.
                let near = |side: f64| {
                    let at = |i: usize| f64::from((i % 41) as u32) * 0.01 - 0.2;
                    gaps.iter().enumerate().any(|(i, gap)| at(i) * side > 0.0 && *gap < 4e-3)
                };
                assert!(near(1.0) && near(-1.0), "{name}");
            }
        }
    }
}

// On a slope the middle of the foot stands on the ground, however large the foot.
/// On a slope, the middle of the foot is put on the ground. This test fails if `bearing` tries only horizontal
/// planes.
#[test]
fn slopes_hold_the_middle_of_the_foot() {
    for rise in [-0.9, -0.3, 0.05, 0.2, 0.6] {
        for align in [false, true] {
            let pose = run(Some(plane(0.0, rise)), None, 0.2, align).unwrap_or_else(|e| panic!("{e}"));
            let foot = pose.w_axis.truncate();
            assert!((foot - DVec3::new(0.3, 0.1, 0.3 * f64::from(rise))).length() < 1e-5, "{rise}: {foot}");
        }
    }
}

/// Objects do not stand on the underside of a table top. If all surfaces face down, they are used as
/// the ground, and this is reported. This test fails if `Ground::columns` ignores the sign of `facing`.
#[test]
fn nothing_stands_on_what_looks_down() {
    let mut slab = plane(0.45, 0.0);
    let below = plane(0.4, 0.0);
    slab.positions.extend(below.positions);
    slab.triangles.extend([[4, 6, 5], [4, 7, 6]]);
    let turned = Mesh { triangles: slab.triangles[2..].to_vec(), ..slab.clone() };
    for (mesh, expected, reported) in [(slab, 0.45, false), (turned, 0.4, true)] {
        let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, 0.38)) };
        let inputs = In { object: object(), pose: Arc::new(pose), mesh: Some(Arc::new(mesh)), splats: None };
        let how = Snap { reach_metres: 0.5, align: false };
        let (out, notes) = Snap::run(&how, inputs, &context()).unwrap_or_else(|e| panic!("{e}"));
        assert!((out.pose.world_from_local.w_axis.z - expected).abs() < 1e-6, "{expected}");
        assert_eq!(notes.iter().any(|note| note.id == "ground-looks-down"), reported);
        assert!(notes.iter().any(|note| note.text.contains("a roughness of 0.0 mm")));
    }
}

/// An object near the edge of a table, or on a stool hardly larger than the object, stays there although the floor
/// extends below and around it. Beyond the edge it moves to the floor. This test fails if `reach` is infinite in
/// `bearing`.
#[test]
fn what_stands_at_an_edge_stays() {
    // A block of 0.4 at x = 0.3 on a top that ends at this distance from its middle.
    for (ends, splats, expected) in
        [(0.21, false, 0.44), (0.2, false, 0.44), (0.1, false, 0.44), (-0.1, false, 0.0), (0.21, true, 0.44)]
    {
        let mut both = plane(0.0, 0.0);
        let mut top = plane(0.44, 0.0);
        top.positions.iter_mut().for_each(|p| p[0] = p[0].min(0.3 + ends));
        both.positions.extend(top.positions);
        both.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.0, 0.44)) };
        let (mesh, splats) = if splats {
            let mut ground = Splats::empty();
            for i in 0..80 * 80 {
                let [x, y] = [i % 80, i / 80].map(|k| k as f32 * 0.02 - 0.8);
                ground.means.push([x, y, 0.0]);
                ground.means.extend((x < 0.3 + ends).then_some([x, y, 0.44]));
            }
            let count = ground.means.len();
            ground.quats = vec![[1.0, 0.0, 0.0, 0.0]; count];
            ground.scales = vec![[0.01; 3]; count];
            ground.opacities = vec![0.9; count];
            ground.sh = vec![[0.0; 3]; count];
            (None, Some(Arc::new(ground)))
        } else {
            (Some(Arc::new(both)), None)
        };
        let inputs = In { object: block(), pose: Arc::new(pose), mesh, splats };
        let how = Snap { reach_metres: 0.5, align: false };
        let (out, _) = Snap::run(&how, inputs, &context()).unwrap_or_else(|e| panic!("{e}"));
        let z = out.pose.world_from_local.w_axis.z;
        assert!((z - expected).abs() < 1e-6, "{ends}: {z}");
    }
}

/// From below a closed shell of ground, only its underside is within reach. The underside supports no object, and
/// the message gives the height of the ground. A room whose normals point outwards is not a shell: its floor faces
/// down, and its ceiling up. This test fails without `shell` in `Ground::ground`.
#[test]
fn the_underside_of_a_shell_bears_nothing() {
    let closed = |top: f32| {
        let (mut mesh, below) = (plane(top, 0.0), plane(0.0, 0.0));
        mesh.positions.extend(below.positions);
        mesh.triangles.extend([[4, 6, 5], [4, 7, 6]]);
        mesh
    };
    for z in [-0.2, 0.1] {
        let error = run(Some(closed(0.65)), None, z, false).map(|_| ()).expect_err("a shell");
        let reported = format!("{error:?}");
        let side = if z < 0.0 { "0.20 m above the foot" } else { "0.10 m below the foot" };
        let up = 0.65 - z;
        for part in [side, "underside of a shell", &format!("up by {up:.2} m")] {
            assert!(reported.contains(part), "{part}: {reported}");
        }
        for (z, reach_metres) in [(z + up, 0.5), (z, up + 0.01)] {
            let pose = Pose { world_from_local: DMat4::from_translation(DVec3::new(0.3, 0.1, z)) };
            let mesh = Some(Arc::new(closed(0.65)));
            let inputs = In { object: object(), pose: Arc::new(pose), mesh, splats: None };
            let how = Snap { reach_metres, align: false };
            let out = Snap::run(&how, inputs, &context()).unwrap_or_else(|e| panic!("{e}")).0;
            assert!((out.pose.world_from_local.w_axis.z - 0.65).abs() < 1e-6, "as it says");
        }
    }
    let pose = run(Some(closed(2.4)), None, 0.1, false).unwrap_or_else(|e| panic!("{e}"));
    assert!(pose.w_axis.z.abs() < 1e-6, "{pose}");
}

// A table above a floor: the object moves to the nearer one.
#[test]
fn of_two_levels_the_nearer_one_holds() {
    let mut both = plane(0.0, 0.0);
    let table = plane(0.4, 0.0);
    both.positions.extend(table.positions);
    both.triangles.extend([[4, 5, 6], [4, 6, 7]]);
    for (z, expected) in [(0.1, 0.0), (0.35, 0.4)] {
        let pose = run(Some(both.clone()), None, z, false).unwrap_or_else(|e| panic!("{e}"));
        assert!((pose.w_axis.z - expected).abs() < 1e-6, "{z}: {pose}");
    }
}

#[test]
fn splats_hold_objects_too() {
    let mut splats = Splats {
        means: Vec::new(),
        means_low: Vec::new(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 400],
        scales: vec![[0.01; 3]; 400],
        opacities: Vec::new(),
        sh_degree: 0,
        sh: vec![[0.0; 3]; 400],
        encoding: scene::types::SplatEncoding::Srgb,
        antialiased: false,
    };
    for i in 0..400_u32 {
        let [x, y] = [i % 20, i / 20].map(|k| k as f32 * 0.05 - 0.4);
        let height = 0.2 + if i % 3 == 0 { 0.004 } else { -0.002 };
        splats.means.push([x, y, if i % 10 == 0 { 0.45 } else { height }]);
        splats.opacities.push(if i % 7 == 0 { 0.1 } else { 0.9 });
    }
    let pose = run(None, Some(splats), 0.0, false).unwrap_or_else(|e| panic!("{e}"));
    assert!((pose.w_axis.z - 0.2).abs() < 0.005, "{pose}");
}

/// A ramp of splats that are larger than the object: no centre lies below the foot, and the object stands on the
/// ramp. This test fails if only centres count.
#[test]
fn splats_larger_than_the_foot_are_ground() {
    let normal = glam::Vec3::new(-0.2, 0.0, 1.0).normalize();
    let q = glam::Quat::from_rotation_arc(glam::Vec3::Z, normal);
    let mut splats = Splats::empty();
    for i in 0..16 {
        let (x, y) = ((i % 4) as f32 * 1.2 - 1.8, (i / 4) as f32 * 1.2 - 1.8);
        splats.means.push([x, y, 0.4 + 0.2 * x]);
        splats.scales.push([0.9, 0.9, 0.001]);
        splats.quats.push([q.w, q.x, q.y, q.z]);
        splats.opacities.push(0.9);
        splats.sh.push([0.0; 3]);
    }
    // A wall nearby is not ground.
    for i in 0..40 {
        splats.means.push([0.45, (i % 8) as f32 * 0.1 - 0.3, (i / 8) as f32 * 0.1 + 0.3]);
        splats.scales.push([0.001, 0.08, 0.08]);
        splats.quats.push([1.0, 0.0, 0.0, 0.0]);
        splats.opacities.push(0.9);
        splats.sh.push([0.0; 3]);
    }
    let pose = run(None, Some(splats), 0.2, false).unwrap_or_else(|e| panic!("{e}"));
    let foot = pose.w_axis.truncate();
    assert!((foot.z - 0.4 - 0.2 * foot.x).abs() < 0.002, "{foot}");
}
