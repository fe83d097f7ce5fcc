//! Tests of depth modes, blend counts and the limiting surface ([`Limit`]).

use super::*;

const MIDDLE: usize = 16 * 33 + 16;

/// Two splats in front of the camera: one at depth 2 with opacity 0.4, and one at depth 6 with opacity 0.9.
fn pair() -> Splats {
    let near = one([0.0, 0.0, 2.0], [0.8; 3], 0.4, [1.0; 3]);
    join(&[&one([0.0, 0.0, 6.0], [2.0; 3], 0.9, [-1.0; 3]), &near])
}

#[test]
fn transmittance_depth_is_nearer_than_expected_depth() {
    for precision in [Precision::F32, Precision::F64] {
        let settings = Settings { precision, depth: DepthMode::Transmittance, ..F64 };
        let seen = draw(&pair(), &camera(33, 33, 60.0), settings);
        let (w0, w1) = (0.4, 0.6 * 0.6 * 0.9);
        let expected = (w0 * 2.0 + w1 * 6.0) / (w0 + w1);
        assert!((f64::from(seen.depth[MIDDLE]) - expected).abs() < 1e-2, "{}", seen.depth[MIDDLE]);
        let splats = cloud(400, 77);
        let by = |depth| draw(&splats, &camera(60, 40, 80.0), Settings { precision, depth, ..F64 }).depth;
        let (mean, front) = (by(DepthMode::Expected), by(DepthMode::Transmittance));
        for (mean, front) in mean.iter().zip(&front) {
            assert!(front <= &(mean * 1.000_01), "{front} beyond {mean}");
        }
        let sum = |depth: &[f32]| depth.iter().filter(|d| d.is_finite()).sum::<f32>();
        assert!(sum(&front) < 0.99 * sum(&mean));
    }
}

#[test]
fn counts_are_the_blends_and_change_nothing_else() {
    let splats = cloud(500, 31);
    let camera = camera(51, 37, 80.0);
    for precision in [Precision::F32, Precision::F64] {
        let plain = draw(&splats, &camera, Settings { precision, ..F64 });
        let counted = draw(&splats, &camera, Settings { precision, count_blends: true, ..F64 });
        assert_eq!(bits(&plain), bits(&counted));
        assert!(plain.blends.is_empty() && counted.blends.len() == 51 * 37);
        let sum: f64 = counted.blends.iter().map(|n| f64::from(*n)).sum();
        assert_eq!(sum as u64, counted.work.blends);
        for (n, pixel) in counted.blends.iter().zip(counted.rgba.as_chunks::<4>().0) {
            assert_eq!(*n > 0.0, pixel[3] > 0.0);
        }
    }
}

fn before(splats: &Splats, camera: &Camera, limit: &Image<Data>, settings: Settings) -> Rendered {
    render(splats, camera, Some(Limit { depth: limit, sigmas: 0.0 }), &settings, &context()).expect("renders")
}

// Splats at or behind the surface have no effect, per pixel.
#[test]
fn a_surface_in_front_ends_the_blend() {
    let splats = cloud(500, 12);
    let camera = camera(50, 40, 80.0);
    let all = |value: f32| Image::<Data>::from_samples(50, 40, 1, vec![value; 50 * 40]);
    for settings in [
        F64,
        Settings { precision: Precision::F32, ..F64 },
        Settings { precision: Precision::F32, sort: Sort::Distance, ..F64 },
        Settings { precision: Precision::F32, bounds: Bounds::None, ..F64 },
    ] {
        let open = draw(&splats, &camera, settings);
        for none in [0.0, f32::INFINITY] {
            assert_eq!(bits(&before(&splats, &camera, &all(none), settings)), bits(&open));
        }
        for depth in [1.0_f32, 3.0, 6.0] {
            let seen = before(&splats, &camera, &all(depth), settings);
            let kept: Vec<usize> = (0..splats.len()).filter(|i| splats.means[*i][2] < depth).collect();
            let nearer = Splats {
                means: kept.iter().map(|i| splats.means[*i]).collect(),
                quats: kept.iter().map(|i| splats.quats[*i]).collect(),
                scales: kept.iter().map(|i| splats.scales[*i]).collect(),
                opacities: kept.iter().map(|i| splats.opacities[*i]).collect(),
                sh: kept.iter().flat_map(|i| &splats.sh[i * 16..(i + 1) * 16]).copied().collect(),
                ..splats.clone()
            };
            assert_eq!(bits(&seen), bits(&draw(&nearer, &camera, settings)), "{depth}");
            assert!(seen.depth.iter().all(|d| *d <= depth || *d == f32::INFINITY));
        }
        // Half a surface: one side is cut, the other is not.
        let samples = (0..50 * 40).map(|i| if i % 50 < 25 { 2.0 } else { 0.0 }).collect();
        let half = before(&splats, &camera, &Image::<Data>::from_samples(50, 40, 1, samples), settings);
        let cut = before(&splats, &camera, &all(2.0), settings);
        for i in 0..50 * 40 {
            let expected = if i % 50 < 25 { &cut } else { &open };
            assert_eq!(half.rgba[i * 4..i * 4 + 4], expected.rgba[i * 4..i * 4 + 4]);
        }
    }
    let small = Image::<Data>::new(49, 40, 1);
    let limit = Limit { depth: &small, sigmas: 0.0 };
    assert!(render(&splats, &camera, Some(limit), &F64, &context()).is_err());
}

