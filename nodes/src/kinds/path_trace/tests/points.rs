//! Tests of `points`: the ratio at splats is that of the pixels which show the same places.

use render::transport::picture::splat_rays::SplatPixels;
use scene::types::Splats;

use super::*;

/// Splats on the floor, one at each place, at heights of at most 2 mm; and one 1 m above the floor, which comes last.
fn splats(places: &[[f32; 2]]) -> Splats {
    let mut splats = Splats::empty();
    let on_floor = places.iter().enumerate().map(|(i, [x, y])| [*x, *y, 0.001 * (i % 5) as f32 - 0.002]);
    for mean in on_floor.chain([[0.3, 0.3, 1.0]]) {
        splats.means.push(mean);
        splats.scales.push([0.02, 0.02, 0.001]);
        splats.quats.push([1.0, 0.0, 0.0, 0.0]);
        splats.opacities.push(0.9);
        splats.sh.push([0.0; 3]);
    }
    splats
}

/// Seen from straight above, pixels and splats have the same places. Under an even sky their ratios agree within six
/// standard errors of 256 samples, and their means within 0.3 %; the edge of a sun's shadow lies at one side of a splat
/// and crosses a pixel, so under a sun only the means are compared. The splat above the floor, and pixels without a splat, have a ratio of 1.
/// This test fails if the rays come from below the floor.
#[test]
fn splats_have_the_ratio_of_the_pixels_that_show_them() {
    let (floor, objects, _) = shadowed();
    let above = rig(DVec3::new(0.0, 1e-3, 6.0), DVec3::new(0.0, 1e-3, 0.0), 24, 3.0);
    let camera = &above.cameras[0];
    let pose = camera.world_from_camera();
    let at = |x: f64, y: f64| {
        let direction = pose.x_axis * ((x - camera.cx) / camera.fx)
            + pose.y_axis * ((y - camera.cy) / camera.fy)
            + pose.z_axis;
        let point = camera.eye() - direction.truncate() * (camera.eye().z / direction.z);
        [point.x as f32, point.y as f32]
    };
    let pixels: Vec<(u32, u32)> = (0..24 * 24).map(|i| (i % 24, i / 24)).collect();
    let places: Vec<_> = pixels.iter().map(|&(x, y)| at(f64::from(x) + 0.5, f64::from(y) + 0.5)).collect();
    let splats = splats(&places);
    for (env, is_sunny) in [(white(), false), (sunny(), true)] {
        let how = params(256, Surroundings::OPEN);
        let (seen, _) = render(&how, &floor, &objects, &above, &env);
        let inputs = In {
            receiver: Arc::new(floor.clone()),
            objects: objects.clone(),
            rig: above.clone(),
            env: Arc::new(env.clone()),
            points: Some(Arc::new(splats.clone())),
        };
        let (out, _) = PathTrace::run(&how, inputs, &context()).expect("renders");
        let arranged = SplatPixels::of(&splats);
        let image = &out.with.0[0].picture;
        assert_eq!((image.size().0 as u32, image.size().1 as u32), arranged.size);
        let ratio = |out: &Out, at: usize| {
            let [with, without] = [&out.with, &out.without].map(|images| f64::from(samples(images)[3 * at]));
            with / without
        };
        let (mut means, mut owned) = ([0.0; 2], vec![false; samples(&out.with).len() / 3]);
        for (splat, (x, y)) in arranged.iter() {
            let own = (y * arranged.size.0 + x) as usize;
            owned[own] = true;
            let Some(pixel) = (splat < places.len()).then_some(splat) else {
                assert_eq!(ratio(&out, own), 1.0, "above the floor");
                continue;
            };
            let [a, b] = [ratio(&seen, pixel), ratio(&out, own)];
            // The fourth channel is the variance of the ratio. Pixels show places around that of the splat.
            let variance = samples(&seen.variance)[4 * pixel + 3] + samples(&out.variance)[4 * own + 3];
            let allowed = 6.0 * f64::from(variance).sqrt() + 0.08;
            assert!(is_sunny || (a - b).abs() < allowed, "{pixel}: {a} {b}");
            means = [means[0] + a, means[1] + b];
        }
        assert!((means[0] / means[1] - 1.0).abs() < 3e-3, "{means:?}");
        for at in (0..owned.len()).filter(|at| !owned[*at]) {
            assert_eq!(ratio(&out, at), 1.0, "no splat");
        }
    }
}

/// A node with points needs a single camera.
#[test]
fn points_belong_to_one_camera() {
    let (floor, objects, one) = shadowed();
    let two = Rig { cameras: vec![one.cameras[0].clone(), one.cameras[0].clone()] };
    let inputs = In {
        receiver: Arc::new(floor),
        objects,
        rig: Arc::new(two),
        env: Arc::new(white()),
        points: Some(Arc::new(splats(&[]))),
    };
    let error = PathTrace::run(&params(4, Surroundings::OPEN), inputs, &context()).err().expect("is refused");
    assert!(error.message().contains("must have one camera"), "{error}");
}
