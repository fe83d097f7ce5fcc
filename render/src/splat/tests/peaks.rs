//! Tests of `RayMedian`, the depth at which splats are densest along rays.

use engine::Up;
use scene::math::equirect;

use super::*;

const RAY: Settings = Settings { depth: DepthMode::RayMedian, ..F64 };

/// Reference values from the inverse covariance of one opaque splat. First: the reciprocal of the depth of greatest
/// density along a ray, clamped to two standard deviations of depth around the centre. Second: the expected error
/// of its linear approximation. This error is the squared distance of the ray from the centre divided by the
/// squared distance of the eye from the centre, both in standard deviations.
fn textbook(splats: &Splats, ray: DVec3) -> (f64, f64) {
    let (sigma, centre) = (covariance(splats, 0), splats.mean(0));
    let a = sigma.inverse();
    let (across, along) = (ray.dot(a * centre), ray.dot(a * ray));
    let held = 2.0 * sigma.z_axis.z.sqrt();
    let (least, most) = (1.0 / (centre.z + held), 1.0 / (centre.z - held).max(0.2));
    let inverse = if across > 0.0 { (along / across).clamp(least, most) } else { least };
    let own = centre.dot(a * centre);
    (inverse, (own - across * across / along) / own)
}

// This test fails if `q` or the bounds are left out of `Peak`.
#[test]
fn depth_is_where_the_splat_is_densest_along_the_ray() {
    let (mut random, camera) = (Random(5), camera(40, 40, 70.0));
    let (mut pixels, mut held, mut far) = (0, 0, 0);
    for _ in 0..200 {
        let mut splats = cloud(1, random.0);
        let z = random.within(1.0, 9.0);
        let quat = [0; 4].map(|_| random.within(-1.0, 1.0));
        let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        splats.means[0] = [0.3 * z, -0.2 * z, z].map(|v| v as f32);
        splats.quats[0] = quat.map(|q| (q / length) as f32);
        splats.scales[0] = [0; 3].map(|_| (z * num::f64::exp(random.within(-5.0, -1.5))) as f32);
        splats.opacities[0] = 0.95;
        let exact = draw(&splats, &camera, RAY);
        let fast = draw(&splats, &camera, Settings { precision: Precision::F32, ..RAY });
        let centre = splats.mean(0).z;
        for (i, depth) in exact.depth.iter().enumerate().filter(|(_, depth)| depth.is_finite()) {
            let (x, y) = ((i % 40) as f64 + 0.5 - camera.cx, (i / 40) as f64 + 0.5 - camera.cy);
            let (inverse, share) = textbook(&splats, DVec3::new(x / camera.fx, y / camera.fy, 1.0));
            assert!((f64::from(*depth) * inverse - 1.0).abs() < 2e-6, "{depth} against {}", 1.0 / inverse);
            let off = (f64::from(fast.depth[i]) * inverse - 1.0).abs();
            let most = share / (1.0 - share);
            assert!(off < 1.001 * most + 3e-6, "{off} of {most}");
            far += usize::from(off > 1e-3);
            pixels += 1;
            held += usize::from(
                (f64::from(*depth) - centre).abs() > 1.99 * covariance(&splats, 0).z_axis.z.sqrt(),
            );
        }
    }
    assert!(pixels > 1000 && far > 5, "{pixels} pixels, {held} held, {far} far off");
}