// The splats of a floor scatter around its mesh and do not count as in front of it; a splat farther in front does.
// This test fails if `margin` is left out of either blend, or if it uses the longest axis instead of the middle
// one.
#[test]
fn the_splats_of_a_surface_are_not_in_front_of_it() {
    let noise =
        |i: usize| 0.05 * (crate::geometry::sampling::unit(crate::geometry::sampling::mix(i as u32)) - 0.5);
    let mut splats = cloud(400, 3);
    for i in 0..400 {
        let (x, y) = ((i % 20) as f32 * 0.2 - 1.9, (i / 20) as f32 * 0.2 - 1.9);
        (splats.means[i], splats.scales[i]) = ([x, y, 4.0 + noise(i)], [0.1, 0.04, 0.002]);
        (splats.quats[i], splats.opacities[i]) = ([1.0, 0.0, 0.0, 0.0], 0.9);
    }
    let camera = camera(50, 40, 50.0);
    let floor = Image::<Data>::from_samples(50, 40, 1, vec![4.0; 50 * 40]);
    for settings in [F64, Settings { precision: Precision::F32, ..F64 }] {
        let alpha = |splats: &Splats, sigmas: f64| -> f32 {
            let limit = Some(Limit { depth: &floor, sigmas });
            let seen = render(splats, &camera, limit, &settings, &context()).expect("renders");
            seen.rgba.as_chunks::<4>().0.iter().map(|p| p[3]).sum()
        };
        // The floor alone has nothing in front of it; by centres, half of it is.
        assert!(alpha(&splats, 0.0) > 100.0 && alpha(&splats, 1.0) == 0.0);
        // Splats farther in front of it than their width are kept completely, nearer ones are not.
        let mut post = splats.clone();
        post.means[210][2] = 3.95;
        let whole = alpha(&post, 1.0);
        assert!(whole > 1.0 && alpha(&post, 1.5) == 0.0);
        assert_eq!(alpha(&post, 1.2), whole);
    }
}

// A mesh that lies below its splats by a third of their size, seen at 20 degrees, has none of them in front of it
// by default, and a surface another size below has all of them. This test fails if the default of `limit_sigmas` is
// 0.5 or 5, or if the limit is compared with the depths of centres.
#[test]
fn a_mesh_a_little_under_its_splats_keeps_them() {
    let turned = |degrees: f64| {
        let (sin, cos) = num::sin_cos(degrees.to_radians());
        (sin as f32, cos as f32)
    };
    let (sin, cos) = turned(20.0);
    let (normal, along, middle) = ([0.0, -cos, -sin], [0.0, -sin, cos], [0.0, 0.3, 4.0]);
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let mut splats = cloud(1600, 3);
    let (half_sin, half_cos) = turned(-35.0);
    for i in 0..1600 {
        let (x, y) = ((i % 40) as f32 * 0.1 - 1.95, (i / 40) as f32 * 0.1 - 1.95);
        splats.means[i] = [x, middle[1] + y * along[1], middle[2] + y * along[2]];
        (splats.scales[i], splats.opacities[i]) = ([0.06, 0.06, 0.001], 0.9);
        splats.quats[i] = [half_cos, half_sin, 0.0, 0.0];
    }
    let camera = camera(400, 320, 50.0);
    let below = |by: f32| {
        let depth = |i: usize| {
            let [u, v] = [(i % 400) as f32 - 199.5, (i / 400) as f32 - 159.5];
            let ray = [u / camera.fx as f32, v / camera.fy as f32, 1.0];
            let depth = (dot(middle, normal) - by) / dot(ray, normal);
            if depth > 0.0 { depth } else { f32::INFINITY }
        };
        Image::<Data>::from_samples(400, 320, 1, (0..400 * 320).map(depth).collect())
    };
    for settings in [F64, Settings { precision: Precision::F32, ..F64 }] {
        let range = |by: f32, sigmas: f64| {
            let limit = below(by);
            let seen = render(&splats, &camera, Some(Limit { depth: &limit, sigmas }), &settings, &context());
            let seen = seen.expect("renders");
            // In the rows in the middle, where a ray falls by 18 to 22 degrees.
            let alphas = (150..170).flat_map(|y| (120..280).map(move |x| 400 * y + x));
            let alphas = alphas.map(|i| seen.rgba[4 * i + 3]);
            alphas.fold((1.0_f32, 0.0_f32), |(least, most), alpha| (least.min(alpha), most.max(alpha)))
        };
        // The default of `splat-render`.
        let usual = 3.0;
        let (mesh, far, all) = (range(0.02, usual), range(0.08, usual), range(9.0, usual));
        assert!(range(0.02, 0.5).1 > 0.05 && mesh.1 < 0.05, "{mesh:?}");
        assert!(range(0.08, 5.0).0 < 0.1 && far.0 > 0.8 * all.0, "{far:?} of {all:?}");
    }
}

