use super::*;
use engine::{Scene, encode_to_vec};

fn params(place: Setting) -> DemoScene {
    DemoScene {
        place,
        splats: 10000,
        width_px: 240,
        height_px: 135,
        truth_width_px: 64,
        ..DemoScene::default()
    }
}

fn make(params: &DemoScene, seed: u64, up: Up, metres_per_unit: f64) -> Out {
    let cx = Context::detached(Scene { up, metres_per_unit, seed, exhaustive: false }, ".");
    DemoScene::run(params, In {}, &cx).expect("runs").0
}

/// Number of edges that triangles do not use equally often in both directions. It is 0 for a closed mesh.
fn open_edges(mesh: &Mesh) -> usize {
    let mut edges = std::collections::BTreeMap::new();
    for [a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((*from.min(to), *from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    edges.values().filter(|&&n| n != 0).count()
}

/// Outputs for the room, made once for several tests.
fn room_of_seed_7() -> &'static Out {
    static ROOM: std::sync::OnceLock<Out> = std::sync::OnceLock::new();
    ROOM.get_or_init(|| make(&params(Setting::Room), 7, Up::PlusZ, 1.0))
}

fn check(out: &Out, stand: f64) {
    let params = params(Setting::Room);
    let splats = &out.splats;
    let wanted = params.splats as usize;
    assert!((wanted * 7 / 10..wanted * 3 / 2).contains(&splats.len()), "{} splats", splats.len());
    assert_eq!(splats.sh.len(), splats.len() * splats.sh_len());
    let numbers = splats.means.as_flattened().iter().chain(splats.scales.as_flattened());
    assert!(numbers.chain(splats.sh.as_flattened()).chain(&splats.opacities).all(|v| v.is_finite()));
    assert!(splats.opacities.iter().all(|o| (0.0..=1.0).contains(o)));
    for q in &splats.quats {
        assert!((q.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-5);
    }
    // A capture is clipped: from the directions it was fitted to, no colour is far above white.
    let white = splats.sh.chunks_exact(splats.sh_len()).map(|sh| 0.5 + 0.2821 * sh[0][1]);
    let (mut bright, mut most) = (0, 0.0_f32);
    for value in white {
        bright += u32::from(value > 0.99);
        most = most.max(value);
    }
    assert!(bright > 20 && most < 1.15, "{bright} white splats, the brightest {most}");

    let proxy = &out.proxy;
    assert_eq!(open_edges(proxy), 0, "the proxy is closed");
    assert_eq!(proxy.colours.len(), proxy.positions.len());
    assert!(proxy.colours.as_flattened().iter().all(|c| (0.0..=1.0).contains(c)));

    // The true light contains what the capture lost, and lies where the documentation says.
    let truth = &out.truth_env;
    assert_eq!(truth.origin, Some(DVec3::new(0.0, 0.0, stand + params.probe_height)));
    let peak = truth.image.samples.iter().fold(0.0_f32, |m, v| m.max(*v));
    assert!(peak > 4.0 && peak.is_finite(), "{peak}");
    assert!(truth.image.samples.iter().all(|v| *v >= 0.0));
    assert!(matches!((truth.image.width, truth.image.height, truth.image.channels), (64, 32, 3)));

    // The camera sees the object.
    let camera = &out.rig.cameras[0];
    let at = camera.camera_from_world().transform_point3(DVec3::new(0.0, 0.0, stand + 0.2));
    let (x, y) = (camera.fx * at.x / at.z + camera.cx, camera.fy * at.y / at.z + camera.cy);
    assert!(at.z > 1.0 && (60.0..180.0).contains(&x) && (30.0..105.0).contains(&y), "({x}, {y})");
}

#[test]
fn the_room_is_what_its_doc_says() {
    check(room_of_seed_7(), room::TABLE);
}

#[test]
fn the_courtyard_is_what_its_doc_says() {
    check(&make(&params(Setting::Courtyard), 7, Up::PlusZ, 1.0), 0.0);
}

#[test]
fn one_seed_one_scene_and_another_seed_another() {
    let (one, again) = (room_of_seed_7(), make(&params(Setting::Room), 7, Up::PlusZ, 1.0));
    assert_eq!(encode_to_vec(&*one.splats), encode_to_vec(&*again.splats));
    assert_eq!(encode_to_vec(&*one.truth_env), encode_to_vec(&*again.truth_env));
    assert_eq!(encode_to_vec(&*one.proxy), encode_to_vec(&*again.proxy));
    for layout in [room::layout, courtyard::layout] {
        let corners = |seed| layout(seed).shapes.quads.iter().map(|quad| quad.p).collect::<Vec<_>>();
        assert_ne!(corners(7), corners(8));
    }
}

// The same room in another frame: every position is rotated with the axes and scaled with the unit.
#[test]
fn frames_differ_by_a_turn_and_a_scale() {
    let (z, y) = (room_of_seed_7(), make(&params(Setting::Room), 7, Up::MinusY, 0.5));
    let [right, forward, above] = equirect::axes(Up::MinusY);
    for (a, b) in z.splats.means.iter().zip(&y.splats.means) {
        let want = (right * f64::from(a[0]) + forward * f64::from(a[1]) + above * f64::from(a[2])) * 2.0;
        assert!((want - DVec3::from(b.map(f64::from))).length() < 1e-5);
    }
    assert_eq!(z.truth_env.image, y.truth_env.image);
}
