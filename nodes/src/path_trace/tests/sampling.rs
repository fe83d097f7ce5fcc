//! Samples: how many are taken, shared and traced, and what they claim of themselves.

use super::*;

// Work is counted, and guarded: objects that are not there cost nothing, and for those that are only the
// samples that they touch are traced again.
#[test]
fn rays_are_only_cast_where_they_may_matter() {
    let (plane, objects, rig) = shadowed();
    let rays = |objects: &[Arc<Placed>], block| {
        let cx = context();
        render_in(&cx, &params(16, block), &plane, objects, &rig, &sunny());
        cx.counts()["rays"]
    };
    let samples = 16 * 32 * 32;
    // A camera ray; where it lands up to four to the sky and, where the plane is solid, one scattered.
    let (solid, pass) = (rays(&[], EnvBlock::Solid), rays(&[], EnvBlock::Pass));
    assert!(solid <= samples * 6 && pass == samples, "{solid} {pass} for {samples} samples");
    // Again a camera ray, and another to the object; up to four to the sky, and two scattered.
    let far = [ball(0.4, matte(0.6), DVec3::new(0.0, 0.0, -50.0))];
    let there = rays(&far, EnvBlock::Solid);
    assert!(there <= solid + samples * 8, "{there} over {solid}");
    let near = rays(&objects, EnvBlock::Solid);
    assert!(near < solid + samples * 11, "{near} over {solid}");
}

// 64 then 256 equals 256 at once, in small: chunks are the same whatever the number of samples is.
#[test]
fn more_samples_only_add_chunks() {
    let (plane, objects, rig) = shadowed();
    let sums = |n| {
        let (out, _) = render(&params(n, EnvBlock::Solid), &plane, &objects, &rig, &sunny());
        samples(&out.without).iter().map(|v| f64::from(*v) * f64::from(n)).collect::<Vec<_>>()
    };
    let (four, sixteen) = (sums(4), sums(16));
    assert!(four.iter().zip(&sixteen).all(|(a, b)| *b >= a - 1e-4));
}

// Same bytes with one thread and with several.
#[test]
fn threads_do_not_change_a_bit() {
    let (plane, objects, rig) = shadowed();
    let go = |threads: usize| {
        let pool = rayon_pool(threads);
        pool.install(|| {
            let (out, _) = render(&params(8, EnvBlock::Auto), &plane, &objects, &rig, &sunny());
            [samples(&out.with).to_vec(), samples(&out.object).to_vec(), samples(&out.depth).to_vec()]
        })
    };
    assert_eq!(go(1), go(3));
}

// The standard error that comes out is that of the mean: over many seeds the spread of a pixel is not above
// the estimate for independent samples, and not far below it either.
#[test]
fn variance_is_an_upper_estimate() {
    let (plane, objects, rig) = shadowed();
    let mut runs = Vec::new();
    let mut claimed = 0.0;
    for seed in 0..12 {
        let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed };
        let cx = Context::detached(scene, ".");
        let (out, _) = render_in(&cx, &params(16, EnvBlock::Solid), &plane, &objects, &rig, &sunny());
        claimed += samples(&out.variance).chunks(4).map(|p| f64::from(p[0])).sum::<f64>() / 12.0;
        let s = samples(&out.without);
        runs.push(s.chunks(3).map(|p| f64::from(luminance([p[0], p[1], p[2]]))).collect::<Vec<_>>());
    }
    let mut spread = 0.0;
    for pixel in 0..runs[0].len() {
        let values: Vec<f64> = runs.iter().map(|r| r[pixel]).collect();
        let mean = values.iter().sum::<f64>() / 12.0;
        spread += values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 11.0;
    }
    assert!(spread < 1.1 * claimed && spread > 0.01 * claimed, "{spread} against {claimed}");
}