// An empty picture is not an error, but a warning with its probable cause.
#[test]
fn an_empty_view_is_reported_with_its_cause() {
    let splats = cloud(300, 5);
    let reported = |camera: &Camera, near: f64| {
        let mut notes = Notes::none();
        let seen = draw(&splats, camera, Settings { near, ..F64 });
        seen.work.report(splats.len(), &Settings { near, ..F64 }, &context(), &mut notes);
        notes.iter().map(|note| format!("{}: {}", note.id, note.text)).collect::<String>()
    };
    let ahead = camera(40, 30, 70.0);
    assert_eq!(reported(&ahead, 0.2), "");
    let text = reported(&ahead, 50.0);
    assert!(
        text.starts_with("few-splats-seen: only 0 of 300") && text.contains("than `near` (50 world"),
        "{text}"
    );
    // Too faint to be drawn; points without a filter.
    for (opacity, low_pass_px2, cause) in
        [(0.001, 0.3, "below `alpha_cut` (0.003922"), (0.5, 0.0, "not finite ellipses")]
    {
        let mut points = cloud(300, 5);
        points.opacities.fill(opacity);
        points.scales.fill([0.0; 3]);
        let settings = Settings { low_pass_px2, ..F64 };
        let mut notes = Notes::none();
        draw(&points, &ahead, settings).work.report(points.len(), &settings, &context(), &mut notes);
        let few = notes.iter().find(|note| note.id == "few-splats-seen").expect("a note");
        assert!(few.text.contains(cause), "{}", few.text);
    }
    let aside = DMat4::from_translation(DVec3::new(1e4, 0.0, -1e3)).to_cols_array();
    let text = reported(&Camera { world_from_camera: aside, ..ahead }, 0.2);
    assert!(text.contains("use the same frame and scale"), "{text}");
}

// A tile of a large scene may take seconds if every splat is evaluated everywhere; a cancelled run must not wait
// for it.
#[test]
fn a_stopped_run_ends_within_a_tile() {
    let splats = cloud(400, 3);
    let list: Vec<u32> = (0..50).collect();
    for precision in [Precision::F32, Precision::F64] {
        let settings = Settings { precision, bounds: Bounds::None, stop: 0.0, ..F64 };
        let cx = context();
        let camera_model = Pinhole::new(&camera(TILE as u32, TILE as u32, 60.0));
        let projected = project::project(&splats, None, &camera_model, (&settings, None), &cx, Level::new())
            .expect("projects");
        let evaluations = || {
            let (mut rgba, mut depth) = ([[0.0; 4]; TILE * TILE], [0.0; TILE * TILE]);
            let strips = Strip::of(TILE, &mut rgba, &mut depth, [&mut [], &mut [], &mut []]);
            let task = Task {
                projected: &projected,
                list: &list,
                area: [0, 0, TILE, TILE],
                limit: None,
                settings: &settings,
                cx: &cx,
                strip: &strips[0],
            };
            match precision {
                Precision::F32 => blend32::blend(Level::new(), &task).evaluations,
                Precision::F64 => blend64::blend(&task).evaluations,
            }
        };
        assert!(evaluations() > 0);
        cx.stop();
        assert_eq!(evaluations(), 0, "{precision:?}");
        assert!(render(&splats, &camera(64, 64, 60.0), None, &settings, &cx).is_err());
    }
}