/// Floor of flat splats a metre under the eye, rotated at random by up to `tilt`.
fn floor(up: Up, tilt: f64) -> Splats {
    let [right, forward, above] = equirect::axes(up);
    let (mut splats, mut random) = (empty(0), Random(3));
    for i in 0..14_400 {
        let (x, y) = (f64::from(i % 120) * 0.1 - 5.95, f64::from(i / 120) * 0.1 - 5.95);
        let mean = right * x + forward * y - above;
        let turn = DVec3::new(random.within(-tilt, tilt), random.within(-tilt, tilt), 0.0);
        let normal = (above + right * turn.x + forward * turn.y).normalize();
        let q = glam::DQuat::from_rotation_arc(DVec3::Z, normal);
        splats.means.push(mean.to_array().map(|v| v as f32));
        splats.quats.push([q.w, q.x, q.y, q.z].map(|v| v as f32));
        splats.scales.push([0.08, 0.08, 0.001]);
        splats.opacities.push(0.9);
        splats.sh.push([0.5; 3]);
    }
    splats
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

// At angles of 10 to 45 degrees, depths of centres are wrong and depths of peaks are right.
#[test]
fn a_slanting_floor_is_where_it_is() {
    let cos = num::f64::cos(20.0_f64.to_radians());
    let sin = num::f64::sin(20.0_f64.to_radians());
    let (forward, down) = (DVec3::new(0.0, cos, -sin), DVec3::new(0.0, -sin, -cos));
    let camera = Camera::centred("down", [96, 64], 90.0, [DVec3::X, down, forward], DVec3::ZERO);
    let off = |splats: &Splats, settings: Settings| {
        let seen = draw(splats, &camera, settings);
        let errors = seen.depth.iter().enumerate().filter_map(|(i, depth)| {
            let d = camera.direction((i % 96) as f64 + 0.5, (i / 96) as f64 + 0.5);
            let truth = -1.0 / d.z * d.dot(forward);
            let visible = d.z < -0.17 && truth < 4.5;
            visible.then(|| f64::from(*depth) / truth - 1.0)
        });
        median(errors.map(f64::abs).collect())
    };
    for precision in [Precision::F64, Precision::F32] {
        let of = |depth| off(&floor(Up::PlusZ, 0.0), Settings { precision, depth, ..F64 });
        let (centres, peaks) = (of(DepthMode::Median), of(DepthMode::RayMedian));
        assert!(peaks < 1e-4 && centres > 0.01, "{peaks} and {centres}");
        // Tilted by up to 6 degrees the splats of the floor are not one plane.
        let tilted = off(&floor(Up::PlusZ, 0.1), Settings { precision, ..RAY });
        assert!(tilted < 0.5 * centres, "{tilted}");
    }
}

#[test]
fn a_floor_around_the_eye_is_where_it_is() {
    for up in [Up::PlusZ, Up::MinusY] {
        let splats = floor(up, 0.0);
        for precision in [Precision::F64, Precision::F32] {
            let around = PanoramaCamera { eye: DVec3::ZERO, up, width_px: 256 };
            let seen = panorama(&splats, &around, None, &Settings { precision, ..RAY }, &context());
            let seen = seen.expect("renders");
            let above = equirect::axes(up)[2];
            let off = seen.depth.iter().enumerate().filter_map(|(i, depth)| {
                let (u, v) = ((i % 256) as f64 + 0.5, (i / 256) as f64 + 0.5);
                let down = -equirect::direction(up, u / 256.0, v / 128.0).dot(above);
                (down > 0.25).then(|| (f64::from(*depth) * down - 1.0).abs())
            });
            let off = median(off.collect());
            // The layout is linear over a splat only to first order.
            assert!(off < 2e-3, "{off}");
        }
    }
}

// Two discs, the nearer of which hides too little: the mean lies between them, and the spread says so.
#[test]
fn the_spread_tells_one_surface_from_two() {
    let camera = camera(33, 33, 60.0);
    let near = one([0.0, 0.0, 2.0], [0.8; 3], 0.4, [1.0; 3]);
    let far = one([0.0, 0.0, 6.0], [2.0; 3], 0.9, [-1.0; 3]);
    for precision in [Precision::F64, Precision::F32] {
        let middle = 16 * 33 + 16;
        let settings = Settings { precision, ..RAY };
        let both = draw(&join(&[&far, &near]), &camera, settings);
        let (w0, w1) = (0.4, 0.6 * 0.9);
        let expected = (w0 * 3.0 + w1) / (w0 + w1) - 1.0;
        assert!((f64::from(both.spread[middle]) - expected).abs() < 1e-2, "{}", both.spread[middle]);
        let alone = draw(&far, &camera, settings);
        assert!(alone.spread[middle] < 1e-6 && alone.spread.len() == 33 * 33);
        assert!(draw(&far, &camera, Settings { precision, ..F64 }).spread.is_empty());
    }
}

// Points and needles have a depth.
#[test]
fn shapes_without_a_plane_have_the_depth_of_their_centre() {
    for scale in [[0.0; 3], [0.0, 0.0, 0.5], [1e-30; 3], [1e18, 0.0, 0.0]] {
        for precision in [Precision::F64, Precision::F32] {
            let splats = one([0.0, 0.0, 3.0], scale, 0.99, [1.0; 3]);
            let settings = Settings { precision, low_pass_px2: 2.0, ..RAY };
            let seen = draw(&splats, &camera(17, 17, 60.0), settings);
            let depth = seen.depth[8 * 17 + 8];
            assert!(depth > 0.19 && !depth.is_nan(), "{depth}");
            assert!(scale != [0.0; 3] || (depth - 3.0).abs() < 1e-6, "{depth}");
        }
    }
}
