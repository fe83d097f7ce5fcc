//! Tests of samples: their number, sharing and tracing, and their reported errors.

use super::*;

// Limits the number of rays: absent objects cost nothing, and only samples that an object may change are traced
// again.
#[test]
fn rays_are_only_cast_where_they_may_matter() {
    let (plane, objects, rig) = shadowed();
    let rays = |objects: &[Arc<Placed>], block| {
        let cx = context();
        render_in(&cx, &params(16, block), &plane, objects, &rig, &sunny());
        let counts = cx.counts();
        let kinds = ["camera_rays", "shadow_rays", "scattered_rays"].map(|kind| counts[kind]);
        assert_eq!(kinds.iter().sum::<u64>(), counts["rays"]);
        kinds
    };
    // In addition to the samples, one ray per pixel finds the front surface.
    let (samples, front) = (16 * 32 * 32, 32 * 32);
    // Each sample takes a camera ray. At a hit it takes up to four rays to the sky and, if the plane is solid, one
    // scattered ray.
    let (solid, pass) = (rays(&[], Surroundings::OPEN), rays(&[], Surroundings::TRANSPARENT));
    assert_eq!(pass, [samples + front, 0, 0]);
    assert_eq!(solid[0], pass[0]);
    assert!(solid[1] <= samples * 4 && solid[2] <= samples, "{solid:?} for {samples} samples");
    // The camera ray of a sample is shared with the picture without objects. Another one is taken in the few pixels
    // in which the object may be visible. Each sample also takes up to four rays to the sky, and two scattered rays
    // that are tested against the receiver and the object.
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let more = |with: [u64; 3]| std::array::from_fn::<u64, 3, _>(|k| with[k] - solid[k]);
    let there = more(rays(&far, Surroundings::OPEN));
    assert!(there[0] < samples / 16, "{there:?} for {samples} samples");
    assert!(there[1] <= samples * 4 && there[2] <= samples * 4, "{there:?} over {solid:?}");
    let near = more(rays(&objects, Surroundings::OPEN));
    assert!(near.iter().sum::<u64>() < samples * 11, "{near:?} over {solid:?}");
}

// Where a ball can block little light, only few samples estimate the change, and their mean is right: a sphere of
// radius r blocks the share `r^2 h / d^3` of a uniform sky from a plane h below its centre, at the distance d.
#[test]
fn what_is_seldom_asked_is_right_on_average() {
    let black = Material { ior: 1.0, ..matte(0.0) };
    let (radius, height, size) = (0.4, 0.5, 32_u32);
    let objects = [ball(radius, black, DVec3::new(0.0, 0.0, f64::from(height)))];
    let eye = DVec3::new(2.5, 0.0, 5.0);
    let rig = rig(eye, DVec3::new(2.5, 0.0, 0.0), size, 8.0);
    let cx = context();
    let (out, _) = render_in(&cx, &params(64, Surroundings::OPEN), &plane(8.0), &objects, &rig, &white());
    let aside = |k: u32| (f64::from(k) + 0.5 - 16.0) / (8.0 * 16.0) * eye.z;
    let taken = |i: usize| {
        let (x, y) = (eye.x + aside(i as u32 % size), aside(i as u32 / size));
        let squared = x * x + y * y + f64::from(height * height);
        f64::from(radius * radius * height) / (squared * squared.sqrt())
    };
    let expected = (0..1024).map(taken).sum::<f64>();
    let pairs = samples(&out.without).chunks(3).zip(samples(&out.with).chunks(3));
    let got: f64 = pairs.map(|(a, b)| f64::from(1.0 - b[0] / a[0])).sum();
    // The ball is a polyhedron and slightly smaller than the sphere. The noise of the mean of all pixels is less
    // than that.
    assert!((got / expected - 1.0).abs() < 0.025, "{got} for {expected}");
    // The change takes fewer rays than the four per sample of `without`.
    assert!(cx.counts()["shadow_rays"] < 64 * 1024 * 6, "{:?}", cx.counts());
}

// Chunks do not depend on the number of samples, so more samples only add chunks.
#[test]
fn more_samples_only_add_chunks() {
    let (plane, objects, rig) = shadowed();
    let sums = |n| {
        let (out, _) = render(&params(n, Surroundings::OPEN), &plane, &objects, &rig, &sunny());
        samples(&out.without).iter().map(|v| f64::from(*v) * f64::from(n)).collect::<Vec<_>>()
    };
    let (four, sixteen) = (sums(4), sums(16));
    assert!(four.iter().zip(&sixteen).all(|(a, b)| *b >= a - 1e-4));
}

// One thread and several threads give the same bytes and the same ray counts.
#[test]
fn threads_do_not_change_a_bit() {
    let (plane, objects, rig) = shadowed();
    let go = |threads: usize| {
        let pool = rayon_pool(threads);
        pool.install(|| {
            let cx = context();
            let (out, _) = render_in(&cx, &params(8, Surroundings::Auto), &plane, &objects, &rig, &sunny());
            let pictures = [&out.with, &out.object, &out.depth].map(|images| samples(images).to_vec());
            (pictures, cx.counts())
        })
    };
    let (pictures, counts) = go(1);
    // Steps are counted for one tile in 16 of each chunk.
    assert!(counts["followed_rays"] > counts["rays"] / 64 && counts["followed_rays"] < counts["rays"] / 4);
    assert!(counts["bvh_nodes"] > counts["followed_rays"] / 4 && counts["triangle_tests"] > 0);
    assert_eq!((pictures, counts), go(3));
}
